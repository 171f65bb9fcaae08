"""Emergency braking: stops before walls where physics allows, none for ordinary cut-ins."""

import dataclasses

import numpy as np
import pytest

from controllers.planning.config import PlannerConfig, SpeedConfig
from iits_mj.core.messages import PlanMode
from iits_mj.road import Route
from iits_mj.validation.planning.planner_limits import ordinary_drive
from iits_mj.validation.planning.stops import wall_stop
from tests.controllers.scenes import Ideal, car

ROUTE = Route.straight(length=5000.0)
LENGTH = 4.8


def drive(speed, duration, vehicles):
    config = PlannerConfig(speed=SpeedConfig(cruise_speed=speed))
    return Ideal(ROUTE, 500.0, 0, speed, config).run(duration, vehicles)


def at_gap(gap, speed=0.0, lane=0, **fields):
    """A car whose rear is `gap` meters ahead of the truck's bumper at station 500."""
    return car(ROUTE, "other", 500.0 + 1.4 + gap + 0.5 * LENGTH, lane, speed, **fields)


def left(drive, vehicle):
    """Gap at the end [m]."""
    moved = vehicle.station + vehicle.speed * drive.ego.time
    return moved - 0.5 * LENGTH - (drive.ego.station + 1.4)


@pytest.mark.parametrize("sight", [55.0, 70.0, 90.0, 130.0, 200.0])
def test_a_wall_seen_at_90_km_h_is_not_hit_if_6_5_m_per_s2_are_enough(sight):
    # 25 m/s need 48 m at 6.5 m/s2.
    wall = at_gap(sight)
    run = drive(25.0, 25.0, (wall,))
    assert run.ego.speed < 0.05
    assert left(run, wall) > 0.5


def test_an_emergency_stop_ends_near_its_wall():
    # 25 m/s and 100 m need 3.7 m/s2 with the brakes' reaction.
    wall = at_gap(100.0)
    run = drive(25.0, 25.0, (wall,))
    assert run.planner.emergencies == 1
    assert 0.5 < left(run, wall) < 8.0
    assert min(plan.acceleration[0] for plan in run.plans) > -5.2


def test_a_wall_seen_from_far_is_no_emergency():
    run = drive(25.0, 30.0, (at_gap(240.0),))
    assert run.planner.emergencies == 0


def test_where_physics_does_not_allow_a_stop_the_truck_brakes_as_hard_as_it_can():
    run = drive(25.0, 1.0, (at_gap(20.0),))
    assert all(plan.mode is PlanMode.EMERGENCY for plan in run.plans[:5])
    assert run.plans[0].acceleration[0] == -PlannerConfig().speed.emergency_deceleration


@pytest.mark.parametrize(
    ("gap", "speed"), [(8.0, 16.67), (6.0, 18.0), (15.0, 14.5), (25.0, 12.0), (35.0, 8.0)]
)
def test_a_cut_in_that_needs_no_hard_braking_is_no_emergency(gap, speed):
    run = drive(16.67, 12.0, (at_gap(gap, speed),))
    assert run.planner.emergencies == 0
    assert min(plan.acceleration[0] for plan in run.plans) > -3.0


def test_a_cut_in_that_closes_fast_is_an_emergency_without_contact():
    intruder = at_gap(14.0, 7.0)
    run = drive(16.67, 12.0, (intruder,))
    assert run.planner.emergencies == 1
    assert left(run, intruder) > 1.0
    gaps = [intruder.station + 7.0 * s.time - 0.5 * LENGTH - s.station - 1.4 for s in run.states]
    assert min(gaps) > 0.5


def test_a_vehicle_close_by_in_the_next_lane_is_no_emergency():
    beside = at_gap(5.0, 0.0, lane=1)
    assert drive(16.67, 3.0, (beside,)).planner.emergencies == 0


def test_emergency_braking_ends_at_once_when_the_obstacle_is_gone():
    wall = at_gap(40.0)
    run = drive(20.0, 4.0, lambda time: (wall,) if time < 1.0 else ())
    assert run.planner.emergencies == 1
    released = [plan.acceleration[0] for plan in run.plans[10:12]]
    assert min(released) >= -PlannerConfig().speed.following.deceleration_max


@pytest.mark.parametrize("payload", [36_000.0, 0.0])
def test_the_mujoco_truck_stands_before_a_wall_seen_70_m_ahead_at_90_km_h(payload):
    stop = wall_stop(25.0, 70.0, payload, 0.002)
    assert stop.record["left"][-1] > 2.0
    assert stop.emergencies == 1
    assert np.isfinite(stop.record["speed"]).all()


def test_a_vehicle_that_only_drifts_is_followed_without_an_emergency():
    drifting = dataclasses.replace(at_gap(30.0, 15.0, lane=1), lateral_speed=-0.3)
    assert drive(16.67, 5.0, (drifting,)).planner.emergencies == 0


@pytest.mark.slow
@pytest.mark.parametrize("probability", [0.12, 0.05])
@pytest.mark.parametrize("seed", [3, 4])
def test_ordinary_traffic_causes_no_emergency_and_no_gap_below_3_m(probability, seed):
    ordinary = ordinary_drive(probability, 200.0, seed)
    assert ordinary.emergencies == 0
    assert ordinary.gap > 3.0
    assert ordinary.braking < 2.8
