"""The retarder, and the response of engine brake and retarder to demands of the brakes."""

import mujoco
import numpy as np
import pytest

from tests.plugin.vehicle_sled import KMH, PARAMETERS, Sled

ENGINE, GEARBOX, RETARDER = PARAMETERS.engine, PARAMETERS.gearbox, PARAMETERS.retarder
RADIUS = PARAMETERS.tires["drive"].rolling_radius
HEAVY = 10_000_000.0  # a sled of 10000 t hardly changes its speed


def demanding(sled, seconds, torque, cut=0.0, names=()):
    """Returns signals `names` while the brakes demand `torque` [N m] at the shaft."""
    model = sled.model
    instance = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_PLUGIN, "air_brake")
    address = model.plugin_stateadr[instance]
    rows = []
    for _ in range(round(seconds / model.opt.timestep)):
        sled.data.plugin_state[address : address + 2] = torque, cut
        mujoco.mj_step(model, sled.data)
        rows.append([sled[name] for name in names])
    return np.array(rows)


def endurance(sled):
    """Returns the message to the brakes: retarding torque, greatest torque, engine speed."""
    instance = mujoco.mj_name2id(sled.model, mujoco.mjtObj.mjOBJ_PLUGIN, "powertrain")
    address = sled.model.plugin_stateadr[instance]
    return sled.data.plugin_state[address : address + 3].copy()


def at_shaft_speed(speed, **options):
    """Returns a heavy sled whose propeller shaft turns at this speed [rad/s]."""
    sensors = [(f"{name}_torque_percent", "powertrain") for name in ("retarder", "engine_brake")]
    vehicle = speed * RADIUS / GEARBOX.final_drive
    return Sled(HEAVY, speed=vehicle, rolling=False, sensors=sensors, **options)


def test_retarder_brakes_the_wheels_with_its_rated_torque():
    sled = at_shaft_speed(100.0).run(0.5, transmission_mode=1)
    assert sled["propeller_shaft_torque"] == pytest.approx(0, abs=1e-9)
    sled.run(3.0, retarder=1.0)
    assert sled["retarder_torque"] == pytest.approx(RETARDER.torque_max, rel=1e-3)
    lost = GEARBOX.driveline_efficiency  # losses behind the retarder add to its torque
    assert sled["propeller_shaft_torque"] == pytest.approx(-sled["retarder_torque"] / lost)
    assert sled["retarder_torque_percent"] == pytest.approx(-100, rel=1e-3)


def test_retarder_fades_with_the_square_of_a_low_shaft_speed():
    half = RETARDER.full_torque_speed / 2
    sled = at_shaft_speed(half).run(3.0, retarder=1.0)
    assert sled["retarder_torque"] == pytest.approx(RETARDER.torque_max / 4, rel=0.02)


def test_retarder_has_full_power_for_10_s_and_then_falls_to_its_continuous_power():
    sled = at_shaft_speed(200.0)
    rows = sled.record(120.0, "retarder_torque", "propeller_shaft_speed", retarder=1.0)
    power = rows.prod(axis=1)
    time = 0.002 * np.arange(1, len(power) + 1)
    full = (time > 2) & (time < 10)
    assert power[full].min() > 0.99 * RETARDER.power_max
    assert power[-1] == pytest.approx(RETARDER.power_continuous, rel=0.01)
    assert np.diff(power[time > 5]).max() < 0.01  # only falls
    worked = sled["retarder_work"]
    assert worked == pytest.approx(0.002 * power[:-1].sum(), rel=1e-3)


def test_retarder_cools_when_it_is_off():
    sled = at_shaft_speed(200.0).run(20.0, retarder=1.0)
    hot = sled["retarder_heat"]
    sled.run(PARAMETERS.retarder.heat_time, retarder=0.0)
    assert sled["retarder_heat"] == pytest.approx(hot / np.e, rel=0.05)


def test_retarder_fills_and_empties_with_its_lags():
    sled = at_shaft_speed(100.0)
    torque = sled.record(RETARDER.fill_time, "retarder_torque", retarder=1.0)[-1, 0]
    assert torque == pytest.approx((1 - np.exp(-1)) * RETARDER.torque_max, rel=0.02)
    sled.run(3.0)
    torque = sled.record(RETARDER.empty_time, "retarder_torque", retarder=0.0)[-1, 0]
    assert torque == pytest.approx(np.exp(-1) * RETARDER.torque_max, rel=0.02)


def test_accelerator_turns_engine_brake_and_retarder_off():
    sled = at_shaft_speed(110.0).run(3.0, retarder=1.0, engine_brake=1.0)
    assert sled["engine_brake_torque"] > 300
    sled.run(2.0, accelerator_pedal=0.3)
    assert sled["engine_brake_torque"] == pytest.approx(0, abs=1)
    assert sled["retarder_torque"] == pytest.approx(0, abs=5)
    assert sled["propeller_shaft_torque"] > 0


def test_retarder_does_not_brake_in_reverse():
    sled = Sled(HEAVY, speed=-3.0, rolling=False).run(2.0, retarder=1.0, transmission_mode=1)
    assert sled["retarder_torque"] == 0


def test_truck_without_retarder_has_no_retarder_torque():
    changes = {("powertrain", "retarder_torque_max"): "0"}
    sled = at_shaft_speed(100.0, changes=changes).run(2.0, retarder=1.0)
    assert sled["retarder_torque"] == sled["retarder_torque_percent"] == 0


def test_demand_of_the_brakes_is_met_by_drag_then_engine_brake_then_retarder():
    sled = at_shaft_speed(110.0)
    demanding(sled, 1.0, 0.0)
    drag, most, engine_speed = endurance(sled)
    assert drag > 100
    assert engine_speed == pytest.approx(sled["engine_speed"], rel=1e-3)
    # A demand below the drag switches no brake on.
    demanding(sled, 3.0, 0.5 * drag)
    assert sled["engine_brake_torque"] == sled["retarder_torque"] == 0
    assert endurance(sled)[0] == pytest.approx(drag, rel=1e-3)
    # The engine brake meets a small demand alone; the retarder stays empty.
    demanding(sled, 3.0, drag + 400)
    assert sled["engine_brake_torque"] > 200
    assert sled["retarder_torque"] < 5
    assert endurance(sled)[0] == pytest.approx(drag + 400, rel=0.01)
    # At a greater demand the engine brake is full and the retarder adds the rest.
    demanding(sled, 4.0, drag + 2500)
    assert sled["engine_brake_torque_percent"] == pytest.approx(
        sled["engine_brake_torque_percent_available"], rel=0.01
    )
    assert sled["retarder_torque"] > 500
    assert endurance(sled)[0] == pytest.approx(drag + 2500, rel=0.01)
    # An excessive demand yields the greatest torque of the message.
    demanding(sled, 4.0, 20_000.0)
    assert endurance(sled)[0] == pytest.approx(most, rel=0.01)


def test_reported_retarding_torque_equals_the_shaft_torque():
    sled = at_shaft_speed(110.0)
    demanding(sled, 4.0, 2000.0)
    assert endurance(sled)[0] == -sled["propeller_shaft_torque"] == pytest.approx(2000, rel=0.01)


def test_engine_offers_no_torque_with_an_open_clutch_or_in_neutral():
    assert endurance(Sled().run(1.0))[1] == 0
    sled = at_shaft_speed(110.0).run(1.0)
    with_engine = endurance(sled)[1]
    sled.run(2.0, transmission_mode=1)
    retarder = RETARDER.torque_max / GEARBOX.driveline_efficiency
    assert endurance(sled)[1] == pytest.approx(retarder, rel=1e-6)
    assert with_engine > retarder + 500


def test_retarder_replaces_the_engine_brake_when_the_gear_disengages():
    sled = at_shaft_speed(110.0)
    demanding(sled, 4.0, 2500.0)
    engine_share = 1 - sled["retarder_torque"] / GEARBOX.driveline_efficiency / 2500
    assert engine_share > 0.4
    sled.command(transmission_mode=1)
    braking = -demanding(sled, 2.0, 2500.0, names=("propeller_shaft_torque",))
    assert braking.min() > 0.65 * 2500
    assert braking.max() < 1.05 * 2500
    assert braking[500:] == pytest.approx(2500, rel=0.03)


def test_demand_is_held_through_the_downshifts_of_a_slow_stop():
    sled = Sled(55_000.0, speed=60 * KMH, rolling=False)
    names = ("propeller_shaft_torque", "gear")
    rows = demanding(sled, 35.0, 2500.0, names=names)[1000:]
    assert np.ptp(rows[:, 1]) > 0
    assert -rows[:, 0].max() > 0.85 * 2500
    assert -rows[:, 0].min() < 1.15 * 2500


def test_engine_brake_and_retarder_release_when_abs_acts_on_driven_wheels():
    sled = at_shaft_speed(110.0).run(3.0, retarder=1.0, engine_brake=1.0)
    held = sled["retarder_torque"]
    assert held > 3000
    demanding(sled, 4 * RETARDER.empty_time, -1.0)
    assert sled["retarder_torque"] < 0.03 * held
    assert sled["engine_brake_torque"] < 30
    demanding(sled, 3.0, 0.0)
    assert sled["retarder_torque"] == pytest.approx(held, rel=0.01)


def test_abs_of_a_driven_wheel_overrides_the_levers():
    sled = Sled(19_000.0, speed=80 * KMH, grip=0.25)
    sled.run(1.0, retarder=0.3, engine_brake=0.3)
    assert sled["retarder_torque"] > 500
    names = ("endurance_torque_demand", "retarder_torque", "speed")
    rows = sled.record(5.0, *names, xbr_demand=-6.0, xbr_mode=2)
    released = np.flatnonzero(rows[:, 0] < 0)
    assert released.size > 100
    began = released[0]
    assert rows[began, 2] > 50 * KMH
    longest = np.flatnonzero(np.diff(released) > 1)
    ended = released[longest[0]] if longest.size else released[-1]
    held = (ended - began) * 0.002
    expected = rows[began, 1] * np.exp(-held / RETARDER.empty_time)
    assert rows[ended, 1] == pytest.approx(expected, rel=0.05, abs=5.0)


def test_demand_of_the_brakes_has_no_effect_while_the_driver_accelerates():
    sled = at_shaft_speed(110.0)
    sled.command(accelerator_pedal=0.5)
    demanding(sled, 4.0, 3000.0)
    assert sled["retarder_torque"] == 0
    assert sled["propeller_shaft_torque"] > 500


def test_brakes_cut_the_accelerator_and_restore_it_smoothly():
    sled = at_shaft_speed(110.0)
    sled.command(accelerator_pedal=1.0)
    demanding(sled, 18.0, 0.0)  # two upshifts, after each of which the torque builds up
    full = sled["engine_torque"]
    assert full > 2000
    names = ("engine_torque", "accelerator_pedal_position")
    rows = demanding(sled, 1.0, 0.0, cut=1.0, names=names)
    drag = np.interp(sled["engine_speed"], ENGINE.drag_speed, ENGINE.drag_torque)
    gone = np.argmax(rows[:, 0] < 0) * 0.002
    assert gone <= ENGINE.torque_cut_time * (1 + full / ENGINE.reference_torque) / 2 + 0.1
    assert rows[-1, 0] == pytest.approx(-drag, rel=1e-3)
    assert np.all(rows[:, 1] == 1.0)  # the driver still presses it fully
    rows = demanding(sled, 13.0, 0.0, names=("engine_torque",))[:, 0]
    assert rows[-1] == pytest.approx(full, rel=0.02)
    slope = np.diff(rows) / 0.002
    assert slope.max() <= 1.001 * ENGINE.torque_rise_rate_low
    assert rows[round(0.5 / 0.002)] < 0.5 * full


@pytest.mark.parametrize("timestep", [0.001, 0.005])
def test_braking_on_a_descent_does_not_depend_on_the_time_step(timestep):
    ends = []
    for step in (0.002, timestep):
        sled = Sled(55_000.0, grade=-0.06, speed=70 * KMH, timestep=step)
        demanding(sled, 30.0, 2600.0)
        ends.append([sled["speed"], sled["retarder_work"], sled["retarder_heat"]])
    np.testing.assert_allclose(ends[0], ends[1], rtol=0.01)


def test_restored_retarder_state_is_bit_identical():
    kind = mujoco.mjtState.mjSTATE_FULLPHYSICS
    sled = Sled(55_000.0, grade=-0.05, speed=70 * KMH).run(5.0, retarder=0.7, engine_brake=0.4)
    state = np.zeros(mujoco.mj_stateSize(sled.model, kind))
    mujoco.mj_getState(sled.model, sled.data, state, kind)
    other = Sled(55_000.0, grade=-0.05)
    mujoco.mj_setState(other.model, other.data, state, kind)
    other.data.qacc_warmstart[:] = sled.data.qacc_warmstart
    other.run(0.0, retarder=0.7, engine_brake=0.4)
    names = ("speed", "retarder_torque", "retarder_heat", "engine_work", "driveline_loss")
    assert np.array_equal(sled.record(5.0, *names), other.record(5.0, *names))


@pytest.mark.parametrize(
    ("attribute", "value"),
    [
        ("retarder_torque_max", "-1"),
        ("retarder_power_continuous", "9e6"),
        ("retarder_heat_time", "nan"),
        ("pedal_return_time", "0"),
    ],
)
def test_bad_attribute_is_refused_by_name(attribute, value):
    with pytest.raises(ValueError, match=attribute):
        Sled(changes={("powertrain", attribute): value})
