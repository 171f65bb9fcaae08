"""The fifth wheel on the truck: lash, stiffness and friction."""

import mujoco
import numpy as np
import pytest

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


def tires_only(truck, angle):
    """The tires push on the tilted trailer, too: their part, from a model without lash spring."""
    other = Truck.load(
        payload=0, parameters={"fifth_wheel": {"roll_stiffness": 0.0}}, visuals=False
    )
    return passive_torque(other, "fifth_wheel_roll", angle)


@pytest.mark.parametrize("angle_deg", [-0.9, 0.5, 0.99])
def test_lash_carries_no_roll(truck, angle_deg):
    angle = np.radians(angle_deg)
    torque = passive_torque(truck, "fifth_wheel_roll", angle) - tires_only(truck, angle)
    assert torque == pytest.approx(0.0, abs=1e-6)


def test_beyond_the_lash_a_degree_takes_100_kilonewton_metres(truck):
    angle = np.radians(1.5)
    torque = passive_torque(truck, "fifth_wheel_roll", angle) - tires_only(truck, angle)
    assert torque == pytest.approx(-50e3, rel=0.01)


def test_greased_plate_brakes_yaw_with_its_friction(truck):
    truck.reset()
    dof = truck.model.joint("fifth_wheel_yaw").dofadr[0]
    other = Truck.load(payload=0, parameters={"fifth_wheel": {"yaw_friction": 0.0}}, visuals=False)
    torques = []
    for each in (truck, other):
        each.reset()
        for _ in range(20):
            each.data.qpos[:] = each.model.qpos0
            each.data.qvel[:] = 0
            each.data.qvel[dof] = 0.5
            mujoco.mj_step(each.model, each.data)
        torques.append(each.data.qfrc_passive[dof])
    friction = truck.parameters.fifth_wheel.yaw_friction
    assert torques[0] - torques[1] == pytest.approx(-friction, rel=1e-3)
