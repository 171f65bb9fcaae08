"""Gaps of a lane change: no collision under full braking; vehicles that count as in the lane."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from controllers.planning.road_preview import RoadPreview
from controllers.planning.safety import SafetyConfig, conflict, front_gap_needed, rear_gap_needed
from iits_mj.core.messages import EgoState, Scene
from iits_mj.road import RoadMap, Route
from tests.controllers.scenes import car

ROUTE = Route.straight(length=3000.0)
PREVIEW = RoadPreview(ROUTE)
CONFIG = SafetyConfig()
EGO = EgoState(station=1000.0, offset=float(ROUTE.lane_offset(0, 1000.0)), speed=16.67)


def target(station=1000.0, preview=PREVIEW):
    return preview.follow(1, station, 400.0, 150.0)


def judged(*vehicles, ego=EGO, limit=0.0, preview=PREVIEW):
    scene = Scene(0.0, ego, vehicles)
    return conflict(scene, target(ego.station, preview), CONFIG, limit=limit)


def least_gap(gap, speed, lead_speed, reaction, braking, lead_braking):
    """Least gap when both brake to a stop, the one behind after its reaction time [m]."""
    time = np.arange(0.0, 30.0, 0.01)

    def way(v, b, delay):
        braked = np.clip(time - delay, 0.0, v / b)
        return v * np.minimum(time, delay) + v * braked - 0.5 * b * braked**2

    return float((gap + way(lead_speed, lead_braking, 0.0) - way(speed, braking, reaction)).min())


@settings(max_examples=60, deadline=None)
@given(own=st.floats(0.0, 25.0), other=st.floats(0.0, 36.0))
def test_no_vehicle_is_hit_when_the_one_in_front_brakes_as_hard_as_it_can(own, other):
    c = CONFIG
    front = front_gap_needed(own, other, c)
    assert least_gap(front, own, other, c.reaction_time, c.truck_braking, c.car_braking) >= 0.0
    rear = rear_gap_needed(own, other, c)
    reaction = c.driver_reaction_time
    assert least_gap(rear, other, own, reaction, c.driver_braking, c.truck_braking) >= 0.0


def test_gaps_grow_with_the_closing_speed_at_the_end_where_it_closes():
    fronts = [front_gap_needed(16.67, v, CONFIG) for v in (16.67, 12.0, 5.0)]
    rears = [rear_gap_needed(16.67, v, CONFIG) for v in (16.67, 20.0, 30.0)]
    assert fronts == sorted(fronts)
    assert rears == sorted(rears)


def test_gaps_are_the_same_for_floats_and_arrays():
    speeds = np.array([0.0, 8.0, 16.0, 24.0])
    for needed in (front_gap_needed, rear_gap_needed):
        each = [needed(16.67, float(v), CONFIG) for v in speeds]
        assert np.allclose(needed(np.full(4, 16.67), speeds, CONFIG), each, rtol=0, atol=1e-12)


def test_a_fast_vehicle_behind_a_slow_one_counts():
    slow = car(ROUTE, "slow", 1000.0 - 15.1 - 2.4 - 25.0, 1, 12.0)
    assert judged(slow) is None
    fast = car(ROUTE, "fast", 1000.0 - 15.1 - 2.4 - 33.0, 1, 25.0)
    assert "fast" in judged(slow, fast)


@pytest.mark.parametrize(("lateral_speed", "free"), [(0.0, True), (0.2, True), (-1.2, False)])
def test_a_vehicle_that_enters_the_target_lane_from_its_far_side_counts(lateral_speed, free):
    far = car(ROUTE, "far", 1010.0, 2, 16.67, lateral_speed=lateral_speed)
    assert (judged(far) is None) is free


def test_a_vehicle_that_leaves_the_target_lane_still_counts():
    leaving = car(ROUTE, "leaving", 1010.0, 1, 16.67, lateral_speed=1.2)
    assert "leaving" in judged(leaving)


def test_a_slow_truck_does_not_change_where_a_vehicle_beyond_sight_may_approach():
    slow = dataclasses.replace(EGO, speed=5.0)
    assert judged(ego=slow, limit=25.0) is None
    blind = dataclasses.replace(CONFIG, sight_behind=60.0)
    assert "sight" in conflict(Scene(0.0, slow), target(), blind, limit=25.0)


def test_a_vehicle_on_a_bridge_above_is_not_in_the_lane():
    route = RoadMap.builtin().route()
    preview = RoadPreview(route)
    offset = float(route.lane_offset(1, 2000.0))
    point = route.evaluate(2000.0, offset)
    ego = dataclasses.replace(EGO, station=2000.0, offset=float(route.lane_offset(0, 2000.0)))
    vehicle = dataclasses.replace(
        car(route, "beside", 1995.0, 1, 16.0), x=float(point.x), y=float(point.y), z=float(point.z)
    )
    assert "beside" in judged(vehicle, ego=ego, preview=preview)
    above = dataclasses.replace(vehicle, z=vehicle.z + 6.0)
    assert judged(above, ego=ego, preview=preview) is None
    lane = preview.follow(1, 2000.0, 400.0, 150.0)
    around = Scene(0.0, ego, (above,)).neighbors
    assert not around.along_path(lane).any()
    assert around.leader_along_path(lane) is None
    assert not around.is_beside(lane)
