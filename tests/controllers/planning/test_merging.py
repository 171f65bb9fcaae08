"""Lanes that end: the truck merges into gaps and stops only if none opens."""

import dataclasses

import numpy as np
import pytest

from tests.controllers.scenes import Ideal, RightLaneEnds, car, moved

END = 800.0


@pytest.fixture
def road():
    return RightLaneEnds(end=END, length=3000.0)


def stream(road, speed, spacing, first, count=60, hole=None):
    """Cars on the left lane, `spacing` apart, one place left out."""
    return tuple(
        car(road, f"c{i}", first + spacing * i, 1, speed) for i in range(count) if i != hole
    )


def following(cars):
    """The cars over time, each at constant speed."""
    return lambda time: tuple(moved(vehicle, time) for vehicle in cars)


def clearance(drive, vehicles):
    """Least bumper gap to a car in the truck's lane over a drive [m]."""
    least = np.inf
    for state in drive.states:
        for vehicle in vehicles(state.time):
            if abs(vehicle.offset - state.offset) < 2.2:
                ahead = vehicle.station - 2.4 - (state.station + 1.4)
                behind = state.station + 1.4 - 16.5 - (vehicle.station + 2.4)
                least = min(least, max(ahead, behind))
    return least


@pytest.mark.parametrize(("speed", "hole"), [(12.0, -60.0), (15.0, -60.0), (15.0, 20.0)])
def test_the_truck_takes_a_hole_in_the_stream_without_a_stop(road, speed, hole):
    vehicles = following(stream(road, speed, 32.0, first=400.0 + hole - 25 * 32.0, hole=25))
    drive = Ideal(road, 400.0, 0, 15.0).run(38.0, vehicles)
    assert drive.planner.lane_changes == 1
    assert drive.ego.station > END
    assert min(state.speed for state in drive.states) > 5.0
    assert min(plan.acceleration[0] for plan in drive.plans) > -2.5
    assert drive.planner.emergencies == 0
    assert clearance(drive, vehicles) > 10.0


def test_the_truck_lets_a_short_platoon_by_and_follows_it(road):
    platoon = tuple(car(road, f"c{i}", 385.0 + 20.0 * i, 1, 15.0) for i in range(4))
    vehicles = following(platoon)
    drive = Ideal(road, 400.0, 0, 15.0).run(40.0, vehicles)
    assert drive.planner.lane_changes == 1
    assert min(state.speed for state in drive.states) > 8.0
    assert "aiming for the gap" in " ".join(plan.reason for plan in drive.plans)
    assert clearance(drive, vehicles) > 3.0


@pytest.mark.slow
def test_a_stream_without_a_gap_stops_the_truck_with_room_and_it_goes_on_afterwards(road):
    cars = stream(road, 12.0, 16.0, first=40.0, count=45)
    drive = Ideal(road, 560.0, 0, 10.0).run(90.0, following(cars))
    room = drive.planner.config.merge.room
    stood = [state for state in drive.states if state.speed < 0.05]
    assert stood
    assert END - room - 5.0 < max(s.station for s in stood) + 1.4 < END - room + 0.5
    assert drive.planner.lane_changes == 1
    assert drive.ego.station > END + 50.0
    crossed = next(s.station for s in drive.states if s.offset > road.lane_offset(0, 0.0) + 2.0)
    assert crossed < END


def test_a_fast_car_from_behind_makes_a_merging_truck_stay_while_there_is_room():
    road = RightLaneEnds(end=900.0, length=3000.0)

    def vehicles(time):
        if time < 1.3:
            return ()
        racer = car(road, "racer", 640.0 - 30.0 + 24.0 * (time - 1.3), 1, 24.0)
        return (dataclasses.replace(racer, station=racer.station),)

    drive = Ideal(road, 601.0, 0, 15.0).run(40.0, vehicles)
    assert drive.planner.lane_changes == 1
    assert drive.ego.station > 900.0
