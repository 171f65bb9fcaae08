"""What the traffic lights of a map show, by OpenDRIVE's signals, on and off the route."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import partial

from iits_mj.road.elements import PEDESTRIAN_LIGHT, Road
from traffic_bridge.network.light_programs import NEAR, SUBTYPES
from traffic_bridge.network.net_file import NetConnection, NetFile
from traffic_bridge.network.route_lanes import RouteLanes
from traffic_bridge.session import Session

CLOSED = "rR"  # SUMO's letters of red


class SignalLamps:
    """The letters of the map's traffic lights in a running simulation.

    A signal shows the letter of its link. Of several links it is the one of the signal's own turn
    (its subtype), or else of the way straight on. A light for pedestrians is green while all links
    of its road are red.
    """

    def __init__(self, session: Session, lanes: RouteLanes) -> None:
        self._state = session.api.trafficlight.getRedYellowGreenState
        self._guard = partial(session.guard, "reading the traffic lights")
        roads = lanes.route.road_map.roads
        self._kinds = {
            signal.id: (signal.kind, signal.subtype)
            for road in roads.values()
            for signal in road.signals
            if signal.dynamic
        }
        # The lights, and the links of each signal: place of its light, number of the letter.
        self._lights = [light.id for light in lanes.net.lights]
        self._links = _links(lanes.net, roads, self._kinds)
        self._states: tuple[str, ...] = ()
        self._shown: tuple[tuple[str, str], ...] = ()

    def letters(self) -> tuple[tuple[str, str], ...]:
        """Id of each signal and its letter, see `LightPhase`; the same object if none changed."""
        if not self._links:
            return ()
        with self._guard():
            states = tuple(self._state(light) for light in self._lights)
        if states != self._states:
            self._states = states
            self._shown = tuple(
                (name, self._letter(name, [states[light][link] for light, link in links]))
                for name, links in self._links.items()
            )
        return self._shown

    def _letter(self, signal: str, letters: list[str]) -> str:
        if self._kinds[signal][0] != PEDESTRIAN_LIGHT:
            return letters[0]
        return "G" if all(letter in CLOSED for letter in letters) else "r"


def _links(
    net: NetFile, roads: Mapping[str, Road], kinds: dict[str, tuple[str, str]]
) -> dict[str, tuple[tuple[int, int], ...]]:
    """Light and link of each signal, the link that it shows first."""
    named = {
        (light.id, link): signals for light in net.lights for link, signals in light.signals.items()
    }
    known = {signal for signals in named.values() for signal in signals}
    places = {light.id: place for place, light in enumerate(net.lights)}
    found: dict[str, list[tuple[tuple[bool, bool], int, int]]] = {}
    for link in net.connections:
        if link.light not in places or link.start.startswith(":"):
            continue
        signals = named.get((link.light, link.link), ())
        for name in (*signals, *(one for one in _beside(net, link, roads) if one not in known)):
            if name in kinds:
                other = SUBTYPES.get(link.turn) != kinds[name][1]
                way = ((other, link.turn != "s"), places[link.light], link.link)
                found.setdefault(name, []).append(way)
    return {name: tuple((p, k) for _, p, k in sorted(ways)) for name, ways in found.items()}


def _beside(net: NetFile, link: NetConnection, roads: Mapping[str, Road]) -> list[str]:
    """Signals that face the vehicles before a link, and stand near the end of their lane."""
    lane = net.lanes[link.start]
    road = roads.get(lane.origin[0]) if lane.origin is not None else None
    if road is None or lane.origin is None:
        return []
    facing = ("+", "none") if road.travel(lane.origin[1]) > 0 else ("-", "none")
    found = []
    for signal in road.signals:
        point = road.plan.evaluate(signal.s)
        away = lane.shape[-1] - net.offset - (float(point.x), float(point.y))
        if signal.orientation in facing and math.hypot(*away) < NEAR:
            found.append(signal.id)
    return found
