"""The planner at its edges: slow crossings, chosen stops, curved roads, the air's drag."""

import dataclasses
import math

import numpy as np
import pytest

from controllers.planning.config import LightConfig, PlannerConfig, Powers
from controllers.planning.crossing import crossing_leads
from controllers.planning.planner import Planner
from controllers.planning.predicted_boxes import Poses
from controllers.planning.road_preview import RoadPreview
from controllers.planning.speed_reference import check_profile
from controllers.planning.stops import LightStop, _needed
from controllers.planning.trajectory import Quintic, on_road
from iits_mj.core.errors import InputError
from iits_mj.core.messages import (
    EgoState,
    LightState,
    Scene,
    SpeedProfile,
    TrackedVehicle,
    TrafficLight,
)
from iits_mj.parameters import TruckParameters
from iits_mj.road import Route
from tests.controllers.planning.test_crossing import bend
from tests.controllers.scenes import Ideal, car

PARAMETERS = TruckParameters.load()
ROUTE = Route.straight(length=3_000.0, lanes=2)
PREVIEW = RoadPreview(ROUTE)


def test_the_drag_is_half_of_density_times_drag_area():
    air = PARAMETERS.aerodynamics
    assert Powers.of(PARAMETERS).drag == pytest.approx(0.5 * air.density * air.drag_area)


def test_the_first_station_that_does_not_rise_is_named():
    stations, speeds = np.array([0.0, 5.0, 5.0, 9.0, 3.0]), np.full(5, 10.0)
    with pytest.raises(InputError, match="do not after 5 m"):
        check_profile(SpeedProfile(stations, speeds), "test")


@pytest.mark.parametrize(("distance", "counts"), [(14.0, True), (18.0, True), (40.0, False)])
def test_a_crawling_truck_sees_a_vehicle_that_stands_across_its_lane(distance, counts):
    station, middle = 1000.0, float(ROUTE.lane_offset(0, 1000.0))
    point = ROUTE.evaluate(station + distance, middle)
    across = TrackedVehicle(
        id="across",
        x=float(point.x),
        y=float(point.y),
        z=float(point.z),
        yaw=float(point.heading) + 0.5 * math.pi,
        speed=0.0,
        station=station + distance,
        offset=middle,
        lane=0,
    )
    ego = EgoState(station=station, offset=middle, x=station, y=middle, speed=1.0)
    path = PREVIEW.follow(0, station, 400.0, 150.0)
    leads = crossing_leads(Scene(0.0, ego, (across,)), PREVIEW, PARAMETERS, path, None)
    assert [name for _, name in leads] == (["across"] if counts else [])
    if counts:
        # Front overhang, half of the vehicle's width and the room, to two meters.
        assert distance - 6.5 <= leads[0][0].gap <= distance - 2.0


def test_a_chosen_stop_is_braked_for_by_the_room_that_is_left():
    config = LightConfig()
    light = TrafficLight(station=100.0, state=LightState.YELLOW)
    stop = LightStop(config)
    first = stop.demand(light, 30.0, 15.0)
    assert math.isfinite(first.stop)
    later = stop.demand(light, 45.0, 15.0)
    assert later.deceleration == pytest.approx(_needed(55.0 - config.stop_before, 15.0))
    assert later.deceleration > first.deceleration
    # The choice lasts: too late for a new one.
    assert math.isfinite(stop.demand(light, 70.0, 15.0).stop)
    assert not math.isfinite(LightStop(config).demand(light, 70.0, 15.0).stop)


@pytest.mark.parametrize("aside", [-1.5, 0.0, 1.5])
def test_a_vehicle_without_a_pose_heads_along_its_course(aside):
    vehicle = dataclasses.replace(car(ROUTE, "car", 1050.0, 1, 10.0), lateral_speed=aside)
    scene = Scene(0.0, EgoState(station=1000.0), (vehicle,))
    found = Poses.of(scene.neighbors, np.array([True]), PREVIEW)
    assert found.to_road[0] == pytest.approx(math.asin(aside / 10.0))


def test_the_headings_of_a_trajectory_are_those_of_its_points_in_a_bend():
    road = bend()
    preview = RoadPreview(road)
    tight = float(preview.station[int(np.abs(preview.curvature).argmax())])
    path = preview.follow(0, tight - 20.0, 100.0, 50.0)
    residual = Quintic.to_zero(tight - 20.0, 60.0, 2.5)
    station = np.arange(tight - 15.0, tight + 20.0, 0.1)
    n = len(station)
    plan = on_road(preview, path, residual, 0.0, station, np.full(n, 5.0), np.zeros(n), 0.1)
    course = np.unwrap(np.arctan2(np.diff(plan.y), np.diff(plan.x)))
    middle = np.unwrap(plan.yaw)
    middle = 0.5 * (middle[1:] + middle[:-1])
    apart = np.angle(np.exp(1j * (course - middle)))
    assert np.median(np.abs(apart)) < 1e-3


def test_only_a_slow_truck_is_braked_harder_than_the_plan_near_a_stop():
    planner = Planner(ROUTE, PlannerConfig(), PARAMETERS)
    ego = EgoState(
        station=1000.0, offset=float(ROUTE.lane_offset(0, 0.0)), speed=9.0, mass=30_000.0
    )
    plan = planner.plan(Scene(0.0, ego, ()))
    planner._last = dataclasses.replace(plan, speed=np.full_like(plan.speed, 8.6))
    found = planner._start(Scene(0.3, ego, ()), 1010.0)
    assert found.speed == pytest.approx(8.6)
    slow = dataclasses.replace(ego, speed=7.9)
    planner._last = dataclasses.replace(plan, speed=np.full_like(plan.speed, 7.5))
    assert planner._start(Scene(0.3, slow, ()), 1010.0).speed == pytest.approx(7.8)


class DriftingLanes:
    """A straight road whose lanes move to the left by 1 m in 100 m."""

    def __init__(self):
        self._route = Route.straight(length=2000.0, lanes=2)
        self.length = self._route.length

    def __getattr__(self, name):
        return getattr(self._route, name)

    def lane_offset(self, lane, station):
        return self._route.lane_offset(lane, station) + 0.01 * np.asarray(station)


def test_a_truck_stays_in_its_lane_where_the_lanes_move_aside():
    road = DriftingLanes()
    ideal = Ideal(road, 100.0, 0, 20.0).run(32.0)
    assert ideal.ego.station > 600.0
    assert ideal.ego.offset == pytest.approx(
        float(road.lane_offset(0, ideal.ego.station)), abs=0.05
    )
    assert {plan.target_lane for plan in ideal.plans} == {0}
