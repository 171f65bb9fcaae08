"""Tight bends in which the trailer leaves its lane: vehicles that the truck waits for."""

import math

import numpy as np
import pytest

from controllers.planning.planner import Planner
from controllers.planning.predicted_boxes import Poses
from controllers.planning.tight_bend_yield import TightBends
from iits_mj.core.messages import (
    EgoState,
    LightState,
    RoadSignals,
    Scene,
    TrackedVehicle,
    TrafficLight,
)
from iits_mj.parameters import TruckParameters
from tests.controllers.planning.test_crossing import bend
from tests.controllers.scenes import advanced

ROAD = bend()
FREE = 235.0


def oncoming(name, station, speed, **fields):
    """A car in the opposite lane, 3.5 m beside the truck's."""
    offset = float(ROAD.lane_offset(0, station)) + 3.5
    place = ROAD.evaluate(station, offset)
    return TrackedVehicle(
        id=name,
        x=float(place.x),
        y=float(place.y),
        z=float(place.z),
        yaw=float(place.heading) + math.pi,
        speed=speed,
        station=station,
        offset=offset,
        lane=-1,
        **fields,
    )


def drive(vehicles, duration, station=190.0, speed=3.0, signals=None):
    """Planner, states and plans of a truck that follows its plans exactly."""
    planner, states, plans = Planner(ROAD), [], []
    offset = float(ROAD.lane_offset(0, station))
    ego = EgoState(station=station, offset=offset, speed=speed, mass=19e3)
    for _ in range(round(10 * duration)):
        time = ego.time
        signs = signals(time) if signals else RoadSignals()
        plan = planner.plan(Scene(time, ego, vehicles(time), signals=signs))
        states.append(ego)
        plans.append(plan)
        ego = advanced(ego, plan)
    return planner, states, plans


def test_the_truck_turns_before_a_stream_that_can_stop_gently():
    def stream(time):
        # One vehicle after the other, each far enough away to stop.
        return (oncoming(f"c{int(time)}", 290.0 - 6.0 * (time % 1.0), 6.0),)

    _, states, plans = drive(stream, 35.0)
    stood = [state for state in states if state.speed < 0.05]
    assert len(stood) > 5
    assert max(state.station for state in stood) < 202.0
    assert any("which approaches" in plan.reason for plan in plans)
    assert states[-1].station > FREE


def test_a_truck_that_has_waited_long_makes_no_vehicle_brake_hard():
    def stream(time):
        return (oncoming(f"c{int(time)}", 275.0 - 14.0 * (time % 1.0), 14.0),)

    _, states, plans = drive(stream, 40.0)
    assert states[-1].speed < 0.05
    assert states[-1].station < 202.0
    assert "which approaches" in plans[-1].reason


def test_time_at_a_red_light_does_not_count_as_waiting_for_others():
    def light(time):
        state = LightState.RED if time < 20.0 else LightState.GREEN
        return RoadSignals(light=TrafficLight(station=199.0, state=state))

    def stream(time):
        return (oncoming(f"c{int(time)}", 290.0 - 6.0 * (time % 1.0), 6.0),)

    _, _, plans = drive(stream, 21.0, signals=light)
    assert "which approaches" in plans[-1].reason


def test_the_truck_waits_for_a_vehicle_stopped_on_the_trailers_ground():
    _, states, plans = drive(lambda time: (oncoming("van", 222.0, 0.0),), 60.0)
    assert states[-1].station < 202.0
    assert "van, which has stopped in the way" in plans[-1].reason


@pytest.mark.parametrize("place", [216.0, 219.0, 222.0])
def test_in_the_bend_the_truck_stops_before_its_trailer_touches_a_vehicle(place):
    def vehicles(time):
        # It appears when the truck is in the bend.
        return (oncoming("late", place, 0.0),) if time > 5.0 else ()

    planner, states, plans = drive(vehicles, 40.0, station=197.0)
    assert 205.0 < states[-1].station < FREE
    assert states[-1].speed < 0.05
    assert "late is in the trailer" in plans[-1].reason
    last = states[-1]
    path = planner.preview.follow(planner.lane(Scene(0.0, last)), last.station, 400.0, 150.0)
    sweep = TightBends(planner.preview, TruckParameters.load()).ahead(path, last)
    around = Scene(0.0, EgoState(), [oncoming("late", place, 0.0)]).neighbors
    there = Poses.of(around, np.array([True]), planner.preview).ahead(np.zeros(1))
    row = round(states[-1].station - sweep.first)
    near = np.any([unit.touch(there, 0.1)[:, 0] for unit in sweep.units], axis=0)
    # The trailer would be too near further on, but is not here.
    assert near[row:].any()
    assert not near[row]
