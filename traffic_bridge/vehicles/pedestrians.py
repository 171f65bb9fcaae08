"""Pedestrians that SUMO simulates: they walk along sidewalks and cross the road at crossings.

Each crossing has a Poisson flow of persons. A person begins on a sidewalk near the crossing, walks
over it, and leaves on a sidewalk of the other side. SUMO's model of pedestrians ("striping")
decides when a person steps onto the road: at lights with green, elsewhere by the junction's right
of way.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from iits_mj.core.angles import wrap_angle
from iits_mj.core.boxes import UnitBox, UnitShape, unit_boxes
from iits_mj.core.errors import InputError
from iits_mj.core.messages import EgoState, TrackedVehicle
from iits_mj.core.vehicles import VehicleFrame
from iits_mj.road.reference_line import RoadPoint
from traffic_bridge.config import TrafficConfig
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
# Least distances between a person and the truck [m]. A standing person keeps `AWAY` from both sides
# of the truck, and from their extensions, which end `AHEAD` of its front. A walking person keeps
# `CLOSE` from its sides and its front.
AWAY, AHEAD, CLOSE = 2.0, 2.0, 0.9
# In the angle between two units a person needs both sides' distances: each pass halves the error.
PASSES = 4
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
        self._reach = config.step_length * FASTEST_BODY
        self._step, size = config.step_length, config.footprint
        rear = size.length - size.front_overhang
        self._shapes = config.units or (UnitShape(0.0, size.front_overhang, rear, size.width),)
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
          reacts: nobody walks into the truck, and persons who stand step back from its sides.
        """
        units: list[UnitBox] = []
        if reacts and ego is not None:
            articulations = (ego.articulation, *ego.rear_articulations)
            units = unit_boxes(ego.x, ego.y, ego.yaw, articulations, self._shapes)
        rows = list(self._rows(ego, units))
        self._bodies = {row.id: (row.x, row.y, row.yaw, row.station) for row in rows}
        return VehicleFrame.of(rows)

    def _rows(self, ego: EgoState | None, units: Sequence[UnitBox]) -> Iterator[TrackedVehicle]:
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
                x, y = toward(before, (x, y), self._reach)
                if units:
                    stands = person.getSpeed(name) < MOVES
                    x, y = toward(before, kept_off(units, before, (x, y), stands), self._reach)
                dx, dy, near = x - before[0], y - before[1], before[3]
                speed = math.hypot(dx, dy) / self._step
                heading = math.atan2(dy, dx) if speed > MOVES else before[2]
            point = RoadPoint(x, y, z, wrap_angle(heading), 0.0, 0.0, 0.0)  # type: ignore[arg-type]
            yield beside_road(self._route, name, point, 0.0, near, speed=speed, **self._size)


def toward(
    body: tuple[float, ...], place: tuple[float, float], reach: float
) -> tuple[float, float]:
    """Returns the point on the way from a body to a place that it reaches with a step [m]."""
    dx, dy = place[0] - body[0], place[1] - body[1]
    share = reach / max(math.hypot(dx, dy), reach)
    return body[0] + share * dx, body[1] + share * dy


def kept_off(
    units: Sequence[UnitBox],
    body: tuple[float, ...],
    place: tuple[float, float],
    stands: bool,
) -> tuple[float, float]:
    """Returns where a person goes who wants to go to a place: beside the truck, not into it.

    Args:
      units: of the truck.
      body: where the person is, x and y first [m].
      place: where the person wants to go, x and y [m].
      stands: the person does not want to go anywhere.
    """
    lead, here = units[0], body[:2]
    (before, aside), (ahead, left) = lead.place(*here), lead.place(*place)
    in_front = before - lead.ahead > max(abs(aside) - 0.5 * lead.width, 0.0)
    stop = min(before, lead.ahead + CLOSE)
    if in_front and ahead < stop and abs(left) < 0.5 * lead.width + CLOSE:
        place = lead.moved(*place, stop - ahead, 0.0)
    nearest = min(units, key=lambda unit: _nearness(unit, *here))
    side = math.copysign(1.0, nearest.place(*here)[1])
    away, reach = (AWAY, AHEAD) if stands else (CLOSE, -math.inf if in_front else CLOSE)
    for _ in range(PASSES):
        for unit in units:
            ahead, left = unit.place(*place)
            lacking = 0.5 * unit.width + away - side * left
            front = unit.ahead + (reach if unit is lead else away)
            if 0.0 < lacking < unit.width + 2.0 * away and -unit.behind - away < ahead < front:
                place = unit.moved(*place, 0.0, side * lacking)
    return place


def _nearness(unit: UnitBox, x: float, y: float) -> tuple[bool, float]:
    """Whether a point is not beside a unit, and a lower bound of its distance from it [m]."""
    ahead, left = unit.place(x, y)
    beside, along = abs(left) - 0.5 * unit.width, max(ahead - unit.ahead, -unit.behind - ahead)
    return beside < 0.0 or along > 0.0, max(beside, along)
