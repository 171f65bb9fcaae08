"""Inverse powertrain: shares of the brakes, XBR demand, interpolation."""

import numpy as np
import pytest

from iits_mj.parameters import TruckParameters
from tests.controllers.tracking.reference import EnduranceForces, Powertrain, interpolate, share_out
from tests.controllers.tracking.speed_reference import xbr_deceleration

PARAMETERS = TruckParameters.load()
INVERSE = Powertrain(PARAMETERS)
FORCES = EnduranceForces(drag=2e3, engine_brake=12e3, retarder=20e3)


@pytest.mark.parametrize(
    ("force", "engine_brake", "retarder", "short"),
    [
        (-5e3, 0.0, 0.0, 0.0),
        (1.5e3, 0.0, 0.0, 0.0),
        (8e3, 0.5, 0.0, 0.0),
        (14e3, 1.0, 0.0, 0.0),
        (24e3, 1.0, 0.5, 0.0),
        (40e3, 1.0, 1.0, 6e3),
    ],
)
def test_the_engine_brakes_first_then_the_retarder_then_friction(
    force, engine_brake, retarder, short
):
    shared = share_out(force, FORCES)
    assert (shared.engine_brake, shared.retarder) == pytest.approx((engine_brake, retarder))
    assert shared.short == pytest.approx(short)


def test_the_shares_add_up_to_the_force():
    for force in (3e3, 9e3, 17e3, 33e3, 60e3):
        shared = share_out(force, FORCES)
        given = FORCES.drag + shared.engine_brake * FORCES.engine_brake
        given += shared.retarder * FORCES.retarder + shared.short
        assert given == pytest.approx(force)


def test_in_a_gear_change_only_the_retarder_brakes():
    forces = INVERSE.endurance(16.0, 180.0, 9, engaged=False)
    assert (forces.drag, forces.engine_brake) == (0.0, 0.0)
    assert share_out(10e3, forces).retarder > 0.0


def test_endurance_brakes_have_the_rated_power_of_the_data_sheet():
    engine, retarder = PARAMETERS.engine, PARAMETERS.retarder
    rated = engine.engine_brake_speed
    assert INVERSE.engine_brake_torque(rated) * rated == pytest.approx(engine.engine_brake_power)
    fast = 1.2 * retarder.power_max / retarder.torque_max
    assert INVERSE.retarder_torque(fast) * fast == pytest.approx(retarder.power_max)
    assert INVERSE.retarder_torque(retarder.full_torque_speed) == retarder.torque_max


def test_endurance_brakes_fade_out_at_walking_pace():
    idle = PARAMETERS.engine.idle_speed
    slow = INVERSE.endurance(1.0, idle, 2, engaged=True)
    assert slow.engine_brake == 0.0
    assert slow.retarder < 0.1 * INVERSE.endurance(15.0, 150.0, 9, engaged=True).retarder


def test_on_the_level_xbr_demands_the_trucks_deceleration():
    for deceleration in (0.6, 1.5, 5.0):
        assert xbr_deceleration(deceleration, deceleration, 0.4, 0.3) == deceleration


@pytest.mark.parametrize("level", [0.2, 0.59, 0.9, 2.0])
def test_on_a_descent_the_correction_of_brake_control_reaches_the_level(level):
    demand = xbr_deceleration(0.0, level, 0.4, 0.3)
    assert demand + min(0.4 + 0.3 * demand, demand) == pytest.approx(level)


def test_uphill_xbr_demands_the_deceleration_although_less_braking_is_enough():
    assert xbr_deceleration(1.0, 0.4, 0.4, 0.3) == 1.0
    assert xbr_deceleration(-0.3, -0.5, 0.4, 0.3) == 0.0


def test_interpolation_equals_numpys_to_the_bit() -> None:
    rng = np.random.default_rng(1)
    for _ in range(3000):
        count, digits = rng.integers(1, 70), rng.integers(1, 16)
        # Rounded, so that some places are there twice and some are asked for exactly.
        places, values = np.sort(rng.normal(size=count).round(digits)), rng.normal(size=count)
        for x in (float(rng.normal()), float(rng.choice(places)), float(places[0]), 9.0, -9.0):
            expected = float(np.interp(x, places, values))
            assert interpolate(x, places.tolist(), values.tolist()) == expected
