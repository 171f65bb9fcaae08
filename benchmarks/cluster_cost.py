"""Costs on which the plan for a cluster rests: a task, a shard and a row, on this machine.

    python benchmarks/cluster_cost.py

Measures one core's work (a trip of the full chain and of the fast world, a Monte-Carlo truck), the
throughput of a head with a local cluster of three nodes in processes, and the size of a shard.
"""

from __future__ import annotations

import argparse
import dataclasses
import os
import tempfile
import time
from pathlib import Path

from iits_mj.core.timing import TIMESTEP
from iits_mj.evaluation import evaluate
from iits_mj.evaluation.drives import drive
from iits_mj.evaluation.parameter_uncertainty import NOMINAL, SampleTask, measure
from iits_mj.evaluation.trials import Task, Trial
from iits_mj.parameters import label_of
from iits_mj.scale import RayExecutor, Shards

NODES = 3


def digest() -> str:
    return "this"


def nothing(number: int) -> int:
    return number


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--tasks", type=int, default=2_000, help="empty tasks for the head")
    asked = parser.parse_args()
    config = evaluate.EvaluateConfig(trials=1, methods="ddqn", cells="medium-12.5", timestep=0.005)
    task = evaluate.tasks_of(config)[-1]
    trial = _timed("a trip of 15 km, full chain, 5 ms", lambda: drive(task))
    fast: Task = dataclasses.replace(task, world="fast")
    _timed("the same in the fast world", lambda: drive(fast))
    _timed(
        "a Monte-Carlo truck",
        lambda: measure(SampleTask(NOMINAL, label_of(None), 36_000.0, TIMESTEP, "")),
    )
    with tempfile.TemporaryDirectory() as folder:
        shards = Shards(Path(folder), Trial, "trials")
        rows = [dataclasses.replace(trial, seed=k) for k in range(50)]
        began = time.perf_counter()
        path = shards.keep([row.task for row in rows], rows)
        print(f"a shard of 50 rows: {path.stat().st_size} bytes, "
              f"{1e3 * (time.perf_counter() - began):.1f} ms to write")  # fmt: skip
    _head(asked.tasks)


def _head(tasks: int) -> None:
    from ray.cluster_utils import Cluster

    os.environ["RAY_USAGE_STATS_ENABLED"] = "0"
    node = {"num_cpus": 1, "object_store_memory": 80_000_000}
    cluster = Cluster(initialize_head=True, head_node_args={**node, "include_dashboard": False})
    for _ in range(NODES - 1):
        cluster.add_node(**node)
    executor = RayExecutor(cluster.address, digest)
    list(executor.map(nothing, range(50)))
    began = time.perf_counter()
    list(executor.map(nothing, range(tasks)))
    print(f"empty tasks through one head, {NODES} nodes on this machine: "
          f"{tasks / (time.perf_counter() - began):.0f} a second")  # fmt: skip
    executor.shutdown()
    cluster.shutdown()


def _timed(what: str, work):
    began = time.process_time()
    outcome = work()
    print(f"{what}: {time.process_time() - began:.1f} s of one core")
    return outcome


if __name__ == "__main__":
    main()
