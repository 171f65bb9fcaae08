"""`iits-mj evaluate`: the paper's table of decision makers over six traffic cells, paired seeds."""

from __future__ import annotations

import functools
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from controllers.decision import NAMES
from controllers.decision.policy import load_policy
from controllers.decision.trip import CELLS, SEEDS_EACH, TEST_SEEDS, VALIDATION_SEEDS, TripConfig
from iits_mj.core import options
from iits_mj.core.errors import InputError
from iits_mj.core.options import option
from iits_mj.core.process_pool import run_all
from iits_mj.evaluation import drives
from iits_mj.evaluation import trials as evaluate_rows
from iits_mj.evaluation.trials import EMPTY, WORLDS, Task, Trial, weights_digest
from iits_mj.parameters import payload_option
from iits_mj.simulation.loop import TIMESTEP
from iits_mj.validation.harness.statistics import half_width

SEEDS = {"test": TEST_SEEDS, "validation": VALIDATION_SEEDS}
DEFAULT_METHODS = "conservative,neutral,aggressive,mobil,lookahead,ddqn"
DEFAULT_CELLS = ",".join(f"{density}-{speed:g}" for density, speed in CELLS)
TRIALS_MAX, SETS_MAX = 1_000, 10


@dataclass(frozen=True, kw_only=True)
class EvaluateConfig:
    """Which decision makers, in which world, how often."""

    trials: int = option(30, help="trips of each method in each cell", low=1, high=TRIALS_MAX)
    methods: str = option(
        DEFAULT_METHODS, help="decision makers, separated by commas", metavar="NAMES"
    )
    cells: str = option(
        DEFAULT_CELLS, help="traffic cells, density and limit in m/s", metavar="CELLS"
    )
    weights: Path | None = option(
        None, help="policy of the method ddqn; without it the shipped one", metavar="FILE.npz"
    )
    world: str = option(
        "full",
        help="full: MuJoCo truck with its stack in SUMO traffic; fast: point mass in numpy traffic",
        choices=WORLDS,
    )
    payload: float = payload_option(TripConfig().payload)
    timestep: float = option(
        TIMESTEP,
        help="of the physics, a whole part of 0.02",
        unit="s",
        low=0.0005,
        high=0.005,
        metavar="S",
    )
    length: float = option(
        15_000.0,
        help="of a trip; it also ends with the road",
        unit="m",
        low=500.0,
        high=1e5,
        metavar="M",
    )
    duration: float = option(
        3_000.0,
        help="a trip that takes longer is cut off, and counts as failed",
        unit="s",
        low=10.0,
        high=1e5,
        metavar="S",
    )
    seeds: str = option(
        "test",
        help="trips; test: for figures only; validation: for choosing a policy",
        choices=tuple(SEEDS),
    )
    seed: int = option(0, help="another set of those trips", low=0, high=SETS_MAX - 1)
    jobs: int = option(1, help="processes at a time, a trip each", low=1, high=256)
    file: Path | None = option(
        None,
        help="file of trials; those in it are not driven again; with --report without it "
        "evaluate.csv beside the page",
        metavar="FILE.csv",
    )
    drive: bool = option(True, help="no-drive: figures of the file's trials alone")

    def __post_init__(self) -> None:
        options.check(self)
        for name in self.names():
            if name not in NAMES:
                raise InputError(f"method {name!r} is unknown; allowed are: {', '.join(NAMES)}")
        self.chosen_cells()

    def names(self) -> tuple[str, ...]:
        """The methods, each once."""
        return tuple(dict.fromkeys(name.strip() for name in self.methods.split(",")))

    def chosen_cells(self) -> tuple[tuple[str, float], ...]:
        """Density and traffic speed of the cells, in the paper's order.

        Raises:
          InputError: one is none of the paper's.
        """
        known = dict(zip(DEFAULT_CELLS.split(","), CELLS, strict=True))
        asked = [name.strip() for name in self.cells.split(",")]
        for name in asked:
            if name not in known:
                raise InputError(f"cell {name!r} is unknown; allowed are: {', '.join(known)}")
        return tuple(cell for name, cell in known.items() if name in asked)


def trial_seed(cell: int, trial: int, config: EvaluateConfig) -> int:
    """The seed that all methods share in a trial, within the million of its kind."""
    per_cell, per_set = TRIALS_MAX, SEEDS_EACH // SETS_MAX
    return SEEDS[config.seeds] + per_set * config.seed + per_cell * cell + trial


def tasks_of(config: EvaluateConfig) -> list[Task]:
    """What is to be driven: the free road, then all cells and methods trial by trial.

    Raises:
      InputError: the policy's file cannot be read.
    """
    digests = {name: weights_digest(name, config.weights) for name in config.names()}
    cells = config.chosen_cells()
    free = [
        _task(config, EMPTY, speed, "keep", "", 0)
        for speed in sorted({speed for _, speed in cells})
    ]
    return free + [
        _task(config, density, speed, name, digests[name], trial_seed(cell, number, config))
        for number in range(config.trials)
        for cell, (density, speed) in enumerate(CELLS)
        if (density, speed) in cells
        for name in config.names()
    ]


def run(
    config: EvaluateConfig,
    progress: Callable[[int, int], None] | None = None,
    say: Callable[[str], None] | None = None,
    drive_all: Callable[..., None] | None = None,
) -> list[Trial]:
    """Drives what is missing in the file of trials; all that were asked for.

    Args:
      config: settings.
      progress: called with (trials done, trials in all).
      say: is told what a reader should know; default: stderr.
      drive_all: drives tasks; default: `drive_trials`.

    Raises:
      InputError: the file of trials is not usable, or the weights are not.
      TasksError: some could not be driven; what was is in the file.
    """
    say = say or _to_stderr
    drive_all = drive_all or drive_trials
    wanted = tasks_of(config)
    if not config.drive:
        return _found(config, wanted, say)
    if "ddqn" in config.names():
        # Weights that cannot drive are refused before the first trial.
        load_policy(config.weights)
    if config.file is None:
        return _run(config, wanted, {}, progress, drive_all)
    with evaluate_rows.alone(config.file):
        known = evaluate_rows.read_trials(config.file, say)
        evaluate_rows.write_trials(config.file, known.values())
        try:
            return _run(config, wanted, known, progress, drive_all)
        finally:
            evaluate_rows.write_trials(config.file, known.values())


def drive_trials(
    tasks: Sequence[Task],
    jobs: int,
    drive: Callable[[Task], Trial],
    keep: Callable[[Trial], None],
) -> None:
    """Drives tasks in that many processes; see `side_by_side.run_all`."""
    run_all(tasks, jobs, drive, keep, describe, what="trials")


def describe(task: Task) -> str:
    """A trial in a few words."""
    return f"{task.density} {task.traffic_speed:g}, {task.method}, seed {task.seed}"


def _run(
    config: EvaluateConfig,
    wanted: list[Task],
    known: dict[Task, Trial],
    progress: Callable[[int, int], None] | None,
    drive_all: Callable[..., None],
) -> list[Trial]:
    """Drives what is not known yet and adds it to what is."""
    missing = [task for task in wanted if task not in known]
    done = len(wanted) - len(missing)

    def keep(trial: Trial) -> None:
        nonlocal done
        known[trial.task] = trial
        if config.file is not None:
            evaluate_rows.append_trial(config.file, trial)
        done += 1
        if progress is not None:
            progress(done, len(wanted))

    if progress is not None:
        progress(done, len(wanted))
    drive = functools.partial(drives.drive, weights=config.weights)
    drive_all(missing, config.jobs, drive, keep)
    return [known[task] for task in wanted]


def _found(config: EvaluateConfig, wanted: list[Task], say: Callable[[str], None]) -> list[Trial]:
    if config.file is None:
        raise InputError("no-drive makes figures of a file of trials: name it by --file")
    known = evaluate_rows.read_trials(config.file, say)
    found = [known[task] for task in wanted if task in known]
    if not found:
        raise InputError(f"file {str(config.file)!r} has none of these trials")
    return found


def _task(
    config: EvaluateConfig, density: str, speed: float, method: str, weights: str, seed: int
) -> Task:
    return Task(
        config.world,
        density,
        speed,
        method,
        weights,
        config.payload,
        config.timestep,
        config.length,
        config.duration,
        seed,
    )


def _to_stderr(text: str) -> None:
    print(text, file=sys.stderr)


__all__ = ["EvaluateConfig", "half_width", "run", "tasks_of", "trial_seed"]
