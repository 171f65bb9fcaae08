"""Forces at the driven wheels: energy, losses, resistances."""

import dataclasses

import numpy as np
import pytest

from iits_mj.analytic.wheel_force import (
    full_load_force,
    input_torque,
    overall_ratio,
    resistance,
    wheel_force,
)
from iits_mj.core.units import GRAVITY, RPM
from iits_mj.model.powertrain import full_load
from iits_mj.parameters import TruckParameters

TRUCK = TruckParameters.load()
VECTO = TruckParameters.load("vecto_40t")


def test_wheel_power_is_engine_power_times_both_efficiencies():
    speed, force = full_load_force(TRUCK, 7)
    turns = speed * overall_ratio(TRUCK, 7)
    power = turns * np.interp(turns, *full_load(TRUCK)) - TRUCK.engine.auxiliary_power
    gearbox = TRUCK.gearbox
    np.testing.assert_allclose(
        force * speed, power * gearbox.efficiency * gearbox.driveline_efficiency, rtol=1e-12
    )


@pytest.mark.parametrize("gear", [1, 6, 12])
def test_auxiliaries_and_loss_maps_take_five_to_fourteen_percent_of_full_load(gear):
    speed, force = full_load_force(VECTO, gear)
    turns = speed * overall_ratio(VECTO, gear)
    share = force * speed / (turns * np.interp(turns, *full_load(VECTO)))
    assert (share > 0.86).all()
    assert (share < 0.95).all()


def test_auxiliaries_lower_the_power_by_their_own():
    more = dataclasses.replace(TRUCK.engine, auxiliaries={"fan": 20e3})
    none = dataclasses.replace(TRUCK.engine, auxiliaries={})
    forces = [
        full_load_force(dataclasses.replace(TRUCK, engine=engine), 12) for engine in (none, more)
    ]
    gearbox = TRUCK.gearbox
    lost = (forces[0][1] - forces[1][1]) * forces[0][0]
    np.testing.assert_allclose(lost, 20e3 * gearbox.efficiency * gearbox.driveline_efficiency)


def test_1200_rpm_in_the_direct_gear_are_87_kmh():
    # 1200 rpm / 2.59 x 0.4883 m
    assert 1200 * RPM / overall_ratio(VECTO, 12) * 3.6 == pytest.approx(85.3, abs=0.1)


def test_resistance_at_standstill_is_grade_and_rolling():
    level, climb = (resistance(TRUCK, 0.0, np.zeros(1), grade)[0] for grade in (0.0, 0.06))
    weight = TRUCK.gross_mass(0.0) * GRAVITY
    assert climb == pytest.approx((0.06 * weight + level) / np.hypot(1.0, 0.06))


def test_air_drag_grows_with_the_square_of_the_speed():
    still, slow, fast = resistance(VECTO, 0.0, np.array([0.0, 10.0, 20.0]))
    assert fast - still == pytest.approx(4.0 * (slow - still))


@pytest.mark.parametrize("truck", [TRUCK, VECTO])
@pytest.mark.parametrize("gear", [1, 8, 12])
def test_input_torque_is_the_inverse_of_the_wheel_force(truck, gear):
    torque, speed = np.array([-250.0, 40.0, 900.0, 2300.0]), np.full(4, 130.0)
    force = wheel_force(truck, gear, torque, speed)
    np.testing.assert_allclose(input_torque(truck, gear, force, speed), torque, rtol=1e-6)


@pytest.mark.parametrize(("speed", "torque"), [(30.0, 500.0), (150.0, 4000.0), (400.0, -900.0)])
def test_losses_continue_in_straight_lines_beyond_the_map_as_in_the_plugin(speed, torque):
    loss = VECTO.gearbox.gear_losses[4]
    step = 1.0
    lost = [float(loss.of(np.asarray(torque + k * step), np.asarray(speed))) for k in range(3)]
    assert lost[2] - lost[1] == pytest.approx(lost[1] - lost[0], abs=1e-9)
    assert min(lost) >= 0.0
    assert float(loss.of(np.asarray(1e3), np.asarray(-1e6))) >= 0.0
