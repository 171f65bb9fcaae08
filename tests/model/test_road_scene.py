"""The drawn road matches the road of the physics, lies above the ground and has no contacts."""

import mujoco
import numpy as np
import pytest
from scipy.interpolate import LinearNDInterpolator

from iits_mj.model.scenery.corridor import Corridor, run_outs
from iits_mj.model.scenery.landscape import OVERLAP, Landscape, is_plain
from iits_mj.model.scenery.paint import MARKING_LIFT, POTHOLE_EDGE, markings
from iits_mj.model.scenery.road_scene import ROAD_GROUP, add_paint, add_road
from iits_mj.model.scenery.streets import Street
from iits_mj.model.scenery.structures import tunnel
from iits_mj.road import RoadMap, Route
from iits_mj.road.unevenness import Unevenness
from iits_mj.suite.scene import turn
from tests.model.meshes import vertices


@pytest.fixture(scope="module")
def highway():
    return RoadMap.builtin().route()


@pytest.fixture(scope="module")
def model(highway):
    spec = mujoco.MjSpec()
    add_road(spec, highway)
    return spec.compile()


@pytest.fixture(scope="module")
def landscape(highway):
    return Landscape(highway, Corridor.sample(highway))


def test_road_has_one_light_and_touches_nothing(model):
    assert model.nlight == 1
    assert model.ngeom < 450
    assert not model.geom_contype.any()
    assert not model.geom_conaffinity.any()
    assert np.all(model.geom_group == ROAD_GROUP)


def test_inside_a_bend_each_stretch_of_road_draws_its_own_ground():
    route = turn()
    corridor = Corridor.sample(route, np.arange(0.0, route.length, 2.0))
    landscape = Landscape(route, corridor)
    ground = [shape for material, shape in landscape.ribbons(corridor) if material == "road_grass"]
    reaches = []
    for shape, edge in zip(ground, (corridor.left, corridor.right), strict=True):
        points = shape.vertices.reshape(len(edge), -1, 3)
        rim = corridor.across(edge)
        reach = np.linalg.norm(points[..., :2] - rim[:, None, :2], axis=-1)
        _, nearest = landscape.height(points[..., 0], points[..., 1])
        # Beyond the middle between two stretches each draws only the overlap.
        assert np.max(reach - nearest) < OVERLAP + 0.5
        reaches.append(reach.max())
    # On the outer side, and away from the bend, the ground extends to the far ground.
    assert min(reaches) > 100.0


def test_drawn_asphalt_and_paint_lie_on_the_road(model, highway):
    for word, lift in (("road_asphalt", 0.0), ("road_marking", MARKING_LIFT)):
        points = vertices(model, word)[::37]
        hint = None
        for x, y, z in points:
            station, offset = highway.locate(x, y, hint)
            if not 0.0 < station < highway.length:
                continue
            road = highway.evaluate(station, offset)
            assert z - float(road.z) == pytest.approx(lift, abs=2e-3)


def test_chords_of_the_asphalt_stay_within_five_millimetres_of_height(highway):
    station = Corridor.sample(highway).station
    middle = 0.5 * (station[1:] + station[:-1])
    inner = (middle > 0.0) & (middle < highway.length)
    for offset in (-4.0, 0.0, 7.0):
        z = highway.evaluate(station, offset).z
        drawn = 0.5 * (z[1:] + z[:-1])
        exact = highway.evaluate(middle, offset).z
        assert np.max(np.abs(drawn - exact)[inner]) < 5e-3


def test_ground_never_rises_through_the_road(highway, landscape):
    station = np.arange(0.0, highway.length, 7.0)
    covered = np.zeros(station.size, dtype=bool)
    for start, end in highway.tunnels:
        covered |= (station > start - 10.0) & (station < end + 10.0)
    right, left = highway.surface_edges(station)
    for share in (0.0, 0.5, 1.0):
        point = highway.evaluate(station, right + share * (left - right))
        for far in (False, True):
            ground, _ = landscape.height(point.x, point.y, far=far)
            assert np.all((ground < point.z - 0.1)[~covered])


def test_far_ground_stays_below_the_road_between_its_grid_points(highway, landscape):
    grid = landscape.grid()
    near, _ = landscape.height(grid.vertices[:, 0], grid.vertices[:, 1], far=True)
    np.testing.assert_allclose(grid.vertices[:, 2], near)
    surface = LinearNDInterpolator(grid.vertices[:, :2], grid.vertices[:, 2])
    for offset in (-4.0, 7.0):
        point = highway.evaluate(np.arange(0.0, highway.length, 5.0), offset)
        assert np.all(surface(point.x, point.y) < point.z - 0.5)


def test_tunnel_is_below_ground_and_bridge_above(highway, landscape):
    for intervals, sign in ((highway.tunnels, 1.0), (highway.bridges, -1.0)):
        assert intervals
        for start, end in intervals:
            point = highway.evaluate(np.linspace(start + 5.0, end - 5.0, 40), 1.0)
            ground, _ = landscape.height(point.x, point.y)
            assert np.all(sign * (ground - point.z) > 0.5)


def test_dashes_are_six_meters_long_every_fifteen(highway):
    street, corridor = Street.of_route(highway), Corridor.sample(highway)
    paint = markings(street, corridor, 2500.0, 2800.0)["road_marking"]
    stations = sorted(
        round(highway.locate(x, y, 2600.0)[0], 1)
        for x, y, _ in paint.vertices
        if abs(highway.locate(x, y, 2600.0)[1] - 2.0) < 0.2
    )
    starts = sorted({s for s in stations if abs(s / 15.0 - round(s / 15.0)) < 1e-3})
    assert len(starts) >= 19
    assert {round(s + 6.0, 1) for s in starts} <= set(stations)


def test_straight_level_road_is_a_plain_and_a_curved_one_is_not(highway):
    assert is_plain(Route.straight())
    assert is_plain(Route.straight(grade=0.05))
    assert not is_plain(highway)


def test_sloping_straight_road_lies_on_its_plain():
    spec = mujoco.MjSpec()
    route = Route.straight(length=3000.0, grade=0.05)
    add_road(spec, route)
    model = spec.compile()
    plane = model.geom("road_plain")
    rotation = np.empty(9)
    mujoco.mju_quat2Mat(rotation, plane.quat)
    normal = rotation.reshape(3, 3)[:, 2]
    point = route.evaluate(np.linspace(0.0, 3000.0, 7))
    height = (np.stack([point.x, point.y, point.z], axis=-1) - plane.pos) @ normal
    assert np.all((height > 0.2) & (height < 0.3))


def test_open_route_gets_run_outs(highway):
    assert run_outs(highway) == (400.0, 400.0)


def test_tunnel_curbs_and_floor_cover_the_ground_on_both_sides(highway):
    parts = list(tunnel(Corridor.sample(highway), *highway.tunnels[0]))
    curbs = next(shape for material, shape in parts if material == "road_curb")
    a, b, c = (curbs.vertices[curbs.faces[:, i]] for i in range(3))
    normal = np.cross(b - a, c - a)
    up = normal[:, 2] > 0.9 * np.linalg.norm(normal, axis=1)
    station = 0.5 * sum(highway.tunnels[0])
    right, left = (float(edge) for edge in highway.surface_edges(station))
    for offset in (right - 0.5, left + 0.5):
        point = highway.evaluate(station, offset)
        middle = (a + b + c)[up] / 3.0
        assert np.min(np.hypot(middle[:, 0] - point.x, middle[:, 1] - point.y)) < 10.0
        across = np.array([highway.locate(x, y, station)[1] for x, y, _ in middle[::9]])
        assert np.any(np.abs(across - offset) < 0.4)


def test_potholes_are_drawn_where_the_tires_feel_them(highway):
    uneven = Unevenness(potholes=20.0, seed=3)
    spec = mujoco.MjSpec()
    add_road(spec, highway.with_unevenness(uneven))
    model = spec.compile()
    holes = vertices(model, "road_pothole")
    corners = holes.reshape(-1, len(POTHOLE_EDGE), 3)
    route = highway.with_unevenness(uneven)
    for hole in corners[:: len(corners) // 20]:
        middle = hole.mean(axis=0)
        station, offset = route.locate(*middle[:2], None)
        right, left = route.surface_edges(station)
        assert right < offset < left
        assert uneven.height(station, offset) < -0.003
        size = np.ptp(hole[:, :2], axis=0).max()
        assert 0.25 < size < 1.1
        road = float(route.evaluate(station, offset).z)
        assert road < middle[2] < road + MARKING_LIFT
    # On both lanes and the shoulder, by their number per kilometer of lane.
    width = np.mean(np.subtract(*highway.surface_edges(np.linspace(0.0, highway.length, 50))[::-1]))
    expected = 20.0 * highway.length / 1000.0 * width / 3.5
    assert len(corners) == pytest.approx(expected, rel=0.2)


def test_paint_far_from_the_route_is_left_out(highway):
    spec = mujoco.MjSpec()
    add_road(spec, highway)
    point = highway.evaluate(500.0)
    corners = np.array([[0.0, 0.0], [3.0, 0.0], [3.0, 0.5], [0.0, 0.5]])
    near, far = (
        np.column_stack([x + corners[:, 0], point.y + corners[:, 1], np.full(4, point.z)])
        for x in (point.x, 5e4)
    )
    add_paint(spec, highway, [near, far], [], [])
    model = spec.compile()
    (geom,) = (g for g in range(model.ngeom) if "_paint" in model.geom(g).name)
    points = vertices(model, model.geom(geom).name)
    assert points[:, 0].max() < point.x + 4.0
    assert points[:, 2] == pytest.approx(float(point.z), abs=0.05)
    assert model.geom_contype[geom] == 0
