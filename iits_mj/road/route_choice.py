"""Finds the chain of roads that a user describes: by roads or lanes, by points, or by turns.

    roads:12,15_-2,3       roads in their order, or lanes as ROAD_LANE; "roads:" can be left out
    points:10,-3.5,250,80  x and y of points of the map [m] in their order
    turns:12,left,right    the first road (without it, the first of the longest chain) and turns

Roads between two named ones, or between two points, are those of the shortest way. The route ends
with the road of the last name or point. After the last turn it goes straight on.
"""

from __future__ import annotations

import heapq
import itertools
import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from iits_mj.core.angles import wrap_angle
from iits_mj.core.errors import InputError
from iits_mj.core.options import option
from iits_mj.road.chain import CHAIN_LENGTH_LIMIT, Node
from iits_mj.road.elements import Road, lane_borders
from iits_mj.road.road_graph import RoadGraph

ROADS, POINTS, TURNS = "roads", "points", "turns"
LEFT, STRAIGHT, RIGHT = "left", "straight", "right"
# Change of heading of each turn [rad]; a way belongs to the nearest one.
HEADINGS = {LEFT: math.pi / 2.0, STRAIGHT: 0.0, RIGHT: -math.pi / 2.0}
TURN_LEAST = math.radians(30.0)  # of a way that counts as left or right
TURN_DISTANCE = 50.0  # [m] of a follower over which its turn is measured
POINT_DISTANCE = 20.0  # [m] from a driving lane
POINT_STEP = 2.0  # [m] between samples of a road
WORDS_MAX = 1000
# A road that a truck cannot drive counts as this much longer [m].
OBSTACLE = 1e5
_FORMS = "use roads:ID,ID_LANE,..., points:X,Y,X,Y,... or turns:left,straight,right,..."


class Words(NamedTuple):
    """A route in words: its kind, and names, coordinates or turns."""

    kind: str
    words: tuple[str, ...]


class Choice(NamedTuple):
    """A chain of roads; `start` is the road s where the first point is, else None."""

    chain: list[Node]
    start: float | None


class _Place(NamedTuple):
    """A road that a point may lie on: its road s, and the distance to its lanes [m]."""

    node: Node
    s: float
    distance: float


def route_option() -> Any:
    """Returns the option of a command that takes a route in words."""
    return option(
        None,
        help="route on the map, by roads or lanes (roads:12,15_-2), by points (points:X,Y,X,Y) or "
        "by turns (turns:12,left,straight); without it the longest one",
        test=read_words,
        metavar="ROUTE",
        group="road",
    )


def read_words(text: str) -> Words:
    """Returns a route in words.

    Raises:
      InputError: the text has none of the forms.
    """
    if not isinstance(text, str):
        raise InputError(f"route {text!r} is no text: {_FORMS}")
    kind, found, rest = text.partition(":")
    if found and kind.strip() in (ROADS, POINTS, TURNS):
        kind = kind.strip()
    else:
        kind, rest = ROADS, text
    words = tuple(word.strip() for word in rest.split(","))
    if not all(words) or len(words) > WORDS_MAX:
        raise InputError(f"route {text[:80]!r} has an empty or too long list: {_FORMS}")
    if kind == POINTS:
        numbers = [_number(word, text) for word in words]
        if len(numbers) % 2 or len(numbers) < 4:
            raise InputError(f"route {text[:80]!r} needs x and y of two or more points")
    if kind == TURNS:
        for word in words[0 if words[0] in HEADINGS else 1 :]:
            if word not in HEADINGS:
                raise InputError(
                    f"route {text[:80]!r}: {word!r} is no turn; use {', '.join(HEADINGS)}"
                )
    return Words(kind, words)


def choose(graph: RoadGraph, text: str) -> Choice:
    """Returns the chain of roads that a text describes.

    Raises:
      InputError: the text has none of the forms, a road, lane or turn does not exist, a point is
        far from every driving lane, or no way leads from one to the next.
      MapError: the map has no driving lanes.
    """
    kind, words = read_words(text)
    if kind == TURNS:
        return Choice(_by_turns(graph, words), None)
    if kind == ROADS:
        named = [_nodes(graph, word) for word in words]
        return Choice(_connect(graph, named, words), None)
    numbers = [float(word) for word in words]
    points = list(zip(numbers[::2], numbers[1::2], strict=True))
    names = [f"({x:g}, {y:g})" for x, y in points]
    places = [_places(graph, x, y, name) for (x, y), name in zip(points, names, strict=True)]
    chain = _connect(graph, [[place.node for place in each] for each in places], names)
    at = [next((p for p in each if p.node in chain), each[0]) for each in places]
    for before, after, name in zip(at, at[1:], names[1:], strict=False):
        if before.node == after.node and before.node[1] * (after.s - before.s) < 0.0:
            raise InputError(
                f"{graph.source}: the point {name} of the route lies behind the point before it on "
                f"road {before.node[0]!r}; a route drives every road once"
            )
    return Choice(chain, at[0].s)


def _number(word: str, text: str) -> float:
    try:
        value = float(word)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise InputError(f"route {text[:80]!r}: {word[:40]!r} is not a finite number")
    return value


def _nodes(graph: RoadGraph, word: str) -> list[Node]:
    """The roads, with their direction of travel, that a name can mean."""
    if word in graph.roads:
        found = [node for node in graph.nodes if node[0] == word]
        if not found:
            raise InputError(f"{graph.source}: road {word!r} of the route has no driving lanes")
        return found
    name, _, lane = word.rpartition("_")
    road = graph.roads.get(name)
    if road is None or not lane.lstrip("-").isdigit():
        names = ", ".join(list(dict.fromkeys(node[0] for node in graph.nodes))[:20])
        raise InputError(
            f"{graph.source}: there is no road {word!r} for the route; there are {names}"
        )
    # Maps may give the line in the middle the type of a lane.
    lanes = (each for part in road.sections for each in part.lanes if each.id and each.is_driving)
    driven = sorted({each.id for each in lanes})
    node = (name, road.travel(int(lane)))
    if int(lane) not in driven or node not in graph.nodes:
        raise InputError(
            f"{graph.source}: road {name!r} has no driving lane {lane} for the route; it has "
            f"{', '.join(map(str, driven)) or 'none'}"
        )
    return [node]


def _connect(graph: RoadGraph, stops: Sequence[Sequence[Node]], names: Sequence[str]) -> list[Node]:
    """The shortest chain over one node of each stop, in their order."""
    best: dict[Node, tuple[float, list[Node]]] = {node: (0.0, [node]) for node in stops[0]}
    for (before, after), targets in zip(itertools.pairwise(names), stops[1:], strict=True):
        ways: dict[Node, tuple[float, list[Node]]] = {}
        for origin, (cost, chain) in best.items():
            for target, (more, way) in _shortest(graph, origin, set(targets), chain).items():
                if target not in ways or cost + more < ways[target][0]:
                    ways[target] = cost + more, chain + way
        if not ways:
            raise InputError(
                f"{graph.source}: no way leads from {before} to {after} of the route; a route "
                "drives every road once"
            )
        best = ways
    return min(best.values(), key=lambda each: each[0])[1]


def _shortest(
    graph: RoadGraph, origin: Node, targets: set[Node], driven: Sequence[Node]
) -> dict[Node, tuple[float, list[Node]]]:
    """Length and nodes of the shortest way to each target, without the origin; Dijkstra's search.

    Roads in `driven` are not driven again.
    """
    closed = {identity for identity, _ in driven}
    result: dict[Node, tuple[float, list[Node]]] = {}
    if origin in targets:
        result[origin] = 0.0, []
    missing = targets - {origin}
    known = {origin}
    # The counter decides between equal lengths, so that the order of the file does.
    counter = itertools.count()
    queue: list[tuple[float, int, Node, tuple[Node, ...]]] = [(0.0, next(counter), origin, ())]
    before: dict[Node, Node] = {}
    while queue and missing:
        length, _, node, previous = heapq.heappop(queue)
        if previous:
            if node in known:
                continue
            known.add(node)
            before[node] = previous[0]
        if node in missing:
            missing.discard(node)
            result[node] = length, _trace(before, origin, node)
        for follower in graph.followers(node):
            if follower in known or follower[0] in closed:
                continue
            more = graph.roads[follower[0]].length
            if graph.obstacle(follower):
                more += OBSTACLE
            if length + more <= CHAIN_LENGTH_LIMIT:
                heapq.heappush(queue, (length + more, next(counter), follower, (node,)))
    return result


def _trace(before: dict[Node, Node], origin: Node, node: Node) -> list[Node]:
    way = [node]
    while before[way[-1]] != origin:
        way.append(before[way[-1]])
    return way[::-1]


def _places(graph: RoadGraph, x: float, y: float, name: str) -> list[_Place]:
    """The roads whose driving lanes are nearest to a point, one place for each."""
    found = []
    nodes = set(graph.nodes)
    for road in graph.roads.values():
        s, t, near = _project(road, x, y)
        if near > POINT_DISTANCE + 100.0:
            continue
        for direction in (1, -1):
            if (road.id, direction) in nodes:
                distance = math.hypot(_beside(road, direction, s, t), _beyond(road, x, y, s))
                found.append(_Place((road.id, direction), s, distance))
    nearest = min((place.distance for place in found), default=math.inf)
    if nearest > POINT_DISTANCE:
        raise InputError(
            f"{graph.source}: the point {name} of the route is farther than {POINT_DISTANCE:g} m "
            "from every driving lane"
        )
    return [place for place in found if place.distance <= nearest + 0.01]


def _project(road: Road, x: float, y: float) -> tuple[float, float, float]:
    """The road s abreast of a point, the point's t, and its distance from the line [m]."""
    s = np.linspace(0.0, road.length, max(math.ceil(road.length / POINT_STEP), 1) + 1)
    for _ in range(3):
        line = road.plan.evaluate(s)
        distance = np.hypot(line.x - x, line.y - y)
        best = int(distance.argmin())
        at, step = float(s[best]), float(s[1] - s[0])
        # The next samples lie between the neighbors of the nearest one.
        s = np.linspace(max(at - step, 0.0), min(at + step, road.length), 21)
    heading = float(line.heading[best])
    t = (y - float(line.y[best])) * math.cos(heading) - (x - float(line.x[best])) * math.sin(
        heading
    )
    return at, t, float(distance[best])


def _beyond(road: Road, x: float, y: float, s: float) -> float:
    """Distance of a point from the road's cross section at s, along the road [m]."""
    line = road.plan.evaluate([s])
    heading = float(line.heading[0])
    return (x - float(line.x[0])) * math.cos(heading) + (y - float(line.y[0])) * math.sin(heading)


def _beside(road: Road, direction: int, s: float, t: float) -> float:
    """Distance of t from the driving lanes of a direction; 0 inside them [m]."""
    section = [each for start, _, each in road.section_spans() if start <= s][-1]
    side = road.side(direction)
    borders = lane_borders(road, section, side)
    distances = []
    for lane in section.driving(side):
        inside = lane.id - 1 if lane.id > 0 else lane.id + 1
        low, high = sorted((borders[lane.id].at(s), borders[inside].at(s)))
        distances.append(max(low - t, t - high, 0.0))
    return min(distances, default=math.inf)


def _by_turns(graph: RoadGraph, words: Sequence[str]) -> list[Node]:
    """A chain that takes a list of turns, and then goes straight on."""
    if words[0] in HEADINGS:
        chain = graph.chain()[:1]
    else:
        starts = _nodes(graph, words[0])
        # Without a direction, the one in which the road leads on.
        chain = [next((node for node in starts if graph.followers(node)), starts[0])]
        words = words[1:]
    turns = list(words)
    driven = {chain[0][0]}
    while True:
        followers = [node for node in graph.followers(chain[-1]) if node[0] not in driven]
        if not followers:
            break
        changes = {node: _turn(graph.roads[node[0]], node[1]) for node in followers}
        kinds = {node: _kind(change) for node, change in changes.items()}
        choice = len(set(kinds.values())) > 1
        wanted = turns.pop(0) if choice and turns else STRAIGHT if choice else None
        if wanted is not None and wanted not in kinds.values():
            if turns or wanted != STRAIGHT:
                possible = ", ".join(turn for turn in HEADINGS if turn in kinds.values())
                raise InputError(
                    f"{graph.source}: after road {chain[-1][0]!r} the route cannot go {wanted}; "
                    f"possible: {possible}"
                )
            wanted = None
        fitting = [node for node in followers if wanted is None or kinds[node] == wanted]
        aim = HEADINGS[wanted or STRAIGHT]
        # Of equal ways the first, which continues most lanes.
        chain.append(min(fitting, key=lambda node: round(abs(changes[node] - aim), 2)))
        driven.add(chain[-1][0])
    if turns:
        raise InputError(
            f"{graph.source}: the route ends with road {chain[-1][0]!r} before the turns "
            f"{', '.join(turns)}"
        )
    return chain


def _turn(road: Road, direction: int) -> float:
    """Change of heading in travel over a road, at most over its first 50 m [rad]."""
    far = min(road.length, TURN_DISTANCE) if road.junction is None else road.length
    ends = (0.0, far) if direction > 0 else (road.length, road.length - far)
    heading = road.plan.evaluate(ends).heading
    return wrap_angle(float(heading[1] - heading[0]))


def _kind(change: float) -> str:
    if abs(change) < TURN_LEAST:
        return STRAIGHT
    return LEFT if change > 0.0 else RIGHT
