"""Fuel saved in traffic by predictive cruise control against constant-speed cruise, full stack.

Sixty trips take most of an hour of one core. This command drives them beforehand, several at a
time; a stopped run continues:

    python -m iits_mj.validation.planning.planning_traffic --seeds 10 --jobs 2 --runs DIR \
        --out FILE.csv

`run_traffic` uses the trips in its `--runs DIR` and drives the others. Trips of another version of
the code are used neither from the folder nor from the table.
"""

from __future__ import annotations

import argparse
import functools
import math
import sys
from pathlib import Path

import numpy as np

from iits_mj.core.errors import Error, InputError
from iits_mj.core.process_pool import run_all
from iits_mj.core.results import Findings, Line, Panel, Results
from iits_mj.core.units import KMH
from iits_mj.validation.harness.config import ValidateConfig
from iits_mj.validation.harness.run_cache import runs_folder
from iits_mj.validation.harness.statistics import half_width
from iits_mj.validation.planning import traffic_trips
from iits_mj.validation.planning.pcc_case import GROSS_MASS
from iits_mj.validation.planning.traffic_trips import (
    DENSITIES,
    LENGTH,
    PLANNERS,
    SPEED,
    TRAFFIC_SPEED,
    TripRow,
    drive_pair,
    read_rows,
    trip_code,
    worth_of_energy,
    write_rows,
)

SEEDS = 10
FIRST_SEED = 100  # lower ones were used in the development of the planner
FEWEST = 3  # seeds a density for a mean
PART = "planning-traffic"


def run_traffic(config: ValidateConfig) -> Results:
    """Returns savings, trip times and other figures for each density.

    Raises:
      InputError: a kept trip cannot be read, or a trip cannot be written.
    """
    results = Results("validate planning traffic")
    if config.quick:
        results.notes.append("traffic: left out of the quick form, as its trips take minutes each")
        return results
    folder = runs_folder(config, PART, traffic_trips)
    rows: list[TripRow] = []
    for density, seed in all_pairs(SEEDS):
        rows += drive_pair(density, seed, folder)
    summarize(results, rows)
    return results


def all_pairs(seeds: int) -> list[tuple[str, int]]:
    """Returns density and seed of every pair."""
    wanted = range(FIRST_SEED, FIRST_SEED + seeds)
    return [(density, seed) for seed in wanted for density in DENSITIES]


def pairs_of(rows: list[TripRow], density: str) -> list[tuple[TripRow, TripRow]]:
    """Returns cruise and PCC of each seed with both trips, sorted by seed."""
    found = {row.key: row for row in rows}
    seeds = sorted({row.seed for row in rows if row.density == density})
    keys = [[(density, seed, name, LENGTH) for name in PLANNERS] for seed in seeds]
    return [(found[a], found[b]) for a, b in keys if a in found and b in found]


def saving_percent(cruise: TripRow, pcc: TripRow, worth: float) -> float:
    """Returns the saving of fuel [%], corrected for the kinetic energy of PCC at the end.

    The worth of kinetic energy is in kg/J.
    """
    energy = 0.5 * GROSS_MASS * (pcc.end_speed**2 - cruise.end_speed**2)
    return 100.0 * (1.0 - (pcc.fuel - worth * energy) / cruise.fuel)


def summarize(results: Results, rows: list[TripRow]) -> None:
    """Adds the figures of a table of trips."""
    worth = worth_of_energy()
    lines, speeds = [], []
    for density in DENSITIES:
        pairs = pairs_of(rows, density)
        driven = [(c, p) for c, p in pairs if not c.failed and not p.failed]
        if len(driven) < FEWEST:
            results.notes.append(f"traffic, {density}: {len(driven)} pairs are too few to tell")
            continue
        found = Findings(f"in traffic, {density}")
        saved = np.array([saving_percent(c, p, worth) for c, p in driven])
        late = np.array([100.0 * (p.time / c.time - 1.0) for c, p in driven])
        name, interval = f"fuel saved, mean of {len(driven)}", f"±{half_width(saved):.2f}"
        found.check(name, saved.mean(), "%", interval, "> 0")
        found.check("trip time, mean over the cruise's", late.mean(), "%", 0.0, "-1 .. 1")
        found.check("trip time, greatest difference", np.abs(late).max(), "%")
        changes = float(np.mean([p.changes - c.changes for c, p in driven]))
        found.check("lane changes, pcc less cruise", changes, "1")
        failed = sum(c.failed + p.failed for c, p in pairs)
        found.check("collisions and trips not ended", failed, "1", None, "<= 0")
        planned, others = (sum(getattr(p, n) for _, p in driven) for n in ("plans", "other_plans"))
        share = 100.0 * planned / max(planned + others, 1)
        found.check("plans by the optimizer", share, "%")
        braking = [np.mean([row.friction for row in trips]) for trips in zip(*driven, strict=True)]
        name = "friction brakes on, pcc, a trip (reference: cruise)"
        found.check(name, braking[1], "s", braking[0])
        # On each of the three stretches these trips are the same drive.
        alone = sum(math.isinf(c.closest) for c, _ in driven)
        found.check("trips that had nobody ahead", alone, "1")
        solve = 1e3 * float(np.median([p.solve_p50 for _, p in driven]))
        found.check("solve, median", solve, "ms")
        results.checks += found.checks
        seeds = np.array([c.seed for c, _ in driven], dtype=float)
        lines.append(Line(density, seeds, saved))
        speeds.append(Line(density, seeds, np.array([LENGTH / c.time / KMH for c, _ in driven])))
    results.figures["in traffic"] = [
        Panel("Fuel saved by PCC", "seed", "saving [%]", tuple(lines)),
        Panel("Mean speed of the cruise", "seed", "speed [km/h]", tuple(speeds)),
    ]
    results.notes.append(
        f"traffic: {LENGTH / 1e3:g} km of the built-in highway, 55 t, reference {SPEED / KMH:g} "
        f"km/h, band {0.75 * SPEED / KMH:g} to 90 km/h within the road's limits, traffic at "
        f"{TRAFFIC_SPEED / KMH:g} km/h that reacts to the truck, MOBIL; the cruise is driven first "
        "and PCC is asked to arrive when it did, neither later nor earlier, as fast as it was; "
        "fuel corrected for kinetic energy at the end; ± is the 95 % interval of the paired mean"
    )


def main(arguments: list[str] | None = None) -> int:
    """Drives the trips missing in folder and table; see the module docstring."""
    parser = argparse.ArgumentParser(description="fuel in traffic, with and without PCC")
    parser.add_argument("--seeds", type=int, default=SEEDS, help="number for each density")
    parser.add_argument("--jobs", type=int, default=1, help="number of processes")
    parser.add_argument("--runs", type=Path, help="folder that keeps every finished pair")
    parser.add_argument(
        "--out", type=Path, help="table of the trips; trips in it are not driven again"
    )
    asked = parser.parse_args(arguments)
    try:
        if not 1 <= asked.seeds <= 1_000 or not 1 <= asked.jobs <= 256:
            raise InputError("seeds must be 1 to 1000, jobs 1 to 256")
        folder = runs_folder(ValidateConfig(runs=asked.runs), PART, traffic_trips)
        rows = _drive(all_pairs(asked.seeds), asked.jobs, folder, asked.out)
    except Error as error:
        print(f"traffic_runner: {error}", file=sys.stderr)
        return 2
    results = Results("validate planning traffic")
    summarize(results, rows)
    print(results.to_table())
    return 0


def _drive(
    jobs: list[tuple[str, int]], processes: int, folder: Path | None, out: Path | None
) -> list[TripRow]:
    """Returns the trips of densities and seeds; drives those that are not in the table."""
    found = [] if out is None else read_rows(out)
    rows = [row for row in found if row.code == trip_code()]
    if len(rows) < len(found):
        print(f"{len(found) - len(rows)} trips of the table are of other code: left out")
    known = {row.key for row in rows}
    missing = [job for job in jobs if any((*job, name, LENGTH) not in known for name in PLANNERS)]
    rows = [row for row in rows if (row.density, row.seed) not in missing]
    done = 0

    def keep(pair: list[TripRow]) -> None:
        nonlocal done
        done += 1
        rows.extend(pair)
        if out is not None:
            write_rows(out, rows)
        print(f"{done}/{len(missing)}: {_sentence(*pair)}", flush=True)

    work = functools.partial(_drive_job, folder)
    run_all(missing, processes, work, keep, lambda job: f"{job[0]}, seed {job[1]}", what="pairs")
    return rows


def _drive_job(folder: Path | None, job: tuple[str, int]) -> list[TripRow]:
    return drive_pair(*job, folder)


def _sentence(cruise: TripRow, pcc: TripRow) -> str:
    saved = saving_percent(cruise, pcc, worth_of_energy())
    late = 100.0 * (pcc.time / cruise.time - 1.0)
    if math.isnan(saved):
        return f"{cruise.density}, seed {cruise.seed}: a trip failed"
    return (
        f"{cruise.density}, seed {cruise.seed}: {saved:.1f} % saved, {late:+.2f} % of time, "
        f"{cruise.changes} and {pcc.changes} changes"
    )


if __name__ == "__main__":
    sys.exit(main())
