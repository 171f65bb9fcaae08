"""The tires' law in numpy gives the plugin's forces."""

import numpy as np
import pytest

from iits_mj import Truck
from iits_mj.analytic.tire import Tires
from iits_mj.commands.bench_physics import tire_inputs, tire_states

RADIUS = 0.5


@pytest.fixture(scope="module")
def truck():
    return Truck.load(20_000.0, visuals=False)


def agree(truck):
    """Compares law and plugin at the truck's present state; returns the law's result."""
    truck.observe()
    forces = Tires.of(truck.parameters).step(*tire_inputs(truck))
    names = [f"{axle.name}_{side}" for axle in truck.parameters.axles for side in ("left", "right")]
    local, slip = (
        np.array([truck.sensor(f"{name}_{signal}") for name in names]).T
        for signal in ("tire_force", "tire_slip")
    )
    np.testing.assert_allclose(forces.bristles, tire_states(truck)[4:7], rtol=1e-6, atol=1e-9)
    # The plugin interpolates its curves; forces are tens of kilonewtons.
    np.testing.assert_allclose(forces.local, local, rtol=1e-6, atol=1e-2)
    np.testing.assert_allclose(forces.slip, slip, rtol=1e-6, atol=1e-9)
    return forces


def test_standing_truck(truck):
    truck.reset()
    forces = agree(truck)
    weight = truck.parameters.gross_mass(20_000.0) * 9.81
    assert forces.force[2].sum() == pytest.approx(weight, rel=1e-6)


def test_driving_steering_and_braking(truck):
    truck.reset(speed=15.0)
    truck.command(accelerator_pedal=0.6, steering_wheel_angle=1.5)
    for _ in range(5):
        truck.step(100)
        agree(truck)
    truck.command(accelerator_pedal=0.0, xbr_demand=-5.0, xbr_mode=2.0)
    for _ in range(5):
        truck.step(100)
        agree(truck)
    truck.command(xbr_demand=0.0, xbr_mode=0.0, steering_wheel_angle=0.0)


def test_locked_and_spinning_wheels_slide(truck):
    truck.reset(speed=15.0)
    wheels = [
        truck.model.joint(f"{axle.name}_left_spin").dofadr[0] for axle in truck.parameters.axles
    ]
    truck.data.qvel[wheels] = 0.0
    truck.data.qvel[wheels[1]] = 4.0 * 15.0 / RADIUS
    for _ in range(10):
        truck.step(1)
        truck.data.qvel[wheels[2]] = 0.0
        forces = agree(truck)
    assert forces.slip[0, 4] == pytest.approx(-1.0, abs=1e-6)


def test_flat_tires_of_a_single_and_a_twin_wheel(truck):
    truck.reset(speed=10.0)
    names = [f"{axle.name}_{side}" for axle in truck.parameters.axles for side in ("left", "right")]
    intact = agree(truck)
    for name in ("tractor_axle1_left", "trailer_axle2_right"):
        truck.faults.puncture(name, 1.0)
    flat = agree(truck)
    for name in ("tractor_axle1_left", "trailer_axle2_right"):
        assert flat.local[2, names.index(name)] < intact.local[2, names.index(name)]
    truck.step(100)
    agree(truck)


def test_a_wheel_in_the_air_has_no_force(truck):
    truck.reset()
    truck.data.qpos[2] += 1.0
    forces = agree(truck)
    assert not forces.force.any()
    assert not forces.moment.any()
