"""No planned trajectory breaks a limit, whatever the state, the traffic and the reference speed."""

import numpy as np
import pytest

from controllers.planning.lane_change import lateral_limit
from controllers.planning.planner import Planner
from controllers.planning.rollover_limits import RollMargins
from iits_mj.core.messages import Decision, EgoState, PlanMode, Scene, SpeedProfile
from iits_mj.parameters import TruckParameters
from iits_mj.road import RoadMap, Route
from iits_mj.road.measured import Lanes, measured_route
from iits_mj.validation.planning import planner_limits
from iits_mj.validation.planning.planner_limits import random_breaches
from tests.controllers.scenes import Ideal, advanced, car

STRAIGHT = Route.straight(length=6000.0)


@pytest.fixture(scope="module")
def roads():
    return [STRAIGHT, RoadMap.builtin().route()]


def judge(result, least_changes):
    assert result.found == []
    assert result.changes >= least_changes
    assert result.lateral <= 1.01
    assert result.jump < 0.01


def test_trajectories_from_random_states_keep_all_limits(roads):
    judge(random_breaches(roads, 80, seed=3), 30)


@pytest.mark.slow
def test_trajectories_from_1500_random_states_keep_all_limits(roads):
    judge(random_breaches(roads, 1500, seed=11), 600)


def test_the_check_finds_a_broken_limit(monkeypatch):
    # The check uses half of the limit of the plan.
    half = lateral_limit
    monkeypatch.setattr(planner_limits, "lateral_limit", lambda *arguments: 0.5 * half(*arguments))
    found = random_breaches([STRAIGHT], 40, seed=5).found
    assert any(breach.startswith("lateral acceleration") for breach in found)


@pytest.mark.parametrize("mass", [19e3, 55e3])
def test_a_change_under_a_rising_reference_keeps_its_lateral_limit_to_the_end(mass):
    # The reference speed rises during the change, as before a climb.
    profile = SpeedProfile(
        np.array([0.0, 500.0, 700.0, 6000.0]), np.array([14.0, 14.0, 24.0, 24.0])
    )
    planner = Planner(STRAIGHT)
    ego = EgoState(station=480.0, offset=float(STRAIGHT.lane_offset(0, 0.0)), speed=14.0, mass=mass)
    greatest, speeds = 0.0, []
    for cycle in range(120):
        decision = Decision.LEFT if cycle == 5 else Decision.KEEP
        plan = planner.plan(Scene(ego.time, ego), decision, profile)
        if plan.mode is PlanMode.LANE_CHANGE:
            lateral = float(np.interp(ego.station, plan.station, plan.curvature)) * ego.speed**2
            greatest = max(greatest, abs(lateral))
            speeds.append(ego.speed)
        ego = advanced(ego, plan)
    assert planner.lane_changes == 1
    assert speeds[-1] > speeds[0] + 1.0
    margin = RollMargins(TruckParameters.load(), 1.0 / planner.config.change.duration_min).at(mass)
    allowed = lateral_limit(margin, speeds[-1], 0.0, planner.config.change)
    assert greatest <= 1.01 * allowed


def lateral_jerk_of_a_change(road, ego, profile):
    """Greatest lateral jerk of a change to the left begun at once, as it is driven [m/s3]."""
    planner, greatest = Planner(road), 0.0
    for cycle in range(150):
        decision = Decision.LEFT if cycle == 0 else Decision.KEEP
        plan = planner.plan(Scene(ego.time, ego), decision, profile)
        if plan.mode is PlanMode.LANE_CHANGE:
            third = planner.maneuver.residual.evaluate(plan.station)[3]
            greatest = max(greatest, float(np.abs(third * plan.speed**3).max()))
        ego = advanced(ego, plan)
    assert planner.lane_changes == 1
    return greatest, planner.config.change.jerk


@pytest.mark.parametrize("speed", [6.0, 7.4])
def test_a_slow_truck_that_gains_speed_in_a_change_keeps_the_jerk_limit_to_the_end(speed):
    # A launch uses the truck's power, regardless of a straight line between the reference's nodes.
    profile = SpeedProfile(
        np.array([0.0, 500.0, 900.0, 6000.0]), np.array([speed, speed, 20.0, 20.0])
    )
    ego = EgoState(station=500.0, offset=float(STRAIGHT.lane_offset(0, 0.0)), speed=speed)
    driven, limit = lateral_jerk_of_a_change(STRAIGHT, ego, profile)
    assert 0.3 * limit < driven <= 1.01 * limit


def test_a_laden_truck_that_gains_speed_over_a_crest_keeps_the_jerk_limit():
    station = np.arange(0.0, 3000.0, 5.0)
    grade = np.interp(station, [560.0, 600.0], [0.05, -0.05])
    height = np.append(0.0, np.cumsum(0.5 * (grade[1:] + grade[:-1]) * 5.0))
    road = measured_route(station, height, lanes=Lanes(2, 4.0, 25.0))
    ego = EgoState(
        station=560.0, offset=float(road.lane_offset(0, 560.0)), speed=7.0, mass=55_000.0
    )
    profile = SpeedProfile(np.array([0.0, 3000.0]), np.array([22.0, 22.0]))
    driven, limit = lateral_jerk_of_a_change(road, ego, profile)
    assert 0.3 * limit < driven <= 1.01 * limit


def test_a_truck_with_a_high_load_refuses_a_change_only_in_the_bend():
    station = np.arange(0.0, 2000.0, 5.0)
    knots, radius = [600.0, 680.0, 1200.0, 1280.0], 300.0
    curvature = np.interp(station, knots, [0.0, 1.0, 1.0, 0.0]) / radius
    flat = np.zeros_like(station)
    road = measured_route(station, flat, curvature=curvature, lanes=Lanes(2, 4.0, 25.0))
    planner = Planner(road, parameters=TruckParameters.load().with_payload_height(3.0))

    def reason(place):
        planner.reset()
        ego = EgoState(station=place, offset=float(road.lane_offset(0, place)), speed=20.0)
        return planner.plan(Scene(0.0, ego), Decision.LEFT).reason

    assert [("cross-slope" in reason(place)) for place in (200.0, 600.0, 900.0, 1400.0)] == [
        False,
        True,
        True,
        False,
    ]


@pytest.mark.parametrize("speed", [0.0, 1.0, 4.0])
def test_a_reference_that_begins_at_a_low_speed_does_not_keep_the_truck_slow(speed):
    # Like a receding plan: from the present speed to the set speed at the next node.
    planner = Planner(STRAIGHT)
    ego = EgoState(station=480.0, offset=float(STRAIGHT.lane_offset(0, 0.0)), speed=speed)
    for _ in range(150):
        places = np.array([ego.station, ego.station + 50.0, ego.station + 2000.0])
        profile = SpeedProfile(places, np.array([max(ego.speed, 0.5), 14.0, 14.0]))
        plan = planner.plan(Scene(ego.time, ego), Decision.KEEP, profile)
        ego = advanced(ego, plan)
    assert ego.speed > speed + 6.0
    assert ego.speed < 14.1


def test_a_slow_truck_keeps_a_slow_reference():
    profile = SpeedProfile(np.array([0.0, 6000.0]), np.array([5.0, 5.0]))
    ego = EgoState(station=480.0, offset=float(STRAIGHT.lane_offset(0, 0.0)), speed=4.0)
    plan = Planner(STRAIGHT).plan(Scene(0.0, ego), Decision.KEEP, profile)
    assert plan.speed.max() <= 5.05


def test_the_truck_keeps_the_reference_speed_during_a_change_on_a_free_road():
    drive = Ideal(STRAIGHT, 500.0, 0, 16.67)
    drive.run(8.0, (car(STRAIGHT, "far", 900.0, 1, 16.67),), lambda t: Decision(-(t < 0.05)))
    assert all(state.speed == pytest.approx(16.67, abs=0.05) for state in drive.states)
