"""The battery of the emergency braking tests what it says."""

import dataclasses

import pytest

from controllers.emergency_braking import EmergencyState
from iits_mj.core.timing import TIMESTEP
from iits_mj.core.units import KMH
from iits_mj.validation.aeb import group
from iits_mj.validation.aeb.drives import BASE, CarefulDriver, at, drive
from traffic_bridge import PlaceVehicle

EMPTY, LADEN = (dataclasses.replace(BASE, payload=payload) for payload in (0.0, 36_000.0))


def test_the_regulations_main_tests_hold_with_noisy_sensors():
    found = group.cars(LADEN, TIMESTEP, quick=True)
    assert [check.name for check in found.checks if not check.ok] == []
    assert len(found.checks) == 15


@pytest.mark.parametrize(("aeb", "hits"), [("off", True), ("on", False)])
def test_a_child_is_hit_only_without_it(aeb, hits):
    config = dataclasses.replace(EMPTY, aeb=aeb)
    (check,) = group.crossing_child(config, TIMESTEP, quick=True).checks
    assert (check.value > 0.0) == hits


def test_the_blind_planner_hits_a_car_at_its_own_speed():
    car = PlaceVehicle(name="car", gap=30.0, relative_lane=0, speed=5.0, reactive=False)
    made = drive(dataclasses.replace(at(EMPTY, 54.0, 5.0), aeb="off"), (car,))
    assert made.impact == pytest.approx(10.0, abs=0.3)
    assert "collision with car" in made.ended


def test_the_careful_driver_brakes_1_15_s_after_a_hard_braking():
    made = drive(at(EMPTY, 80.0), group.braking(2.0, 8.0), guard=CarefulDriver())
    assert made.impact == 0.0
    # At 3 s the car begins; its deceleration passes 5 m/s2 within 0.2 s, seen every 0.1 s.
    first = made.time[(made.demand < 0.0) & (made.time > 0.5)][0]
    assert first - 3.0 == pytest.approx(1.15 + 0.2, abs=0.12)


def test_it_avoids_a_cut_in_that_the_careful_driver_hits():
    events = group.cut_in(20.0, 30.0)
    driver = drive(at(EMPTY, 80.0, 12.0), events, guard=CarefulDriver())
    aeb = drive(at(EMPTY, 80.0, 12.0), events)
    assert driver.impact > 15.0 * KMH
    assert aeb.impact == 0.0
    assert aeb.first(EmergencyState.BRAKING) > 3.0


def test_it_does_not_react_to_cars_at_both_sides_but_sees_them():
    found = group.false_reactions(EMPTY, TIMESTEP, quick=True)
    assert all(check.ok for check in found.checks)
    near = PlaceVehicle(
        name="car", gap=40.0, relative_lane=0, offset=1.3, speed=0.0, reactive=False
    )
    assert drive(at(EMPTY, 50.0, 4.0), (near,)).reacted
