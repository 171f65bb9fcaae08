import numpy as np
import pytest

from iits_mj.core.errors import InputError
from iits_mj.road import Route
from iits_mj.truck import Truck
from iits_mj.truck.fleet import TRUCKS_MAX, TruckFleet, prefix
from iits_mj.truck.placement import TruckPlacement

ROUTE = Route.straight(length=2_000.0, lanes=2)


@pytest.fixture(scope="module")
def pair():
    return TruckFleet.load([0.0, 36_000.0], route=ROUTE, visuals=False)


def test_a_truck_of_a_fleet_drives_as_it_does_alone_bit_for_bit(pair):
    pair.reset(
        [TruckPlacement(station=200.0, speed=10.0), TruckPlacement(station=100.0, speed=12.0)]
    )
    alone = Truck.load(0.0, route=ROUTE, visuals=False)
    alone.reset(station=200.0, speed=10.0)
    for truck in (pair.trucks[0], alone):
        truck.command(accelerator_pedal=0.6, steering_wheel_angle=0.1)
    pair.step(1_000)
    alone.step(1_000)
    assert pair.observe()[0] == alone.observe()
    assert pair.trucks[0].report() == alone.report()


def test_each_truck_has_its_own_commands_and_load(pair):
    pair.reset(
        [TruckPlacement(station=200.0, speed=10.0), TruckPlacement(station=100.0, speed=10.0)]
    )
    pair.trucks[0].command(accelerator_pedal=0.0, xbr_demand=-3.0, xbr_mode=2)
    pair.trucks[1].command(accelerator_pedal=1.0)
    pair.step(2_500)
    first, second = pair.observe()
    assert first.speed < 6.0 < 10.0 < second.speed
    assert (first.mass, second.mass) == (19_000.0, 55_000.0)
    assert pair.trucks[0].last_command().xbr_demand == -3.0
    assert pair.trucks[1].last_command().xbr_demand == 0.0


def test_contact_is_reported_between_trucks_and_never_within_one(pair):
    length = pair.trucks[0].footprint.length
    pair.reset(
        [TruckPlacement(station=200.0), TruckPlacement(station=200.0 - length - 3.0, speed=8.0)]
    )
    assert not pair.touching()
    pair.trucks[0].command(parking_brake=1.0)
    for _ in range(100):
        pair.step(10)
        if pair.touching():
            break
    assert pair.touching() == {(0, 1)}
    before = pair.observe()[0].station
    pair.step(500)
    # The braked truck was pushed.
    assert pair.observe()[0].station > before + 0.05


def test_names_have_the_trucks_prefix(pair):
    assert prefix(1) == "truck1/"
    assert pair.model.body("truck1/tractor").id != pair.model.body("truck0/tractor").id
    assert pair.trucks[1].sensor("tractor_velocity").shape == (3,)


def test_reset_puts_every_truck_at_its_place(pair):
    states = pair.reset(
        [TruckPlacement(station=300.0, speed=5.0), TruckPlacement(station=250.0, offset=4.0)]
    )
    np.testing.assert_allclose([s.station for s in states], [300.0, 250.0], atol=0.02)
    np.testing.assert_allclose([s.offset for s in states], [0.0, 4.0], atol=1e-3)
    assert pair.time == 0.0


def test_wrong_numbers_are_refused(pair):
    with pytest.raises(InputError, match="3 places for 2 trucks"):
        pair.reset([TruckPlacement()] * 3)
    with pytest.raises(InputError, match="number of trucks = 0: allowed is 1 to"):
        TruckFleet.load([], route=ROUTE)
    with pytest.raises(InputError, match=f"trucks = {TRUCKS_MAX + 1}: "):
        TruckFleet.load([0.0] * (TRUCKS_MAX + 1), route=ROUTE)
    with pytest.raises(InputError, match="payload"):
        TruckFleet.load([0.0, -1.0], route=ROUTE)
    with pytest.raises(InputError, match="speed"):
        TruckPlacement(speed=-1.0)
    with pytest.raises(InputError, match="heading"):
        TruckPlacement(heading=float("nan"))


def test_a_truck_can_start_at_an_angle_to_the_road_and_articulated():
    truck = Truck.load(0.0, route=ROUTE, visuals=False)
    ego = truck.reset(station=500.0, offset=1.0, heading=0.2, articulation=-0.3)
    assert ego.yaw == pytest.approx(0.2, abs=1e-6)
    assert ego.articulation == pytest.approx(-0.3, abs=1e-6)
    truck.step(500)
    settled = truck.observe()
    assert settled.articulation == pytest.approx(-0.3, abs=0.01)
    assert abs(settled.roll) < 0.01
