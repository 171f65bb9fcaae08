"""Roads from measurements pass smoothly through the measured heights."""

import numpy as np
import pytest

from iits_mj.core.errors import InputError
from iits_mj.road import RoadMap
from iits_mj.road.measured import Lanes, measured_route, road_from_csv, route_from_csv
from iits_mj.road.writer import write
from tests.road.map_peers import convert, netconvert, read_net

STATION = np.arange(0.0, 401.0, 10.0)
TURN = np.linspace(0.0, 5.0, STATION.size)
HEIGHT = 250.0 + 3.0 * np.sin(STATION / 60.0)


def test_the_road_lies_on_the_measured_heights_and_its_grade_is_continuous():
    route = measured_route(STATION, HEIGHT)
    point = route.evaluate(STATION)
    assert np.abs(point.z - HEIGHT).max() < 1e-6
    fine = route.evaluate(np.arange(0.0, 400.0, 0.1))
    assert np.abs(fine.grade - 0.05 * np.cos(np.arange(0.0, 400.0, 0.1) / 60.0)).max() < 2e-3
    assert np.abs(np.diff(fine.grade)).max() < 2e-4


def test_a_straight_road_is_straight_and_as_long_as_its_stations():
    route = measured_route(STATION + 1000.0, HEIGHT)
    point = route.evaluate(STATION)
    assert route.length == pytest.approx(400.0)
    assert np.abs(point.y).max() == 0.0
    assert np.abs(point.curvature).max() == 0.0


def test_curvature_and_first_heading_make_the_plan_view():
    curvature = np.interp(STATION, [0.0, 100.0, 200.0, 400.0], [0.0, 0.002, 0.002, -0.002])
    route = measured_route(STATION, HEIGHT, np.full(STATION.size, 0.3), curvature)
    fine = np.arange(0.0, 400.0, 0.5)
    point = route.evaluate(fine)
    assert np.abs(point.curvature - np.interp(fine, STATION, curvature)).max() < 1e-5
    turned = np.trapezoid(curvature, STATION)
    assert point.heading[0] == pytest.approx(0.3)
    assert float(route.evaluate(400.0).heading) - 0.3 == pytest.approx(turned, abs=1e-4)


def test_lanes_limit_and_friction_are_as_requested():
    route = measured_route(STATION, HEIGHT, lanes=Lanes(3, 3.5, 20.0, 0.4))
    assert route.lane_count(50.0) == 3
    assert route.lane_width(2, 50.0) == pytest.approx(3.5)
    assert route.lane_offset(0, 50.0) == pytest.approx(0.0)
    assert route.speed_limit(50.0) == 20.0
    assert route.friction(50.0, 0.0) == 0.4


def test_a_csv_with_a_byte_order_mark_and_comments_is_read(tmp_path):
    file = tmp_path / "road.csv"
    rows = "\n".join(f"{s:g},{z:.4f}" for s, z in zip(STATION, HEIGHT, strict=True))
    file.write_text(f"﻿# measured\ns_m,z_m\n{rows}\n", encoding="utf-8")
    assert route_from_csv(file).length == pytest.approx(400.0)


@pytest.mark.parametrize(
    ("station", "height", "curvature", "words"),
    [
        (STATION[::-1], HEIGHT, None, "must rise, after 400 m comes 390 m"),
        (STATION, np.where(STATION == 50.0, np.nan, HEIGHT), None, "not finite"),
        (STATION[:2], HEIGHT[:2], None, "3 or more"),
        (STATION, HEIGHT[:-1], None, "equal length"),
        (STATION, np.where(STATION > 200.0, 260.0, 250.0), None, "at most 25 %"),
        (STATION, HEIGHT, np.full(STATION.size, 0.5), "curvature 0.5 1/m"),
    ],
)
def test_columns_that_do_not_describe_a_road_are_refused(station, height, curvature, words):
    with pytest.raises(InputError, match=words):
        measured_route(station, height, curvature=curvature)


@pytest.mark.parametrize("text", ["", "s_m,x\n0,1\n", "s_m,z_m\n0,one\n", "s_m,z_m\n0,1,2\n"])
def test_a_file_that_does_not_describe_a_road_is_refused_by_name(tmp_path, text):
    file = tmp_path / "broken.csv"
    file.write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=r"broken\.csv"):
        route_from_csv(file)


def table(file, **columns):
    rows = np.column_stack(list(columns.values()))
    np.savetxt(file, rows, fmt="%.6f", delimiter=",", header=",".join(columns), comments="")
    return file


def test_the_highway_made_again_of_its_own_points_is_the_same_road(tmp_path):
    highway = RoadMap.builtin().route()
    s = np.linspace(0.0, highway.length, int(highway.length / 10.0) + 1)
    point = highway.evaluate(s)
    file = table(
        tmp_path / "highway.csv", x_m=point.x, y_m=point.y, z_m=point.z,
        superelevation_rad=point.superelevation,
    )  # fmt: skip
    made = RoadMap.from_opendrive(write(road_from_csv(file), tmp_path / "made.xodr")).route()
    fine = np.arange(5.0, highway.length, 7.0)
    ours, theirs = highway.evaluate(fine), made.evaluate(fine)
    assert made.length == pytest.approx(highway.length, abs=0.02)
    assert np.hypot(ours.x - theirs.x, ours.y - theirs.y).max() < 0.02
    assert np.abs(ours.z - theirs.z).max() < 0.01
    assert np.abs(ours.superelevation - theirs.superelevation).max() < 1e-3
    assert np.abs(ours.curvature - theirs.curvature).max() < 2e-4


@pytest.mark.skipif(netconvert() is None, reason="netconvert is not installed")
def test_netconvert_reads_a_made_road_with_the_same_lanes(tmp_path):
    s = np.arange(0.0, 601.0, 20.0)
    file = table(
        tmp_path / "road.csv", s_m=s, curvature_1pm=0.004 * np.sin(s / 100.0), z_m=s / 50.0,
        lanes=np.where(s < 300.0, 2, 3), oncoming_lanes=np.ones_like(s), lane_width_m=3.5 + 0.0 * s,
    )  # fmt: skip
    path = write(road_from_csv(file, centered=True), tmp_path / "road.xodr")
    net = tmp_path / "road.net.xml"
    assert convert(path, net).returncode == 0
    content = RoadMap.from_opendrive(path)
    route = content.route()
    assert [route.lane_count(150.0), route.lane_count(450.0)] == [2, 3]
    compared = {1: 0, -1: 0}
    for lane in read_net(net):
        for x, y, z in lane.shape[2:-2:10]:
            station, offset = route.locate(x, y)
            # Lanes are 3.5 m wide on both sides of the center line.
            assert (offset / 3.5 - 0.5) % 1.0 == pytest.approx(0.0, abs=0.006) or (
                offset / 3.5 - 0.5
            ) % 1.0 == pytest.approx(1.0, abs=0.006)
            assert z == pytest.approx(station / 50.0, abs=0.02)
            compared[int(np.sign(offset))] += 1
    assert min(compared.values()) > 5


@pytest.mark.parametrize(
    ("columns", "words"),
    [
        ({"z_m": HEIGHT}, "s_m, or x_m and y_m, are needed"),
        ({"s_m": STATION, "lanes": np.full(STATION.size, 1.5)}, "lanes is 1.5 at 0 m"),
        ({"s_m": STATION, "superelevation_rad": STATION / 100.0}, "superelevation_rad of 4 is too"),
        ({"x_m": 4.0 * np.cos(TURN), "y_m": 4.0 * np.sin(TURN)}, "bend with a radius of"),
        ({"x_m": STATION % 20.0, "y_m": STATION}, "turns by 90 degrees at point 2"),
        ({"x_m": 0.0 * STATION, "y_m": 0.0 * STATION}, "is that before it"),
    ],
)
def test_a_table_that_is_no_road_is_refused(tmp_path, columns, words):
    with pytest.raises(InputError, match=words):
        road_from_csv(table(tmp_path / "bad.csv", **columns))
