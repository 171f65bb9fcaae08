"""Places a truck on its road: pose of all its units, speed, rolling wheels."""

from __future__ import annotations

import math
from dataclasses import dataclass

import mujoco
import numpy as np

from iits_mj.core.arrays import FloatArray
from iits_mj.core.checks import in_range
from iits_mj.parameters import TruckParameters
from iits_mj.parameters.mass_state import group_center
from iits_mj.road import Route

# No truck rolls faster: well above what the tires and the driveline are made for.
SPEED_MAX = 60.0
STATION_MAX, OFFSET_MAX = 1e6, 1e3  # [m], beyond every road
_TRACK = 1.0  # [m], from the middle of a truck to its wheel tracks
_ANGLES = ("yaw", "pitch", "roll")
ARTICULATION_MAX = 0.5 * math.pi  # [rad], where the trailer meets the cab


@dataclass(frozen=True, kw_only=True)
class TruckPlacement:
    """A place and motion of a truck on its road, rolling freely.

    Attributes:
      station: of the steer axle's center on the route [m].
      offset: of the same, to the left [m].
      speed: of the steer axle along the tractor [m/s], zero or positive.
      heading: of the tractor against the road, positive to the left [rad].
      articulation: tractor's yaw less that of the first towed unit [rad], further units straight
        behind it; None: the units follow the road.

    Raises:
      InputError: a value is not a number, or beyond these bounds: station 1000 km, offset 1 km,
        speed 0 to 60 m/s, heading half a turn, articulation a right angle.
    """

    station: float = 20.0
    offset: float = 0.0
    speed: float = 0.0
    heading: float = 0.0
    articulation: float | None = None

    def __post_init__(self) -> None:
        in_range("reset: station", self.station, -STATION_MAX, STATION_MAX, "m")
        in_range("reset: offset", self.offset, -OFFSET_MAX, OFFSET_MAX, "m")
        in_range("reset: speed", self.speed, 0.0, SPEED_MAX, "m/s")
        in_range("reset: heading", self.heading, -math.pi, math.pi, "rad")
        if self.articulation is not None:
            most = ARTICULATION_MAX
            in_range("reset: articulation", self.articulation, -most, most, "rad")


class Poser:
    """Writes placements into the positions and velocities of a truck's joints.

    Args:
      model: a compiled scene.
      parameters: of the truck; route: its road.
      prefix: of the truck's names in the model.
    """

    def __init__(
        self, model: mujoco.MjModel, parameters: TruckParameters, route: Route, prefix: str
    ) -> None:
        self._parameters = parameters
        self._route = route
        free = model.joint(f"{prefix}tractor_free")
        self._position, self._velocity = int(free.qposadr[0]), int(free.dofadr[0])
        self._hitches = [
            [int(model.joint(f"{prefix}{name}_{part}").qposadr[0]) for part in _ANGLES]
            for name in parameters.coupling_names
        ]
        self._spin = {
            axle.name: [
                int(model.joint(f"{prefix}{axle.name}_{side}_spin").dofadr[0])
                for side in ("left", "right")
            ]
            for axle in parameters.axles
        }
        # Of each towed unit, from its coupling to the middle of its axles.
        self._reaches = [group_center(unit.axles) for unit in parameters.units[1:]]

    @property
    def behind(self) -> float:
        """Distance of the last unit's rear axle group behind the steer axle [m]."""
        p = self._parameters
        if not self._reaches:
            return p.lead.axles[-1].position
        return sum(coupling.position for coupling in p.couplings) + self._reaches[-1]

    def pose(self, data: mujoco.MjData, place: TruckPlacement) -> None:
        """Writes the pose: every unit on its axles."""
        p, at = self._parameters, self._position
        wheelbase = next(axle for axle in p.lead.axles if not axle.steered).position
        station, offset = place.station, place.offset
        front = self._point(station, offset)
        rear = self._point(station - wheelbase, offset)
        rotation = _frame(front - rear, self._across(station - 0.5 * wheelbase))
        if place.heading:
            rotation = rotation @ _yaw(place.heading)
        data.qpos[at : at + 3] = front
        mujoco.mju_mat2Quat(data.qpos[at + 3 : at + 7], rotation.ravel())
        for places, angles in zip(
            self._hitches, self._hitch_angles(place, front, rotation), strict=True
        ):
            data.qpos[places] = angles
        data.qvel[self._velocity : self._velocity + 3] = rotation[:, 0] * place.speed
        for axle in p.axles:
            spin = place.speed / p.tires[axle.tire].rolling_radius
            data.qvel[self._spin[axle.name]] = spin

    def _hitch_angles(
        self, place: TruckPlacement, front: FloatArray, rotation: FloatArray
    ) -> list[tuple[float, float, float]]:
        """Yaw, pitch and roll of each towed unit in the frame of the unit ahead [rad]."""
        p = self._parameters
        if place.articulation is not None:
            # Upright on the plane under the tractor.
            straight = [(0.0, 0.0, 0.0)] * len(p.couplings)
            return [(-place.articulation, 0.0, 0.0), *straight[1:]] if straight else []
        angles = []
        origin, station, height = front, place.station, 0.0
        for coupling, reach in zip(p.couplings, self._reaches, strict=True):
            station = station - coupling.position
            lever = np.array([-coupling.position, 0.0, coupling.height - height])
            origin, height = origin + rotation @ lever, coupling.height
            bogie_station = station - reach
            bogie = self._point(bogie_station, place.offset)
            across = self._across(bogie_station)
            # The unit's x axis is at the coupling's height above the road, also at the bogie.
            ahead, behind = (self._point(bogie_station + d, place.offset) for d in (1.0, -1.0))
            bogie = bogie + _frame(ahead - behind, across)[:, 2] * height
            own = _frame(origin - bogie, across)
            relative = rotation.T @ own
            angles.append(
                (
                    math.atan2(relative[1, 0], relative[0, 0]),
                    -math.asin(relative[2, 0]),
                    math.atan2(relative[2, 1], relative[2, 2]),
                )
            )
            rotation = own
        return angles

    def _point(self, station: float, offset: float) -> FloatArray:
        point = self._route.evaluate(station, offset)
        z = float(point.z)
        if self._route.unevenness:
            tracks = (offset - _TRACK, offset + _TRACK)
            z += 0.5 * sum(self._route.unevenness.height(station, track) for track in tracks)
        return np.array([float(point.x), float(point.y), z])

    def _across(self, station: float) -> FloatArray:
        """Unit vector to the left across the road."""
        point = self._route.evaluate(station, 0.0)
        heading, tilt = float(point.heading), float(point.superelevation)
        level = math.cos(tilt)
        return np.array([-math.sin(heading) * level, math.cos(heading) * level, math.sin(tilt)])


def _frame(forward: FloatArray, left: FloatArray) -> FloatArray:
    """Rotation matrix whose x is `forward` and whose y is as near to `left` as possible."""
    x = forward / np.linalg.norm(forward)
    z = np.cross(x, left)
    z /= np.linalg.norm(z)
    return np.column_stack([x, np.cross(z, x), z])


def _yaw(angle: float) -> FloatArray:
    """Rotation about z."""
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
