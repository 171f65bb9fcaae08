"""The map about a route is drawn: other roads, junctions, bridges; nothing of it has contacts."""

import math

import mujoco
import numpy as np
import pytest

from iits_mj.model.scenery.network import REACH, network
from iits_mj.model.scenery.road_scene import add_road
from iits_mj.road import RoadMap
from iits_mj.road.opendrive import parse
from tests.model.crossing import ARM, HALF, LANE, SIDEWALK, crossing, lane, lanes, overpass
from tests.model.meshes import vertices
from tests.road.opendrive_text import document, line, road

PAVED = ("road_asphalt", "road_marking", "road_border")


def scene(text, start=None):
    """Returns the compiled scenery of a map, with its state and route."""
    route = RoadMap(parse(text.encode(), "map"), "map").route(start)
    spec = mujoco.MjSpec()
    add_road(spec, route)
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return model, data, route


def seen(model, data, x, y, height=50.0, down=-1.0):
    """Returns name and height of what is seen from a height, looking down (or up, +1)."""
    # A ray through a mesh's plane of symmetry may miss it.
    geom, start = np.array([-1], dtype=np.int32), np.array([x + 0.0137, y + 0.0071, height])
    distance = mujoco.mj_ray(model, data, start, np.array([0, 0, down]), None, 1, -1, geom)
    name = model.geom(int(geom[0])).name if geom[0] >= 0 else ""
    return name, height + down * distance


@pytest.fixture(scope="module")
def town():
    return scene(crossing(), "0:-1")


def test_map_touches_nothing(town):
    model, _, _ = town
    assert not model.geom_contype.any()
    assert not model.geom_conaffinity.any()
    assert model.body_mass.sum() == 0.0


def test_lanes_of_roads_off_the_route_are_asphalt(town):
    model, data, route = town
    assert {segment.road_id for segment in route.segments} == {"0", "02", "2"}
    for y in np.arange(HALF, HALF + ARM, 3.0):
        for x in (-0.5 * LANE, 0.5 * LANE):
            for sign in (-1.0, 1.0):
                name, z = seen(model, data, x, sign * y)
                assert name.startswith(PAVED)
                assert z == pytest.approx(0.0, abs=0.1)


def test_whole_area_of_a_junction_is_asphalt(town):
    model, data, _ = town
    for x in np.arange(-HALF, HALF, 1.7):
        for y in np.arange(-HALF, HALF, 1.7):
            if abs(x) + abs(y) < HALF + LANE - 0.2:
                assert seen(model, data, x, y)[0].startswith(PAVED)


def test_paths_of_turning_vehicles_lie_on_asphalt(town):
    model, data, route = town
    for name, turn in route.road_map.roads.items():
        if turn.junction is None:
            continue
        point = turn.plan.evaluate(np.linspace(0.0, turn.length, 15))
        x = point.x + 0.5 * LANE * np.sin(point.heading)
        y = point.y - 0.5 * LANE * np.cos(point.heading)
        for place in zip(x, y, strict=True):
            assert seen(model, data, *place)[0].startswith(PAVED), name


def test_sidewalk_lies_beside_the_lanes_and_grass_beyond(town):
    model, data, _ = town
    for sign in (-1.0, 1.0):
        edge = sign * (LANE + 0.5 * SIDEWALK)
        assert seen(model, data, edge, 60.0)[0].startswith("road_sidewalk")
        assert seen(model, data, 60.0, edge)[0].startswith("road_sidewalk")
        assert seen(model, data, sign * 20.0, 60.0)[0].startswith("road_grass")


def test_ground_has_no_hole_about_a_junction(town):
    model, data, _ = town
    for x in np.arange(-90.0, 90.0, 7.3):
        for y in np.arange(-90.0, 90.0, 7.1):
            # The far ground is only seen through a hole in the near one.
            assert seen(model, data, x, y)[0] != "road_terrain"


def test_no_paint_crosses_a_junction(town):
    model, _, _ = town
    paint = vertices(model, "road_marking")
    middle = np.hypot(paint[:, 0], paint[:, 1]) < 0.5 * HALF
    assert len(paint) > 100
    assert not middle.any()


def test_road_under_a_bridge_is_free():
    model, data, route = scene(overpass(), "low")
    assert network(route).bridges["high"]
    for x in np.arange(189.5, 211.0, 2.0):
        name, z = seen(model, data, x, -2.0, height=3.0)
        assert name.startswith(PAVED)
        assert z == pytest.approx(0.0, abs=0.1)
    deck, z = seen(model, data, 200.0, -2.0, height=3.0, down=1.0)
    assert deck.startswith("road_concrete")
    assert z == pytest.approx(7.0 - 1.5, abs=0.2)
    top, z = seen(model, data, 201.0, 0.0)
    assert top.startswith(PAVED)
    assert z == pytest.approx(7.0, abs=0.05)


def test_route_over_another_road_has_no_ground_on_it():
    model, data, route = scene(overpass(), "high")
    assert network(route).bridges[""]
    name, z = seen(model, data, 200.0, -2.0, height=3.0)
    assert name.startswith(PAVED)
    assert z == pytest.approx(0.0, abs=0.1)


def test_roads_beyond_the_reach_are_not_drawn():
    far = document(
        road("1", line(0.0), 100),
        road("2", line(0.0, REACH - 50.0), 100),
        road("3", line(0.0, REACH + 50.0), 100),
    )
    _, _, route = scene(far, "1")
    assert set(network(route).others) == {"2"}


def test_road_alone_has_no_network():
    route = RoadMap(parse(document(road()).encode(), "map"), "map").route()
    assert network(route) is None


def test_markings_have_their_color_and_number_of_lines():
    both = lane(-1, "driving", LANE, "solid", "red"), lane(1, "driving", LANE, "broken", "blue")
    text = document(road(lanes=lanes(*both, center="solid solid", color="yellow")))
    model, _, _ = scene(text)
    yellow = vertices(model, "road_marking_yellow")
    # Two lines of 0.15 m with 0.15 m between them: edges at 0.075 and 0.225 m on both sides.
    edges = np.unique(np.round(yellow[:, 1], 3))
    np.testing.assert_allclose(edges, [-0.225, -0.075, 0.075, 0.225], atol=2e-3)
    red, blue = vertices(model, "road_marking_red"), vertices(model, "road_marking_blue")
    assert np.median(red[:, 1]) == pytest.approx(-LANE, abs=0.1)
    assert np.median(blue[:, 1]) == pytest.approx(LANE, abs=0.1)
    inside = blue[(blue[:, 0] > 0.0) & (blue[:, 0] < 100.0)]
    starts = np.unique(np.round(inside[:, 0], 2))
    assert {round(start % 15.0, 2) for start in starts} == {0.0, 6.0}


def test_a_route_that_starts_at_a_junction_has_no_road_beyond_it(town):
    model, data, route = town
    start, end = route.evaluate(0.0), route.evaluate(route.length)
    assert math.hypot(float(start.x), float(start.y)) == pytest.approx(HALF + ARM)
    outside = seen(model, data, float(end.x) - 200.0, float(end.y))[0]
    # The map ends there, so the road goes on for the run-out.
    assert outside.startswith(PAVED)
