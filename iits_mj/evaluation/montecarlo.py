"""`iits-mj montecarlo`: what the figures come to over all trucks that our knowledge allows.

Each sample is a truck drawn from `mjcf/spread.toml`, driven through the manoeuvres of
`montecarlo_samples`. The distribution says how far a figure of the shipped truck is to be trusted;
the rank correlations say which parameter one would have to know better.
"""

from __future__ import annotations

import functools
import hashlib
import sys
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from scipy.stats import spearmanr

from iits_mj.core import options
from iits_mj.core.arrays import FloatArray
from iits_mj.core.assets import mjcf_path
from iits_mj.core.errors import InputError
from iits_mj.core.options import option
from iits_mj.core.results import Check, Line, Panel, Results
from iits_mj.core.tables import write_table
from iits_mj.core.units import DIESEL_DENSITY, KMH
from iits_mj.parameters import payload_option
from iits_mj.parameters import randomization as spreads
from iits_mj.parameters.randomization import Drawn, Spread
from iits_mj.truck import Truck
from iits_mj.validation.handling import rollover, single_lane_change
from iits_mj.validation.handling.single_lane_change import PBS_FACTOR
from iits_mj.validation.harness.recorder import fit, run_straight
from iits_mj.validation.harness.run_cache import drive_digest
from iits_mj.validation.longitudinal import full_stop
from iits_mj.validation.longitudinal.full_stop import UN_R13, distance, fully_developed

# --- One truck out of many that our figures allow: drawn, driven, measured ---

# Speed of the lane change and of the fuel figure [m/s].
SPEED = 80.0 * KMH
_FUEL_TIME = 20.0  # [s]
NOMINAL = -1


@dataclass(frozen=True)
class SampleTask:
    """A truck that is to be measured.

    Attributes:
      seed: decides the truck; `NOMINAL` is the one of the shipped figures.
      payload: [kg].
      timestep: of the physics [s].
      spread: digest of what is drawn from.
    """

    seed: int
    payload: float
    timestep: float
    spread: str


@dataclass(frozen=True)
class Sample(SampleTask):
    """Figures of one truck.

    Attributes:
      rollover_threshold: static, on a tilt table [g].
      rearward_amplification: single sine of 0.4 Hz at 80 km/h [1].
      yaw_fit: of the yaw-sideslip model with the same figures to the tractor's yaw rate there [%].
      stop_distance: full stop from 60 km/h [m]; deceleration: mean fully developed [m/s2].
      fuel: at a steady 80 km/h on a level road [l/100 km].
      wall_time: [s]; code: digest of what drove it.
    """

    rollover_threshold: float
    rearward_amplification: float
    yaw_fit: float
    stop_distance: float
    deceleration: float
    fuel: float
    wall_time: float
    code: str

    @property
    def task(self) -> SampleTask:
        """What was measured."""
        return SampleTask(self.seed, self.payload, self.timestep, self.spread)


@functools.cache
def sample_code() -> str:
    """Digest of the code that drives samples."""
    return drive_digest(full_stop, rollover, single_lane_change, spreads, sys.modules[__name__])


def drawn_truck(spread: Spread, seed: int) -> Drawn:
    """The truck of a seed."""
    return spread.nominal() if seed == NOMINAL else spread.draw(np.random.default_rng(seed))


def measure(task: SampleTask, spread_file: Path | None = None) -> Sample:
    """Drives one truck through all manoeuvres.

    Args:
      task: which truck.
      spread_file: what it is drawn from; default: the shipped spread.

    Raises:
      InputError: the truck cannot be built, or holds no 80 km/h.
      Error: the physics diverged.
    """
    began = time.perf_counter()
    drawn = drawn_truck(Spread.load(spread_file), task.seed)
    payload, timestep, overlay = task.payload, task.timestep, drawn.overlay
    tilt = rollover.tilt_table(payload, timestep, parameters=overlay)
    sine = single_lane_change.sine_steer(payload, SPEED, timestep, parameters=overlay)
    stop = full_stop.stop_run(payload, full_stop.UN_R13.speed, timestep, parameters=overlay)
    return Sample(
        **vars(task),
        rollover_threshold=tilt.threshold,
        rearward_amplification=sine.truck(),
        yaw_fit=fit(sine.recording.yaw_rate, sine.model.yaw_rate),
        stop_distance=distance(stop),
        deceleration=fully_developed(stop),
        fuel=_steady_fuel(payload, timestep, drawn),
        wall_time=round(time.perf_counter() - began, 3),
        code=sample_code(),
    )


def _steady_fuel(payload: float, timestep: float, drawn: Drawn) -> float:
    """Fuel at a steady speed on a level road [l/100 km]."""
    truck = Truck.load(payload, parameters=drawn.overlay, timestep=timestep, visuals=False)
    truck.reset(speed=SPEED)
    hold = run_straight(truck, SPEED)
    before = truck.observe()
    for _ in range(round(_FUEL_TIME / 0.01)):
        truck.command(hold.command(SPEED - truck.observe().speed, 0.0))
        truck.step(round(0.01 / timestep))
    after = truck.observe()
    way = after.x - before.x
    return (after.fuel_used - before.fuel_used) / DIESEL_DENSITY / way * 1e5


# --- `iits-mj montecarlo`: what the figures come to over all trucks that our knowledge allows ---

SAMPLES_MAX = 1_000_000
# Name of the figure, its title and unit.
FIGURES = (
    ("rollover_threshold", "static roll-over threshold", "g"),
    ("rearward_amplification", "rearward amplification", "1"),
    ("yaw_fit", "fit of the yaw-sideslip model", "%"),
    ("stop_distance", "full stop from 60 km/h", "m"),
    ("deceleration", "mean fully developed deceleration", "m/s2"),
    ("fuel", "fuel at 80 km/h", "l/100 km"),
)
PBS_THRESHOLD = 0.35
R13_DECELERATION = 5.0
# Fewer trucks than these tell nothing about correlations.
_CORRELATED = 30
_STRONGEST = 3


@dataclass(frozen=True, kw_only=True)
class MonteCarloConfig:
    """Which trucks, and how many."""

    samples: int = option(200, help="trucks to draw", low=2, high=SAMPLES_MAX)
    payload: float = payload_option()
    timestep: float = option(
        0.002, help="of the physics", unit="s", low=0.0005, high=0.005, metavar="S"
    )
    spread: Path | None = option(
        None,
        help="what is drawn from; without it the shipped mjcf/spread.toml",
        metavar="FILE.toml",
    )
    seed: int = option(0, help="another set of trucks", low=0, high=1_000)
    jobs: int = option(1, help="processes at a time on this machine", low=1, high=256)

    def __post_init__(self) -> None:
        options.check(self)


def tasks_of(config: MonteCarloConfig) -> list[SampleTask]:
    """The shipped truck, then those that are drawn.

    Raises:
      InputError: the spread cannot be read, or is not usable.
    """
    Spread.load(config.spread)
    digest = hashlib.sha256(_spread_file(config).read_bytes()).hexdigest()[:12]
    first = SAMPLES_MAX * config.seed
    seeds = [NOMINAL, *range(first, first + config.samples)]
    return [SampleTask(seed, config.payload, config.timestep, digest) for seed in seeds]


def describe(task: SampleTask) -> str:
    """A sample in a few words."""
    return "the shipped truck" if task.seed == NOMINAL else f"truck {task.seed}"


def summarize(config: MonteCarloConfig, rows: Sequence[Sample]) -> Results:
    """Distribution of each figure, shares that hold the standards, correlations, and curves.

    Raises:
      InputError: the shipped truck is missing, or fewer than two are drawn.
    """
    shipped = next((row for row in rows if row.seed == NOMINAL), None)
    drawn = sorted((row for row in rows if row.seed != NOMINAL), key=lambda row: row.seed)
    if shipped is None or len(drawn) < 2:
        raise InputError("the shipped truck and at least two drawn ones are wanted")
    values = {name: np.array([getattr(row, name) for row in drawn]) for name, *_ in FIGURES}
    results = Results("montecarlo", seed=config.seed)
    results.notes += [
        f"{len(drawn)} trucks drawn from {_spread_file(config).name}, "
        f"{config.payload / 1e3:g} t of load, {config.timestep:g} s a step",
        *_correlations(config, drawn, values),
    ]
    results.checks += [*_shares(values), *_figures(shipped, values)]
    for name, title, unit in FIGURES:
        results.figures[title] = [_panel(shipped, name, title, unit, values[name])]
    return results


def write_samples(path: Path, config: MonteCarloConfig, rows: Sequence[Sample]) -> None:
    """Writes each truck's factors and figures as CSV.

    Raises:
      InputError: it cannot be written.
    """
    spread = Spread.load(config.spread)
    table = []
    for row in sorted(rows, key=lambda row: row.seed):
        factors = drawn_truck(spread, row.seed).factors
        table.append({**asdict(row), **{f"factor_{name}": v for name, v in factors.items()}})
    write_table(path, list(table[0]), table, "trucks")


def _spread_file(config: MonteCarloConfig) -> Path:
    return config.spread or mjcf_path("spread.toml")


def _correlations(
    config: MonteCarloConfig, drawn: Sequence[Sample], values: dict[str, FloatArray]
) -> list[str]:
    """The quantities that move each figure most, by Spearman's rank correlation."""
    if len(drawn) < _CORRELATED:
        return [f"fewer than {_CORRELATED} trucks: no correlations"]
    spread = Spread.load(config.spread)
    names = [quantity.name for quantity in spread.quantities if quantity.low < quantity.high]
    factors = [drawn_truck(spread, row.seed).factors for row in drawn]
    columns = {name: np.array([row[name] for row in factors]) for name in names}
    lines = ["strongest rank correlations"]
    for figure, title, _ in FIGURES:
        if np.ptp(values[figure]) == 0.0:
            lines.append(f"{title:<36}the same for all")
            continue
        found = {name: float(spearmanr(columns[name], values[figure]).statistic) for name in names}
        first = sorted(found, key=lambda name: -abs(found[name]))[:_STRONGEST]
        lines.append(f"{title:<36}" + ", ".join(f"{name} {found[name]:+.2f}" for name in first))
    return lines


def _shares(values: dict[str, FloatArray]) -> list[Check]:
    """Shares of the trucks that hold what standards ask [%]."""
    held = {
        f"within UN R13's distance of {UN_R13.laden:.1f} m from 60 km/h": (
            values["stop_distance"] <= UN_R13.laden,
            ">= 100",
        ),
        f"of {R13_DECELERATION:g} m/s2 mean fully developed deceleration (UN R13)": (
            values["deceleration"] >= R13_DECELERATION,
            ">= 100",
        ),
        f"of a rearward amplification of at most {PBS_FACTOR:g} thresholds (PBS)": (
            values["rearward_amplification"] <= PBS_FACTOR * values["rollover_threshold"],
            ">= 100",
        ),
        # A high load is the carrier's, not the truck's: for information.
        f"of a roll-over threshold of {PBS_THRESHOLD:g} g (PBS)": (
            values["rollover_threshold"] >= PBS_THRESHOLD,
            "",
        ),
    }
    return [
        Check(f"trucks {name}", 100.0 * float(np.mean(ok)), "%", None, must)
        for name, (ok, must) in held.items()
    ]


def _figures(shipped: Sample, values: dict[str, FloatArray]) -> list[Check]:
    checks = []
    for name, title, unit in FIGURES:
        found, own = values[name], float(getattr(shipped, name))
        low, median, high = (float(v) for v in np.quantile(found, (0.05, 0.5, 0.95)))
        checks += [
            Check(f"{title}: 5 % of the trucks below", low, unit, own),
            Check(f"{title}: median", median, unit, own),
            Check(f"{title}: 5 % of the trucks above", high, unit, own),
            Check(f"{title}: standard deviation", float(found.std(ddof=1)), unit),
        ]
    return checks


def _panel(shipped: Sample, name: str, title: str, unit: str, found: FloatArray) -> Panel:
    """Share of the trucks below a value, and the shipped truck's."""
    order = np.sort(found)
    share = np.arange(1, len(order) + 1) / len(order)
    own = np.full(2, float(getattr(shipped, name)))
    return Panel(
        f"{title}: share of trucks below",
        f"{title} [{unit}]",
        "share [1]",
        (
            Line("shipped truck", own, np.array([0.0, 1.0]), "reference"),
            Line("drawn trucks", order, share, "simulation"),
        ),
    )
