"""The battery of the emergency braking tests what it says."""

import dataclasses

import pytest

from controllers.emergency_braking import EmergencyState
from iits_mj.core.units import KMH
from iits_mj.validation.aeb import group
from iits_mj.validation.aeb.drives import Setup, drive, kmh
from traffic_bridge import PlaceVehicle

SETUP = Setup(speed=0.0, events=())


def test_the_regulations_main_test_holds_with_noisy_sensors():
    found = group._standing(dataclasses.replace(SETUP, payload=36_000.0), quick=True)
    assert [check.name for check in found.checks if not check.ok] == []
    assert len(found.checks) == 7


@pytest.mark.parametrize(("guard", "hits"), [("none", True), ("aeb", False)])
def test_a_child_is_hit_only_without_it(guard, hits, monkeypatch):
    monkeypatch.setattr(group, "drive", lambda s: drive(dataclasses.replace(s, guard=guard)))
    (check,) = group._child(dataclasses.replace(SETUP, payload=0.0), quick=True).checks
    assert (check.value > 0.0) == hits


def test_the_blind_planner_hits_a_car_at_its_own_speed():
    car = PlaceVehicle(name="car", gap=30.0, relative_lane=0, speed=5.0, reactive=False)
    made = drive(Setup(speed=15.0, events=(car,), guard="none", duration=5.0))
    assert made.impact == pytest.approx(10.0, abs=0.3)
    assert "collision with car" in made.ended


def test_the_careful_driver_brakes_1_15_s_after_a_hard_braking():
    made = drive(
        Setup(speed=80.0 * KMH, events=group._braking(2.0, 8.0), guard="driver", duration=20.0)
    )
    assert made.impact == 0.0
    # At 3 s the car begins; its deceleration passes 5 m/s2 within 0.2 s, seen every 0.1 s.
    first = made.time[(made.demand < 0.0) & (made.time > 0.5)][0]
    assert first - 3.0 == pytest.approx(1.15 + 0.2, abs=0.12)


def test_it_avoids_a_cut_in_that_the_careful_driver_hits():
    setup = Setup(speed=80.0 * KMH, events=group._cut_in(20.0, 30.0), duration=12.0)
    driver = drive(dataclasses.replace(setup, guard="driver"))
    aeb = drive(setup)
    assert kmh(driver.impact) > 15.0
    assert aeb.impact == 0.0
    assert aeb.first(EmergencyState.BRAKING) > 3.0


def test_it_does_not_react_to_cars_at_both_sides_but_sees_them():
    found = group._false_reactions(dataclasses.replace(SETUP, payload=0.0), quick=True)
    assert all(check.ok for check in found.checks)
    aside = 0.5 * (group.CLEAR + 1.9)
    near = PlaceVehicle(
        name="car", gap=40.0, relative_lane=0, offset=0.4 * aside, speed=0.0, reactive=False
    )
    assert drive(Setup(speed=50.0 * KMH, events=(near,), duration=4.0)).reacted
