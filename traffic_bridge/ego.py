"""The ego truck inside SUMO: its pose, its whole length, and the second lane it may stand in."""

from __future__ import annotations

import math

from iits_mj.errors import InputError
from iits_mj.messages import EgoFootprint, EgoState
from iits_mj.road import Route
from traffic_bridge.lanes import LaneTable, RouteLanes
from traffic_bridge.session import Session

EGO = "ego"
SHADOW = "shadow"
# The truck counts as being in a second lane as well from this overlap on [m].
OVERLAP = 0.3
# moveToXY: 2 keeps the exact pose, 0 and 1 would snap it to the lane's centre.
EXACT_POSE = 2
MATCH_RADIUS = 30.0  # [m] in which SUMO looks for the truck's lane; its default of 100 costs more


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
        f'<vType id="{EGO}" length="{footprint.length}" width="{footprint.width}" minGap="2.5" '
        'maxSpeed="40" carFollowModel="IDM" accel="1" decel="4" emergencyDecel="6" '
        'speedFactor="1" speedDev="0"/>'
    )


class EgoInTraffic:
    """Places the truck in SUMO every step.

    SUMO's lane-based world knows one lane per vehicle. While the truck straddles two lanes, in a
    lane change or with its trailer still in the old lane, a second vehicle of the same length (the
    shadow) stands in the other lane beside it, so that nobody there drives into its side.
    """

    def __init__(
        self, session: Session, lanes: RouteLanes, route: Route, footprint: EgoFootprint
    ) -> None:
        self._session = session
        self._api = session.api
        self._lanes = lanes
        self._route = route
        self._footprint = footprint
        self._present = False
        self._shadow: str | None = None
        self._shadows = 0

    def front(self, ego: EgoState) -> tuple[float, float, float, float]:
        """Front bumper: x, y [m], station, offset [m]."""
        reach = self._footprint.front_overhang
        x = ego.x + reach * math.cos(ego.yaw)
        y = ego.y + reach * math.sin(ego.yaw)
        return x, y, *self._route.locate(x, y, ego.station)

    def place(self, ego: EgoState) -> None:
        """Moves the truck (and its shadow) to where it is at the end of the coming step."""
        x, y, station, offset = self.front(ego)
        lane = self._route.lane_at(station, offset)
        table = self._lanes.find(lane, station) if lane >= 0 else None
        with self._session.guard("placing the ego truck"):
            if station >= self._route.length - 1.0:
                # SUMO would let it arrive and forget it.
                self._remove()
                return
            if not self._present:
                self._add(EGO)
                self._present = True
            if table is None:
                x, y = self._lanes.to_sumo(x, y)
            else:
                x, y = self._in_lane(table, station, offset)
            self._move(EGO, x, y, ego.yaw, max(ego.speed, 0.0), table)
            self._place_shadow(ego, station, lane)

    def _place_shadow(self, ego: EgoState, station: float, lane: int) -> None:
        second = self._second_lane(ego, station, lane)
        if second is None:
            self._remove_shadow()
            return
        if self._shadow is None:
            self._shadow = f"{SHADOW}.{self._shadows}"
            self._shadows += 1
            self._add(self._shadow)
        center = second.at(second.position_of(station))[1]
        x, y = self._in_lane(second, station, center)
        yaw = float(self._route.evaluate(station).heading)
        self._move(self._shadow, x, y, yaw, max(ego.speed, 0.0), second)

    def _in_lane(self, table: LaneTable, station: float, offset: float) -> tuple[float, float]:
        """SUMO's coordinates of a point on a lane, by station: so the gaps to others are exact.

        SUMO maps positions to coordinates unevenly in bends (see `lanes`), by up to some metres.
        """
        position = table.position_of(station)
        x, y = table.point_at(position)
        side = offset - table.at(position)[1]
        heading = float(self._route.evaluate(station).heading)
        return x - side * math.sin(heading), y + side * math.cos(heading)

    def _second_lane(self, ego: EgoState, station: float, lane: int) -> LaneTable | None:
        """The lane other than the ego's that tractor or trailer reaches into."""
        half = 0.5 * self._footprint.width - OVERLAP
        offsets = (ego.offset, ego.trailer_offset)
        for edge in (max(offsets) + half, min(offsets) - half):
            other = self._route.lane_at(station, edge)
            if other not in (-1, lane):
                return self._lanes.find(other, station)
        return None

    def _add(self, name: str) -> None:
        self._api.vehicle.add(name, "along.0", typeID=EGO, departSpeed="0")
        self._api.vehicle.setSpeedMode(name, 0)
        self._api.vehicle.setLaneChangeMode(name, 0)

    def _move(
        self, name: str, x: float, y: float, yaw: float, speed: float, table: LaneTable | None
    ) -> None:
        edge, index = (table.edge, table.index) if table else ("", -1)
        angle = 90.0 - math.degrees(yaw)
        self._api.vehicle.moveToXY(name, edge, index, x, y, angle, EXACT_POSE, MATCH_RADIUS)
        self._api.vehicle.setSpeed(name, speed)

    def _remove_shadow(self) -> None:
        if self._shadow is not None:
            self._api.vehicle.remove(self._shadow)
            self._shadow = None

    def _remove(self) -> None:
        self._remove_shadow()
        if self._present:
            self._api.vehicle.remove(EGO)
            self._present = False
