"""Tracks of other road users: a Kalman filter for each, with association and confirmation.

The state of a track is position, velocity and acceleration in the map. The acceleration is a
first-order Markov process (R. A. Singer, "Estimating optimal tracking filter performance for manned
maneuvering targets", IEEE Transactions on Aerospace and Electronic Systems AES-6 (1970)). A radar
measures position and the speed along its line of sight, a camera position alone. Detections are
assigned to the nearest track within a gate of the Mahalanobis distance and one of the speed, the
closest pair first (S. Blackman and R. Popoli, "Design and Analysis of Modern Tracking Systems"
(1999), chapter 6). The truck's own place in the map is taken as known.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from iits_mj.core.angles import wrap_angle
from iits_mj.core.arrays import BoolArray, FloatArray
from iits_mj.core.messages import TrackedVehicle
from iits_mj.core.vehicles import VehicleFrame
from iits_mj.road import Route

# Settings, our choices. Time constant of an acceleration [s]; its standard deviations along and
# across the heading [m/s2]; gate of the squared Mahalanobis distance: 99.9 % of two degrees of
# freedom.
_TIME_CONSTANT, _ACCELERATION, _GATE = 2.0, (2.5, 0.5), 13.8
# Gate of the speed: standard deviations, and the hardest braking or acceleration since the track's
# last detection [m/s2].
_SPEED_GATE, _HARDEST = 4.0, 10.0
# Scans with a detection before a track is reported, and those of a camera where one looks.
_CONFIRMED, _SEEN = 3, 2
# Time without detection after which a track ends, and one that is not confirmed [s].
_LOST, _TENTATIVE = 0.8, 0.25
# Share of a measured heading that a track takes over.
_HEADING_SHARE = 0.3
# A wheeled vehicle moves across its heading by no more than this share of its motion along it: what
# stands does not move aside, whatever the noise of its position says. The standard deviation of its
# speed across [m/s] has a floor, for the error of the heading.
_COURSE, _SLIP = 0.35, 0.1
# A track this far above or below the route's surface is on another road [m].
_OTHER_LEVEL = 3.0
# Spread of a new track's velocity along its heading, known and not, and across it [m/s], and of its
# acceleration [m/s2].
_NEW_SPEED, _UNKNOWN_SPEED, _NEW_LATERAL, _NEW_ACCELERATION = 3.0, 30.0, 0.7, 1.0


@dataclass(frozen=True, slots=True)
class Detection:
    """An object as one sensor sees it.

    Attributes:
      x, y: of the center of its box in the map [m].
      covariance: of x and y, as xx, xy and yy [m2].
      sight: unit vector from the sensor to the object in the map.
      speed: of the object over ground along `sight` [m/s], nan if it is not measured.
      speed_sigma: standard deviation of `speed` [m/s].
      look: kind, size, heading and height of the object; its id and its motion are not used.
    """

    x: float
    y: float
    covariance: tuple[float, float, float]
    sight: tuple[float, float]
    speed: float
    speed_sigma: float
    look: TrackedVehicle


@dataclass(slots=True, eq=False)
class _Track:
    """State (6,) and its covariance (6, 6), appearance, and counts of scans."""

    name: str
    state: FloatArray
    covariance: FloatArray
    look: TrackedVehicle
    seen_at: float
    hits: int = 1
    camera: int = 0
    confirmed: bool = False
    counted: bool = True


class Tracker:
    """Makes stable tracks of the detections of several sensors.

    The route, the truck's road, gives station, offset and lane of the tracks.
    """

    def __init__(self, route: Route) -> None:
        self.route = route
        self.reset()

    def reset(self) -> None:
        """Forgets all tracks."""
        self._tracks: list[_Track] = []
        self._time = -math.inf
        self._made = 0

    def update(
        self,
        time: float,
        scans: Sequence[tuple[bool, Sequence[Detection]]],
        watched: Callable[[FloatArray], BoolArray] | None = None,
        *,
        at_once: bool = False,
    ) -> None:
        """Takes over the scans of one instant.

        Args:
          time: of the measurement [s], not before that of the last scans.
          scans: of each sensor, whether it is a camera, and its detections.
          watched: returns which of the places (n, 2) a camera covers; default: none.
          at_once: confirms new tracks with their first detection, as when a drive begins with a
            system that has been running.
        """
        elapsed = 0.0 if math.isinf(self._time) else time - self._time
        for track in self._tracks:
            self._predict(track, elapsed)
            track.counted = False
        self._time = time
        for camera, detections in scans:
            self._take(time, camera, detections)
        places = np.array([t.state[:2] for t in self._tracks]).reshape(-1, 2)
        covered = np.zeros(len(places), bool) if watched is None else watched(places)
        kept: list[_Track] = []
        for track, in_view in zip(self._tracks, covered, strict=True):
            enough = track.hits >= _CONFIRMED
            enough &= track.camera >= _SEEN or not in_view
            track.confirmed |= enough or at_once
            patience = _LOST if track.confirmed else _TENTATIVE
            known = any(_inside(track.state, older) for older in kept if older.confirmed)
            if time - track.seen_at <= patience + 1e-9 and not known:
                kept.append(track)
        self._tracks = kept

    def vehicles(self, time: float) -> VehicleFrame:
        """Returns the confirmed tracks, predicted to a time [s]."""
        ahead = max(time - self._time, 0.0)
        return VehicleFrame.of([self._vehicle(t, ahead) for t in self._tracks if t.confirmed])

    def _predict(self, track: _Track, elapsed: float) -> None:
        if elapsed <= 0.0:
            return
        forward = transition(elapsed)
        # Singer's noise for steps that are short against the time constant: of the acceleration.
        kept = 1.0 - math.exp(-2.0 * elapsed / _TIME_CONSTANT)
        turn = _rotation(track.look.yaw)
        spread = np.diag(np.square(_ACCELERATION)) * kept
        gain = np.array([elapsed**2 / 2.0, elapsed, 1.0])
        noise = np.kron(np.outer(gain, gain), turn @ spread @ turn.T)
        track.state = forward @ track.state
        track.covariance = forward @ track.covariance @ forward.T + noise
        if track.look.kind != "pedestrian":
            self._roll(track)

    def _roll(self, track: _Track) -> None:
        """Takes over that wheels hardly move across their heading, as a measured speed of zero."""
        model, yaw = np.zeros((1, 6)), track.look.yaw
        model[0, 2:4] = -math.sin(yaw), math.cos(yaw)
        along = math.cos(yaw) * track.state[2] + math.sin(yaw) * track.state[3]
        sigma = math.hypot(_SLIP, _COURSE * float(along))
        _update(track, model, np.array([[sigma**2]]), np.zeros(1))

    def _take(self, time: float, camera: bool, detections: Sequence[Detection]) -> None:
        """Updates tracks with the detections of one sensor, and begins new ones."""
        pairs = []
        for k, seen in enumerate(detections):
            (xx, xy, yy), place = seen.covariance, np.array([seen.x, seen.y])
            measured = np.array([[xx, xy], [xy, yy]])
            for track in self._tracks:
                off = place - track.state[:2]
                if abs(off[0]) + abs(off[1]) > 30.0:  # saves the exact distance
                    continue
                if _leaps(track, seen, time):
                    continue
                spread = track.covariance[:2, :2] + measured
                pairs.append((float(off @ np.linalg.solve(spread, off)), track.name, k, track))
        pairs.sort(key=lambda pair: pair[:3])
        free, used = set(range(len(detections))), set()
        for distance, name, k, track in pairs:
            if distance > _GATE:
                break
            if k in free and name not in used:
                free.discard(k)
                used.add(name)
                self._correct(track, detections[k], time, camera)
        for k in sorted(free):
            self._begin(detections[k], time, camera)

    def _correct(self, track: _Track, seen: Detection, time: float, camera: bool) -> None:
        """Updates a track with position and, of a radar, speed along sight."""
        (xx, xy, yy), (ux, uy) = seen.covariance, seen.sight
        model = np.zeros((3, 6))
        model[0, 0] = model[1, 1] = 1.0
        model[2, 2:4] = ux, uy
        measured = np.array([[xx, xy, 0.0], [xy, yy, 0.0], [0.0, 0.0, seen.speed_sigma**2]])
        value = np.array([seen.x, seen.y, seen.speed])
        if math.isnan(seen.speed):
            model, measured, value = model[:2], measured[:2, :2], value[:2]
        _update(track, model, measured, value)
        turned = wrap_angle(seen.look.yaw - track.look.yaw)
        yaw = track.look.yaw + _HEADING_SHARE * turned
        track.look = dataclasses.replace(seen.look, yaw=yaw)
        track.seen_at = time
        track.camera += camera
        track.hits += not track.counted
        track.counted = True

    def _begin(self, seen: Detection, time: float, camera: bool) -> None:
        """A new track that moves along its heading."""
        (xx, xy, yy), look = seen.covariance, seen.look
        forward = np.array([math.cos(look.yaw), math.sin(look.yaw)])
        along = float(forward @ np.array(seen.sight))
        velocity = np.zeros(2)
        if not math.isnan(seen.speed) and abs(along) > 0.5:
            velocity = forward * seen.speed / along
        turn = _rotation(look.yaw)
        covariance = np.zeros((6, 6))
        covariance[:2, :2] = (xx, xy), (xy, yy)
        along = _UNKNOWN_SPEED if math.isnan(seen.speed) else _NEW_SPEED
        covariance[2:4, 2:4] = turn @ np.diag([along**2, _NEW_LATERAL**2]) @ turn.T
        covariance[4:, 4:] = np.eye(2) * _NEW_ACCELERATION**2
        state = np.array([seen.x, seen.y, *velocity, 0.0, 0.0])
        self._made += 1
        name = f"track{self._made:06d}"
        self._tracks.append(_Track(name, state, covariance, look, time, camera=int(camera)))

    def _vehicle(self, track: _Track, ahead: float) -> TrackedVehicle:
        x, y, vx, vy, ax, ay = transition(ahead) @ track.state
        look, route = track.look, self.route
        station, offset = route.locate(x, y, look.station)
        road = route.evaluate(station, offset)
        lane = route.lane_at(station, offset)
        forward, left = math.cos(look.yaw), math.sin(look.yaw)
        along, across = float(vx * forward + vy * left), float(vy * forward - vx * left)
        if look.kind != "pedestrian":
            across = math.copysign(min(abs(across), _COURSE * abs(along)), across)
        turned = look.yaw - float(road.heading)
        return dataclasses.replace(
            look,
            id=track.name,
            x=float(x),
            y=float(y),
            speed=along,
            acceleration=float(ax * forward + ay * left),
            lateral_speed=along * math.sin(turned) + across * math.cos(turned),
            station=float(station),
            offset=float(offset),
            lane=lane if abs(look.z - float(road.z)) <= _OTHER_LEVEL else -1,
            yaw_rate=0.0,
        )


def _leaps(track: _Track, seen: Detection, time: float) -> bool:
    """Whether the speed of a detection is none that a track can have, such as that of a ghost."""
    if math.isnan(seen.speed):
        return False
    sight = np.array(seen.sight)
    spread = float(sight @ track.covariance[2:4, 2:4] @ sight) + seen.speed_sigma**2
    change = abs(seen.speed - float(sight @ track.state[2:4]))
    return change > _SPEED_GATE * math.sqrt(spread) + _HARDEST * (time - track.seen_at)


def _update(track: _Track, model: FloatArray, measured: FloatArray, value: FloatArray) -> None:
    """The update of a Kalman filter, in Joseph's form.

    Args:
      track: of which the state changes.
      model: of the measurement, shape (n, 6).
      measured: covariance of the measurement, shape (n, n).
      value: measured, shape (n,).
    """
    p = track.covariance
    gain = np.linalg.solve(model @ p @ model.T + measured, model @ p).T
    rest = np.eye(6) - gain @ model
    track.state = track.state + gain @ (value - model @ track.state)
    track.covariance = rest @ p @ rest.T + gain @ measured @ gain.T


def _inside(place: FloatArray, track: _Track) -> bool:
    """Whether a place lies in the box of a track, where no second object can be."""
    look, (dx, dy) = track.look, place[:2] - track.state[:2]
    forward, left = math.cos(look.yaw), math.sin(look.yaw)
    along, across = dx * forward + dy * left, dy * forward - dx * left
    return bool(abs(along) < 0.5 * look.length and abs(across) < 0.5 * look.width)


def transition(elapsed: float) -> FloatArray:
    """Matrix that advances a state by a time [s], shape (6, 6); Singer's, equation 12."""
    t = _TIME_CONSTANT
    fade = math.exp(-elapsed / t)
    speed, place = t * (1.0 - fade), t * t * (elapsed / t - 1.0 + fade)
    matrix = np.array([[1.0, elapsed, place], [0.0, 1.0, speed], [0.0, 0.0, fade]])
    return np.kron(matrix, np.eye(2))


def _rotation(yaw: float) -> FloatArray:
    return np.array([[math.cos(yaw), -math.sin(yaw)], [math.sin(yaw), math.cos(yaw)]])
