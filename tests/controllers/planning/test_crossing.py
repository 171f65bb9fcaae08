"""Braking for vehicles that will be in the way of tractor and trailer, and for no others."""

import math

import numpy as np
import pytest

from controllers.planning.crossing import _is_along
from controllers.planning.planner import Planner
from controllers.planning.predicted_boxes import Poses
from controllers.planning.road_preview import RoadPreview
from iits_mj.core.messages import EgoState, PlanMode, RoadSignals, Scene, TrackedVehicle
from iits_mj.core.neighbors import ALONG
from iits_mj.road import RoadMap, Route
from iits_mj.road.measured import Lanes, measured_route
from tests.controllers.scenes import advanced, car, posed

ROAD = Route.straight(length=3000.0, lanes=2)
MIDDLE = float(ROAD.lane_offset(0, 500.0))
EGO = EgoState(station=500.0, offset=MIDDLE, speed=16.67, mass=55e3)


def plan(*vehicles, ego=EGO):
    return Planner(ROAD).plan(Scene(0.0, ego, vehicles))


def crossing(station=530.0, aside=-8.0, speed=4.0, **fields):
    """A car that crosses the road to the left, with its pose in the map frame."""
    fields = {"lateral_speed": speed} | fields
    return posed(ROAD, "across", station, MIDDLE + aside, 0.5 * math.pi, speed, **fields)


def test_the_truck_brakes_hard_for_a_vehicle_that_crosses_30_m_ahead():
    found = plan(crossing())
    assert found.mode is PlanMode.EMERGENCY
    assert found.acceleration[0] < -5.0
    assert "across" in found.reason


def test_a_vehicle_that_is_along_by_its_own_heading_does_not_cross():
    road = RoadMap.builtin().route()
    preview = RoadPreview(road)
    turns, stations = (0.0, 0.2, 0.349, 0.351, 2.0, -0.34, -0.4), np.linspace(900.0, 9000.0, 12)
    vehicles = [
        posed(road, f"{k}.{turn}", station, 0.0, turn, speed)
        for k, station in enumerate(stations.tolist())
        for turn in turns
        for speed in (6.0, -3.0)
    ]
    vehicles += [TrackedVehicle(id="no pose", station=950.0, speed=5.0)]
    neighbors = Scene(0.0, EGO, tuple(vehicles)).neighbors
    found = Poses.of(neighbors, np.ones(len(vehicles), dtype=bool), preview)
    along = [_is_along(neighbors, index, preview) for index in range(len(vehicles))]
    forward = neighbors.posed & (neighbors.speed >= 0.0)
    assert along == ((np.abs(found.to_road) < ALONG) & forward).tolist()


def test_a_crossing_vehicle_without_a_pose_counts():
    vehicle = TrackedVehicle(
        id="x", station=530.0, offset=MIDDLE - 8.0, lane=-1, speed=0.5, lateral_speed=4.0
    )
    assert plan(vehicle).mode is PlanMode.EMERGENCY


@pytest.mark.parametrize(
    "vehicle",
    [
        crossing(aside=8.0),
        crossing(aside=-40.0),
        crossing(acceleration=-3.5),
        crossing(aside=-8.0, speed=1.0),
        crossing(station=440.0),
    ],
    ids=["has passed", "is far", "brakes", "can stop", "is behind"],
)
def test_the_truck_does_not_brake_for_a_vehicle_that_stays_out_of_its_way(vehicle):
    found = plan(vehicle)
    assert found.mode is PlanMode.LANE_KEEPING
    assert found.acceleration.min() > -0.1


def test_the_truck_stops_for_a_car_stopped_across_the_lane():
    # Its middle is beyond the lane's edge, its length reaches in.
    across = crossing(station=580.0, aside=-3.0, speed=0.0, length=6.0)
    assert plan(across).acceleration.min() < -1.0


def test_the_truck_does_not_brake_for_a_vehicle_that_crosses_beside_its_trailer():
    assert plan(crossing(station=490.0, aside=-4.0)).mode is PlanMode.LANE_KEEPING


def bend(radius=9.25, width=3.5):
    """A quarter turn to the left at 200 m: one lane each way."""
    station = np.arange(0.0, 500.0, 1.0)
    arc = 0.5 * np.pi * radius
    curvature = np.where((station >= 200.0) & (station < 200.0 + arc), 1.0 / radius, 0.0)
    return measured_route(
        station, np.zeros_like(station), curvature=curvature, lanes=Lanes(1, width, 14.0)
    )


def test_before_a_turn_that_needs_more_than_the_lane_the_truck_waits_until_it_is_free():
    road = bend()
    planner = Planner(road)
    ego = EgoState(station=170.0, offset=float(road.lane_offset(0, 170.0)), speed=5.0, mass=19e3)
    lane = float(road.lane_offset(0, 220.0))
    standing = posed(road, "oncoming", 222.0, lane + 3.5, math.pi, 0.0)
    for cycle in range(400):
        around = (standing,) if cycle < 200 else ()
        found = planner.plan(Scene(ego.time, ego, around, signals=RoadSignals()))
        if cycle == 199:
            assert ego.speed < 0.05
            assert 190.0 < ego.station < 201.0
            assert "oncoming" in found.reason
        ego = advanced(ego, found)
        if 203.0 < ego.station < 215.0:
            assert ego.speed < 3.3
    assert ego.station > 235.0


def test_the_truck_does_not_wait_for_a_vehicle_beside_the_swept_ground():
    road = bend()
    ego = EgoState(station=195.0, offset=float(road.lane_offset(0, 195.0)), speed=3.0, mass=19e3)
    beside = car(road, "far", 300.0, 0, 0.0)
    assert "waiting" not in Planner(road).plan(Scene(0.0, ego, (beside,))).reason
