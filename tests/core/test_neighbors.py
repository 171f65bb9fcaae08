"""Which vehicles each query counts as ahead, and when boxes touch."""

import dataclasses
import math

import numpy as np
import pytest

from controllers.planning.road_preview import RoadPreview
from iits_mj.core.angles import wrap_angles
from iits_mj.core.boxes import Boxes, axis_gaps, box_corners
from iits_mj.core.messages import EgoFootprint, EgoState, Scene, TrackedVehicle
from iits_mj.core.neighbors import ALONG
from iits_mj.core.vehicles import VehicleFrame
from iits_mj.road import RoadMap, Route
from tests.core.box_distance import box_distance, separation

ROUTE = Route.straight(length=3000.0, lanes=2)
PREVIEW = RoadPreview(ROUTE)
RIGHT, LEFT = (float(ROUTE.lane_offset(lane, 1000.0)) for lane in (0, 1))
EGO = EgoState(station=1000.0, offset=RIGHT, speed=16.0)


def around(*vehicles):
    return Scene(0.0, EGO, vehicles).neighbors


def test_a_vehicle_that_will_change_into_the_lane_leads_along_the_path_but_not_in_the_lane():
    cutting_in = TrackedVehicle("a", station=1040.0, offset=LEFT, lane=1, lateral_speed=-1.8)
    seen = around(cutting_in)
    assert seen.leader_along_path(PREVIEW.follow(0, 1000.0, 400.0)).id == "a"
    assert seen.leader_in_lane(ROUTE, 0) is None
    assert seen.leader_in_lane(ROUTE, 1).id == "a"


def test_a_vehicle_beside_the_trailer_is_a_follower_in_the_lane_and_behind_by_its_front():
    beside = TrackedVehicle("a", station=995.0, offset=LEFT, lane=1)
    seen = around(beside)
    assert seen.follower_in_lane(ROUTE, 1).gap < 0.0
    assert seen.least_gap(ROUTE, 1) < 0.0
    assert seen.is_beside(PREVIEW.follow(1, 1000.0, 400.0))
    ahead, behind = seen.nearest_by_front(250.0, 50.0)
    assert (len(ahead), behind.tolist()) == (0, [0])


def test_a_vehicle_off_the_route_is_ahead_in_the_corridor_only():
    crossing = TrackedVehicle("a", station=1030.0, offset=RIGHT, lane=-1)
    seen = around(crossing)
    assert seen.corridor_gaps(0)[0] == pytest.approx(30.0 - 2.4 - 1.4)
    assert seen.leader_in_lane(ROUTE, 0) is None
    assert seen.nearest_by_front(250.0, 50.0)[0].size == 0


def test_rows_and_columns_make_the_same_neighbors():
    vehicles = [
        TrackedVehicle(str(k), station=1000.0 + 9.3 * k, offset=k % 3, lane=k % 2) for k in range(9)
    ]
    rows, columns = around(*vehicles), Scene(0.0, EGO, VehicleFrame.of(vehicles)).neighbors
    assert rows.ids == columns.ids
    for name in ("gap", "station", "offset", "lane", "front_distance"):
        np.testing.assert_array_equal(getattr(rows, name), getattr(columns, name))


def in_numpy(seen, path, entering):
    """Vehicles on the level, surely along the road, in the path, and the leader's index."""
    road = path.road
    bank = np.interp(seen.station, road.station, road.superelevation)
    height = np.interp(seen.station, road.station, road.height) + seen.offset * np.tan(bank)
    level = ~seen.posed | (np.abs(seen.z - height) < 3.0)
    rows = np.clip(np.rint(seen.station / road.step), 0, len(road.station) - 1).astype(int)
    angle = np.abs(wrap_angles(seen.yaw - road.heading[rows]))
    along = seen.posed & (seen.speed >= 0.0) & (angle < ALONG - road.swing[rows])
    middle = np.interp(seen.station, path.station, path.offset)
    reach = path.half_width + 0.5 * seen.width - 0.3
    places = [seen.offset, seen.offset + seen.lateral_speed]
    inside = np.any([np.abs(place - middle) < reach for place in places], axis=0)
    if entering:
        later = seen.offset + entering * seen.lateral_speed
        through = (seen.offset - middle) * (later - middle) < 0.0
        crosses = (np.abs(later - middle) < reach) | through
        inside |= (np.abs(seen.lateral_speed) > 0.3) & crosses
    inside &= (seen.station >= path.station[0]) & (seen.station <= path.station[-1])
    inside &= (seen.station <= path.end) & level
    ahead = np.flatnonzero(inside & (seen.station > seen.front))
    leader = ahead[seen.gap[ahead].argmin()] if ahead.size else None
    return level, along, inside, leader


def corridor_in_numpy(seen, lane):
    """Bumper gaps ahead of and behind the truck's corridor."""
    inside = np.abs(seen.offset - EGO.offset) < 0.5 * (seen.width + EgoFootprint().width)
    inside |= (seen.lane == lane) & (lane >= 0)
    inside &= (seen.lane >= 0) | (np.abs(seen.z - EGO.z) < 4.5)
    ahead = seen.station >= 0.5 * (seen.front + seen.rear)
    return tuple(float(np.min(seen.gap[inside & half], initial=np.inf)) for half in (ahead, ~ahead))


def test_queries_agree_with_their_numpy_form():
    route = RoadMap.builtin().route()
    preview = RoadPreview(route)
    generator = np.random.default_rng(7)
    leaders = 0
    for _ in range(60):
        here = float(generator.uniform(200.0, route.length - 200.0))
        vehicles = []
        for k in range(int(generator.integers(0, 40))):
            station = here + float(generator.uniform(-200.0, 200.0))
            offset = float(generator.uniform(-8.0, 8.0))
            point = route.evaluate(station, offset)
            posed = generator.random() < 0.8
            pose = {
                "x": float(point.x),
                "y": float(point.y),
                "z": float(point.z) + float(generator.choice([0.0, 2.9, 3.1, -6.0])),
                "yaw": float(point.heading) + float(generator.choice([0.0, 0.3, 0.4, np.pi])),
            }
            vehicles.append(
                TrackedVehicle(
                    f"{k:02}",
                    station=station,
                    offset=offset,
                    speed=float(generator.uniform(-1.0, 20.0)),
                    lateral_speed=float(generator.choice([0.0, 0.2, 1.0, -2.0])),
                    lane=int(generator.integers(-1, 3)),
                    **(pose if posed else {}),
                )
            )
        ego = dataclasses.replace(EGO, station=here)
        for given in (vehicles, VehicleFrame.of(vehicles)):
            seen = Scene(0.0, ego, given).neighbors
            half = 0.5 * seen.length
            gap = np.maximum(seen.station - half - seen.front, seen.rear - seen.station - half)
            assert np.array_equal(seen.gap, gap)
            assert np.array_equal(seen.front_distance, seen.station + half - seen.front)
            for lane in (0, 1):
                path = preview.follow(lane, here, 400.0, 150.0)
                for entering in (0.0, 2.0):
                    level, along, inside, leader = in_numpy(seen, path, entering)
                    assert np.array_equal(seen.on_level(preview), level)
                    assert np.array_equal(seen.surely_along(preview), along)
                    assert seen.all_along(preview) is bool(along[level].all())
                    assert np.array_equal(seen.along_path(path, entering), inside)
                    if entering == 0.0:
                        leaders += leader is not None
                        expected = None if leader is None else seen.neighbor(int(leader))
                        assert seen.leader_along_path(path) == expected
                assert seen.corridor_gaps(lane) == corridor_in_numpy(seen, lane)
            assert seen.corridor_gaps(-1) == corridor_in_numpy(seen, -1)
    assert leaders > 50


def test_separation_is_a_lower_bound_of_the_distance_and_boxes_touch_where_it_is_not_positive():
    random = np.random.default_rng(3)
    touching = 0
    for x, y, yaw, length in random.uniform((-9, -9, -4, 2), (9, 9, 4, 9), (300, 4)).tolist():
        one = box_corners(0.0, 0.0, 0.4, 3.0, 3.0, 2.0)
        other = box_corners(x, y, yaw, 0.5 * length, 0.5 * length, 1.5)
        least, distance = separation(one, other), box_distance(one, other)
        assert least <= distance + 1e-9
        assert (distance == 0.0) is (least <= 0.0)
        first, second = (
            Boxes(*(np.array([v]) for v in values))
            for values in ((0.0, 0.0, 0.4, 6.0, 2.0), (x, y, yaw, length, 1.5))
        )
        assert bool(first.touch(second, 0.0)) is (distance == 0.0)
        touching += distance == 0.0
    assert 20 < touching < 280


def test_axis_gaps_of_two_squares_in_a_row():
    ahead = (math.cos(0.0), math.sin(0.0), 1.0, 1.0)
    assert axis_gaps(5.0, 0.0, ahead, ahead) == (3.0, -2.0, 3.0, -2.0)
