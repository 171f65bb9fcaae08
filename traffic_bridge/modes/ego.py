"""The ego truck inside SUMO: its pose, its length, and the second lane that it may occupy."""

from __future__ import annotations

import math

import numpy as np

from iits_mj.core.errors import InputError
from iits_mj.core.messages import EgoFootprint, EgoState
from iits_mj.road import Route
from traffic_bridge.config import TrafficConfig
from traffic_bridge.modes.smoothing import Box
from traffic_bridge.modes.teleported_vehicle import (
    ALONG,
    EGO_TYPE,
    END,
    LaneOverlap,
    TeleportedVehicle,
)
from traffic_bridge.network.route_lanes import LaneTable, RouteLanes
from traffic_bridge.session import Session
from traffic_bridge.vehicles.ego_room import EGO_HEADWAY, LEVEL_HEADWAY, EgoRoom

EGO = "ego"
SHADOW = "shadow"
ASTRAY = 50.0  # [m] between the ego's (station, offset) and its (x, y), at most
AXIS_POINTS = 17  # along the combination
SHORTEST = 0.5  # [m]: with less than this length on the route, the truck is not in SUMO
AGAINST = "ego.against"  # SUMO's route along the oncoming lanes


def check_ego(ego: EgoState, route: Route | None = None) -> None:
    """Checks that an ego state is finite and consistent.

    Args:
      ego: the state.
      route: on which its station and offset must agree with its x and y; None: no comparison.

    Raises:
      InputError: names the field.
    """
    if not isinstance(ego, EgoState):
        raise InputError(f"ego = {ego!r}: must be an EgoState")
    for name in ("x", "y", "yaw", "speed", "station", "offset", "trailer_offset"):
        value = getattr(ego, name)
        try:
            finite = math.isfinite(value)
        except TypeError:
            raise InputError(f"ego.{name} = {value!r}: must be a number") from None
        if not finite:
            raise InputError(f"ego.{name} = {value!r}: must be finite")
    if route is None:
        return
    point = route.evaluate(ego.station, ego.offset)
    apart = math.hypot(ego.x - point.x, ego.y - point.y)
    if not apart <= ASTRAY:
        raise InputError(
            f"ego.station = {ego.station:g}, ego.offset = {ego.offset:g}: that point of the route "
            f"is {apart:.3g} m from ego.x = {ego.x:g}, ego.y = {ego.y:g}; at most {ASTRAY:g} m are "
            "allowed"
        )


def ego_type_xml(footprint: EgoFootprint) -> str:
    """The ego's `vType`; SUMO uses only its size, because the truck moves from outside."""
    return (
        f'<vType id="{EGO_TYPE}" length="{footprint.length}" width="{footprint.width}" '
        'minGap="2.5" maxSpeed="40" carFollowModel="IDM" accel="1" decel="4" emergencyDecel="6" '
        'speedFactor="1" speedDev="0"/>'
    )


class EgoInTraffic:
    """Moves the truck in SUMO in every step.

    In SUMO a vehicle has one lane. While the truck occupies two lanes, in a lane change or with its
    trailer still in the old lane, a second vehicle of the same length (the shadow) drives in the
    other lane beside it, so that no vehicle there hits its side. On an oncoming lane the shadow
    stands still, and oncoming vehicles stop before it.
    """

    def __init__(self, session: Session, lanes: RouteLanes, config: TrafficConfig) -> None:
        self._session = session
        self._api = session.api
        self._lanes = lanes
        self._route = lanes.route
        self._config = config
        self._footprint = config.footprint
        # The truck by its name, the shadows by their SUMO routes.
        self._teleported: dict[str, TeleportedVehicle] = {}
        self._overlap = LaneOverlap(lanes)
        self._has_way_against = False
        self._shadows = 0

    def front(self, ego: EgoState) -> tuple[float, float, float, float]:
        """Front bumper: x, y [m], station, offset [m]."""
        reach = self._footprint.front_overhang
        x = ego.x + reach * math.cos(ego.yaw)
        y = ego.y + reach * math.sin(ego.yaw)
        return x, y, *self._route.locate(x, y, ego.station + reach)

    def boxes(self, ego: EgoState) -> tuple[Box, Box]:
        """The truck's box on the road at the tractor's offset and at the trailer's."""
        size = self._footprint
        middle = ego.station + size.front_overhang - 0.5 * size.length
        return (
            Box(middle, ego.offset, ego.speed, size.length, size.width),
            Box(middle, ego.trailer_offset, ego.speed, size.length, size.width),
        )

    def room(self, ego: EgoState) -> EgoRoom:
        """The space that the truck needs when the road is populated."""
        steady = self._config.steady
        _, _, station, offset = self.front(ego)
        part = np.linspace(0.0, 1.0, AXIS_POINTS)
        offsets = ego.trailer_offset + part * (offset - ego.trailer_offset)
        points = self._route.evaluate(station + (part - 1.0) * self._footprint.length, offsets)
        return EgoRoom(
            station,
            self._route.lane_at(station, offset),
            ego.speed,
            np.stack((points.x, points.y), axis=1),
            self._footprint,
            self._config.speed_limit if steady is None else steady.speed,
            EGO_HEADWAY if steady is None else LEVEL_HEADWAY,
            beside=steady is not None,
        )

    def place(self, ego: EgoState) -> None:
        """Moves the truck and its shadows to their places at the end of the next step.

        SUMO removes vehicles at the end of their route. So the truck stays there, shortened to its
        part on the route, until its rear has passed the end.
        """
        x, y, station, offset = self.front(ego)
        length = self._footprint.length
        hidden = max(station - (self._route.length - END), 0.0)
        with self._session.guard("placing the ego truck"):
            if length - hidden < SHORTEST:
                for role in (EGO, ALONG, AGAINST):
                    self._drop(role)
                return
            if hidden > 0.0:
                station = self._route.length - END
                point = self._route.evaluate(station, offset)
                x, y = float(point.x), float(point.y)
            lane = self._route.lane_at(station, offset)
            truck = self._known(EGO)
            truck.cut(length, hidden)
            self._overlap.put(truck, lane, station, offset, (x, y), ego.yaw, ego.speed)
            edges = self._overlap.edges(self._footprint.width, (ego.offset, ego.trailer_offset))
            under = self._overlap.under(station, edges)
            self._place_shadow(ego, station, self._overlap.second(lane, station, under), hidden)
            against = self._overlap.opposite(station, edges, under)
            self._place_against(against, station - length + hidden, edges)

    def _place_shadow(self, ego: EgoState, station: float, second: int, hidden: float) -> None:
        """Puts the shadow into a second lane of the route, or removes it for -1."""
        if second < 0:
            self._drop(ALONG)
            return
        shadow = self._known(ALONG)
        shadow.cut(self._footprint.length, hidden)
        offset = float(self._route.lane_offset(second, station))
        point = self._route.evaluate(station, offset)
        place = float(point.x), float(point.y)
        self._overlap.put(shadow, second, station, offset, place, ego.yaw, ego.speed)

    def _place_against(
        self, table: LaneTable | None, rear: float, edges: tuple[float, float]
    ) -> None:
        """Puts a shadow into an oncoming lane, its front at the truck's rear; None removes it."""
        if table is None:
            self._drop(AGAINST)
            return
        if not self._has_way_against:
            self._api.route.add(AGAINST, list(self._lanes.oncoming_edges))
            self._has_way_against = True
        under = self._overlap.under(rear, edges)
        table = self._overlap.opposite(rear, edges, under) or table
        position = min(table.position_of(rear), table.length - END)
        self._known(AGAINST).put(table, max(position, 0.0), 0.0, 0.0)

    def _known(self, role: str) -> TeleportedVehicle:
        """The truck or a shadow, added to SUMO if it is missing."""
        if role not in self._teleported:
            name = role
            if role != EGO:
                name = f"{SHADOW}.{self._shadows}"
                self._shadows += 1
            way = AGAINST if role == AGAINST else ALONG
            self._teleported[role] = TeleportedVehicle(
                self._session, self._lanes, name, self._config.step_length, way=way
            )
        return self._teleported[role]

    def _drop(self, role: str) -> None:
        """Removes the truck or a shadow from SUMO."""
        if role in self._teleported:
            self._teleported.pop(role).remove()
