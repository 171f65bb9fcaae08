"""Tasks on a Ray cluster of three nodes on this machine, and training by RLlib."""

import dataclasses
import functools
import math
import os
import signal
import subprocess
import sys
import time

import pytest

from iits_mj import cli
from iits_mj.core.errors import Error, InputError
from iits_mj.evaluation.trials import read_trials
from iits_mj.scale.ray_executor import ClusterError, RayExecutor
from tests.paths import ROOT

ray = pytest.importorskip("ray")
NODES = 3


def same():
    return "the same code"


def square(x):
    return x * x


def refuse(x):
    raise Error(f"cannot do {x}")


def fail(x):
    raise ZeroDivisionError("by nothing")


def where(seconds):
    time.sleep(seconds)
    return ray.get_runtime_context().get_node_id()


def die_once(flag, x):
    if not os.path.exists(flag):
        open(flag, "w").close()
        os.kill(os.getpid(), signal.SIGKILL)
    return x + 1


def threads():
    return os.environ["OPENBLAS_NUM_THREADS"]


@pytest.fixture(scope="module")
def cluster():
    from ray.cluster_utils import Cluster

    # Workers cannot import this module.
    ray.cloudpickle.register_pickle_by_value(sys.modules[__name__])
    os.environ["RAY_USAGE_STATS_ENABLED"] = "0"
    node = {"num_cpus": 1, "object_store_memory": 80_000_000}
    cluster = Cluster(initialize_head=True, head_node_args={**node, "include_dashboard": False})
    for _ in range(NODES - 1):
        cluster.add_node(**node)
    yield cluster.address
    cluster.shutdown()


@pytest.fixture
def executor(cluster):
    made = RayExecutor(cluster, same)
    yield made
    made.shutdown(cancel_futures=True)


def test_tasks_run_on_all_nodes_with_one_thread_each(executor):
    assert executor.cores == NODES
    assert list(executor.map(square, range(5))) == [0, 1, 4, 9, 16]
    assert len(set(executor.map(where, [0.5] * 6))) == NODES
    assert executor.submit(threads).result() == "1"
    assert executor.submit(square, executor.share(7)).result() == 49


def test_an_error_of_a_task_is_reported_without_a_traceback(executor):
    with pytest.raises(Error, match=r"^cannot do 3$"):
        executor.submit(refuse, 3).result()
    with pytest.raises(ClusterError, match="by nothing"):
        executor.submit(fail, 3).result()


@pytest.mark.slow
def test_the_task_of_a_killed_worker_is_repeated(executor, tmp_path):
    flag = tmp_path / "died"
    futures = [executor.submit(die_once, str(flag), x) for x in range(4)]
    assert [future.result() for future in futures] == [1, 2, 3, 4]
    assert flag.exists()


def differs_in_the_head(head):
    return "123456789abcdef" if os.getpid() == head else same()


def test_another_version_of_the_code_is_refused(cluster):
    executor = RayExecutor(cluster, functools.partial(differs_in_the_head, os.getpid()))
    with pytest.raises(Error, match=r"another version of the code .the same cod. than the head"):
        executor.submit(square, 2).result()
    executor.shutdown()


def test_waiting_tasks_are_cancelled_and_new_ones_are_refused_after_shutdown(cluster):
    executor = RayExecutor(cluster, same)
    futures = [executor.submit(time.sleep, 30.0) for _ in range(20)]
    executor.shutdown(cancel_futures=True)
    assert sum(future.cancelled() for future in futures) >= 5
    # No task ended by itself: the running ones were stopped as well.
    assert all(future.cancelled() or future.exception() is not None for future in futures)
    with pytest.raises(RuntimeError, match="after shutdown"):
        executor.submit(square, 1)


@pytest.mark.parametrize("address", ["127.0.0.1:1", "head", "127.0.0.1:port", "127.0.0.1:99999"])
def test_an_address_without_a_cluster_is_named(address):
    with pytest.raises(ClusterError, match=f"no Ray cluster at '{address}'"):
        RayExecutor(address, same)


def _evaluate(file, *flags):
    return [
        "evaluate", "--world", "fast", "--trials", "2", "--cells", "dense-12.5", "--length",
        "1500", "--methods", "aggressive,mobil", "--file", str(file), *flags,
    ]  # fmt: skip


def _rows(file):
    """Returns the rows of a trial file without their wall-clock times."""
    rows = read_trials(file, print).values()
    return sorted(repr(dataclasses.replace(row, wall_time=math.nan)) for row in rows)


def test_evaluate_gives_the_trials_of_one_machine(cluster, tmp_path, capsys):
    here, there = tmp_path / "here.csv", tmp_path / "there.csv"
    cli.main(_evaluate(here))
    cli.main(_evaluate(there, "--ray", cluster, "--shard", "2"))
    assert _rows(there) == _rows(here)
    assert len(_rows(here)) == 5
    assert not (tmp_path / "there.csv.shards").exists()


@pytest.mark.slow
def test_a_new_head_continues_with_the_finished_shards(cluster, tmp_path):
    file = tmp_path / "trials.csv"
    shards = tmp_path / "trials.csv.shards"
    command = _evaluate(file, "--trials", "16", "--ray", cluster, "--shard", "3")
    program = [sys.executable, "-m", "iits_mj.cli", *command]
    first = subprocess.Popen(program, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    deadline = time.monotonic() + 90.0
    while len(list(shards.glob("*.csv"))) < 2 and time.monotonic() < deadline:
        time.sleep(0.05)
    first.send_signal(signal.SIGKILL)
    first.wait()
    finished = {path: path.stat().st_mtime_ns for path in shards.glob("*.csv")}
    assert 2 <= len(finished) < 11
    # An incomplete row, as after a kill during writing.
    with file.open("a") as stream:
        stream.write("full,dense")
    subprocess.run(program, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, check=False)
    here = tmp_path / "here.csv"
    cli.main(_evaluate(here, "--trials", "16", "--jobs", "2"))
    assert _rows(file) == _rows(here)
    assert not shards.exists()


def test_evaluation_on_a_cluster_requires_a_file(cluster, capsys):
    command = _evaluate("x.csv", "--ray", cluster)
    del command[command.index("--file") : command.index("--file") + 2]
    assert cli.main(command) == 2
    assert "--ray needs a file for the trials: add --file" in capsys.readouterr().err


def test_an_error_without_ray_names_the_install_command(monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(InputError, match=r"pip install 'iits-mj\[scale\]'"):
        RayExecutor("local", same)


@pytest.mark.slow
def test_training_on_a_cluster_is_bit_identical_to_one_machine(cluster, tmp_path):
    pytest.importorskip("torch")
    from controllers.decision.policy import QNetwork

    for folder, flags in (("here", ()), ("there", ("--ray", cluster))):
        command = [
            "train", "--out", str(tmp_path / folder), "--decisions", "120", "--trip-duration", "10",
            "--trips-per-round", "2", "--warm-up", "20", "--evaluate-interval", "60",
            "--validation-trips", "1", "--validation-duration", "10", *flags,
        ]  # fmt: skip
        assert cli.main(command) == 0
    here, there = (
        sorted((tmp_path / folder / "policies").iterdir()) for folder in ("here", "there")
    )
    assert [path.name for path in here] == [path.name for path in there]
    for one, other in zip(here, there, strict=True):
        for ours, theirs in zip(
            QNetwork.load(one).weights, QNetwork.load(other).weights, strict=True
        ):
            assert (ours == theirs).all()


@pytest.mark.slow
def test_ppo_of_rllib_trains_on_the_highway():
    """RLlib's workers import iits_mj because of the prefix of the environment's name."""
    pytest.importorskip("torch")
    ppo = pytest.importorskip("ray.rllib.algorithms.ppo", exc_type=ImportError)
    os.environ["RAY_USAGE_STATS_ENABLED"] = "0"
    ray.init(
        address="local", num_cpus=2, include_dashboard=False, log_to_driver=False,
        object_store_memory=100_000_000,
    )  # fmt: skip
    try:
        config = (
            ppo.PPOConfig()
            .environment("iits_mj:iits_mj/HighwayFast-v0", env_config={"duration": 30.0})
            .env_runners(num_env_runners=1, rollout_fragment_length=64)
            .training(train_batch_size=128, minibatch_size=64, num_epochs=2)
        )
        algorithm = config.build_algo()
        found = algorithm.train()
        assert found["num_env_steps_sampled_lifetime"] == 128
        # In the worst case every decision is a refused lane change.
        assert -30.0 * 40.0 < found["env_runners"]["episode_return_mean"] < 0.0
        algorithm.stop()
    finally:
        ray.shutdown()


@pytest.mark.slow
def test_tasks_of_a_lost_node_run_on_another_node():
    from ray.cluster_utils import Cluster

    ray.cloudpickle.register_pickle_by_value(sys.modules[__name__])
    node = {"num_cpus": 1, "object_store_memory": 80_000_000}
    own = Cluster(initialize_head=True, head_node_args={**node, "include_dashboard": False})
    lost = own.add_node(**node)
    executor = RayExecutor(own.address, same)
    try:
        list(executor.map(square, range(4)))
        futures = [executor.submit(where, 4.0) for _ in range(4)]
        time.sleep(1.0)
        own.remove_node(lost, allow_graceful=False)
        assert len({future.result(timeout=120.0) for future in futures}) == 1
    finally:
        executor.shutdown(cancel_futures=True)
        own.shutdown()


@pytest.mark.slow
def test_montecarlo_gives_the_results_of_one_machine(cluster, tmp_path):
    tables = []
    for folder, flags in (("here", ()), ("there", ("--ray", cluster, "--shard", "1"))):
        out = tmp_path / folder
        assert cli.main(["montecarlo", "--samples", "2", "--folder", str(out), *flags]) == 0
        rows = [line.split(",") for line in (out / "samples.csv").read_text().splitlines()]
        clock = rows[0].index("wall_time")
        tables.append([row[:clock] + row[clock + 1 :] for row in rows])
    assert tables[0] == tables[1]
    assert len(tables[0]) == 4


@pytest.mark.slow
def test_a_sweep_has_the_rows_of_one_machine(cluster, tmp_path):
    words = [
        str(ROOT / "examples/cut_in.toml"),
        "--traffic-mode",
        "none",
        "--plant",
        "yaw-sideslip",
    ]
    words += ["--duration", "3", "--param", "gap=5,15", "--param", "payload=0,9000", "--shard", "1"]
    words += ["--plant", "yaw-sideslip"]
    tables = []
    for folder, flags in (("here", ("--jobs", "2")), ("there", ("--ray", cluster))):
        out = tmp_path / folder
        assert cli.main(["sweep", *words, "--out", str(out), *flags]) == 0
        tables.append((out / "runs.csv").read_bytes())
    assert tables[0] == tables[1]
    assert tables[0].count(b"comfortable") == 4
