"""`iits-mj evaluate`: drives decision makers through the paper's cells, with paired seeds."""

from __future__ import annotations

import functools
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from controllers import decision
from controllers.decision.prices import PriceOptions
from controllers.decision.trip import (
    CELLS,
    SEEDS_EACH,
    TEST_SEEDS,
    VALIDATION_SEEDS,
    TripConfig,
    usual_payload,
)
from controllers.own_parts import DECISION
from iits_mj.core import options
from iits_mj.core.checks import one_of
from iits_mj.core.errors import InputError
from iits_mj.core.options import jobs_option, option, plant_option, timestep_option
from iits_mj.core.own_parts import FILES, FORMS
from iits_mj.core.process_pool import run_all
from iits_mj.evaluation import drives, trials
from iits_mj.evaluation.hulls import SWEEP
from iits_mj.evaluation.trials import EMPTY, WORLDS, Task, Trial, weights_digest
from iits_mj.parameters import (
    AnyTruck,
    TruckParameters,
    check_truck,
    label_of,
    payload_option,
    truck_option,
)
from iits_mj.simulation.config import LANE_DISCIPLINES

SEEDS = {"test": TEST_SEEDS, "validation": VALIDATION_SEEDS}
DEFAULT_METHODS = "conservative,neutral,aggressive,mobil,lookahead,ddqn"
DEFAULT_CELLS = ",".join(f"{density}-{speed:g}" for density, speed in CELLS)
TRIALS_MAX, SETS_MAX = 1_000, 10


@dataclass(frozen=True, kw_only=True)
class EvaluateConfig(PriceOptions):
    """Decision makers to compare, their world, and the number of trips."""

    trials: int = option(
        30, help="trips of each method in each cell", low=1, high=TRIALS_MAX, group="run"
    )
    methods: str = option(
        DEFAULT_METHODS,
        help="decision makers, separated by commas, with options as "
        f"lookahead:horizon=30:change_cost=25; or your own as {FORMS}",
        names=lambda: DECISION.shipped,
        metavar="NAMES",
        files=FILES,
        group="decision",
    )
    sweep: bool = option(
        False,
        help="drive mobil and lookahead with swept thresholds, horizons and costs, too, for the "
        "comparison at equal lane changes",
        group="decision",
    )
    cells: str = option(
        DEFAULT_CELLS,
        help="traffic cells: density and speed limit in m/s, separated by commas",
        metavar="CELLS",
        group="traffic",
    )
    lane_discipline: str = option(
        "free",
        help="lane use of the traffic, as of a drive; free: fills both lanes; right: keeps right",
        choices=LANE_DISCIPLINES,
        group="traffic",
    )
    keep_right: str = option(
        "off",
        help="on: the truck returns to the right lane, as of a drive",
        choices=("on", "off"),
        group="decision",
    )
    weights: Path | None = option(
        None,
        help="policy of the method ddqn; default: the shipped policy",
        metavar="FILE.npz",
        group="decision",
    )
    world: str = option(
        "full",
        help="full: MuJoCo truck with its stack in SUMO traffic; fast: point mass, no SUMO",
        choices=WORLDS,
        group="run",
    )
    plant: str = plant_option()
    truck: AnyTruck | None = truck_option("truck of all trips")
    payload: float | None = payload_option(
        help=f"load of the truck; without it {TripConfig.payload:g} kg, or the greatest if less"
    )
    timestep: float = timestep_option()
    length: float = option(
        15_000.0,
        help="length of a trip, which also ends at the end of the road",
        unit="m",
        low=500.0,
        high=1e5,
        group="road",
    )
    duration: float = option(
        3_000.0,
        help="time after which a trip is cut off and counts as failed",
        unit="s",
        low=10.0,
        high=1e5,
        group="run",
    )
    seeds: str = option(
        "test",
        help="seeds of the traffic; test: for figures; validation: for choosing a policy",
        choices=tuple(SEEDS),
        group="traffic",
    )
    seed: int = option(
        0, help="number of the set of seeds", low=0, high=SETS_MAX - 1, group="traffic"
    )
    jobs: int = jobs_option(help="number of processes; each drives one trip")
    file: Path | None = option(
        None,
        help="file of trials; trials that it contains are not driven again; default with --report: "
        "evaluate.csv in that folder",
        metavar="FILE.csv",
        group="output",
    )
    drive: bool = option(
        True, help="drive missing trials; --no-drive: use only those in --file", group="run"
    )

    def __post_init__(self) -> None:
        options.check(self)
        check_truck(self)
        for name in self.names():
            DECISION.check(name)
        self.chosen_cells()
        self.prices()
        if self.world == "fast" and self.plant != "full":
            raise InputError(f"plant {self.plant}: the fast world has a point mass; use world full")

    @property
    def trial_world(self) -> str:
        """The world of the trials: the plant of the full chain, or "fast"."""
        return self.plant if self.world == "full" else self.world

    def used_payload(self) -> float:
        """The load of all trips [kg]."""
        if self.payload is None:
            return usual_payload(TruckParameters.load(self.truck))
        return float(self.payload)

    def names(self) -> tuple[str, ...]:
        """The methods, each once; the same text for each way to write a rule's options.

        Raises:
          InputError: a method is unknown, or an option is not allowed.
        """
        names: list[str] = []
        for word in (word.strip() for word in self.methods.split(",")):
            key, equals, _ = word.partition("=")
            if names and equals and key.isidentifier():
                names[-1] += f":{word}"  # a further option of the method before
            else:
                names.append(word)
        return tuple(dict.fromkeys(map(DECISION.normal_name, names)))

    def driven(self) -> tuple[str, ...]:
        """The methods, and the rules of the sweep."""
        swept = map(DECISION.normal_name, SWEEP if self.sweep else ())
        return tuple(dict.fromkeys((*self.names(), *swept)))

    def chosen_cells(self) -> tuple[tuple[str, float], ...]:
        """Density and traffic speed of the cells, in the paper's order.

        Raises:
          InputError: a cell is not one of the paper's.
        """
        known = dict(zip(DEFAULT_CELLS.split(","), CELLS, strict=True))
        asked = [name.strip() for name in self.cells.split(",")]
        for name in asked:
            one_of("cell", name, known)
        return tuple(cell for name, cell in known.items() if name in asked)


def trial_seed(cell: int, trial: int, config: EvaluateConfig) -> int:
    """The seed of a trial in a cell, the same for all methods."""
    per_cell, per_set = TRIALS_MAX, SEEDS_EACH // SETS_MAX
    return SEEDS[config.seeds] + per_set * config.seed + per_cell * cell + trial


def tasks_of(config: EvaluateConfig) -> list[Task]:
    """All tasks: first the empty road, then all cells and methods, trial by trial.

    Raises:
      InputError: the policy's file cannot be read.
    """
    truck, payload = label_of(config.truck), config.used_payload()
    prices = config.prices()
    digests = {name: weights_digest(name, config.weights, prices) for name in config.driven()}
    cells = config.chosen_cells()

    def task(density: str, speed: float, method: str, weights: str, seed: int) -> Task:
        limits = (truck, payload, config.timestep, config.length, config.duration)
        where = (config.trial_world, density, speed, method, weights)
        return Task(
            *(*where, *limits, seed),
            lane_discipline=config.lane_discipline,
            keep_right=config.keep_right,
        )

    free = [task(EMPTY, speed, "keep", "", 0) for speed in sorted({speed for _, speed in cells})]
    return free + [
        task(density, speed, name, digests[name], trial_seed(cell, number, config))
        for number in range(config.trials)
        for cell, (density, speed) in enumerate(CELLS)
        if (density, speed) in cells
        for name in config.driven()
    ]


def run(
    config: EvaluateConfig,
    progress: Callable[[int, int], None] | None = None,
    say: Callable[[str], None] | None = None,
    drive_all: Callable[..., None] | None = None,
) -> list[Trial]:
    """Drives the trials that the file does not contain yet; returns all trials of the settings.

    Args:
      config: settings.
      progress: called with the numbers of finished trials and of all trials.
      say: gets messages for the user; default: they are printed on stderr.
      drive_all: drives tasks; default: `process_pool.run_all`.

    Raises:
      InputError: the file of trials or the weights are not usable.
      TasksError: some trials failed; the others are in the file.
    """
    say = say or functools.partial(print, file=sys.stderr)
    wanted = tasks_of(config)
    if not config.drive:
        if config.file is None:
            raise InputError("--no-drive needs a file of trials: name it by --file")
        known = trials.read_trials(config.file, say)
        found = [known[task] for task in wanted if task in known]
        if not found:
            raise InputError(f"file {str(config.file)!r} has none of these trials")
        return found
    if "ddqn" in config.names():
        # Refuse unusable weights before the first trial.
        weights = None if config.weights is None else str(config.weights)
        decision.make("ddqn", weights, config.prices())
    drive_all = drive_all or functools.partial(run_all, describe=describe, what="trials")
    if config.file is None:
        return _run(config, wanted, {}, progress, drive_all)
    with trials.locked(config.file):
        known = trials.read_trials(config.file, say)
        trials.write_trials(config.file, known.values())
        try:
            return _run(config, wanted, known, progress, drive_all)
        finally:
            trials.write_trials(config.file, known.values())


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
    """Drives the tasks that are not known, and adds their trials to the known ones."""
    missing = [task for task in wanted if task not in known]
    done = len(wanted) - len(missing)

    def keep(trial: Trial) -> None:
        nonlocal done
        known[trial.task] = trial
        if config.file is not None:
            trials.append_trial(config.file, trial)
        done += 1
        if progress is not None:
            progress(done, len(wanted))

    if progress is not None:
        progress(done, len(wanted))
    truck = TruckParameters.load(config.truck)
    drive_one = functools.partial(
        drives.drive, weights=config.weights, truck=truck, prices=config.prices()
    )
    drive_all(missing, config.jobs, drive_one, keep)
    return [known[task] for task in wanted]
