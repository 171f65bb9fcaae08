from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from iits_mj.core.errors import InputError
from iits_mj.road import TABLE_COLUMNS, RoadMap, Route
from iits_mj.road.opendrive import parse
from tests.road.opendrive_text import document, road

WIDE = """<lanes><laneOffset s="0" a="1" b="0" c="0" d="0"/>
<laneSection s="0"><left>
<lane id="2" type="driving"><width sOffset="0" a="3" b="0" c="0" d="0"/>
 <roadMark sOffset="0" type="solid"/></lane>
<lane id="1" type="driving"><width sOffset="0" a="4" b="0" c="0" d="0"/>
 <roadMark sOffset="0" type="broken"/></lane></left>
<center><lane id="0" type="none"><roadMark sOffset="0" type="solid solid"/></lane></center><right>
<lane id="-1" type="driving"><width sOffset="0" a="3.5" b="0" c="0" d="0"/>
 <roadMark sOffset="0" type="broken"/><roadMark sOffset="20" type="solid"/>
 <speed sOffset="0" max="100" unit="km/h"/><speed sOffset="60" max="20" unit="m/s"/></lane>
<lane id="-2" type="driving"><width sOffset="0" a="3" b="0.01" c="0" d="0"/>
 <roadMark sOffset="0" type="solid"/><material sOffset="40" friction="0.3"/></lane>
<lane id="-3" type="shoulder"><width sOffset="0" a="2" b="0" c="0" d="0"/></lane></right>
</laneSection></lanes>"""
SPIRAL = """<geometry s="0" x="3" y="4" hdg="2.9" length="100">
<spiral curvStart="-0.004" curvEnd="0.01"/></geometry>"""
PROFILES = {
    "elevation": '<elevation s="0" a="10" b="0.03" c="-0.0004" d="1e-6"/>',
    "extra": '<lateralProfile><superelevation s="0" a="0.02" b="0.0004" c="0" d="0"/>'
    "</lateralProfile>"
    '<type s="0" type="town" country="DE"><speed max="50" unit="km/h"/></type>'
    '<objects><tunnel id="1" s="30" length="20"/><bridge id="2" s="80" length="50"/></objects>'
    '<signals><signal id="7" s="25" t="-8" type="274" value="60" unit="km/h" orientation="+"/>'
    '<signal id="8" s="35" t="9" type="1000001" dynamic="yes" orientation="-"/></signals>',
}


def wide_map() -> RoadMap:
    text = document(road(geometry=SPIRAL, lanes=WIDE, **PROFILES))
    return RoadMap(parse(text.encode(), "wide"), "wide")


FORTH = wide_map().route("1:+1")
BACK = wide_map().route("1:-1")
HIGHWAY = RoadMap.builtin().route()


@given(s=st.floats(-30.0, 130.0), t=st.floats(-15.0, 15.0), guess=st.floats(-30.0, 30.0))
@settings(deadline=None)
@pytest.mark.parametrize("route", [FORTH, BACK], ids=["forth", "back"])
def test_locate_inverts_evaluate(route, s, t, guess):
    point = route.evaluate(s, t)
    for near in (s + guess, None):
        assert route.locate(point.x, point.y, near) == pytest.approx((s, t), abs=1e-5)


@given(s=st.floats(0.0, 15_000.0), t=st.floats(-12.0, 12.0))
@settings(deadline=None)
def test_locate_inverts_evaluate_on_the_highway(s, t):
    point = HIGHWAY.evaluate(s, t)
    for near in (s + 3.0, s - 400.0, None):
        assert HIGHWAY.locate(point.x, point.y, near) == pytest.approx((s, t), abs=1e-5)


def test_locate_refuses_a_point_that_is_not_finite():
    with pytest.raises(InputError, match="finite"):
        FORTH.locate(math.nan, 0.0)


def test_point_at_the_center_of_a_bend_is_located_at_its_radius():
    geometry = '<geometry s="0" x="0" y="0" hdg="0" length="60"><arc curvature="0.05"/></geometry>'
    text = document(road(geometry=geometry, length=60))
    route = RoadMap(parse(text.encode(), "arc"), "arc").route()
    station, offset = route.locate(0.0, 20.0)
    assert 0.0 <= station <= 60.0
    assert offset == pytest.approx(20.0, abs=1e-3)


@given(s=st.floats(-20.0, 120.0), t=st.floats(-5.0, 5.0))
def test_scalar_and_vector_evaluation_agree(s, t):
    scalar = FORTH.evaluate(s, t)
    vector = FORTH.evaluate(np.array([s]), np.array([t]))
    assert all(isinstance(value, float) for value in scalar)
    assert np.allclose(np.array(scalar), np.array(vector)[:, 0], atol=1e-12)


def test_both_directions_see_one_surface():
    for s in (5.0, 42.0, 97.0):
        for t in (-4.0, 0.0, 6.0):
            forth, back = FORTH.evaluate(s, t), BACK.evaluate(100.0 - s, -t)
            assert (forth.x, forth.y, forth.z) == pytest.approx((back.x, back.y, back.z), abs=1e-6)
            assert math.cos(forth.heading - back.heading) == pytest.approx(-1.0, abs=1e-9)
            assert forth.grade == pytest.approx(-back.grade, abs=1e-7)
            assert forth.curvature == pytest.approx(-back.curvature, abs=1e-6)
            assert forth.superelevation == pytest.approx(-back.superelevation, abs=1e-9)


def test_positive_superelevation_lifts_the_left_side():
    point, left = FORTH.evaluate(50.0), FORTH.evaluate(50.0, 2.0)
    assert point.superelevation == pytest.approx(0.04, abs=1e-9)
    assert left.z - point.z == pytest.approx(2.0 * math.tan(0.04), abs=1e-9)


def test_height_and_heading_equal_the_exact_records():
    s = np.linspace(0.0, 100.0, 333)
    point, plan = FORTH.evaluate(s), FORTH.road_map.roads["1"].plan.evaluate(s)
    assert np.abs(point.x - plan.x).max() < 1e-6
    assert np.abs(point.y - plan.y).max() < 1e-6
    assert np.abs(point.heading - plan.heading).max() < 1e-6
    assert np.abs(point.curvature - plan.curvature).max() < 1e-9
    assert np.abs(point.z - (10 + 0.03 * s - 4e-4 * s**2 + 1e-6 * s**3)).max() < 1e-9


def test_lanes_are_counted_from_the_right_of_travel():
    assert FORTH.lane_boundaries_at(10.0) == pytest.approx([-5.6, -2.5, 1.0])
    assert BACK.lane_boundaries_at(10.0) == pytest.approx([-8.0, -5.0, -1.0])
    assert FORTH.lane_offset(0, 10.0) == pytest.approx(-4.05)
    assert BACK.lane_width(1, 10.0) == pytest.approx(4.0)
    assert [FORTH.lane_at(10.0, t) for t in (-6.0, -4.0, 0.0, 2.0)] == [-1, 0, 1, -1]
    right, left = FORTH.surface_edges(10.0)
    assert (float(right), float(left)) == pytest.approx((-7.6, 8.0))


def test_lane_functions_agree_for_scalars_and_arrays():
    station = np.linspace(-5.0, 15_005.0, 401)
    for lane in (0, 1, 2):
        each = [HIGHWAY.lane_offset(lane, float(s)) for s in station]
        assert np.allclose(HIGHWAY.lane_offset(lane, station), each, atol=1e-9)
        each = [HIGHWAY.lane_width(lane, float(s)) for s in station]
        assert np.allclose(HIGHWAY.lane_width(lane, station), each, atol=1e-9)


def test_lanes_at_a_place_do_not_depend_on_the_places_asked_before():
    def lanes(route, station):
        offsets = np.linspace(-8.0, 8.0, 9).tolist()
        return [route.lane_at(station, offset) for offset in offsets], route.lane_count(station)

    road_map = RoadMap.builtin()
    route = road_map.route()
    for station in (-5.0, 10.0, 4000.0, 10.0, 12_000.0, 4000.0, 4000.0, route.length + 5.0, -5.0):
        assert lanes(route, station) == lanes(road_map.route(), station)


def test_speed_limits_come_from_lane_then_road():
    assert FORTH.speed_limit(10.0, 1) == pytest.approx(100.0 / 3.6)
    assert FORTH.speed_limit(80.0, 1) == 20.0
    assert FORTH.speed_limit(10.0, 0) == pytest.approx(50.0 / 3.6)
    assert BACK.speed_limit(10.0, 0) == pytest.approx(50.0 / 3.6)


def test_road_marks_are_found_on_their_boundary():
    assert [FORTH.boundary_mark(i, 10.0).kind for i in range(3)] == [
        "solid",
        "broken",
        "solid solid",
    ]
    assert [FORTH.boundary_mark(i, 30.0).kind for i in range(3)] == [
        "solid",
        "solid",
        "solid solid",
    ]
    assert [BACK.boundary_mark(i, 30.0).kind for i in range(3)] == [
        "solid",
        "broken",
        "solid solid",
    ]


def test_tunnels_bridges_and_signals_lie_at_their_stations():
    assert [*FORTH.tunnels[0], *FORTH.bridges[0]] == pytest.approx([30.0, 50.0, 80.0, 100.0])
    assert [*BACK.tunnels[0], *BACK.bridges[0]] == pytest.approx([50.0, 70.0, 0.0, 20.0])
    (sign,) = FORTH.signals
    assert (sign.station, sign.offset, sign.signal.value) == pytest.approx((25.0, -8.0, 60.0))
    (light,) = BACK.signals
    assert (light.station, light.offset) == pytest.approx((65.0, -9.0))
    assert light.signal.is_traffic_light


def test_friction_follows_the_lane_material():
    assert FORTH.friction(30.0, -4.0) == pytest.approx(0.3)
    assert FORTH.friction(30.0, 0.0) == pytest.approx(0.8)
    row = FORTH.table(1.0)[50]
    assert row[7:9] == pytest.approx([0.8, 0.3])
    assert row[9] == pytest.approx(-2.5)


def test_friction_can_be_replaced_on_a_stretch():
    icy = Route.straight(1000.0).with_friction(0.8, 0.2, split=0.5, start=100.0, end=200.0)
    assert [icy.friction(150.0, t) for t in (-1.0, 1.0)] == [0.2, 0.8]
    assert icy.friction(250.0, -1.0) == 0.8
    assert icy.table(10.0)[15, 7:].tolist() == [0.8, 0.2, 0.5]
    assert icy.table(10.0)[25, 7:].tolist() == [0.8, 0.8, 0.0]
    with pytest.raises(InputError, match="friction"):
        icy.with_friction(math.nan)


@pytest.mark.parametrize("route", [FORTH, BACK, HIGHWAY], ids=["forth", "back", "highway"])
def test_table_is_uniform_in_station_and_covers_the_route(route):
    table = route.table(2.0)
    assert table.shape == (math.ceil(route.length / 2.0 - 1e-9) + 1, len(TABLE_COLUMNS))
    assert np.isfinite(table).all()
    point = route.evaluate(np.arange(len(table)) * 2.0)
    assert np.array_equal(table[:, :7], np.column_stack(point))
    assert np.abs(np.diff(table[:, 3])).max() < 0.1


def test_smoothed_grade_is_the_mean_over_40_m():
    assert Route.straight(grade=0.03).smoothed_grade(500.0) == pytest.approx(0.03)
    s = np.linspace(30.0, 70.0, 4001)
    assert FORTH.smoothed_grade(50.0) == pytest.approx(FORTH.evaluate(s).grade.mean(), abs=1e-5)


def test_straight_route_has_its_origin_in_the_middle_of_the_right_lane():
    route = Route.straight(length=500.0, lanes=2, lane_width=3.5, speed_limit=22.0, grade=0.05)
    assert route.lane_count(10.0) == 2
    assert [route.lane_offset(i, 10.0) for i in (0, 1)] == pytest.approx([0.0, 3.5])
    assert route.speed_limit(10.0, 1) == 22.0
    point = route.evaluate(100.0, 3.5)
    assert (point.x, point.y, point.z) == pytest.approx((100.0, 3.5, 5.0))


@pytest.mark.parametrize("name", ["length", "lane_width", "speed_limit", "grade", "friction"])
def test_straight_route_refuses_nan(name):
    with pytest.raises(InputError, match=name):
        Route.straight(**{name: math.nan})


def test_a_route_continues_straight_beyond_its_ends():
    before, start = FORTH.evaluate(-10.0), FORTH.evaluate(0.0)
    assert math.hypot(before.x - start.x, before.y - start.y) == pytest.approx(10.0)
    assert before.z == pytest.approx(start.z - 10.0 * start.grade)
    assert before.curvature == 0.0


def test_cross_slopes_above_the_limit_are_scaled_down_to_it():
    content = wide_map()
    route = content.route("1:+1", superelevation_limit=0.03)
    s = np.linspace(0.0, 100.0, 101)
    exact = content.roads["1"].superelevation.evaluate(s)
    assert np.allclose(route.evaluate(s).superelevation, exact * 0.5, atol=1e-6)
    assert "3.4 degrees are scaled down to 1.7" in route.notes[0]
    assert FORTH.notes == ()


@pytest.fixture(scope="module")
def places():
    line = HIGHWAY.line
    random = np.random.default_rng(3).uniform(-60.0, line.length + 60.0, 2000).tolist()
    return [*random, 0.0, line.length, line.spacing, -1.0, line.length + 1.0]


def test_highway_points_agree_for_scalars_and_arrays(places):
    line = HIGHWAY.line
    offsets = np.random.default_rng(4).uniform(-9.0, 9.0, len(places))
    every = np.array(line.evaluate(np.array(places), offsets))
    each = [line.evaluate(s, o) for s, o in zip(places, offsets.tolist(), strict=True)]
    # Sines and arc tangents of NumPy and of Python may differ in the last bit.
    assert np.allclose(np.array(each).T, every, rtol=1e-14, atol=1e-12)


def test_height_equals_the_height_of_the_point_bit_for_bit(places):
    line = HIGHWAY.line
    assert all(line.height(s) == line.evaluate(s).z for s in places)


def test_cached_pieces_do_not_change_the_points(places):
    line = HIGHWAY.line
    first = [line.evaluate(s, 2.0) for s in places]
    again = [line.evaluate(s, 2.0) for s in reversed(places)]
    assert again[::-1] == first


def signed(*signs, country="DE", types='<type s="0" type="motorway"/>'):
    """A route of 100 m with signs of the German catalogue: type and station of each."""
    texts = "".join(
        f'<signal id="{i}" s="{s}" t="-5" type="{kind}" orientation="{side}" country="{country}"/>'
        for i, (kind, s, side) in enumerate(signs)
    )
    text = document(road(extra=f"{types}<signals>{texts}</signals>"))
    return RoadMap(parse(text.encode(), "signs"), "signs").route()


@pytest.mark.parametrize(
    ("signs", "bans"),
    [
        ((), []),
        ((("277", 10, "+"), ("281", 40, "+"), ("277", 60, "+")), [(10.0, 40.0), (60.0, math.inf)]),
        # A repeated sign begins nothing, and the end of the ban for all leaves that of trucks.
        ((("277", 10, "+"), ("277", 20, "+"), ("280", 30, "+"), ("282", 50, "+")), [(10.0, 50.0)]),
        ((("276", 10, "+"), ("280", 30, "+")), [(10.0, 30.0)]),
        ((("277", 10, "-"), ("274", 20, "+"), ("281", 30, "+")), []),
    ],
)
def test_signs_forbid_trucks_to_overtake_until_a_sign_ends_it(signs, bans):
    assert list(signed(*signs).overtaking_bans) == [pytest.approx(ban) for ban in bans]
    assert signed(*signs, country="SE").overtaking_bans == ()


@pytest.mark.parametrize(
    ("kinds", "countries", "keeps"),
    [
        (("motorway",), ("DE",), True),
        (("motorway", "rural"), ("", "AUT"), True),
        (("motorway", "town"), ("DE", "DE"), False),
        (("motorway",), ("",), False),
        (("motorway",), ("US",), False),
        (("motorway", "motorway"), ("DE", "GB"), False),
    ],
)
def test_a_map_says_by_kind_and_country_whether_vehicles_keep_right(kinds, countries, keeps):
    types = "".join(
        f'<type s="{30 * i}" type="{kind}"' + (f' country="{country}"/>' if country else "/>")
        for i, (kind, country) in enumerate(zip(kinds, countries, strict=True))
    )
    assert signed(types=types).keep_right is keeps


def test_the_built_in_map_and_a_straight_road_name_no_country():
    assert not HIGHWAY.keep_right
    assert not Route.straight().keep_right
