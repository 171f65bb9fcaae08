"""The stop in lane, on the MuJoCo truck."""

import dataclasses
import math

import numpy as np
import pytest

from controllers.planning.config import PlannerConfig, SpeedConfig
from controllers.safe_stop.fallback import CommandSource, Fallback, FallbackConfig
from controllers.safe_stop.stop import SafeStop, SafeStopConfig, StopPhase
from controllers.stack import Stack
from iits_mj.core.errors import InputError
from iits_mj.core.messages import (
    Decision,
    EgoState,
    Scene,
    TransmissionMode,
    VehicleCommand,
    XbrMode,
)
from iits_mj.road import RoadMap, Route
from iits_mj.truck import Truck
from tests.controllers.scenes import Script

TIME, STATION, SPEED, ERROR, DEMAND, PARKING = range(6)
LEFT_AT_2_S = Script(at2=Decision.LEFT)


def stopped(route, payload, station, speed, cut, maker=None, longest=40.0, last=None):
    """Drives with the stack until `cut`, then stops; rows until the truck is parked."""
    truck = Truck.load(payload=payload, route=route, visuals=False)
    truck.reset(station=station, offset=float(route.lane_offset(0, station)), speed=speed)
    config = PlannerConfig(speed=SpeedConfig(cruise_speed=max(speed, 0.5)))
    stack = Stack(route, maker, config, parameters=truck.parameters)
    stop = SafeStop(route, truck.parameters)
    stop.prepare(truck.observe())
    rows, command = [], VehicleCommand()
    while truck.time < longest and stop.phase is not StopPhase.PARKED:
        ego = truck.observe()
        if ego.time < cut - 1e-6:
            if round(ego.time * 50) % 5 == 0:
                stack.plan(Scene(ego.time, ego, ()))
            command = stack.control(ego)
        else:
            command = stop.command(ego, last or command)
        truck.command(command)
        truck.step(10)
        middle = float(route.lane_offset(max(stop.lane, 0), ego.station))
        error = ego.offset - middle
        row = (ego.time, ego.station, ego.speed, error, command.xbr_demand, command.parking_brake)
        rows.append(row)
    return np.array(rows), stop


def braking(rows, cut):
    """Deceleration [m/s2] and jerk [m/s3], means over 0.2 s, above 0.5 m/s."""
    after = rows[(rows[:, TIME] >= cut) & (rows[:, SPEED] > 0.5)]
    mean = np.convolve(np.gradient(after[:, SPEED], 0.02), np.ones(10) / 10.0, "valid")
    return -mean, np.gradient(mean, 0.02)


@pytest.mark.parametrize(
    "payload", [36_000.0, pytest.param(0.0, marks=pytest.mark.slow)], ids=["laden", "empty"]
)
def test_bus_cut_at_80_km_h_in_a_bend_ends_parked_in_the_lane(payload):
    # Left-hand bend of 620 m.
    route = RoadMap.builtin().route()
    rows, stop = stopped(route, payload, 10_960.0, 22.2, cut=4.0)
    assert stop.phase is StopPhase.PARKED
    after = rows[rows[:, TIME] >= 4.0]
    assert after[0, SPEED] * 3.6 > 77.0
    assert np.abs(after[:, ERROR]).max() < 0.3
    deceleration, jerk = braking(rows, 4.0)
    assert deceleration.max() < 2.0
    assert np.abs(jerk).max() < 2.5
    way = after[-1, STATION] - after[0, STATION]
    assert way == pytest.approx(after[0, SPEED] ** 2 / 3.0, abs=20.0)
    # The truck does not creep at standstill.
    standing = after[np.abs(after[:, SPEED]) < 0.05]
    assert np.ptp(standing[:, STATION]) < 0.03


def test_the_empty_truck_stays_in_its_lane_on_packed_snow():
    # Friction 0.2, with 1.5 m/s2 along and 0.8 across.
    route = RoadMap.builtin().route().with_friction(0.2)
    rows, stop = stopped(route, 0.0, 10_960.0, 22.2, cut=4.0)
    assert stop.phase is StopPhase.PARKED
    assert np.abs(rows[:, ERROR]).max() < 0.3


@pytest.mark.parametrize("grade", [-0.08, 0.08])
def test_the_laden_truck_stops_and_stays_on_8_percent(grade):
    route = Route.straight(length=1500.0, grade=grade)
    rows, stop = stopped(route, 36_000.0, 100.0, 10.0, cut=0.5)
    assert stop.phase is StopPhase.PARKED
    assert braking(rows, 0.5)[0].max() < 2.2
    standing = rows[(np.abs(rows[:, SPEED]) < 0.05) & (rows[:, TIME] > 1.0)]
    assert np.ptp(standing[:, STATION]) < 0.05


def test_the_stop_reverts_a_lane_change_that_has_hardly_begun():
    route = RoadMap.builtin().route()
    rows, stop = stopped(route, 36_000.0, 4700.0, 16.67, cut=3.5, maker=LEFT_AT_2_S)
    assert stop.lane == 0
    assert abs(rows[-1, ERROR]) < 0.2


def test_the_stop_finishes_a_lane_change_that_is_half_done():
    route = RoadMap.builtin().route()
    rows, stop = stopped(route, 36_000.0, 4700.0, 16.67, cut=5.5, maker=LEFT_AT_2_S)
    assert stop.lane == 1
    assert abs(rows[-1, ERROR]) < 0.2
    after = rows[rows[:, TIME] >= 5.5]
    assert after[0, ERROR] < -1.0
    assert after[:, ERROR].max() < 0.3


def test_the_stop_is_not_weaker_than_the_last_demand():
    route = Route.straight(length=1000.0)
    emergency = VehicleCommand(xbr_demand=-4.0, xbr_mode=XbrMode.MAXIMUM)
    rows, _ = stopped(route, 0.0, 100.0, 20.0, cut=0.1, last=emergency)
    assert 3.5 < braking(rows, 0.1)[0].max() < 5.0


def test_the_truck_stops_before_the_road_ends():
    route = Route.straight(length=250.0)
    rows, stop = stopped(route, 36_000.0, 100.0, 20.0, cut=0.0)
    assert stop.phase is StopPhase.PARKED
    assert rows[-1, STATION] + 1.4 < 250.0
    assert braking(rows, 0.0)[0].max() < 4.5


def test_a_standing_truck_is_parked_after_a_second():
    rows, _ = stopped(Route.straight(length=500.0), 0.0, 100.0, 0.0, cut=0.0)
    assert rows[-1, PARKING] == 1.0
    assert 1.0 <= rows[-1, TIME] < 2.5
    assert abs(rows[-1, STATION] - 100.0) < 0.05


@pytest.fixture(scope="module")
def made():
    """One stop for all, since its steering gains take a while."""
    return SafeStop(Route.straight(length=2000.0))


@pytest.fixture
def stop(made):
    made.reset()
    return made


def _ego(**fields):
    return EgoState(station=100.0, x=100.0, **fields)


def test_a_reversing_truck_is_braked_with_the_wheel_held_and_the_driveline_open(stop):
    last = VehicleCommand(transmission_mode=TransmissionMode.REVERSE, steering_wheel_angle=0.3)
    for k in range(50):
        ego = _ego(time=0.02 * k, speed=-2.0, gear=-1, steering_wheel_angle=0.3)
        command = stop.command(ego, last)
    assert command.transmission_mode is TransmissionMode.NEUTRAL
    assert command.xbr_demand <= -0.5
    assert command.steering_wheel_angle == pytest.approx(0.3)


def test_on_a_road_without_lanes_the_truck_stops_straight_on():
    stop = SafeStop(Route.straight(length=500.0))
    stop.preview.offset[:] = math.nan
    for k in range(100):
        ego = _ego(time=0.02 * k, speed=10.0, offset=1.5, y=1.5)
        command = stop.command(ego)
    assert command.steering_wheel_angle == pytest.approx(0.0, abs=0.05)
    assert command.xbr_demand < -1.0


def test_service_brakes_hold_until_the_spring_brakes_are_applied(stop):
    commands = {}
    for k in range(300):
        ego = _ego(time=0.02 * k)
        commands[k] = stop.command(ego)
    assert commands[40].parking_brake == 0.0
    assert commands[60].parking_brake == 1.0
    assert commands[60].xbr_mode is XbrMode.MAXIMUM
    assert commands[149].xbr_demand < -1.0
    assert commands[160].xbr_mode is XbrMode.OFF
    assert commands[299].parking_brake == 1.0


def test_a_parked_truck_that_slides_keeps_its_parking_brake_and_brakes_again(stop):
    for k in range(250):
        stop.command(_ego(time=0.02 * k))
    for k in range(250, 300):
        command = stop.command(_ego(time=0.02 * k, speed=0.4))
    assert command.parking_brake == 1.0
    assert command.xbr_demand < -1.0


@pytest.mark.parametrize("name", ["speed", "station", "yaw", "x", "articulation", "yaw_rate"])
def test_a_state_that_is_not_finite_is_refused(stop, name):
    with pytest.raises(InputError, match=name):
        stop.command(dataclasses.replace(_ego(), **{name: math.nan}))


def test_a_state_that_stops_being_finite_is_refused(stop):
    stop.command(_ego(speed=10.0))
    with pytest.raises(InputError, match="lateral_speed"):
        stop.command(_ego(time=0.02, speed=10.0, lateral_speed=math.inf))


@pytest.mark.parametrize(
    "wrong", [{"deceleration_max": 1.0}, {"standing_time": math.nan}, {"stop_gap": -1.0}]
)
def test_impossible_settings_are_refused(wrong):
    with pytest.raises(InputError, match=next(iter(wrong))):
        SafeStopConfig(**wrong)


@pytest.fixture
def make_fallback(stop):
    return lambda **settings: Fallback(stop, FallbackConfig(**settings))


def test_commands_pass_untouched_while_they_arrive(make_fallback):
    fallback = make_fallback()
    command = VehicleCommand(accelerator_pedal=0.7, steering_wheel_angle=0.1)
    for k in range(10):
        assert fallback.command(_ego(time=0.02 * k, speed=10.0), command, False) is command
    assert fallback.stops == 0


def _lose(fallback, until=2.0, speed=10.0):
    """A loss from the start until a time; returns the last command."""
    for k in range(round(until / 0.02)):
        obeyed = fallback.command(_ego(time=0.02 * k, speed=speed), VehicleCommand(), True)
    return obeyed


def test_returning_commands_take_over_without_a_step(make_fallback):
    fallback = make_fallback(return_time=0.5, blend_time=1.0)
    before = _lose(fallback)
    received = VehicleCommand(accelerator_pedal=0.8, steering_wheel_angle=0.5)
    obeyed = []
    for k in range(200):
        ego = _ego(time=2.0 + 0.02 * k, speed=10.0)
        obeyed.append(fallback.command(ego, received, False))
    # The stop lasts half a second more, then both blend over a second.
    assert fallback.source is CommandSource.COMMANDS
    assert obeyed[20].accelerator_pedal == 0.0
    assert obeyed[-1] == received
    wheel = [before.steering_wheel_angle] + [c.steering_wheel_angle for c in obeyed]
    demand = [before.xbr_demand] + [c.xbr_demand for c in obeyed]
    assert np.abs(np.diff(wheel)).max() < 0.03
    assert np.abs(np.diff(demand)).max() < 0.06
    assert all(0.0 <= c.accelerator_pedal <= 0.8 for c in obeyed)


def test_commands_with_gaps_do_not_end_the_stop(make_fallback):
    fallback = make_fallback(return_time=0.5)
    _lose(fallback)
    received = VehicleCommand(accelerator_pedal=0.8)
    for k in range(100):
        ego = _ego(time=2.0 + 0.02 * k, speed=10.0)
        command = fallback.command(ego, received, lost=k % 20 == 0)
        assert command.accelerator_pedal == 0.0
    assert fallback.source is CommandSource.STOP
    assert fallback.stops == 1


def test_commands_lost_again_while_returning_begin_a_new_stop(make_fallback):
    fallback = make_fallback(return_time=0.1, blend_time=1.0)
    _lose(fallback)
    for k in range(20):
        fallback.command(_ego(time=2.0 + 0.02 * k, speed=10.0), VehicleCommand(), False)
    assert fallback.source is CommandSource.RETURNING
    fallback.command(_ego(time=2.4, speed=10.0), VehicleCommand(), True)
    assert fallback.source is CommandSource.STOP
    assert fallback.stops == 2


def test_a_stopped_truck_waits_for_a_released_pedal_if_configured(make_fallback):
    fallback = make_fallback(acknowledge=True, return_time=0.1)
    _lose(fallback, speed=0.0)
    pressed, free = VehicleCommand(accelerator_pedal=0.5), VehicleCommand()
    for k in range(100):
        fallback.command(_ego(time=2.0 + 0.02 * k), pressed, False)
    assert fallback.source is CommandSource.STOP
    for k in range(100, 200):
        fallback.command(_ego(time=2.0 + 0.02 * k), free if k < 110 else pressed, False)
    assert fallback.source is CommandSource.COMMANDS


def test_a_harder_demand_of_the_returning_commands_counts_at_once(make_fallback):
    fallback = make_fallback(return_time=0.0, blend_time=1.0)
    _lose(fallback)
    hard = VehicleCommand(xbr_demand=-5.0, xbr_mode=XbrMode.ADDITION)
    fallback.command(_ego(time=2.0, speed=10.0), hard, False)
    command = fallback.command(_ego(time=2.02, speed=10.0), hard, False)
    assert (command.xbr_demand, command.xbr_mode) == (-5.0, XbrMode.ADDITION)


def test_an_active_emergency_brake_counts_while_the_driving_commands_are_missing(make_fallback):
    fallback = make_fallback()
    _lose(fallback)
    weak = VehicleCommand(xbr_demand=-0.1, xbr_mode=XbrMode.MAXIMUM)
    hard = VehicleCommand(xbr_demand=-8.0, xbr_mode=XbrMode.MAXIMUM, brake_pedal=0.9)
    own = fallback.command(_ego(time=2.0, speed=10.0), weak, True)
    assert own.xbr_demand < -1.0
    assert own.brake_pedal == 0.0
    braked = fallback.command(_ego(time=2.02, speed=10.0), hard, True)
    assert (braked.xbr_demand, braked.brake_pedal) == (-8.0, 0.9)
    assert braked.accelerator_pedal == 0.0
    released = fallback.command(_ego(time=2.04, speed=10.0), VehicleCommand(), True)
    assert released.xbr_demand == pytest.approx(own.xbr_demand, abs=0.1)
    assert released.brake_pedal == 0.0
    assert fallback.source is CommandSource.STOP


@pytest.mark.parametrize("wrong", [{"return_time": math.inf}, {"blend_time": -0.1}])
def test_impossible_settings_of_the_return_are_refused(wrong):
    with pytest.raises(InputError, match=next(iter(wrong))):
        FallbackConfig(**wrong)


@pytest.mark.slow
def test_a_drive_continues_after_two_seconds_without_the_bus():
    route = Route.straight(length=2000.0)
    truck = Truck.load(payload=0.0, route=route, visuals=False)
    truck.reset(station=100.0, offset=float(route.lane_offset(0, 100.0)), speed=15.0)
    stack = Stack(route, planner=PlannerConfig(speed=SpeedConfig(cruise_speed=15.0)))
    fallback = Fallback(SafeStop(route, truck.parameters))
    speeds = []
    for k in range(round(14.0 * 50)):
        ego = truck.observe()
        lost = 1.0 <= ego.time < 3.0
        if k % 5 == 0:
            stack.plan(Scene(ego.time, ego, ()))
        command = fallback.command(ego, stack.control(ego), lost)
        truck.command(command)
        truck.step(10)
        speeds.append(ego.speed)
    assert fallback.source is CommandSource.COMMANDS
    assert 10.0 < min(speeds) < 13.5
    assert speeds[-1] > min(speeds) + 1.5
