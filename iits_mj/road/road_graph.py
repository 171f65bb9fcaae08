"""Finds drivable chains of roads through links and junctions."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from iits_mj.core.angles import wrap_angle
from iits_mj.core.errors import MapError
from iits_mj.road.chain import CHAIN_LENGTH_LIMIT, GAP_LIMIT, SHIFT_LIMIT, LinkError, Node, apart
from iits_mj.road.elements import Junction, OpenDriveMap, Road, lane_borders
from iits_mj.road.seams import (
    HEADING_STEP_LIMIT,
    HEIGHT_STEP_LIMIT,
    heading_step,
    height_step,
)

SEARCH_BUDGET = 20_000
# A laden articulated truck neither turns on a smaller radius nor climbs a steeper grade; a route
# over such roads is taken only if the others are shorter than `LEAST_ROUTE` (judgement).
LEAST_RADIUS, STEEPEST = 6.0, 0.20  # [m], [1]
LEAST_ROUTE = 50.0  # [m]
WIDE_RADIUS = 30.0  # [m] of a reference line on which every lane is wide enough for a truck


class RoadEnd(NamedTuple):
    """Where a road is entered or left: position [m] and heading in travel [rad]."""

    x: float
    y: float
    z: float
    heading: float


class RoadGraph:
    """Successors of every road, in each direction of travel that has driving lanes.

    A node is (road id, direction): +1 along s, -1 against s.

    Attributes:
      roads: by id.
      nodes: all of them, in the order of the file.
      notes: links that are not driven, in words.
    """

    def __init__(self, content: OpenDriveMap, source: str) -> None:
        """`source` names the map in errors."""
        self.source = source
        self.roads = {road.id: road for road in content.roads}
        self._junctions = {junction.id: junction for junction in content.junctions}
        self.nodes: list[Node] = [
            (road.id, direction)
            for road in content.roads
            for direction in (1, -1)
            if road.has_lanes(direction)
        ]
        self.notes: list[str] = []
        self._closed: set[Node] = set()
        self._obstacles: dict[Node, str] = {}
        self._ends: dict[Node, tuple[RoadEnd, RoadEnd]] = {}
        known = set(self.nodes)
        self._next = {
            node: [
                follower
                for follower in self._followers(node)
                if follower in known and self._meets(node, follower)
            ]
            for node in self.nodes
        }

    def followers(self, node: Node) -> list[Node]:
        """Returns the successors of a node, the one that continues most lanes first."""
        if not self._closed:
            return self._next[node]
        return [follower for follower in self._next[node] if follower not in self._closed]

    def starts(self) -> list[Node]:
        """Returns the nodes where a chain can begin: without predecessor, and one per loop."""
        nodes = [node for node in self.nodes if node not in self._closed]
        reached = {follower for node in nodes for follower in self.followers(node)}
        starts = [node for node in nodes if node not in reached]
        covered = self._reachable(starts)
        for node in sorted(nodes, key=lambda n: self.roads[n[0]].junction is not None):
            if node not in covered:
                starts.append(node)
                covered |= self._reachable([node])
        return starts

    def cut(self, error: LinkError) -> None:
        """Drives a link no longer."""
        before, after = error.link
        self._next[before] = [node for node in self._next[before] if node != after]
        self._note(str(error).removeprefix(f"{self.source}: "))

    def chain(self, start: str | None = None) -> list[Node]:
        """Returns the longest chain, or the longest from `start`: "ID" (along s) or "ID:-1".

        Every road is driven at most once, so a closed loop gives one lap. The search is exhaustive
        on maps of some dozens of roads; on large ones it ends after a fixed number of steps. Roads
        that are too tight or too steep for a truck are avoided if another chain is long enough.

        Raises:
          MapError: no road has driving lanes, or there is no such start.
        """
        if not self.nodes:
            raise MapError(f"{self.source}: no road has driving lanes from its start to its end")
        best = self._longest(start)
        if any(self._obstacle(node) for node in best):
            first = {self._node(start)} if start is not None else set()
            self._closed = {node for node in self.nodes if self._obstacle(node)} - first
            easy = self._longest(start)
            self._closed = set()
            if sum(self.roads[identity].length for identity, _ in easy) >= LEAST_ROUTE:
                for node in best:
                    if (reason := self._obstacle(node)) and node not in easy:
                        self._note(reason)
                return easy
        if not best:
            raise MapError(f"{self.source}: no road is long enough to drive on")
        return best

    def _longest(self, start: str | None) -> list[Node]:
        starts = self.starts() if start is None else [self._node(start)]
        budget = max(200, SEARCH_BUDGET // max(len(starts), 1))
        best: list[Node] = []
        longest = 0.0
        for node in starts:
            chain, length = self._longest_from(node, budget)
            # The first of equal chains is kept, so that the result does not depend on rounding.
            if length > longest + 1e-6:
                best, longest = chain, length
        return best

    def _obstacle(self, node: Node) -> str:
        """The reason why a truck cannot drive along a road, or ""."""
        if node not in self._obstacles:
            road, direction = self.roads[node[0]], node[1]
            s = np.linspace(0.0, road.length, max(math.ceil(road.length / 2.0), 4) + 1)[1:-1]
            bend = direction * road.plan.evaluate(s).curvature
            # Only there the lane's place beside the reference line matters.
            sharp = np.abs(bend) > 1.0 / WIDE_RADIUS
            offset = [self._outermost(road, direction, float(each)) for each in s[sharp]]
            radius = np.abs(1.0 / bend[sharp] - np.array(offset))
            steep = float(np.abs(road.elevation.evaluate(s, 1)).max())
            reason = ""
            if (tightest := float(radius.min(initial=math.inf))) < LEAST_RADIUS:
                reason = (
                    f"road {road.id!r} bends with a radius of {tightest:.1f} m; a truck needs "
                    f"{LEAST_RADIUS:g} m"
                )
            elif steep > STEEPEST:
                reason = (
                    f"road {road.id!r} has a grade of {100.0 * steep:.0f} %; a truck drives "
                    f"{100.0 * STEEPEST:g} %"
                )
            self._obstacles[node] = reason
        return self._obstacles[node]

    @staticmethod
    def _outermost(road: Road, direction: int, s: float) -> float:
        """Offset of the outermost driving lane's center in travel [m]."""
        section = [each for start, _, each in road.section_spans() if start <= s][-1]
        side = road.side(direction)
        borders = lane_borders(road, section, side)
        lane = section.driving(side)[0].id
        inside = lane - 1 if lane > 0 else lane + 1
        return 0.5 * direction * (borders[lane].at(s) + borders[inside].at(s))

    def _node(self, start: str) -> Node:
        if (start, 1) in self._next:
            return start, 1
        identity, _, sign = start.rpartition(":")
        if sign in ("1", "+1", "-1") and (identity, int(sign)) in self._next:
            return identity, int(sign)
        if (start, -1) in self._next:
            return start, -1
        choices = ", ".join(f"{name}:{sign:+d}" for name, sign in self.nodes[:20])
        raise MapError(
            f"{self.source}: no chain of roads starts with {start!r}; there are {choices}"
        )

    def _longest_from(self, start: Node, budget: int) -> tuple[list[Node], float]:
        path = [start]
        visited = {start[0]}
        lengths = [self.roads[start[0]].length]
        pending = [iter(self.followers(start))]
        best, longest = list(path), lengths[-1]
        while pending and budget > 0:
            follower = next(pending[-1], None)
            if follower is None:
                pending.pop()
                lengths.pop()
                visited.discard(path.pop()[0])
                continue
            if follower[0] in visited:
                continue
            length = lengths[-1] + self.roads[follower[0]].length
            if length > CHAIN_LENGTH_LIMIT:
                continue
            budget -= 1
            path.append(follower)
            visited.add(follower[0])
            lengths.append(length)
            pending.append(iter(self.followers(follower)))
            if length > longest:
                best, longest = list(path), length
        return best, longest

    def _reachable(self, starts: list[Node]) -> set[Node]:
        found = set(starts)
        pending = list(starts)
        while pending:
            for follower in self.followers(pending.pop()):
                if follower not in found:
                    found.add(follower)
                    pending.append(follower)
        return found

    def _followers(self, node: Node) -> list[Node]:
        ranked = sorted(self._linked(node), key=lambda item: -item[1])
        return list(dict.fromkeys(follower for follower, _ in ranked))

    def _linked(self, node: Node) -> Iterator[tuple[Node, int]]:
        """Followers with the number of lanes that continue."""
        identity, direction = node
        road = self.roads[identity]
        link = road.link(direction)
        if link is None:
            return
        last = road.sections[-1 if direction > 0 else 0]
        lanes = {lane.id for lane in last.driving(road.side(direction))}
        if link.element == "road":
            follower = (link.id, -1 if link.contact == "end" else 1)
            if link.id in self.roads:
                after = self.roads[link.id]
                first = after.sections[0 if follower[1] > 0 else -1]
                yield follower, min(len(lanes), len(first.driving(after.side(follower[1]))))
            return
        junction = self._junctions.get(link.id)
        if junction is not None and junction.kind == "direct":
            yield from self._direct(node, junction, lanes)
            return
        for connection in () if junction is None else junction.connections:
            if connection.incoming != identity or connection.connecting not in self.roads:
                continue
            onward = 1 if connection.contact == "start" else -1
            if not self._leads_back(connection.connecting, onward, node):
                continue
            count = sum(1 for origin, _ in connection.lane_links if origin in lanes)
            if count or not connection.lane_links:
                yield (connection.connecting, onward), count

    def _leads_back(self, connecting: str, onward: int, node: Node) -> bool:
        """Whether a connecting road begins at the exit of `node`."""
        link = self.roads[connecting].link(-onward)
        if link is None or link.element != "road":
            return True
        contact = "end" if node[1] > 0 else "start"
        return link.id == node[0] and link.contact in (None, contact)

    def _direct(
        self, node: Node, junction: Junction, lanes: set[int]
    ) -> Iterator[tuple[Node, int]]:
        """Followers through a direct junction, whose connections hold for both directions."""
        identity, direction = node
        exit_contact = "end" if direction > 0 else "start"
        for connection in junction.connections:
            onwards: tuple[int, ...]
            if connection.incoming == identity:
                other, leaving = connection.connecting, 0
                onwards = (1 if connection.contact == "start" else -1,)
            elif (connection.connecting, connection.contact) == (identity, exit_contact):
                other, leaving = connection.incoming, 1
                road = self.roads.get(other)
                # The incoming road begins, ends, or does both in this junction.
                onwards = tuple(
                    onward
                    for onward in (1, -1)
                    if road is not None and _ends_in(road, -onward, junction)
                )
            else:
                continue
            count = sum(1 for link in connection.lane_links if link[leaving] in lanes)
            if other in self.roads and (count or not connection.lane_links):
                for onward in onwards:
                    yield (other, onward), count

    def _meets(self, node: Node, follower: Node) -> bool:
        """Whether the follower begins where the node ends; a note says why not."""
        end, start = self._road_ends(node)[1], self._road_ends(follower)[0]
        dx, dy = end.x - start.x, end.y - start.y
        sine, cosine = math.sin(start.heading), math.cos(start.heading)
        along, lateral = dx * cosine + dy * sine, dy * cosine - dx * sine
        turn = abs(wrap_angle(start.heading - end.heading))
        place = f"where road {node[0]!r} meets {follower[0]!r}"
        # Chains shift parallel lines, so here only what no shift can mend is decided.
        if abs(along) > 2.0 * GAP_LIMIT + abs(lateral) or abs(lateral) > 2.0 * SHIFT_LIMIT:
            self._note(apart(node[0], follower[0], along, lateral))
        elif turn > HEADING_STEP_LIMIT:
            self._note(f"{place}: {heading_step(turn)}")
        elif abs(start.z - end.z) > HEIGHT_STEP_LIMIT:
            self._note(f"{place}: {height_step(start.z - end.z)}")
        else:
            return True
        return False

    def _note(self, text: str) -> None:
        self.notes.append(f"not driven: {text}")

    def _road_ends(self, node: Node) -> tuple[RoadEnd, RoadEnd]:
        """Where a node is entered and left."""
        if node not in self._ends:
            road, direction = self.roads[node[0]], node[1]
            plan = road.plan.evaluate([0.0, road.length])
            height = road.elevation.evaluate([0.0, road.length])
            heading = plan.heading if direction > 0 else plan.heading + math.pi
            ends = [
                RoadEnd(float(plan.x[i]), float(plan.y[i]), float(height[i]), float(heading[i]))
                for i in (0, 1)
            ]
            self._ends[node] = (ends[0], ends[1]) if direction > 0 else (ends[1], ends[0])
        return self._ends[node]


def _ends_in(road: Road, direction: int, junction: Junction) -> bool:
    """Whether a road's end in a direction of travel is in a junction."""
    link = road.link(direction)
    return link is not None and (link.element, link.id) == ("junction", junction.id)
