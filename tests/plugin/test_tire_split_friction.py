"""The whole truck with its left wheels on ice and its right wheels on dry asphalt."""

import numpy as np
import pytest

from iits_mj.parameters.tire_law import friction
from iits_mj.road import Route
from iits_mj.truck import Truck

ICE, DRY, REFERENCE = 0.3, 0.8, 0.8


@pytest.fixture(scope="module")
def braking():
    """Forces (steps, axles, sides, 3) of hard braking from 20 m/s, and the truck."""
    route = Route.straight().with_friction(ICE, DRY)
    truck = Truck.load(route=route, visuals=False)
    truck.reset(station=60.0, speed=20.0)
    truck.command(xbr_demand=-8.0, xbr_mode=2.0)
    forces = []
    for _ in range(170):  # without steering a wheel later leaves its half of the road
        truck.step(5)
        forces.append(
            [
                [
                    truck.data.sensor(f"{axle.name}_{side}_tire_force").data.copy()
                    for side in ("left", "right")
                ]
                for axle in truck.parameters.axles
            ]
        )
    return truck, np.array(forces)


def used(truck, forces, side, surface):
    """Returns the share of friction that the tires of a side use, shape (steps, axles)."""
    common, shares = truck.parameters.tire_common, []
    for i, axle in enumerate(truck.parameters.axles):
        fx, fy, load = forces[:, i, side].T
        per_tire = np.maximum(load, 1.0) / truck.parameters.tires[axle.tire].count
        x = friction(per_tire, common.friction_longitudinal, common) * surface / REFERENCE
        y = friction(per_tire, common.friction_lateral, common) * surface / REFERENCE
        shares.append(np.hypot(fx / x, fy / y) / np.maximum(load, 1.0))
    return np.array(shares).T


def test_no_tire_exceeds_the_friction_of_its_surface(braking):
    truck, forces = braking
    for side, surface in ((0, ICE), (1, DRY)):
        assert used(truck, forces, side, surface).max() < 1.02


def test_wheels_on_ice_use_all_friction_and_wheels_on_asphalt_brake_harder(braking):
    truck, forces = braking
    late = forces[110:]
    assert np.median(used(truck, late, 0, ICE).max(axis=0)) > 0.9
    # ABS controls trailer wheels individually, and both wheels of a drive axle together.
    left, right = (-late[:, 3:, side, 0].sum(axis=1).mean() for side in (0, 1))
    assert right > 1.8 * left > 0.0


def test_truck_is_pulled_towards_the_asphalt(braking):
    truck, _ = braking
    ego = truck.observe()
    assert ego.yaw < -0.002 or ego.offset < -0.02
