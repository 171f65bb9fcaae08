"""Which vehicles each query counts as ahead, and when boxes touch."""

import math

import numpy as np
import pytest

from controllers.planning.road_preview import RoadPreview
from iits_mj.core.boxes import Boxes, axis_gaps, box_corners
from iits_mj.core.messages import EgoState, Scene, TrackedVehicle
from iits_mj.core.vehicles import VehicleFrame
from iits_mj.road import Route
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
    assert not seen.is_lane_free(ROUTE, 1, 0.0)
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
