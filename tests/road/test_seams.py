from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from iits_mj.road import RoadMap, Route
from iits_mj.road.opendrive import parse
from tests.road.opendrive_text import LANES, document, line, road, successor


def two_roads(
    along: float = 0.0,
    across: float = 0.0,
    turn: float = 0.0,
    rise: float = 0.0,
    grades: tuple[float, float] = (0.0, 0.0),
    rolls: tuple[float, float] = (0.0, 0.0),
    lanes: str = LANES,
) -> Route:
    """Two straight roads of 200 m with a faulty joint at x = 200."""

    def profiles(a: float, b: float, roll: float) -> dict[str, str]:
        return {
            "elevation": f'<elevation s="0" a="{a}" b="{b}" c="0" d="0"/>',
            "extra": "<lateralProfile>"
            f'<superelevation s="0" a="{roll}" b="0" c="0" d="0"/></lateralProfile>',
        }

    first = road(
        "1",
        geometry=line(0.0, length=200.0),
        length=200,
        link=successor("2"),
        **profiles(5.0, grades[0], rolls[0]),
    )
    second = road(
        "2",
        geometry=line(200.0 + along, across, turn, 200.0),
        length=200,
        lanes=lanes,
        **profiles(5.0 + 200.0 * grades[0] + rise, grades[1], rolls[1]),
    )
    return RoadMap(parse(document(first, second).encode(), "dirty"), "dirty").route()


def largest_steps(route: Route, step: float) -> dict[str, float]:
    station = np.arange(0.0, route.length, step)
    point = route.evaluate(station, -2.0)
    direction = np.arctan2(np.diff(point.y), np.diff(point.x))
    return {
        "position": float(np.hypot(np.diff(point.x), np.diff(point.y)).max()),
        "direction": float(np.abs(np.diff(direction)).max()),
        "height": float(np.abs(np.diff(point.z)).max()),
        "grade": float(np.abs(np.diff(point.grade)).max()),
        "roll": float(np.abs(np.diff(point.superelevation)).max()),
    }


@settings(max_examples=20, deadline=None)
@given(
    along=st.floats(-1.0, 1.0),
    across=st.floats(-0.25, 0.25),
    turn=st.floats(-0.01, 0.01),
    rise=st.floats(-0.5, 0.5),
    before=st.floats(-0.05, 0.05),
    after=st.floats(-0.05, 0.05),
)
def test_faulty_joint_is_smooth_in_steps_of_4_cm(along, across, turn, rise, before, after):
    route = two_roads(along, across, turn, rise, (before, after))
    steps = largest_steps(route, 0.04)
    assert steps["position"] < 0.041
    assert steps["direction"] < 0.04 * 4e-3
    assert steps["grade"] < 0.04 * 2e-2
    assert steps["height"] < 0.04 * 0.12


@settings(max_examples=20, deadline=None)
@given(
    along=st.floats(-1.0, 1.0),
    across=st.floats(-0.25, 0.25),
    rise=st.floats(-0.5, 0.5),
    before=st.floats(-0.05, 0.05),
    after=st.floats(-0.05, 0.05),
)
def test_route_is_exact_away_from_a_faulty_joint(along, across, rise, before, after):
    route = two_roads(along, across, 0.0, rise, (before, after))
    for station, offset in ((100.0, -1.0), (140.0, 2.0)):
        point = route.evaluate(station, offset)
        expected = (station, offset, 5.0 + before * station)
        assert (point.x, point.y, point.z) == pytest.approx(expected, abs=1e-6)
    for x in (260.0, 300.0):
        station, offset = route.locate(x, across)
        s = x - 200.0 - along
        assert offset == pytest.approx(0.0, abs=1e-6)
        height = 5.0 + 200.0 * before + rise + after * s
        assert route.evaluate(station).z == pytest.approx(height, abs=1e-6)


@pytest.mark.parametrize("along", [-0.8, 0.8])
def test_overlap_is_trimmed_and_gap_is_bridged(along):
    route = two_roads(along)
    assert route.length == pytest.approx(400.0 + along, abs=1e-3)
    x = route.evaluate(np.arange(0.0, route.length, 0.5)).x
    assert np.allclose(np.diff(x), 0.5, atol=1e-6)


def test_grade_step_of_20_percent_is_blended():
    route = two_roads(grades=(0.0, 0.2))
    assert largest_steps(route, 0.04)["grade"] < 1e-3
    assert np.abs(route.evaluate(np.arange(0.0, 180.0, 1.0)).grade).max() < 1e-9


def test_cross_slope_step_is_blended():
    assert largest_steps(two_roads(rolls=(0.0, 0.04)), 0.04)["roll"] < 2e-4


def test_reference_line_is_kept_where_the_next_road_has_another():
    # The second road's reference line is 3.5 m to the left; its lanes lie one lane further out.
    lanes = LANES.replace(
        '<lane id="-1"',
        '<lane id="-2" type="driving"><width sOffset="0" a="3.5"/></lane><lane id="-1"',
    )
    route = two_roads(across=3.5, lanes=lanes)
    y = route.evaluate(np.arange(0.0, route.length, 1.0)).y
    assert np.allclose(y, 0.0, atol=1e-9)
    assert route.lane_offset(0, 100.0) == pytest.approx(-1.75)
    assert route.lane_count(300.0) == 2
    assert route.lane_offset(0, 300.0) == pytest.approx(-1.75)
    assert route.lane_offset(1, 300.0) == pytest.approx(1.75)


def test_station_stays_arc_length_beside_a_bend():
    # A bend of 20 m radius followed 3 m outside its reference line is 23 m long per radian.
    bend = '<geometry s="0" x="200" y="3" hdg="0" length="20"><arc curvature="0.05"/></geometry>'
    first = road("1", geometry=line(0.0, length=200.0), length=200, link=successor("2"))
    second = road("2", geometry=bend, length=20)
    route = RoadMap(parse(document(first, second).encode(), "bend"), "bend").route()
    assert route.length == pytest.approx(223.0, abs=2e-3)
    point = route.evaluate(np.linspace(0.0, route.length, 4001))
    travelled = np.hypot(np.diff(point.x), np.diff(point.y)).sum()
    assert travelled == pytest.approx(route.length, abs=2e-3)
    assert route.evaluate(212.0).curvature == pytest.approx(1.0 / 23.0, rel=1e-3)
