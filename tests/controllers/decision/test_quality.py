"""Figures of lane changes and of the use of lanes, from scenes whose figures are known."""

import math
from dataclasses import replace

import numpy as np
import pytest

from controllers.decision import make
from controllers.decision.fast_world.worlds import FastWorlds
from controllers.decision.quality import IMPOSED_TIME, QualityLog
from controllers.decision.rules import compiled
from controllers.decision.trip import cell_trip
from iits_mj.core.messages import EgoState, PlanMode, Scene, Trajectory
from iits_mj.road import Route
from tests.controllers.scenes import car

ROUTE = Route.straight(length=5000.0)
# The truck's steer axle is at 1000 m; its front bumper and its rear [m].
FRONT, REAR = 1001.4, 1001.4 - 16.5
HALF = 2.4  # of a car's length [m]


def scene(*vehicles, time=0.0, speed=16.0):
    return Scene(time, EgoState(time=time, station=1000.0, speed=speed), vehicles)


def follower(braking, time, name="behind"):
    return scene(car(ROUTE, name, REAR - 20.0 - HALF, 1, 18.0, acceleration=-braking), time=time)


def plan(lane, mode=PlanMode.LANE_KEEPING):
    line = np.array([0.0, 1.0])
    return Trajectory(*[line] * 10, mode=mode, target_lane=lane)


def test_times_at_a_change_are_those_of_the_new_leader_and_the_new_follower():
    log = QualityLog()
    ahead = car(ROUTE, "ahead", FRONT + 30.0 + HALF, 1, 12.0)
    near = car(ROUTE, "own lane", FRONT + 5.0 + HALF, 0, 10.0)
    behind = car(ROUTE, "behind", REAR - 20.0 - HALF, 1, 18.0)
    log.begin_change(scene(ahead, near, behind), ROUTE, 1)
    found = log.quality
    assert found.collision_time_front == pytest.approx(30.0 / (16.0 - 12.0))
    assert found.collision_time_rear == pytest.approx(20.0 / (18.0 - 16.0))
    assert found.change_time_gap_front == pytest.approx(30.0 / 16.0)
    assert found.change_time_gap_rear == pytest.approx(20.0 / 18.0)


def test_vehicles_that_drive_apart_never_collide():
    log = QualityLog()
    ahead = car(ROUTE, "ahead", FRONT + 30.0 + HALF, 1, 17.0)
    behind = car(ROUTE, "behind", REAR - 20.0 - HALF, 1, 15.0)
    log.begin_change(scene(ahead, behind), ROUTE, 1)
    assert log.quality.collision_time_front == log.quality.collision_time_rear == math.inf
    empty = QualityLog()
    empty.begin_change(scene(), ROUTE, 1)
    assert empty.quality.change_time_gap_front == math.inf


@pytest.mark.parametrize(
    ("brakings", "count", "hardest"),
    [
        ((0.0, 1.5, 0.5), 0, 1.5),
        ((1.0, 2.5, 3.0, 1.0, 2.8), 1, 3.0),
        ((-1.0, -0.5), 0, 0.0),
    ],
)
def test_the_hardest_braking_of_the_new_follower_counts_once(brakings, count, hardest):
    log = QualityLog()
    log.begin_change(follower(0.0, 0.0), ROUTE, 1)
    for second, braking in enumerate(brakings, 1):
        log.add(follower(braking, float(second)), 1, 1.0)
    assert log.quality.imposed_brakings == count
    assert log.quality.imposed_deceleration == pytest.approx(hardest)


def test_braking_that_lasts_for_one_short_step_is_not_imposed():
    log = QualityLog()
    log.begin_change(follower(0.0, 0.0), ROUTE, 1)
    for step, braking in enumerate((0.1, 8.0, 0.4, 0.3, 1.2, 1.4, 0.0), 1):
        log.add(follower(braking, 0.1 * step), 1, 0.1)
    assert log.quality.imposed_brakings == 0
    assert log.quality.imposed_deceleration == pytest.approx(1.2)


def test_braking_of_others_and_later_braking_is_not_imposed():
    log = QualityLog()
    log.begin_change(follower(0.0, 0.0), ROUTE, 1)
    log.add(follower(4.0, 1.0, name="another"), 1, 1.0)
    log.add(follower(0.0, IMPOSED_TIME), 1, 1.0)
    log.add(follower(4.0, IMPOSED_TIME + 0.1), 1, 1.0)
    assert log.quality.imposed_deceleration == 0.0


def test_two_changes_add_their_brakings():
    log = QualityLog()
    for start in (0.0, 20.0):
        log.begin_change(follower(0.0, start), ROUTE, 1)
        log.add(follower(2.5, start + 1.0), 1, 1.0)
    assert log.quality.imposed_brakings == 2
    assert log.quality.imposed_deceleration == pytest.approx(5.0)


@pytest.mark.parametrize(
    ("station", "lane", "beside"),
    [
        (FRONT + HALF - 0.1, 1, True),
        (REAR - HALF + 0.1, 1, True),
        (FRONT + HALF + 0.1, 1, False),
        (REAR - HALF - 0.1, 1, False),
        (1000.0, 2, False),
        (1000.0, -1, False),
    ],
)
def test_a_vehicle_is_beside_when_it_overlaps_the_length_in_a_neighboring_lane(
    station, lane, beside
):
    log = QualityLog()
    other = replace(car(ROUTE, "other", station, 1, 16.0), lane=lane)
    log.add(scene(other), 0, 0.1)
    assert log.quality.beside_time == pytest.approx(0.1 * beside)


def test_a_change_of_the_plan_begins_with_its_new_lane_and_an_abort_is_no_change():
    log = QualityLog()
    quiet, near = scene(), follower(0.0, 3.0)
    log.add_plan(quiet, ROUTE, plan(0), 2.0)
    # Lanes are counted again where a lane begins at the right.
    log.add_plan(near, ROUTE, plan(1), 2.0)
    assert log.quality.change_time_gap_rear == math.inf
    log.add_plan(near, ROUTE, plan(0), 2.0)
    log.add_plan(near, ROUTE, plan(0, PlanMode.ABORT), 2.0)
    log.add_plan(near, ROUTE, plan(1, PlanMode.ABORT), 2.0)
    assert log.quality.change_time_gap_rear == math.inf
    log.add_plan(near, ROUTE, plan(0), 2.0)
    log.add_plan(near, ROUTE, plan(1, PlanMode.LANE_CHANGE), 2.0)
    assert log.quality.change_time_gap_rear == pytest.approx(20.0 / 18.0)
    assert log.quality.right_time == pytest.approx(8.0)


def test_the_fast_world_measures_the_hardest_braking_behind_a_change():
    """Wide gaps impose less than narrow ones, and a change imposes no more than it measures."""
    found = {}
    for name in ("conservative", "lookahead"):
        worlds = FastWorlds(20)
        for index in range(20):
            worlds.reset(index, np.random.default_rng(index), cell_trip("dense", 12.5))
        worlds.drive(compiled(make(name)))
        changes = worlds.states["changes"].sum()
        found[name] = worlds.states["imposed_deceleration"].sum() / changes
        assert (
            worlds.states["imposed_deceleration"] >= 2.0 * worlds.states["imposed_brakings"]
        ).all()
        right = [worlds.summary(index).quality.right_time for index in range(20)]
        assert right == worlds.states["right_time"].tolist()
    assert found["conservative"] < 0.5 * found["lookahead"] < 0.5
