import dataclasses
import math

import numpy as np
import pytest

from iits_mj.core.errors import InputError
from iits_mj.core.messages import EgoFootprint
from iits_mj.core.vehicles import VehicleFrame
from tests.traffic_bridge.scenario.scene import ROAD
from tests.traffic_bridge.scripted_truck import ego_at
from traffic_bridge import vehicle_on
from traffic_bridge.scenario.conditions import (
    MEASURES,
    Condition,
    Situation,
    Trigger,
    groups_of,
    time_to_collision,
)

OFFSET = float(ROAD.lane_offset(1, 0.0))


def situation(*vehicles, time=0.0, speed=20.0, events=None):
    """A truck in the middle of three lanes at station 500 m."""
    ego = ego_at(ROAD, time, 500.0, speed, OFFSET)
    return Situation(time, ROAD, EgoFootprint(), ego, VehicleFrame.of(vehicles), events or {})


def car(name, station, lane=1, speed=15.0):
    return vehicle_on(ROAD, name, station, lane, speed=speed, length=5.0)


SIX = (
    *(car("ahead", 550.0), car("behind", 450.0)),
    *(car("l_ahead", 540.0, 2), car("l_behind", 440.0, 2)),
    *(car("r_ahead", 530.0, 0), car("r_behind", 430.0, 0)),
    *(car("far", 600.0), car("far_left", 600.0, 2)),
)


@pytest.mark.parametrize(
    ("role", "name"),
    [
        ("leader", "ahead"),
        ("follower", "behind"),
        ("left_leader", "l_ahead"),
        ("left_follower", "l_behind"),
        ("right_leader", "r_ahead"),
        ("right_follower", "r_behind"),
    ],
)
def test_a_role_is_the_nearest_vehicle_of_its_lane(role, name):
    assert situation(*SIX).find(role).name == name


def test_a_role_without_a_vehicle_or_a_lane_is_empty():
    assert situation(car("ahead", 550.0)).find("left_leader") is None
    right = situation(car("other", 550.0, 0))
    ego = dataclasses.replace(right.ego, offset=float(ROAD.lane_offset(0, 500.0)))
    assert dataclasses.replace(right, ego=ego).find("right_leader") is None


def test_measures_have_the_values_of_their_definitions():
    now = situation(car("ahead", 550.0))
    # Truck: front at 501.4 m, 20 m/s. Car: 547.5 m to 552.5 m, 15 m/s.
    values = {
        "station": 501.4,
        "lane": 1.0,
        "speed": 20.0,
        "gap": 46.1,
        "ahead": 51.1,
        "time_gap": 46.1 / 20.0,
        "ttc": 46.1 / 5.0,
        "speed_difference": -5.0,
        "distance": 50.0,
    }
    for name, expected in values.items():
        to = "ahead" if MEASURES[name].bodies == 2 else None
        found = Condition(measure=name, to=to, above=0.0).value(now)
        assert found == pytest.approx(expected, abs=1e-9), name


def test_the_gap_is_zero_side_by_side_and_time_to_collision_needs_closing():
    beside = situation(car("beside", 495.0, 2))
    assert Condition(measure="gap", to="beside", above=0.0).value(beside) == 0.0
    now = situation(car("faster", 550.0, speed=25.0), car("chaser", 450.0, speed=25.0))
    truck = now.truck
    assert time_to_collision(truck, now.bodies["faster"]) == math.inf
    # The chaser's front is at 452.5 m, the truck's rear at 484.9 m.
    assert time_to_collision(truck, now.bodies["chaser"]) == pytest.approx(32.4 / 5.0)


def test_a_crossing_body_has_no_pace_along_the_road_and_its_width_across_it():
    walker = vehicle_on(ROAD, "walker", 550.0, 1, speed=2.0, length=1.0, width=0.4)
    walker = dataclasses.replace(walker, yaw=walker.yaw + 0.5 * math.pi)
    body = situation(walker).bodies["walker"]
    assert body.pace == pytest.approx(0.0, abs=1e-12)
    assert body.front - body.rear == pytest.approx(0.4)
    assert body.width == pytest.approx(1.0)


def test_a_condition_on_a_missing_body_does_not_hold():
    for limits in ({"above": 0.0}, {"below": 1e9}):
        assert not Condition(measure="gap", to="nobody", **limits).holds(situation())


def test_a_time_gap_that_never_ends_is_above_every_limit_and_below_none():
    now = situation(car("behind", 450.0))
    assert Condition(measure="time_gap", to="behind", above=1e6).holds(now)
    assert not Condition(measure="time_gap", to="behind", below=1e6).holds(now)


SPEEDS = (10.0, 20.0, 20.0, 10.0, 20.0)


@pytest.mark.parametrize(
    ("edge", "expected"),
    [
        ("none", (False, True, True, False, True)),
        ("rising", (False, True, False, False, True)),
        ("falling", (False, False, False, True, False)),
        ("either", (False, True, False, True, True)),
    ],
)
@pytest.mark.parametrize("delay", [0.0, 0.1, 0.3])
def test_an_edge_and_a_delay_shift_the_comparison(edge, expected, delay):
    trigger = Trigger(groups_of({"measure": "speed", "above": 15.0, "edge": edge, "delay": delay}))
    found = [
        trigger.step(situation(time=0.1 * k, speed=speed))
        for k, speed in enumerate((*SPEEDS, *3 * (SPEEDS[-1],)))
    ]
    late = round(delay / 0.1)
    assert found[late : late + len(expected)] == list(expected)
    assert not any(found[:late])


def test_one_group_must_hold_with_all_its_conditions():
    fast = {"measure": "speed", "above": 15.0}
    late, begun = {"measure": "time", "above": 5.0}, {"event": "x", "state": "begun"}
    both, either = Trigger(groups_of([fast, late])), Trigger(groups_of([[fast, late], [begun]]))
    early = situation(time=1.0)
    assert not both.step(early)
    assert not either.step(early)
    assert both.step(situation(time=5.0))
    assert either.step(situation(time=1.0, events={"x": "ended"}))


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"measure": "gapp", "below": 1.0}, "did you mean gap"),
        ({"measure": "gap", "below": 1.0}, "needs `to`"),
        ({"measure": "speed", "to": "leader", "below": 1.0}, "has no `to`"),
        ({"measure": "speed"}, "needs above, below"),
        ({"measure": "speed", "below": math.nan}, "below = nan"),
        ({"measure": "speed", "below": "fast"}, "below = 'fast'"),
        ({"measure": "speed", "below": 1.0, "equals": 2.0}, "equals alone"),
        ({"measure": "speed", "below": 1.0, "edge": "up"}, "edge 'up'"),
        ({"measure": "speed", "below": 1.0, "delay": -1.0}, "delay = -1.0"),
        ({"event": "a", "below": 1.0}, "below is not used"),
        ({"event": "a", "measure": "speed"}, "not both"),
        ({}, "a measure or an event"),
        ({"measur": "speed"}, "did you mean measure"),
        ({"measure": "gap", "point": [0, 0], "below": 1.0}, "point is for the measure distance"),
        ({"measure": "distance", "point": [0], "below": 1.0}, "must be 2 numbers"),
        ({"variable": "a"}, "variable a needs above"),
        ({"variable": "a", "text": "x", "above": 1.0}, "equals alone"),
        ({"event": "a", "text": "x"}, "text is not used"),
        ([], "must be a condition"),
        ("soon", "must be a condition"),
        ([[]], "no condition"),
        ([{"measure": "speed", "below": 1.0}] * 21, "more than 20"),
    ],
)
def test_a_wrong_condition_is_refused_by_name(given, words):
    with pytest.raises(InputError, match="when") as raised:
        groups_of(given)
    assert words in str(raised.value)


def test_a_variable_is_compared_as_a_number_or_a_text():
    now = dataclasses.replace(situation(), values={"light": "green", "count": 11.0})
    assert Condition(variable="light", text="green").holds(now)
    assert not Condition(variable="light", text="red").holds(now)
    assert Condition(variable="count", above=10.0).holds(now)
    for missing in ("light", "other"):
        assert not Condition(variable=missing, below=1e9).holds(now)


def test_a_point_is_passed_also_between_two_steps():
    # The point of the truck 1.4 m behind its front has come from 498 m to 500 m in the last step.
    now = dataclasses.replace(situation(), step=0.1)
    for station, expected in ((500.0, 0.0), (499.1, 0.0), (498.0, 0.0), (497.0, 1.0), (501.0, 1.0)):
        point = (station, now.ego.y)
        found = Condition(measure="distance", point=point, back=1.4, below=9.0).value(now)
        assert found == pytest.approx(expected, abs=1e-9), station


def test_a_condition_that_must_last_begins_again_after_a_break():
    trigger = Trigger(groups_of({"measure": "speed", "below": 15.0, "lasting": 0.2}))
    speeds = (10.0, 10.0, 20.0, 10.0, 10.0, 10.0, 20.0)
    found = [trigger.step(situation(time=0.1 * k, speed=v)) for k, v in enumerate(speeds)]
    assert found == [False, False, False, False, False, True, False]


def test_numpy_numbers_become_plain():
    condition = Condition(measure="speed", above=np.float64(3.0))
    assert type(condition.above) is float
