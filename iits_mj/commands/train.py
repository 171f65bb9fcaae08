"""Train the decision maker ("ddqn") in the fast highway world.

Leaves in --out: ddqn.npz (the best policy so far, for 'iits-mj drive --decision ddqn'),
training.csv and a checkpoint that --resume continues from. Needs torch: pip install
'iits-mj[train]'.
"""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

from tqdm import tqdm

from controllers.decision.training import TrainConfig, train
from iits_mj import options as option_fields
from iits_mj.commands.output import prepare_folder
from iits_mj.options import option

_DEFAULTS = TrainConfig()


@dataclass(frozen=True, kw_only=True)
class Options:
    """Flags of `iits-mj train`."""

    out: Path = option(Path("out/train"), help="folder for weights and log", metavar="DIR")
    decisions: int = option(
        _DEFAULTS.decisions, help="decisions of the truck, one a second", low=1, high=10**9
    )
    trip_duration: float = option(
        _DEFAULTS.trip_duration, help="length of a trip", unit="s", low=10.0, high=1e5, metavar="S"
    )
    learning_rate: float = option(
        _DEFAULTS.learning_rate, help="of Adam", low=1e-8, high=1.0, metavar="RATE"
    )
    seed: int = option(_DEFAULTS.seed, help="the one seed of everything", low=0, high=2**31 - 1)
    resume: bool = option(False, help="continue from the checkpoint in --out")
    json: bool = option(False, help="print the outcome as one JSON object")

    def __post_init__(self) -> None:
        option_fields.check(self)


def run(options: Options) -> int:
    """Trains and says where the weights are."""
    prepare_folder(options.out)
    config = TrainConfig(
        decisions=options.decisions,
        seed=options.seed,
        trip_duration=options.trip_duration,
        learning_rate=options.learning_rate,
        resume=options.resume,
    )
    with tqdm(total=options.decisions, unit=" decisions", disable=None) as bar:
        summary = train(
            config,
            options.out,
            progress=lambda done, _: _move(bar, done),
            command=" ".join(["iits-mj", *sys.argv[1:]]),
        )
    outcome = {
        "weights": str(summary.weights),
        "log": str(summary.log),
        "score": summary.score,
        "decisions": summary.decisions,
        "wall_time_s": summary.wall_time,
    }
    if options.json:
        print(json.dumps({"command": "train", "seed": options.seed, **outcome}))
    else:
        print(f"{summary.decisions} decisions in {summary.wall_time:.0f} s")
        print(f"best validation score: {summary.score:.3f}")
        print(f"weights: {summary.weights}")
        print(f"log: {summary.log}")
    return 0


def _move(bar: tqdm[NoReturn], done: int) -> None:
    bar.update(done - bar.n)
