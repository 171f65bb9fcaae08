"""OpenStreetMap extracts and SUMO nets become maps that a truck drives."""

from __future__ import annotations

import re
from xml.etree import ElementTree

import numpy as np
import pytest

from iits_mj.core.errors import InputError, MapError
from iits_mj.road import RoadMap
from iits_mj.road.terrain import geographic
from iits_mj.road.writer import to_xml
from iits_mj.simulation import DriveConfig, Simulation
from iits_mj.simulation.parts import load_map
from tests.traffic_bridge.network.test_netconvert_input import distance
from tests.village import NODES, WAYS, write_osm
from traffic_bridge import MapNetwork
from traffic_bridge.network import map_sources
from traffic_bridge.network.map_sources import convert
from traffic_bridge.network.nets import build_network, run_netconvert


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("sources")


@pytest.fixture(scope="module")
def village(folder):
    return write_osm(folder / "village.osm")


@pytest.fixture(scope="module")
def content(village):
    return convert(village)


@pytest.fixture(autouse=True)
def cache(folder, monkeypatch):
    monkeypatch.setenv("IITS_MJ_CACHE", str(folder / "cache"))


def test_roads_of_an_extract_lie_where_its_nodes_are(content):
    place = geographic(content)
    ends = []
    for road in content.roads:
        if road.junction is None:
            start = road.plan.evaluate([0.0])
            ends.append(place(start.x, start.y))
    for node in (1, 6, 7, 8, 9):
        latitude, longitude = NODES[node]
        # 1e-6 degrees are 0.1 m.
        assert any(
            abs(lat[0] - latitude) < 1e-6 and abs(lon[0] - longitude) < 1e-6 for lon, lat in ends
        ), node


def test_limits_lights_and_names_of_an_extract_are_read(content):
    main = [road for road in content.roads if road.junction is None]
    limits = {road.sections[0].driving(1)[0].speeds[0][1] for road in main}
    assert sorted(limits) == pytest.approx([30 / 3.6, 50 / 3.6, 70 / 3.6], abs=0.01)
    lit = [road for road in main if any(signal.is_traffic_light for signal in road.signals)]
    assert len(lit) == 4


ARMS = {"w": (-200, 0), "e": (200, 20), "n": (10, 200)}


def letters(net):
    """The letters of each light's links over a cycle, by the link's first point and turn."""
    lanes = {lane.get("id"): lane for lane in net.iter("lane")}
    (light,) = net.findall("tlLogic")
    found = {}
    for link in net.findall("connection"):
        if link.get("tl") == light.get("id"):
            lane = lanes[f"{link.get('from')}_{link.get('fromLane')}"]
            point = [float(n) for n in lane.get("shape").split()[0].split(",")[:2]]
            key = *map(round, point), link.get("dir")
            number = int(link.get("linkIndex"))
            phases = light.findall("phase")
            found[key] = [(float(p.get("duration")), p.get("state")[number]) for p in phases]
    return light.get("offset"), found


def test_lights_of_a_net_keep_their_programs(folder):
    nodes = "".join(f'<node id="{k}" x="{x}" y="{y}"/>' for k, (x, y) in ARMS.items())
    center = '<node id="c" x="0" y="0" type="traffic_light"/>'
    (folder / "n.nod.xml").write_text(f"<nodes>{center}{nodes}</nodes>")
    edges = "".join(
        f'<edge id="{k}c" from="{k}" to="c" numLanes="2"/><edge id="c{k}" from="c" to="{k}"/>'
        for k in ARMS
    )
    (folder / "n.edg.xml").write_text(f"<edges>{edges}</edges>")
    net = folder / "lit.net.xml"
    inputs = ["-n", str(folder / "n.nod.xml"), "-e", str(folder / "n.edg.xml")]
    options = ["--default.junctions.radius", "10", "--no-turnarounds"]
    run_netconvert([*inputs, *options, "-o", str(net)])
    tree = ElementTree.parse(net)
    (light,) = tree.getroot().findall("tlLogic")
    light.set("offset", "7")
    for number, phase in enumerate(light.findall("phase")):
        phase.set("duration", str(11 + number))
    tree.write(net)
    made = build_network(load_map(net)).path
    source, driven = (letters(ElementTree.parse(path).getroot()) for path in (net, made))
    assert len(source[1]) >= 6
    assert source == driven


def test_every_turn_is_wide_enough_for_a_truck(content):
    road_map = RoadMap(content, "village")
    assert road_map.unusable() == frozenset()
    assert road_map.route().length > 1000.0


def test_roads_driven_on_the_left_are_left_of_their_lines(village):
    content = convert(village, left_hand=True)
    road_map = RoadMap(content, "village")
    assert road_map.left_hand
    assert all(lane.id >= 0 for road in content.roads for lane in road.sections[0].lanes)
    assert road_map.route().length > 1000.0
    net = MapNetwork.of(road_map)
    assert 'lefthand="true"' in net.net.path.read_text()
    # Inside junctions SUMO's lanes are those of the map, too.
    assert max(distance(net, name) for name, lane in net.lanes.items() if lane.length > 0.5) < 0.1
    # Left turns are the near ones, and end on the outermost lane.
    turns = {link.turn for link in net.connections if link.start == "-81_0"}
    assert turns == {"l", "r"}


@pytest.mark.parametrize("ending", [".osm", ".net.xml"])
def test_a_drive_takes_the_file_itself(village, folder, ending):
    path = village
    if ending == ".net.xml":
        path = folder / "village.net.xml"
        run_netconvert(["--osm-files", str(village), "-o", str(path), "--no-turnarounds"])
    config = DriveConfig(map=path, duration=4.0, density="medium", start_speed=10.0)
    with Simulation(config, visuals=False) as simulation:
        summary = simulation.run()
    assert not summary.failed
    assert summary.distance > 25.0
    assert load_map(path).path.name.startswith(f"village{ending}.")


def test_lanes_of_any_order_in_a_file_are_those_of_the_map(content, folder):
    root = ElementTree.fromstring(to_xml(content))
    for group in root.iter("right"):
        group[:] = reversed(group)
    path = folder / "reversed.xodr"
    ElementTree.ElementTree(root).write(path)
    net = MapNetwork.of(RoadMap.from_opendrive(path))
    assert max(distance(net, name) for name, lane in net.lanes.items() if lane.length > 0.5) < 0.1


def test_one_extract_gives_one_text(village, content):
    assert convert(village) == content


def test_a_table_of_heights_by_place_gives_the_heights_of_the_roads(village, folder):
    table = folder / "plane.csv"
    x, y = np.meshgrid(np.linspace(-50.0, 1100.0, 12), np.linspace(-50.0, 550.0, 7))
    z = 300.0 + 0.03 * x - 0.02 * y
    np.savetxt(
        table, np.column_stack((x.flat, y.flat, z.flat)), delimiter=",", header="x_m,y_m,z_m",
        comments="",
    )  # fmt: skip
    route = RoadMap(convert(village, terrain=table), "village").route()
    point = route.evaluate(np.arange(0.0, route.length, 5.0))
    assert np.abs(point.z - (300.0 + 0.03 * point.x - 0.02 * point.y)).max() < 0.01


def test_a_table_of_heights_by_station_is_that_of_the_route(village, folder):
    table = folder / "stations.csv"
    table.write_text("s_m,z_m\n0,100\n500,115\n2000,115\n")
    route = RoadMap(convert(village, terrain=table), "village").route()
    assert float(route.evaluate(250.0).z) == pytest.approx(107.5, abs=0.3)
    assert float(route.evaluate(900.0).z) == pytest.approx(115.0, abs=0.05)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("x_m,y_m,z_m\n9000,0,1\n9100,0,1\n9100,99,1\n", "cover 0 % of the map"),
        ("x_m,y_m,z_m\n0,0,1\n1,1,1\n2,2,1\n", "lie on one line"),
        ("s_m,z_m\n0,1\n0,2\n", "must rise"),
        ("s_m,z_m\n0,0\n100,90\n", "grade"),
        ("x_m,z_m\n0,0\n1,1\n2,2\n", "y_m"),
    ],
)
def test_heights_that_do_not_fit_are_refused(village, folder, text, words):
    table = folder / "bad.csv"
    table.write_text(text)
    with pytest.raises(InputError, match=words):
        convert(village, terrain=table)


def test_damaged_and_empty_extracts_are_refused_by_name(folder):
    bad = folder / "bad.osm"
    bad.write_text("<osm><node")
    with pytest.raises(MapError, match=r"bad\.osm"):
        convert(bad)
    footway = write_osm(folder / "paths.osm", {103: WAYS[103]})
    with pytest.raises(MapError, match=r"paths\.osm.*no road that trucks may use|paths\.osm"):
        convert(footway)


def test_wrong_uses_are_refused(village, folder):
    with pytest.raises(InputError, match="a map's name ends with"):
        convert(folder / "map.kml")
    with pytest.raises(InputError, match="--left-hand is for OpenStreetMap"):
        convert(folder / "map.net.xml", left_hand=True)
    with pytest.raises(MapError, match="there is no such file"):
        map_sources.opendrive_file(folder / "nowhere.osm")


def test_messages_about_a_converted_map_name_its_own_file(village):
    road_map = map_sources.read_map(village)
    assert road_map.name == str(village)
    assert road_map.path != village
    with pytest.raises(InputError, match=re.escape(str(village))):
        road_map.route(along="roads:nowhere")
