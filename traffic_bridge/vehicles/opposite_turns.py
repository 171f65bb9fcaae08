"""Turns of long vehicles that need the ground of other turns, or of the lanes before a junction.

SUMO lets two vehicles turn left past each other, because the centers of their lanes do not cross,
and a vehicle turn left past one that turns right out of the road into which it turns. The rear of a
long vehicle, or the front that swings out, cuts into the other turn. So the second of the two waits
at its stop line until the first has left the junction.

A long vehicle also sweeps the ends of other lanes, for which `stop_lines` sets their lines back. A
vehicle does not pass such a line while the turn is under way. The truck itself is never held.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable
from dataclasses import dataclass
from functools import partial

from traffic_bridge.network.net_file import NetConnection, NetFile, NetLane
from traffic_bridge.network.stop_lines import TURNS, junction_links, meets, swept_lanes
from traffic_bridge.session import Session

LEFT = {"l", "L"}  # SUMO's letters of left turns
LONG = 8.0  # [m]: vehicles from this length on need the ground of another turn
BRAKING = 2.0  # [m/s2] to the stop line
REACHES = 25.0  # [m] before a stop line in which a vehicle is looked at
COMMITTED = 0.5  # [m]: a vehicle this near to its line, or past it, has begun its turn
SETS_OFF = 0.3  # [m/s]: a slower vehicle before its line waits there
STOPS = 3.0  # [m/s2]: a vehicle that would have to brake harder at a swept lane passes its line
TRUCK_NEAR = 12.0  # [m] before its line, where the truck begins its turn unless its light is red


@dataclass(frozen=True, slots=True)
class _Begun:
    """A turn under way: its connection, and whether the vehicle is long."""

    link: int
    long: bool


class OppositeTurns:
    """Holds vehicles before turns that another vehicle's turn needs.

    Args:
      session: the running SUMO.
      net: of the map.
      ego: name of the truck in SUMO.
    """

    def __init__(self, session: Session, net: NetFile, ego: str) -> None:
        self._ego = ego
        self._links: list[NetConnection] = []
        self._against: list[set[int]] = []
        self._swept: list[set[str]] = []
        self._number: dict[tuple[str, str], int] = {}
        for links in junction_links(net).values():
            turns = [link for link in links if link.turn in TURNS]
            pairs = [
                (a, b)
                for a, b in itertools.combinations(turns, 2)
                if _edge(a.start) != _edge(b.start)
                and _edge(a.end) != _edge(b.end)
                and {a.turn, b.turn} & LEFT
                and meets(net, a, b)
            ]
            for pair in pairs:
                first, second = (self._add(link) for link in pair)
                self._against[first].add(second)
                self._against[second].add(first)
            lanes = [net.lanes[name] for name in sorted({link.start for link in links})]
            for link in turns:
                if swept := swept_lanes(net, link, lanes):
                    self._swept[self._add(link)] |= swept.keys()
        # The lanes before these turns and those that they sweep, with the positions of their lines.
        self._approaches: list[tuple[NetLane, float]] = []
        for name in sorted({link.start for link in self._links}.union(*self._swept)):
            lane = net.lanes[name]
            self._approaches.append((lane, lane.length - lane.stop_offset))
        self._begun: dict[str, _Begun] = {}
        read = partial(session.function, "vehicle")
        self._ids = session.function("lane", "getLastStepVehicleIDs")
        self._lane, self._position = read("getLaneID"), read("getLanePosition")
        self._speed, self._length = read("getSpeed"), read("getLength")
        self._lines = {lane.id: line for lane, line in self._approaches}
        self._route, self._index = session.api.vehicle.getRoute, session.api.vehicle.getRouteIndex
        self._states = session.api.trafficlight.getRedYellowGreenState
        self._there = session.api.vehicle.getIDList

    def held(self) -> dict[str, float]:
        """Speed limits of the vehicles that wait, by name [m/s]; call it once a step."""
        if not self._approaches:
            return {}
        self._forget_ended()
        found: dict[str, float] = {}
        arriving = []
        for lane, line in self._approaches:
            ids = self._ids(lane.id)
            for name in reversed(ids):
                left = line - self._position(name)
                if left > REACHES:
                    break
                if name not in self._begun:
                    arriving.append((left, name, lane))
        for left, name, lane in sorted(arriving, key=lambda item: item[:2]):
            speed = float(self._speed(name))
            if name != self._ego and self._is_swept(lane.id, left, speed):
                found[name] = math.sqrt(2.0 * BRAKING * max(left - COMMITTED, 0.0))
                continue
            link = self._link_of(name, lane)
            if link is None:
                continue
            long = name == self._ego or float(self._length(name)) >= LONG
            if name == self._ego:
                begins = left < COMMITTED or (left < TRUCK_NEAR and self._is_open(link))
            elif self._is_taken(link, long):
                found[name] = math.sqrt(2.0 * BRAKING * max(left - COMMITTED, 0.0))
                continue
            else:
                begins = left < COMMITTED + speed**2 / (2.0 * BRAKING) and speed > SETS_OFF
            if begins:
                self._begun[name] = _Begun(link, long)
        return found

    def _add(self, link: NetConnection) -> int:
        key = link.start, _edge(link.end)
        if key not in self._number:
            self._number[key] = len(self._links)
            self._links.append(link)
            self._against.append(set())
            self._swept.append(set())
        return self._number[key]

    def _link_of(self, name: str, lane: NetLane) -> int | None:
        """Number of the turn that a vehicle on a lane will make, None for another way."""
        route, index = self._route(name), self._index(name)
        following = route[index + 1] if index + 1 < len(route) else ""
        return self._number.get((lane.id, following))

    def _is_open(self, link: int) -> bool:
        """Whether no light keeps vehicles from a turn."""
        light = self._links[link].light
        return not light or self._states(light)[self._links[link].link] in "gGoO"

    def _is_taken(self, link: int, long: bool) -> bool:
        """Whether a turn under way needs the ground of another one."""
        return any(
            other.link in self._against[link] and (long or other.long)
            for other in self._begun.values()
        )

    def _is_swept(self, lane: str, left: float, speed: float) -> bool:
        """Whether a vehicle before its line can stop for a turn under way that sweeps its lane."""
        stops = speed < SETS_OFF or speed**2 < 2.0 * STOPS * left
        return (
            left > -COMMITTED
            and stops
            and any(
                other.long and lane in self._swept[other.link] and self._is_inside(name, other)
                for name, other in self._begun.items()
            )
        )

    def _is_inside(self, name: str, begun: _Begun) -> bool:
        """Whether a vehicle has passed the line before its turn."""
        start = self._links[begun.link].start
        return bool(self._lane(name) != start or self._position(name) > self._lines[start])

    def _forget_ended(self) -> None:
        """Drops the turns whose vehicles have left the junction with their rear."""
        if not self._begun:
            return
        there = set(self._there())
        for name, begun in list(self._begun.items()):
            if name not in there:
                del self._begun[name]
                continue
            lane = str(self._lane(name))
            if lane.startswith(":") or not lane:
                continue
            position = float(self._position(name))
            if lane == self._links[begun.link].start:
                # It waits at its line after all.
                ended = position < self._lines[lane] + COMMITTED and self._speed(name) < SETS_OFF
                ended = ended and not (name == self._ego and self._is_open(begun.link))
            else:
                ended = position > float(self._length(name))
            if ended:
                del self._begun[name]


def merged(*limits: Iterable[tuple[str, float]]) -> dict[str, float]:
    """The least of several speed limits of each vehicle [m/s]."""
    found: dict[str, float] = {}
    for name, limit in itertools.chain(*limits):
        found[name] = min(limit, found.get(name, limit))
    return found


def _edge(lane: str) -> str:
    return lane.rpartition("_")[0]
