"""`iits-mj evaluate`: the paper's table of decision makers over six traffic cells, paired seeds."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.stats import t as student

from controllers.decision import NAMES
from iits_mj import options
from iits_mj.errors import InputError
from iits_mj.options import option
from iits_mj.results import Check, Results
from iits_mj.validation import trials as trial_files
from iits_mj.validation.trials import CELLS, Trial

# The paper's table: speed loss [%] of its methods per cell. "10.0" of sparse, 15, aggressive is as
# printed, probably 1.0.
PAPER_LOSS_PERCENT = {
    ("dense", 12.5): {"conservative": 38.9, "neutral": 28.5, "aggressive": 24.5, "ddqn": 24.0},
    ("dense", 15.0): {"conservative": 30.9, "neutral": 20.1, "aggressive": 18.8, "ddqn": 17.3},
    ("medium", 12.5): {"conservative": 14.1, "neutral": 13.8, "aggressive": 6.6, "ddqn": 8.0},
    ("medium", 15.0): {"conservative": 4.4, "neutral": 1.6, "aggressive": 1.6, "ddqn": 1.4},
    ("sparse", 12.5): {"conservative": 5.9, "neutral": 3.4, "aggressive": 4.4, "ddqn": 3.4},
    ("sparse", 15.0): {"conservative": 1.0, "neutral": 1.0, "aggressive": 10.0, "ddqn": 1.0},
}
RULES = ("conservative", "neutral", "aggressive")
DEFAULT_METHODS = "conservative,neutral,aggressive,mobil,ddqn"


@dataclass(frozen=True, kw_only=True)
class EvaluateConfig:
    """Which decision makers, in which world, how often."""

    trials: int = option(30, help="trips of each method in each cell", low=1, high=1_000)
    methods: str = option(
        DEFAULT_METHODS, help="decision makers, separated by commas", metavar="NAMES"
    )
    world: str = option(
        "fast",
        help="fast: point-mass truck in numpy traffic; full: MuJoCo truck in SUMO traffic",
        choices=("fast", "full"),
    )
    length: float = option(
        15_000.0, help="of a trip in the fast world", unit="m", low=500.0, high=1e5, metavar="M"
    )
    duration: float = option(
        1_200.0, help="of a trip in the full world", unit="s", low=10.0, high=1e5, metavar="S"
    )
    seed: int = option(0, help="another set of test trips", low=0, high=1_000)
    file: Path | None = option(
        None, help="file of trials; those in it are not driven again", metavar="FILE.csv"
    )

    def __post_init__(self) -> None:
        options.check(self)
        for name in self.names():
            if name not in NAMES:
                raise InputError(f"method {name!r} is unknown; allowed are: {', '.join(NAMES)}")

    def names(self) -> tuple[str, ...]:
        """The methods."""
        return tuple(name.strip() for name in self.methods.split(","))


def run(config: EvaluateConfig, progress: Callable[[int, int], None] | None = None) -> Results:
    """Drives what is missing in the file of trials and makes the table.

    Args:
      config: settings.
      progress: called with (trials done, trials in all).

    Raises:
      InputError: a method is unknown, the file of trials is not usable, or weights are missing.
    """
    done = trial_files.read_trials(config.file) if config.file is not None else []
    if config.file is not None:
        trial_files.rewrite_trials(config.file, done)
    known = {trial.key: trial for trial in done}
    chosen: list[Trial] = []
    jobs = [
        (density, speed, name, trial_files.trial_seed(cell, number, config.seed))
        for number in range(config.trials)
        for cell, (density, speed) in enumerate(CELLS)
        for name in config.names()
    ]
    for count, (density, speed, name, seed) in enumerate(jobs, start=1):
        trial = known.get((config.world, density, speed, name, seed))
        if trial is None:
            trial = _drive(config, density, speed, name, seed)
            if config.file is not None:
                trial_files.append_trial(config.file, trial)
        chosen.append(trial)
        if progress is not None:
            progress(count, len(jobs))
    return summarize(chosen, config)


def summarize(trials: list[Trial], config: EvaluateConfig) -> Results:
    """Means, standard deviations and 95 % intervals per cell and method, and the paired claims."""
    results = Results("evaluate", seed=config.seed)
    world = {
        "fast": "fast world: point-mass truck in numpy IDM and MOBIL traffic, no SUMO, no MuJoCo",
        "full": "full chain: MuJoCo truck, planner and tracking in SUMO traffic",
    }[config.world]
    results.notes = [f"{world}; {config.trials} trips a cell and method, paired seeds", ""]
    results.notes.append(
        "cell           method        speed loss [%]: mean  std  95 %    changes: mean  std   "
        "refused  collisions"
    )
    for density, speed in CELLS:
        cell = f"{density} {speed:g}"
        rows = {
            name: [
                t
                for t in trials
                if (t.density, t.traffic_speed, t.method) == (density, speed, name)
            ]
            for name in config.names()
        }
        for name, own in rows.items():
            loss = 100.0 * np.array([t.speed_loss for t in own])
            changes = np.array([t.changes for t in own], dtype=float)
            refused = float(np.mean([t.refused for t in own]))
            hits = sum(t.collisions for t in own)
            results.notes.append(
                f"{cell:14s} {name:14s} {loss.mean():18.2f} {_std(loss):5.2f} "
                f"±{half_width(loss):4.2f} {changes.mean():17.2f} {_std(changes):5.2f} "
                f"{refused:8.1f} {hits:9d}"
            )
            reference = PAPER_LOSS_PERCENT[density, speed].get(name)
            label = f"{cell}, {name}: "
            results.checks.append(Check(label + "speed loss", float(loss.mean()), "%", reference))
            results.checks.append(Check(label + "lane changes", float(changes.mean()), "1"))
            results.checks.append(Check(label + "collisions", float(hits), "1", None, "<= 0"))
        results.checks += _claims(cell, rows)
    return results


def half_width(values: np.ndarray) -> float:
    """Half of the 95 % interval of the mean, Student's t; 0 for a single value."""
    if values.size < 2:
        return 0.0
    quantile = float(student.ppf(0.975, values.size - 1))
    return quantile * _std(values) / math.sqrt(values.size)


def _claims(cell: str, rows: dict[str, list[Trial]]) -> list[Check]:
    """The trained policy against the best of the paper's rules, trip by trip."""
    rules = {name: rows[name] for name in RULES if name in rows}
    if "ddqn" not in rows or not rules:
        return []
    means = {name: float(np.mean([t.speed_loss for t in own])) for name, own in rules.items()}
    best = min(means, key=lambda name: means[name])
    paired = [
        100.0 * (a.speed_loss - b.speed_loss)
        for a, b in zip(rows["ddqn"], rules[best], strict=True)
    ]
    claims = [
        Check(
            f"{cell}: speed loss, ddqn less {best}, paired",
            float(np.mean(paired)),
            "% points",
            f"±{half_width(np.array(paired)):.2f}",
            "<= 0.1",
        )
    ]
    if "aggressive" in rows:
        more = np.mean([t.changes for t in rows["ddqn"]])
        more -= np.mean([t.changes for t in rows["aggressive"]])
        claims.append(
            Check(f"{cell}: lane changes, ddqn less aggressive", float(more), "1", None, "<= 0")
        )
    return claims


def _drive(config: EvaluateConfig, density: str, speed: float, name: str, seed: int) -> Trial:
    if config.world == "fast":
        return trial_files.run_fast(density, speed, name, seed, config.length)
    return trial_files.run_full(density, speed, name, seed, config.duration)


def _std(values: np.ndarray) -> float:
    return float(values.std(ddof=1)) if values.size > 1 else 0.0
