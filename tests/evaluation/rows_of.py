"""Artificial trials for tests of files, figures and pages."""

import math
import os
from pathlib import Path

from iits_mj.evaluation.trials import Task, Trial
from iits_mj.parameters import label_of


def trial(task: Task, loss: float, changes: int = 3, **figures) -> Trial:
    known = {
        "speed_loss": loss,
        "speed_error": loss * 60.0 / 3.6,
        "changes": changes,
        "asked": changes + 1,
        "refused": 1,
        "unsafe": 1,
        "collisions": 0,
        "failures": 0,
        "ended": "reached the end of the route",
        "time_gap": 1.5,
        "close_share": 0.01,
        "box_distance": 0.9,
        "fuel": 4.0,
        "distance": 14_930.0,
        "time": 14_930.0 / (1.0 - loss) * 3.6 / 60.0,
        "wall_time": 60.0,
        "code": "0123456789ab",
        "imposed_brakings": 1.0,
        "imposed_deceleration": 0.8,
        "collision_time_front": 20.0,
        "collision_time_rear": math.inf,
        "change_time_gap_front": 2.5,
        "change_time_gap_rear": 1.2,
        "right_share": 0.6,
        "beside_share": 0.2,
    }
    return Trial(**vars(task), **(known | figures))


def task(method: str, seed: int, cell=("dense", 12.5), weights: str = "") -> Task:
    limits = (12_000.0, 0.002, 15_000.0, 3_000.0)
    return Task("full", *cell, method, weights, label_of(None), *limits, seed)


def rows(losses, cell=("dense", 12.5), floor: float = 0.01, changes=None):
    """Trials of a cell from losses by method, and its free road."""
    made = [
        trial(task(name, seed, cell), loss, (changes or {}).get(name, 3))
        for name, values in losses.items()
        for seed, loss in enumerate(values)
    ]
    return [*made, trial(task("keep", 0, ("empty", cell[1])), floor, time_gap=math.inf)]


def die_once(mark: Path, asked: Task) -> Trial:
    """A drive whose process dies the first time."""
    if asked.seed == 3 and not mark.exists():
        mark.touch()
        os._exit(1)
    return trial(asked, 0.1)
