"""The ego truck inside SUMO: its pose, its whole length, and the second lane it may stand in."""

from __future__ import annotations

import math

from iits_mj.errors import InputError
from iits_mj.messages import EgoFootprint, EgoState
from iits_mj.road import Route
from traffic_bridge.modes.placed import EGO_TYPE, PlacedVehicle
from traffic_bridge.modes.smoothing import Box
from traffic_bridge.network.lanes import RouteLanes
from traffic_bridge.session import Session

EGO = "ego"
SHADOW = "shadow"
# The truck counts as being in a second lane as well from this overlap on [m].
OVERLAP = 0.3


def check_ego(ego: EgoState) -> None:
    """Refuses an ego state with values that are not finite.

    Raises:
      InputError: names the field.
    """
    for name in ("x", "y", "yaw", "speed", "station", "offset", "trailer_offset"):
        if not math.isfinite(getattr(ego, name)):
            raise InputError(f"ego.{name} = {getattr(ego, name)!r}: must be finite")


def ego_type_xml(footprint: EgoFootprint) -> str:
    """The ego's `vType`: SUMO needs its size only, the truck drives itself."""
    return (
        f'<vType id="{EGO_TYPE}" length="{footprint.length}" width="{footprint.width}" '
        'minGap="2.5" maxSpeed="40" carFollowModel="IDM" accel="1" decel="4" emergencyDecel="6" '
        'speedFactor="1" speedDev="0"/>'
    )


class EgoInTraffic:
    """Places the truck in SUMO every step.

    Args:
      session: the running SUMO.
      lanes: of the route.
      route: the ego's road.
      footprint: size of the combination.
      step: length of a step [s].

    SUMO's lane-based world knows one lane per vehicle. While the truck straddles two lanes, in a
    lane change or with its trailer still in the old lane, a second vehicle of the same length (the
    shadow) stands in the other lane beside it, so that nobody there drives into its side.
    """

    def __init__(
        self,
        session: Session,
        lanes: RouteLanes,
        route: Route,
        footprint: EgoFootprint,
        step: float,
    ) -> None:
        self._session = session
        self._api = session.api
        self._lanes = lanes
        self._route = route
        self._footprint = footprint
        self._step = step
        self._truck: PlacedVehicle | None = None
        self._shadow: PlacedVehicle | None = None
        self._shadows = 0

    def front(self, ego: EgoState) -> tuple[float, float, float, float]:
        """Front bumper: x, y [m], station, offset [m]."""
        reach = self._footprint.front_overhang
        x = ego.x + reach * math.cos(ego.yaw)
        y = ego.y + reach * math.sin(ego.yaw)
        return x, y, *self._route.locate(x, y, ego.station + reach)

    def boxes(self, ego: EgoState) -> tuple[Box, Box]:
        """Where the truck is on the road: with the tractor's offset and with the trailer's."""
        size = self._footprint
        middle = ego.station + size.front_overhang - 0.5 * size.length
        return (
            Box(middle, ego.offset, ego.speed, size.length, size.width),
            Box(middle, ego.trailer_offset, ego.speed, size.length, size.width),
        )

    def place(self, ego: EgoState) -> None:
        """Moves the truck (and its shadow) to where it is at the end of the coming step."""
        x, y, station, offset = self.front(ego)
        lane = self._route.lane_at(station, offset)
        with self._session.guard("placing the ego truck"):
            if station >= self._route.length - 1.0:
                # SUMO would let it arrive and forget it.
                self._remove()
                return
            if self._truck is None:
                self._truck = PlacedVehicle(self._session, self._lanes, EGO, self._step)
            self._put(self._truck, ego, station, offset, lane, (x, y))
            self._place_shadow(ego, station, lane)

    def _put(
        self,
        placed: PlacedVehicle,
        ego: EgoState,
        station: float,
        offset: float,
        lane: int,
        point: tuple[float, float],
    ) -> None:
        speed = max(ego.speed, 0.0)
        if lane >= 0:
            table = self._lanes.covering(lane, station) or self._lanes.find(lane, station)
            if table is not None:
                position = table.position_of(station)
                placed.put(table, position, offset - table.at(position)[1], speed)
                return
        placed.move(*self._lanes.to_sumo(*point), ego.yaw, speed)

    def _place_shadow(self, ego: EgoState, station: float, lane: int) -> None:
        second = self._second_lane(ego, station, lane)
        if second < 0:
            self._remove_shadow()
            return
        if self._shadow is None:
            name = f"{SHADOW}.{self._shadows}"
            self._shadows += 1
            self._shadow = PlacedVehicle(self._session, self._lanes, name, self._step)
        offset = float(self._route.lane_offset(second, station))
        point = self._route.evaluate(station, offset)
        self._put(self._shadow, ego, station, offset, second, (float(point.x), float(point.y)))

    def _second_lane(self, ego: EgoState, station: float, lane: int) -> int:
        """The lane other than the ego's that tractor or trailer reaches into, -1 for none."""
        half = 0.5 * self._footprint.width - OVERLAP
        offsets = (ego.offset, ego.trailer_offset)
        for edge in (max(offsets) + half, min(offsets) - half):
            other = self._route.lane_at(station, edge)
            if other not in (-1, lane) and self._lanes.find(other, station) is not None:
                return other
        return -1

    def _remove_shadow(self) -> None:
        if self._shadow is not None:
            self._shadow.remove()
            self._shadow = None

    def _remove(self) -> None:
        self._remove_shadow()
        if self._truck is not None:
            self._truck.remove()
            self._truck = None
