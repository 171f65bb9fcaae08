"""Air forces on the truck."""

import mujoco
import numpy as np
import pytest

from iits_mj.truck import Truck


@pytest.fixture(scope="module")
def truck():
    return Truck.load(visuals=False)


def air_force(truck, speed, wind=(0.0, 0.0, 0.0)):
    """Returns the air force on the free joint: the force with air less the force without."""
    forces = []
    calm = Truck.load(parameters={"aerodynamics": {"density": 0.0}}, visuals=False)
    for each in (truck, calm):
        each.reset(speed=speed)
        each.model.opt.wind[:] = wind
        mujoco.mj_forward(each.model, each.data)
        forces.append(each.data.qfrc_passive[:3].copy())
    truck.model.opt.wind[:] = 0
    return forces[0] - forces[1]


def test_drag_is_half_rho_cda_v_squared(truck):
    air = truck.parameters.aerodynamics
    drag = 0.5 * air.density * air.drag_area * 20.0**2
    # The hitch's play in pitch tilts the trailer by less than a milliradian at reset.
    np.testing.assert_allclose(air_force(truck, 20.0), [-drag, 0, 0], atol=1e-3 * drag)


def test_head_wind_adds_to_the_speed(truck):
    np.testing.assert_allclose(
        air_force(truck, 15.0, wind=(-5.0, 0, 0)), air_force(truck, 20.0), atol=1e-6
    )


def test_side_wind_pushes_the_truck_downwind(truck):
    force = air_force(truck, 20.0, wind=(0.0, 10.0, 0.0))
    air = truck.parameters.aerodynamics
    expected = 0.5 * air.density * air.side_area * np.hypot(20, 10) * 10
    assert force[1] == pytest.approx(expected, rel=1e-6)
