"""The safe stop call by call: lane, limits, phases, demand, and the way back to commands."""

import dataclasses
import math

import numpy as np
import pytest

from controllers.planning.speed_plan import SpeedState
from controllers.safe_stop.fallback import CommandSource, Fallback, FallbackConfig
from controllers.safe_stop.stop import (
    SafeStop,
    SafeStopConfig,
    StopLimits,
    StopPhase,
    roll_to_stop,
    stop_distance,
)
from iits_mj.core.errors import InputError
from iits_mj.core.messages import (
    EgoState,
    PlanMode,
    TransmissionMode,
    VehicleCommand,
    XbrEbiMode,
    XbrMode,
)
from iits_mj.core.timing import CONTROL_PERIOD
from iits_mj.parameters import TruckParameters
from iits_mj.road import Route
from tests.controllers.scenes import RightLaneEnds

ROUTE = Route.straight(length=2000.0, lanes=2)
PARAMETERS = TruckParameters.load()
CONFIG = SafeStopConfig()
LIMITS = CONFIG.limits
MIDDLE = float(ROUTE.lane_offset(0, 100.0))
LEFT = float(ROUTE.lane_offset(1, 100.0))


@pytest.fixture(scope="module")
def made():
    return SafeStop(ROUTE, PARAMETERS)


@pytest.fixture
def stop(made):
    made.reset()
    return made


def ego(offset=MIDDLE, station=100.0, **fields):
    values = {"speed": 20.0, "mass": 55_000.0} | fields
    return EgoState(station=station, x=station, offset=offset, y=offset, **values)


# --- limits ---------------------------------------------------------------------------------


def test_the_deceleration_eases_to_its_last_value_at_constant_jerk():
    limits = StopLimits(1.5, 1.0, 0.8, 0.25)
    assert limits.wanted(0.0) == limits.wanted(-3.0) == -0.25
    assert limits.wanted(0.5) == pytest.approx(-math.sqrt(0.25**2 + 1.6 * 0.5))
    assert limits.wanted(20.0) == -1.5


@pytest.mark.parametrize("name", ["deceleration", "jerk"])
def test_the_limits_are_allowed_up_to_10_and_their_ends_up_to_themselves(name):
    wide = StopLimits(10.0, 10.0)
    assert dataclasses.replace(wide, **{f"{name}_end": 10.0})
    with pytest.raises(InputError, match=f"{name} = 10.1: allowed is above 0 to 10"):
        dataclasses.replace(wide, **{name: 10.1})
    with pytest.raises(InputError, match=f"{name}_end = 10.1: allowed is above 0 to {name} = 10"):
        dataclasses.replace(wide, **{f"{name}_end": 10.1})
    with pytest.raises(InputError, match=f"{name}_end = 0.0"):
        dataclasses.replace(wide, **{f"{name}_end": 0.0})


def test_the_greatest_deceleration_is_between_the_limits_and_10():
    assert SafeStopConfig(deceleration_max=LIMITS.deceleration).deceleration_max == 1.5
    assert SafeStopConfig(deceleration_max=10.0).deceleration_max == 10.0
    with pytest.raises(InputError, match=r"deceleration 1\.5 to 10"):
        SafeStopConfig(deceleration_max=10.1)
    for name in ("standing_time", "parking_time", "stop_gap", "off_center", "look_ahead"):
        assert getattr(SafeStopConfig(**{name: 0.0}), name) == 0.0
        with pytest.raises(InputError, match=name):
            SafeStopConfig(**{name: -0.1})


# --- the profile ----------------------------------------------------------------------------


def test_the_rolled_profile_is_the_integral_of_its_acceleration():
    step = 0.1
    s, v, a = roll_to_stop(SpeedState(50.0, 12.0, 0.2), LIMITS, 80, step)
    assert (s[0], v[0], a[0]) == (50.0, 12.0, 0.2)
    moving = v[1:] > 0.0
    assert np.diff(v)[moving] == pytest.approx(step * a[:-1][moving])
    assert np.diff(s)[moving] == pytest.approx((step * v[:-1] + 0.5 * step**2 * a[:-1])[moving])
    assert np.abs(np.diff(a)[moving]).max() <= LIMITS.jerk * step + 1e-12
    assert np.diff(a).min() == pytest.approx(-LIMITS.jerk * step)


def test_the_last_step_ends_where_the_truck_comes_to_rest():
    s, v, a = roll_to_stop(SpeedState(0.0, 0.1, -2.0), LIMITS, 3, 0.1)
    assert s[1:] == pytest.approx(np.full(3, 0.5 * 0.1 * 0.1))
    assert not v[1:].any()
    assert not a[1:].any()
    backward = roll_to_stop(SpeedState(3.0, -1.0, 0.5), LIMITS, 2, 0.1)
    assert backward[0] == pytest.approx(np.full(3, 3.0))


@pytest.mark.parametrize(("speed", "acceleration"), [(20.0, 0.0), (8.0, -1.0), (12.0, 0.5)])
def test_the_stopping_distance_is_that_of_the_profile(speed, acceleration):
    start = SpeedState(0.0, speed, acceleration)
    rolled = roll_to_stop(start, LIMITS, 4000, 0.01)[0][-1]
    assert stop_distance(speed, acceleration, LIMITS) == pytest.approx(rolled, rel=0.02)
    assert stop_distance(0.0, 0.0, LIMITS) == stop_distance(-2.0, 0.0, LIMITS) == 0.0


# --- the beginning --------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("offset", "sideways", "lane"),
    [
        (0.1, 0.0, 0),
        (0.45, 0.0, 0),
        (0.55, 0.0, 1),
        # One second ahead at its sideways speed decides.
        (0.45, 0.1, 1),
        (0.55, -0.1, 0),
    ],
)
def test_the_lane_is_the_nearest_one_in_a_second(stop, offset, sideways, lane):
    width = LEFT - MIDDLE
    stop.command(ego(MIDDLE + offset * width, lateral_speed=sideways * width))
    assert stop.lane == lane
    assert stop.trajectory.target_lane == lane
    assert (stop.trajectory.mode, stop.trajectory.reason) == (PlanMode.EMERGENCY, "stop in lane")


@pytest.mark.parametrize(("aside", "curve"), [(0.19, False), (0.21, True), (-0.21, True)])
def test_a_truck_beside_its_lanes_middle_returns_by_a_curve(stop, aside, curve):
    stop.command(ego(MIDDLE + aside))
    assert (stop._residual is not None) is curve
    begin = aside if curve else 0.0
    assert stop.trajectory.offset[0] == pytest.approx(MIDDLE + begin)
    assert stop.trajectory.offset[-1] == pytest.approx(MIDDLE, abs=0.15)


def test_the_curve_begins_in_the_direction_of_motion_at_the_speed(stop):
    stop.command(ego(MIDDLE + 0.5, lateral_speed=1.0, yaw_rate=0.04))
    value, slope, bend, _ = stop._residual.evaluate(100.0)
    assert (value, slope) == pytest.approx((0.5, 1.0 / 20.0))
    assert bend == pytest.approx(0.04 / 20.0)
    fast = stop._residual.length
    stop.reset()
    stop.command(ego(MIDDLE + 0.5, speed=5.0))
    assert stop._residual.length < fast


def test_slope_and_bend_of_the_motion_are_bounded_and_need_speed(stop):
    assert stop._slope(ego(yaw=0.1, lateral_speed=-1.0)) == pytest.approx(
        math.tan(0.1 - math.atan2(1.0, 20.0))
    )
    for side in (-1.0, 1.0):
        assert stop._slope(ego(yaw=side)) == pytest.approx(side * math.tan(0.3))
        assert stop._bend(ego(yaw_rate=side)) == side * 0.003
        assert stop._bend(ego(yaw_rate=0.04 * side)) == pytest.approx(side * 0.002)
    assert stop._slope(ego(yaw=0.2, speed=0.99)) == 0.0
    assert stop._slope(ego(yaw=0.2, speed=1.0)) == pytest.approx(math.tan(0.2))
    assert stop._bend(ego(yaw_rate=0.01, speed=4.99)) == 0.0
    assert stop._bend(ego(yaw_rate=0.01, speed=5.0)) == pytest.approx(0.002)


@pytest.mark.parametrize(("demand", "deceleration"), [(-1.0, 1.5), (-2.5, 2.5), (-9.0, 4.0)])
def test_the_stop_is_as_strong_as_the_last_demand_up_to_its_bound(stop, demand, deceleration):
    stop.command(ego(), VehicleCommand(xbr_demand=demand, xbr_mode=XbrMode.MAXIMUM))
    assert stop._limits.deceleration == deceleration
    assert stop._limits.jerk == pytest.approx(deceleration / LIMITS.deceleration)
    # Without an active mode, the demand does not count.
    stop.reset()
    stop.command(ego(), VehicleCommand(xbr_demand=demand))
    assert stop._limits == LIMITS


def test_a_short_road_needs_a_greater_deceleration(stop):
    distance = stop_distance(20.0, 0.0, LIMITS)
    start = SpeedState(0.0, 20.0, 0.0)
    assert stop._sooner(start, distance) is stop._limits
    shorter = stop._sooner(start, 0.8 * distance)
    assert shorter.deceleration == pytest.approx(1.15 * 20.0**2 / (1.6 * distance))
    assert stop._sooner(start, 0.0).deceleration == CONFIG.deceleration_max
    # A jerk limit is at most 10 m/s3.
    stop._limits = dataclasses.replace(LIMITS, jerk=6.0)
    assert stop._at_least(4.0).jerk == 10.0
    # The gap to the end of the road is that of the front bumper.
    left = stop.preview.route.length - ego().station
    stop._limits = LIMITS
    near = stop.preview.route.length - distance - CONFIG.stop_gap
    near -= PARAMETERS.lead.front_overhang
    for spare, harder in ((1.0, False), (-3.0, True)):
        stop.reset()
        stop.command(ego(station=near - spare))
        least = float(stop.trajectory.acceleration.min())
        assert (least < -LIMITS.deceleration - 1e-6) is harder
    assert left > distance


def test_the_plan_continues_the_last_one_near_the_trucks_speed(stop):
    first = stop._start(ego(acceleration=0.9))
    assert (first.speed, first.acceleration) == (20.0, 0.5)
    assert stop._start(ego(acceleration=-3.0)).acceleration == -LIMITS.deceleration
    assert stop._start(ego(acceleration=-0.7)).acceleration == -0.7
    stop.command(ego())
    plan, reach = stop.trajectory, CONFIG.resync_speed
    now = float(plan.time[5])
    planned, pull = float(plan.speed[5]), float(plan.acceleration[5])
    for speed, expected in (
        (planned, planned),
        (planned + 2.0 * reach, planned + reach),
        (planned - 2.0 * reach, planned - reach),
    ):
        found = stop._start(ego(time=now, speed=speed))
        assert (found.speed, found.acceleration) == pytest.approx((expected, pull))
    for time in (float(plan.time[0]), float(plan.time[-1])):
        at = float(np.interp(time, plan.time, plan.speed))
        assert stop._start(ego(time=time, speed=at + 0.1)).speed == pytest.approx(at)
    # Outside the plan the truck's own state counts.
    late = stop._start(ego(time=float(plan.time[-1]) + 0.01, speed=9.0, acceleration=-0.3))
    assert (late.speed, late.acceleration) == (9.0, -0.3)
    assert stop._start(ego(time=now, speed=-5.0)).speed == 0.0


# --- cycles, phases, demand -----------------------------------------------------------------


def test_a_command_is_computed_every_20_ms_and_a_plan_every_100_ms(stop):
    first = stop.command(ego())
    plan = stop.trajectory
    assert stop.command(ego(time=0.019)) is first
    for k in range(1, 5):
        assert stop.command(ego(time=0.02 * k)) is not first
        assert stop.trajectory is plan
    stop.command(ego(time=0.1))
    assert stop.trajectory is not plan
    assert stop.trajectory.time[0] == pytest.approx(0.1)
    assert stop.trajectory.time[-1] == pytest.approx(0.1 + CONFIG.horizon)
    assert len(stop.trajectory.time) == round(CONFIG.horizon / CONFIG.step) + 1


def test_a_prepared_stop_has_not_begun(stop):
    stop.prepare(ego())
    assert stop.trajectory is None
    assert stop.lane == -1
    assert stop.phase is StopPhase.BRAKING
    assert stop._demand == 0.0
    assert stop.lateral._gains is not None


def test_the_phases_follow_from_standstill_and_its_duration(stop):
    for time, speed, phase in (
        (0.0, 0.05, StopPhase.BRAKING),
        (0.2, 0.049, StopPhase.STANDING),
        (1.1, -0.049, StopPhase.STANDING),
        (1.12, 0.06, StopPhase.BRAKING),
        (1.2, 0.0, StopPhase.STANDING),
        (2.19, 0.0, StopPhase.STANDING),
        (2.2, 0.0, StopPhase.PARKED),
        (2.3, 0.2, StopPhase.PARKED),
    ):
        stop._stand(ego(time=time, speed=speed))
        assert stop.phase is phase


def test_the_demand_is_the_plan_earlier_plus_the_correction_of_speed(stop):
    stop.command(ego())
    plan, step = stop.trajectory, 2.0 * LIMITS.jerk * CONTROL_PERIOD
    for excess in (0.0, 0.4, -0.4):
        stop._demand = 1.0
        now = 2.0
        planned = float(np.interp(now, plan.time, plan.speed))
        soon = float(np.interp(now + CONFIG.lead_time, plan.time, plan.acceleration))
        wanted = -soon + CONFIG.speed_gain * excess
        stop._brake(ego(time=now, speed=planned + excess), plan)
        assert stop._demand == pytest.approx(min(max(wanted, 1.0 - step), 1.0 + step))
        stop._demand = wanted
        stop._brake(ego(time=now, speed=planned + excess), plan)
        assert stop._demand == pytest.approx(wanted)
    # A reversing truck is braked by the magnitude of its speed.
    stop._demand = 3.0
    stop._brake(ego(time=2.0, speed=-planned), plan)
    assert stop._demand == pytest.approx(3.0 - step)


def test_near_standstill_and_at_rest_the_demand_holds_the_truck(stop):
    stop.command(ego())
    slow = dataclasses.replace(
        stop.trajectory,
        speed=np.full(41, 5.0),
        acceleration=np.zeros(41),
    )
    for speed, expected in ((0.99, LIMITS.deceleration_end), (1.0, 0.0)):
        stop._demand = expected
        stop._brake(ego(time=1.0, speed=speed), slow)
        assert stop._demand == pytest.approx(expected)
    stop.phase = StopPhase.STANDING
    stop._demand = CONFIG.hold_demand
    stop._brake(ego(time=1.0, speed=0.0), slow)
    assert stop._demand == CONFIG.hold_demand
    stop.phase = StopPhase.BRAKING
    stop._demand = CONFIG.deceleration_max
    stop._brake(ego(time=1.0, speed=40.0), slow)
    assert stop._demand == CONFIG.deceleration_max
    stop._demand = 0.0
    stop._brake(ego(time=1.0, speed=2.0), slow)
    assert stop._demand == 0.0


@pytest.mark.parametrize("speed", [-7.0, -5.9, 5.9, 6.1])
def test_the_driveline_is_open_at_low_speed_and_the_drivers_controls_stay(stop, speed):
    stop._last = VehicleCommand(
        parking_brake=1.0, brake_pedal=0.3, transmission_mode=TransmissionMode.DRIVE
    )
    stop._demand = 1.2
    command = stop._assemble(ego(speed=speed), 0.4)
    slow = abs(speed) < 6.0
    assert command == VehicleCommand(
        xbr_demand=-1.2,
        xbr_mode=XbrMode.MAXIMUM,
        steering_wheel_angle=0.4,
        parking_brake=1.0,
        brake_pedal=0.3,
        transmission_mode=TransmissionMode.NEUTRAL if slow else TransmissionMode.DRIVE,
        xbr_ebi_mode=XbrEbiMode.FRICTION_ONLY,
    )


@pytest.mark.parametrize(("time", "released"), [(3.99, False), (4.0, True)])
def test_the_service_brakes_are_released_after_the_parking_time(stop, time, released):
    stop.phase, stop._demand, stop._still_since = StopPhase.PARKED, 1.5, 1.0
    stop._last = VehicleCommand(brake_pedal=0.5)
    command = stop._assemble(ego(time=time, speed=0.0), 0.0)
    assert (command.parking_brake, command.brake_pedal) == (1.0, 0.0)
    assert command.xbr_mode is (XbrMode.OFF if released else XbrMode.MAXIMUM)
    assert command.xbr_demand == (0.0 if released else -1.5)


# --- fallback -------------------------------------------------------------------------------


class Braking:
    """A stop that always gives the same command."""

    def __init__(self, **fields):
        self.phase, self.resets = StopPhase.BRAKING, 0
        self.given = VehicleCommand(**fields)
        self.last = []

    def reset(self):
        self.resets += 1

    def command(self, ego, last=None):
        self.last.append(last)
        return self.given


def fallback(given=None, **settings):
    stop = Braking(**(given or {"xbr_demand": -1.5, "xbr_mode": XbrMode.MAXIMUM}))
    return Fallback(stop, FallbackConfig(**settings))


def test_a_loss_begins_one_stop_with_the_last_command():
    made = fallback()
    driving = VehicleCommand(accelerator_pedal=0.5, steering_wheel_angle=0.2)
    made.command(ego(), driving, lost=False)
    for k in range(3):
        made.command(ego(time=0.02 * k), VehicleCommand(), lost=True)
    assert made.stops == 1
    assert made.stop.resets == 2
    assert made.stop.last[0] is driving
    assert made.source is CommandSource.STOP
    made.reset()
    assert (made.stops, made.source) == (0, CommandSource.COMMANDS)
    assert made.stop.resets == 3


@pytest.mark.parametrize(("back", "returns"), [(0.48, False), (0.5, True)])
def test_commands_count_again_after_the_time_without_a_gap(back, returns):
    made = fallback(return_time=0.5)
    made.command(ego(), VehicleCommand(), lost=True)
    made.command(ego(time=1.0), VehicleCommand(), lost=False)
    made.command(ego(time=1.0 + back), VehicleCommand(), lost=False)
    assert (made.source is CommandSource.RETURNING) is returns


def test_braking_and_steering_fade_in_proportion_to_time():
    given = {"xbr_demand": -2.0, "xbr_mode": XbrMode.MAXIMUM, "steering_wheel_angle": 0.6}
    made = fallback(given, return_time=0.0, blend_time=1.0)
    received = VehicleCommand(accelerator_pedal=0.8, steering_wheel_angle=0.2)
    made.command(ego(), VehicleCommand(), lost=True)
    assert made.command(ego(time=1.0), received, lost=False).xbr_demand == -2.0
    for share in (0.25, 0.75):
        found = made.command(ego(time=1.0 + share), received, lost=False)
        assert found.accelerator_pedal == pytest.approx(0.8 * share)
        assert found.steering_wheel_angle == pytest.approx(0.2 + 0.4 * (1.0 - share))
        assert found.xbr_demand == pytest.approx(-2.0 * (1.0 - share))
        assert (found.xbr_mode, found.xbr_ebi_mode) == (XbrMode.MAXIMUM, XbrEbiMode.FRICTION_ONLY)
    # A weaker demand of the commands does not weaken the braking, an equal or stronger one counts.
    weak = dataclasses.replace(received, xbr_demand=-0.4, xbr_mode=XbrMode.ADDITION)
    assert made.command(ego(time=1.75), weak, lost=False).xbr_demand == pytest.approx(-0.5)
    equal = dataclasses.replace(weak, xbr_demand=-0.5)
    assert made.command(ego(time=1.75), equal, lost=False).xbr_mode is XbrMode.ADDITION
    last = made.command(ego(time=2.0), received, lost=False)
    assert last == received
    assert made.source is CommandSource.COMMANDS


def test_without_a_blend_time_the_commands_count_at_once():
    made = fallback(return_time=0.0, blend_time=0.0)
    received = VehicleCommand(accelerator_pedal=0.8)
    made.command(ego(), VehicleCommand(), lost=True)
    made.command(ego(time=1.0), received, lost=False)
    assert made.command(ego(time=1.02), received, lost=False) == received


def test_a_stop_without_braking_leaves_only_the_steering_to_fade():
    made = fallback({"xbr_demand": -2.0, "steering_wheel_angle": 0.6}, return_time=0.0)
    made.command(ego(), VehicleCommand(), lost=True)
    made.command(ego(time=1.0), VehicleCommand(), lost=False)
    found = made.command(ego(time=1.5), VehicleCommand(), lost=False)
    assert (found.xbr_mode, found.xbr_demand) == (XbrMode.OFF, 0.0)
    assert found.steering_wheel_angle == pytest.approx(0.3)


@pytest.mark.parametrize(
    ("pedal", "demand", "mode", "expected"),
    [
        (0.2, -1.0, XbrMode.MAXIMUM, (0.3, -1.5, XbrEbiMode.FRICTION_ONLY)),
        (0.4, -1.0, XbrMode.MAXIMUM, (0.4, -1.5, XbrEbiMode.FRICTION_ONLY)),
        (0.2, -1.5, XbrMode.MAXIMUM, (0.3, -1.5, XbrEbiMode.FRICTION_ONLY)),
        (0.2, -2.0, XbrMode.MAXIMUM, (0.3, -2.0, XbrEbiMode.INTEGRATION)),
        (0.2, -2.0, XbrMode.OFF, (0.3, -1.5, XbrEbiMode.FRICTION_ONLY)),
    ],
)
def test_only_stronger_braking_counts_beside_the_stop(pedal, demand, mode, expected):
    made = fallback({"xbr_demand": -1.5, "xbr_mode": XbrMode.MAXIMUM, "brake_pedal": 0.3})
    received = VehicleCommand(
        brake_pedal=pedal,
        xbr_demand=demand,
        xbr_mode=mode,
        xbr_ebi_mode=XbrEbiMode.INTEGRATION,
        accelerator_pedal=0.9,
    )
    found = made.command(ego(), received, lost=True)
    assert (found.brake_pedal, found.xbr_demand, found.xbr_ebi_mode) == expected
    assert (found.xbr_mode, found.accelerator_pedal) == (XbrMode.MAXIMUM, 0.0)
    # A parked truck needs no braking of others.
    made.stop.phase = StopPhase.PARKED
    assert made.command(ego(), received, lost=True) is made.stop.given


def test_a_released_pedal_acknowledges_only_since_the_last_gap():
    made = fallback(acknowledge=True, return_time=0.0)
    made.stop.phase = StopPhase.STANDING
    pressed, free = VehicleCommand(accelerator_pedal=0.5), VehicleCommand()
    made.command(ego(), free, lost=True)
    made.command(ego(time=0.1), pressed, lost=False)
    assert made.source is CommandSource.STOP
    # A gap in the commands clears the acknowledgement.
    made._acknowledged = True
    made.command(ego(time=0.2), free, lost=True)
    made.command(ego(time=0.3), pressed, lost=False)
    assert made.source is CommandSource.STOP
    made.command(ego(time=0.4), free, lost=False)
    assert made.source is CommandSource.RETURNING
    # A moving truck needs none.
    moving = fallback(acknowledge=True, return_time=0.0)
    moving.command(ego(), free, lost=True)
    moving.command(ego(time=0.1), pressed, lost=False)
    assert moving.source is CommandSource.RETURNING


@pytest.mark.parametrize("name", ["return_time", "blend_time"])
def test_a_return_may_take_no_time(name):
    assert getattr(FallbackConfig(**{name: 0.0}), name) == 0.0


# --- lanes that move ------------------------------------------------------------------------


def test_a_reversing_truck_stops_in_the_lane_in_which_it_is(stop):
    # Its direction of motion says nothing about the lane ahead.
    width = LEFT - MIDDLE
    stop.command(ego(MIDDLE + 0.45 * width, speed=-2.0, lateral_speed=0.3 * width))
    assert stop.lane == 0


def test_the_stop_stays_in_its_lane_where_the_lane_to_the_right_ends():
    road = RightLaneEnds(end=150.0)
    stop = SafeStop(road, PARAMETERS)
    middle = float(road.lane_offset(1, 100.0))
    stop.command(ego(middle))
    assert (stop.lane, stop.trajectory.target_lane) == (1, 1)
    stop.command(dataclasses.replace(ego(middle, station=160.0), time=3.0))
    # The lane has become the only one.
    assert (stop.lane, stop.trajectory.target_lane) == (0, 0)
    assert stop.trajectory.offset == pytest.approx(middle)
