"""Driver and XBR, friction and endurance brakes, and traction of the engine during braking."""

import mujoco
import numpy as np
import pytest

from iits_mj.core.units import GRAVITY
from tests.plugin.vehicle_sled import KMH, PARAMETERS, Sled

BRAKE = PARAMETERS.air_brake
TRAILER = "brake_pressure_trailer"
ENDURANCE = "endurance_torque_demand"
DRIVER = 1.5 / BRAKE.pedal_deceleration
XBR = {"xbr_demand": -1.5, "xbr_mode": 2.0}


def deceleration(mass=40_000.0, seconds=3.0, speed=80 * KMH, **controls):
    sled = Sled(mass, speed=speed).run(0.5).run(1.5, **controls)
    before = sled["speed"]
    sled.run(seconds, **controls)
    return (before - sled["speed"]) / seconds


@pytest.mark.parametrize("pedal", [0.05, 0.15, 0.3])
def test_brake_pedal_demands_its_share_of_the_greatest_deceleration(pedal):
    expected = pedal * BRAKE.pedal_deceleration
    assert deceleration(brake_pedal=pedal) == pytest.approx(expected, rel=0.03)


def test_full_pedal_demands_more_of_a_laden_truck_than_dry_friction_allows():
    """The wheels of this sled do not slip."""
    dry = PARAMETERS.tire_common.friction_longitudinal * GRAVITY
    assert deceleration(55_000.0, seconds=0.5, brake_pedal=1.0) > 1.05 * dry


@pytest.mark.parametrize(
    ("mode", "expected"), [(0, 1.5), (1, 1.5 + 1.0), (2, 1.5), (3, 1.5)], ids=str
)
def test_xbr_demand_below_the_drivers_is_added_in_addition_mode_only(mode, expected):
    found = deceleration(brake_pedal=DRIVER, xbr_demand=-1.0, xbr_mode=mode)
    assert found == pytest.approx(expected, rel=0.03)


@pytest.mark.parametrize(("mode", "expected"), [(1, 1.5 + 2.5), (2, 2.5)], ids=str)
def test_xbr_demand_above_the_drivers_is_added_or_replaces_it(mode, expected):
    found = deceleration(seconds=2.0, brake_pedal=DRIVER, xbr_demand=-2.5, xbr_mode=mode)
    assert found == pytest.approx(expected, rel=0.03)


def test_xbr_is_inactive_while_only_the_pedal_brakes():
    sled = Sled(speed=60 * KMH).run(1.0, brake_pedal=DRIVER)
    assert sled["xbr_active"] == 0
    assert sled.run(0.1, xbr_demand=-0.5, xbr_mode=2)["xbr_active"] == 1


def test_friction_only_mode_demands_no_endurance_torque():
    sled = Sled(40_000.0, speed=80 * KMH)
    rows = sled.record(3.0, ENDURANCE, TRAILER, xbr_demand=-1.0, xbr_mode=2, xbr_ebi_mode=0)
    assert np.all(rows[:, 0] == 0)
    assert rows[-1, 1] > BRAKE.push_out_pressure


def test_endurance_only_mode_applies_no_friction_brake():
    sled = Sled(40_000.0, speed=80 * KMH)
    rows = sled.record(3.0, ENDURANCE, TRAILER, xbr_demand=-1.0, xbr_mode=2, xbr_ebi_mode=1)
    assert rows[-1, 0] > 1000
    assert np.all(rows[:, 1] == 0)


def test_endurance_only_mode_keeps_friction_braking_for_the_driver():
    sled = Sled(40_000.0, speed=80 * KMH)
    controls = {"xbr_demand": -0.5, "xbr_mode": 2, "xbr_ebi_mode": 1}
    sled.run(2.0, brake_pedal=0.3, **controls)
    assert sled[TRAILER] > 100e3


def test_integration_mode_keeps_the_deceleration_with_less_friction_braking():
    """The drag of the engine counts as braking before any endurance brake acts."""
    with_friction = Sled(40_000.0, speed=80 * KMH).run(4.0, xbr_demand=-1.0, xbr_mode=2)
    shared = Sled(40_000.0, speed=80 * KMH).run(4.0, xbr_demand=-1.0, xbr_mode=2, xbr_ebi_mode=2)
    assert shared["speed"] == pytest.approx(with_friction["speed"], abs=0.15)
    assert shared[TRAILER] <= with_friction[TRAILER] + 1e3


@pytest.mark.parametrize(("mode", "tolerance"), [(0, 0.05), (2, 0.05)])
def test_engine_drag_counts_as_braking(mode, tolerance):
    """The total deceleration is right at high engine drag; friction supplies only the rest."""
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
    # Too early for the integral to correct a wrong mass.
    assert (before - sled["speed"]) / 0.5 == pytest.approx(2.0, rel=0.05)


@pytest.mark.parametrize("controls", [XBR, {"brake_pedal": 0.15}], ids=["xbr", "pedal"])
def test_braking_cuts_engine_traction(controls):
    sled = Sled(40_000.0, speed=60 * KMH).run(4.0, accelerator_pedal=0.8)
    assert sled["propeller_shaft_torque"] > 1000
    sled.run(2.5, **controls)
    before = sled["speed"]
    rows = sled.record(2.0, "propeller_shaft_torque", "speed")
    assert np.all(rows[:, 0] < 50)
    assert (before - sled["speed"]) / 2.0 == pytest.approx(1.5, rel=0.04)


def test_traction_returns_after_braking():
    sled = Sled(40_000.0, speed=60 * KMH).run(3.0, accelerator_pedal=0.5).run(2.0, **XBR)
    rows = sled.record(5.0, "propeller_shaft_torque", "speed", xbr_demand=0.0)
    assert rows[-1, 0] > 500
    acceleration = np.convolve(np.gradient(rows[:, 1], 0.002), np.ones(100) / 100, mode="valid")
    assert np.gradient(acceleration, 0.002).max() < 8.0
    assert acceleration[-1] > 0.05


def test_brake_pedal_holds_the_truck_against_the_engine():
    sled = Sled(20_000.0).run(2.0, brake_pedal=0.4)
    sled.run(4.0, accelerator_pedal=1.0)
    assert abs(sled["position"]) < 0.02
