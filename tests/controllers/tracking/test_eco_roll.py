"""Neutral on request of the speed plan."""

from dataclasses import replace

import numpy as np
import pytest

from controllers.planning.speed_reference import check_profile
from controllers.stack import Stack
from controllers.tracking.eco_roll import eco_roll
from iits_mj.core.errors import InputError
from iits_mj.core.messages import (
    EgoState,
    PlanMode,
    Scene,
    SpeedProfile,
    Trajectory,
    TransmissionMode,
    VehicleCommand,
)
from iits_mj.road.measured import Lanes, measured_route

DRIVES = VehicleCommand(accelerator_pedal=0.2)
EGO = EgoState(speed=20.0, gear=12)


def trajectory(speed=20.0, mode=PlanMode.LANE_KEEPING):
    zero = np.zeros(2)
    columns = [np.array([0.0, 5.0]), *6 * [zero], zero, np.full(2, speed), zero]
    return Trajectory(*columns, mode=mode)


def test_rolling_truck_has_neutral_and_no_accelerator():
    command = eco_roll(DRIVES, EGO, trajectory())
    assert command.transmission_mode is TransmissionMode.NEUTRAL
    assert command.accelerator_pedal == 0.0


@pytest.mark.parametrize(
    "changed",
    [{"xbr_demand": -0.1}, {"engine_brake": 0.1}, {"retarder": 0.1}, {"brake_pedal": 0.1}],
)
def test_a_braking_command_stays_in_gear(changed):
    command = replace(DRIVES, accelerator_pedal=0.0, **changed)
    assert eco_roll(command, EGO, trajectory()) is command


def test_truck_off_its_plan_slow_or_in_an_emergency_stays_in_gear():
    for ego, plan in (
        (EGO, trajectory(18.5)),
        (replace(EGO, speed=5.0), trajectory(5.0)),
        (EGO, trajectory(mode=PlanMode.EMERGENCY)),
    ):
        assert eco_roll(DRIVES, ego, plan) is DRIVES


def test_the_stack_asks_for_neutral_on_the_stretches_of_its_profile():
    station = np.arange(0.0, 1_001.0, 10.0)
    route = measured_route(station, 0.0 * station, lanes=Lanes(speed_limit=40.0), name="road")
    neutral = np.array([False, True, False])
    profile = SpeedProfile(np.array([0.0, 200.0, 300.0]), np.full(3, 20.0), neutral)
    stack = Stack(route, profile=profile)
    modes = []
    for place in (100.0, 250.0, 350.0):
        ego = EgoState(
            station=place, offset=float(route.lane_offset(0, place)), speed=20.0, gear=12
        )
        stack.reset()
        stack.plan(Scene(0.0, ego, ()))
        modes.append(stack.control(ego).transmission_mode)
    drive, roll = TransmissionMode.DRIVE, TransmissionMode.NEUTRAL
    assert modes == [drive, roll, drive]


def test_the_stack_burns_no_fuel_above_the_speed_of_its_profile_from_which_on_it_coasts():
    station = np.arange(0.0, 1_001.0, 10.0)
    route = measured_route(station, 0.0 * station, lanes=Lanes(speed_limit=40.0), name="road")
    place = EgoState(station=100.0, offset=float(route.lane_offset(0, 100.0)), gear=12)
    pedals = []
    for coast_above in (np.inf, 19.9, 20.1):
        profile = SpeedProfile(np.array([0.0, 900.0]), np.full(2, 20.0), coast_above=coast_above)
        stack = Stack(route, profile=profile)
        ego = replace(place, speed=20.0)
        stack.plan(Scene(0.0, ego, ()))
        for _ in range(20):
            command = stack.control(ego)
        pedals.append(command.accelerator_pedal)
    assert pedals[0] == pedals[2] > 0.1
    assert pedals[1] == 0.0


def test_profile_that_always_coasts_is_refused():
    for value in (0.0, -1.0, np.nan):
        profile = SpeedProfile(np.array([0.0, 1.0]), np.full(2, 20.0), coast_above=value)
        with pytest.raises(InputError, match="coast_above"):
            check_profile(profile, "speed profile")


def test_profile_with_neutral_for_other_stations_is_refused():
    profile = SpeedProfile(np.array([0.0, 1.0]), np.full(2, 20.0), np.array([True]))
    with pytest.raises(InputError, match="neutral"):
        check_profile(profile, "speed profile")
