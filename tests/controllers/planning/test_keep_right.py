"""The truck keeps right: it returns to a lane that stays free, and passes only when it must."""

import dataclasses

import pytest
from hypothesis import given
from hypothesis import strategies as st

from controllers.planning.config import FollowingConfig, LaneChangeConfig, PlannerConfig
from controllers.planning.keep_right import stays_free
from controllers.planning.planner import Planner
from iits_mj.core.messages import Decision, EgoState, Scene
from iits_mj.core.neighbors import Neighbor
from iits_mj.road import Route
from tests.controllers.scenes import Ideal, RightLaneEnds, at, car

SPEED = 16.67
FOLLOWING = FollowingConfig()
ROUTE = Route.straight(length=5000.0, lanes=2)
RIGHT = PlannerConfig(keep_right=True)


def leader(gap, speed):
    return Neighbor("a", gap, 0.0, 0.0, speed, 0.0, 4.5, 1.8)


@given(
    gap=st.floats(0.0, 500.0),
    lead_speed=st.floats(0.0, 40.0),
    speed=st.floats(0.0, 30.0),
    reference=st.floats(1.0, 30.0),
)
def test_a_lane_stays_free_if_the_gap_never_falls_below_the_following_distance(
    gap, lead_speed, speed, reference
):
    faster = max(speed, reference)
    least = min(gap - (faster - lead_speed) * time for time in (0.0, 20.0))
    spare = least - (FOLLOWING.standstill_gap + FOLLOWING.time_gap * faster)
    if abs(spare) > 1e-6:
        free = stays_free(leader(gap, lead_speed), speed, reference, FOLLOWING)
        assert free is (spare > 0.0)


def test_an_empty_lane_stays_free():
    assert stays_free(None, SPEED, SPEED, FOLLOWING)


def drive(vehicles=(), lane=1, config=RIGHT, duration=15.0, decide=None, route=ROUTE):
    return Ideal(route, 500.0, lane, SPEED, config).run(
        duration, vehicles, *([] if decide is None else [decide])
    )


@pytest.mark.parametrize("keep_right", [False, True])
def test_a_truck_that_keeps_right_leaves_the_left_lane_of_an_empty_road(keep_right):
    driven = drive(config=PlannerConfig(keep_right=keep_right))
    assert driven.planner.lane_changes == int(keep_right)
    assert driven.ego.offset == pytest.approx(ROUTE.lane_offset(0 if keep_right else 1, 600.0))
    assert driven.planner.refused == 0


@pytest.mark.parametrize(("spare", "changes"), [(-2.0, 0), (2.0, 1)])
def test_it_returns_when_it_reaches_the_leader_on_the_right_after_more_than_20_s(spare, changes):
    slow = 12.5
    footprint = Scene(0.0, EgoState(), ()).footprint
    wanted = (SPEED - slow) * 20.0 + FOLLOWING.standstill_gap + FOLLOWING.time_gap * SPEED
    ahead = car(ROUTE, "slow", 0.0, 0, slow)
    station = 500.0 + footprint.front_overhang + wanted + spare + 0.5 * ahead.length
    # One cycle: later the truck is nearer.
    driven = drive((dataclasses.replace(ahead, station=station),), duration=0.1)
    assert driven.planner.changing is bool(changes)


def test_it_does_not_return_beside_a_vehicle_or_closely_before_a_faster_one():
    for station, speed in ((490.0, SPEED), (470.0, 22.0)):
        driven = drive((car(ROUTE, "other", station, 0, speed),), duration=0.5)
        assert not driven.planner.changing
        # Nobody asked for a change.
        assert (driven.planner.refused, driven.planner.unsafe) == (0, 0)


def test_it_passes_a_slow_vehicle_and_returns():
    slow = car(ROUTE, "slow", 590.0, 0, 8.0)
    driven = drive((slow,), lane=0, duration=40.0, decide=at(0.0, Decision.LEFT))
    assert driven.planner.lane_changes == 2
    assert driven.ego.offset == pytest.approx(float(ROUTE.lane_offset(0, 600.0)), abs=0.05)
    assert driven.ego.station > 590.0 + 8.0 * 40.0


def test_it_does_not_leave_a_lane_that_stays_free():
    driven = drive(lane=0, duration=1.0, decide=at(0.0, Decision.LEFT))
    plan = driven.plans[0]
    assert plan.refused is Decision.LEFT
    assert plan.reason == "left refused: the truck keeps right: its lane is free for 20 s"
    assert (driven.planner.refused, driven.planner.unsafe) == (1, 0)
    scene = Scene(0.0, EgoState(station=500.0, speed=SPEED, mass=30_000.0), ())
    assert not Planner(ROUTE, RIGHT).may_pass(scene)
    assert Planner(ROUTE).may_pass(scene)


def test_it_does_not_return_to_a_lane_that_ends():
    route = RightLaneEnds(end=1_200.0, length=3_000.0)
    for station, changes in ((100.0, True), (600.0, False)):
        driven = Ideal(route, station, 1, SPEED, RIGHT).run(0.5)
        assert driven.planner.changing is changes


class Ban:
    """A straight road of two lanes where signs forbid trucks to overtake on a stretch."""

    overtaking_bans = ((1_000.0, 2_000.0),)

    def __getattr__(self, name):
        return getattr(ROUTE, name)


def test_it_does_not_pass_where_signs_forbid_it():
    slow = (car(ROUTE, "slow", 660.0, 0, 8.0),)
    way = LaneChangeConfig.duration_max * SPEED
    for station, allowed in ((980.0 - way, True), (1_010.0 - way, False), (1_990.0, False)):
        near = tuple(dataclasses.replace(v, station=station + 90.0) for v in slow)
        driven = Ideal(Ban(), station, 0, SPEED).run(0.1, near, at(0.0, Decision.LEFT))
        assert driven.planner.changing is allowed
        if not allowed:
            assert driven.plans[0].reason == "left refused: a sign forbids trucks to overtake"


def test_it_returns_where_signs_forbid_it_to_overtake():
    for station, changes in ((500.0, False), (1_500.0, True), (2_100.0, False)):
        driven = Ideal(Ban(), station, 1, SPEED).run(0.5)
        assert driven.planner.changing is changes
