"""The fifth wheel on the truck: lash, stiffness and friction."""

import mujoco
import numpy as np
import pytest

from iits_mj.analytic import coupling_loads
from iits_mj.truck import Truck


@pytest.fixture(scope="module")
def truck():
    return Truck.load(payload=0, visuals=False)


def passive_torque(truck, joint, angle, rate=0.0):
    truck.reset()
    handle = truck.model.joint(joint)
    truck.data.qpos[handle.qposadr[0]] = angle
    truck.data.qvel[handle.dofadr[0]] = rate
    mujoco.mj_forward(truck.model, truck.data)
    return truck.data.qfrc_passive[handle.dofadr[0]]


def with_coupling(**values):
    """Returns an empty truck whose fifth wheel has other parameters."""
    overlay = {"units": {"trailer": {"coupling": values}}}
    return Truck.load(payload=0, parameters=overlay, visuals=False)


def roll_torque(angle, **fifth_wheel):
    """Returns the coupling's torque [N m], without that of the tires on the tilted trailer."""
    torques = [
        passive_torque(with_coupling(**values), "fifth_wheel_roll", angle)
        for values in (fifth_wheel, {**fifth_wheel, "roll_stiffness": 0.0})
    ]
    return torques[0] - torques[1]


def lift_moment(truck):
    """Returns the moment of the kingpin load at the plate's edge [N m]."""
    return 0.5 * coupling_loads(truck.parameters, 0)[0] * truck.parameters.couplings[0].plate_width


@pytest.mark.parametrize("angle_deg", [-0.9, 0.5, 0.99])
def test_lash_without_a_plate_transmits_no_roll_torque(angle_deg):
    torque = roll_torque(np.radians(angle_deg), plate_width=0.0)
    assert torque == pytest.approx(0.0, abs=1e-6)


def test_half_a_degree_beyond_the_lash_takes_50_kilonewton_metres():
    assert roll_torque(np.radians(1.5), plate_width=0.0) == pytest.approx(-50e3, rel=0.01)


def test_kingpin_load_keeps_the_plate_closed():
    assert roll_torque(np.radians(-0.1)) == pytest.approx(10e3, rel=0.01)


@pytest.mark.parametrize("share", [0.05, 0.95])
def test_opening_plate_carries_the_kingpin_load_on_its_edge(truck, share):
    moment = lift_moment(truck)
    coupling = truck.parameters.couplings[0]
    angle = moment / coupling.roll_stiffness + share * coupling.roll_lash
    assert roll_torque(angle) == pytest.approx(-moment, rel=1e-6)


def test_locked_kingpin_transmits_roll_torque_beyond_the_lash(truck):
    coupling, moment = truck.parameters.couplings[0], lift_moment(truck)
    angle = moment / coupling.roll_stiffness + coupling.roll_lash + np.radians(0.5)
    assert roll_torque(angle) == pytest.approx(-moment - 50e3, rel=0.01)


def test_friction_of_the_plate_opposes_yaw(truck):
    truck.reset()
    dof = truck.model.joint("fifth_wheel_yaw").dofadr[0]
    other = with_coupling(yaw_friction=0.0)
    torques = []
    for each in (truck, other):
        each.reset()
        for _ in range(20):
            each.data.qpos[:] = each.model.qpos0
            each.data.qvel[:] = 0
            each.data.qvel[dof] = 0.5
            mujoco.mj_step(each.model, each.data)
        torques.append(each.data.qfrc_passive[dof])
    friction = truck.parameters.couplings[0].yaw_friction
    assert torques[0] - torques[1] == pytest.approx(-friction, rel=1e-3)


def coupled(turntable, stiffness, load, plate_width):
    """Returns a model of one towed unit on a coupling, rolled by 0.05 rad, without gravity."""
    config = {
        "roll_stiffness": stiffness,
        "roll_damping": 2e3,
        "roll_lash": 0.02,
        "plate_width": plate_width,
        "kingpin_load": load,
        "yaw_friction": 8e3,
        "turntable": turntable,
    }
    keys = "".join(f'<config key="{k}" value="{v}"/>' for k, v in config.items())
    return mujoco.MjModel.from_xml_string(f"""
    <mujoco>
      <option timestep="0.002" integrator="implicitfast" gravity="0 0 0"/>
      <extension><plugin plugin="iits.fifth_wheel">
        <instance name="coupling">{keys}</instance></plugin></extension>
      <worldbody><body name="unit">
        <joint name="yaw" axis="0 0 1"/><joint name="pitch" axis="0 1 0"/>
        <joint name="roll" axis="1 0 0"/>
        <inertial pos="0 0 0" mass="3000" diaginertia="4e3 9e3 9e3"/>
        <plugin plugin="iits.fifth_wheel" instance="coupling"/>
      </body></worldbody>
    </mujoco>""")


def test_unloaded_turntable_swings_back_and_a_drawbar_eye_does_not():
    periods = {}
    for name, model in (
        ("turntable", coupled(1, 4e5, 0.0, 0.0)),
        ("drawbar_eye", coupled(0, 0.0, 0.0, 0.0)),
    ):
        data = mujoco.MjData(model)
        data.qpos[2] = 0.05
        rolls = []
        for _ in range(1000):
            mujoco.mj_step(model, data)
            rolls.append(data.qpos[2])
        periods[name] = rolls
    assert periods["drawbar_eye"] == [0.05] * 1000
    # sqrt(k / J) = 10 rad/s, damping ratio 0.025.
    crossings = np.flatnonzero(np.diff(np.sign(periods["turntable"])))
    assert np.diff(crossings).mean() * 0.002 == pytest.approx(np.pi / 10, rel=0.01)
    assert max(periods["turntable"][-300:]) == pytest.approx(0.05 * np.exp(-0.25 * 1.7), rel=0.1)
