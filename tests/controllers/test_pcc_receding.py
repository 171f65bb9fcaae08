"""The receding-horizon speed planner: hills, a vehicle ahead, failures."""

import numpy as np
import pytest

from controllers.pcc import Leader, RecedingConfig, RecedingPlanner, RoadProfile
from controllers.pcc.solver import Solver
from controllers.pcc.vehicle import durations
from iits_mj.errors import InputError, PlanningError
from iits_mj.parameters import TruckParameters

STATION = 50.0 * np.arange(241)
ROAD = RoadProfile(
    STATION, 12.0 * np.sin(2.0 * np.pi * STATION / 2500.0), np.full(241, 25.0), "waves"
)
PARAMETERS = TruckParameters.load()


@pytest.fixture(scope="module")
def planner():
    return RecedingPlanner(ROAD, PARAMETERS, receding=RecedingConfig(time_limit=10.0))


@pytest.fixture(autouse=True)
def _fresh(planner):
    planner.reset()


def times(plan, station, speed):
    road = RoadProfile(
        plan.profile.station, np.zeros(plan.profile.station.size), np.full(101, 99.0)
    )
    return np.concatenate([[0.0], np.cumsum(durations(plan.profile.speed, road))])


def test_plan_starts_at_the_trucks_speed_and_keeps_the_limits(planner):
    plan = planner.plan(1000.0, 18.0, 0.0)
    assert plan.status == "optimal"
    assert plan.profile.speed[0] == pytest.approx(18.0)
    assert plan.profile.station[-1] - plan.profile.station[0] == pytest.approx(5000.0)
    assert plan.profile.speed.max() <= 85.0 / 3.6 + 1e-6


def test_plan_is_slower_at_the_crest_than_in_the_sag(planner):
    plan = planner.plan(0.0, 20.0, 0.0)
    crest, sag = plan.profile.at(625.0 + 2500.0), plan.profile.at(1875.0 + 2500.0)
    assert crest < sag - 1.0


def test_level_road_is_driven_at_the_reference_speed():
    level = RoadProfile(STATION, np.zeros(241), np.full(241, 30.0), "level")
    plan = RecedingPlanner(level, PARAMETERS).plan(0.0, 20.0, 0.0)
    assert np.abs(plan.profile.speed - 20.0).max() < 0.3


def test_a_lag_makes_the_plan_faster(planner):
    planner.plan(0.0, 20.0, 0.0)
    on_time = planner.plan(2000.0, 20.0, 100.0).profile.speed.mean()
    late = planner.plan(2000.0, 20.0, 130.0).profile.speed.mean()
    assert late > on_time + 0.1


def test_fence_of_a_slow_vehicle_ahead_is_never_passed(planner):
    leader = Leader(rear=1150.0, speed=14.0)
    plan = planner.plan(1000.0, 18.0, 0.0, leader)
    assert plan.status == "optimal"
    clock = times(plan, 1000.0, 18.0)
    settings = planner.receding
    clear = leader.rear - settings.standstill_gap
    fence = (plan.profile.station - clear) / leader.speed + settings.time_gap
    near = plan.profile.station <= clear + leader.speed * settings.fence_time
    assert (clock[near] >= fence[near] - 0.05).all()


def test_an_impossible_fence_falls_back_to_a_slow_cruise_with_the_reason(planner):
    plan = planner.plan(1000.0, 20.0, 0.0, Leader(rear=1005.0, speed=5.0))
    assert plan.status == "cruise"
    assert plan.reason
    assert plan.profile.speed.max() <= 5.0 + 1e-6


def test_a_failed_solve_keeps_the_last_plan(planner, monkeypatch):
    first = planner.plan(1000.0, 20.0, 0.0)
    speed = first.profile.at(1200.0)

    def fail(self, task, guess):
        raise PlanningError("time is up")

    monkeypatch.setattr(Solver, "solve", fail)
    second = planner.plan(1200.0, speed, 10.0)
    assert second.status == "kept"
    assert second.reason == "time is up"
    assert second.profile.at(2000.0) == pytest.approx(first.profile.at(2000.0), abs=0.05)


def test_a_late_solve_is_given_up():
    planner = RecedingPlanner(ROAD, PARAMETERS, receding=RecedingConfig(time_limit=1e-4))
    plan = planner.plan(1000.0, 20.0, 0.0)
    assert plan.status == "cruise"
    assert plan.reason


def test_numbers_that_are_not_finite_are_refused_by_name(planner):
    with pytest.raises(InputError, match="speed is nan"):
        planner.plan(0.0, float("nan"), 0.0)
    with pytest.raises(InputError, match="leader"):
        planner.plan(0.0, 20.0, 0.0, Leader(float("inf"), 10.0))
