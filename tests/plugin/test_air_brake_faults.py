"""The truck has none of five brake faults of the public release."""

import numpy as np
import pytest

from iits_mj.core.units import GRAVITY
from iits_mj.model.air_brake import torque_slope
from tests.plugin.vehicle_sled import KMH, PARAMETERS, Sled

BRAKE = PARAMETERS.air_brake
XBR = {"xbr_mode": 2.0}
RADIUS = np.array([PARAMETERS.tires[axle.tire].rolling_radius for axle in PARAMETERS.axles])


def test_brake_torque_follows_the_pressure_in_pascal():
    """The public release compares MPa with kPa."""
    sled = Sled(50_000.0, speed=70 * KMH).run(2.5, xbr_demand=-2.0, **XBR)
    pressure = sled.wheels("brake_pressures")
    torque = sled.wheels("brake_torques")
    assert 100e3 < pressure.mean() < 300e3
    expected = np.repeat(torque_slope(PARAMETERS), 2) * (pressure - BRAKE.push_out_pressure)
    # Hysteresis allows a torque between that of build-up and that of release.
    slack = np.repeat(torque_slope(PARAMETERS), 2) * BRAKE.hysteresis_pressure
    assert np.all(torque > 0.99 * expected)
    assert np.all(torque < 1.01 * (expected + slack))


@pytest.mark.parametrize("demand", [-1.0, -4.0])
def test_pressure_builds_up_equally_fast_at_any_time_step(demand):
    """The public release adds 0.01 s per step of 1 to 2 ms: 5 to 10 times too fast."""
    rises = []
    for timestep in (0.0005, 0.001, 0.002, 0.005):
        sled = Sled(50_000.0, speed=90 * KMH, timestep=timestep).run(0.5)
        pressure = sled.record(1.5, "brake_pressure_trailer", xbr_demand=demand, **XBR)[:, 0]
        level = pressure[round(0.8 / timestep)]
        rises.append(np.argmax(pressure > 0.632 * level) * timestep)
    assert np.ptp(rises) < 0.008
    own = PARAMETERS.axles[3].brake
    ideal = own.dead_time + BRAKE.trailer_line_delay + own.build_up_time_constant
    assert ideal - 0.02 < rises[0] < ideal + 0.1


def test_brake_force_acts_once():
    """The public release applies it twice; here wheel torque equals inertia times deceleration."""
    mass = 40_000.0
    sled = Sled(mass, speed=60 * KMH, rolling=False)
    sled.run(3.0, brake_pedal=0.2)
    rows, torques = [], []
    for _ in range(250):
        sled.run(0.002)
        rows.append([sled["speed"], sled["propeller_shaft_torque"]])
        torques.append(sled.wheels("brake_torques"))
    rows = np.array(rows)
    deceleration = (rows[0, 0] - rows[-1, 0]) / (0.002 * (len(rows) - 1))
    spin = sum(
        2 * axle.wheel_inertia_spin / radius**2
        for axle, radius in zip(PARAMETERS.axles, RADIUS, strict=True)
    )
    force = float(np.mean(np.array(torques) @ np.repeat(1 / RADIUS, 2)))
    force -= float(rows[:, 1].mean()) * PARAMETERS.gearbox.final_drive / RADIUS[1]
    assert force == pytest.approx((mass + spin) * deceleration, rel=0.003)


@pytest.mark.parametrize("grade", [0.0, 0.05, -0.05])
def test_integral_does_not_wind_up_at_standstill(grade):
    """After a minute at rest the brake releases as quickly as after a second."""
    times = []
    for seconds in (1.0, 60.0):
        sled = Sled(30_000.0, speed=2.5, grade=grade).run(4.0, xbr_demand=-1.0, **XBR)
        sled.run(seconds)
        held = sled["brake_pressure_trailer"]
        rows = sled.record(12.0, "brake_pressure_trailer", xbr_demand=0.0)[:, 0]
        times.append(np.argmax(rows < 0.1 * held) * 0.002)
        assert rows[-1] == 0
    assert times[0] > 0
    assert times[1] == pytest.approx(times[0], abs=0.01)


def test_integral_does_not_wind_up_at_the_friction_limit():
    """Five seconds of a demand beyond the friction do not change the response to a small one."""
    after = []
    for demand in (-8.0, -2.0):  # the road allows 2.45 m/s2
        sled = Sled(19_000.0, speed=25.0, grip=0.25).run(5.0, xbr_demand=demand, **XBR)
        sled.run(3.5, xbr_demand=-1.0)
        before = sled["speed"]
        after.append(before - sled.run(1.0)["speed"])
    assert after[0] == pytest.approx(after[1], abs=0.1)


def test_xbr_releases_gradually():
    """The public release drops the demand at once; here it falls within the jerk limit."""
    sled = Sled(40_000.0, speed=22.0, rolling=False).run(4.0, xbr_demand=-2.0, **XBR)
    speed = sled.record(1.5, "speed", xbr_demand=0.0)[:, 0]
    deceleration = -np.gradient(speed, 0.002)
    smooth = np.convolve(deceleration, np.ones(25) / 25, mode="valid")
    jerk = -np.diff(smooth) / 0.002
    assert jerk.max() < 1.3 * BRAKE.release_rate
    assert smooth[0] == pytest.approx(2.0, rel=0.03)
    # More than half is left after half the ramp, and almost nothing a second later.
    half = round(0.5 * 2.0 / BRAKE.release_rate / 0.002)
    assert smooth[half] > 0.5 * smooth[0]
    assert smooth[-1] < 0.05 * GRAVITY * 0.5


@pytest.mark.parametrize("end", [{"xbr_mode": 0.0}, {"xbr_demand": 0.0}], ids=["mode", "demand"])
def test_pressure_falls_gradually_when_mode_or_demand_ends(end):
    sled = Sled(40_000.0, speed=22.0).run(4.0, xbr_demand=-2.0, **XBR)
    rows = sled.record(0.5, "brake_pressure_rear_left", **end)[:, 0]
    assert rows[50] > 0.7 * rows[0]
    assert rows[-1] < 0.6 * rows[0]
