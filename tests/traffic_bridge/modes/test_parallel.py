import dataclasses
import math
import multiprocessing
import os
import pickle
import re
import signal
import subprocess
import sys
import tempfile
import textwrap
import time
from pathlib import Path

import numpy as np
import pytest

from iits_mj.core.errors import InputError, TrafficError
from iits_mj.road import Route
from tests.paths import ROOT
from tests.traffic_bridge.scripted_truck import ego_at
from traffic_bridge import InterSim, PureSim, TrafficConfig, TrafficWorlds, WorldSpec
from traffic_bridge.modes.world_process import WorldProcess

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
def temporary(tmp_path_factory):
    """A separate folder for temporary files."""
    folder = tmp_path_factory.mktemp("temporary")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(tempfile, "tempdir", str(folder))
        yield folder


@pytest.fixture(scope="module")
def worlds(temporary):
    with TrafficWorlds(SPECS, timeout=60.0) as made:
        yield made


def worlds_with_files(folder):
    """Number of worlds whose SUMO has files in a folder of temporary files."""
    return len(list(folder.glob("iits_mj_world_*/*/types.add.xml")))


@pytest.fixture(scope="module")
def alone():
    """Frames of each world's simulation, run in this process."""
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
    """Whether a process of this number exists and is no zombie."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


def test_worlds_are_bit_identical_to_simulations_in_this_process(worlds, alone):
    for _ in range(2):
        frames = [worlds.reset(egos(0))]
        frames += [worlds.step(egos(k)) for k in range(1, STEPS + 1)]
        for number, run in enumerate(alone):
            assert [frame[number] for frame in frames] == run
            assert len(run[-1]) > 3
    assert alone[0] != alone[1]


def test_a_step_is_sent_and_received_separately(worlds, alone):
    worlds.reset(egos(0))
    worlds.send_step(egos(1))
    with pytest.raises(TrafficError, match="under way"):
        worlds.step(egos(2))
    with pytest.raises(TrafficError, match="under way"):
        worlds.call("time")
    assert worlds.receive_step() == (alone[0][1], alone[1][1])
    with pytest.raises(TrafficError, match="send_step"):
        worlds.receive_step()


def test_one_world_is_reset_with_another_seed_while_the_other_continues(worlds, alone):
    worlds.reset(egos(0), seeds=[3, 4])
    worlds.step(egos(1))
    (other,) = worlds.reset([ego(0, 0)], seeds=[np.int64(11)], worlds=[0])
    assert other != alone[0][0]
    assert worlds.step([ego(1, 2)], worlds=[1]) == (alone[1][2],)
    assert worlds.call("time") == pytest.approx((0.0, 0.2))
    assert worlds.call("seed") == (11, 4)
    (again,) = worlds.reset([ego(0, 0)], seeds=[3], worlds=[0])
    assert again == alone[0][0]


def test_methods_are_called_in_the_processes_of_the_worlds(worlds):
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
    with pytest.raises(
        InputError, match=r"world 0: 'vehicles\.change' .* wrong arguments: missing"
    ):
        worlds.call("vehicles.change", time_headway=2.5)
    with pytest.raises(InputError, match=r"world 0: no vehicle 'bus\.1'"):
        worlds.call("vehicles.change", "bus.1", worlds=[0], time_headway=1.0)


def test_an_error_in_a_world_keeps_its_type_and_names_the_world(worlds, alone):
    worlds.reset(egos(0), seeds=[3, 4])
    broken = [ego(0, 1), type(ego(1, 1))(x=math.nan)]
    with pytest.raises(InputError, match=r"world 1: ego\.x = nan"):
        worlds.step(broken)
    # The other world has made its step, and both continue.
    assert worlds.step([ego(0, 2)], worlds=[0]) == (alone[0][2],)
    assert worlds.step([ego(1, 1)], worlds=[1]) == (alone[1][1],)
    with pytest.raises(InputError, match=r"world 0: InterSim\.step needs the ego"):
        worlds.step([None], worlds=[0])


def test_wrong_numbers_egos_and_seeds_are_refused_before_any_world_acts(worlds):
    worlds.reset(egos(0), seeds=[3, 4])
    for wrong in ([2], [-1], [0, 0], [0.5], ["a"]):
        with pytest.raises(InputError, match="world"):
            worlds.step([ego(0, 1)] * len(wrong), worlds=wrong)
    with pytest.raises(InputError, match="1 egos for 2 worlds"):
        worlds.step([ego(0, 1)])
    with pytest.raises(InputError, match="ego of world 1"):
        worlds.step([ego(0, 1), "truck"])
    for wrong in ([1], [1, -1], [1, 2**31], [1, 0.5], [1, "a"], [1, True], 4, "ab"):
        with pytest.raises(InputError, match="seed"):
            worlds.reset(egos(0), seeds=wrong)
    with pytest.raises(InputError, match=r"worlds = 1: must be numbers of worlds"):
        worlds.step([ego(0, 1)], worlds=1)
    for wrong in (5, ego(0, 1), "ab", {0: None, 1: None}):
        with pytest.raises(InputError, match="must be a sequence of 2, one per world"):
            worlds.step(wrong)
    with pytest.raises(InputError, match="5 to call: must be a name"):
        worlds.call(5)
    assert worlds.call("time") == (0.0, 0.0)
    assert worlds.call("seed") == (3, 4)


class Unreadable:
    """Can be pickled, but raises an error when it is unpickled."""

    def __reduce__(self):
        return eval, ("1 // 0",)


def test_arguments_that_cannot_be_pickled_are_refused_and_the_worlds_continue(worlds, alone):
    worlds.reset(egos(0), seeds=[3, 4])
    for lost in (lambda: 0, open(os.devnull), sys._getframe()):  # noqa: SIM115
        with pytest.raises(
            InputError, match=r"arguments of 'vehicles\.change' cannot be handed to"
        ):
            worlds.call("vehicles.change", "car", time_headway=lost)
    # The first world's ego is valid; the second one cannot be pickled.
    with pytest.raises(InputError, match="ego of world 1 cannot be handed to another process"):
        worlds.step([ego(0, 1), dataclasses.replace(ego(1, 1), gear=lambda: 0)])
    with pytest.raises(InputError, match="ego of world 1 cannot be handed to another process"):
        worlds.reset([ego(0, 0), dataclasses.replace(ego(1, 0), gear=lambda: 0)], seeds=[8, 9])
    assert worlds.call("seed") == (3, 4)
    assert worlds.step(egos(1)) == (alone[0][1], alone[1][1])


def test_arguments_that_cannot_be_unpickled_are_an_error_of_their_world(worlds, alone):
    worlds.reset(egos(0), seeds=[3, 4])
    pids = worlds.pids
    with pytest.raises(InputError, match="world 0: the message cannot be read there"):
        worlds.call("vehicles.change", "car", time_headway=Unreadable())
    assert worlds.step(egos(1)) == (alone[0][1], alone[1][1])
    assert worlds.pids == pids


def test_after_an_interrupt_no_old_answer_is_taken_for_a_new_one(worlds, alone, monkeypatch):
    worlds.reset(egos(0), seeds=[3, 4])

    sent, send = [], WorldProcess.send

    def interrupted(world, message):
        if sent:
            raise KeyboardInterrupt
        sent.append(world)
        send(world, message)

    with monkeypatch.context() as patch:
        patch.setattr(WorldProcess, "send", interrupted)
        with pytest.raises(KeyboardInterrupt):
            worlds.step(egos(1))
    with pytest.raises(TrafficError, match="world 0: was ended by an interrupt; reset it"):
        worlds.step(egos(1))
    assert worlds.reset(egos(0)) == (alone[0][0], alone[1][0])
    assert worlds.step(egos(1)) == (alone[0][1], alone[1][1])


def test_seeds_of_numpy_become_pythons_own_numbers():
    spec = WorldSpec(SPECS[0].route, seed=np.int64(3))
    assert type(spec.seed) is int
    assert spec == WorldSpec(SPECS[0].route, seed=3)


@pytest.mark.parametrize("how", ["SIGKILL", "SIGTERM"])
def test_a_killed_world_is_reported_leaves_no_files_and_can_be_reset(how, worlds, alone, temporary):
    worlds.reset(egos(0), seeds=[3, 4])
    assert worlds_with_files(temporary) == 2
    killed = worlds.pids[1]
    os.kill(killed, signal.Signals[how])
    with pytest.raises(TrafficError, match=rf"world 1: its process ended.*{how}.*reset"):
        worlds.step(egos(1))
    assert worlds.pids[1] is None
    assert worlds_with_files(temporary) == len(list(temporary.iterdir())) == 1
    with pytest.raises(TrafficError, match="world 1: its process ended"):
        worlds.step([ego(1, 1)], worlds=[1])
    assert worlds.reset([ego(1, 0)], worlds=[1]) == (alone[1][0],)
    assert worlds.pids[1] not in (None, killed)
    assert worlds.step(egos(2))[0] == alone[0][2]


def test_a_world_that_hangs_is_ended_and_reported(worlds, monkeypatch):
    worlds.reset(egos(0))
    monkeypatch.setattr(worlds, "timeout", 0.5)
    pid = worlds.pids[0]
    os.kill(pid, signal.SIGSTOP)
    with pytest.raises(TrafficError, match=r"world 0: gave no answer for 0\.5 s"):
        worlds.step([ego(0, 1)], worlds=[0])
    assert not is_running(pid)


def test_wrong_specs_of_worlds_are_refused():
    with pytest.raises(InputError, match="at least one WorldSpec"):
        TrafficWorlds([])
    for wrong in ([SPECS[0], "world"], SPECS[0], 3):
        with pytest.raises(InputError, match="at least one WorldSpec"):
            TrafficWorlds(wrong)
    for wrong in (math.nan, 0.0, "a"):
        with pytest.raises(InputError, match="timeout"):
            TrafficWorlds(SPECS, timeout=wrong)
    with pytest.raises(InputError, match="needs a Route, not 'road'"):
        WorldSpec("road")
    with pytest.raises(InputError, match="needs a TrafficConfig, not None"):
        WorldSpec(SPECS[0].route, None)
    for wrong in ("ReSim", [], None):
        with pytest.raises(InputError, match=r"mode .* allowed are InterSim, PureSim"):
            WorldSpec(SPECS[0].route, mode=wrong)
    with pytest.raises(InputError, match="seed -1"):
        WorldSpec(SPECS[0].route, seed=-1)
    assert pickle.loads(pickle.dumps(WorldSpec(SPECS[0].route, mode="PureSim")))().mode == "PureSim"


def test_worlds_in_a_daemonic_process_are_refused_with_the_reason(monkeypatch):
    # Workers of vector environments are such processes.
    monkeypatch.setitem(multiprocessing.current_process()._config, "daemon", True)
    with pytest.raises(TrafficError, match=r"cannot be started: daemonic"):
        TrafficWorlds(SPECS)


def test_worlds_do_not_affect_a_simulation_in_this_process(worlds, alone):
    with PureSim(route_of(0), CROWDED, seed=1) as own:
        first = own.reset()
        worlds.reset(egos(0), seeds=[3, 4])
        assert worlds.step(egos(1)) == (alone[0][1], alone[1][1])
        assert own.step() != first


@pytest.mark.parametrize("ending", ["SIGKILL", pytest.param("exit", marks=pytest.mark.slow)])
def test_worlds_end_when_their_owner_ends_and_leave_no_files(ending, tmp_path):
    script = tmp_path / "owner.py"
    script.write_text(
        textwrap.dedent(
            """
            import sys
            from iits_mj.road import Route
            from traffic_bridge import TrafficWorlds, WorldSpec

            if __name__ == "__main__":
                worlds = TrafficWorlds([WorldSpec(Route.straight(length=1000.0))])
                worlds.reset()
                print(*worlds.pids, flush=True)
                sys.stdin.read()
            """
        )
    )
    folder = tmp_path / "temporary"
    folder.mkdir()
    owner = subprocess.Popen(
        [sys.executable, str(script)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env=os.environ | {"TMPDIR": str(folder)},
    )
    (pid,) = map(int, owner.stdout.readline().split())
    assert is_running(pid)
    assert worlds_with_files(folder) == 1
    if ending == "SIGKILL":
        owner.kill()
    owner.communicate()  # else the script ends without closing its worlds
    deadline = time.monotonic() + 20.0
    while (is_running(pid) or list(folder.iterdir())) and time.monotonic() < deadline:
        time.sleep(0.02)
    assert not is_running(pid)
    assert not list(folder.iterdir())


@pytest.mark.slow
def test_the_example_of_the_manual_steps_three_trucks_in_three_worlds(tmp_path):
    manual = ROOT / "docs" / "traffic.md"
    section = manual.read_text(encoding="utf-8").partition("## Many worlds")[2]
    example = re.search(r"```python\n(.*?)```", section, re.DOTALL).group(1)
    script = tmp_path / "example.py"
    script.write_text(example, encoding="utf-8")
    result = subprocess.run([sys.executable, str(script)], capture_output=True, text=True)
    assert result.returncode == 0, result.stderr
    time, counts, gaps = re.findall(r"[(\[].*?[)\]]", result.stdout)
    assert time == "(5.0, 5.0, 5.0)"
    assert all(int(count) > 5 for count in counts.strip("[]").split(","))
    assert all(float(gap) > 2.0 for gap in gaps.strip("[]").split())


@pytest.mark.slow
def test_a_script_without_a_guarded_main_part_gets_an_error_that_names_it(tmp_path):
    script = tmp_path / "careless.py"
    script.write_text(
        "from iits_mj.road import Route\n"
        "from traffic_bridge import TrafficWorlds, WorldSpec\n"
        "TrafficWorlds([WorldSpec(Route.straight(length=1000.0))])\n"
    )
    result = subprocess.run([sys.executable, str(script)], capture_output=True, text=True)
    assert result.returncode == 1
    assert "__main__" in result.stderr.splitlines()[-1]


def test_closing_leaves_no_process_and_no_file_and_closed_worlds_are_refused(worlds, temporary):
    # Must be the last test of the file, because the others share these worlds.
    worlds.reset(egos(0))
    pids = worlds.pids
    assert all(map(is_running, pids))
    worlds.close()
    worlds.close()
    assert not any(map(is_running, pids))
    assert not multiprocessing.active_children()
    assert not list(temporary.iterdir())
    with pytest.raises(TrafficError, match="are closed"):
        worlds.reset()
