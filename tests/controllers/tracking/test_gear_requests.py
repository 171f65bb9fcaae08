"""Forward gear and neutral on request of the speed plan."""

from dataclasses import replace

import numpy as np
import pytest

from controllers.planning.speed_reference import check_profile
from controllers.stack import Stack
from controllers.tracking.gear_requests import GearKeeper, in_planned_gear
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
EGO = EgoState(station=100.0, speed=20.0, gear=12)
DRIVE, ROLL, ELEVENTH = (
    TransmissionMode.DRIVE,
    TransmissionMode.NEUTRAL,
    TransmissionMode.forward(11),
)


def trajectory(speed=20.0, mode=PlanMode.LANE_KEEPING):
    zero = np.zeros(2)
    columns = [np.array([0.0, 5.0]), *6 * [zero], zero, np.full(2, speed), zero]
    return Trajectory(*columns, mode=mode)


def profile(mode, speed=20.0):
    return SpeedProfile(np.array([0.0, 900.0]), np.full(2, speed), np.full(2, mode))


def test_rolling_truck_has_neutral_and_no_accelerator():
    command = in_planned_gear(DRIVES, EGO, trajectory(), profile(ROLL))
    assert command == replace(DRIVES, transmission_mode=ROLL, accelerator_pedal=0.0)


def test_planned_gear_leaves_the_accelerator_as_it_is():
    command = in_planned_gear(DRIVES, EGO, trajectory(), profile(ELEVENTH))
    assert command == replace(DRIVES, transmission_mode=ELEVENTH)
    assert command.transmission_mode.gear == 11
    assert in_planned_gear(DRIVES, EGO, trajectory(), profile(DRIVE)) is DRIVES


@pytest.mark.parametrize("mode", [ROLL, ELEVENTH])
@pytest.mark.parametrize(
    "changed",
    [{"xbr_demand": -0.1}, {"engine_brake": 0.1}, {"retarder": 0.1}, {"brake_pedal": 0.1}],
)
def test_gearbox_of_a_braking_truck_chooses_the_gear(changed, mode):
    command = replace(DRIVES, accelerator_pedal=0.0, **changed)
    assert in_planned_gear(command, EGO, trajectory(), profile(mode)) is command


@pytest.mark.parametrize("mode", [ROLL, ELEVENTH])
def test_gearbox_of_a_truck_off_its_plan_slow_or_in_an_emergency_chooses_the_gear(mode):
    for ego, plan, planned in (
        (EGO, trajectory(18.5 if mode is ROLL else 20.0), profile(mode, 23.5)),
        (replace(EGO, speed=5.0), trajectory(5.0), profile(mode, 5.0)),
        (EGO, trajectory(mode=PlanMode.EMERGENCY), profile(mode)),
        (replace(EGO, station=900.0), trajectory(), profile(mode)),
    ):
        assert in_planned_gear(DRIVES, ego, plan, planned) is DRIVES


def test_the_stack_asks_for_gears_on_the_stretches_of_its_profile():
    station = np.arange(0.0, 1_001.0, 10.0)
    route = measured_route(station, 0.0 * station, lanes=Lanes(speed_limit=40.0), name="road")
    planned = SpeedProfile(
        np.array([0.0, 200.0, 300.0, 400.0]), np.full(4, 20.0), np.array([DRIVE, ROLL, ELEVENTH, 0])
    )
    stack = Stack(route, profile=planned)
    modes = []
    for place in (100.0, 250.0, 350.0, 450.0):
        ego = EgoState(
            station=place, offset=float(route.lane_offset(0, place)), speed=20.0, gear=12
        )
        stack.reset()
        stack.plan(Scene(0.0, ego, ()))
        modes.append(stack.control(ego).transmission_mode)
    assert modes == [DRIVE, ROLL, ELEVENTH, DRIVE]


def test_the_stack_burns_no_fuel_above_the_speed_of_its_profile_from_which_on_it_coasts():
    station = np.arange(0.0, 1_001.0, 10.0)
    route = measured_route(station, 0.0 * station, lanes=Lanes(speed_limit=40.0), name="road")
    place = EgoState(station=100.0, offset=float(route.lane_offset(0, 100.0)), gear=12)
    pedals = []
    for coast_above in (np.inf, 19.9, 20.1):
        planned = SpeedProfile(np.array([0.0, 900.0]), np.full(2, 20.0), coast_above=coast_above)
        stack = Stack(route, profile=planned)
        ego = replace(place, speed=20.0)
        stack.plan(Scene(0.0, ego, ()))
        for _ in range(20):
            command = stack.control(ego)
        pedals.append(command.accelerator_pedal)
    assert pedals[0] == pedals[2] > 0.1
    assert pedals[1] == 0.0


def test_profile_that_always_coasts_is_refused():
    for value in (0.0, -1.0, np.nan):
        planned = SpeedProfile(np.array([0.0, 1.0]), np.full(2, 20.0), coast_above=value)
        with pytest.raises(InputError, match="coast_above"):
            check_profile(planned, "speed profile")


@pytest.mark.parametrize("modes", [[1], [0, 2], [0, 21], [-1, 0]])
def test_profile_with_modes_for_other_stations_or_that_cannot_be_planned_is_refused(modes):
    planned = SpeedProfile(np.array([0.0, 1.0]), np.full(2, 20.0), np.array(modes))
    with pytest.raises(InputError, match="transmission_mode"):
        check_profile(planned, "speed profile")


def test_a_lane_change_keeps_the_gear_in_which_it_began():
    keeper, changing = GearKeeper(), trajectory(mode=PlanMode.LANE_CHANGE)
    ninth = replace(EGO, gear=9)
    assert keeper.keep(DRIVES, ninth, trajectory()) is DRIVES
    # A gear change under way is not interrupted; the gear that it engages is kept.
    assert keeper.keep(DRIVES, replace(EGO, shift_in_process=True), changing) is DRIVES
    kept = replace(DRIVES, transmission_mode=TransmissionMode.forward(9))
    assert keeper.keep(DRIVES, ninth, changing) == kept
    assert keeper.keep(DRIVES, replace(EGO, gear=10), changing) == kept
    assert keeper.keep(DRIVES, ninth, trajectory()) is DRIVES


def test_the_gear_is_not_kept_by_a_truck_that_brakes_is_slow_aborts_or_has_a_planned_gear():
    changing = trajectory(mode=PlanMode.LANE_CHANGE)
    rolls = replace(DRIVES, transmission_mode=ROLL)
    brakes = replace(DRIVES, accelerator_pedal=0.0, engine_brake=0.1)
    for command, ego, plan in (
        (rolls, EGO, changing),
        (brakes, EGO, changing),
        (DRIVES, replace(EGO, speed=5.0), changing),
        (DRIVES, EGO, trajectory(mode=PlanMode.ABORT)),
    ):
        assert GearKeeper().keep(command, ego, plan) is command
