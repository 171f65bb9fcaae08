"""Tracking at its edges: ends of the path, yaw that wraps, brakes that are not there, tires."""

import dataclasses
import math

import numpy as np
import pytest

from controllers.planning.predicted_boxes import unit_lengths
from controllers.tracking.lateral import LateralController
from controllers.tracking.lateral_gains import LateralConfig
from controllers.tracking.lateral_model import LateralModel
from controllers.tracking.longitudinal import LongitudinalController, Phase
from iits_mj.core.messages import EgoState
from iits_mj.core.timing import CONTROL_PERIOD
from iits_mj.parameters import TruckParameters, shipped_trucks
from iits_mj.parameters.mass_state import static_axle_loads
from iits_mj.parameters.tire_law import cornering_stiffness
from iits_mj.parameters.units import SelfSteering
from tests.controllers.tracking.reference import (
    EnduranceForces,
    PathView,
    Powertrain,
    Steering,
    gains_at,
    share_out,
)
from tests.controllers.tracking.speed_reference import KickDown
from tests.controllers.tracking.test_lateral import arc
from tests.controllers.tracking.test_longitudinal import LADEN, plan

PARAMETERS = TruckParameters.load()


def test_before_its_start_and_beyond_its_end_a_bend_is_its_tangent():
    view = PathView(arc())
    assert view.error(EgoState(station=-5.0, x=-5.0))[1] == 0.0
    last = float(arc().yaw[-1])
    assert view.error(EgoState(station=70.0, yaw=last))[1] == pytest.approx(0.0, abs=1e-12)


def test_a_yaw_that_wraps_from_plus_to_minus_pi_is_made_continuous():
    path = arc()
    yaw = np.full(len(path.yaw), 3.1)
    yaw[7:] = -3.1
    view = PathView(dataclasses.replace(path, yaw=yaw))
    assert view.yaw[-1] == pytest.approx(2.0 * math.pi - 3.1)
    assert np.abs(view.curvature(np.array([0.0, 10.0, 20.0, 30.0]))).max() < 0.05
    # A path of two points, too.
    names = ("time", "station", "offset", "x", "y", "z", "curvature", "speed", "acceleration")
    short = {name: getattr(path, name)[:2] for name in names}
    view = PathView(dataclasses.replace(path, yaw=np.array([3.1, -3.1]), **short))
    assert view.yaw[-1] == pytest.approx(2.0 * math.pi - 3.1)


def test_the_steady_angle_uses_the_curvature_over_twice_the_lag():
    config = LateralConfig(speed_grid=(10.0, 20.0))
    assert Steering(PARAMETERS, config).near * CONTROL_PERIOD == pytest.approx(2.0 * config.lag)
    assert Steering(PARAMETERS, dataclasses.replace(config, lag=1e-3)).near == 1


def test_a_brake_that_is_not_there_gets_no_request():
    shared = share_out(9e3, EnduranceForces(1e3, 0.0, 4e3))
    assert (shared.engine_brake, shared.retarder, shared.short) == (0.0, 1.0, 4e3)
    weak = share_out(9e3, EnduranceForces(1e3, 0.5, 0.25))
    assert (weak.engine_brake, weak.retarder, weak.short) == (1.0, 1.0, 8e3 - 0.75)


def test_a_pedal_filter_faster_than_the_control_follows_at_once():
    shifting = dataclasses.replace(PARAMETERS.gearbox.shifting, pedal_lag=1e-3)
    gearbox = dataclasses.replace(PARAMETERS.gearbox, shifting=shifting)
    kick_down = KickDown(dataclasses.replace(PARAMETERS, gearbox=gearbox))
    kick_down.follow(0.5)
    assert kick_down._slow_pedal == 0.5


def test_at_standstill_the_endurance_brakes_are_released():
    controller = LongitudinalController(PARAMETERS)
    controller.memory.engine_brake = controller.memory.retarder = 0.5
    command = controller.command(dataclasses.replace(LADEN, speed=0.0), plan(0.0), 0.05)
    assert (command.engine_brake, command.retarder) == (0.0, 0.0)


@pytest.mark.parametrize("load", [0.0, 20_000.0])
def test_an_axle_has_the_cornering_stiffness_of_all_its_tires(load):
    model = LateralModel.of(PARAMETERS, PARAMETERS.gross_mass(load), 0.1)
    found = list(zip(model.plane.position, model.plane.cornering, model.plane.steer, strict=True))
    loads = static_axle_loads(PARAMETERS, load)
    for axle, on_axle, (position, stiffness, steer) in zip(
        PARAMETERS.axles, loads, found, strict=True
    ):
        tire = PARAMETERS.tires[axle.tire]
        count = 2 * tire.count
        each = cornering_stiffness(float(on_axle) / count, tire, PARAMETERS.tire_common)
        assert stiffness == pytest.approx(count * float(each))
        assert position == axle.position
        assert steer == float(axle.steered)


def test_the_preview_begins_at_the_truck_and_covers_its_time():
    config = LateralConfig(speed_grid=(10.0, 20.0))
    controller = LateralController(PARAMETERS, config)
    path = arc(1e9, 1.0, 60.0, 10.0)
    yaw = 1e-4 * path.station**2 + 1e-6 * path.station**3
    ego = EgoState(station=5.0, x=5.0, yaw=0.0, speed=10.0, mass=55_000.0)
    view = PathView(dataclasses.replace(path, yaw=yaw))
    error, heading = view.error(ego)
    controller.steer(ego, view.trajectory)
    gains = gains_at(controller.gains(55_000.0), 10.0)
    steps = round(config.preview_time / CONTROL_PERIOD)
    ends = 5.0 + 10.0 * CONTROL_PERIOD * np.arange(steps + 1)
    curvature = np.diff(np.interp(ends, path.station, yaw)) / np.diff(ends)
    state = np.array([0.0, 0.0, 0.0, 0.0, error, heading, 0.0, 0.0, 0.0])
    rate = -float(gains.feedback @ state) - float(gains.preview @ curvature)
    assert controller.memory.demand == pytest.approx(rate * CONTROL_PERIOD)


@pytest.mark.parametrize("speed", [3.0, 20.0])
def test_the_models_matrices_are_those_of_virtual_work(speed):
    """Newton's law for (w, r, r_t): each mass and axle acts by its own lateral velocity."""
    model = LateralModel.of(PARAMETERS, 45_000.0, 0.1)
    plane = model.plane
    (m1, m2), (c,), (cg, trailer_cg) = plane.mass, plane.couplings, plane.cg
    tractor, trailer = np.array([1.0, -cg, 0.0]), np.array([1.0, -c, -trailer_cg])
    inertia = m1 * np.outer(tractor, tractor) + m2 * np.outer(trailer, trailer)
    inertia += np.diag([0.0, *plane.inertia])
    rates, articulation, steer = np.zeros((3, 3)), np.zeros(3), np.zeros(3)
    axles = list(zip(plane.unit, plane.position, plane.cornering, strict=True))
    for place, stiffness in (axle[1:] for axle in axles if axle[0] == 0):
        velocity = np.array([1.0, -place, 0.0])
        rates -= stiffness / speed * np.outer(velocity, velocity)
        steer += stiffness * velocity * (place == 0.0)
    for place, stiffness in (axle[1:] for axle in axles if axle[0] == 1):
        velocity = np.array([1.0, -c, -place])
        rates -= stiffness / speed * np.outer(velocity, velocity)
        articulation -= stiffness * velocity
    rates[:, 1] -= speed * (m1 * tractor + m2 * trailer)
    a, b, e = model.matrices(speed)
    assert inertia @ a[:3, :3] == pytest.approx(rates, rel=1e-9, abs=1e-3)
    assert inertia @ a[:3, 3] == pytest.approx(articulation)
    assert inertia @ a[:3, 6] == pytest.approx(steer, abs=1e-3)
    # Articulation, offset, heading error, actuator and integral.
    assert a[3] == pytest.approx([0, 1, -1, 0, 0, 0, 0, 0, 0])
    assert a[4] == pytest.approx([1, 0, 0, 0, 0, speed, 0, 0, 0])
    assert a[5] == pytest.approx([0, 1, 0, 0, 0, 0, 0, 0, 0])
    assert a[6] == pytest.approx([0, 0, 0, 0, 0, 0, -10, 10, 0])
    assert a[8] == pytest.approx([0, 0, 0, 0, 1, 0, 0, 0, 0])
    assert b[:, 0] == pytest.approx([0, 0, 0, 0, 0, 0, 0, 1, 0])
    assert e[:, 0] == pytest.approx([0, 0, 0, 0, 0, -speed, 0, 0, 0])


def test_the_gear_is_kept_while_none_is_engaged():
    controller = LongitudinalController(PARAMETERS)
    for gear, kept in ((1, 1), (9, 9), (0, 9), (-1, 9), (1, 1)):
        controller.command(dataclasses.replace(LADEN, gear=gear), plan(16.67), 0.0)
        assert controller.memory.gear == kept


@pytest.mark.parametrize(("gear", "phase"), [(1, Phase.OVERRUN), (0, Phase.DRIVE)])
def test_the_engine_brakes_in_first_gear_and_not_in_neutral(gear, phase):
    controller = LongitudinalController(PARAMETERS)
    ego = EgoState(mass=19_000.0, speed=2.0, gear=gear, engine_speed=150.0)
    for _ in range(50):
        controller.command(ego, plan(2.0), -0.12)
    assert controller.phase is phase


@pytest.mark.parametrize(("engine_speed", "assumed"), [(60.0, 70.0), (95.0, 95.0)])
def test_a_start_uses_the_engine_speed_above_idle(engine_speed, assumed):
    controller = LongitudinalController(PARAMETERS)
    ego = dataclasses.replace(LADEN, speed=0.0, gear=2, engine_speed=engine_speed)
    for _ in range(100):
        last = controller.command(ego, plan(0.5, 0.5), 0.0)
    inverse = Powertrain(PARAMETERS)
    force = 0.35 * ego.mass + inverse.resistance(ego.mass, 0.1, 0.0)
    expected = inverse.pedal(inverse.engine_torque(force, 2), assumed)
    assert expected > 0.12
    assert last.accelerator_pedal == pytest.approx(expected)


@pytest.mark.parametrize("name", shipped_trucks())
def test_a_slow_truck_steers_like_a_bicycle_with_the_wheelbase_of_its_axle_group(name):
    truck = TruckParameters.load(name)
    model = LateralModel.of(truck, truck.gross_mass(truck.payload_max), 0.1)
    base = unit_lengths(truck)[0]
    # Axles of a group scrub: the tractor's lengthen its wheelbase, a trailer's push it aside.
    assert 0.75 < model.steady_acceleration(0.5) * base / 0.5**2 < 1.06


def test_a_self_steering_axle_yields_to_side_forces():
    truck = TruckParameters.load()
    steering = SelfSteering(trail=0.15, stiffness=20e3, damping=1e3, angle_max=0.3)
    *fixed, last = truck.units[1].axles
    trailer = dataclasses.replace(
        truck.units[1], axles=(*fixed, dataclasses.replace(last, self_steering=steering))
    )
    changed = dataclasses.replace(truck, units=(truck.lead, trailer))
    before, after = (LateralModel.of(p, 55e3, 0.1).plane.cornering[-1] for p in (truck, changed))
    lever = 0.15 + truck.tires[last.tire].pneumatic_trail
    # Both wheels' slip and knuckle angle share the slip of the axle: in series.
    assert 1.0 / after == pytest.approx(1.0 / before + 0.5 * lever / 20e3)


def test_a_lifted_axle_has_no_part_in_the_model():
    truck = TruckParameters.load("tractor_semitrailer_6x2")
    empty, laden = (
        LateralModel.of(truck, truck.gross_mass(load), 0.1).plane for load in (0.0, 20e3)
    )
    assert len(empty.position) == len(laden.position) - 1
