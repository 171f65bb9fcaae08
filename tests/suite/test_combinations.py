"""`Physics` of a truck alone and of chains of units."""

import numpy as np
import pytest

from iits_mj.parameters import TruckParameters
from iits_mj.road import Route
from iits_mj.suite.physics import Physics, add_cameras
from iits_mj.truck import Truck
from tests.combinations import load


@pytest.fixture(params=["alone", "dolly", "b_double", "rigid_drawbar"])
def physics(request):
    truck = Truck.load(0.0, parameters=load(request.param), route=Route.straight(), visuals=False)
    made = Physics.from_truck(truck)
    made.place(200.0, 0.0, 5.0)
    return made


def test_rear_of_the_last_unit_is_the_rear_of_the_combination(physics):
    x, y, yaw = physics.trailer_rear()
    assert physics.ego().x - x == pytest.approx(physics.truck.parameters.rear, abs=1e-3)
    assert (y, yaw) == pytest.approx((physics.ego().y, 0.0), abs=1e-6)


def test_outline_reaches_half_the_width_of_the_widest_unit_to_both_sides(physics):
    widest = max(unit.width for unit in physics.truck.parameters.units)
    offsets = physics.outline_offsets() - physics.offset()
    assert np.abs(offsets).max() == pytest.approx(0.5 * widest, abs=1e-6)
    assert offsets.max() == pytest.approx(-offsets.min(), abs=1e-6)


def test_station_of_the_last_axle_group_is_behind_the_steer_axle(physics):
    p = physics.truck.parameters
    ahead = physics.station() - physics.trailer_station()
    origin = sum(coupling.position for coupling in p.couplings)
    group = [axle.position for axle in p.last.axles if not axle.steered]
    assert ahead == pytest.approx(origin + np.mean(group), abs=1e-3)


@pytest.mark.parametrize("name", ["a_double", "vecto_tractor"])
def test_chase_camera_is_as_far_behind_every_combination(name):
    behind = []
    for parameters in (TruckParameters.load(), TruckParameters.load(name)):
        truck = Truck.load(parameters=parameters, visuals=False, edit_spec=add_cameras)
        behind.append(-float(truck.model.camera("chase").pos[0]) - parameters.rear)
    assert behind[0] == pytest.approx(behind[1], abs=0.01)
