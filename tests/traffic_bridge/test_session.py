import gc
import os
import re
import signal
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest

from iits_mj.core.errors import TrafficError
from traffic_bridge import PureSim, TrafficConfig
from traffic_bridge.network.nets import build_network
from traffic_bridge.session import Session, load_libsumo

CROWDED = TrafficConfig(density=0.2, fill_ahead=500.0, fill_behind=500.0)


@pytest.fixture(scope="module")
def net(straight):
    return build_network(straight).path


@pytest.fixture(scope="module")
def highway_net(highway):
    return build_network(highway).path


def resident_mib():
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 2**20


def growth(straight, reloads, lane_change="mobil"):
    config = TrafficConfig(
        density=0.1, fill_ahead=500.0, fill_behind=500.0, lane_change=lane_change
    )
    with PureSim(straight, config, seed=1) as traffic:

        def reload():
            traffic.reset()
            for _ in range(3):
                traffic.step()
            traffic.close()

        for _ in range(10):
            reload()
        gc.collect()
        before = resident_mib()
        for _ in range(reloads):
            reload()
        gc.collect()
        return resident_mib() - before


def test_60_reloads_leak_less_than_2_mib(straight):
    # A simulation of this size takes 0.6 MiB, so a leak of one at each reload would show.
    assert growth(straight, 60) < 5.0 * 60 / 500 + 1.0


@pytest.mark.slow
@pytest.mark.parametrize("lane_change", ["lc2013", "mobil"])
def test_500_reloads_leak_less_than_5_mib(straight, lane_change):
    assert growth(straight, 500, lane_change) < 5.0


def test_a_second_simulation_is_refused_with_advice_and_the_first_continues(net):
    first = Session(net)
    try:
        with pytest.raises(TrafficError, match=r"already running.*TrafficWorlds"):
            Session(net)
        first.step()
        assert first.api.simulation.getTime() == pytest.approx(0.1)
    finally:
        first.close()


def test_a_simulation_without_references_is_closed(straight):
    traffic = PureSim(straight, CROWDED)
    traffic.reset()
    del traffic
    gc.collect()
    assert not load_libsumo().isLoaded()


def test_a_simulation_started_by_other_code_is_neither_used_nor_closed(net):
    api = load_libsumo()
    ours = Session(net)
    # libsumo replaces a simulation without an error.
    api.start(["sumo", "--net-file", str(net), "--no-step-log", "true"])
    try:
        with pytest.raises(TrafficError, match="ended or replaced by other code"):
            ours.step()
        assert not ours.is_open
        assert api.isLoaded()
        assert api.simulation.getTime() == 0.0
        with pytest.raises(TrafficError, match="already running"):
            Session(net)
    finally:
        api.close()


@pytest.mark.parametrize("call", ["simulationStep", "simulation.getArrivedIDList"])
def test_an_interrupt_during_a_step_closes_sumo(straight, monkeypatch, call):
    traffic = PureSim(straight, CROWDED, seed=1)
    traffic.reset()
    api = load_libsumo()
    target = f"libsumo.{call}"
    real = api.simulationStep if call == "simulationStep" else api.simulation.getArrivedIDList

    def interrupted(*arguments):
        signal.raise_signal(signal.SIGINT)
        return real(*arguments)

    with monkeypatch.context() as patch:
        patch.setattr(target, interrupted)
        with pytest.raises(KeyboardInterrupt):
            traffic.step()
    assert not api.isLoaded()
    assert len(traffic.reset()) > 0
    traffic.close()


def test_ctrl_c_closes_sumo_before_the_process_ends():
    code = """
        from iits_mj.road import Route
        from traffic_bridge import PureSim, TrafficConfig
        from traffic_bridge.session import load_libsumo

        try:
            with PureSim(Route.straight(length=2000.0), TrafficConfig(density=0.3)) as traffic:
                traffic.reset()
                print("running", flush=True)
                while True:
                    traffic.step()
        except KeyboardInterrupt:
            print("loaded", load_libsumo().isLoaded())
    """
    child = subprocess.Popen(
        [sys.executable, "-c", textwrap.dedent(code)], stdout=subprocess.PIPE, text=True
    )
    assert child.stdout.readline().strip() == "running"
    child.send_signal(signal.SIGINT)
    out, _ = child.communicate(timeout=30)
    assert out.strip() == "loaded False"


@pytest.mark.parametrize(
    ("pattern", "replacement", "reason"),
    [
        (r'(<lane [^>]*length=")[^"]*', r"\g<1>-5", "no positive length"),
        (r'(<lane [^>]*length=")[^"]*', r"\g<1>nan", "no positive length"),
        (r'(<lane [^>]*length=")[^"]*', r"\g<1>long", "long"),
        (r'(<lane [^>]*speed=")[^"]*', r"\g<1>0", "no positive length and speed"),
        (r'(<lane [^>]*shape=")[^"]*', r"\g<1>nan,0 1,1", "not finite"),
        (r'(<lane [^>]*shape=")[^"]*', r"\g<1>1,1", "broken"),
        (r"<connection [^>]*/>", "", "no connection leads to lane"),
        (r'(<connection [^>]*to=")[^"]*', r"\g<1>nowhere", "nowhere"),
        (r'(<connection [^>]*toLane=")[^"]*', r"\g<1>99", "lane index"),
        (r'(<edge [^>]*from=")[^"]*', r"\g<1>nowhere", "nowhere"),
        (r'(<net [^>]*version=")[^"]*', r"\g<1>new", "new"),
        (r'(<net [^>]*)version="[^"]*"', r"\g<1>", "no version"),
        (r"</net>", "", "no element found"),
        (r"<net.*", "", "no element found|syntax error"),
    ],
)
def test_a_damaged_net_gives_one_error_with_the_reason_and_no_simulation(
    highway_net, tmp_path, pattern, replacement, reason
):
    text = highway_net.read_text()
    damaged = re.sub(pattern, replacement, text, flags=re.DOTALL)
    assert damaged != text
    path = tmp_path / "damaged.net.xml"
    path.write_text(damaged)
    with pytest.raises(TrafficError, match=reason) as caught:
        Session(path)
    assert str(path) in str(caught.value)
    assert not load_libsumo().isLoaded()


def test_files_other_than_nets_are_refused(tmp_path):
    for name, content in (
        ("empty", b""),
        ("binary", bytes(range(256)) * 10),
        ("routes", b"<routes/>"),
        ("latin", b"<net version='1'>\xe4</net>"),
    ):
        path = tmp_path / f"{name}.net.xml"
        path.write_bytes(content)
        with pytest.raises(TrafficError, match="not a SUMO network"):
            Session(path)
    with pytest.raises(TrafficError, match="not a SUMO network"):
        Session(tmp_path / "missing.net.xml")
    with pytest.raises(TrafficError, match="not a SUMO network"):
        Session(tmp_path)


@pytest.mark.parametrize(
    ("additional", "reason"),
    [
        ("<vType", "loading"),
        ('<vType id="a" accel="-1"/>', "accel"),
        ('<vType id="a" carFollowModel="Telepathy"/>', "Telepathy"),
        ('<vType id="a"/><vType id="a"/>', "a"),
        ('<route id="r" edges="nowhere"/>', "nowhere"),
    ],
)
def test_unusable_additional_files_give_one_error_and_no_simulation(net, additional, reason):
    with pytest.raises(TrafficError, match=reason):
        Session(net, additional)
    assert not load_libsumo().isLoaded()


def test_a_wrong_route_during_the_run_closes_sumo(net):
    session = Session(net)
    with (
        pytest.raises(TrafficError, match=r"while sending a bus.*nowhere"),
        session.guard("sending a bus"),
    ):
        session.api.route.add("detour", ["nowhere"])
    assert not session.is_open
    session.close()
    with pytest.raises(TrafficError, match="reset"):
        session.step()


def test_temporary_files_are_removed_on_closing(net, tmp_path, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    session = Session(net)
    assert list(tmp_path.iterdir())
    session.close()
    assert not list(tmp_path.iterdir())
    with pytest.raises(TrafficError):
        Session(net, "<vType")
    assert not list(tmp_path.iterdir())
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "missing"))
    with pytest.raises(TrafficError, match="temporary files"):
        Session(net)


def calls_of(traffic, undo):
    """Calls through handles of a run that a user may still hold."""
    vehicles, signals = traffic.vehicles, traffic.signals
    return {
        "ids": vehicles.ids,
        "change a type": lambda: vehicles.change("car", time_headway=9.0),
        "undo": undo,
        "hold below": lambda: vehicles.hold_below(vehicles.ids()[0], 1.0),
        "limit": lambda: signals.set_speed_limit(3.0),
        "lift all": signals.reset_speed_limits,
        "read a limit": lambda: signals.speed_limit(100.0),
        "stop a vehicle": lambda: signals.stop_vehicle(900.0),
        "close a lane": lambda: signals.close_lane(0, 900.0, 1000.0),
        "convoy": lambda: signals.convoy(900.0, 5.0, count=2),
    }


@pytest.mark.parametrize("newer", [True, False])
def test_handles_of_an_ended_run_are_refused_and_do_not_change_the_running_one(straight, newer):
    old = PureSim(straight, CROWDED, seed=1)
    old.reset()
    calls = calls_of(old, old.vehicles.change("car", time_headway=4.0))
    old.close()
    with PureSim(straight, CROWDED, seed=2) as running:
        if newer:
            running.reset()
            before = [running.vehicles.in_force(name) for name in running.vehicles.ids()]
        for call in calls.values():
            with pytest.raises(TrafficError, match=r"has ended; take traffic\.vehicles / traffic"):
                call()
        if newer:
            assert [running.vehicles.in_force(n) for n in running.vehicles.ids()] == before
            assert running.signals.speed_limit(100.0) > 3.0
            assert not running.signals.obstructions.closed()
            running.step()


def test_handles_are_refused_after_other_code_has_replaced_the_simulation(straight, net):
    api = load_libsumo()
    traffic = PureSim(straight, CROWDED, seed=1)
    traffic.reset()
    api.start(["sumo", "--net-file", str(net), "--no-step-log", "true"])
    try:
        with pytest.raises(TrafficError, match="ended or replaced by other code"):
            traffic.signals.set_speed_limit(3.0)
        assert not traffic.session.is_open
        assert api.isLoaded()
        assert min(api.lane.getMaxSpeed(lane) for lane in api.lane.getIDList()) > 3.0
    finally:
        api.close()
