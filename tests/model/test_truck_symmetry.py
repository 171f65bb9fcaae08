"""The truck is symmetric: in its parts, at rest, rolling, and in every motion."""

import mujoco
import numpy as np
import pytest

from iits_mj.truck import Truck
from tests.model.mirror import Mirror, twin

REFLECT = np.array([1.0, -1.0, 1.0])


@pytest.fixture(scope="module")
def truck():
    return Truck.load(visuals=False)


def pairs(model, kind, count):
    """(element, its twin) for every element of the left side."""
    handle = getattr(model, kind)
    for i in range(count):
        if "left" in handle(i).name.split("_"):
            yield handle(i), handle(twin(handle(i).name))


def forces(truck, side):
    return np.array(
        [
            truck.data.sensor(f"{axle.name}_{side}_tire_force").data
            for axle in truck.parameters.axles
        ]
    )


def test_bodies_have_the_same_mass_inertia_and_place_on_both_sides(truck):
    found = list(pairs(truck.model, "body", truck.model.nbody))
    assert len(found) == 12  # a hub and a wheel per axle
    for left, right in found:
        np.testing.assert_array_equal(left.mass, right.mass)
        np.testing.assert_array_equal(left.inertia, right.inertia)
        np.testing.assert_array_equal(left.pos * REFLECT, right.pos)
        np.testing.assert_array_equal(left.ipos * REFLECT, right.ipos)


def test_joints_have_the_same_spring_damper_and_range_on_both_sides(truck):
    found = list(pairs(truck.model, "joint", truck.model.njnt))
    assert len(found) == 7  # a spin per axle and the knuckle
    for left, right in found:
        for figure in ("stiffness", "qpos_spring", "damping", "armature", "frictionloss"):
            np.testing.assert_array_equal(getattr(left, figure), getattr(right, figure))
        np.testing.assert_array_equal(left.axis, right.axis)
        np.testing.assert_array_equal(left.range, -right.range[::-1])


def test_bodies_without_a_twin_lie_on_the_middle_plane(truck):
    model = truck.model
    for i in range(1, model.nbody):
        body = model.body(i)
        if twin(body.name) == body.name:
            assert (body.pos[1], body.ipos[1]) == (0.0, 0.0), body.name


@pytest.mark.parametrize("payload", [0.0, 36_000.0])
def test_tires_at_rest_carry_equal_loads_and_no_side_force(payload):
    truck = Truck.load(payload, visuals=False)
    truck.step(1000)
    truck.observe()
    left, right = forces(truck, "left"), forces(truck, "right")
    np.testing.assert_allclose(left, right * REFLECT, rtol=1e-6, atol=1e-3)
    np.testing.assert_allclose(left[:, 1], 0.0, atol=1e-3)
    assert abs(truck.data.qpos[1]) < 1e-9


@pytest.mark.parametrize("payload", [0.0, 36_000.0])
def test_truck_rolling_straight_does_not_drift_sideways(payload):
    truck = Truck.load(payload, visuals=False)
    truck.reset(speed=20.0)
    truck.command(transmission_mode=1)
    truck.step(2500)
    ego = truck.observe()
    assert ego.x > 90.0
    assert abs(ego.y) < 1e-9
    assert abs(ego.yaw) < 1e-10
    assert abs(ego.articulation) < 1e-10


def test_mirrored_commands_give_the_mirrored_motion(truck):
    """Steering, driving and braking show any term that differs between left and right."""
    model, mirror = truck.model, Mirror(truck.model)
    truck.reset(speed=20.0)
    ours, theirs = mujoco.MjData(model), mujoco.MjData(model)
    ours.qpos[:], ours.qvel[:] = model.qpos0, truck.data.qvel
    theirs.qpos[:] = mirror.position(ours.qpos)
    theirs.qvel[:] = mirror.velocity(ours.qvel)
    for k in range(1500):
        braking = k > 800
        steer = 0.3 + 0.8 * np.sin(0.006 * k)
        ours.ctrl[:4] = 0.0 if braking else 0.4, -2.0 * braking, 2 * braking, steer
        theirs.ctrl[:] = mirror.control(ours.ctrl)
        mujoco.mj_step(model, ours)
        mujoco.mj_step(model, theirs)
    assert abs(ours.qpos[1]) > 3.0  # the truck moved to the side
    np.testing.assert_allclose(theirs.qpos, mirror.position(ours.qpos), atol=1e-9)
    np.testing.assert_allclose(theirs.qvel, mirror.velocity(ours.qvel), atol=1e-9)
