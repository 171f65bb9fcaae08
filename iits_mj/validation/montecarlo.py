"""`iits-mj montecarlo`: what the figures come to over all trucks that our knowledge allows.

Each sample is a truck drawn from `mjcf/spread.toml`, driven through the manoeuvres of
`montecarlo_samples`. The distribution says how far a figure of the shipped truck is to be trusted;
the rank correlations say which parameter one would have to know better.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from scipy.stats import spearmanr

from iits_mj import options
from iits_mj.assets import mjcf_path
from iits_mj.core.arrays import FloatArray
from iits_mj.errors import InputError
from iits_mj.options import option
from iits_mj.results import Check, Line, Panel, Results
from iits_mj.spread import Spread
from iits_mj.validation.full_stop import UN_R13
from iits_mj.validation.montecarlo_samples import (
    NOMINAL,
    Sample,
    SampleTask,
    drawn_truck,
)
from iits_mj.validation.row_files import write_table
from iits_mj.validation.single_lane_change import PBS_FACTOR

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
    payload: float = option(
        36_000.0, help="load on the semitrailer", unit="kg", low=0.0, high=36_000.0, metavar="KG"
    )
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
