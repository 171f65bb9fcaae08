"""The powertrain plugin on a sled: launch, gear changes, governors, fuel, reverse, robustness."""

from xml.etree import ElementTree

import mujoco
import numpy as np
import pytest

import iits_mj
from iits_mj.model.powertrain import full_load
from tests.plugin.vehicle_sled import KMH, PARAMETERS, RPM, Sled, sled_xml

FULL_PHYSICS = mujoco.mjtState.mjSTATE_FULLPHYSICS
ENGINE, GEARBOX = PARAMETERS.engine, PARAMETERS.gearbox
DRIVE, NEUTRAL, REVERSE = 0, 1, 2


@pytest.fixture(scope="module")
def launch():
    """40 % pedal for 40 s from standstill, 19 t, level road: the paper's acceleration test."""
    names = ("speed", "gear", "shift_in_process", "propeller_shaft_torque", "engine_speed")
    return Sled(19_000.0).record(40.0, *names, accelerator_pedal=0.4)


def spans(flags, timestep=0.002):
    """Returns the durations [s] of the runs of true values."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], flags.astype(int), [0]])))
    return (edges[1::2] - edges[::2]) * timestep


def test_empty_truck_at_40_percent_pedal_reaches_tenth_gear_and_45_km_h_in_40_s(launch):
    speed, gear = launch[:, 0], launch[:, 1]
    assert gear[0] == 2
    assert gear[-1] in (9, 10)
    assert 40 * KMH < speed[-1] < 50 * KMH


def test_gears_only_rise_during_a_steady_acceleration(launch):
    assert np.all(np.diff(launch[:, 1]) >= 0)


def test_gear_change_interrupts_torque_for_0_6_to_1_0_s(launch):
    changing = launch[:, 2] > 0
    changes = spans(changing)
    assert len(changes) == 8
    assert np.all((changes > 0.6) & (changes < 1.0))
    without_torque = 0.002 * np.count_nonzero(changing & (np.abs(launch[:, 3]) < 100.0))
    assert 0.4 < without_torque / len(changes) < 0.7


def test_engine_stays_in_its_speed_range_during_a_launch(launch):
    assert launch[:, 4].min() > 0.9 * ENGINE.idle_speed
    assert launch[:, 4].max() < ENGINE.governed_speed


def test_clutch_is_open_and_the_truck_at_rest_with_the_pedal_released():
    sled = Sled(55_000.0)
    rows = sled.record(5.0, "clutch_engagement", "propeller_shaft_torque", "position")
    assert np.all(rows == 0)


@pytest.mark.parametrize("mode", [DRIVE, NEUTRAL])
def test_engine_idles_at_600_rpm_with_its_idle_fuel_rate(mode):
    sled = Sled().run(3.0, transmission_mode=mode)
    assert sled["engine_speed"] == pytest.approx(600 * RPM, rel=0.005)
    assert sled["fuel_rate"] == pytest.approx(ENGINE.idle_fuel_rate, rel=0.02)
    assert sled["engine_torque"] == pytest.approx(0, abs=1)


def test_weak_clutch_is_closed_at_most_and_slips_at_its_torque():
    sled = Sled(60_000.0, changes={("powertrain", "clutch_torque_max"): "1200"})
    names = ("clutch_engagement", "propeller_shaft_torque", "gear")
    engagement, torque, gear = sled.record(3.6, *names, accelerator_pedal=1.0).T
    assert set(gear) == {GEARBOX.start_gear}
    assert engagement.max() == 1
    efficiency = GEARBOX.efficiency * GEARBOX.driveline_efficiency
    greatest = 1200 * GEARBOX.ratios[GEARBOX.start_gear - 1] * efficiency
    assert torque.max() == pytest.approx(greatest, rel=1e-6)


def test_engine_returns_to_idle_without_stalling_after_a_burst_in_neutral():
    sled = Sled().run(2.0, transmission_mode=NEUTRAL, accelerator_pedal=1.0)
    assert 0.95 * ENGINE.governed_speed < sled["engine_speed"] < 1.005 * ENGINE.governed_speed
    speeds = sled.record(6.0, "engine_speed", accelerator_pedal=0.0)[:, 0]
    assert speeds.min() > 0.85 * ENGINE.idle_speed
    assert speeds[-1] == pytest.approx(ENGINE.idle_speed, rel=0.01)
    assert sled["gear"] == 0


def test_torque_follows_the_pedal_map_and_fuel_the_consumption_map():
    # A sled of 10000 t hardly changes its speed: the engine is held at its operating point.
    sled = Sled(10_000_000.0, speed=60 * KMH).run(6.0, accelerator_pedal=0.5)
    speed, torque = sled["engine_speed"], sled["engine_torque"]
    table = ENGINE.pedal_map
    column = list(np.round(table.columns, 3)).index(0.5)
    assert torque == pytest.approx(np.interp(speed, table.rows, table.values[:, column]), rel=0.01)
    fuel = ENGINE.fuel_map
    by_torque = [np.interp(speed, fuel.columns, row) for row in fuel.values]
    consumption = np.interp(torque, fuel.rows, by_torque)
    assert sled["fuel_rate"] == pytest.approx(consumption * torque * speed, rel=0.005)
    lost = 1 - sled["propeller_shaft_torque"] / (torque * GEARBOX.ratios[int(sled["gear"]) - 1])
    assert lost == pytest.approx(1 - GEARBOX.efficiency * GEARBOX.driveline_efficiency, abs=0.005)


def test_fuel_used_is_the_integral_of_the_fuel_rate():
    sled = Sled()
    rates = sled.record(10.0, "fuel_rate", accelerator_pedal=0.6)[:, 0]
    # Sensors show the state before the step: the last rate is not in the sum yet.
    assert sled["fuel_used"] == pytest.approx(0.002 * rates[:-1].sum(), rel=1e-9)


def test_overrun_burns_no_fuel_and_brakes_by_the_drag_curve():
    sled = Sled(55_000.0, speed=80 * KMH).run(3.0)
    assert sled["fuel_rate"] == 0
    drag = np.interp(sled["engine_speed"], ENGINE.drag_speed, ENGINE.drag_torque)
    assert sled["engine_torque"] == pytest.approx(-drag, rel=0.001)
    assert sled["propeller_shaft_torque"] < -drag


def test_engine_brake_has_its_rated_power_at_its_rated_speed():
    sled = Sled(10_000_000.0, speed=80 * KMH).run(1.0)
    ratio = sled["engine_speed"] / (80 * KMH)
    speed = 0.98 * ENGINE.governed_speed / ratio
    sled = Sled(10_000_000.0, speed=speed).run(3.0, engine_brake=1.0)
    engine_speed = sled["engine_speed"]
    drag = np.interp(engine_speed, ENGINE.drag_speed, ENGINE.drag_torque)
    power = (-sled["engine_torque"] - drag) * engine_speed
    exponent = np.log(0.55) / np.log(1500 / 2300)
    expected = ENGINE.engine_brake_power * (engine_speed / ENGINE.engine_brake_speed) ** exponent
    assert power == pytest.approx(expected, rel=0.01)


def test_driveline_is_a_spring_and_damper_with_the_values_of_the_wheels():
    h = 0.001
    sled = Sled(10_000_000.0, speed=60 * KMH, timestep=h).run(4.0)
    names = ("engine_speed", "propeller_shaft_speed", "propeller_shaft_torque")
    rows = sled.record(2.0, *names, accelerator_pedal=0.6)
    ratio = GEARBOX.ratios[int(sled["gear"]) - 1]
    efficiency = GEARBOX.efficiency * GEARBOX.driveline_efficiency
    torque = np.where(rows[:, 2] > 0, rows[:, 2] / efficiency, rows[:, 2] * efficiency) / ratio
    rate = rows[:, 0] - ratio * rows[:, 1]
    terms = np.stack([h * np.cumsum(rate), rate, np.ones_like(rate)], axis=1)
    stiffness, damping, _ = np.linalg.lstsq(terms, torque)[0] * (ratio * GEARBOX.final_drive) ** 2
    assert stiffness == pytest.approx(GEARBOX.driveline_stiffness, rel=0.1)
    assert damping == pytest.approx(GEARBOX.driveline_damping, rel=0.1)


def test_rolling_truck_starts_in_gear_with_the_clutch_closed():
    sled = Sled(speed=80 * KMH)
    rows = sled.record(1.0, "engine_speed", "speed", "clutch_engagement", "gear")
    assert rows[0, 3] == 12
    assert np.all(rows[:, 2] == 1)
    assert np.ptp(rows[:, 0]) < 0.03 * rows[0, 0]


def test_laden_truck_starts_on_a_12_percent_grade_without_rolling_back():
    sled = Sled(55_000.0, grade=0.12)
    sled.run(3.0, parking_brake=1.0, xbr_demand=-1.0, xbr_mode=2).run(2.0, parking_brake=0.0)
    start = sled["position"]
    names = ("position", "engine_speed", "gear", "speed")
    rows = sled.record(20.0, *names, xbr_demand=0.0, accelerator_pedal=1.0)
    assert rows[:, 0].min() > start - 0.03
    assert rows[:, 1].min() > 0.9 * ENGINE.idle_speed
    assert rows[-1, 3] > 2.0
    assert spans(np.diff(rows[-5000:, 2]) != 0).size == 0


def test_laden_truck_on_a_climb_settles_in_one_gear():
    sled = Sled(55_000.0, grade=0.04, speed=70 * KMH)
    rows = sled.record(120.0, "gear", "speed", accelerator_pedal=1.0)
    assert np.count_nonzero(np.diff(rows[-25_000:, 0])) <= 1
    assert rows[-1, 1] > 24 * KMH


def test_braking_to_a_standstill_ends_in_the_start_gear_with_the_engine_idling():
    sled = Sled(55_000.0, speed=80 * KMH).run(2.0, accelerator_pedal=0.5)
    names = ("engine_speed", "speed")
    rows = sled.record(20.0, *names, accelerator_pedal=0.0, xbr_demand=-4.0, xbr_mode=2)
    assert rows[:, 0].min() > 0.85 * ENGINE.idle_speed
    assert sled["speed"] == pytest.approx(0, abs=1e-3)
    assert sled["gear"] == GEARBOX.start_gear
    assert sled["clutch_engagement"] == 0


def test_engaged_engine_at_rest_never_pushes_the_braked_truck():
    sled = Sled(19_000.0, speed=3.0).run(6.0, xbr_demand=-1.0, xbr_mode=2)
    rows = sled.record(5.0, "propeller_shaft_torque", "speed")
    assert np.all(np.abs(rows[:, 0]) < 1e-6)


def test_reverse_drives_backward_and_does_not_engage_at_speed():
    sled = Sled().run(8.0, transmission_mode=REVERSE, accelerator_pedal=0.3)
    assert sled["gear"] == -1
    assert sled["speed"] < -1.0
    sled = Sled(speed=10.0)
    gears = sled.record(2.0, "gear", transmission_mode=REVERSE)[:, 0]
    assert -1 not in gears
    assert gears[-1] == 0


def test_drive_is_engaged_again_after_neutral_at_speed():
    sled = Sled(speed=60 * KMH).run(2.0, transmission_mode=NEUTRAL)
    assert sled["propeller_shaft_torque"] == 0
    sled.run(3.0, transmission_mode=DRIVE, accelerator_pedal=0.4)
    assert sled["gear"] >= 10
    assert sled["clutch_engagement"] == 1
    assert sled["propeller_shaft_torque"] > 500


def test_acceleration_does_not_depend_on_the_time_step():
    rows = []
    for timestep in (0.001, 0.002, 0.005):
        sled = Sled(19_000.0, timestep=timestep).run(30.0, accelerator_pedal=0.5)
        rows.append([sled["speed"], sled["fuel_used"], sled["engine_speed"]])
    np.testing.assert_allclose(rows[0], rows[1], rtol=5e-3)
    np.testing.assert_allclose(rows[0], rows[2], rtol=1e-2)


def drive_at_random(sled, first, last):
    for k in range(first, last):
        pedal, brake, other = np.random.default_rng(k).random(3)
        braking = brake > 0.6
        sled.run(
            0.5,
            accelerator_pedal=0.0 if braking else pedal,
            xbr_demand=-4.0 * brake if braking else 0.0,
            xbr_mode=2,
            engine_brake=float(other > 0.8),
            transmission_mode=float(NEUTRAL if other < 0.05 else DRIVE),
        )
    state = np.zeros(mujoco.mj_stateSize(sled.model, FULL_PHYSICS))
    mujoco.mj_getState(sled.model, sled.data, state, FULL_PHYSICS)
    return state


def test_random_drive_repeats_bit_for_bit_and_from_a_restored_state():
    whole = drive_at_random(Sled(30_000.0, speed=10.0), 0, 40)
    sled = Sled(30_000.0, speed=10.0)
    middle = drive_at_random(sled, 0, 20)
    other = Sled(30_000.0).run(1.3, accelerator_pedal=1.0)
    mujoco.mj_setState(other.model, other.data, middle, FULL_PHYSICS)
    other.data.qacc_warmstart[:] = sled.data.qacc_warmstart
    assert np.array_equal(drive_at_random(sled, 20, 40), whole)
    assert np.array_equal(drive_at_random(other, 20, 40), whole)
    assert np.isfinite(whole).all()


def test_forward_evaluations_between_steps_change_nothing():
    plain, disturbed = Sled(rolling=False), Sled(rolling=False)
    for _ in range(500):
        plain.run(0.01, accelerator_pedal=0.7)
        disturbed.run(0.01, accelerator_pedal=0.7)
        mujoco.mj_forward(disturbed.model, disturbed.data)
        mujoco.mj_forward(disturbed.model, disturbed.data)
    assert plain["speed"] == disturbed["speed"] > 1.0
    # The forward evaluations updated the sensors of the disturbed run.
    mujoco.mj_forward(plain.model, plain.data)
    assert plain["fuel_used"] == disturbed["fuel_used"] > 0.0


def test_full_load_curve_reaches_from_idle_to_governed_speed():
    speed, torque = full_load(PARAMETERS)
    assert speed[0] == pytest.approx(ENGINE.idle_speed)
    assert speed[-1] == pytest.approx(ENGINE.governed_speed)
    assert np.all(np.diff(speed) > 0)
    assert speed[-1] * torque[-1] == pytest.approx(412e3, rel=0.01)


@pytest.mark.parametrize(
    ("attribute", "value"),
    [
        ("idle_speed", "-3"),
        ("ratios", "1 2 3"),
        ("start_gear", "13"),
        ("governed_speed", "nan"),
        ("pedal_map_torque", "1 2 3"),
        ("full_load_speed", "100 90 200"),
        ("clutch_torque_max", ""),
    ],
)
def test_bad_attribute_is_refused_by_name(attribute, value):
    with pytest.raises(ValueError, match=attribute):
        mujoco.MjModel.from_xml_string(
            sled_xml(19_000.0, changes={("powertrain", attribute): value})
        )


def test_unknown_sensor_is_refused_with_the_known_names():
    with pytest.raises(ValueError, match=r"turbo_speed.*engine_speed"):
        Sled(sensors=[("turbo_speed", "powertrain")])


def sorted_sled(group, first):
    """A sled that brakes, with one of its sensors or actuators before all others."""
    root = ElementTree.fromstring(sled_xml(19_000.0))
    root.find(group)[:] = sorted(root.find(group), key=lambda child: child.get("name") != first)
    sled = Sled()
    sled.model = mujoco.MjModel.from_xml_string(ElementTree.tostring(root, encoding="unicode"))
    sled.data = mujoco.MjData(sled.model)
    sled.data.qvel[:] = Sled(speed=60 * KMH).data.qvel
    return sled.run(0.6, brake_pedal=0.4, engine_brake=0.5, retarder=0.3, xbr_demand=-1.0)


@pytest.mark.parametrize("group", ["sensor", "actuator"])
def test_order_of_sensors_and_actuators_does_not_matter(group):
    plain = sorted_sled(group, "")
    for child in ElementTree.fromstring(sled_xml(19_000.0)).find(group):
        first = child.get("name")
        sled = sorted_sled(group, first)
        assert getattr(sled.model, group)(first).id == 0
        for i in range(plain.model.nsensor):
            name = plain.model.sensor(i).name
            assert sled.wheels(name).tolist() == plain.wheels(name).tolist(), (first, name)


@pytest.mark.parametrize("timestep", [0.001, 0.005])
def test_engine_neither_stalls_nor_overspeeds_under_any_commands(timestep):
    random = np.random.default_rng(3)
    sled = Sled(19_000.0, speed=10.0, timestep=timestep)
    for _ in range(100):
        braking, driving = random.random(2) < (0.4, 0.7)
        commands = {
            "accelerator_pedal": 1.5 * random.random() - 0.2,
            "xbr_demand": -12.0 * random.random() if braking else 0.0,
            "xbr_mode": 2.0,
            "parking_brake": float(random.random() < 0.1),
            "engine_brake": float(random.random() < 0.3),
            "transmission_mode": DRIVE if driving else 2.4 * random.random(),
        }
        speeds = sled.record(0.5, "engine_speed", **commands)
        assert speeds.min() > 0.7 * ENGINE.idle_speed
        assert speeds.max() < 1.1 * ENGINE.governed_speed
    assert sled.data.warning.number.sum() == 0


def test_complete_truck_accelerates_as_the_sled_does(launch):
    truck = iits_mj.Truck.load(payload=19_000.0 - PARAMETERS.gross_mass(0.0), visuals=False)
    truck.reset()
    truck.command(accelerator_pedal=0.4)
    truck.step(round(40.0 / truck.model.opt.timestep))
    state = truck.observe()
    assert state.gear in (9, 10)
    assert 40 * KMH < state.speed < 50 * KMH
    assert state.speed == pytest.approx(launch[-1, 0], rel=0.05)
