import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from iits_mj.core.errors import MapError, TrafficError
from iits_mj.road import RoadMap, Route
from iits_mj.road.writer import to_xml, write
from tests.traffic_bridge.esmini_maps import MAPS, esmini
from tests.traffic_bridge.merge_map import two_way_road
from traffic_bridge import MapNetwork, PureSim, TrafficConfig, build_network, cache_dir
from traffic_bridge.network import nets
from traffic_bridge.network.route_lanes import RouteLanes
from traffic_bridge.session import Session, load_libsumo

LOCATION = "<location netOffset='0,0' convBoundary='0,0,9,9' origBoundary='0,0,9,9'/>"
LANE = "<edge id='a' from='x' to='y'><lane id='a_0' length='9' speed='9' shape='0,0 9,0'/></edge>"


@pytest.mark.parametrize("name", MAPS)
def test_lanes_of_a_foreign_map_lie_on_the_route(name):
    route = esmini(name).route()
    network = build_network(route)
    session = Session(network.path)
    try:
        lanes = RouteLanes(session, network, route)
        reached = 0.0
        for edge in lanes.edges:
            for table in lanes.of_edge(edge):
                assert np.all(np.diff(table.station) > 0.0)
                middle = len(table.station) // 2
                station = float(table.station[middle])
                center = route.lane_offset(table.lane, station)
                assert abs(table.offset[middle] - center) < 0.05
                assert abs(table.position_of(station) - middle * table.spacing) < 1e-6
                reached = max(reached, float(table.station[-1]))
        assert reached > route.length - 1.0
    finally:
        session.close()


def test_shipped_net_of_the_highway_is_used_and_covers_it(highway):
    network = build_network(highway)
    assert network.path.parent == highway.road_map.path.parent
    session = Session(network.path)
    try:
        lanes = RouteLanes(session, network, highway)
        stations = np.concatenate([lanes.of_edge(edge)[0].station for edge in lanes.edges])
        assert stations[0] < 1.0
        assert stations[-1] > highway.length - 1.0
        for station in (500.0, 5_000.0, 12_000.0):
            for lane in range(highway.lane_count(station)):
                table = lanes.find(lane, station)
                assert table is not None
                limit = session.api.lane.getMaxSpeed(table.id)
                middle = float(table.station[len(table.station) // 2])
                assert limit == pytest.approx(min(highway.speed_limit(middle, lane), 70.0))
    finally:
        session.close()


def test_one_map_content_gives_one_cached_net(straight):
    first = build_network(straight)
    stamp = first.path.stat().st_mtime_ns
    assert first.path.is_relative_to(cache_dir())
    assert build_network(Route.straight(length=4000.0)).path == first.path
    assert first.path.stat().st_mtime_ns == stamp
    assert build_network(Route.straight(length=4100.0)).path != first.path


@pytest.mark.parametrize("damage", ["cut", "changed", "emptied"])
def test_a_damaged_net_is_made_again(damage):
    route = Route.straight(length=3300.0)
    path = build_network(route).path
    whole = path.read_bytes()
    bad = {
        "cut": whole[: len(whole) // 2],
        "changed": whole.replace(b'speed="25.000"', b'speed="99.000"'),
        "emptied": b"",
    }
    assert bad[damage] != whole
    path.write_bytes(bad[damage])
    assert build_network(route).path == path
    assert path.read_bytes() == whole


def test_two_processes_can_make_one_net_at_the_same_time(tmp_path):
    code = (
        "from iits_mj.road import Route; from traffic_bridge import build_network;"
        "print(build_network(Route.straight(length=2900.0)).path.read_bytes()[-80:])"
    )
    environment = os.environ | {"IITS_MJ_CACHE": str(tmp_path)}
    both = [
        subprocess.Popen([sys.executable, "-c", code], env=environment, stdout=subprocess.PIPE)
        for _ in range(2)
    ]
    said = [process.communicate()[0] for process in both]
    assert [process.returncode for process in both] == [0, 0]
    assert said[0] == said[1] != b""
    assert len(list((tmp_path / "nets").iterdir())) == 1


def test_limits_of_turns_follow_from_their_curvature():
    network = MapNetwork.of(esmini("fabriksgatan_traffic_lights"))
    turns = {link.via: link.turn for link in network.connections if link.via}
    speeds = {turn: [network.lanes[via].speed for via, t in turns.items() if t == turn]
              for turn in "lrs"}  # fmt: skip
    # On 6 m of radius 3 m/s2 is 4.2 m/s; SUMO takes the mean bend of the whole turn.
    assert max(speeds["r"]) < 6.0
    assert max(speeds["l"]) < 8.0
    assert min(speeds["s"]) == pytest.approx(13.89)


def test_an_empty_junction_attribute_means_no_junction(tmp_path):
    path = tmp_path / "map.xodr"
    text = to_xml(Route.straight(length=500.0).road_map.content)
    path.write_text(text.replace('junction="-1"', 'junction=""'))
    network = MapNetwork.of(RoadMap.from_opendrive(path))
    assert network.entrances == network.exits == ("-1",)
    assert network.roads["1"].junction == ""


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("<net", "loading"),
        ("<net></net>", "loading"),
        ("this is no net", "loading"),
        (f"<net version='1.2'>{LOCATION}<edge id='a'/></net>", "no lanes"),
        (f"<net version='1.2'>{LANE}</net>", "no complete"),
        (f"<net>{LOCATION}{LANE}</net>", "no version"),
        (f"<net version='1.2'>{LOCATION}{LANE}</net>", "node 'x'"),
    ],
)
def test_a_malformed_net_gives_one_error_and_no_simulation(tmp_path, text, expected):
    net = tmp_path / "bad.net.xml"
    net.write_text(text)
    with pytest.raises(TrafficError, match=expected):
        Session(net)
    assert not load_libsumo().isLoaded()
    with pytest.raises(TrafficError, match=r"bad\.net\.xml"):
        Session(tmp_path / "missing_bad.net.xml")


def test_a_net_of_another_map_is_refused(straight, highway):
    net = build_network(straight)
    session = Session(net.path)
    with pytest.raises(TrafficError, match="no edge for road"):
        RouteLanes(session, net, highway)
    assert not session.is_open


def test_a_failed_netconvert_run_reports_the_reason(straight, tmp_path):
    from traffic_bridge.network.nets import run_netconvert

    bad = tmp_path / "bad.xodr"
    bad.write_text("<OpenDRIVE><road id='1'/></OpenDRIVE>")
    with pytest.raises(MapError, match=r"bad\.xodr: .*netconvert"):
        run_netconvert(["--opendrive", str(bad), "-o", str(tmp_path / "x.net.xml")], str(bad))


def test_without_netconvert_the_message_names_the_extra_that_has_it(monkeypatch):
    monkeypatch.setattr(nets.shutil, "which", lambda name: None)
    monkeypatch.setattr(nets.importlib.util, "find_spec", lambda name: None)
    monkeypatch.setattr(nets.sys, "prefix", "/nowhere")
    with pytest.raises(TrafficError, match=r"pip install 'iits-mj\[maps\]'"):
        nets.find_netconvert()


def test_a_netconvert_that_does_not_end_or_fills_the_memory_is_stopped(
    straight, monkeypatch, tmp_path
):
    def replace_by(script):
        tool = tmp_path / "netconvert"
        tool.write_text(f"#!{sys.executable}\n{script}\n")
        tool.chmod(0o755)
        monkeypatch.setattr(nets, "find_netconvert", lambda: tool)

    nets.netconvert_version()  # kept from the real one
    monkeypatch.setenv("IITS_MJ_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(nets, "TIMEOUT", 0.5)
    replace_by("import time; time.sleep(60)")
    with pytest.raises(
        TrafficError, match=r"straight road of 4000 m: SUMO's netconvert did not finish .* 0.5 s"
    ):
        nets.build_network(straight)
    monkeypatch.setattr(nets, "TIMEOUT", 20.0)
    replace_by(
        "import sys\n"
        "try:\n    content = bytearray(2**33)\n"
        "except MemoryError:\n    sys.exit('std::bad_alloc')"
    )
    with pytest.raises(
        TrafficError, match=r"straight road of 4000 m: SUMO's netconvert needs more than 4 GB"
    ):
        nets.build_network(straight)


def test_an_unwritable_cache_folder_is_reported_with_its_variable(straight, monkeypatch, tmp_path):
    blocker = tmp_path / "file"
    blocker.write_text("")
    monkeypatch.setenv("IITS_MJ_CACHE", str(blocker / "cache"))
    with pytest.raises(TrafficError, match="IITS_MJ_CACHE"):
        build_network(straight)


def test_oncoming_traffic_runs_on_the_opposite_lanes(tmp_path):
    path = write(two_way_road(1000.0), tmp_path / "two_way.xodr")
    route = RoadMap.from_opendrive(path).route()
    config = TrafficConfig(density=0.1, scope="both")
    with PureSim(route, config, seed=1) as traffic:
        before = {v.id: v for v in traffic.reset()}
        for _ in range(10):
            after = {v.id: v for v in traffic.step()}
    oncoming = [v for v in after.values() if v.lane == -1]
    assert oncoming
    for v in oncoming:
        assert v.offset > 0.0
        if v.id in before:
            assert v.station < before[v.id].station
            heading = float(route.evaluate(v.station).heading)
            assert np.cos(v.yaw - heading) < -0.95


def test_without_a_usable_home_the_message_names_the_cache_variable(tmp_path, monkeypatch):
    (tmp_path / "file").touch()
    for name in (nets.CACHE_VARIABLE, "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("HOME", str(tmp_path / "file" / "home"))
    with pytest.raises(TrafficError, match=r"cache folder .*Not a directory.*set IITS_MJ_CACHE to"):
        build_network(Route.straight())
    monkeypatch.setenv(nets.CACHE_VARIABLE, str(tmp_path / "cache"))
    assert build_network(Route.straight())


def test_a_user_without_a_home_gets_the_same_message(monkeypatch):
    def unknown() -> Path:
        raise RuntimeError("Could not determine home directory.")

    for name in (nets.CACHE_VARIABLE, "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(Path, "home", unknown)
    with pytest.raises(TrafficError, match="set IITS_MJ_CACHE to a folder"):
        build_network(Route.straight())
