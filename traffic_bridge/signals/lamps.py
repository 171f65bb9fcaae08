"""What the traffic lights of a map show, by OpenDRIVE's signals, on and off the route."""

from __future__ import annotations

from functools import partial

from iits_mj.road.elements import PEDESTRIAN_LIGHT
from traffic_bridge.network.light_programs import SUBTYPES
from traffic_bridge.network.net_file import NetFile
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
        self._lights = [light.id for light in lanes.net.lights if light.signals]
        self._links = _links(lanes.net, self._kinds)
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
    net: NetFile, kinds: dict[str, tuple[str, str]]
) -> dict[str, tuple[tuple[int, int], ...]]:
    """Light and link of each signal, the link that it shows first."""
    turns = {(link.light, link.link): link.turn for link in net.connections if link.light}
    found: dict[str, list[tuple[tuple[bool, bool], int, int]]] = {}
    for place, light in enumerate(light for light in net.lights if light.signals):
        for link, signals in sorted(light.signals.items()):
            turn = turns.get((light.id, link), "")
            for name in signals:
                if name in kinds and link < len(light.phases[0][1]):
                    own = SUBTYPES.get(turn) == kinds[name][1]
                    found.setdefault(name, []).append(((not own, turn != "s"), place, link))
    return {name: tuple((p, k) for _, p, k in sorted(ways)) for name, ways in found.items()}
