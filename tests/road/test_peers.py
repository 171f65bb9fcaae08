"""Our geometry against pyxodr and netconvert on real maps."""

from __future__ import annotations

import numpy as np
import pytest

from iits_mj.core.angles import wrap_angle, wrap_angles
from iits_mj.road import RoadMap, Route
from iits_mj.road.chain import Piece
from iits_mj.road.elements import Road
from iits_mj.road.seams import ContinuousChain
from tests.paths import outside
from tests.road.map_peers import OUTSIDE_MAPS, convert, netconvert, read_net

DISTANCE = 0.05
ANGLE = np.radians(0.5)
BUILTIN = RoadMap.builtin().path
ALL = [*OUTSIDE_MAPS, pytest.param(BUILTIN, id=BUILTIN.stem)]

needs_netconvert = pytest.mark.skipif(netconvert() is None, reason="netconvert is not installed")


def single(content: RoadMap, road: Road, direction: int) -> Route:
    """A route over one road, cross slopes left out as in a SUMO net."""
    ends = (0.0, road.length) if direction > 0 else (road.length, 0.0)
    piece = Piece(road, direction, *ends, 0.0)
    return Route(content, ContinuousChain([piece], "peer", roll_scale=0.0))


@pytest.mark.parametrize("path", ALL)
def test_reference_line_agrees_with_pyxodr(path):
    network = pytest.importorskip("pyxodr.road_objects.network")
    content = RoadMap.from_opendrive(path)
    for peer in network.RoadNetwork(str(path), resolution=0.5).get_roads():
        road = content.roads[str(peer.id)]
        line = np.asarray(peer.reference_line)
        inside = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(line, axis=0).T))))
        s = np.clip(inside, 0.0, road.length)
        # pyxodr's points lie between ours along the road: compare across it, and in height.
        for _ in range(5):
            ours = road.plan.evaluate(s)
            dx, dy = line[:, 0] - ours.x, line[:, 1] - ours.y
            s = s + dx * np.cos(ours.heading) + dy * np.sin(ours.heading)
        ours = road.plan.evaluate(s)
        across = (line[:, 1] - ours.y) * np.cos(ours.heading) - (line[:, 0] - ours.x) * np.sin(
            ours.heading
        )
        assert np.abs(across).max() < DISTANCE, road.id
        assert np.abs(s - inside).max() < 0.6, road.id
        height = np.asarray(peer.z_coordinates)
        assert np.abs(height - road.elevation.evaluate(inside)).max() < DISTANCE, road.id
        # A chord's direction is the heading midway; chords at records' joints may be too short.
        step = line[2:] - line[:-2]
        chord = np.arctan2(step[:, 1], step[:, 0])
        long = np.hypot(*step.T) > 0.8
        middle = road.plan.evaluate(0.5 * (s[2:] + s[:-2])).heading
        assert np.abs(wrap_angles(chord - middle))[long].max() < ANGLE, road.id


@needs_netconvert
@pytest.mark.parametrize("path", OUTSIDE_MAPS)
def test_lanes_agree_with_netconvert(path, tmp_path):
    net = tmp_path / "peer.net.xml"
    assert convert(path, net).returncode == 0
    content = RoadMap.from_opendrive(path)
    routes: dict[tuple[str, int], Route] = {}
    compared = 0
    for lane in read_net(net):
        key = (lane.road_id, lane.direction)
        if key not in routes:
            routes[key] = single(content, content.roads[lane.road_id], lane.direction)
        route = routes[key]
        along = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(lane.shape[:, :2], axis=0).T))))
        if along[-1] < 8.0:
            continue
        # netconvert also imports hard shoulders ("stop"): compare with the nearest driving lane.
        places = np.linspace(2.0, along[-1] - 2.0, max(int(along[-1] / 5.0), 2))
        for d in places:
            x, y, z = (float(np.interp(d, along, lane.shape[:, k])) for k in range(3))
            station, offset = route.locate(x, y)
            index = route.lane_at(station, offset)
            if index < 0:
                assert _is_stop_lane(content.roads[lane.road_id], lane.direction)
                continue
            compared += 1
            assert offset == pytest.approx(route.lane_offset(index, station), abs=DISTANCE)
            assert z == pytest.approx(route.evaluate(station).z, abs=DISTANCE)
            # Mean heading over 4 m, because the net's points are rounded to a centimeter.
            ends = [[np.interp(d + e, along, lane.shape[:, k]) for k in (0, 1)] for e in (-2, 2)]
            direction = np.arctan2(ends[1][1] - ends[0][1], ends[1][0] - ends[0][0])
            stretch = np.linspace(*(route.locate(*end, station)[0] for end in ends), 21)
            heading = route.evaluate(stretch).heading.mean()
            assert abs(wrap_angle(direction - heading)) < ANGLE
    assert compared > 20


def _is_stop_lane(road: Road, direction: int) -> bool:
    return any(lane.kind == "stop" for lane in road.sections[0].side(direction))


@needs_netconvert
def test_netconvert_reads_the_built_in_highway_with_its_tapers(tmp_path):
    result = convert(BUILTIN, tmp_path / "x.net.xml")
    assert result.returncode == 0
    assert "Error" not in result.stderr
    assert len(read_net(tmp_path / "x.net.xml")) > 20


def test_a_direct_junction_joins_both_carriageways_of_a_real_map():
    road_map = RoadMap.from_opendrive(outside("xodr/esmini_soderleden.xodr"))
    assert road_map.notes == ()
    for start in ("2", "1"):
        route = road_map.route(start)
        assert route.segments[-1].road_id == "0"
        assert route.length > 1600.0


@pytest.mark.parametrize("path", ALL)
def test_route_lies_within_a_millimetre_of_the_exact_records(path):
    route = RoadMap.from_opendrive(path).route()
    seams = np.array([seam.p for seam in route.chain.seams])
    for piece in route.chain.pieces:
        p = np.linspace(piece.p_start + 0.1, piece.p_end - 0.1, 777)
        p = p[np.min(np.abs(p[:, None] - seams), axis=1, initial=np.inf) > 50.0]
        s = piece.s_at(p)
        exact = piece.road.plan.evaluate(s)
        point = route.evaluate(route.line.station(p), piece.shift * -1.0)
        assert np.hypot(point.x - exact.x, point.y - exact.y).max(initial=0.0) < 1e-3
        assert np.abs(point.z - piece.road.elevation.evaluate(s)).max(initial=0.0) < 1e-3


@pytest.mark.parametrize("path", OUTSIDE_MAPS)
def test_real_map_gives_a_smooth_drivable_route(path):
    route = RoadMap.from_opendrive(path).route()
    assert route.length > 390.0
    point = route.evaluate(np.arange(0.0, route.length, 0.04))
    assert np.hypot(np.diff(point.x), np.diff(point.y)).max() < 0.0405
    assert np.abs(np.diff(point.grade)).max() < 2e-3
    assert np.abs(point.superelevation).max() <= 0.1 + 1e-6
    assert np.isfinite(route.table(1.0)).all()
    assert all(route.lane_exists(0, float(s)) for s in np.arange(1.0, route.length, 5.0))
