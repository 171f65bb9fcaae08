"""The air-brake plugin on a sled: demand, pneumatics, holding, ABS, parking brake, robustness."""

import mujoco
import numpy as np
import pytest

import iits_mj
from iits_mj.core.units import GRAVITY
from tests.plugin.vehicle_sled import KMH, PARAMETERS, Sled, axle_brakes, sled_xml

FULL_PHYSICS = mujoco.mjtState.mjSTATE_FULLPHYSICS
BRAKE = PARAMETERS.air_brake
TRAILER = "brake_pressure_trailer"
XBR = {"xbr_mode": 2.0}


@pytest.mark.parametrize("mass", [18_000.0, 19_000.0, 50_000.0, 55_000.0])
@pytest.mark.parametrize("demand", [0.7, 1.5, 3.0])
def test_mean_deceleration_meets_the_demand_within_5_percent(mass, demand):
    sled = Sled(mass, speed=60 * KMH).run(1.0)
    sled.run(2.5, xbr_demand=-demand, **XBR)
    before = sled["speed"]
    seconds = 0.8 * before / demand
    sled.run(seconds)
    assert (before - sled["speed"]) / seconds == pytest.approx(demand, rel=0.05)


def test_demand_of_1_5_at_50_t_needs_about_150_kpa():
    sled = Sled(50_000.0, speed=60 * KMH).run(5.0, xbr_demand=-1.5, **XBR)
    circuits = ("front_left", "rear_left", "trailer")
    pressure = np.array([sled[f"brake_pressure_{name}"] for name in circuits])
    assert 120e3 < pressure @ [1, 2, 3] / 6 < 165e3
    assert np.all((pressure > 105e3) & (pressure < 165e3))


def test_build_up_has_its_dead_time_then_its_time_constant():
    sled = Sled(50_000.0, speed=60 * KMH, timestep=0.001).run(0.5)
    names = ("brake_pressure_front_left", "brake_pressure_rear_left", TRAILER)
    rows = sled.record(3.0, *names, xbr_demand=-1.0, **XBR)
    dead_time = axle_brakes("dead_time")[[0, 1, 3]] + [0.0, 0.0, BRAKE.trailer_line_delay]
    # Pressure rises two steps after its cause: first the supply responds, then the chamber.
    first = np.argmax(rows > 0, axis=0) * 1e-3
    np.testing.assert_allclose(first, dead_time, atol=0.004)
    level = rows[400:600].mean(axis=0)
    to_63_percent = np.argmax(rows > 0.632 * level, axis=0) * 1e-3
    build_up = axle_brakes("build_up_time_constant")[[0, 1, 3]]
    np.testing.assert_allclose(to_63_percent, dead_time + build_up, atol=0.07)


def test_lines_without_dead_time_fill_the_chambers_from_the_first_step_on():
    none = {("air_brake", "dead_time"): "0 0 0 0 0 0", ("air_brake", "trailer_line_delay"): "0"}
    sled = Sled(50_000.0, speed=60 * KMH, changes=none).run(0.5)
    sled.run(0.002, brake_pedal=1.0)
    mujoco.mj_forward(sled.model, sled.data)
    first = sled.wheels("brake_pressures")
    filled = -np.expm1(-0.002 / np.repeat(axle_brakes("build_up_time_constant"), 2))
    assert first == pytest.approx(filled * BRAKE.supply_rise_rate * 0.002, rel=1e-3)


@pytest.mark.parametrize("demand", [-1.5, -10.0])
def test_every_axle_reaches_75_percent_of_its_pressure_within_0_6_s(demand):
    """UN R13 annex 6: the limit holds at the least favourable brake chamber."""
    sled = Sled(50_000.0, speed=90 * KMH).run(0.5)
    sled.command(xbr_demand=demand, **XBR)
    rows = np.array([sled.run(0.002).wheels("brake_pressures") for _ in range(1000)])
    reached = np.argmax(rows >= 0.75 * rows[-1], axis=0) * 0.002
    assert reached.max() <= 0.6
    assert reached.min() > 0.2


def test_brakes_of_a_tractor_release_within_0_55_s():
    """FMVSS 121 S5.3.4: from 655 to 34 kPa."""
    sled = Sled(50_000.0, speed=90 * KMH).run(2.0, brake_pedal=1.0)
    names = ("brake_pressure_front_left", "brake_pressure_rear_left")
    rows = sled.record(2.0, *names, brake_pedal=0.0)
    for column in rows.T:
        high, low = np.argmax(column < 655e3), np.argmax(column < 34e3)
        assert column[0] > 655e3
        assert 0.1 < (low - high) * 0.002 < 0.55


@pytest.mark.parametrize("controls", [{"xbr_demand": -3.0, "xbr_mode": 0.0}, {"xbr_mode": 2.0}])
def test_brakes_have_no_pressure_without_a_mode_or_a_demand(controls):
    sled = Sled(speed=60 * KMH)
    rows = sled.record(2.0, TRAILER, "xbr_active", **controls)
    assert np.all(rows == 0)


def test_nan_controls_do_not_brake():
    sled = Sled(speed=60 * KMH)
    sled.command(
        xbr_demand=np.nan,
        xbr_mode=np.nan,
        parking_brake=np.nan,
        brake_pedal=np.nan,
        xbr_ebi_mode=np.nan,
    )
    mujoco.mj_forward(sled.model, sled.data)
    assert np.isfinite(sled.data.qacc).all()
    assert sled["xbr_active"] == 0


@pytest.mark.parametrize("grade", [0.08, -0.08])
def test_laden_truck_is_held_on_an_8_percent_grade_without_creep(grade):
    sled = Sled(55_000.0, grade=grade, rolling=False)
    sled.run(2.0, parking_brake=1.0, xbr_demand=-0.3, **XBR).run(5.0, parking_brake=0.0)
    start = sled["position"]
    rows = sled.record(20.0, "position", "speed")
    assert np.abs(rows[:, 0] - start).max() < 1e-4
    assert abs(rows[-1, 0] - rows[-2500, 0]) < 1e-7


def test_parking_brake_holds_on_a_12_percent_grade_and_releases():
    sled = Sled(55_000.0, grade=-0.12, rolling=False)
    rows = sled.record(20.0, "position", parking_brake=1.0)
    assert abs(rows[-1, 0] - rows[2500, 0]) < 1e-5
    sled.run(3.0, parking_brake=0.0)
    assert sled["speed"] > 1.0


def test_hill_hold_acts_for_some_seconds_and_on_an_upgrade_only():
    held, free = (
        Sled(55_000.0, grade=grade, speed=3.0).run(8.0, xbr_demand=-1.0, **XBR)
        for grade in (0.06, -0.06)
    )
    for sled in (held, free):
        sled.run(3.0, xbr_demand=0.0)
    assert abs(held["speed"]) < 1e-3
    assert free["speed"] > 0.5
    held.run(5.0)
    assert held["speed"] < -0.3


def test_holding_at_standstill_does_not_wind_up_the_integral():
    sled = Sled(19_000.0, speed=3.0).run(20.0, xbr_demand=-0.5, **XBR)
    before = sled[TRAILER]
    sled.run(60.0)
    assert sled[TRAILER] == pytest.approx(before, rel=0.001)
    sled.run(2.0, xbr_demand=0.0)
    assert sled[TRAILER] < 0.02 * before


def test_pressure_falls_gradually_after_the_dead_time():
    sled = Sled(55_000.0, speed=20.0).run(4.0, xbr_demand=-2.0, **XBR)
    rows = sled.record(3.0, TRAILER, xbr_demand=0.0)[:, 0]
    dead = round((PARAMETERS.axles[3].brake.dead_time + BRAKE.trailer_line_delay) / 0.002) + 5
    assert rows[dead] > 0.9 * rows[0]
    assert np.all(np.diff(rows[dead:]) <= 0)
    assert rows[-1] < 0.01 * rows[0]


def test_abs_keeps_the_wheels_turning_on_a_slippery_road():
    sled = Sled(19_000.0, speed=70 * KMH, grip=0.2)
    dof = sled.model.joint("tractor_axle2_left_spin").dofadr[0]
    radius = PARAMETERS.tires["drive"].rolling_radius
    sled.command(xbr_demand=-6.0, **XBR)
    slips, active = [], []
    while sled["speed"] > 1.5 * BRAKE.abs_speed_min:
        sled.run(0.002)
        slips.append(1 - sled.data.qvel[dof] * radius / sled["speed"])
        active.append(sled["abs_active"])
    assert sum(active) > 0
    assert np.mean(np.array(slips) > 0.9) < 0.05
    # The sled's friction is the same at any slip: ABS cycles may lose a third of it.
    deceleration = 70 * KMH / (0.002 * len(slips))
    assert deceleration > 0.65 * 0.2 * GRAVITY


def test_truck_stops_from_80_km_h_in_a_full_brake_application():
    sled = Sled(55_000.0, speed=80 * KMH)
    start = sled["position"]
    sled.run(8.0, xbr_demand=-7.0, **XBR)
    assert sled["speed"] == pytest.approx(0, abs=1e-3)
    assert sled["position"] - start < 70.0


def test_braking_does_not_depend_on_the_time_step():
    results = []
    for timestep in (0.001, 0.002, 0.005):
        sled = Sled(50_000.0, speed=60 * KMH, timestep=timestep)
        sled.run(5.0, xbr_demand=-1.5, **XBR)
        results.append([sled["speed"], sled[TRAILER], sled["position"]])
    np.testing.assert_allclose(results[1], results[0], rtol=2e-3)
    np.testing.assert_allclose(results[2], results[0], rtol=5e-3)


def test_dead_time_does_not_depend_on_changes_of_time_step_and_clock():
    results = []
    for disturb in (False, True):
        sled = Sled(50_000.0, speed=60 * KMH).run(0.1, xbr_demand=-1.5, **XBR)
        if disturb:
            sled.model.opt.timestep = 0.001
            sled.data.time = 0.0
        sled.run(1.0)
        results.append(sled[TRAILER])
    assert results[1] == pytest.approx(results[0], rel=0.01)


def test_braking_is_bit_identical_from_a_restored_state():
    def stop(sled):
        for demand in (-3.0, -0.5, -6.0, 0.0):
            sled.run(1.0, xbr_demand=demand, **XBR)
        state = np.zeros(mujoco.mj_stateSize(sled.model, FULL_PHYSICS))
        mujoco.mj_getState(sled.model, sled.data, state, FULL_PHYSICS)
        return state

    sled = Sled(speed=20.0, grip=0.3).run(0.55, xbr_demand=-4.0, **XBR)
    state = np.zeros(mujoco.mj_stateSize(sled.model, FULL_PHYSICS))
    mujoco.mj_getState(sled.model, sled.data, state, FULL_PHYSICS)
    warmstart = sled.data.qacc_warmstart.copy()
    other = Sled(speed=3.0, grip=0.3).run(1.0, xbr_demand=-1.0, **XBR)
    mujoco.mj_setState(other.model, other.data, state, FULL_PHYSICS)
    other.data.qacc_warmstart[:] = warmstart
    assert np.array_equal(stop(sled), stop(other))


@pytest.mark.parametrize(
    ("attribute", "value"),
    [
        ("dead_time", "0.05"),
        ("circuit", "0 1 1 2 2 3"),
        ("abs_release_slip", "2"),
        ("demand", "1 0.5 2"),
        ("share_light", "1"),
        ("mass_heavy", "1000"),
        ("governor_cut_in", "1.1e6"),
        ("abs_reapply_slip", "0.3"),
        ("stiffness", "inf"),
        ("supply_rise_rate", ""),
    ],
)
def test_bad_attribute_is_refused_by_name(attribute, value):
    with pytest.raises(ValueError, match=attribute):
        mujoco.MjModel.from_xml_string(
            sled_xml(19_000.0, changes={("air_brake", attribute): value})
        )


def test_unknown_sensor_is_refused_with_the_known_names():
    with pytest.raises(ValueError, match=r"brake_pressure_spare.*brake_pressure_trailer"):
        Sled(sensors=[("brake_pressure_spare", "air_brake")])


def tilt(truck, grade):
    angle = np.arctan(grade)
    truck.model.opt.gravity[:] = -GRAVITY * np.sin(angle), 0.0, -GRAVITY * np.cos(angle)


@pytest.mark.parametrize("mass", [19_000.0, 50_000.0, 55_000.0])
def test_complete_truck_decelerates_at_the_xbr_demand_within_5_percent(mass):
    truck = iits_mj.Truck.load(payload=mass - PARAMETERS.gross_mass(0.0), visuals=False)
    truck.reset(speed=60 * KMH)
    truck.step(500)
    truck.command(xbr_demand=-1.5, xbr_mode=2)
    truck.step(1000)
    before = truck.observe().speed
    truck.step(3500)
    assert (before - truck.observe().speed) / 7.0 == pytest.approx(1.5, rel=0.05)


def test_complete_truck_stops_holds_and_restarts_on_a_5_percent_grade():
    truck = iits_mj.Truck.load(payload=36_000.0, visuals=False)
    tilt(truck, 0.05)
    truck.reset(speed=30 * KMH)
    truck.command(xbr_demand=-1.5, xbr_mode=2)
    truck.step(6000)
    stopped = truck.observe().x
    truck.step(5000)
    assert abs(truck.observe().x - stopped) < 1e-3
    truck.command(accelerator_pedal=0.7, xbr_demand=0.0, xbr_mode=0)
    lowest = stopped
    for _ in range(50):
        truck.step(100)
        lowest = min(lowest, truck.observe().x)
    assert lowest > stopped - 0.03
    assert truck.observe().speed > 2.0
