"""Radars and cameras of a drive: what they report of the traffic, and the tracks made of it.

A sensor reports an object whose nearest point is within its range and field of view and of which a
quarter or more is not hidden by nearer vehicles. Range, bearing and speed along the line of sight
have Gaussian noise. Detections drop out at random, arrive late, and radars report ghosts: objects
that are not there, for as long as an exponential time. Ghosts stand, or move with the traffic.

The typical figures of 3GPP TR 22.837 V19 (2024), table "Typical automotive radar KPIs", are the
defaults; of a range of accuracies we take the worse end as the standard deviation: long-range radar
250 m with more than 90 % probability of detection, accuracy 0.4 m, 0.3 deg and 0.12 m/s, field of
view 9 to 15 deg to either side; short-range radar 100 m, 0.1 m, 5 deg (we take 1 deg, as trackers
of objects average over many reflections), 60 to 85 deg to either side. Range and field of view of
the camera, its errors, and rates of ghosts are our assumptions. Not modeled: dependence on the
radar cross section and the weather, drop-outs that last, reflections of signs and guard rails other
than ghosts, errors of size and kind, and errors of the truck's own place.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from controllers.perception.tracker import Detection, Tracker
from iits_mj.core.angles import wrap_angles
from iits_mj.core.arrays import BoolArray, FloatArray, IndexArray
from iits_mj.core.checks import in_range, require_positive
from iits_mj.core.messages import EgoFootprint, EgoState, TrackedVehicle
from iits_mj.core.vehicles import VehicleFrame
from iits_mj.road import Route

# Share of an object's width, seen from the sensor, that must not be hidden.
_SHOWS = 0.25
_RAYS = 9
# Standard deviation of a measured heading [rad].
_HEADING_SIGMA = math.radians(1.0)
LATENCY = 0.1  # from a scan to its tracks [s]


@dataclass(frozen=True, slots=True)
class Sensor:
    """A radar, or a camera, which measures no speed.

    Attributes:
      ahead: of the truck's front, negative behind it [m]; left: of its middle plane [m].
      direction: of its axis [rad], positive to the left of straight ahead.
      reach: range [m]; half_view: field of view to either side [rad].
      range_sigma: standard deviation of the range [m], and range_share: in proportion to it.
      bearing_sigma: of the bearing [rad]; speed_sigma: of the speed along sight [m/s].
      detection: probability of a detection in a scan.
      camera: whether it is a camera.
      ghosts: mean number of new ghosts per second; ghost_life: their mean life [s].
    """

    ahead: float
    left: float
    direction: float
    reach: float
    half_view: float
    range_sigma: float
    bearing_sigma: float
    range_share: float = 0.0
    speed_sigma: float = 0.12
    detection: float = 0.9
    camera: bool = False
    ghosts: float = 0.0
    ghost_life: float = 0.15

    def __post_init__(self) -> None:
        require_positive(self, "reach", "half_view", "bearing_sigma", "speed_sigma", "ghost_life")
        require_positive(self, "range_sigma", "range_share", "ghosts", zero=True)
        in_range("Sensor: detection", self.detection, 0.0, 1.0)


_LONG_RANGE = Sensor(0.0, 0.0, 0.0, 250.0, math.radians(15.0), 0.4, math.radians(0.3), ghosts=0.1)
_SHORT_RANGE = Sensor(0.0, 0.0, 0.0, 100.0, math.radians(60.0), 0.1, math.radians(1.0), ghosts=0.1)
_CAMERA = Sensor(
    *(-0.4, 0.0, 0.0, 150.0, math.radians(50.0), 0.5, math.radians(0.2)),
    range_share=0.05,
    camera=True,
)
# Behind the cab's front corners, along the trailer; the area behind the trailer stays unseen.
_SIDES = tuple(
    dataclasses.replace(
        _SHORT_RANGE,
        ahead=-0.9,
        left=side * 1.275,
        direction=side * math.radians(107.0),
        half_view=math.radians(72.0),
        ghosts=0.05,
    )
    for side in (1.0, -1.0)
)
_FRONT = (_LONG_RANGE, _SHORT_RANGE, _CAMERA)
# By the option `sensors` of a drive.
SUITES = {"front": _FRONT, "surround": (*_FRONT, *_SIDES)}
CHOICES = ("perfect", *SUITES)


@dataclass(slots=True)
class _Ghost:
    """Place, velocity and end of a ghost in the map [m], [m/s], [s]."""

    place: FloatArray
    velocity: FloatArray
    end: float


class Perception:
    """The sensors of a truck and its tracker.

    Args:
      sensors: of the truck.
      route: the truck's road.
      footprint: of the truck.
      seed: of noise, drop-outs and ghosts.
    """

    def __init__(
        self, sensors: Sequence[Sensor], route: Route, footprint: EgoFootprint, seed: int
    ) -> None:
        self.sensors, self._seed, self._front = tuple(sensors), seed, footprint.front_overhang
        self.tracker = Tracker(route)
        self.reset()

    def reset(self) -> None:
        """Forgets everything; the same scenes then give the same tracks."""
        self._random = np.random.default_rng([self._seed, 77])
        self.tracker.reset()
        self._late: deque[tuple[EgoState, list[tuple[bool, list[Detection]]]]] = deque()
        self._ghosts: list[list[_Ghost]] = [[] for _ in self.sensors]
        self._last: float | None = None

    def see(self, ego: EgoState, vehicles: VehicleFrame) -> VehicleFrame:
        """Returns the tracks that the truck has now; call it once per cycle.

        Args:
          ego: the truck now.
          vehicles: the traffic now, as it is.
        """
        first, elapsed = self._last is None, ego.time - (self._last or ego.time)
        self._last = ego.time
        scans = [
            (sensor.camera, self._scan(sensor, ghosts, ego, vehicles, elapsed))
            for sensor, ghosts in zip(self.sensors, self._ghosts, strict=True)
        ]
        self._late.append((ego, scans))
        while self._late and (first or self._late[0][0].time <= ego.time - LATENCY + 1e-6):
            seen_from, arrived = self._late.popleft()
            watched = functools.partial(self._watched, seen_from)
            self.tracker.update(seen_from.time, arrived, watched, at_once=first)
        return self.tracker.vehicles(ego.time)

    def _watched(self, ego: EgoState, places: FloatArray) -> BoolArray:
        """Which places (n, 2) a camera covers."""
        covered = np.zeros(len(places), bool)
        for sensor in (each for each in self.sensors if each.camera):
            dx, dy = places.T - np.array(_mount(sensor, ego, self._front))[:, None]
            bearing = wrap_angles(np.arctan2(dy, dx) - ego.yaw - sensor.direction)
            near = np.hypot(dx, dy) <= sensor.reach
            covered |= near & (np.abs(bearing) <= sensor.half_view)
        return covered

    def _scan(
        self,
        sensor: Sensor,
        ghosts: list[_Ghost],
        ego: EgoState,
        vehicles: VehicleFrame,
        elapsed: float,
    ) -> list[Detection]:
        random, (x, y) = self._random, _mount(sensor, ego, self._front)
        shown = visible(sensor, ego, vehicles, self._front)
        found = []
        for index in shown[random.random(len(shown)) < sensor.detection]:
            look = vehicles[int(index)]
            velocity = look.speed * _unit(look.yaw)
            found.append(self._measure(sensor, look, look.x - x, look.y - y, velocity, x, y))
        if sensor.ghosts > 0.0:
            self._haunt(sensor, ghosts, ego, elapsed)
        for ghost in ghosts:
            # A ghost has the heading of the truck's road, as far as a radar can tell.
            look, (dx, dy) = _ghost_look(ego), (ghost.place - (x, y)).tolist()
            found.append(self._measure(sensor, look, dx, dy, ghost.velocity, x, y))
        return found

    def _measure(
        self,
        sensor: Sensor,
        look: TrackedVehicle,
        dx: float,
        dy: float,
        velocity: FloatArray,
        x: float,
        y: float,
    ) -> Detection:
        """A noisy detection of an object at (dx, dy) from the sensor at (x, y)."""
        noise = self._random.normal(size=4).tolist()
        true_range = math.hypot(dx, dy)
        spread = sensor.range_sigma + sensor.range_share * true_range
        reach = max(true_range + spread * noise[0], 0.1)
        bearing = math.atan2(dy, dx) + sensor.bearing_sigma * noise[1]
        ux, uy = math.cos(bearing), math.sin(bearing)
        along, across = spread**2, (reach * sensor.bearing_sigma) ** 2
        speed = float(velocity @ (dx, dy)) / max(true_range, 0.1) + sensor.speed_sigma * noise[2]
        return Detection(
            x=x + reach * ux,
            y=y + reach * uy,
            covariance=(
                along * ux * ux + across * uy * uy,
                (along - across) * ux * uy,
                along * uy * uy + across * ux * ux,
            ),
            sight=(ux, uy),
            speed=math.nan if sensor.camera else speed,
            speed_sigma=sensor.speed_sigma,
            look=dataclasses.replace(look, yaw=look.yaw + _HEADING_SIGMA * noise[3]),
        )

    def _haunt(self, sensor: Sensor, ghosts: list[_Ghost], ego: EgoState, elapsed: float) -> None:
        """Moves the ghosts of a radar, ends old ones and makes new ones."""
        random = self._random
        for ghost in ghosts:
            ghost.place = ghost.place + ghost.velocity * elapsed
        ghosts[:] = [ghost for ghost in ghosts if ghost.end > ego.time]
        for _ in range(random.poisson(sensor.ghosts * elapsed)):
            # Uniform over the area of the field of view; half of the ghosts stand.
            reach = sensor.reach * math.sqrt(random.random())
            bearing = ego.yaw + sensor.direction + sensor.half_view * random.uniform(-1.0, 1.0)
            speed = 0.0 if random.random() < 0.5 else random.uniform(0.5, 1.2) * ego.speed
            place = np.array(_mount(sensor, ego, self._front)) + reach * _unit(bearing)
            end = ego.time + random.exponential(sensor.ghost_life)
            ghosts.append(_Ghost(place, speed * _unit(ego.yaw), end))


def visible(sensor: Sensor, ego: EgoState, vehicles: VehicleFrame, front: float) -> IndexArray:
    """Returns the indices of the vehicles that a sensor sees, without drop-outs, shape (n,).

    A vehicle on another level counts like one on the road.

    Args:
      sensor: radar or camera.
      ego: the truck.
      vehicles: the traffic.
      front: from the steer axle's center to the truck's front [m].
    """
    x, y = _mount(sensor, ego, front)
    dx, dy, yaw, length, width = vehicles.columns("x", "y", "yaw", "length", "width")
    dx, dy = dx - x, dy - y
    near = np.flatnonzero(np.hypot(dx, dy) <= sensor.reach + 0.5 * length)
    if not near.size:
        return near
    dx, dy, yaw, length, width = (column[near] for column in (dx, dy, yaw, length, width))
    cosine, sine = np.cos(yaw), np.sin(yaw)
    along = 0.5 * length * np.array([[1.0], [1.0], [-1.0], [-1.0]])
    across = 0.5 * width * np.array([[1.0], [-1.0], [1.0], [-1.0]])
    corner_x, corner_y = dx + along * cosine - across * sine, dy + along * sine + across * cosine
    middle = np.arctan2(dy, dx) - ego.yaw - sensor.direction
    bearing = middle + wrap_angles(np.arctan2(corner_y, corner_x) - np.arctan2(dy, dx))
    turns = np.round(middle / math.tau) * math.tau
    right, left = bearing.min(axis=0) - turns, bearing.max(axis=0) - turns
    nearest = np.hypot(corner_x, corner_y).min(axis=0)
    rays = right + (left - right) * np.linspace(0.02, 0.98, _RAYS)[:, None]
    in_view = np.abs(rays) <= sensor.half_view
    hidden = (
        (rays[:, :, None] >= right) & (rays[:, :, None] <= left) & (nearest < nearest[:, None])
    ).any(axis=2)
    shows = (in_view & ~hidden).mean(axis=0) >= _SHOWS
    return near[shows & (nearest <= sensor.reach)]


def _ghost_look(ego: EgoState) -> TrackedVehicle:
    return TrackedVehicle("", z=ego.z, yaw=ego.yaw, station=ego.station)


def _mount(sensor: Sensor, ego: EgoState, front: float) -> tuple[float, float]:
    """Place of a sensor in the map [m]."""
    ahead = front + sensor.ahead
    forward, left = math.cos(ego.yaw), math.sin(ego.yaw)
    return (
        ego.x + ahead * forward - sensor.left * left,
        ego.y + ahead * left + sensor.left * forward,
    )


def _unit(angle: float) -> FloatArray:
    return np.array([math.cos(angle), math.sin(angle)])
