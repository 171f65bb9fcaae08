"""Finds drivable chains of roads: through road links and through junctions' connecting roads."""

from __future__ import annotations

from collections.abc import Iterator

from iits_mj.errors import MapError
from iits_mj.road.elements import LaneSection, OpenDriveMap, Road

Node = tuple[str, int]

SEARCH_BUDGET = 20_000
CHAIN_LENGTH_LIMIT = 1e6


class RoadGraph:
    """Which road follows which, for every direction of travel that has driving lanes.

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
        """Nodes one can drive on to, the one that continues most lanes first."""
        return self._next[node]

    def starts(self) -> list[Node]:
        """Where a chain can begin: nodes nobody leads to, and one of every closed loop."""
        reached = {follower for followers in self._next.values() for follower in followers}
        starts = [node for node in self.nodes if node not in reached]
        covered = self._reachable(starts)
        for node in sorted(self.nodes, key=lambda n: self.roads[n[0]].junction is not None):
            if node not in covered:
                starts.append(node)
                covered |= self._reachable([node])
        return starts

    def chain(self, start: str | None = None) -> list[Node]:
        """The longest chain, or the longest from `start`: "ID" (along s) or "ID:-1" (against).

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
            # Equal chains: the first one stays, so the result does not hang on rounding.
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
        lanes = {lane.id for lane in self._last_section(road, direction).driving(direction)}
        if link.element == "road":
            follower = (link.id, -1 if link.contact == "end" else 1)
            if link.id in self.roads:
                first = self._first_section(self.roads[link.id], follower[1])
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
        """Whether a connecting road begins at the end of `node` that is being left."""
        link = self.roads[connecting].link(-onward)
        if link is None or link.element != "road":
            return True
        contact = "end" if node[1] > 0 else "start"
        return link.id == node[0] and link.contact in (None, contact)

    @staticmethod
    def _last_section(road: Road, direction: int) -> LaneSection:
        return road.sections[-1 if direction > 0 else 0]

    @staticmethod
    def _first_section(road: Road, direction: int) -> LaneSection:
        return road.sections[0 if direction > 0 else -1]
