"""Tire forces: load, relaxation, sliding, rolling resistance, standstill and dual tires."""

import mujoco
import numpy as np
import pytest

from iits_mj.parameters.tire_law import cornering_stiffness, friction
from iits_mj.truck import Truck
from tests.plugin.tire_rig import COMMON, PARAMETERS, drive, rig, road

NOMINAL = 2 * COMMON.nominal_load  # of a dual pair
STEER_AXIS = '<joint name="steer" type="hinge" axis="0 0 1"/>'


def aligning_moment(angle, load=NOMINAL):
    """Returns the aligning moment [N m] about the wheel center and the lateral force [N]."""
    model, data = rig(hub_joint=STEER_AXIS)
    force = drive(model, data, load=load, speed=15.0, slip_angle=angle, seconds=0.6)
    mujoco.mj_forward(model, data)
    return data.qfrc_passive[model.joint("steer").dofadr[0]], force[1]


def build_up(load, speed, angle=1e-3):
    """Returns distance [m] and share of the steady force after a step in slip angle."""
    model, data = rig()
    model.opt.timestep = 0.0005
    drive(model, data, load=load, speed=speed, seconds=20 * 0.0005)
    forces, step = [], 5 * 0.0005
    for _ in range(round(6.0 / speed / step)):
        forces.append(drive(model, data, load=load, speed=speed, slip_angle=angle, seconds=step)[1])
    way = speed * step * np.arange(1, len(forces) + 1)
    return way, np.array(forces) / forces[-1]


def test_cornering_stiffness_rises_less_and_less_with_load():
    loads = np.linspace(0.2, 1.8, 9) * NOMINAL
    stiffness = np.array(
        [drive(*rig(), load=load, speed=15.0, slip_angle=1e-3, seconds=0.7)[1] for load in loads]
    )
    assert (np.diff(stiffness) > 0).all()
    assert (np.diff(stiffness, 2) < 0).all()


def test_peak_friction_falls_with_load():
    tire, peaks = PARAMETERS.tires["drive"], []
    loads = np.array([0.5, 1.0, 1.5]) * NOMINAL
    for load in loads:
        peaks.append(
            max(
                drive(*rig(), load=load, speed=15.0, slip_angle=angle, seconds=0.4)[1] / load
                for angle in np.radians([7.0, 10.0, 13.0, 16.0, 20.0, 24.0])
            )
        )
    assert peaks[0] > peaks[1] > peaks[2]
    expected = friction(loads / tire.count, COMMON.friction_lateral, COMMON)
    np.testing.assert_allclose(peaks, expected, rtol=0.01)


@pytest.mark.parametrize("slip", [-0.03, -0.1, -0.3, 0.1])
def test_braking_or_driving_reduces_the_lateral_force(slip):
    pure = drive(*rig(), load=NOMINAL, speed=15.0, slip_angle=0.06, seconds=1.0)[1]
    both = drive(*rig(), load=NOMINAL, speed=15.0, slip_angle=0.06, slip=slip, seconds=1.0)
    assert 0.0 < both[1] < pure
    assert both[0] * slip > 0.0
    limits = NOMINAL * np.array([COMMON.friction_longitudinal, COMMON.friction_lateral])
    assert np.linalg.norm(both[:2] / limits) <= 1.01


@pytest.mark.parametrize("angle", [0.05, 0.2, 0.8])
def test_a_locked_wheel_slides_against_its_motion_and_does_not_steer(angle):
    force = drive(*rig(), load=NOMINAL, speed=15.0, slip_angle=angle, slip=-1.0, seconds=1.0)
    # Longitudinal and lateral friction differ a little, which turns the force.
    assert np.arctan2(force[1], -force[0]) == pytest.approx(angle, rel=0.3)
    rolling = drive(*rig(), load=NOMINAL, speed=15.0, slip_angle=angle)
    assert abs(force[1]) < abs(rolling[1])


def test_truck_in_neutral_comes_to_rest_on_its_rolling_resistance():
    truck = Truck.load(visuals=False)
    truck.reset(speed=0.3)
    truck.command(transmission_mode=1)
    truck.step(10_000)
    assert np.abs(truck.data.qvel).max() < 1e-4


@pytest.mark.parametrize("relative", [0.5, 1.0, 1.5])
def test_lateral_force_reaches_63_percent_after_the_relaxation_length_at_any_speed(relative):
    expected = COMMON.relaxation_lateral * relative**COMMON.relaxation_load_exponent
    ways = []
    for speed in (3.0, 10.0, 25.0):
        way, share = build_up(relative * NOMINAL, speed)
        ways.append(np.interp(1.0 - np.exp(-1.0), share, way))
    np.testing.assert_allclose(ways, expected, rtol=0.06)
    assert max(ways) - min(ways) < 0.06 * expected


def test_aligning_moment_has_the_pneumatic_trail_at_small_slip_and_vanishes_when_sliding():
    moment, force = aligning_moment(1e-3)
    assert -moment / force == pytest.approx(PARAMETERS.tires["drive"].pneumatic_trail, rel=0.03)
    moments = {
        degrees: -aligning_moment(np.radians(degrees))[0] for degrees in (4.0, 6.0, 12.0, 25.0)
    }
    assert 0.0 < moments[12.0] < 0.75 * moments[6.0]  # it peaks long before the force
    assert abs(moments[25.0]) < 0.01 * moments[6.0]


@pytest.mark.parametrize("load", [0.3 * NOMINAL, NOMINAL])
def test_sideways_deflection_of_the_carcass_adds_an_overturning_moment(load):
    tire = PARAMETERS.tires["drive"]
    model, data = rig(hub_joint='<joint name="tip" type="hinge" axis="1 0 0"/>')
    drive(model, data, load=load, speed=15.0, slip_angle=1e-3, seconds=0.6)
    mujoco.mj_forward(model, data)
    force = data.sensor("wheel_tire_force").data
    load = force[2]  # includes the force of the vertical damper
    height = tire.free_radius + data.qpos[2]
    beyond = data.qfrc_passive[model.joint("tip").dofadr[0]] - height * force[1]
    relative = load / NOMINAL
    relaxation = COMMON.relaxation_lateral * relative**COMMON.relaxation_load_exponent
    stiffness = tire.count * float(cornering_stiffness(load / tire.count, tire, COMMON))
    deflection = force[1] * relaxation / stiffness
    assert beyond == pytest.approx(load * deflection, rel=0.01)
    assert 1e-5 < deflection < 1e-3


@pytest.mark.parametrize(("share", "holds"), [(0.9, True), (1.2, False)])
def test_rolling_resistance_holds_an_unbraked_wheel_up_to_its_own_grade(share, holds):
    tire = PARAMETERS.tires["drive"]
    slope = share * tire.rolling_resistance
    model, data = rig()
    model.dof_damping[2] = 5e4
    data.qpos[2] = -700 * 9.81 / (2 * tire.vertical_stiffness)
    model.opt.gravity[:] = -9.81 * np.sin(slope), 0.0, -9.81 * np.cos(slope)
    means = []
    for _ in range(4):
        way = []
        for _ in range(10_000):
            mujoco.mj_step(model, data)
            way.append(data.qpos[0])
        means.append(np.mean(way))
    if holds:  # rocking on the tread at most
        assert abs(means[-1]) < 0.05
        assert means[-1] == pytest.approx(means[-2], abs=1e-4)
    else:
        expected = 0.5 * 9.81 * (share - 1.0) * tire.rolling_resistance * 40.0**2
        assert -data.qpos[0] == pytest.approx(expected * 700 / (700 + 34 / 0.54**2), rel=0.1)


def test_lifted_wheel_has_no_force_and_regains_it_after_landing():
    case = {"load": NOMINAL, "speed": 15.0, "slip_angle": 0.05}
    model, data = rig(hub_joint=STEER_AXIS)
    before = drive(model, data, **case)
    for _ in range(200):
        data.qpos[2] = 0.05
        data.qvel[:] = 0.0
        data.qvel[:2] = 15.0, -15.0 * np.tan(0.05)
        mujoco.mj_step(model, data)
        np.testing.assert_array_equal(data.sensor("wheel_tire_force").data, 0.0)
        np.testing.assert_array_equal(data.qfrc_passive, 0.0)
    # The tread has lost its strain: the side force builds up again.
    landed = drive(model, data, **case, seconds=0.002)
    assert landed[2] == pytest.approx(NOMINAL)
    assert landed[1] < 0.2 * before[1]
    np.testing.assert_allclose(drive(model, data, **case), before, rtol=1e-6)


@pytest.mark.parametrize(("angle", "slip"), [(1e-3, 0.0), (0.1, 0.0), (0.06, -0.1), (0.3, -0.5)])
@pytest.mark.parametrize("load", [15e3, 35e3, 60e3])
def test_dual_tire_equals_two_single_tires_at_half_the_load(load, angle, slip):
    case = {"speed": 15.0, "slip_angle": angle, "slip": slip, "seconds": 1.0}
    single = drive(*rig(count=1), load=load, count=1, **case)
    pair = drive(*rig(count=2), load=2 * load, count=2, **case)
    np.testing.assert_allclose(pair, 2 * single, rtol=1e-9)


def on_split_road(y, angle):
    """Returns the lateral force on a road with friction 0.8 left and 0.3 right of y = 0."""
    rows = [[s, 0, 0, 1, 0, 0, 0, 0, 0.8, 0.3, 0.0] for s in np.arange(-5.0, 30.0)]
    model, data = rig(extra=road(rows))
    for _ in range(8):
        # Back to the start, so that the wheel does not cross the split.
        data.qpos[:2] = 0.0, y
        force = drive(model, data, load=NOMINAL, speed=5.0, slip_angle=angle, seconds=0.1)
    return force[1]


def test_surface_friction_changes_the_peak_force_but_not_the_cornering_stiffness():
    small = 1e-3
    assert on_split_road(-1.0, small) == pytest.approx(on_split_road(1.0, small), rel=0.01)
    dry, wet = (
        max(on_split_road(y, angle) for angle in np.radians([3, 4, 5, 6, 7, 8, 12, 15, 18]))
        for y in (1.0, -1.0)
    )
    assert wet == pytest.approx(0.3 / 0.8 * dry, rel=0.02)


def test_locked_wheel_yields_elastically_to_a_small_side_force():
    """Under a side force of a tenth of the friction it moves a little, stays, and returns."""
    tire = PARAMETERS.tires["drive"]
    model, data = rig(wheel_joint='damping="1e9"')
    model.dof_damping[2] = 5e4
    weight = 700 * 9.81
    data.qpos[2] = -weight / (2 * tire.vertical_stiffness)
    data.qfrc_applied[1] = 0.1 * weight
    for _ in range(30_000):
        mujoco.mj_step(model, data)
    pushed = data.qpos[1]
    for _ in range(10_000):
        mujoco.mj_step(model, data)
    assert 1e-4 < pushed < 0.05
    assert data.qpos[1] == pytest.approx(pushed, abs=1e-9)
    data.qfrc_applied[1] = 0.0
    for _ in range(10_000):
        mujoco.mj_step(model, data)
    assert abs(data.qpos[1]) < 0.02 * pushed
