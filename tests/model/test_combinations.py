"""Other combinations: loads at rest, lifted and steered axles, equilibrium."""

import numpy as np
import pytest

from iits_mj.core.units import GRAVITY
from iits_mj.model.sensor_table import sensor_unit
from iits_mj.parameters import TruckParameters
from iits_mj.parameters.mass_state import axle_loads_by_name, coupling_loads, static_axle_loads
from iits_mj.truck import Truck
from tests.combinations import TRUCKS, load

SIDES = ("left", "right")


def tire_loads(truck):
    """Returns the load that each axle's tires carry [N], (axles,)."""
    return np.array(
        [
            sum(truck.sensor(f"{axle.name}_{side}_tire_force")[2] for side in SIDES)
            for axle in truck.parameters.axles
        ]
    )


def knuckles(truck, axle):
    """Returns the angles of an axle's road wheels [rad], left and right."""
    return np.array([float(truck.data.joint(f"{axle}_{side}_knuckle").qpos[0]) for side in SIDES])


def settled(truck, speed, steering, seconds):
    """Lets a truck roll in neutral with the steering wheel held."""
    truck.reset(speed=speed)
    truck.command(steering_wheel_angle=steering, transmission_mode=1)
    truck.step(round(seconds / truck.model.opt.timestep))
    return truck


@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
@pytest.mark.parametrize("name", TRUCKS)
def test_tires_carry_the_static_loads_at_rest_on_level_ground(name, share):
    parameters = load(name)
    payload = share * parameters.payload_max
    truck = Truck.load(payload, parameters=parameters, visuals=False)
    truck.step(1000)
    loads = tire_loads(truck)
    np.testing.assert_allclose(loads, static_axle_loads(parameters, payload), rtol=0.005, atol=20.0)
    assert loads.sum() == pytest.approx(parameters.gross_mass(payload) * GRAVITY, rel=1e-5)
    assert np.abs(truck.data.qvel).max() < 1e-5


@pytest.mark.parametrize("name", TRUCKS)
def test_every_unit_is_a_body_in_the_one_ahead_and_every_sensor_has_a_unit(name):
    parameters = load(name)
    truck = Truck.load(0.0, parameters=parameters, visuals=False)
    bodies = [truck.model.body(unit.name) for unit in parameters.units]
    assert [int(body.parentid[0]) for body in bodies[1:]] == [body.id for body in bodies[:-1]]
    mass = truck.model.body_subtreemass[bodies[0].id]
    assert mass == pytest.approx(parameters.gross_mass(0.0))
    for i in range(truck.model.nsensor):
        assert sensor_unit(truck.model.sensor(i).name).unit


def test_a_truck_without_trailer_carries_itself():
    alone, whole = load("alone"), TruckParameters.load()
    assert coupling_loads(alone, 0.0) == ()
    assert static_axle_loads(alone, 0.0).sum() == pytest.approx(whole.lead.mass * GRAVITY)
    truck = Truck.load(parameters=alone, visuals=False)
    truck.reset(speed=5.0)
    truck.command(accelerator_pedal=1.0)
    truck.step(2500)
    assert truck.observe().speed > 8.0


def test_a_dolly_carries_half_of_the_second_semitrailer_and_little_of_its_own_on_the_hook():
    parameters = load("dolly")
    _, hook, turntable = coupling_loads(parameters, 20_000.0)
    second = parameters.last
    weight = (second.mass + parameters.unit_payloads(20_000.0)[-1]) * GRAVITY
    assert turntable == pytest.approx(coupling_loads(TruckParameters.load(), 10_000.0)[0])
    assert 0.0 < turntable < weight
    assert abs(hook) < 0.1 * turntable


def test_a_lifted_axle_carries_nothing_and_clears_the_road():
    parameters = load("lift_axle")
    for payload, lifted in ((14_999.0, True), (15_000.0, False)):
        truck = Truck.load(payload, parameters=parameters, visuals=False)
        settled(truck, 10.0, 0.5, 2.0)
        loads = dict(zip([axle.name for axle in parameters.axles], tire_loads(truck), strict=True))
        assert bool(loads["trailer_axle1"] == 0.0) is lifted
        assert (axle_loads_by_name(parameters, payload)["trailer_axle1"] == 0.0) is lifted
        wheel = float(truck.data.body("trailer_axle1_left_wheel").xpos[2])
        clear = wheel - parameters.tires["trailer"].free_radius
        assert (clear > 0.05) is lifted
        assert loads["trailer_axle2"] > 0.0


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_self_steering_axle_turns_into_the_bend(side):
    """Behind the fixed axles the trailer slides outward, and the wheels turn along that."""
    steering, found = side * 5.0, []
    for name in ("self_steering", None):
        parameters = load(name) if name else TruckParameters.load()
        truck = settled(Truck.load(0.0, parameters=parameters, visuals=False), 8.0, steering, 4.0)
        forces = [truck.sensor(f"trailer_axle3_{each}_tire_force")[1] for each in SIDES]
        found.append(abs(sum(forces)))
        if name:
            angles = knuckles(truck, "trailer_axle3")
            assert (-side * angles > np.deg2rad(0.5)).all()
            # The tie rod keeps the wheels nearly parallel.
            assert np.ptp(angles) < np.deg2rad(0.5)
    turned, fixed = found
    assert turned < 0.5 * fixed


def test_two_steered_axles_turn_about_one_point():
    parameters = load("two_steered")
    truck = settled(Truck.load(parameters=parameters, visuals=False), 1.5, 12.0, 4.0)
    rear = np.mean([axle.position for axle in parameters.driven_axles])
    centers = []
    for axle in parameters.lead.axles:
        if axle.steered:
            angles = knuckles(truck, axle.name)
            across = np.array([0.5, -0.5]) * axle.track
            centers += list((rear - axle.position) / np.tan(angles) + across)
    assert np.mean(centers) > 0.0
    np.testing.assert_allclose(centers, np.mean(centers), rtol=0.03)


def test_axles_share_their_groups_load_by_their_shares():
    parameters = load("unequal")
    for payload in (0.0, 36_000.0):
        steer, one, two, *trailer = static_axle_loads(parameters, payload)
        assert two == pytest.approx(0.5 * one)
        assert trailer[0] == pytest.approx(0.8 * trailer[1])
        assert trailer[1] == pytest.approx(trailer[2])
        assert steer + one + two + sum(trailer) == pytest.approx(
            parameters.gross_mass(payload) * GRAVITY
        )
        # Moments about the kingpin: the loads act at their axles.
        levers = [axle.position for axle in parameters.last.axles]
        on_coupling = coupling_loads(parameters, payload)[0]
        weight = on_coupling + sum(trailer)
        unit, load_mass = parameters.last, parameters.unit_payloads(payload)[1]
        cg = unit.mass * unit.cg_position + load_mass * unit.payload.cg_position
        assert np.dot(trailer, levers) == pytest.approx(cg * GRAVITY)
        assert weight == pytest.approx((unit.mass + load_mass) * GRAVITY)
