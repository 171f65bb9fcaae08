"""Stop lines before junctions, and turns that long vehicles can take."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from iits_mj.road import RoadMap
from tests.paths import outside
from tests.traffic_bridge.esmini_maps import esmini
from traffic_bridge import PureSim, TrafficConfig
from traffic_bridge.network.net_file import NetFile
from traffic_bridge.network.nets import build_network
from traffic_bridge.network.stop_lines import stop_offsets, turn_radius


@pytest.fixture(scope="module")
def town() -> RoadMap:
    return esmini("fabriksgatan_traffic_lights")


@pytest.fixture(scope="module")
def net(town: RoadMap) -> NetFile:
    return build_network(town)


def test_the_radius_of_a_turn_is_that_of_its_arc(net):
    # The connecting roads of the map, see its file: arcs of 1 / 0.108 m and straight ones.
    lefts = [turn_radius(net, link) for link in net.connections if link.turn == "l"]
    straights = [turn_radius(net, link) for link in net.connections if link.turn == "s"]
    lefts = [radius for radius in lefts if math.isfinite(radius)]
    assert 9.0 < min(lefts) < max(lefts) < 10.0
    assert math.isinf(min(straights))


def test_a_line_is_before_the_light_and_clear_of_trucks_that_turn(net, town):
    offsets = stop_offsets(net, town.roads)
    # Each arm is the exit of a left turn; the light of road 3 is 5.3 m before its end.
    assert set(offsets) == {"0_0", "1_0", "-2_0", "-3_0"}
    assert offsets["-3_0"] > 5.3
    assert all(offsets[lane] <= 0.4 * net.lanes[lane].length for lane in offsets)
    assert {name: net.lanes[name].stop_offset for name in offsets} == offsets


def test_a_line_of_the_map_counts_where_no_truck_turns():
    road_map = RoadMap.from_opendrive(outside("xosc/xodr/multi_intersections.xodr"))
    offsets = stop_offsets(build_network(road_map), road_map.roads)
    # On the right lane of two beside a left turn, the map's line is 4 m before the junction.
    assert offsets["202#0_0"] == pytest.approx(4.0, abs=0.01)
    assert offsets["229_0"] > 5.0


def test_vehicles_wait_at_the_line(town, net):
    with PureSim(town.route(), TrafficConfig(density="dense", scope="map"), seed=0) as traffic:
        traffic.reset()
        api = traffic.session.api.vehicle
        nearest = dict.fromkeys((lane.id for lane in net.lanes.values()), math.inf)
        for _ in range(600):
            for vehicle in traffic.step():
                if vehicle.speed < 0.05:
                    lane = api.getLaneID(vehicle.id)
                    left = net.lanes[lane].length - api.getLanePosition(vehicle.id)
                    nearest[lane] = min(nearest[lane], left)
    waited = {lane: left for lane, left in nearest.items() if math.isfinite(left)}
    assert waited
    for lane, left in waited.items():
        assert left > net.lanes[lane].stop_offset - 0.01, lane


def test_long_vehicles_take_turns_that_they_fit(town, net):
    config = TrafficConfig(density=0.1, scope="map", mix={"articulated": 1.0}, speed_limit=12.0)
    links = {(link.start, link.end): link for link in net.connections}
    taken = []
    with PureSim(town.route(), config, seed=1) as traffic:
        traffic.reset()
        api = traffic.session.api.vehicle
        for _ in range(20):
            for name in api.getIDList():
                route = api.getRoute(name)
                taken += [
                    turn_radius(net, links[f"{a}_0", f"{b}_0"])
                    for a, b in itertools.pairwise(route)
                ]
            for _ in range(30):
                traffic.step()
    assert len(taken) > 20
    assert np.min(taken) >= 9.7
