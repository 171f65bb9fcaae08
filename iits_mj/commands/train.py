"""Train the decision maker "ddqn".

Writes into --out: ddqn.npz (the best policy so far), the policy of every validation, training.csv,
event files for TensorBoard, and a checkpoint, also after Ctrl-C. --resume continues from the
checkpoint with the same settings. Needs torch: pip install 'iits-mj[train]'.
"""

from __future__ import annotations

import functools
import json
import math
import sys
from dataclasses import dataclass
from pathlib import Path

from controllers.decision.learning.collection import Interrupted, MakeDrivers, WorldFactory
from controllers.decision.learning.config import TrainConfig
from controllers.decision.learning.training import train
from iits_mj.commands.output import prepare_folder
from iits_mj.core.options import option
from iits_mj.core.progress import remark, task


@dataclass(frozen=True, kw_only=True)
class Options(TrainConfig):
    """Flags of `iits-mj train`: the settings of the training, and its output."""

    out: Path = option(
        Path("out/train"), help="folder for weights and log", metavar="DIR", group="output"
    )
    world: str = option(
        "fast",
        help="fast: point masses; truck: point masses, then the MuJoCo truck in SUMO traffic",
        choices=("fast", "truck"),
        group="run",
    )
    ray: str | None = option(
        None,
        help="drive the trips on a Ray cluster: HOST:PORT of its head, auto, or local; learning "
        "stays on this machine",
        metavar="ADDRESS",
        group="run",
    )
    json: bool = option(False, help="print the outcome as one JSON object", group="output")


def run(options: Options) -> int:
    """Trains and prints the outcome; returns the exit code."""
    prepare_folder(options.out)
    with task("training", options.decisions, "decisions") as report:
        try:
            summary = train(
                options,
                options.out,
                progress=lambda done, _: report(done),
                command=" ".join(["iits-mj", *sys.argv[1:]]),
                world=_world(options.world),
                note=remark,
                drivers=_drivers(options.ray),
            )
        except Interrupted:
            remark(f"the checkpoint is in {options.out}; --resume continues from it")
            raise
    score = summary.score if math.isfinite(summary.score) else None
    outcome = {
        "weights": None if summary.weights is None else str(summary.weights),
        "log": str(summary.log),
        "score": score,
        "decisions": summary.decisions,
        "wall_time_s": summary.wall_time,
    }
    if options.json:
        print(json.dumps({"command": "train", "seed": options.seed, **outcome}))
        return 0
    print(f"{summary.decisions} decisions in {summary.wall_time:.0f} s")
    if summary.weights is None:
        print("no best policy: every policy collided in its validation")
    else:
        print(f"best validation score: {summary.score:.3f}")
        print(f"weights: {summary.weights}")
    print(f"log: {summary.log}")
    return 0


def _world(name: str) -> WorldFactory | None:
    """Returns the world of the second stage; None without this stage."""
    if name == "fast":
        return None
    from iits_mj.simulation.truck_world import TruckWorld

    return TruckWorld


def _drivers(address: str | None) -> MakeDrivers | None:
    """Returns a maker of cluster workers; None for processes of this machine."""
    if address is None:
        return None
    from iits_mj.scale.ray_executor import ClusterDrivers

    return functools.partial(ClusterDrivers, address)
