"""A truck behind a broken-down vehicle passes it without contact."""

import dataclasses

import numpy as np
import pytest

from controllers.planning.planner import Planner
from controllers.planning.predicted_boxes import Poses, bodies_along
from iits_mj.core.messages import Decision, EgoState, LightState, RoadSignals, Scene, TrafficLight
from iits_mj.parameters import TruckParameters
from iits_mj.road import Route
from tests.controllers.scenes import Ideal, car

ROAD = Route.straight(length=3000.0, lanes=2, lane_width=3.75)
VAN = car(ROAD, "van", 600.0, 0, 0.0, length=6.0, width=2.0)


def test_the_truck_stops_with_room_and_passes_when_the_left_lane_is_free():
    # Without a decision: a decision maker sees no gain while there is room ahead.
    run = Ideal(ROAD, 400.0, 0, 14.0).run(100.0, (VAN,))
    stood = [state.station + 1.4 for state in run.states if state.speed < 0.05]
    assert len(stood) > 30
    assert 14.0 < VAN.station - 3.0 - stood[-1] < 18.0
    assert run.planner.lane_changes == 1
    assert run.ego.station > 620.0
    assert run.planner.emergencies == 0
    # Neither tractor nor trailer touches the van on the driven path.
    way = [(state.station, state.offset) for state in run.states]
    station, offset = np.array(way).T
    moved = np.concatenate([[True], np.diff(station) > 1e-3])
    path = run.planner.preview.follow(0, float(station[0]), 400.0, 150.0)
    driven = dataclasses.replace(
        path,
        shift=np.interp(path.station, station[moved], offset[moved]) - path.offset,
    )
    units = bodies_along(
        TruckParameters.load(), run.planner.preview, driven, None, np.arange(560.0, 640.0, 0.5)
    )
    around = Scene(0.0, EgoState(), [VAN]).neighbors
    there = Poses.of(around, np.array([True]), run.planner.preview).ahead(np.zeros(1))
    assert not any(unit.touch(there, 0.2).any() for unit in units)


@pytest.mark.parametrize("gap", [4.0, 8.0])
def test_a_change_too_near_behind_a_stopped_vehicle_is_refused_by_name(gap):
    station = VAN.station - 3.0 - gap - 1.4
    ego = EgoState(station=station, offset=float(ROAD.lane_offset(0, station)), mass=55e3)
    plan = Planner(ROAD).plan(Scene(0.0, ego, (VAN,)), Decision.LEFT)
    assert plan.refused is Decision.LEFT
    assert "get past" in plan.reason


def test_the_truck_does_not_pull_out_before_a_fast_vehicle_from_behind():
    ego = EgoState(station=576.0, offset=float(ROAD.lane_offset(0, 576.0)), mass=55e3)
    fast = car(ROAD, "fast", 520.0, 1, 16.0)
    plan = Planner(ROAD).plan(Scene(0.0, ego, (VAN, fast)), Decision.LEFT)
    assert plan.refused is Decision.LEFT
    assert "fast" in plan.reason


def test_the_truck_does_not_leave_a_queue_at_a_light():
    ego = EgoState(station=576.0, offset=float(ROAD.lane_offset(0, 576.0)), mass=55e3)
    light = RoadSignals(light=TrafficLight(station=615.0, state=LightState.RED))
    plan = Planner(ROAD).plan(Scene(0.0, ego, (VAN,), signals=light), Decision.LEFT)
    assert plan.refused is Decision.LEFT
