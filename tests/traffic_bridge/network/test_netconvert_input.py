"""What netconvert makes of maps that it cannot read, or reads in another way than we do."""

from __future__ import annotations

import numpy as np
import pytest

from iits_mj.road import RoadMap
from tests.road.map_peers import netconvert
from tests.road.opendrive_text import document, line, road
from tests.road.test_odd_maps import at_junction, connection, junction, lanes
from traffic_bridge import MapNetwork, PureSim, TrafficConfig
from traffic_bridge.network.netconvert_input import opendrive_for_netconvert

pytestmark = pytest.mark.skipif(netconvert() is None, reason="netconvert is not installed")

SPLIT = document(
    road("1", link=at_junction("successor"), lanes=lanes(3, 2)),
    road("2", line(100.0), link=at_junction("predecessor"), lanes=lanes(2, 2)),
    road("3", line(100.0, -7.0, length=90.0), 90, at_junction("predecessor")),
    extra=junction(
        connection("1", "2", "start", (-1, -1), (-2, -2), (1, 1), (2, 2)),
        connection("1", "3", "start", (-3, -1)),
    ),
)


def network(folder, text: str) -> MapNetwork:
    path = folder / "odd.xodr"
    path.write_text(text)
    return MapNetwork.of(RoadMap.from_opendrive(path))


def distance(network: MapNetwork, name: str) -> float:
    """Greatest distance between a lane's surface and SUMO's polyline [m]."""
    surface = network.surface(name)
    shape = network.net.lanes[name].shape - np.array(network.net.offset)
    points = np.column_stack((surface.x, surface.y))
    begin, way = shape[:-1], np.diff(shape, axis=0)
    part = ((points[:, None] - begin) * way).sum(-1) / (way**2).sum(-1)
    foot = begin + np.clip(part, 0.0, 1.0)[..., None] * way
    return float(np.hypot(*(points[:, None] - foot).T).min(axis=0).max())


def test_a_direct_junction_connects_each_pair_of_lanes(tmp_path):
    found = network(tmp_path, SPLIT)
    names = {lane.id: (lane.road, lane.lane) for lane in found.lanes.values()}
    pairs = {
        (names[each.start], names[each.end])
        for each in found.connections
        if not each.start.startswith(":")
    }
    assert pairs == {
        (("1", -1), ("2", -1)),
        (("1", -2), ("2", -2)),
        (("1", -3), ("3", -1)),
        (("2", 1), ("1", 1)),
        (("2", 2), ("1", 2)),
    }
    # The added roads are no roads of the map, and its lanes meet without a step.
    assert set(found.roads) == {"1", "2", "3"}
    for each in found.connections:
        if each.via:
            first, last = found.surface(each.start), found.surface(each.via)
            assert last.y[0] == pytest.approx(first.y[-1], abs=0.01)


def test_left_hand_traffic_drives_on_the_left_in_the_net(tmp_path):
    text = SPLIT.replace("<road ", '<road rule="LHT" ')
    found = network(tmp_path, text)
    for name, lane in found.lanes.items():
        if lane.internal:
            continue
        assert distance(found, name) < 0.02
        surface = found.surface(name)
        sense = 1.0 if lane.lane > 0 else -1.0
        assert (surface.x[-1] - surface.x[0]) * sense > 0.0
    # SUMO's lane 0 is the outermost one on both sides.
    outermost = {lane.lane for lane in found.lanes.values() if lane.road == "1" and lane.index == 0}
    assert outermost == {-3, 2}


def test_a_spiral_of_constant_curvature_does_not_exhaust_the_memory(tmp_path):
    spiral = '<spiral curvStart="-0.04177570039796949" curvEnd="-0.04177570039796944"/>'
    text = document(road(geometry=line(0.0, length=20.0).replace("<line/>", spiral), length=20))
    found = network(tmp_path, text)
    assert distance(found, "-1_0") < 0.02


def two_roads(signal: str) -> str:
    """Two roads that meet at x = 100 m; the first one has a signal."""
    return document(
        road(
            "1",
            link='<successor elementType="road" elementId="2" contactPoint="start"/>',
            extra=f"<signals>{signal}</signals>",
        ),
        road(
            "2",
            line(100.0),
            link='<predecessor elementType="road" elementId="1" contactPoint="end"/>',
        ),
    )


SIGNAL = '<signal id="7" s="95" t="0" type="{}" dynamic="{}" orientation="+"/>'


@pytest.mark.parametrize(
    ("kind", "dynamic", "lights"), [("1000001", "yes", 1), ("1000003", "no", 0)]
)
def test_a_painted_crossing_is_no_light(tmp_path, kind, dynamic, lights):
    found = network(tmp_path, two_roads(SIGNAL.format(kind, dynamic)))
    assert len(found.lights) == lights
    assert any(link.light for link in found.connections) == bool(lights)
    PureSim(found.road_map.route(), TrafficConfig(density="empty"), seed=1).close()


@pytest.mark.parametrize("kind", ['id="0" type="" subtype=""', "", 'id="7" type="274" subtype=""'])
def test_an_incomplete_signal_does_not_refuse_the_map(tmp_path, kind):
    signal = f'<signals><signal s="10" t="-4" {kind}/></signals>'
    assert network(tmp_path, document(road(extra=signal))).entrances == ("-1",)


def test_roads_that_are_left_out_are_left_out_of_the_net(tmp_path):
    path = tmp_path / "odd.xodr"
    path.write_text(
        document(
            road("1", link='<successor elementType="road" elementId="9" contactPoint="start"/>'),
            road("9", line(100.0), lanes=""),
        )
    )
    content = opendrive_for_netconvert(RoadMap.from_opendrive(path))
    assert b'"9"' not in content
    assert MapNetwork.of(RoadMap.from_opendrive(path)).exits == ("-1",)


def test_a_map_whose_header_has_an_offset_has_its_net_at_the_same_place(tmp_path):
    shifted = '<header revMajor="1" revMinor="6"><offset x="7e5" y="5e6" z="0" hdg="0"/></header>'
    text = document(road("1")).replace('<header revMajor="1" revMinor="6"/>', shifted)
    made = network(tmp_path, text)
    assert made.road_map.content.offset == (7e5, 5e6)
    assert made.net.offset == (0.0, 0.0)
    assert made.locate(50.0, -1.75).sumo_lane
