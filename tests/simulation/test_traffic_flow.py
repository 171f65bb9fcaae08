import dataclasses
import math
from types import SimpleNamespace

import pytest

from iits_mj.core.messages import EgoState, Scene
from iits_mj.core.vehicles import TrackedVehicle
from iits_mj.road import RoadMap, Route
from iits_mj.simulation import DriveConfig, Simulation
from iits_mj.simulation.parts import UNLIMITED_SPEED, traffic_speed
from iits_mj.simulation.traffic_flow import REACH, FlowMeter

ROUTE = Route.straight(4_000.0, lanes=2, speed_limit=30.0)


def frame(vehicles, station=2_000.0):
    ego = EgoState(station=station)
    return SimpleNamespace(ego=ego, scene=Scene(0.0, ego, vehicles))


def vehicle(name, station, speed=20.0, lane=0, kind="car"):
    return TrackedVehicle(name, kind, station=station, speed=speed, lane=lane)


def test_density_flow_and_speed_are_those_of_the_vehicles_within_reach():
    meter = FlowMeter(ROUTE)
    near = [vehicle(f"v{k}", 1_750.0 + 100.0 * k, 20.0 + k, k % 2) for k in range(6)]
    far = [vehicle("far", 2_000.0 + REACH + 1.0), vehicle("beside", 2_000.0, lane=-1)]
    for _ in range(3):
        meter.add(frame([*near, *far]))
    flow = meter.flow
    assert flow.density == pytest.approx(6.0 / (2.0 * 2.0 * REACH))
    assert flow.speed == pytest.approx(22.5)
    assert flow.flow == pytest.approx(flow.density * flow.speed)
    assert flow.level == "A"


def test_trucks_count_as_two_cars_in_the_level_of_service():
    cars, trucks = FlowMeter(ROUTE), FlowMeter(ROUTE)
    for meter, kind in ((cars, "car"), (trucks, "articulated")):
        meter.add(frame([vehicle(f"v{k}", 1_760.0 + 40.0 * k, kind=kind) for k in range(13)]))
    assert cars.flow.density == trucks.flow.density
    assert (cars.flow.level, trucks.flow.level) == ("B", "D")


def test_road_that_ends_within_reach_counts_up_to_its_end():
    meter = FlowMeter(ROUTE)
    meter.add(frame([vehicle("a", 10.0)], station=0.0))
    assert meter.flow.density == pytest.approx(1.0 / (2.0 * REACH))


def test_empty_road_has_no_flow_and_no_speed():
    meter = FlowMeter(ROUTE)
    meter.add(frame([]))
    assert (meter.flow.density, meter.flow.flow, meter.flow.level) == (0.0, 0.0, "A")
    assert math.isnan(meter.flow.speed)
    assert meter.flow.to_text() == "none around the truck"


def test_traffic_of_a_level_drives_at_the_limit_of_the_road():
    config = DriveConfig(density="C")
    assert traffic_speed(config, RoadMap.builtin().route()) == 22.22
    assert traffic_speed(config, ROUTE) == 30.0
    assert traffic_speed(config, Route.straight(1_000.0, speed_limit=70.0)) == UNLIMITED_SPEED
    assert traffic_speed(dataclasses.replace(config, traffic_speed=10.0), ROUTE) == 10.0
    assert traffic_speed(DriveConfig(), ROUTE) == 12.5


def test_summary_of_a_drive_has_flow_density_speed_and_level_of_the_traffic():
    config = DriveConfig(
        density="D", start_station=13_800.0, duration=2.0, speed_planner="cruise", decision="keep"
    )
    with Simulation(config) as simulation:
        summary = simulation.run()
    figures = summary.as_dict()
    assert figures["level_of_service"] in ("C", "D", "E")
    assert 8.0 < figures["traffic_density_per_km"] < 25.0
    assert figures["traffic_flow_per_hour"] == pytest.approx(
        3.6 * figures["traffic_density_per_km"] * figures["traffic_speed_mps"]
    )
    assert "level of service" in summary.to_text()
