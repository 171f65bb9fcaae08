"""Train the decision maker "ddqn".

--learner double-dqn trains the paper's policy, which has one price of a lane change. It writes into
--out: ddqn.npz (the best policy so far), the policy of every validation, training.csv, event files
for TensorBoard, and a checkpoint, also after Ctrl-C.

--learner roll-outs trains one policy for every price. It writes into --out: priced.npz, the policy
of every round, and the labels. Its settings are --rounds to --members; of the others it uses
--seed, --jobs, --resume and --out.

--resume continues a training with the same settings. Needs torch: pip install 'iits-mj[train]'.
"""

from __future__ import annotations

import functools
import json
import math
import sys
import time
from dataclasses import dataclass
from pathlib import Path

from controllers.decision.learning.collection import Interrupted, MakeDrivers, WorldFactory
from controllers.decision.learning.config import RolloutConfig, TrainConfig
from controllers.decision.learning.priced_training import train_priced
from controllers.decision.learning.training import train
from iits_mj.commands.output import prepare_folder
from iits_mj.core.errors import InputError
from iits_mj.core.options import option
from iits_mj.core.progress import remark, task


@dataclass(frozen=True, kw_only=True)
class Options(RolloutConfig, TrainConfig):
    """Flags of `iits-mj train`: the settings of the training, and its output."""

    learner: str = option(
        "double-dqn",
        help="double-dqn: the paper's policy, with one price of a lane change; roll-outs: one "
        "policy for every price",
        choices=("double-dqn", "roll-outs"),
        group="run",
    )

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

    def __post_init__(self) -> None:
        TrainConfig.__post_init__(self)
        if self.learner == "roll-outs" and (self.world != "fast" or self.ray is not None):
            raise InputError("learner roll-outs drives in the fast world alone, without --ray")


def run(options: Options) -> int:
    """Trains and prints the outcome; returns the exit code."""
    prepare_folder(options.out)
    if options.learner == "roll-outs":
        return _by_roll_outs(options)
    with task("training", options.decisions, "decisions") as report:
        try:
            summary = train(
                options,
                options.out,
                progress=lambda done, _: report(done),
                command=_command(),
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


def _by_roll_outs(options: Options) -> int:
    """Trains the policy for every price and prints the outcome; returns the exit code."""
    began = time.monotonic()
    with task("training", unit="chunks of labels") as report:
        weights = train_priced(
            options,
            options.out,
            seed=options.seed,
            jobs=options.jobs,
            resume=options.resume,
            progress=lambda done, total: report(done, total=total),
            command=_command(),
        )
    seconds = time.monotonic() - began
    if options.json:
        outcome = {"weights": str(weights), "wall_time_s": seconds}
        print(json.dumps({"command": "train", "seed": options.seed, **outcome}))
    else:
        print(f"weights: {weights} ({seconds:.0f} s)")
    return 0


def _command() -> str:
    return " ".join(["iits-mj", *sys.argv[1:]])


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
