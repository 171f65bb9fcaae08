"""Pedestrians that SUMO simulates: they walk along sidewalks and cross the road at crossings.

Each crossing has a Poisson flow of persons. A person begins on a sidewalk near the crossing, walks
over it, and leaves on a sidewalk of the other side. SUMO's model of pedestrians ("striping")
decides when a person steps onto the road: at lights with green, elsewhere by the junction's right
of way.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from iits_mj.core.angles import wrap_angle
from iits_mj.core.errors import InputError
from iits_mj.core.messages import EgoFootprint, EgoState, TrackedVehicle
from iits_mj.core.vehicles import VehicleFrame
from iits_mj.road.reference_line import RoadPoint
from traffic_bridge.config import TrafficConfig
from traffic_bridge.mirror.articulation import Articulation
from traffic_bridge.network.route_lanes import RouteLanes
from traffic_bridge.network.walkways import read_crossings
from traffic_bridge.scenario.actors import beside_road, size_of
from traffic_bridge.session import Session
from traffic_bridge.vehicles.types import VehicleType, road_user_types

KIND = "pedestrian"
# Speed of walking: mean, standard deviation and bounds at two of them [m/s], from U. Weidmann,
# Transporttechnik der Fussgaenger, ETH Zurich, 1993.
SPEED_MEAN, SPEED_DEVIATION, SPEED_BOUNDS = 1.34, 0.26, (0.82, 1.86)
WALK = (8.0, 25.0)  # [m] from the crossing where a walk begins and ends
# SUMO's persons jump by some meters in walking areas; their bodies follow at this speed [m/s].
FASTEST_BODY = 2.5
# Distances [m]. A person who stands keeps at least `AWAY` from the truck's sides, and from the
# ground beside its front, as far as `AHEAD` of it. A person who walks keeps at least `CLOSE` from
# the sides.
AWAY, AHEAD, CLOSE = 2.0, 2.0, 0.9
MOVES = 0.2  # [m/s]: a faster body looks where it goes
STREAM = 1609  # separates the generator of pedestrians from that of vehicles with the same seed
_SECONDS = 3600.0  # of an hour


def pedestrian_type() -> VehicleType:
    """Size and look of a pedestrian."""
    return next(kind for kind in road_user_types() if kind.name == KIND)


def pedestrian_type_xml() -> str:
    """The `vType` element of pedestrians."""
    kind = pedestrian_type()
    return (
        f'<vType id="{KIND}" vClass="{KIND}" length="{kind.length}" width="{kind.width}" '
        f'height="{kind.height}" maxSpeed="{SPEED_BOUNDS[1]}" speedFactor="1" speedDev="0"/>'
    )


class Pedestrians:
    """The pedestrians of one running SUMO simulation.

    Args:
      session: with a net that has walkways.
      lanes: of the truck's route.
      config: settings.
      seed: of arrivals, sides and speeds.

    Raises:
      InputError: no crossing of the map joins two sidewalks.
    """

    def __init__(
        self, session: Session, lanes: RouteLanes, config: TrafficConfig, seed: int
    ) -> None:
        self._person, self._route, self._net = session.api.person, lanes.route, lanes.net
        road_map = lanes.route.road_map
        self._crossings = read_crossings(lanes.net.path, road_map.roads)
        if not self._crossings:
            raise InputError(f"pedestrians need crossings: {road_map.name} has none")
        self._chance = config.pedestrians / _SECONDS * config.step_length
        self._range = config.view_range
        self._rng = np.random.default_rng([seed, STREAM])
        self._size = size_of(pedestrian_type())
        self._count = 0
        self._step, self._footprint = config.step_length, config.footprint
        # Place and heading of each body in view, and its station.
        self._bodies: dict[str, tuple[float, float, float, float]] = {}

    def spawn(self) -> None:
        """Adds the persons who arrive in one step."""
        draws = self._rng.random(len(self._crossings))
        for number in np.flatnonzero(draws < self._chance).tolist():
            sides = self._crossings[number].sides
            first = int(self._rng.integers(2))
            begin, end = (
                side[int(self._rng.integers(len(side)))]
                for side in (sides[first], sides[1 - first])
            )
            start, goal = (one.place(self._rng.uniform(*WALK)) for one in (begin, end))
            speed = float(np.clip(self._rng.normal(SPEED_MEAN, SPEED_DEVIATION), *SPEED_BOUNDS))
            name = f"{KIND}.{self._count:05d}"
            self._count += 1
            self._person.add(name, begin.edge, start, typeID=KIND)
            self._person.appendWalkingStage(name, [begin.edge, end.edge], goal)
            self._person.setSpeed(name, speed)

    def frame(self, ego: EgoState | None, reacts: bool) -> VehicleFrame:
        """The persons within view of the truck, or all without a truck.

        Args:
          ego: the truck.
          reacts: nobody walks into the truck's sides, and persons who stand step back from them.
        """
        units = _units(ego, self._footprint) if reacts and ego is not None else ()
        rows = list(self._rows(ego, units))
        self._bodies = {row.id: (row.x, row.y, row.yaw, row.station) for row in rows}
        return VehicleFrame.of(rows)

    def _rows(self, ego: EgoState | None, units: Sequence[_Unit]) -> Iterator[TrackedVehicle]:
        person, (left, low) = self._person, self._net.offset
        for name in sorted(person.getIDList()):
            x, y, z = person.getPosition3D(name)
            x, y = x - left, y - low
            if not math.isfinite(x + y):
                continue  # it has not departed
            if ego is not None and math.hypot(x - ego.x, y - ego.y) > self._range:
                continue
            heading = math.radians(90.0 - person.getAngle(name))
            before, speed, near = self._bodies.get(name), 0.0, None
            if before is not None:
                stands = person.getSpeed(name) < MOVES
                for unit in units:
                    x, y = unit.leave(before, x, y, stands)
                dx, dy, near = x - before[0], y - before[1], before[3]
                away = math.hypot(dx, dy)
                speed = min(away / self._step, FASTEST_BODY)
                share = speed * self._step / away if away > 0.0 else 0.0
                x, y = before[0] + share * dx, before[1] + share * dy
                heading = math.atan2(dy, dx) if speed > MOVES else before[2]
            point = RoadPoint(x, y, z, wrap_angle(heading), 0.0, 0.0, 0.0)  # type: ignore[arg-type]
            yield beside_road(self._route, name, point, 0.0, near, speed=speed, **self._size)


@dataclass(frozen=True)
class _Unit:
    """A unit of the truck from above: middle of its front edge, heading, length, half width."""

    x: float
    y: float
    yaw: float
    length: float
    half_width: float

    def place(self, x: float, y: float) -> tuple[float, float]:
        """Distances of a point ahead of the front edge and to the left of the middle [m]."""
        dx, dy, c, s = x - self.x, y - self.y, math.cos(self.yaw), math.sin(self.yaw)
        return c * dx + s * dy, c * dy - s * dx

    def leave(
        self, body: tuple[float, ...], x: float, y: float, stands: bool
    ) -> tuple[float, float]:
        """The place to which a person at a place goes beside the unit, instead of into it."""
        ahead, left = self.place(x, y)
        if not -self.length - AWAY < ahead < (AHEAD if stands else 0.0):
            return x, y
        side = math.copysign(1.0, self.place(*body[:2])[1])
        lacking = self.half_width + (AWAY if stands else CLOSE) - side * left
        if lacking <= 0.0:
            return x, y
        return x - side * lacking * math.sin(self.yaw), y + side * lacking * math.cos(self.yaw)


def _units(ego: EgoState, footprint: EgoFootprint) -> tuple[_Unit, _Unit]:
    """The motor vehicle and what it tows, which bends at a kingpin as of a usual combination."""
    half, kingpin = 0.5 * footprint.width, Articulation.of_length(footprint.length).kingpin
    first = 0.5 * footprint.length - kingpin  # from the front bumper to the kingpin
    reach, yaw = footprint.front_overhang, ego.yaw - ego.articulation
    x, y = ego.x + reach * math.cos(ego.yaw), ego.y + reach * math.sin(ego.yaw)
    bend_x, bend_y = x - first * math.cos(ego.yaw), y - first * math.sin(ego.yaw)
    return (
        _Unit(x, y, ego.yaw, first, half),
        _Unit(bend_x, bend_y, yaw, footprint.length - first, half),
    )
