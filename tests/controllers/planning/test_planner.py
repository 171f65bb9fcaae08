import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from controllers.planning.config import PlannerConfig, SpeedConfig
from controllers.planning.planner import Planner
from iits_mj.core.angles import wrap_angles
from iits_mj.core.errors import InputError
from iits_mj.core.messages import Decision, EgoFootprint, EgoState, PlanMode, Scene, SpeedProfile
from iits_mj.road import RoadMap, Route
from tests.controllers.scenes import Ideal, RightLaneEnds, at, car

ROUTE = Route.straight(length=5000.0)


@pytest.fixture(scope="module")
def highway():
    return RoadMap.builtin().route()


def test_a_change_into_a_lane_that_does_not_exist_is_refused_with_the_reason():
    drive = Ideal(ROUTE, 500.0, 0, 16.67).run(2.0, (), at(1.0, Decision.RIGHT))
    plan = drive.plans[10]
    assert plan.refused is Decision.RIGHT
    assert "no lane to the right" in plan.reason
    assert plan.mode is PlanMode.LANE_KEEPING
    assert (drive.planner.refused, drive.planner.unsafe) == (1, 0)
    assert abs(drive.ego.offset - float(ROUTE.lane_offset(0, 500.0))) < 1e-6


@pytest.mark.parametrize(("station", "speed"), [(500.0, 16.67), (475.0, 17.5), (508.0, 16.0)])
def test_a_change_beside_or_before_a_vehicle_is_refused_as_unsafe(station, speed):
    other = car(ROUTE, "other", station, 1, speed)
    drive = Ideal(ROUTE, 500.0, 0, 16.67).run(1.0, (other,), at(0.0, Decision.LEFT))
    assert drive.plans[0].refused is Decision.LEFT
    assert "other" in drive.plans[0].reason
    assert drive.planner.unsafe == 1
    assert not drive.planner.changing


def test_a_car_beside_the_trailer_blocks_the_change():
    beside_trailer = car(ROUTE, "beside", 500.0 - 12.0, 1, 16.67)
    drive = Ideal(ROUTE, 500.0, 0, 16.67).run(0.5, (beside_trailer,), at(0.0, Decision.LEFT))
    assert "beside" in drive.plans[0].reason


def test_a_safe_change_reaches_the_target_lane_in_5_to_8_s():
    drive = Ideal(ROUTE, 500.0, 0, 16.67).run(12.0, (), at(1.0, Decision.LEFT))
    assert drive.planner.lane_changes == 1
    assert drive.ego.offset == pytest.approx(float(ROUTE.lane_offset(1, 500.0)), abs=0.02)
    changing = [p for p in drive.plans if p.mode is PlanMode.LANE_CHANGE]
    assert 5.0 <= 0.1 * len(changing) <= 8.0


def test_a_lane_the_truck_may_not_use_is_refused():
    drive = Ideal(ROUTE, 500.0, 1, 16.67).run(0.5, (), at(0.0, Decision.LEFT))
    assert "not one the truck may use" in drive.plans[0].reason


def test_a_second_change_right_after_the_first_is_refused():
    def decide(time):
        return Decision.LEFT if time < 0.05 else Decision.RIGHT

    drive = Ideal(ROUTE, 500.0, 0, 16.67).run(9.0, (), decide)
    assert any("must pass" in plan.reason for plan in drive.plans)


def test_decisions_during_a_change_are_ignored_and_not_counted():
    drive = Ideal(ROUTE, 500.0, 0, 16.67).run(4.0, (), lambda time: Decision.LEFT)
    assert drive.planner.refused == 0
    assert drive.planner.changing


@pytest.mark.parametrize("speed", [8.0, 16.67, 22.0])
def test_the_truck_stops_behind_a_standing_obstacle_with_more_than_2_m(speed):
    obstacle = car(ROUTE, "obstacle", 760.0, 0, 0.0)
    # Only one lane: with a second one the truck keeps more room.
    config = PlannerConfig(lanes=(0,), speed=SpeedConfig(cruise_speed=speed))
    drive = Ideal(ROUTE, 500.0, 0, speed, config).run(60.0, (obstacle,))
    gap = 760.0 - 2.4 - 1.4 - drive.ego.station
    assert drive.ego.speed == 0.0
    assert 2.0 < gap < 6.0
    assert drive.planner.emergencies == 0
    assert min(plan.acceleration[0] for plan in drive.plans) > -2.0


def test_a_leader_at_cruise_speed_beyond_the_time_gap_costs_no_speed():
    leader = car(ROUTE, "leader", 545.0, 0, 16.67)
    drive = Ideal(ROUTE, 500.0, 0, 16.67).run(20.0, (leader,))
    assert min(state.speed for state in drive.states) > 16.6


def test_the_truck_settles_behind_a_slower_leader_at_its_time_gap():
    leader = car(ROUTE, "leader", 620.0, 0, 12.5)
    drive = Ideal(ROUTE, 500.0, 0, 16.67).run(70.0, (leader,))
    gap = 620.0 + 12.5 * 70.0 - 2.4 - 1.4 - drive.ego.station
    assert drive.ego.speed == pytest.approx(12.5, abs=0.1)
    assert 1.2 < gap / 12.5 < 2.3


def test_overtaking_early_costs_little_speed():
    slow = car(ROUTE, "slow", 590.0, 0, 12.5)
    drive = Ideal(ROUTE, 500.0, 0, 16.67).run(15.0, (slow,), at(0.0, Decision.LEFT))
    assert drive.planner.lane_changes == 1
    assert min(state.speed for state in drive.states) > 16.0


def test_a_leader_that_brakes_hard_causes_an_emergency_and_is_not_hit():
    def vehicles(time):
        braking = min(max(time - 2.0, 0.0), 16.67 / 7.0)
        station = 540.0 + 16.67 * (min(time, 2.0) + braking) - 3.5 * braking**2
        speed = max(16.67 - 7.0 * braking, 0.0)
        slowing = -7.0 if 0.0 < braking < 16.67 / 7.0 else 0.0
        return (car(ROUTE, "leader", station, 0, speed, acceleration=slowing),)

    drive = Ideal(ROUTE, 500.0, 0, 16.67).run(15.0, vehicles)
    gap = vehicles(15.0)[0].station - 2.4 - 1.4 - drive.ego.station
    assert drive.planner.emergencies >= 1
    assert any(plan.mode is PlanMode.EMERGENCY for plan in drive.plans)
    assert gap > 1.0
    assert drive.planner.emergencies < 4


@pytest.mark.parametrize("begins", [0.3, 1.0, 1.6])
def test_a_leader_that_brakes_while_the_truck_leaves_its_lane_is_not_hit(begins):
    # It brakes from 16.67 m/s to 3 m/s before the truck is beside it.
    end = begins + (16.67 - 3.0) / 7.0

    def leader(time):
        braking = min(max(time - begins, 0.0), end - begins)
        station = 500.0 + 1.4 + 10.0 + 2.4 + 16.67 * min(time, begins)
        station += 16.67 * braking - 3.5 * braking**2 + 3.0 * max(time - end, 0.0)
        slowing = -7.0 if begins < time < end else 0.0
        return car(ROUTE, "leader", station, 0, 16.67 - 7.0 * braking, acceleration=slowing)

    drive = Ideal(ROUTE, 500.0, 0, 16.67).run(5.0, lambda t: (leader(t),), at(0.0, Decision.LEFT))
    first = next(plan for plan in drive.plans if plan.mode is PlanMode.EMERGENCY)
    assert first.time[0] <= begins + 0.31
    aside = 0.5 * (1.8 + EgoFootprint().width)
    for state in drive.states:
        other = leader(state.time)
        gap = other.station - 2.4 - 1.4 - state.station
        assert gap > 0.3 or abs(state.offset - other.offset) > aside


def test_the_truck_aborts_a_change_when_its_gap_closes_early():
    def vehicles(time):
        # A fast car that is far behind at first, then suddenly near.
        station = 380.0 + 16.67 * time if time < 1.5 else 500.0 - 20.0 + 18.0 * time
        return (car(ROUTE, "racer", station, 1, 18.0),)

    drive = Ideal(ROUTE, 500.0, 0, 16.67).run(12.0, vehicles, at(0.0, Decision.LEFT))
    assert drive.planner.aborted == 1
    assert drive.planner.lane_changes == 0
    assert any(plan.mode is PlanMode.ABORT for plan in drive.plans)
    assert drive.ego.offset == pytest.approx(float(ROUTE.lane_offset(0, 500.0)), abs=0.05)


def test_the_truck_leaves_an_ending_lane_in_time_without_a_decision():
    road = RightLaneEnds(end=800.0)
    drive = Ideal(road, 300.0, 0, 16.67).run(40.0)
    assert drive.planner.lane_changes == 1
    assert drive.ego.offset == pytest.approx(4.0 + float(ROUTE.lane_offset(0, 0.0)), abs=0.05)
    assert drive.ego.station > 850.0
    crossed = next(s.station for s in drive.states if s.offset > 3.8)
    assert crossed < 800.0


def test_the_truck_stops_before_a_lane_end_that_it_cannot_leave():
    road = RightLaneEnds(end=800.0)

    def wall(time):
        return tuple(car(road, f"c{i}", 200.0 + 12.0 * i, 1, 0.0) for i in range(50))

    drive = Ideal(road, 500.0, 0, 14.0).run(42.0, wall)
    room = drive.planner.config.merge.room
    assert drive.ego.speed < 0.05
    assert drive.ego.station + 1.4 == pytest.approx(800.0 - room, abs=3.0)


def test_the_truck_stops_before_the_road_ends():
    road = Route.straight(length=900.0)
    drive = Ideal(road, 500.0, 0, 16.67).run(70.0)
    assert drive.ego.speed < 0.1
    assert 880.0 < drive.ego.station + 1.4 < 900.0


def test_a_lane_continues_where_its_index_shifts():
    drive = Ideal(RightLaneEnds(end=800.0), 600.0, 1, 16.67).run(25.0)
    assert max(abs(s.offset - drive.states[0].offset) for s in drive.states) < 1e-6
    assert drive.plans[-1].target_lane == 0


def test_speed_limits_and_profile_are_kept(highway):
    config = PlannerConfig(speed=SpeedConfig(cruise_speed=25.0))
    drive = Ideal(highway, 500.0, 0, 20.0, config).run(60.0)
    for state in drive.states[50:]:
        assert state.speed <= highway.speed_limit(state.station, 0) + 0.1
    profile = SpeedProfile(np.array([0.0, 5000.0]), np.array([10.0, 10.0]))
    plan = Planner(ROUTE).plan(
        Scene(0.0, EgoState(station=100.0, speed=10.0)), Decision.KEEP, profile
    )
    assert plan.speed[-1] == pytest.approx(10.0, abs=0.05)


@settings(max_examples=40, deadline=None)
@given(data=st.data())
def test_no_planned_trajectory_breaks_its_limits(data):
    planner = Planner(ROUTE)
    lane = data.draw(st.integers(0, 1))
    ego = EgoState(
        station=data.draw(st.floats(200, 4000)),
        offset=float(ROUTE.lane_offset(lane, 0.0)) + data.draw(st.floats(-0.7, 0.7)),
        speed=data.draw(st.floats(0, 24)),
        mass=data.draw(st.floats(19_000, 55_000)),
    )
    vehicles = tuple(
        car(
            ROUTE,
            f"v{i}",
            ego.station + data.draw(st.floats(-120, 200)),
            data.draw(st.integers(0, 2)),
            data.draw(st.floats(0, 25)),
        )
        for i in range(data.draw(st.integers(0, 5)))
    )
    decision = data.draw(st.sampled_from(list(Decision)))
    plan = planner.plan(Scene(0.0, ego, vehicles), decision)
    arrays = [plan.station, plan.offset, plan.x, plan.y, plan.z, plan.yaw, plan.curvature]
    assert all(np.isfinite(array).all() and array.shape == (61,) for array in arrays)
    assert np.all(np.diff(plan.time) > 0.0)
    assert np.all(np.diff(plan.station) >= 0.0)
    assert np.all(plan.speed >= 0.0)
    speed = planner.config.speed
    if plan.mode is PlanMode.EMERGENCY:
        assert plan.acceleration.min() >= -speed.emergency_deceleration - 1e-9
    else:
        assert plan.acceleration.min() >= -speed.following.deceleration_max - 1e-9
    assert plan.acceleration.max() <= speed.following.acceleration_max + 1e-9
    if plan.mode is PlanMode.LANE_CHANGE:
        lateral = plan.curvature * np.maximum(plan.speed, ego.speed) ** 2
        assert np.abs(lateral).max() <= planner.config.change.comfort_acceleration * 1.01


def test_the_same_scenes_give_the_same_plans():
    leader = car(ROUTE, "leader", 620.0, 0, 12.5)
    runs = [Ideal(ROUTE, 500.0, 0, 16.67).run(8.0, (leader,), at(2.0, Decision.LEFT)) for _ in "ab"]
    for first, second in zip(runs[0].plans, runs[1].plans, strict=True):
        assert np.array_equal(first.offset, second.offset)
        assert np.array_equal(first.speed, second.speed)


def test_after_a_reset_the_planner_plans_like_a_new_one():
    drive = Ideal(ROUTE, 500.0, 0, 16.67).run(4.0, (), at(1.0, Decision.LEFT))
    first = drive.planner
    first.reset()
    scene = Scene(0.0, EgoState(station=500.0, speed=16.67))
    fresh = Planner(ROUTE).plan(scene)
    again = first.plan(scene)
    assert np.array_equal(fresh.offset, again.offset)
    assert first.lane_changes == first.refused == 0


def test_a_vehicle_without_a_finite_station_is_named():
    broken = dataclasses.replace(car(ROUTE, "ghost", 520.0, 0, 10.0), station=float("nan"))
    with pytest.raises(InputError, match="ghost"):
        Planner(ROUTE).plan(Scene(0.0, EgoState(station=500.0, speed=10.0), (broken,)))


@pytest.mark.parametrize("name", ["time", "station", "offset", "speed", "mass"])
def test_a_state_that_is_not_finite_is_named(name):
    ego = dataclasses.replace(EgoState(station=500.0, speed=10.0), **{name: float("nan")})
    with pytest.raises(InputError, match=name):
        Planner(ROUTE).plan(Scene(0.0, ego))


def test_a_reference_speed_that_is_not_a_number_is_refused():
    profile = SpeedProfile(np.array([0.0, 5000.0]), np.array([10.0, float("nan")]))
    with pytest.raises(InputError, match="reference speed"):
        Planner(ROUTE).plan(Scene(0.0, EgoState(station=500.0, speed=10.0)), profile=profile)


def test_positions_lie_on_the_road(highway):
    drive = Ideal(highway, 2600.0, 0, 20.0).run(1.0)
    plan = drive.plans[-1]
    point = highway.evaluate(plan.station, plan.offset)
    assert np.allclose(plan.x, point.x)
    assert np.allclose(plan.z, point.z)
    step = np.hypot(np.diff(plan.x), np.diff(plan.y))
    heading = np.arctan2(np.diff(plan.y), np.diff(plan.x))
    middle = 0.5 * (np.unwrap(plan.yaw)[1:] + np.unwrap(plan.yaw)[:-1])
    assert np.abs(wrap_angles(heading - middle)).max() < 2e-3
    assert np.allclose(np.diff(np.unwrap(plan.yaw)) / step, plan.curvature[1:], atol=3e-4)
