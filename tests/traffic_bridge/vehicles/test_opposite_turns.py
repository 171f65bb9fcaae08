"""Long vehicles and opposite left turns: one after the other."""

from __future__ import annotations

import itertools

import pytest

from tests.traffic_bridge.esmini_maps import esmini
from traffic_bridge import PureSim, TrafficConfig
from traffic_bridge.modes.ego import EGO
from traffic_bridge.network.nets import build_network
from traffic_bridge.network.stop_lines import junction_links, meets, swept_lanes
from traffic_bridge.session import Session
from traffic_bridge.vehicles.opposite_turns import OppositeTurns, merged
from traffic_bridge.vehicles.types import default_types


@pytest.fixture(scope="module")
def net():
    return build_network(esmini("fabriksgatan_traffic_lights"))


def test_only_opposite_left_turns_meet_without_crossing(net):
    (links,) = junction_links(net).values()
    turns = [link for link in links if link.turn == "l"]
    found = {
        frozenset((a.start, b.start))
        for a, b in itertools.combinations(turns, 2)
        if meets(net, a, b)
    }
    assert found == {frozenset(("-2_0", "0_0")), frozenset(("-3_0", "1_0"))}


def turning(net, first, second, ways=(("-2", "-1", 290.0), ("0", "3", 78.0)), after=0):
    """Steps two vehicles on two ways, by default opposite left turns; yields SUMO and the limits.

    Args:
      net: of the map.
      first, second: types of the vehicles "a" and "b".
      ways: their edges and the position where they begin [m].
      after: step in which "b" begins.
    """
    kinds = "".join(kind.to_sumo_xml(12.0) for kind in default_types())
    session = Session(net.path, kinds)
    try:
        api, turns = session.api, OppositeTurns(session, net, EGO)
        begins = (0.0, 0.1 * after)
        for name, kind, way, begin in zip("ab", (first, second), ways, begins, strict=True):
            *edges, position = way
            api.route.add(name, edges)
            api.vehicle.add(name, name, kind, str(begin), departPos=f"{position}", departSpeed="3")
        api.trafficlight.setRedYellowGreenState("4", "G" * 12)
        for _ in range(400):
            session.step()
            limits = turns.held()
            for name in api.vehicle.getIDList():
                api.vehicle.setSpeed(name, limits.get(name, -1.0))
            yield api.vehicle, limits
    finally:
        session.close()


@pytest.mark.parametrize("long", ["a", "b"])
def test_a_vehicle_waits_while_a_long_one_turns_against_it(net, long):
    kinds = {"a": "car", "b": "car"} | {long: "truck"}
    together, waited, left = 0, set(), set()
    for vehicle, limits in turning(net, kinds["a"], kinds["b"]):
        there = vehicle.getIDList()
        inside = [name for name in there if vehicle.getLaneID(name).startswith(":")]
        together += len(inside) == 2
        waited |= limits.keys()
        left |= {name for name in there if vehicle.getRouteIndex(name) == 1}
    assert together == 0
    assert len(waited) == 1
    assert left == {"a", "b"}


def test_two_cars_turn_past_each_other(net):
    limits = [limits for _, limits in turning(net, "car", "car")]
    assert not any(limits)


def test_a_vehicle_does_not_pass_its_line_while_a_long_one_sweeps_its_lane(net):
    lane = net.lanes["-3_0"]
    line = lane.length - lane.stop_offset
    ways = (("0", "3", 78.0), ("-3", "-1", line - 20.0))
    (link,) = (one for one in net.connections if (one.start, one.end) == ("0_0", "3_0"))
    assert lane.id in swept_lanes(net, link, [lane])

    place, passed = 0.0, False
    for vehicle, _ in turning(net, "articulated", "car", ways, after=20):
        there = vehicle.getIDList()
        turns = "a" in there and vehicle.getLaneID("a").startswith(":")
        if turns and "b" in there and vehicle.getLaneID("b") == lane.id:
            place = max(place, vehicle.getLanePosition("b"))
        passed |= "b" in there and vehicle.getRoadID("b") == "-1"
    assert line - 2.0 < place < line
    assert passed
    # A car needs no more than its lane.
    assert not any(limits for _, limits in turning(net, "car", "car", ways, after=20))


def test_of_several_limits_the_least_holds():
    assert merged({"a": 2.0, "b": 5.0}.items(), {"a": 3.0, "b": 1.0, "c": 4.0}.items()) == {
        "a": 2.0,
        "b": 1.0,
        "c": 4.0,
    }


def test_no_two_bodies_touch_in_a_town_with_long_vehicles():
    from benchmarks import junction_soak

    config = TrafficConfig(
        density=0.1, scope="map", speed_limit=12.5, mix={"articulated": 1.0, "car": 2.0}
    )
    row = junction_soak.Row("fabriksgatan", "traffic", 3)
    watch = junction_soak.TrafficWatch(config, row)
    with PureSim(esmini("fabriksgatan_traffic_lights").route(), config, seed=3) as traffic:
        watch.look(traffic.reset(), 0.0, boxes=True)
        for k in range(900):
            frame = traffic.step()
            watch.look(frame, traffic.time, boxes=k % 3 == 0)
    assert row.vehicles > 5.0
    assert (row.touches, row.note) == (0, "")
