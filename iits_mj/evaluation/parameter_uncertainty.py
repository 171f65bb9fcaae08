"""`iits-mj montecarlo`: effect of the uncertainty of the truck's parameters on its figures.

Each sample is a truck drawn from `mjcf/spread.toml` and driven through the same maneuvers. The
distribution of a figure shows how reliable the figure of the shipped truck is; rank correlations
show which parameters it depends on.
"""

from __future__ import annotations

import functools
import hashlib
import sys
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path

import numpy as np
from scipy.stats import spearmanr

from controllers.own_parts import LATERAL, LONGITUDINAL
from iits_mj.core import options
from iits_mj.core.arrays import FloatArray
from iits_mj.core.assets import mjcf_path
from iits_mj.core.errors import InputError
from iits_mj.core.options import jobs_option, option, part_option, timestep_option
from iits_mj.core.own_parts import AnyPart
from iits_mj.core.results import Findings, Line, Results
from iits_mj.core.tables import write_table
from iits_mj.core.units import DIESEL_DENSITY, KMH
from iits_mj.evaluation import controlled_drive
from iits_mj.parameters import (
    AnyTruck,
    TruckParameters,
    check_truck,
    label_of,
    payload_option,
    randomization,
    truck_option,
)
from iits_mj.parameters.randomization import Drawn, Spread
from iits_mj.validation.handling import lane_change, rollover
from iits_mj.validation.harness import maneuver, recorder
from iits_mj.validation.harness.run_cache import drive_digest
from iits_mj.validation.longitudinal import braking
from iits_mj.validation.pbs.limits import STANDARDS

# Speed of the lane change and of the fuel figure [m/s].
SPEED = 80.0 * KMH
_FUEL_TIME = 20.0  # [s]
NOMINAL = -1
_FOLLOWING = tuple(field.name for field in fields(controlled_drive.Following))


@dataclass(frozen=True)
class SampleTask:
    """A truck to measure.

    Attributes:
      seed: of the draw; `NOMINAL` is the truck itself.
      truck: see `label_of`.
      payload: [kg].
      timestep: of the physics [s].
      spread: digest of the distributions.
      controllers: the user's, see `controlled_drive.identity`.
    """

    seed: int
    truck: str
    payload: float
    timestep: float
    spread: str
    controllers: str


@dataclass(frozen=True)
class Sample(SampleTask):
    """Figures of one truck.

    Attributes:
      rollover_threshold: static, on a tilt table [g].
      rearward_amplification: single sine of 0.4 Hz at 80 km/h [1].
      yaw_fit: fit of the yaw-sideslip model with the same parameters to the yaw rate there [%].
      stop_distance: full stop from 60 km/h [m]; deceleration: mean fully developed [m/s2].
      fuel: at a steady 80 km/h on a level road [l/100 km].
      path_error, speed_error, completed: of `controlled_drive.Following`; 0 without the user's
        controllers, when nothing shows them.
      wall_time: [s]; code: digest of the code of the drives.
    """

    rollover_threshold: float
    rearward_amplification: float
    yaw_fit: float
    stop_distance: float
    deceleration: float
    fuel: float
    path_error: float
    speed_error: float
    completed: int
    wall_time: float
    code: str

    @property
    def task(self) -> SampleTask:
        """The task of the sample."""
        return SampleTask(**{f.name: getattr(self, f.name) for f in fields(SampleTask)})


@functools.cache
def sample_code() -> str:
    """Digest of the code that drives samples."""
    drivers = (braking, rollover, lane_change, maneuver, recorder, randomization, controlled_drive)
    return drive_digest(*drivers, sys.modules[__name__])


def drawn_truck(spread: Spread, seed: int) -> Drawn:
    """The truck of a seed."""
    return spread.nominal() if seed == NOMINAL else spread.draw(np.random.default_rng(seed))


def measure(
    task: SampleTask,
    spread_file: Path | None = None,
    truck: AnyTruck | None = None,
    lateral: AnyPart | None = None,
    longitudinal: AnyPart | None = None,
) -> Sample:
    """Drives one truck through all maneuvers.

    Args:
      task: which truck.
      spread_file: distributions of the parameters; default: the shipped file.
      truck: of the task, a name or file.
      lateral: the user's steering controller, for a drive with it.
      longitudinal: the user's speed controller, for a drive with it.

    Raises:
      InputError: truck or controllers are not the task's, a controller fails, or the truck cannot
        be built or cannot hold 80 km/h.
      Error: the physics diverged.
    """
    began = time.perf_counter()
    if label_of(truck) != task.truck:
        raise InputError(f"the sample is of truck {task.truck!r}, not of {label_of(truck)!r}")
    if (controllers := controlled_drive.identity(lateral, longitudinal)) != task.controllers:
        raise InputError(f"the sample has controllers {task.controllers!r}, here {controllers!r}")
    drawn = drawn_truck(Spread.load(spread_file, truck), task.seed)
    payload, timestep = task.payload, task.timestep
    parameters = TruckParameters.load(truck, drawn.overlay)
    followed = controlled_drive.Following(0.0, 0.0, 0)
    if controllers:
        followed = controlled_drive.follow(parameters, payload, timestep, lateral, longitudinal)
    tilt = rollover.tilt_table(parameters, payload, timestep)
    sine = lane_change.sine_steer(parameters, payload, SPEED, timestep)
    stop = braking.stop_run(parameters, payload, braking.UN_R13.speed, timestep)
    return Sample(
        **vars(task),
        rollover_threshold=tilt.threshold,
        rearward_amplification=sine.amplification(),
        yaw_fit=recorder.fit(sine.recording.yaw_rate, sine.model.yaw_rate),
        stop_distance=braking.distance(stop),
        deceleration=braking.fully_developed(stop),
        fuel=_steady_fuel(payload, timestep, parameters),
        **vars(followed),
        wall_time=round(time.perf_counter() - began, 3),
        code=sample_code(),
    )


def _steady_fuel(payload: float, timestep: float, parameters: TruckParameters) -> float:
    """Fuel at a steady speed on a level road [l/100 km]."""
    truck, hold = maneuver.steady_truck(payload, SPEED, timestep, parameters=parameters)
    before = truck.observe()
    for _ in range(round(_FUEL_TIME / recorder.PERIOD)):
        truck.command(hold.command(SPEED - truck.observe().speed, 0.0))
        truck.step(round(recorder.PERIOD / timestep))
    after = truck.observe()
    way = after.x - before.x
    return (after.fuel_used - before.fuel_used) / DIESEL_DENSITY / way * 1e5


SAMPLES_MAX = 1_000_000
# Attribute, title and unit of each figure.
FIGURES = (
    ("rollover_threshold", "static roll-over threshold", "g"),
    ("rearward_amplification", "rearward amplification", "1"),
    ("yaw_fit", "fit of the yaw-sideslip model", "%"),
    ("stop_distance", "full stop from 60 km/h", "m"),
    ("deceleration", "mean fully developed deceleration", "m/s2"),
    ("fuel", "fuel at 80 km/h", "l/100 km"),
)
# Figures of the drive with the user's controllers.
FOLLOWING = (
    ("path_error", "distance from the lane's middle, greatest", "m"),
    ("speed_error", "difference from the requested speed, mean", "m/s"),
)
PBS_THRESHOLD = STANDARDS["rollover"].limits[0]
# Least number of trucks for correlations, and number of correlations shown for each figure.
_CORRELATED = 30
_STRONGEST = 3


@dataclass(frozen=True, kw_only=True)
class MonteCarloConfig:
    """Number of trucks, and how they are drawn."""

    samples: int = option(
        200, help="number of trucks to draw", low=2, high=SAMPLES_MAX, group="run"
    )
    truck: AnyTruck | None = truck_option("truck whose parameters are uncertain")
    payload: float | None = payload_option()
    timestep: float = timestep_option()
    spread: Path | None = option(
        None,
        help="distributions of the parameters; default: the shipped mjcf/spread.toml",
        metavar="FILE.toml",
        group="truck",
    )
    lateral: AnyPart | None = part_option(
        None, LATERAL, "measures a drive on the highway, too, with this steering controller"
    )
    longitudinal: AnyPart | None = part_option(
        None,
        LONGITUDINAL,
        "measures a drive on the highway, too, with this speed controller",
    )
    seed: int = option(0, help="number of the set of trucks", low=0, high=1_000, group="run")
    jobs: int = jobs_option()

    def __post_init__(self) -> None:
        options.check(self)
        parameters = check_truck(self)
        if len(parameters.units) < 2:
            raise InputError(
                f"truck {parameters.name!r} has no trailer, whose motion in a lane change and on a "
                "tilt table is measured"
            )

    @property
    def figures(self) -> tuple[tuple[str, str, str], ...]:
        """Attribute, title and unit of each figure."""
        driven = self.lateral is not None or self.longitudinal is not None
        return (*FIGURES, *FOLLOWING) if driven else FIGURES

    @property
    def spread_file(self) -> Path:
        """File with the distributions of the parameters."""
        return self.spread or mjcf_path("spread.toml")


def tasks_of(config: MonteCarloConfig) -> list[SampleTask]:
    """The truck itself, then the drawn ones.

    Raises:
      InputError: the file of distributions cannot be read, or is not usable.
    """
    Spread.load(config.spread, config.truck)
    truck, payload = label_of(config.truck), check_truck(config).check_payload(config.payload)
    digest = hashlib.sha256(config.spread_file.read_bytes()).hexdigest()[:12]
    first = SAMPLES_MAX * config.seed
    seeds = [NOMINAL, *range(first, first + config.samples)]
    controllers = controlled_drive.identity(config.lateral, config.longitudinal)
    rest = payload, config.timestep, digest, controllers
    return [SampleTask(seed, truck, *rest) for seed in seeds]


def describe(task: SampleTask) -> str:
    """A sample in a few words."""
    return "the shipped truck" if task.seed == NOMINAL else f"truck {task.seed}"


def summarize(config: MonteCarloConfig, rows: Sequence[Sample]) -> Results:
    """Shares of trucks that meet the standards, distributions of all figures, and correlations.

    Raises:
      InputError: the shipped truck is missing, or fewer than two trucks are drawn.
    """
    shipped = next((row for row in rows if row.seed == NOMINAL), None)
    drawn = sorted((row for row in rows if row.seed != NOMINAL), key=lambda row: row.seed)
    if shipped is None or len(drawn) < 2:
        raise InputError("the shipped truck and at least two drawn trucks are needed")
    values = {name: np.array([getattr(row, name) for row in drawn]) for name, *_ in config.figures}
    results = Results("montecarlo", seed=config.seed)
    results.notes += [
        f"{len(drawn)} trucks drawn from {config.spread_file.name}, "
        f"{shipped.payload / 1e3:g} t of load, {config.timestep:g} s a step",
        *_correlations(config, drawn, values),
    ]
    shares = _shares(values)
    if "path_error" in values:
        completed = 100.0 * float(np.mean([row.completed for row in drawn]))
        shares.check("trucks that complete the drive", completed, "%", must=">= 100")
    results.add("", shares)
    for name, title, unit in config.figures:
        results.add(title, _distribution(title, unit, getattr(shipped, name), values[name]))
    return results


def write_samples(path: Path, config: MonteCarloConfig, rows: Sequence[Sample]) -> None:
    """Writes the factors and figures of each truck as CSV.

    Raises:
      InputError: the file cannot be written.
    """
    spread = Spread.load(config.spread, config.truck)
    table = []
    for row in sorted(rows, key=lambda row: row.seed):
        factors, figures = drawn_truck(spread, row.seed).factors, asdict(row)
        if not row.controllers:
            for name in ("controllers", *_FOLLOWING):
                del figures[name]
        table.append({**figures, **{f"factor_{name}": v for name, v in factors.items()}})
    write_table(path, list(table[0]), table, "trucks")


def _correlations(
    config: MonteCarloConfig, drawn: Sequence[Sample], values: dict[str, FloatArray]
) -> list[str]:
    """The parameters with the strongest effect on each figure, by Spearman's rank correlation."""
    if len(drawn) < _CORRELATED:
        return [f"fewer than {_CORRELATED} trucks: no correlations"]
    spread = Spread.load(config.spread, config.truck)
    names = [quantity.name for quantity in spread.quantities if quantity.low < quantity.high]
    factors = [drawn_truck(spread, row.seed).factors for row in drawn]
    columns = {name: np.array([row[name] for row in factors]) for name in names}
    lines = ["strongest rank correlations"]
    for figure, title, _ in config.figures:
        if np.ptp(values[figure]) == 0.0:
            lines.append(f"{title:<36}the same for all")
            continue
        found = {name: float(spearmanr(columns[name], values[figure]).statistic) for name in names}
        first = sorted(found, key=lambda name: -abs(found[name]))[:_STRONGEST]
        lines.append(f"{title:<36}" + ", ".join(f"{name} {found[name]:+.2f}" for name in first))
    return lines


def _shares(values: dict[str, FloatArray]) -> Findings:
    """Shares of the trucks that meet the standards [%]."""
    found = Findings()
    factor, least = lane_change.PBS_FACTOR, braking.R13_DECELERATION
    distance = braking.UN_R13.laden
    stops, brakes = values["stop_distance"] <= distance, values["deceleration"] >= least
    calm = values["rearward_amplification"] <= factor * values["rollover_threshold"]
    upright = values["rollover_threshold"] >= PBS_THRESHOLD
    for name, held, must in (
        (f"within UN R13's distance of {distance:.1f} m from 60 km/h", stops, ">= 100"),
        (f"of {least:g} m/s2 mean fully developed deceleration (UN R13)", brakes, ">= 100"),
        (f"of a rearward amplification of at most {factor:g} thresholds (PBS)", calm, ">= 100"),
        # For information: the carrier determines the height of the load.
        (f"of a roll-over threshold of {PBS_THRESHOLD:g} g (PBS)", upright, ""),
    ):
        found.check(f"trucks {name}", 100.0 * float(np.mean(held)), "%", must=must)
    return found


def _distribution(title: str, unit: str, shipped: float, values: FloatArray) -> Findings:
    """Quantiles of a figure, and the share of trucks below each value."""
    found, own = Findings(title), shipped
    low, median, high = np.quantile(values, (0.05, 0.5, 0.95))
    found.check("5 % of the trucks below", low, unit, own)
    found.check("median", median, unit, own)
    found.check("5 % of the trucks above", high, unit, own)
    found.check("standard deviation", values.std(ddof=1), unit)
    share = np.arange(1, len(values) + 1) / len(values)
    found.panel(
        "share of trucks below",
        f"{title} [{unit}]",
        "share [1]",
        Line("shipped truck", np.full(2, own), np.array([0.0, 1.0]), "reference"),
        Line("drawn trucks", np.sort(values), share, "simulation"),
    )
    return found
