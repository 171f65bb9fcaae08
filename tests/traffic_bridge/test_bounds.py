"""Bounds of vehicle parameters, and contents of vehicle frames."""

import dataclasses
import math

import numpy as np
import pytest

from iits_mj.core.errors import InputError
from iits_mj.core.messages import TrackedVehicle
from iits_mj.core.vehicles import VehicleFrame
from iits_mj.road import Route
from traffic_bridge import PureSim, TrafficConfig, calibrated_types, default_types
from traffic_bridge.vehicles.types import FASTEST, HIGHEST

CAR = default_types()[0]


@pytest.mark.parametrize("name", HIGHEST)
def test_a_vehicle_parameter_above_its_physical_bound_is_refused(name):
    top = HIGHEST[name]
    assert getattr(dataclasses.replace(CAR, **{name: top}), name) == top
    for wrong in (1.01 * top, 1e9, 10**400, math.nan, -0.1, "1", None, True, np.float64(1e9)):
        with pytest.raises(InputError, match=rf"car\.{name} = .*: (allowed is 0 to|must be)"):
            dataclasses.replace(CAR, **{name: wrong})


def test_vehicles_of_the_package_stay_below_90_percent_of_the_bounds():
    for kind in (*default_types(), *calibrated_types()):
        for name, top in HIGHEST.items():
            assert getattr(kind, name) <= 0.9 * top


def test_numbers_of_numpy_become_pythons_own():
    car = dataclasses.replace(CAR, length=np.float32(4.5), colors=[[np.float32(1), 0, 0]])
    assert type(car.length) is float
    assert car.colors == ((1.0, 0.0, 0.0),)


def test_a_change_beyond_the_bounds_or_of_an_unknown_vehicle_is_refused():
    with PureSim(Route.straight(length=1000.0), TrafficConfig(density=0.1), seed=1) as traffic:
        name = traffic.reset()[0].id
        for wrong in ("acceleration", "time_headway", "minimum_gap", "politeness"):
            with pytest.raises(InputError, match=rf"car\.{wrong} = 1000000000\.0: allowed is 0"):
                traffic.vehicles.change("car", **{wrong: 1e9})
        with pytest.raises(InputError, match=f"desired_speed = 80: allowed is 0 to {FASTEST:g}"):
            traffic.vehicles.change(name, desired_speed=80)
        for wrong in ([], None, {}):
            with pytest.raises(InputError, match="to change: must be the name of a vehicle"):
                traffic.vehicles.change(wrong, time_headway=2.0)
            with pytest.raises(InputError, match=r"no vehicle .* in the traffic"):
                traffic.vehicles.in_force(wrong)
        traffic.vehicles.change(name, desired_speed=np.float32(9), politeness=np.float32(0.5))
        found = traffic.vehicles.in_force(name)
        assert (found["desired_speed"], found["politeness"]) == (9.0, 0.5)
        traffic.step()


def test_a_frame_returns_columns_by_name_and_refuses_unknown_names():
    frame = VehicleFrame.of([TrackedVehicle("a", x=1.0), TrackedVehicle("b", x=2.0, y=3.0)])
    assert frame.columns("y", "x").tolist() == [[0.0, 3.0], [1.0, 2.0]]
    for wrong in ("q", [], None):
        with pytest.raises(InputError, match=r"column .*: allowed are x, y, z"):
            frame.columns("x", wrong)
        with pytest.raises(InputError, match=r"column .*: allowed are x, y, z"):
            frame.column(wrong)
    with pytest.raises(InputError, match="its id is a text"):
        frame.find(None)
    assert frame.select([1]) == [frame[1]]


@pytest.mark.parametrize(
    ("vehicles", "text"),
    [
        (5, "made of TrackedVehicles, not of 5"),
        ([1], "made of TrackedVehicles, 1 is none"),
        ([TrackedVehicle(3)], "vehicle 3: its id must be a text"),
        ([TrackedVehicle("a", kind=None)], "vehicle 'a': kind is None"),
        ([TrackedVehicle("a", lane=0.5)], "vehicle 'a': lane is 0.5: not a whole number"),
        ([TrackedVehicle("b"), TrackedVehicle("a", x="3")], "vehicle 'a': x is '3': not finite"),
        ([TrackedVehicle("a", yaw=[1.0])], r"vehicle 'a': yaw is \[1\.0\]"),
        ([TrackedVehicle("a", speed=None)], "speed is None"),
        ([TrackedVehicle("a", speed=10**400)], "speed is 1000"),
        ([TrackedVehicle("a", z=math.inf)], "z is inf"),
    ],
)
def test_a_frame_with_unusable_vehicles_is_refused(vehicles, text):
    with pytest.raises(InputError, match=text):
        VehicleFrame.of(vehicles)
