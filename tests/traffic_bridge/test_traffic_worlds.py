import math
import multiprocessing
import os
import pickle
import signal
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import numpy as np
import pytest
from scripted_truck import ego_at

from iits_mj.errors import InputError, TrafficError
from iits_mj.road import Route
from traffic_bridge import InterSim, PureSim, TrafficConfig, TrafficWorlds, WorldSpec

CROWDED = TrafficConfig(density=0.2, fill_ahead=500.0, fill_behind=500.0)
BY_MOBIL = TrafficConfig(
    density=0.1, lane_change="mobil", fill_ahead=500.0, fill_behind=500.0, speed_limit=20.0
)
STEPS = 40


def route_of(number):
    return Route.straight(length=(3000.0, 2000.0)[number], lanes=(3, 2)[number])


def ego(number, k, speed=10.0):
    station = 900.0 + 0.1 * speed * k
    return ego_at(route_of(number), 0.1 * k, station, speed, 0.0)


SPECS = (
    WorldSpec(route_of(0), CROWDED, seed=3),
    WorldSpec(route_of(1), BY_MOBIL, seed=4),
)


@pytest.fixture(scope="module")
def worlds():
    with TrafficWorlds(SPECS, timeout=60.0) as made:
        yield made


@pytest.fixture(scope="module")
def alone():
    """Frames of each world run in this process."""
    runs = []
    for number, spec in enumerate(SPECS):
        with InterSim(spec.route, spec.config, spec.seed) as traffic:
            frames = [traffic.reset(ego(number, 0))]
            frames += [traffic.step(ego(number, k)) for k in range(1, STEPS + 1)]
        runs.append(frames)
    return runs


def egos(k):
    return [ego(0, k), ego(1, k)]


def is_running(pid):
    """Whether a process of this number exists and is not a dead one waiting to be reaped."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


def test_worlds_of_different_routes_give_what_they_give_alone_bit_for_bit(worlds, alone):
    for _ in range(2):
        frames = [worlds.reset(egos(0))]
        frames += [worlds.step(egos(k)) for k in range(1, STEPS + 1)]
        for number, run in enumerate(alone):
            assert [frame[number] for frame in frames] == run
            assert len(run[-1]) > 3
    assert alone[0] != alone[1]


def test_worlds_run_on_while_the_caller_works(worlds, alone):
    worlds.reset(egos(0))
    worlds.send_step(egos(1))
    with pytest.raises(TrafficError, match="under way"):
        worlds.step(egos(2))
    with pytest.raises(TrafficError, match="under way"):
        worlds.call("time")
    assert worlds.receive_step() == (alone[0][1], alone[1][1])
    with pytest.raises(TrafficError, match="send_step"):
        worlds.receive_step()


def test_one_world_is_reset_with_another_seed_while_the_other_goes_on(worlds, alone):
    worlds.reset(egos(0), seeds=[3, 4])
    worlds.step(egos(1))
    (other,) = worlds.reset([ego(0, 0)], seeds=[np.int64(11)], worlds=[0])
    assert other != alone[0][0]
    assert worlds.step([ego(1, 2)], worlds=[1]) == (alone[1][2],)
    assert worlds.call("time") == pytest.approx((0.0, 0.2))
    assert worlds.call("seed") == (11, 4)
    (again,) = worlds.reset([ego(0, 0)], seeds=[3], worlds=[0])
    assert again == alone[0][0]


def test_vehicles_are_changed_through_the_process(worlds):
    worlds.reset(egos(0), seeds=[3, 4])
    worlds.call("vehicles.change", "car", worlds=[0], time_headway=2.5)
    name = next(v.id for v in worlds.step([ego(0, 1)], worlds=[0])[0] if v.kind == "car")
    (kind,) = worlds.call("vehicles.type_of", name, worlds=[0])
    assert kind.time_headway == 2.5
    with pytest.raises(InputError, match=r"world 1: .*no public 'weather'"):
        worlds.call("weather", worlds=[1])
    with pytest.raises(InputError, match="no public '_world'"):
        worlds.call("_world.session")
    with pytest.raises(TrafficError, match="cannot be handed over"):
        worlds.call("vehicles", worlds=[0])
    with pytest.raises(InputError, match=r"world 0: no vehicle 'bus\.1'"):
        worlds.call("vehicles.change", "bus.1", worlds=[0], time_headway=1.0)


def test_an_error_of_a_world_comes_back_with_its_type_and_number(worlds, alone):
    worlds.reset(egos(0), seeds=[3, 4])
    broken = [ego(0, 1), type(ego(1, 1))(x=math.nan)]
    with pytest.raises(InputError, match=r"world 1: ego\.x = nan"):
        worlds.step(broken)
    # The other one has made its step, and both go on.
    assert worlds.step([ego(0, 2)], worlds=[0]) == (alone[0][2],)
    assert worlds.step([ego(1, 1)], worlds=[1]) == (alone[1][1],)
    with pytest.raises(InputError, match=r"world 0: InterSim\.step needs the ego"):
        worlds.step([None], worlds=[0])


def test_wrong_numbers_egos_and_seeds_are_refused_before_anything_happens(worlds):
    worlds.reset(egos(0), seeds=[3, 4])
    for wrong in ([2], [-1], [0, 0], [0.5], ["a"]):
        with pytest.raises(InputError, match="world"):
            worlds.step([ego(0, 1)] * len(wrong), worlds=wrong)
    with pytest.raises(InputError, match="1 egos for 2 worlds"):
        worlds.step([ego(0, 1)])
    with pytest.raises(InputError, match="ego of world 1"):
        worlds.step([ego(0, 1), "truck"])
    for wrong in ([1], [1, -1], [1, 2**31], [1, 0.5], [1, "a"]):
        with pytest.raises(InputError, match="seed"):
            worlds.reset(egos(0), seeds=wrong)
    assert worlds.call("time") == (0.0, 0.0)
    assert worlds.call("seed") == (3, 4)


def test_a_killed_process_is_named_and_its_world_can_be_reset(worlds, alone):
    worlds.reset(egos(0), seeds=[3, 4])
    killed = worlds.pids[1]
    os.kill(killed, signal.SIGKILL)
    with pytest.raises(TrafficError, match=r"world 1: its process ended.*SIGKILL.*reset"):
        worlds.step(egos(1))
    assert worlds.pids[1] is None
    with pytest.raises(TrafficError, match="world 1: its process ended"):
        worlds.step([ego(1, 1)], worlds=[1])
    assert worlds.reset([ego(1, 0)], worlds=[1]) == (alone[1][0],)
    assert worlds.pids[1] not in (None, killed)
    assert worlds.step(egos(2))[0] == alone[0][2]


def test_a_process_that_hangs_is_ended_and_named(worlds, monkeypatch):
    worlds.reset(egos(0))
    monkeypatch.setattr(worlds, "timeout", 0.5)
    pid = worlds.pids[0]
    os.kill(pid, signal.SIGSTOP)
    with pytest.raises(TrafficError, match=r"world 0: gave no answer for 0\.5 s"):
        worlds.step([ego(0, 1)], worlds=[0])
    assert not is_running(pid)


def test_what_is_no_world_is_refused():
    with pytest.raises(InputError, match="at least one WorldSpec"):
        TrafficWorlds([])
    for wrong in ([SPECS[0], "world"], SPECS[0], 3):
        with pytest.raises(InputError, match="at least one WorldSpec"):
            TrafficWorlds(wrong)
    for wrong in (math.nan, 0.0, "a"):
        with pytest.raises(InputError, match="timeout"):
            TrafficWorlds(SPECS, timeout=wrong)
    with pytest.raises(InputError, match="needs a Route and a TrafficConfig, not str"):
        WorldSpec("road")
    with pytest.raises(InputError, match="mode"):
        WorldSpec(SPECS[0].route, mode="ReSim")
    with pytest.raises(InputError, match="seed -1"):
        WorldSpec(SPECS[0].route, seed=-1)
    assert pickle.loads(pickle.dumps(WorldSpec(SPECS[0].route, mode="PureSim")))().mode == "PureSim"


def test_a_process_that_may_have_no_children_is_told_so(monkeypatch):
    # Workers of vector environments are such processes.
    monkeypatch.setitem(multiprocessing.current_process()._config, "daemon", True)
    with pytest.raises(TrafficError, match=r"cannot be started: daemonic"):
        TrafficWorlds(SPECS)


def test_worlds_beside_a_simulation_of_this_process_do_not_disturb_it(worlds, alone):
    with PureSim(route_of(0), CROWDED, seed=1) as own:
        first = own.reset()
        worlds.reset(egos(0), seeds=[3, 4])
        assert worlds.step(egos(1)) == (alone[0][1], alone[1][1])
        assert own.step() != first


def test_worlds_end_when_their_owner_is_killed(tmp_path):
    script = tmp_path / "owner.py"
    script.write_text(
        textwrap.dedent(
            """
            import time
            from iits_mj.road import Route
            from traffic_bridge import TrafficWorlds, WorldSpec

            if __name__ == "__main__":
                worlds = TrafficWorlds([WorldSpec(Route.straight(length=1000.0))])
                worlds.reset()
                print(*worlds.pids, flush=True)
                time.sleep(60.0)
            """
        )
    )
    owner = subprocess.Popen([sys.executable, str(script)], stdout=subprocess.PIPE, text=True)
    (pid,) = map(int, owner.stdout.readline().split())
    assert is_running(pid)
    owner.kill()
    owner.communicate()
    deadline = time.monotonic() + 20.0
    while is_running(pid) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not is_running(pid)


@pytest.mark.slow
def test_a_script_without_a_guarded_main_part_is_told_so(tmp_path):
    script = tmp_path / "careless.py"
    script.write_text(
        "from iits_mj.road import Route\n"
        "from traffic_bridge import TrafficWorlds, WorldSpec\n"
        "TrafficWorlds([WorldSpec(Route.straight(length=1000.0))])\n"
    )
    result = subprocess.run([sys.executable, str(script)], capture_output=True, text=True)
    assert result.returncode == 1
    assert "__main__" in result.stderr.splitlines()[-1]


def test_closing_leaves_no_process_and_closed_worlds_say_so(worlds):
    # The last test of the file: the others share these worlds.
    worlds.reset(egos(0))
    pids = worlds.pids
    assert all(map(is_running, pids))
    worlds.close()
    worlds.close()
    assert not any(map(is_running, pids))
    assert not multiprocessing.active_children()
    with pytest.raises(TrafficError, match="are closed"):
        worlds.reset()
