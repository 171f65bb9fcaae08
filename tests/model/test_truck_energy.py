"""The truck loses its energy to tires, air and dampers, and gains none."""

import mujoco
import numpy as np
import pytest

from iits_mj.core.units import GRAVITY
from iits_mj.parameters.mass_state import air_shares
from iits_mj.truck import Truck

NEUTRAL = 1.0


def load(payload, timestep=0.002):
    truck = Truck.load(payload, timestep=timestep, visuals=False)
    truck.model.opt.enableflags |= mujoco.mjtEnableBit.mjENBL_ENERGY
    truck.reset()
    return truck


class Energy:
    """Energy of motion, height, joint and tendon springs, and of the tires' compression."""

    def __init__(self, truck):
        self.data, tires = truck.data, truck.parameters.tires
        ends = [(axle, side) for axle in truck.parameters.axles for side in ("left", "right")]
        self.wheels = [truck.model.body(f"{axle.name}_{side}_wheel").id for axle, side in ends]
        self.radius = np.array([tires[axle.tire].free_radius for axle, _ in ends])
        self.stiffness = np.array(
            [tires[axle.tire].count * tires[axle.tire].vertical_stiffness for axle, _ in ends]
        )

    def __call__(self):
        deflection = np.maximum(0.0, self.radius - self.data.xpos[self.wheels, 2])
        return self.data.energy.sum() + 0.5 * np.sum(self.stiffness * deflection**2)


class Losses:
    """Power that road, air and dampers take from the truck [W]."""

    def __init__(self, truck):
        self.model, self.data, self.p = truck.model, truck.data, truck.parameters

    def velocity(self, body, *, local):
        out = np.zeros(6)
        kind = mujoco.mjtObj.mjOBJ_BODY
        index = self.model.body(body).id
        mujoco.mj_objectVelocity(self.model, self.data, kind, index, out, int(local))
        return out[3:]

    def air(self):
        figures, power = self.p.aerodynamics, 0.0
        for unit, part in zip(self.p.units, air_shares(self.p), strict=True):
            v = self.velocity(f"{unit.name}_pressure_center", local=True)
            area = figures.drag_area * v[0] ** 2 + figures.side_area * v[1] ** 2
            power += 0.5 * figures.density * part * area * np.linalg.norm(v)
        return power

    def tires(self):
        power = 0.0
        for axle in self.p.axles:
            tire = self.p.tires[axle.tire]
            for side in ("left", "right"):
                name = f"{axle.name}_{side}"
                fx, fy, load = self.data.sensor(f"{name}_tire_force").data
                slip, angle = self.data.sensor(f"{name}_tire_slip").data
                speed = np.linalg.norm(self.velocity(f"{name}_hub", local=False)[:2])
                rolling = tire.rolling_radius * abs(self.data.joint(f"{name}_spin").qvel[0])
                power += tire.rolling_resistance * load * rolling
                power += (fx * slip + fy * np.sin(angle)) * speed
        return power

    def __call__(self):
        dampers = float(self.model.dof_damping @ self.data.qvel**2)
        return self.air() + self.tires() + dampers


@pytest.mark.parametrize("steering", [0.0, 0.8], ids=["straight", "turning"])
@pytest.mark.parametrize("payload", [0.0, 36_000.0])
def test_unpowered_truck_loses_the_energy_that_road_and_air_take(payload, steering):
    truck = load(payload)
    truck.reset(speed=20.0)
    truck.command(transmission_mode=NEUTRAL, steering_wheel_angle=steering)
    truck.step(10)
    energy, losses = Energy(truck), Losses(truck)
    values, lost = [], 0.0
    for k in range(1000):
        truck.step(1)
        values.append(energy())
        lost += losses() * truck.model.opt.timestep if k else 0.0
    # Not counted: aligning moments, play of the couplings, the gearbox in neutral.
    assert values[0] - values[-1] == pytest.approx(lost, rel=0.02)
    assert np.diff(values).max() < 0.0


@pytest.mark.parametrize("timestep", [0.001, 0.005])
@pytest.mark.parametrize("payload", [0.0, 36_000.0])
def test_truck_dropped_from_20_cm_gains_no_energy_and_comes_to_rest(payload, timestep):
    truck = load(payload, timestep)
    energy, data = Energy(truck), truck.data
    truck.command(transmission_mode=NEUTRAL)
    data.qpos[2] += 0.2
    truck.step(1)
    start, values = energy(), []
    for _ in range(round(4.0 / timestep)):
        truck.step(1)
        values.append(energy())
    weight = truck.parameters.gross_mass(payload) * GRAVITY
    assert max(values) < start
    # `energy` leaves out the strain of the treads, which they release at times.
    assert np.maximum(np.diff(values), 0.0).sum() < 0.01 * 0.2 * weight
    truck.command(parking_brake=1.0)
    truck.step(round(8.0 / timestep))
    assert np.abs(data.qvel).max() < 1e-4
    loads = sum(
        data.sensor(f"{axle.name}_{side}_tire_force").data[2]
        for axle in truck.parameters.axles
        for side in ("left", "right")
    )
    assert loads == pytest.approx(weight, rel=1e-4)


@pytest.mark.parametrize("grade", [0.05, 0.08, 0.18])
@pytest.mark.parametrize("payload", [0.0, 36_000.0])
def test_parked_truck_does_not_creep_on_a_grade(payload, grade):
    truck = load(payload)
    slope = np.arctan(grade)
    truck.model.opt.gravity[:] = -GRAVITY * np.sin(slope), 0.0, -GRAVITY * np.cos(slope)
    truck.command(parking_brake=1.0)
    truck.step(7500)
    before = truck.data.qpos.copy()
    truck.step(2500)
    assert np.abs(truck.data.qpos - before).max() < 1e-5
    assert np.abs(truck.data.qvel).max() < 1e-5
