"""Compressed air: consumption, compressor, and spring brakes at low pressure."""

import mujoco
import numpy as np
import pytest

from iits_mj.truck.faults import CIRCUITS, WHEELS_MAX
from tests.plugin.vehicle_sled import KMH, PARAMETERS, Sled, axle_brakes

BRAKE = PARAMETERS.air_brake
RESERVOIRS = tuple(f"reservoir_pressure_{circuit}" for circuit in ("front", "rear", "trailer"))
ATMOSPHERE = 101_325.0
DRY = {("air_brake", "compressor_displacement"): "0"}


def pump(sled, times):
    """Returns the reservoir pressures after full applications and releases of the pedal."""
    for _ in range(times):
        sled.run(1.5, brake_pedal=1.0).run(1.5, brake_pedal=0.0)
    return np.array([sled[name] for name in RESERVOIRS])


def test_sensors_show_full_reservoirs_from_the_reset_on():
    sled = Sled().run(1.0, brake_pedal=1.0)
    for _ in range(2):
        mujoco.mj_resetData(sled.model, sled.data)
        mujoco.mj_forward(sled.model, sled.data)
        assert [sled[name] for name in RESERVOIRS] == [BRAKE.governor_cut_out] * 3
        mujoco.mj_step(sled.model, sled.data)
        assert [sled[name] for name in RESERVOIRS] == [BRAKE.governor_cut_out] * 3


def test_reservoirs_start_full():
    sled = Sled().run(0.01)
    assert [sled[name] for name in RESERVOIRS] == [BRAKE.governor_cut_out] * 3


def test_a_brake_application_consumes_the_air_of_its_chambers():
    sled = Sled(55_000.0, changes=DRY).run(0.01)
    sled.run(1.5, brake_pedal=1.0)
    wheels = np.array([2, 4, 6]) * axle_brakes("chamber_volume")[[0, 1, 3]]
    filled = [
        sled[f"brake_pressure_{name}"] + ATMOSPHERE
        for name in ("front_left", "rear_left", "trailer")
    ]
    expected = BRAKE.governor_cut_out - wheels * filled / np.array(BRAKE.reservoir_volume)
    np.testing.assert_allclose([sled[name] for name in RESERVOIRS], expected, rtol=1e-6)


def test_eight_full_applications_leave_enough_for_secondary_braking():
    """UN R13 annex 7, no compressor: the ninth has at least half the pressure of the first."""
    sled = Sled(55_000.0, changes=DRY).run(1.5, brake_pedal=1.0)
    names = ("front_left", "rear_left", "trailer")
    first = np.array([sled[f"brake_pressure_{name}"] for name in names])
    sled.run(1.5, brake_pedal=0.0)
    left = pump(sled, 7)
    assert np.all(left < 0.85 * BRAKE.governor_cut_out)
    sled.run(1.5, brake_pedal=1.0)
    ninth = np.array([sled[f"brake_pressure_{name}"] for name in names])
    assert np.all(ninth > 0.5 * first)


def test_chamber_pressure_never_exceeds_the_reservoir_pressure():
    sled = Sled(55_000.0, changes=DRY | {("air_brake", "reservoir_volume"): "0.01 0.02 0.02"})
    names = ("brake_pressure_front_left", RESERVOIRS[0])
    for _ in range(4):
        rows = sled.record(1.5, *names, brake_pedal=1.0)
        assert np.all(rows[:, 0] <= rows[:, 1] + 1e3)
        sled.run(1.5, brake_pedal=0.0)


def test_compressor_cuts_in_and_out_and_the_reservoirs_store_all_its_air():
    sled = Sled(55_000.0)
    assert sled.run(1.0)["compressor_active"] == 0
    while sled["compressor_active"] == 0:
        before = [sled[name] for name in RESERVOIRS]
        sled.run(0.5, brake_pedal=1.0).run(0.5, brake_pedal=0.0)
    assert min(before + [sled[name] for name in RESERVOIRS]) < BRAKE.governor_cut_in
    sled.run(2.0)  # chambers are empty
    rows = sled.record(1.0, "engine_speed", *RESERVOIRS)
    stored = (rows[-1, 1:] - rows[0, 1:]) @ np.array(BRAKE.reservoir_volume)
    delivered = ATMOSPHERE * BRAKE.compressor_displacement * rows[1:, 0].sum() * 0.002
    assert stored == pytest.approx(delivered, rel=0.01)
    sled.run(120.0)
    assert sled["compressor_active"] == 0
    assert [sled[name] for name in RESERVOIRS] == pytest.approx([BRAKE.governor_cut_out] * 3)


def test_compressor_is_large_enough_for_fmvss_121():
    """S5.1.1: from 586 to 689 kPa within 25 s at the engine's greatest speed."""
    air = (689e3 - 586e3) * sum(BRAKE.reservoir_volume)
    flow = ATMOSPHERE * BRAKE.compressor_displacement * PARAMETERS.engine.governed_speed
    assert air / flow < 25.0


def test_abs_cycles_consume_air():
    used = []
    for grip in (0.15, 0.9):
        sled = Sled(30_000.0, speed=70 * KMH, grip=grip, changes=DRY)
        sled.run(4.0, brake_pedal=0.3)
        chambers = sled["brake_pressure_rear_left"] + ATMOSPHERE
        taken = (BRAKE.governor_cut_out - sled[RESERVOIRS[1]]) * BRAKE.reservoir_volume[1]
        used.append(taken / (chambers * 4 * axle_brakes("chamber_volume")[1]))
    cycling, steady = used
    assert steady == pytest.approx(1.0, rel=0.1)
    assert cycling > 1.2


def test_spring_brakes_apply_without_air():
    small = DRY | {("air_brake", "reservoir_volume"): "0.01 0.02 0.02"}
    sled = Sled(30_000.0, speed=60 * KMH, changes=small)
    sled.run(1.0)
    while sled[RESERVOIRS[2]] > BRAKE.spring_full_pressure:
        sled.run(0.3, brake_pedal=1.0).run(0.3, brake_pedal=0.0)
        assert sled.data.time < 60.0
    sled.run(10.0)
    assert sled["speed"] == pytest.approx(0, abs=1e-3)
    assert np.all(sled.wheels("brake_torques")[:2] == 0)  # no springs on the steer axle
    for _ in range(3):  # the engine cannot move the truck
        assert sled.run(1.0, accelerator_pedal=0.5)["speed"] < 0.01


@pytest.mark.parametrize("circuit", [0, 1, 2])
def test_leak_empties_its_own_circuit_by_its_rate(circuit):
    sled = Sled(30_000.0, changes=DRY).run(0.01)
    brake = sled.model.actuator_plugin[sled.model.actuator("xbr_demand").id]
    end = sled.model.plugin_stateadr[brake] + sled.model.plugin_statenum[brake]
    sled.data.plugin_state[end - len(CIRCUITS) - 3 * WHEELS_MAX + circuit] = 0.2
    sled.run(2.0)
    expected = np.full(3, BRAKE.governor_cut_out)
    expected[circuit] *= np.exp(-0.2 * 2.0)
    assert [sled[name] for name in RESERVOIRS] == pytest.approx(expected, rel=2e-3)


def test_full_reservoirs_release_the_spring_brakes():
    sled = Sled(30_000.0, speed=60 * KMH).run(0.5)
    for _ in range(100):
        assert np.all(sled.run(0.02).wheels("brake_torques") == 0)


def test_releasing_the_parking_brake_consumes_air():
    sled = Sled(30_000.0, changes=DRY).run(3.0, parking_brake=1.0)
    before = [sled[name] for name in RESERVOIRS]
    sled.run(3.0, parking_brake=0.0)
    fall = np.array(before) - [sled[name] for name in RESERVOIRS]
    assert fall[0] == 0
    assert np.all(fall[1:] > 50e3)
