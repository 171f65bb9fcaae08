"""Combination of driver and XBR, of friction and endurance brakes, and the engine's traction."""

import mujoco
import numpy as np
import pytest

from iits_mj.core.units import GRAVITY
from tests.plugin.vehicle_sled import KMH, PARAMETERS, Sled

BRAKE = PARAMETERS.air_brake
TRAILER = "brake_pressure_trailer"
ENDURANCE = "endurance_torque_demand"
DRIVER = 1.5 / BRAKE.pedal_deceleration


def deceleration(mass=40_000.0, seconds=3.0, speed=80 * KMH, **controls):
    sled = Sled(mass, speed=speed).run(0.5).run(1.5, **controls)
    before = sled["speed"]
    sled.run(seconds, **controls)
    return (before - sled["speed"]) / seconds


@pytest.mark.parametrize("pedal", [0.05, 0.15, 0.3])
def test_brake_pedal_demands_its_share_of_the_greatest_deceleration(pedal):
    wanted = pedal * BRAKE.pedal_deceleration
    assert deceleration(brake_pedal=pedal) == pytest.approx(wanted, rel=0.03)


def test_full_pedal_brakes_a_laden_truck_harder_than_a_dry_road_can_hold():
    """On this sled wheels do not slip."""
    dry = PARAMETERS.tire_common.friction_longitudinal * GRAVITY
    assert deceleration(55_000.0, seconds=0.5, brake_pedal=1.0) > 1.05 * dry


@pytest.mark.parametrize(
    ("mode", "wanted"), [(0, 1.5), (1, 1.5 + 1.0), (2, 1.5), (3, 1.5)], ids=str
)
def test_xbr_below_the_driver_is_added_in_addition_mode_only(mode, wanted):
    found = deceleration(brake_pedal=DRIVER, xbr_demand=-1.0, xbr_mode=mode)
    assert found == pytest.approx(wanted, rel=0.03)


@pytest.mark.parametrize(("mode", "wanted"), [(1, 1.5 + 2.5), (2, 2.5)], ids=str)
def test_xbr_above_the_driver_overrides_in_maximum_mode(mode, wanted):
    found = deceleration(seconds=2.0, brake_pedal=DRIVER, xbr_demand=-2.5, xbr_mode=mode)
    assert found == pytest.approx(wanted, rel=0.03)


def test_pedal_alone_is_not_an_active_xbr():
    sled = Sled(speed=60 * KMH).run(1.0, brake_pedal=DRIVER)
    assert sled["xbr_active"] == 0
    assert sled.run(0.1, xbr_demand=-0.5, xbr_mode=2)["xbr_active"] == 1


def test_friction_only_asks_nothing_of_the_endurance_brakes():
    sled = Sled(40_000.0, speed=80 * KMH)
    rows = sled.record(3.0, ENDURANCE, TRAILER, xbr_demand=-1.0, xbr_mode=2, xbr_ebi_mode=0)
    assert np.all(rows[:, 0] == 0)
    assert rows[-1, 1] > BRAKE.push_out_pressure


def test_endurance_only_leaves_the_friction_brakes_alone():
    sled = Sled(40_000.0, speed=80 * KMH)
    rows = sled.record(3.0, ENDURANCE, TRAILER, xbr_demand=-1.0, xbr_mode=2, xbr_ebi_mode=1)
    assert rows[-1, 0] > 1000
    assert np.all(rows[:, 1] == 0)


def test_endurance_only_keeps_friction_braking_for_the_driver():
    sled = Sled(40_000.0, speed=80 * KMH)
    controls = {"xbr_demand": -0.5, "xbr_mode": 2, "xbr_ebi_mode": 1}
    sled.run(2.0, brake_pedal=0.3, **controls)
    assert sled[TRAILER] > 100e3


def test_integration_keeps_the_total_while_friction_is_spared():
    """The engine's own drag is all that this powertrain is sure to give: it counts already."""
    with_friction = Sled(40_000.0, speed=80 * KMH).run(4.0, xbr_demand=-1.0, xbr_mode=2)
    shared = Sled(40_000.0, speed=80 * KMH).run(4.0, xbr_demand=-1.0, xbr_mode=2, xbr_ebi_mode=2)
    assert shared["speed"] == pytest.approx(with_friction["speed"], abs=0.15)
    assert shared[TRAILER] <= with_friction[TRAILER] + 1e3


@pytest.mark.parametrize(("mode", "tolerance"), [(0, 0.05), (2, 0.05)])
def test_engine_drag_counts_as_braking(mode, tolerance):
    """Much drag: total deceleration is right, friction gives only the rest."""
    mass = 19_000.0
    sled = Sled(mass, speed=45 * KMH).run(1.0)
    sled.run(1.0, xbr_demand=-1.0, xbr_mode=2, xbr_ebi_mode=mode)
    before = sled["speed"]
    rows = sled.record(1.5, "propeller_shaft_torque", xbr_demand=-1.0)
    assert (before - sled["speed"]) / 1.5 == pytest.approx(1.0, rel=tolerance)
    assert rows[:, 0].mean() < -100


def test_abs_switches_the_endurance_brakes_off():
    sled = Sled(19_000.0, speed=70 * KMH, grip=0.2)
    rows = sled.record(2.0, "abs_active", ENDURANCE, xbr_demand=-6.0, xbr_mode=2, xbr_ebi_mode=2)
    active = rows[1:-1, 0] > 0
    assert active.any()
    assert np.all(rows[2:, 1][active] <= 0)


def test_deceleration_control_compensates_an_unknown_grade():
    for grade in (-0.04, 0.03):
        sled = Sled(50_000.0, speed=80 * KMH, grade=grade).run(5.0, xbr_demand=-1.5, xbr_mode=2)
        before = sled["speed"]
        sled.run(3.0)
        assert (before - sled["speed"]) / 3.0 == pytest.approx(1.5, rel=0.03)


@pytest.mark.parametrize("factor", [0.6, 1.0, 1.5])
def test_load_sensing_uses_the_present_mass_of_the_model(factor):
    """Domain randomization scales the masses of a compiled model."""
    sled = Sled(30_000.0, speed=70 * KMH)
    body = sled.model.body("sled").id
    sled.model.body_mass[body] *= factor
    mujoco.mj_setConst(sled.model, sled.data)
    sled.data.qvel[0] = 70 * KMH
    for axle in PARAMETERS.axles:
        for side in ("left", "right"):
            dof = sled.model.joint(f"{axle.name}_{side}_spin").dofadr[0]
            sled.data.qvel[dof] = 70 * KMH / PARAMETERS.tires[axle.tire].rolling_radius
    sled.run(0.7, xbr_demand=-2.0, xbr_mode=2)
    before = sled["speed"]
    sled.run(0.5)
    # Before the integral could learn it.
    assert (before - sled["speed"]) / 0.5 == pytest.approx(2.0, rel=0.05)
