"""The battery of the lane keeping tests what it says, against a driver who is a truck's."""

import dataclasses
import math

import pytest

from iits_mj.core.assets import regulation_path
from iits_mj.core.errors import InputError
from iits_mj.core.messages import EgoState
from iits_mj.core.timing import TIMESTEP
from iits_mj.core.units import KMH
from iits_mj.validation.aeb.drives import BASE, NEAR, RISKY_BRAKING, at, drive, scenario, straight
from iits_mj.validation.alks import group
from iits_mj.validation.alks.driver import AVOIDED, CAR, Brakes, measure
from iits_mj.validation.alks.lane import LAG, OUTSIDE, lane_keeping, sleeper, time_to_line
from traffic_bridge import read_events

LADEN = dataclasses.replace(BASE, payload=36_000.0)
STACK = dataclasses.replace(group.STACK, payload=36_000.0)


def impact(config, speed, events, guard=None):
    return drive(at(config, speed), events, straight(), guard=guard).impact


def test_the_cars_driver_is_that_of_the_regulation():
    assert (CAR.near, CAR.risky) == pytest.approx((NEAR, RISKY_BRAKING))
    # At a time to collision of 2 s this driver just avoids what is slower by 8.35 m/s.
    left = NEAR * AVOIDED - (0.4 + 0.75 + CAR.lag) * AVOIDED
    assert left == pytest.approx(AVOIDED**2 / (2.0 * CAR.deceleration))


@pytest.mark.parametrize(("friction", "least", "most"), [(0.8, 6.5, 7.6), (0.5, 4.3, 4.9)])
def test_the_measured_brakes_are_slower_and_weaker_than_a_cars(friction, least, most):
    brakes = measure(LADEN, 80.0, straight(friction))
    assert least < brakes.deceleration < most
    assert CAR.lag < brakes.lag < 0.8
    assert CAR.near < brakes.near < 3.0
    assert brakes.risky < CAR.risky


def test_the_trucks_driver_avoids_a_cut_in_from_the_gap_of_the_closed_form():
    brakes, slower = measure(LADEN, 80.0, straight()), 25.0 * KMH
    needed = brakes.gap_needed(slower, group._time_aside(0.375))
    # The driver sees every 100 ms: up to 0.1 s later, which is 0.7 m here.
    for gap, hits in ((needed - 1.5, True), (needed + 2.0, False)):
        events = scenario("r157_cut_in", gap=gap, slower=slower, duration=4.0)
        assert (impact(LADEN, 80.0, events, brakes.driver()) > 0.0) == hits
    assert brakes.gap_needed(AVOIDED + 0.1, 1.0) == math.inf


def test_the_driver_sees_a_standing_car_when_the_leader_leaves():
    events = scenario("r157_cut_out", speed=60.0 * KMH, time_gap=1.5, uncovers=3.5)
    driver = Brakes(7.3, 0.57).driver()
    made = drive(at(LADEN, 60.0), events, straight(), guard=driver)
    first = made.time[made.demand < 0.0][0]
    # The van begins at 1 s and is 0.375 m aside 0.6 s later.
    assert first == pytest.approx(1.0 + 0.6 + 1.15, abs=0.15)
    assert made.impact == 0.0


def test_the_stack_avoids_what_the_driver_avoids_in_some_cases_of_each_scenario():
    found, rows = group.against_driver(STACK, group.DRY, "laden", TIMESTEP, quick=True)
    assert [check.name for check in found.checks if not check.ok] == []
    assert [row[0] for row in rows[1:]] == ["cut-in", "cut-out", "braking"]
    assert all(row[2] == "2" for row in rows[1:])


def test_a_stack_that_sees_nothing_falls_short(monkeypatch):
    monkeypatch.setattr(group, "SCENARIOS", [s for s in group.SCENARIOS if s.name == "braking"])
    blind = dataclasses.replace(STACK, planner=BASE.planner, aeb="off")
    found, _ = group.against_driver(blind, group.DRY, "blind", TIMESTEP, quick=True)
    assert any(not check.ok for check in found.checks)


def test_the_empty_truck_does_not_roll_on_into_a_standing_car_on_a_descent():
    case = group.Case(80.0, 0.75, 1.5)
    empty = at(dataclasses.replace(group.STACK, payload=0.0), 80.0, group.DURATION)
    events = group.SCENARIOS[2].events(case, 0.8)
    made = drive(empty, events, straight(*group.DESCENT))
    assert made.impact == 0.0
    assert 2.0 < made.gap < 4.5


def test_cars_beside_the_way_cause_no_braking():
    found = group.false_reactions(STACK, TIMESTEP, quick=True)
    assert [check.name for check in found.checks if not check.ok] == []
    assert len(found.checks) == 4


def test_the_stack_keeps_its_lane_in_bends_and_gusts():
    found = lane_keeping(STACK, "laden", TIMESTEP, quick=True)
    values = {check.name: check.value for check in found.checks}
    room = [value for name, value in values.items() if "distance" in name or "gust" in name]
    assert len(room) == 2
    (false,) = (value for name, value in values.items() if "false take-overs" in name)
    assert false == 0.0
    # 0.725 m is half of what a lane of 4 m leaves beside the truck.
    assert all(0.1 < value < 0.725 for value in room)


def test_the_stack_takes_over_from_a_sleeper_before_the_last_warning():
    beyond = {}
    for ahead in (0.0, LAG):
        asleep = sleeper(0.8, ahead)
        made = drive(at(dataclasses.replace(STACK, planner=asleep), 65.0, 9.0))
        beyond[ahead] = -made.room
        # The drift is at the line after 1 s + 0.725 m / 0.8 m/s; the stack looks every 0.1 s.
        assert asleep.alarms[0] == pytest.approx(1.906 - ahead, abs=0.21)
    assert 0.0 < beyond[LAG] < OUTSIDE < beyond[0.0]


def test_time_to_the_line_is_room_over_the_rate_across_the_road():
    route = straight()
    middle = float(route.lane_offset(1, 400.0))
    drifting = EgoState(station=400.0, offset=middle + 0.5, yaw=0.02, speed=20.0)
    assert time_to_line(drifting, route, 2.6) == pytest.approx(0.2 / (20.0 * math.sin(0.02)))
    leaving = dataclasses.replace(drifting, yaw=-0.02)
    assert time_to_line(leaving, route, 2.6) == math.inf
    slipping = dataclasses.replace(drifting, yaw=0.0, lateral_speed=0.4)
    assert time_to_line(slipping, route, 2.6) == pytest.approx(0.5)
    assert time_to_line(slipping, route, 3.2) == 0.0


def test_every_scenario_reads_with_its_defaults():
    folder = regulation_path("road.csv").parent
    files = sorted(folder.glob("*.toml"))
    assert len(files) == 8
    assert all(read_events(file) for file in files)
    with pytest.raises(InputError, match=r"no scenario 'r131_bus.toml'; there are: .*r131_car"):
        regulation_path("r131_bus.toml")
    with pytest.raises(InputError, match="there is no parameter 'gapp'"):
        scenario("r131_car", gapp=3.0)
