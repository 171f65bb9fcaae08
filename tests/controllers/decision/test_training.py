"""Training as a whole: rounds, stages, validation, checkpoints, interruption, failures."""

import hashlib
import io
import os
import re
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

from controllers.decision.learning.training import TrainConfig, train
from controllers.decision.learning.trips import sample_trip, validation_trips
from controllers.decision.policy import QNetwork
from controllers.decision.trip import TripConfig
from iits_mj import cli
from iits_mj.core.errors import Error, InputError
from tests.controllers.decision.training_worlds import (
    BlindWorld,
    DyingWorld,
    FailingWorld,
    FlatWorld,
    TorchlessWorld,
)

torch = pytest.importorskip("torch", reason="torch is not installed (the train extra)")

from controllers.decision.learning import checkpoint  # noqa: E402

SMALL = {
    "decisions": 120,
    "trip_duration": 10.0,
    "trips_per_round": 2,
    "warm_up": 20,
    "batch_size": 16,
    "target_interval": 10,
    "replay_capacity": 80,
    "epsilon_decisions": 100,
    "evaluate_interval": 50,
    "validation_trips": 1,
    "truck_validation_trips": 1,
    "validation_duration": 10.0,
    "checkpoint_interval": 30,
    "mirror": True,
    "standardized": True,
    "gap": 0.5,
    "dueling": True,
    "average_rate": 0.1,
}
# Figures of the table that depend on the clock.
CLOCKS = {"wall_s", "training_decisions_per_s"}


def small(**changes):
    return TrainConfig(**{**SMALL, **changes})


def table(folder):
    header, *rows = (folder / "training.csv").read_text().splitlines()
    names = header.split(",")
    return [dict(zip(names, row.split(","), strict=True)) for row in rows]


def outcome(folder):
    """Returns all results that the seed determines: table, networks, memory, policies."""
    state = checkpoint.read(folder)
    rows = [{k: v for k, v in row.items() if k not in CLOCKS} for row in table(folder)]
    counters = {k: v for k, v in state["counters"].items() if k != "wall"}
    arrays = [t.numpy() for part in ("online", "target") for t in state["learner"][part].values()]
    arrays += [state["replay"][name] for name in ("reward", "observation", "action")]
    policies = sorted(path.name for path in (folder / "policies").iterdir())
    for path in ("ddqn.npz", f"policies/{policies[-1]}"):
        arrays += QNetwork.load(folder / path).weights
    return rows, counters, state["generator"], policies, arrays


def assert_same(one, other):
    *values, arrays = outcome(one)
    *others, theirs = outcome(other)
    assert values == others
    assert all(np.array_equal(a, b) for a, b in zip(arrays, theirs, strict=True))


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A training of two stages without interruption, on one worker."""
    folder = tmp_path_factory.mktemp("whole")
    train(small(fast_decisions=60, jobs=1), folder, world=FlatWorld, command="iits-mj train")
    return folder


def test_result_does_not_depend_on_the_number_of_processes(whole, tmp_path):
    train(small(fast_decisions=60, jobs=2), tmp_path, world=FlatWorld)
    assert_same(whole, tmp_path)


@pytest.mark.parametrize("at", [40, 80])
def test_a_resumed_training_continues_to_the_bit(whole, tmp_path, at):
    class PowerCutError(Exception):
        pass

    def cut(done, _):
        if done >= at:
            raise PowerCutError

    config = {"fast_decisions": 60, "checkpoint_interval": 1}
    with pytest.raises(PowerCutError):
        train(small(**config), tmp_path, cut, world=FlatWorld)
    with (tmp_path / "training.csv").open("a") as stream:
        stream.write("a row after the last checkpoint\n")
    train(small(**config, resume=True), tmp_path, world=FlatWorld)
    assert_same(whole, tmp_path)


def test_the_second_stage_resets_memory_exploration_and_best_score(whole):
    state = checkpoint.read(whole)
    began = state["counters"]["stage_began"]
    assert began >= 60
    assert state["counters"]["stage"] == 1
    rows = table(whole)
    # The last validation of the fast world is at the switch.
    assert began in [int(row["decisions"]) for row in rows]
    after = [row for row in rows if int(row["decisions"]) > began]
    assert int(after[0]["training_replay_size"]) <= int(after[0]["decisions"]) - began
    assert 0.03 < float(after[0]["training_epsilon"]) <= 0.2
    scores = [float(row["validation_score_per_s"]) for row in after]
    assert state["counters"]["best"] == pytest.approx(max(scores), rel=1e-5)
    best = QNetwork.load(whole / "ddqn.npz").metadata
    assert best["world"] == "FlatWorld"
    assert best["command"] == "iits-mj train"


def test_every_validated_policy_is_stored(whole):
    decisions = [int(row["decisions"]) for row in table(whole)]
    names = sorted(path.name for path in (whole / "policies").iterdir())
    assert names == [f"ddqn_{n:07d}.npz" for n in decisions]
    assert QNetwork.load(whole / "policies" / names[0]).metadata["decisions"] == decisions[0]


def test_reward_terms_sum_to_the_score(whole):
    for row in table(whole):
        for group in ("training", "validation"):
            terms = ("change_per_s", "speed_per_s", "danger_per_s", "collision_per_s")
            total = sum(float(row[f"{group}_{term}"]) for term in terms)
            assert total == pytest.approx(float(row[f"{group}_score_per_s"]), rel=1e-4)


def test_number_of_updates_is_proportional_to_the_decisions(whole):
    state = checkpoint.read(whole)
    decisions, counters = state["counters"]["decisions"], state["counters"]
    updates = state["learner"]["updates"]
    # At most two rounds, one per stage, make no updates; a trip has about ten decisions.
    assert 0.5 * (decisions - 2 * 40) < updates <= 0.5 * decisions
    assert 0.0 <= counters["debt"] < 1.0


def test_event_files_contain_the_figures_of_the_table(whole):
    pytest.importorskip("tensorboard")
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    events = EventAccumulator(str(whole / "tensorboard"))
    events.Reload()
    tags = events.Tags()["scalars"]
    assert {"training/loss", "training/mean_q", "training/td_error", "training/epsilon"} < {*tags}
    assert {"validation/score_per_s", "validation/speed_loss", "training/speed_per_s"} < {*tags}
    scores = {e.step: e.value for e in events.Scalars("validation/score_per_s")}
    wanted = {int(r["decisions"]): float(r["validation_score_per_s"]) for r in table(whole)}
    assert scores == pytest.approx(wanted, rel=1e-5)


def test_training_without_tensorboard_reports_the_missing_event_files(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "torch.utils.tensorboard", None)
    said = []
    train(small(decisions=10), tmp_path, note=said.append)
    assert len(said) == 1
    assert "no event files" in said[0]
    assert len(table(tmp_path)) == 1


def command(*words):
    """Starts `iits-mj train` in a process of its own."""
    program = "import sys; from iits_mj.cli import main; sys.exit(main())"
    flags = [
        f"--{name.replace('_', '-')}" + ("" if value is True else f"={value}")
        for name, value in SMALL.items()
        if name != "decisions"
    ]
    return subprocess.Popen(
        [sys.executable, "-c", program, "train", *flags, *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def wait_for(condition, process):
    end = time.monotonic() + 60.0
    while not condition():
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < end, "nothing happened for a minute"
        time.sleep(0.02)


def children(pid):
    listed = subprocess.run(
        ["ps", "-o", "pid=", "--ppid", str(pid)], capture_output=True, text=True
    )
    return [int(word) for word in listed.stdout.split()]


def alive(pid):
    try:
        with open(f"/proc/{pid}/stat") as stream:
            return stream.read().rsplit(")", 1)[1].split()[0] != "Z"
    except OSError:
        return False


def test_a_killed_training_loses_at_most_one_checkpoint_interval(tmp_path):
    folder = tmp_path / "killed"
    process = command("--decisions=1000000", "--out", str(folder))
    wait_for((folder / "checkpoint.previous.pt").exists, process)
    workers = children(process.pid)
    assert len(workers) >= 2
    os.kill(process.pid, signal.SIGKILL)
    process.communicate()
    done = int(table(folder)[-1]["decisions"])
    stored = checkpoint.read(folder)["counters"]["decisions"]
    # A checkpoint is due after 30 decisions and written after a round of two trips.
    assert stored >= max(30, done - 30 - 2 * 10)
    end = time.monotonic() + 60.0
    while any(alive(pid) for pid in workers):
        assert time.monotonic() < end, "a worker outlived its training"
        time.sleep(0.05)
    train(small(decisions=stored + 30, resume=True), folder)
    train(small(decisions=stored + 30), tmp_path / "whole")
    assert_same(folder, tmp_path / "whole")


def test_ctrl_c_writes_a_checkpoint_and_exits_with_130(tmp_path):
    process = command(
        "--decisions=1000000", "--checkpoint-interval=1000000", "--out", str(tmp_path)
    )
    wait_for(lambda: list(tmp_path.glob("policies/*.npz")), process)
    assert not (tmp_path / "checkpoint.pt").exists()
    process.send_signal(signal.SIGINT)
    _, said = process.communicate(timeout=60)
    assert process.returncode == 130, said
    assert "--resume continues from it" in said
    assert "Traceback" not in said
    assert checkpoint.read(tmp_path)["counters"]["decisions"] >= 50


def test_train_command_prints_its_result_and_refuses_a_used_folder(tmp_path, capsys):
    words = ["train", "--decisions", "40", "--trip-duration", "10", "--validation-trips", "1"]
    words += ["--validation-duration", "10", "--warm-up", "10", "--jobs", "1"]
    assert cli.main([*words, "--out", str(tmp_path)]) == 0
    said = capsys.readouterr().out
    assert re.search(r"^4\d|^[5-9]\d decisions in", said)
    assert str(tmp_path / "ddqn.npz") in said
    # The same folder without --resume must not overwrite the first training.
    assert cli.main([*words, "--out", str(tmp_path)]) == 2
    assert "--resume" in capsys.readouterr().err


def test_workers_run_on_one_thread_without_torch(tmp_path):
    before = dict(os.environ)
    train(small(decisions=10, fast_decisions=0), tmp_path, world=TorchlessWorld)
    assert dict(os.environ) == before


@pytest.mark.parametrize(
    ("world", "reason"),
    [
        (FailingWorld, r"training trip 0 of round 0: ValueError: the trailer is gone"),
        (DyingWorld, r"training trip 0 of round 0: its process ended with exit code 9"),
        (BlindWorld, r"training trip 0 of round 0: InputError: observation: .* is nan"),
    ],
)
def test_the_error_of_a_failed_trip_names_trip_and_reason(tmp_path, world, reason):
    config = small(fast_decisions=0, jobs=1, epsilon_start=0.0)
    with pytest.raises(Error, match=reason):
        train(config, tmp_path, world=world)


def test_the_checkpoint_remains_after_a_worker_dies(tmp_path):
    with pytest.raises(Error, match="exit code 9"):
        train(small(fast_decisions=60), tmp_path, world=DyingWorld)
    assert 30 <= checkpoint.read(tmp_path)["counters"]["decisions"] < 100


@pytest.fixture
def stored(tmp_path):
    """Folder of a short training."""
    train(small(decisions=10, jobs=1), tmp_path)
    return tmp_path


def test_resuming_with_other_settings_is_refused_by_name(stored):
    for change in ({"mirror": False}, {"dueling": False}, {"seed": 7}, {"learning_rate": 1e-3}):
        ((name, _),) = change.items()
        with pytest.raises(InputError, match=f"resume: {name.replace('_', '-')} is"):
            train(small(**{"decisions": 20, "resume": True, **change}), stored)
    with pytest.raises(InputError, match=r"resume: world is 'FlatWorld'.* has 'fast world"):
        train(small(decisions=200_000, resume=True), stored, world=FlatWorld)


def test_a_damaged_or_missing_checkpoint_is_refused(stored, tmp_path):
    with pytest.raises(InputError, match="no checkpoint"):
        train(small(resume=True), tmp_path / "nothing")
    path = stored / "checkpoint.pt"
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)
    with pytest.raises(InputError, match="not usable: it is damaged"):
        train(small(resume=True), stored)
    path.write_bytes(b"nonsense")
    with pytest.raises(InputError, match="not usable: its format is 'nonsense'"):
        train(small(resume=True), stored)


@pytest.mark.parametrize(
    "change",
    [
        {"decisions": 0},
        {"epsilon_end": 2.0},
        {"warm_up": 10**7},
        {"learning_rate": np.nan},
        {"batch_size": 0},
        {"guided_share": 1.1},
        {"gap": -0.1},
        {"jobs": 0},
        {"dueling": 1},
        {"trips_per_round": 2.5},
    ],
)
def test_settings_out_of_bounds_are_refused_by_name(change):
    with pytest.raises(InputError, match=next(iter(change)).replace("_", "-")):
        TrainConfig(**change)


def test_a_second_stage_without_decisions_is_refused(tmp_path):
    with pytest.raises(InputError, match="fast-decisions 120 is not allowed"):
        train(small(fast_decisions=120), tmp_path, world=FlatWorld)


def test_training_trips_mix_the_six_cells_with_randomized_traffic():
    random = np.random.default_rng(0)
    trips = [sample_trip(TrainConfig(), random) for _ in range(400)]
    cells = [t for t in trips if t.payload == TripConfig().payload]
    assert 0.5 < len(cells) / len(trips) < 0.7
    assert len({(t.spawn_probability, t.traffic_speed) for t in cells}) == 6
    others = [t for t in trips if t.payload != TripConfig().payload]
    for figure, low, high in (
        ("spawn_probability", 0.005, 0.12),
        ("traffic_speed", 11.0, 16.0),
        ("payload", 0.0, 36_000.0),
    ):
        values = np.sort([getattr(t, figure) for t in others])
        assert low <= values[0] < low + 0.1 * (high - low)
        assert high - 0.1 * (high - low) < values[-1] <= high


def test_trips_start_at_random_places_and_fit_on_the_road():
    random = np.random.default_rng(0)
    for duration in (10.0, 300.0, 5000.0):
        trips = [sample_trip(TrainConfig(trip_duration=duration), random) for _ in range(200)]
        ends = [t.start_station + t.length for t in trips]
        assert max(ends) <= TripConfig.length + 1e-6
        assert min(t.start_station for t in trips) >= 60.0
        # A trip ends by its duration, not by its length, unless the road is too short.
        assert all(
            t.length >= min(t.reference_speed * duration, TripConfig.length - 60.0) for t in trips
        )
    starts = [
        sample_trip(TrainConfig(trip_duration=300.0), random).start_station for _ in range(200)
    ]
    assert min(starts) < 600.0
    assert max(starts) > 9_000.0


def test_all_trips_use_the_configured_charge_and_discount():
    config = TrainConfig(change_charge=25.0, discount=0.97)
    trips = [trip for _, trip, _ in validation_trips(config, 1)]
    trips += [sample_trip(config, np.random.default_rng(k)) for k in range(5)]
    assert {(t.reward.change, t.reward.discount, t.reward.danger) for t in trips} == {
        (25.0, 0.97, 20.0)
    }


def test_validation_trips_are_the_same_each_time_and_start_at_different_places():
    config = TrainConfig(validation_duration=600.0)
    first, second = list(validation_trips(config, 3)), list(validation_trips(config, 3))
    assert len(first) == 6 * 3
    assert [trip for _, trip, _ in first] == [trip for _, trip, _ in second]
    assert [g.random() for *_, g in first] == [g.random() for *_, g in second]
    assert len({trip.start_station for _, trip, _ in first}) == 18


def test_training_without_torch_names_the_install_command(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "torch", None)
    with pytest.raises(InputError, match=r"needs torch: pip install 'iits-mj\[train\]'"):
        train(TrainConfig(decisions=100), tmp_path)


def test_a_checkpoint_of_other_content_with_a_right_checksum_is_refused(tmp_path):
    import torch

    stream = io.BytesIO()
    torch.save({"learner": {}, "settings": {}}, stream)
    payload = stream.getvalue()
    header = f"{checkpoint.FORMAT} {hashlib.sha256(payload).hexdigest()}\n"
    (tmp_path / checkpoint.CHECKPOINT).write_bytes(header.encode() + payload)
    with pytest.raises(InputError, match="resume"):
        train(TrainConfig(decisions=100, resume=True), tmp_path)
