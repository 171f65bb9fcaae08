from __future__ import annotations

import math
import re

import numpy as np
import pytest
from highway_map import MAPS, TABLE, highway, main

from iits_mj.core.errors import InputError
from iits_mj.road import RoadMap
from iits_mj.road.design import Design
from iits_mj.road.geometry import Arc
from iits_mj.road.writer import to_xml
from tests.road.map_peers import netconvert, read_net

MAP = RoadMap.builtin()
ROUTE = MAP.route()
STATION = np.arange(0.0, ROUTE.length, 1.0)
POINT = ROUTE.evaluate(STATION)


def test_shipped_map_equals_the_written_design_table():
    assert (MAPS / "highway.xodr").read_text(encoding="utf-8") == to_xml(highway())


def test_shipped_map_reads_back_as_designed():
    assert MAP.content == highway()
    assert MAP.notes == ()


def test_highway_is_15_km_of_five_linked_roads():
    assert 14_500.0 < ROUTE.length < 15_500.0
    assert [segment.road_id for segment in ROUTE.segments] == ["1", "2", "3", "4", "5"]


def test_roads_join_without_a_step():
    assert ROUTE.chain.seams == ()


def test_arcs_have_500_m_radius_or_more():
    radii = [
        1.0 / abs(geometry.curvature)
        for road in MAP.roads.values()
        for geometry in road.geometries
        if isinstance(geometry, Arc)
    ]
    assert len(radii) > 10
    assert min(radii) >= 500.0
    assert np.abs(POINT.curvature).max() <= 1.0 / 500.0 + 1e-9


def test_curvature_never_jumps():
    assert np.abs(np.diff(POINT.curvature)).max() < 2e-5


def test_grades_reach_but_do_not_exceed_5_percent():
    assert np.abs(POINT.grade).max() <= 0.05 + 1e-9
    assert POINT.grade.max() > 0.045
    assert POINT.grade.min() < -0.045
    # The paper's road: mean magnitude 2.4 %, standard deviation 2.8 %.
    assert 0.02 < np.abs(POINT.grade).mean() < 0.03
    assert 0.025 < POINT.grade.std() < 0.033


def test_vertical_curves_suit_80_km_h():
    # K of at least 26 m per percent of grade change (AASHTO crest curve at 80 km/h).
    assert np.abs(np.diff(POINT.grade)).max() < 0.01 / 26.0


def test_grade_is_the_slope_of_height():
    s = np.arange(10.0, 14_990.0, 7.3)
    slope = (ROUTE.evaluate(s + 0.01).z - ROUTE.evaluate(s - 0.01).z) / 0.02
    assert np.abs(slope - ROUTE.evaluate(s).grade).max() < 1e-5


def test_road_leans_into_its_bends_by_at_most_4_percent():
    assert np.abs(np.tan(POINT.superelevation)).max() <= 0.04 + 1e-6
    bent = np.abs(POINT.curvature) > 1e-4
    assert (POINT.curvature * POINT.superelevation)[bent].max() < 0.0


def test_origin_of_offsets_is_the_center_of_the_right_lane():
    assert np.abs(ROUTE.lane_offset(0, STATION)).max() < 1e-6
    assert np.abs(ROUTE.lane_width(0, STATION) - 4.0).max() < 1e-6


def test_two_lanes_with_three_on_the_climbs():
    counts = np.array([ROUTE.lane_count(float(s)) for s in STATION[::10]])
    assert set(counts) == {2, 3}
    assert 0.55 < (counts == 2).mean() < 0.85


def test_third_lane_opens_and_closes_gradually():
    taper = np.linspace(2800.0, 3000.0, 201)
    width = ROUTE.lane_width(2, taper[1:-1])
    assert width[0] < 0.01
    assert width[-1] > 3.99
    assert np.abs(np.diff(width)).max() < 0.04
    assert not ROUTE.lane_exists(2, 2820.0)
    assert ROUTE.lane_exists(2, 2950.0)
    left = np.array([ROUTE.surface_edges(float(s))[1] for s in np.arange(2700.0, 4600.0, 1.0)])
    assert np.abs(np.diff(left)).max() < 0.04


def test_tunnel_lies_on_the_first_2_km_and_tunnel_and_bridge_have_realistic_lengths():
    ((start, end),) = ROUTE.tunnels
    assert 500.0 <= end - start <= 900.0
    assert end < 1900.0
    ((start, end),) = ROUTE.bridges
    assert 100.0 < end - start < 500.0


def test_speed_limits_are_80_km_h_and_60_in_the_tunnel():
    assert ROUTE.speed_limit(500.0) == 22.22
    assert ROUTE.speed_limit(1300.0, 1) == 16.67
    assert ROUTE.speed_limit(8500.0) == 19.44
    assert [signal.signal.value for signal in ROUTE.signals] == [80.0, 60.0, 80.0, 70.0, 80.0]


def test_paint_divides_lanes_with_broken_and_edges_with_solid_lines():
    assert [ROUTE.boundary_mark(i, 500.0).kind for i in range(3)] == ["solid", "broken", "solid"]
    three = [ROUTE.boundary_mark(i, 3500.0).kind for i in range(4)]
    assert three == ["solid", "broken", "broken", "solid"]


def test_shipped_net_has_every_lane_in_place():
    checked = 0
    for lane in read_net(MAPS / "highway.net.xml"):
        for x, y, z in lane.shape[::10]:
            station, offset = ROUTE.locate(x, y)
            assert offset == pytest.approx(ROUTE.lane_offset(lane.index, station), abs=0.01)
            assert z == pytest.approx(ROUTE.evaluate(station).z, abs=0.01)
            checked += 1
        middle = ROUTE.locate(*lane.shape[len(lane.shape) // 2, :2])[0]
        assert lane.speed == ROUTE.speed_limit(middle, lane.index)
    assert checked > 500


@pytest.mark.skipif(netconvert() is None, reason="netconvert is not installed")
def test_command_reproduces_the_shipped_map_and_net(tmp_path, capsys):
    assert main(["--out", str(tmp_path)]) == 0
    assert "highway.net.xml" in capsys.readouterr().out
    for name in ("highway.xodr", "highway.net.xml"):
        assert (tmp_path / name).read_text() == (MAPS / name).read_text(), name


def test_command_names_a_folder_it_cannot_write_to(tmp_path, capsys):
    assert main(["--out", str(tmp_path / "none")]) == 2
    assert "cannot be written" in capsys.readouterr().err


def test_incomplete_design_table_is_refused(tmp_path):
    path = tmp_path / "table.toml"
    path.write_text(re.sub(r"lane_width = 4.0", "", TABLE.read_text()))
    with pytest.raises(InputError, match="lane_width"):
        Design.load(path)
    path.write_text("= nonsense")
    with pytest.raises(InputError, match=r"design table .* cannot be read"):
        Design.load(path)
    path.write_text(
        re.sub(r"initial_grade = .*", f"initial_grade = {'1' * 400}", TABLE.read_text())
    )
    with pytest.raises(InputError, match=r"an entry of the design table is wrong: int too large"):
        Design.load(path)


def test_design_length_is_the_sum_of_its_elements():
    assert Design.load(TABLE).length == pytest.approx(math.fsum(r.length for r in highway().roads))
