"""Measures of recorded drives, on histories with known results."""

import numpy as np
import pytest

from iits_mj.parameters import TruckParameters
from iits_mj.validation.harness.maneuver import Run
from iits_mj.validation.harness.recorder import PERIOD
from iits_mj.validation.longitudinal import braking, speed_accuracy
from iits_mj.validation.longitudinal.acceleration import coast_along, engaged_gear, hunting, shifts
from iits_mj.validation.longitudinal.force_balance import ForceBalance

LAG = 0.25


def drive(duration=10.0, **columns):
    """A run of this length [s] at 20 m/s; other columns are zero unless given."""
    time = np.arange(round(duration / PERIOD) + 1) * PERIOD
    empty = {
        name: np.zeros_like(time)
        for name in Run.__dataclass_fields__
        if name not in ("wheel_slips", "wheel_pressures", "extra")
    }
    wide = {
        "wheel_slips": np.zeros((len(time), 12)),
        "wheel_pressures": np.zeros((len(time), 12)),
    }
    start = {"time": time, "speed": np.full_like(time, 20.0)}
    given = {name: value(time) if callable(value) else value for name, value in columns.items()}
    return Run(**{**empty, **wide, **start, **given})


def first_order(time, start=1.0):
    return np.where(time < start, 0.0, 400e3 * (1.0 - np.exp(-np.maximum(time - start, 0.0) / LAG)))


def test_rise_of_a_first_order_lag_takes_1_4_time_constants_to_75_percent():
    run = drive()
    pressure = first_order(run.time)
    found = braking.rise_time(run.time - 1.0, pressure, 0.75, 400e3)
    assert found == pytest.approx(LAG * np.log(4.0), abs=0.011)
    assert braking.first_rise(run.time - 1.0, pressure) == pytest.approx(0.01, abs=0.011)
    assert np.isnan(braking.rise_time(run.time - 1.0, 0.5 * pressure, 0.75, 400e3))


def test_lock_time_counts_one_and_the_same_wheel_above_the_speed():
    slips = np.zeros((1001, 12))
    slips[100:150, 0], slips[150:220, 1] = -0.95, 0.9
    assert braking.lock_time(drive(wheel_slips=slips)) == pytest.approx(0.70)
    slow = drive(wheel_slips=slips, speed=np.full(1001, 3.0))
    assert braking.lock_time(slow) == 0.0


def test_fully_developed_deceleration_of_a_uniform_stop_is_its_deceleration():
    run = drive(4.0, speed=lambda t: 20.0 - 5.0 * t, station=lambda t: 20.0 * t - 2.5 * t**2)
    assert braking.fully_developed(run) == pytest.approx(5.0, rel=1e-6)
    assert braking.distance(run) == pytest.approx(40.0)
    rolling = drive(station=lambda t: 20.0 * t)
    assert np.isnan(braking.fully_developed(rolling))


def test_jerk_of_a_deceleration_that_ends_at_once_is_its_step_over_the_window():
    run = drive(speed=lambda t: np.where(t < 5.0, 20.0 - 1.5 * t, 12.5))
    assert braking.mean_jerk(run, 0.5).max() == pytest.approx(3.0, rel=0.01)
    gentle = drive(speed=lambda t: 20.0 - 1.5 * t + 0.1 * t**2)
    assert braking.mean_jerk(gentle, 0.5)[50:-50] == pytest.approx(0.2, rel=0.01)


def test_a_shift_is_as_long_as_the_driveline_is_open_and_the_dip_as_the_pull_is_gone():
    def shift(t):
        return ((t >= 3.0) & (t < 3.7)).astype(float)

    def pull(t):
        return np.where((t >= 3.05) & (t < 3.75), -0.1, 0.5)

    run = drive(
        shift_in_process=shift,
        gear=lambda t: np.where(t < 3.0, 5.0, 6.0),
        acceleration=pull,
        engine_torque=lambda t: np.where((t >= 3.1) & (t < 3.75), 0.0, 1500.0),
    )
    (change,) = shifts(run)
    assert change.gear == 6
    assert change.duration == pytest.approx(0.7, abs=0.011)
    assert change.idle == pytest.approx(0.65, abs=0.011)
    assert change.dip == pytest.approx(0.7, abs=0.03)


def test_only_a_gear_taken_back_soon_is_hunting():
    def gears(t):
        return np.select([t < 2.0, t < 4.0, t < 9.5], [8.0, 9.0, 8.0], 9.0)

    assert hunting(drive(gear=gears)) == 1
    assert hunting(drive(gear=lambda t: 5.0 + np.floor(t / 2.0))) == 0


def test_old_gear_stays_engaged_until_the_clutch_is_open():
    gear = np.array([5.0, 6.0, 6.0, 6.0, 6.0])
    engagement = np.array([1.0, 0.5, 0.0, 0.5, 1.0])
    assert engaged_gear(gear, engagement).tolist() == [5, 5, 6, 6, 6]


def test_point_mass_without_engine_coasts_down_by_its_resistances():
    parameters = TruckParameters.load()
    balance = ForceBalance(parameters, 36_000.0)
    run = drive(extra={"clutch_engagement": np.zeros(1001)})
    speed = coast_along(run, balance)
    mass = balance.mass + balance.wheel_mass
    rates = np.gradient(speed, run.time)[1:-1]
    np.testing.assert_allclose(rates, -balance.resistance(speed[1:-1]) / mass, rtol=1e-3)


def test_obeyed_demand_is_late_by_dead_time_and_lag():
    parameters = TruckParameters.load()
    run = drive(7.0)
    speed = speed_accuracy.braked_speed(run, parameters)
    dead = max(braking.dead_times(parameters))
    late = dead + max(axle.brake.build_up_time_constant for axle in parameters.axles)
    assert speed[-1] == pytest.approx(20.0 - 1.5 * (7.0 - late), abs=0.01)
    assert np.all(speed[run.time <= dead] == 20.0)


def test_part_of_a_run_keeps_every_column():
    part = drive(extra={"a": np.arange(1001.0)}).between(2.0, 3.0)
    assert part.time[0] == pytest.approx(2.0)
    assert len(part.time) == len(part.wheel_slips) == len(part.extra["a"]) == 100
