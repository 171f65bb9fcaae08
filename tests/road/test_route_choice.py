"""Routes that a user describes by roads, lanes, points or turns."""

from __future__ import annotations

import itertools
import math

import pytest

from iits_mj.core.errors import InputError
from iits_mj.road import RoadMap
from iits_mj.road.opendrive import parse
from iits_mj.road.route_choice import read_words
from tests.road.opendrive_text import document, road

ARM, RADIUS = 100.0, 20.0
BOTH = """<lanes><laneSection s="0"><left>
<lane id="1" type="driving"><width sOffset="0" a="3.5" b="0" c="0" d="0"/></lane></left>
<center><lane id="0" type="none"/></center><right>
<lane id="-1" type="driving"><width sOffset="0" a="3.5" b="0" c="0" d="0"/></lane>
<lane id="-2" type="shoulder"><width sOffset="0" a="1.5" b="0" c="0" d="0"/></lane></right>
</laneSection></lanes>"""
ONE = """<lanes><laneSection s="0"><center><lane id="0" type="none"/></center><right>
<lane id="-1" type="driving"><link><predecessor id="-1"/><successor id="1"/></link>
<width sOffset="0" a="3.5" b="0" c="0" d="0"/></lane></right></laneSection></lanes>"""
NAMES = ("east", "north", "west", "south")  # roads that lead to the crossing, by their place


def crossing() -> RoadMap:
    """Four roads that lead to the origin, and a connecting road for each turn there."""
    roads, connections = [], []
    for i, name in enumerate(NAMES):
        angle = i * math.pi / 2.0
        far = RADIUS + ARM
        geometry = (
            f'<geometry s="0" x="{far * math.cos(angle)}" y="{far * math.sin(angle)}" '
            f'hdg="{angle + math.pi}" length="{ARM}"><line/></geometry>'
        )
        link = '<successor elementType="junction" elementId="9"/>'
        roads.append(road(name, geometry, ARM, link, BOTH))
    for i, j in itertools.permutations(range(4), 2):
        angle, turn = i * math.pi / 2.0, (j - i) % 4
        x, y = RADIUS * math.cos(angle), RADIUS * math.sin(angle)
        length = 2.0 * RADIUS if turn == 2 else RADIUS * math.pi / 2.0
        bend = {1: -1.0, 2: 0.0, 3: 1.0}[turn] / RADIUS
        shape = "<line/>" if turn == 2 else f'<arc curvature="{bend}"/>'
        place = f'<geometry s="0" x="{x}" y="{y}" hdg="{angle + math.pi}" length="{length}">'
        link = "".join(
            f'<{what} elementType="road" elementId="{NAMES[k]}" contactPoint="end"/>'
            for what, k in (("predecessor", i), ("successor", j))
        )
        name = f"{NAMES[i]}_{NAMES[j]}"
        roads.append(
            road(name, f"{place}{shape}</geometry>", length, link, ONE, attributes='junction="9"')
        )
        connections.append(
            f'<connection id="{name}" incomingRoad="{NAMES[i]}" connectingRoad="{name}" '
            'contactPoint="start"><laneLink from="-1" to="-1"/></connection>'
        )
    text = document(*roads, extra=f'<junction id="9">{"".join(connections)}</junction>')
    return RoadMap(parse(text.encode(), "crossing"), "crossing")


CROSSING = crossing()


def driven(words: str) -> list[tuple[str, int]]:
    return [(part.road_id, part.direction) for part in CROSSING.route(along=words).segments]


def way(begin: str, end: str) -> list[tuple[str, int]]:
    return [(begin, 1), (f"{begin}_{end}", 1), (end, -1)]


@pytest.mark.parametrize(("begin", "end"), itertools.permutations(NAMES, 2))
def test_roads_between_named_ones_are_found_in_every_direction(begin, end):
    assert driven(f"{begin},{end}") == way(begin, end)
    assert driven(f"roads: {begin}_-1 , {end}_1") == way(begin, end)


@pytest.mark.parametrize(
    ("turn", "end"), [("left", "south"), ("straight", "west"), ("right", "north")]
)
def test_a_turn_leads_to_the_road_on_its_side(turn, end):
    assert driven(f"turns:east,{turn}") == way("east", end)


def test_after_the_last_turn_the_route_goes_straight_on():
    assert driven("turns:north") == way("north", "south")


@pytest.mark.parametrize(("y", "begin", "end"), [(2.0, "east", "west"), (-2.0, "west", "east")])
def test_points_choose_the_direction_of_the_lane_they_lie_in(y, begin, end):
    x = math.copysign(80.0, y)
    route = CROSSING.route(along=f"points:{x},{y},{-x},{y}")
    assert [part.road_id for part in route.segments] == [begin, f"{begin}_{end}", end]
    assert route.start == pytest.approx(ARM + RADIUS - 80.0, abs=1e-3)


def test_a_point_that_cannot_be_reached_is_refused_with_the_reason():
    with pytest.raises(InputError, match=r"no way leads from \(80, -2\) to \(-80, -2\)"):
        CROSSING.route(along="points:80,-2,-80,-2")
    with pytest.raises(InputError, match=r"\(50, -2\) of the route lies behind"):
        CROSSING.route(along="points:80,-2,50,-2")
    with pytest.raises(InputError, match=r"\(80, 40\) of the route is farther than 20 m"):
        CROSSING.route(along="points:80,40,-80,2")


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("nowhere,east", "there is no road 'nowhere' for the route; there are east, north"),
        ("east_-2,west", "road 'east' has no driving lane -2 for the route; it has -1, 1"),
        ("east,west,east", "no way leads from west to east"),
        ("east_1,west", "no way leads from east_1 to west"),
        ("turns:east,left,left", "ends with road 'south' before the turns left"),
        ("east,,west", "has an empty or too long list"),
        ("points:1,2,3", "needs x and y of two or more points"),
        ("points:1,nan,3,4", "'nan' is not a finite number"),
        ("turns:east,up", "'up' is no turn; use left, straight, right"),
    ],
)
def test_a_wrong_route_is_refused_with_what_is_allowed(words, message):
    with pytest.raises(InputError, match=message.replace("(", r"\(")):
        CROSSING.route(along=words)


def test_a_start_and_a_description_contradict_each_other():
    with pytest.raises(InputError, match="not both"):
        CROSSING.route("east", along="east,west")


@pytest.mark.parametrize("value", [5, None, b"1,2"])
def test_only_text_describes_a_route(value):
    with pytest.raises(InputError, match="is no text"):
        read_words(value)
