"""Finds drivable chains of roads through links and junctions, and joins their roads end to end.

Joining trims overlaps, bridges gaps and shifts parallel reference lines.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from iits_mj.core.arrays import FloatArray
from iits_mj.core.errors import MapError
from iits_mj.road.elements import OpenDriveMap, Road

Node = tuple[str, int]

SEARCH_BUDGET = 20_000
CHAIN_LENGTH_LIMIT = 1e6
GAP_LIMIT = 3.0
SHIFT_LIMIT = 20.0
# A smaller lateral step is blended; a larger one is another choice of reference line.
BLENDED_LATERAL_STEP = 0.3


class RoadGraph:
    """Successors of every road, in each direction of travel that has driving lanes.

    A node is (road id, direction): +1 along s on the right lanes, -1 against s on the left ones.
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
        known = set(self.nodes)
        self._next = {
            node: [follower for follower in self._followers(node) if follower in known]
            for node in self.nodes
        }

    def followers(self, node: Node) -> list[Node]:
        """Returns the successors of a node, the one that continues most lanes first."""
        return self._next[node]

    def starts(self) -> list[Node]:
        """Returns the nodes where a chain can begin: without predecessor, and one per loop."""
        reached = {follower for followers in self._next.values() for follower in followers}
        starts = [node for node in self.nodes if node not in reached]
        covered = self._reachable(starts)
        for node in sorted(self.nodes, key=lambda n: self.roads[n[0]].junction is not None):
            if node not in covered:
                starts.append(node)
                covered |= self._reachable([node])
        return starts

    def chain(self, start: str | None = None) -> list[Node]:
        """Returns the longest chain, or the longest from `start`: "ID" (along s) or "ID:-1".

        Every road is driven at most once, so a closed loop gives one lap. The search is exhaustive
        on maps of some dozens of roads; on large ones it ends after a fixed number of steps.

        Raises:
          MapError: no road has driving lanes, or there is no such start.
        """
        if not self.nodes:
            raise MapError(f"{self.source}: no road has driving lanes from its start to its end")
        starts = self.starts() if start is None else [self._node(start)]
        budget = max(200, SEARCH_BUDGET // len(starts))
        best: list[Node] = []
        longest = 0.0
        for node in starts:
            chain, length = self._longest_from(node, budget)
            # The first of equal chains is kept, so that the result does not depend on rounding.
            if length > longest + 1e-6:
                best, longest = chain, length
        return best

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
        pending = [iter(self._next[start])]
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
            pending.append(iter(self._next[follower]))
            if length > longest:
                best, longest = list(path), length
        return best, longest

    def _reachable(self, starts: list[Node]) -> set[Node]:
        found = set(starts)
        pending = list(starts)
        while pending:
            for follower in self._next[pending.pop()]:
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
        lanes = {lane.id for lane in road.sections[-1 if direction > 0 else 0].driving(direction)}
        if link.element == "road":
            follower = (link.id, -1 if link.contact == "end" else 1)
            if link.id in self.roads:
                first = self.roads[link.id].sections[0 if follower[1] > 0 else -1]
                yield follower, min(len(lanes), len(first.driving(follower[1])))
            return
        junction = self._junctions.get(link.id)
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


@dataclass(frozen=True)
class Piece:
    """A stretch of one road in a chain.

    Attributes:
      road: the road; direction: +1 along its s, -1 against it.
      s_start, s_end: where it is entered and left; may lie slightly outside to bridge a gap.
      p_start: chain parameter at the entry.
      shift: of the chain's reference line to the left (in travel) of the road's [m].
    """

    road: Road
    direction: int
    s_start: float
    s_end: float
    p_start: float
    shift: float = 0.0

    @property
    def length(self) -> float:
        """Metres of road s."""
        return abs(self.s_end - self.s_start)

    @property
    def p_end(self) -> float:
        """Chain parameter at the exit."""
        return self.p_start + self.length

    def s_at(self, p: ArrayLike) -> FloatArray:
        """Road s at chain parameters."""
        return self.s_start + self.direction * (np.asarray(p, dtype=float) - self.p_start)

    def p_at(self, s: float) -> float:
        """Chain parameter at a road s."""
        return self.p_start + self.direction * (s - self.s_start)

    def state(self, s: ArrayLike, side: int = 1, roll_scale: float = 1.0) -> FloatArray:
        """Exact values and derivatives by p, shape (3, 4, n): order of derivative; x, y, z, roll.

        Where two records meet, `side` selects the one after (+1) or before (-1) in travel. Second
        derivatives of z and roll are zero.
        """
        s = np.atleast_1d(np.asarray(s, dtype=float))
        sign = self.direction
        plan = self.road.plan.evaluate(s, side * sign)
        sine, cosine = sign * np.sin(plan.heading), sign * np.cos(plan.heading)
        bend = sign * plan.curvature
        stretch = 1.0 - bend * self.shift
        speed = plan.speed * stretch
        profile = self.road.superelevation
        roll = sign * roll_scale * profile.evaluate(s, 0, side * sign)
        roll_rate = roll_scale * profile.evaluate(s, 1, side * sign)
        height = self.road.elevation.evaluate(s, 0, side * sign)
        grade = sign * self.road.elevation.evaluate(s, 1, side * sign)
        zero = np.zeros_like(s)
        normal = bend * plan.speed * speed
        return np.array(
            [
                [
                    plan.x - self.shift * sine,
                    plan.y + self.shift * cosine,
                    height + self.shift * np.tan(roll),
                    roll,
                ],
                [
                    speed * cosine,
                    speed * sine,
                    grade + self.shift * roll_rate / np.cos(roll) ** 2,
                    roll_rate,
                ],
                [-normal * sine, normal * cosine, zero, zero],
            ]
        )

    def steepest(self) -> float:
        """Greatest cross slope of the road on this stretch [rad]."""
        s = np.linspace(self.s_start, self.s_end, max(int(self.length), 10))
        return float(np.max(np.abs(self.road.superelevation.evaluate(s))))

    def breaks(self) -> list[float]:
        """Road s of every record that starts inside, in the order of travel."""
        low, high = sorted((self.s_start, self.s_end))
        places = {*map(float, self.road.plan.starts)}
        places.update(self.road.elevation.breaks(), self.road.superelevation.breaks())
        return sorted((s for s in places if low < s < high), reverse=self.direction < 0)


def join(roads: dict[str, Road], chain: Sequence[Node], source: str) -> list[Piece]:
    """Joins the roads of a chain end to end.

    Overlaps are trimmed and gaps are bridged by extending the next road backwards. Where the next
    road's reference line runs beside the last one's (in another lane), the chain keeps its line by
    a parallel shift.

    Raises:
      MapError: two roads do not meet.
    """
    pieces: list[Piece] = []
    for identity, direction in chain:
        road = roads[identity]
        entry, leave = (0.0, road.length) if direction > 0 else (road.length, 0.0)
        if not pieces:
            pieces.append(Piece(road, direction, entry, leave, 0.0))
            continue
        last = pieces[-1]
        end = last.state(last.s_end, -1)[0, :2, 0]
        start, lateral = _project(Piece(road, direction, entry, leave, 0.0), end)
        along = direction * (start - entry)
        if abs(along) > GAP_LIMIT or abs(lateral) > SHIFT_LIMIT:
            raise MapError(
                f"{source}: road {last.road.id!r} is linked to {identity!r}, but they are "
                f"{math.hypot(along, lateral):.1f} m apart ({along:.1f} m along, {lateral:.1f} m "
                f"across); up to {GAP_LIMIT:g} m along are bridged"
            )
        if direction * (leave - start) < 0.1:
            continue
        shift = lateral if abs(lateral) > BLENDED_LATERAL_STEP else 0.0
        pieces.append(Piece(road, direction, start, leave, last.p_end, shift))
        sampled = road.plan.evaluate(np.linspace(0.0, road.length, 200))
        tightest = float(np.max(np.abs(sampled.curvature)))
        if tightest * abs(shift) > 0.8:
            raise MapError(
                f"{source}: road {identity!r} bends with a radius of {1 / tightest:.1f} m, too "
                f"tight to follow a line {shift:.1f} m beside its reference line"
            )
    return pieces


def _project(piece: Piece, point: FloatArray) -> tuple[float, float]:
    """Road s abreast of a point near the piece's entry, and the point's offset to the left."""
    s = piece.s_start
    lateral = 0.0
    for _ in range(20):
        state = piece.state(s)
        position, tangent = state[0, :2, 0], state[1, :2, 0]
        norm = float(np.hypot(*tangent))
        dx, dy = point - position
        along = float((dx * tangent[0] + dy * tangent[1]) / norm)
        lateral = float((dy * tangent[0] - dx * tangent[1]) / norm)
        s += piece.direction * along / norm
        if abs(along) < 1e-9 or abs(s - piece.s_start) > 2.0 * GAP_LIMIT:
            break
    return s, lateral
