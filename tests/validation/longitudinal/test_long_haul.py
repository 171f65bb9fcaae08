"""VECTO's mission is driven as its driver would, and its energies add up."""

import dataclasses

import numpy as np
import pytest

from iits_mj.core.messages import EgoState
from iits_mj.core.units import KMH
from iits_mj.parameters import TruckParameters
from iits_mj.validation.longitudinal.long_haul import (
    DECLARED,
    TRUCK,
    Driver,
    Mission,
    accelerating,
    braking,
    compare,
    drive,
)

MISSION, VECTO = Mission.load(), TruckParameters.load(TRUCK)
STEP = 0.005
ENTRY = 60.0


def test_mission_is_108_km_long_with_five_stops_between_its_ends():
    assert MISSION.length == pytest.approx(108_191.0)
    assert [place for place, _ in MISSION.stops] == [0, 899, 2249, 105_941, 107_291, 108_191]
    assert MISSION.target.max() == pytest.approx(85.0 * KMH)
    assert np.abs(MISSION.grade).max() < 0.07


def test_road_has_the_grades_and_the_height_of_the_mission():
    route = MISSION.cut(8000.0).route()
    middle = MISSION.distance[:-1] + 0.5 * np.diff(MISSION.distance)
    chosen = (np.diff(MISSION.distance) >= 10.0) & (middle < 7900.0)
    place = middle[chosen] + ENTRY
    height = np.asarray(route.evaluate(place + 0.5, 0.0).z) - route.evaluate(place - 0.5, 0.0).z
    np.testing.assert_allclose(height, MISSION.grade[:-1][chosen], atol=1e-3)


def test_driver_accelerates_and_brakes_as_declared():
    assert [accelerating(kmh * KMH) for kmh in (0.0, 25.0, 60.0, 85.0)] == [1.0, 1.0, 0.5, 0.5]
    assert accelerating(42.5 * KMH) == pytest.approx(0.75)
    assert [braking(kmh * KMH) for kmh in (10.0, 50.0, 60.0, 85.0)] == [1.0, 1.0, 0.5, 0.5]


# Level, 60 and then 85 km/h, with a stop at each end.
LEVEL = Mission(
    np.array([0.0, 1.0, 3000.0, 9000.0]),
    np.array([60.0, 60.0, 85.0, 0.0]) * KMH,
    np.zeros(4),
    ((0.0, 2.0), (2000.0, 60.0), (9000.0, 2.0)),
)
DOWNHILL = dataclasses.replace(LEVEL, grade=np.full(4, -0.03), stops=((9000.0, 2.0),))
# The descent ends at 5 km.
VALLEY = Mission(
    np.array([0.0, 1.0, 3000.0, 5000.0, 9000.0]),
    np.array([60.0, 60.0, 85.0, 85.0, 0.0]) * KMH,
    np.array([0.0, 0.0, -0.03, 0.0, 0.0]),
    ((0.0, 2.0), (9000.0, 2.0)),
)


def command(mission, place, kmh):
    driver = Driver(mission, VECTO, 19_300.0)
    state = EgoState(station=place + ENTRY, speed=kmh * KMH, gear=12, engine_speed=125.0)
    return driver.command(state)


def test_driver_lets_the_truck_roll_5_kmh_over_a_high_target_and_then_brakes():
    rolling = command(DOWNHILL, 5000.0, 88.0)
    assert rolling.accelerator_pedal == 0.0
    assert rolling.xbr_demand == 0.0
    assert command(DOWNHILL, 5000.0, 90.5).xbr_demand < 0.0


def test_driver_brakes_down_to_the_target_before_a_descent_ends():
    assert command(VALLEY, 4900.0, 88.0).xbr_demand == 0.0
    assert command(VALLEY, 4990.0, 88.0).xbr_demand < -0.3
    assert command(VALLEY, 5100.0, 88.0).xbr_demand < -0.3


def test_driver_coasts_ahead_of_a_stop_and_brakes_close_to_it():
    far, near, close = (command(LEVEL, place, 60.0) for place in (1200.0, 1750.0, 1900.0))
    assert far.accelerator_pedal > 0.0
    assert near.accelerator_pedal == near.xbr_demand == 0.0
    assert close.xbr_demand < -0.3


def test_first_kilometers_include_two_stops_and_the_energies_add_up():
    driven = drive(VECTO, MISSION.cut(3000.0), 19_300.0, STEP)
    time, place, speed = driven.record[:, :3].T
    for stop in (899.0, 2249.0):
        standing = np.abs(place - stop) < 2.0
        assert time[standing & (speed < 0.05)].size * 0.05 >= 59.0
    height = driven.record[-1, 4] - driven.record[0, 4]
    raised = 33_900.0 * 9.81 * height / 3.6e6
    # Slip of tires and clutch and the empty retarder take the rest.
    used = sum(driven.energies) + raised
    assert used == pytest.approx(driven.engine, rel=0.05)
    assert used < driven.engine


def test_quick_form_drives_the_first_12_km():
    assert compare(STEP, quick=True).checks[0].ok


@pytest.mark.slow
def test_fuel_is_within_3_percent_of_the_declared_at_the_reference_load():
    declared = DECLARED["reference"]
    driven = drive(VECTO, MISSION, declared.payload, STEP)
    assert driven.liters_per_100_km == pytest.approx(declared.fuel, rel=0.03)
    assert driven.time == pytest.approx(declared.time, rel=0.01)
    assert driven.energies == pytest.approx(declared.energies, rel=0.05)
