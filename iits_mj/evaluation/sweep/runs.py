"""The drives of a sweep: measures, outcome and row of each, and the description of their folder."""

from __future__ import annotations

import functools
import json
import math
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from iits_mj.core.errors import InputError
from iits_mj.core.input_files import read_toml
from iits_mj.core.output_files import write_whole
from iits_mj.core.progress import shown_on
from iits_mj.core.tables import write_table
from iits_mj.evaluation.sweep import design
from iits_mj.evaluation.sweep.design import Drive, Point, Sweep, SweepConfig
from iits_mj.simulation import Simulation
from iits_mj.simulation.config import with_level_start
from iits_mj.simulation.conflicts import ConflictLog
from iits_mj.simulation.frame import DivergedError
from iits_mj.validation.harness.run_cache import drive_digest

# From the worst to the best; a run with an error may hide anything but a comfortable drive.
OUTCOMES = ("collision", "failure", "near miss", "error", "comfortable")
# Units in the names of columns.
UNITS = {
    name: unit
    for unit, names in (
        ("mps", ("impact_speed",)),
        ("s", ("ttc", "time_gap", "pet", "duration")),
        ("mps2", ("drac", "deceleration")),
        ("m", ("rss_margin", "gap", "distance")),
    )
    for name in names
}
# Columns of `runs.csv` behind those of the swept values.
COLUMNS = (
    *("outcome", "reason", "road_user"),
    *(f"{name}_{unit}" for name, unit in UNITS.items()),
    *("events", "ended", "command"),
)


@functools.cache
def sweep_code() -> str:
    """Digest of the code that drives the points."""
    return drive_digest(design, sys.modules[__name__])


@dataclass(frozen=True)
class SweepRun:
    """Measures of the drive of a point; those of `Conflict` are the worst of all road users.

    Attributes:
      point: names and texts as JSON; error: why there is no drive, "" for a drive.
      ended: reason of the end; collision, failed: 1 or 0, see `DriveSummary`.
      road_user: that the truck hit, else the one with the least gap, "" without one.
      impact_speed: nan without a collision [m/s]; ttc, time_gap, drac, pet, rss_margin, gap: see
        `Conflict`; deceleration: the truck's greatest [m/s2].
      distance: driven [m]; duration: simulated [s]; events: number that began.
    """

    point: str
    error: str = ""
    ended: str = ""
    collision: int = 0
    failed: int = 0
    road_user: str = ""
    impact_speed: float = math.nan
    ttc: float = math.inf
    time_gap: float = math.inf
    drac: float = 0.0
    pet: float = math.nan
    rss_margin: float = math.inf
    gap: float = math.inf
    deceleration: float = 0.0
    distance: float = 0.0
    duration: float = 0.0
    events: int = 0

    @property
    def values(self) -> Point:
        """The point."""
        return tuple((name, text) for name, text in json.loads(self.point))


def describe(point: Point) -> str:
    """A point in a few words."""
    return ", ".join(f"{name}={text}" for name, text in point)


def drive_point(point: Point, sweep: Sweep) -> SweepRun:
    """Returns the measures of the drive of a point; a drive that fails gives its error."""
    text = json.dumps(point)
    try:
        with shown_on(None, quiet=True):
            return _driven(text, sweep.asked(point))
    except Exception as error:
        kind = "" if isinstance(error, InputError) else f"{type(error).__name__}: "
        return SweepRun(text, " ".join(f"{kind}{error}".split()) or kind)


def _driven(point: str, asked: Drive) -> SweepRun:
    log = ConflictLog()
    with Simulation(with_level_start(asked, asked.given), visuals=False) as simulation:
        try:
            summary = simulation.run([log])
        except DivergedError:
            summary = simulation.summary()
        impact = simulation.impact
    found = log.conflicts()
    nearest = min(found, key=lambda c: c.gap, default=None)
    pet = [c.pet for c in found if not math.isnan(c.pet)]
    return SweepRun(
        point,
        ended=summary.ended,
        collision=int(summary.collision),
        failed=int(summary.failed),
        road_user=impact.vehicle if impact else nearest.actor if nearest else "",
        impact_speed=impact.speed if impact else math.nan,
        ttc=min((c.ttc for c in found), default=math.inf),
        time_gap=min((c.time_gap for c in found), default=math.inf),
        drac=max((c.drac for c in found), default=0.0),
        pet=min(pet, default=math.nan),
        rss_margin=min((c.rss_margin for c in found), default=math.inf),
        gap=nearest.gap if nearest else math.inf,
        deceleration=log.deceleration,
        distance=summary.distance,
        duration=summary.duration,
        events=len(log.records),
    )


def outcome(run: SweepRun, config: SweepConfig) -> tuple[str, str]:
    """Returns the outcome of a run, one of `OUTCOMES`, and its reason in words."""
    if run.error:
        return "error", run.error
    if run.collision:
        return "collision", f"{run.impact_speed * 3.6:.1f} km/h into {run.road_user}"
    if run.failed:
        return "failure", run.ended
    near = [f"TTC {run.ttc:.2f} s"] if run.ttc < config.near_ttc else []
    near += [f"DRAC {run.drac:.2f} m/s2"] if run.drac > config.near_drac else []
    if run.deceleration > config.near_deceleration:
        near.append(f"deceleration {run.deceleration:.2f} m/s2")
    if config.near_pet is not None and run.pet < config.near_pet:
        near.append(f"PET {run.pet:.2f} s")
    return ("near miss", ", ".join(near)) if near else ("comfortable", "")


def limits_text(config: SweepConfig) -> str:
    """What the outcomes mean, in words."""
    pet = "" if config.near_pet is None else f", PET below {config.near_pet:g} s"
    return (
        f"A near miss has a time to collision below {config.near_ttc:g} s, a DRAC above "
        f"{config.near_drac:g} m/s2, a deceleration of the truck above "
        f"{config.near_deceleration:g} m/s2{pet}. A failure is a roll-over, a road departure or a "
        "simulation that diverged."
    )


def severity(run: SweepRun, found: str) -> tuple[float, ...]:
    """A key that sorts runs from the worst to the best."""
    speed = 0.0 if math.isnan(run.impact_speed) else run.impact_speed
    return OUTCOMES.index(found), -speed, run.ttc, -run.drac, -run.deceleration


def table_rows(
    sweep: Sweep, runs: Sequence[SweepRun], config: SweepConfig
) -> Iterator[dict[str, Any]]:
    """Yields the rows of `runs.csv`, units in the names; a value that is not finite is None."""
    for run in runs:
        found, reason = outcome(run, config)
        measures = [
            value if math.isfinite(value) and not run.error else None
            for value in (getattr(run, name) for name in UNITS)
        ]
        last = run.events, run.ended, sweep.command(run.values)
        cells = found, reason, run.road_user, *measures, *last
        yield dict(run.values) | dict(zip(COLUMNS, cells, strict=True))


def write_runs(path: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """Writes the rows as CSV; InputError if the file cannot be written."""
    names = dict.fromkeys(name for row in rows for name in row)
    write_table(path, list(names), rows, "runs")


def check_names(sweep: Sweep) -> None:
    """Raises InputError if a swept value has the name of a column of `runs.csv`."""
    for name in sweep.swept:
        if name in COLUMNS:
            raise InputError(
                f"param {name}: runs.csv has a column of this name for the drives; rename the "
                "parameter in the scenario"
            )


def check_folder(folder: Path, identity: Mapping[str, str]) -> None:
    """Notes the sweep of a folder, or compares it with the noted one.

    Raises:
      InputError: the folder has the drives of another sweep; the message says what differs.
    """
    path = folder / "sweep.toml"
    identity = {**identity, "version of the code": sweep_code()}
    if path.exists():
        then = read_toml(path, "description of a sweep")
        for name in (*then, *identity):
            was, now = then.get(name, "not set"), identity.get(name, "not set")
            if was != now:
                raise InputError(
                    f"folder {str(folder)!r} has the drives of another sweep: its {name} was "
                    f"{was}, now it is {now}; use another --out, or remove the folder"
                )
        return
    lines = [f"{json.dumps(name)} = {json.dumps(text)}" for name, text in identity.items()]
    write_whole(path, ("\n".join(lines) + "\n").encode(), "description of a sweep")
