"""Vehicles that the truck passes without a decision: those stopped alone, not those in a queue."""

import dataclasses

import pytest

from iits_mj.core.messages import Decision, PlanMode
from iits_mj.road import Route
from tests.controllers.scenes import Ideal, at, car
from tests.controllers.test_on_truck import drive

ROAD = Route.straight(length=3000.0, lanes=2, lane_width=3.75)
VAN = car(ROAD, "van", 600.0, 0, 0.0, length=6.0, width=2.0)


def queue(lane, first, count=4):
    return tuple(car(ROAD, f"q{lane}.{i}", first + 8.0 * i, lane, 0.0) for i in range(count))


def left_lane():
    return float(ROAD.lane_offset(1, 600.0))


@pytest.mark.parametrize(
    "others",
    [queue(0, 608.0), queue(1, 590.0), (car(ROAD, "slow", 612.0, 0, 0.0),)],
    ids=["row ahead", "lane beside", "one ahead"],
)
def test_in_a_jam_the_truck_stays_in_its_queue(others):
    run = Ideal(ROAD, 540.0, 0, 8.0).run(40.0, (VAN, *others))
    assert run.planner.lane_changes == 0
    assert not run.planner.changing
    assert run.ego.speed < 0.05
    assert run.ego.station < VAN.station
    assert "queue behind van" in run.plans[-1].reason


def test_a_stopped_vehicle_with_a_far_or_moving_leader_has_broken_down():
    far = car(ROAD, "far", 660.0, 0, 0.0)
    driving = car(ROAD, "driving", 615.0, 0, 6.0)
    for other in (far, driving):
        run = Ideal(ROAD, 540.0, 0, 8.0).run(45.0, (VAN, other))
        assert run.planner.changing or run.planner.lane_changes == 1


def test_the_truck_does_not_leave_a_jam_that_is_free_for_a_moment():
    def vehicles(time):
        # The row ahead disappears for 3 s, less than the patience.
        return (VAN, *(queue(0, 608.0) if time % 6.0 < 3.0 else ()))

    run = Ideal(ROAD, 570.0, 0, 2.0).run(40.0, vehicles)
    assert run.planner.lane_changes == 0
    assert not run.planner.changing


def starts(moment, acceleration=0.8):
    """The van, which moves off at a moment [s], up to 8 m/s."""

    def vehicles(time):
        moved = max(time - moment, 0.0)
        speed = min(acceleration * moved, 8.0)
        way = speed * moved - 0.5 * speed**2 / acceleration
        return (dataclasses.replace(VAN, station=VAN.station + way, speed=speed),)

    return vehicles


def begun(run):
    """Time at which the first change began [s]."""
    return next(p.time[0] for p in run.plans if p.mode is PlanMode.LANE_CHANGE)


def test_a_vehicle_that_moves_off_early_ends_the_change_and_is_followed():
    first = begun(Ideal(ROAD, 578.0, 0, 0.0).run(12.0, (VAN,)))
    run = Ideal(ROAD, 578.0, 0, 0.0).run(60.0, starts(first))
    assert run.planner.aborted == 1
    assert run.planner.lane_changes == 0
    assert any(plan.mode is PlanMode.ABORT for plan in run.plans)
    middle = float(ROAD.lane_offset(0, 600.0))
    assert max(state.offset for state in run.states) - middle < 0.63
    assert run.ego.offset == pytest.approx(middle, abs=0.05)
    assert "following van" in run.plans[-1].reason
    assert run.ego.speed > 5.0


def test_after_an_aborted_change_the_truck_waits_while_the_vehicle_stops_again():
    first = begun(Ideal(ROAD, 578.0, 0, 0.0).run(12.0, (VAN,)))

    def vehicles(time):
        moved = time if time < first + 3.0 else max(first + 3.0, time - 20.0)
        one = starts(first)(moved)[0]
        stands = moved == first + 3.0
        return (dataclasses.replace(one, speed=0.0 if stands else one.speed),)

    run = Ideal(ROAD, 578.0, 0, 0.0).run(70.0, vehicles)
    rested = [p for p, s in zip(run.plans, run.states, strict=True) if 20.0 < s.time < 28.0]
    assert {plan.mode for plan in rested} == {PlanMode.LANE_KEEPING}
    assert run.planner.aborted == 1
    assert run.ego.offset == pytest.approx(float(ROAD.lane_offset(0, 600.0)), abs=0.05)
    assert run.ego.speed > 5.0


def test_in_the_other_lane_the_truck_continues_past_a_vehicle_that_moves_off():
    first = begun(Ideal(ROAD, 578.0, 0, 0.0).run(12.0, (VAN,)))
    run = Ideal(ROAD, 578.0, 0, 0.0).run(60.0, starts(first + 7.0, 0.3))
    assert run.planner.aborted == 0
    assert run.planner.lane_changes == 1
    assert run.ego.offset == pytest.approx(left_lane(), abs=0.05)


def test_a_decision_to_leave_the_queue_is_obeyed_when_there_is_room():
    jam = (VAN, *queue(0, 608.0))
    run = Ideal(ROAD, 580.0, 0, 0.0).run(40.0, jam, at(8.0, Decision.LEFT))
    assert run.planner.lane_changes == 1


def test_the_mujoco_truck_aborts_its_change_and_follows_a_vehicle_that_moves_off():
    rows, stack = drive(ROAD, 0.0, 14.0, 30.0, 578.0, 0.0, starts(8.0))
    planner = stack.planner
    assert (planner.aborted, planner.lane_changes) == (1, 0)
    assert rows[-1, 2] > 4.0
    # From the van's rear to the truck's bumper.
    assert (starts(8.0)(30.0)[0].station - 3.0) - (rows[-1, 1] + 1.4) > 5.0
    assert abs(rows[-1, 4]) < 0.1


def test_in_a_jam_the_mujoco_truck_stays_in_its_queue():
    rows, stack = drive(ROAD, 0.0, 14.0, 15.0, 575.0, 3.0, lambda t: (VAN, *queue(0, 608.0)))
    assert stack.planner.lane_changes == 0
    assert not stack.planner.changing
    assert rows[-1, 2] < 0.05
