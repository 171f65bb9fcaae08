"""Different trucks in one roll-out and in one fleet."""

import numpy as np
import pytest

from iits_mj.core.errors import InputError
from iits_mj.parameters import TruckParameters, shipped_trucks
from iits_mj.road import Route
from iits_mj.truck import Truck
from iits_mj.truck.fleet import TruckFleet
from iits_mj.truck.placement import TruckPlacement
from iits_mj.truck.rollouts import Scenario, roll_out

DEFAULT = shipped_trucks()[0]
ROAD = Route.straight(length=1_000.0)
ALONE = {"remove": ["units.trailer"]}


def test_scenarios_of_different_trucks_drive_as_each_does_alone():
    place = TruckPlacement(station=50.0, speed=15.0)
    scenarios = [
        Scenario(route=ROAD, place=place),
        Scenario(route=ROAD, place=place, truck=DEFAULT, parameters=ALONE),
    ]
    drives = roll_out(scenarios, {"accelerator_pedal": 0.5}, duration=0.4)
    # A tractor alone has no trailer, so that the default signals leave its sensors out.
    assert "trailer_gyro" not in drives.values
    truck = Truck.load(parameters=ALONE, route=ROAD, visuals=False)
    truck.reset(station=50.0, speed=15.0)
    truck.command(accelerator_pedal=0.5)
    truck.step(200)
    truck.observe()
    velocity = truck.sensor("tractor_velocity")
    np.testing.assert_array_equal(drives["tractor_velocity"][1, -1], velocity)


@pytest.mark.parametrize(
    ("settings", "signals", "message"),
    [
        ({"truck": "nowhere"}, None, "shipped trucks"),
        ({"parameters": ALONE}, ("trailer_gyro",), "unknown on truck"),
        ({"parameters": ALONE}, ("wheel_speeds",), "roll them out apart"),
    ],
)
def test_scenarios_that_do_not_fit_are_refused(settings, signals, message):
    scenarios = [Scenario(route=ROAD), Scenario(route=ROAD, **settings)]
    with pytest.raises(InputError, match=message):
        roll_out(scenarios, {}, duration=0.1, signals=signals)


def test_a_fleet_of_different_trucks_has_the_mass_and_length_of_each():
    alone = TruckParameters.load(overlay=ALONE)
    fleet = TruckFleet.load([None, 0.0], route=ROAD, truck=[DEFAULT, alone], visuals=False)
    full = TruckParameters.load()
    masses = [state.mass for state in fleet.observe()]
    assert masses == [full.gross_mass(), alone.gross_mass()]
    assert [truck.footprint.length for truck in fleet.trucks] == [full.length, alone.length]


@pytest.mark.parametrize("truck", ["nowhere", [DEFAULT], [DEFAULT, "nowhere"]])
def test_a_fleet_of_unusable_trucks_is_refused(truck):
    with pytest.raises(InputError, match=r"shipped trucks|1 trucks for 2 places"):
        TruckFleet.load([0.0, 0.0], route=ROAD, truck=truck, visuals=False)
