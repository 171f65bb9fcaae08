"""The tire plugin on a one-wheel rig: prescribed hub motion, measured forces."""

import mujoco
import numpy as np
import pytest

import iits_mj
from iits_mj.parameters.tire_law import cornering_stiffness, friction
from tests.plugin.tire_rig import COMMON, PARAMETERS, drive, rig, road


def test_tire_deflects_by_load_over_vertical_stiffness():
    model, data = rig()
    model.dof_damping[2] = 5e4
    for _ in range(3000):
        mujoco.mj_step(model, data)
    tire = PARAMETERS.tires["drive"]
    weight = 700 * 9.81
    assert data.sensor("wheel_tire_force").data[2] == pytest.approx(weight, rel=1e-3)
    assert -data.qpos[2] == pytest.approx(weight / (2 * tire.vertical_stiffness), rel=1e-2)


@pytest.mark.parametrize("load", [20e3, 47e3, 70e3, 100e3])
def test_cornering_stiffness_equals_the_analytic_law_at_any_load(load):
    model, data = rig()
    angle = 1e-3
    force = drive(model, data, load=load, speed=15, slip_angle=angle)
    tire = PARAMETERS.tires["drive"]
    expected = tire.count * cornering_stiffness(load / tire.count, tire, COMMON)
    assert force[1] / angle == pytest.approx(expected, rel=5e-3)


def test_lateral_force_peaks_at_the_friction_of_the_load():
    load = 90e3
    peak = max(
        drive(*rig(), load=load, speed=15, slip_angle=a, seconds=0.5)[1]
        for a in np.radians([8, 12, 16, 20, 25])
    )
    tire = PARAMETERS.tires["drive"]
    mu = friction(load / tire.count, COMMON.friction_lateral, COMMON)
    assert peak == pytest.approx(mu * load, rel=0.01)


def test_combined_forces_share_the_friction_ellipse():
    load = 70e3
    pure = drive(*rig(), load=load, speed=15, slip_angle=0.1)
    both = drive(*rig(), load=load, speed=15, slip_angle=0.1, slip=-0.15)
    assert both[0] < 0
    assert both[1] < 0.9 * pure[1]
    limit_x, limit_y = COMMON.friction_longitudinal * load, COMMON.friction_lateral * load
    assert (both[0] / limit_x) ** 2 + (both[1] / limit_y) ** 2 <= 1.02


def test_lateral_force_builds_up_over_the_relaxation_length():
    load = 2 * COMMON.nominal_load
    speed, angle = 10.0, 2e-3
    model, data = rig()
    final = drive(model, data, load=load, speed=speed, slip_angle=angle)[1]
    model, data = rig()
    drive(model, data, load=load, speed=speed, seconds=0.5)
    time = COMMON.relaxation_lateral / speed
    built = drive(model, data, load=load, speed=speed, slip_angle=angle, seconds=time)[1]
    assert built / final == pytest.approx(1 - np.exp(-1), abs=0.03)


def test_free_rolling_wheel_slows_down_by_rolling_resistance():
    model, data = rig()
    tire = PARAMETERS.tires["drive"]
    deflection = 700 * 9.81 / (2 * tire.vertical_stiffness)
    radius = tire.rolling_radius + (COMMON.nominal_load / tire.vertical_stiffness - deflection) / 3
    data.qvel[0], data.qvel[3] = 10.0, 10.0 / radius
    data.qpos[2] = -deflection
    for _ in range(2000):
        mujoco.mj_step(model, data)
    deceleration = (10.0 - data.qvel[0]) / 2.0
    rotating = 34 / radius**2
    expected = tire.rolling_resistance * 9.81 * 700 / (700 + rotating)
    assert deceleration == pytest.approx(expected, rel=0.03)


@pytest.mark.parametrize("grade", [0.05, 0.08, 0.18])
@pytest.mark.parametrize("timestep", [0.001, 0.002, 0.005])
def test_locked_wheel_holds_on_a_grade_without_creep(grade, timestep):
    model, data = rig(wheel_joint='damping="1e9"')
    model.opt.timestep = timestep
    model.opt.gravity[:] = -9.81 * np.sin(np.arctan(grade)), 0, -9.81 * np.cos(np.arctan(grade))
    for _ in range(round(5 / timestep)):
        mujoco.mj_step(model, data)
    start = data.qpos[0]
    for _ in range(round(20 / timestep)):
        mujoco.mj_step(model, data)
    assert abs(data.qpos[0] - start) < 1e-4


def test_lifted_wheel_gives_no_force():
    model, data = rig()
    data.qpos[2] = 0.2
    data.qvel[:2] = 5, 5
    mujoco.mj_step(model, data)
    np.testing.assert_array_equal(data.sensor("wheel_tire_force").data, 0)


def test_forces_are_mirrored_left_and_right():
    left = drive(*rig(), load=40e3, speed=15, slip_angle=0.05)
    right = drive(*rig(), load=40e3, speed=15, slip_angle=-0.05)
    np.testing.assert_allclose(left * [1, -1, 1], right, rtol=1e-9)


OTHER = """
  <body name="other" pos="3 -4 {radius}"><joint type="slide" axis="1 0 0"/>
    <inertial pos="2 1 0" mass="900" diaginertia="9 9 9"/>
    <body pos="0 1 0"><joint axis="0 1 0"/><inertial pos="0 0 0" mass="9" diaginertia="1 1 1"/>
      {wheel}</body></body>"""


@pytest.mark.parametrize("wheel", ["", '<plugin plugin="iits.tire" instance="tire"/>'])
def test_other_vehicles_do_not_change_the_forces_on_a_wheel(wheel):
    """Neither a body without tires in the model, nor one with a wheel of the same plugin."""
    radius = PARAMETERS.tires["drive"].free_radius
    steered = '<joint name="steer" type="hinge" axis="0 0 1"/>'
    found = []
    for before in ("", OTHER.format(radius=radius - 0.02, wheel=wheel)):
        model, data = rig(hub_joint=steered, before=before)
        first = model.joint("x").dofadr[0]
        position = model.joint("x").qposadr[0]
        for _ in range(20):
            data.qpos[position:] = 0, 0, -0.02, 0.1, 0
            data.qvel[:] = 0
            data.qvel[first:] = 15, 0.3, -0.05, 0.4, 28
            mujoco.mj_step(model, data)
        mujoco.mj_forward(model, data)
        found.append([*data.sensor("wheel_tire_force").data, *data.qfrc_passive[first:]])
    np.testing.assert_allclose(found[1], found[0], rtol=1e-9, atol=1e-6)
    assert np.abs(found[0]).min() > 0.1


def test_tire_load_follows_height_and_normal_of_the_road_table():
    grade, tilt, height = 0.04, 0.02, 12.0
    rows = [
        [s, 0, height + grade * s, 1, 0, 0, grade, tilt, 0.8, 0.8, 0] for s in np.arange(-5.0, 30.0)
    ]
    model, data = rig(extra=road(rows))
    x, y = 7.3, 1.5
    for _ in range(10):
        data.qpos[:3] = x, y, height + grade * x + tilt * y
        data.qvel[:] = 0
        mujoco.mj_step(model, data)
    tire = PARAMETERS.tires["drive"]
    slant = 1 / np.sqrt(1 + grade**2 + tilt**2)
    deflection = tire.free_radius * (1 - slant)
    load = data.sensor("wheel_tire_force").data[2]
    assert load == pytest.approx(2 * tire.vertical_stiffness * deflection, rel=1e-2)


def test_split_friction_brakes_less_on_the_slippery_side():
    rows = [[s, 0, 0, 1, 0, 0, 0, 0, 0.8, 0.2, 0.0] for s in np.arange(-5.0, 30.0)]
    forces = []
    # A quarter of the friction peaks at about a quarter of the slip.
    for y, slip in ((1.0, -0.16), (-1.0, -0.04)):
        model, data = rig(extra=road(rows))
        data.qpos[1] = y
        forces.append(drive(model, data, load=60e3, speed=15, slip=slip, seconds=1.0)[0])
    assert forces[1] == pytest.approx(0.25 * forces[0], rel=0.05)


def test_malformed_road_table_is_refused():
    bad = '<custom><numeric name="iits_road" size="5" data="1 7 0 1 3"/></custom>'
    with pytest.raises(ValueError, match="not a road table"):
        rig(extra=bad)


@pytest.mark.parametrize(
    ("name", "value"), [("free_radius", -1.0), ("nominal_load", float("nan")), ("count", 7.0)]
)
def test_bad_attribute_is_refused_by_name(name, value):
    with pytest.raises(ValueError, match=name):
        rig(**{name: value})


def test_plugin_is_registered_by_importing_the_package():
    assert iits_mj.__version__
    model, _ = rig()
    assert model.nplugin == 1
