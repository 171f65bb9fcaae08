"""Fuel saved in traffic by predictive cruise control against constant-speed cruise, full stack.

Sixty trips take most of an hour of one core. They can be driven beforehand, several at a time;
a stopped run continues where it was:

    python -m iits_mj.validation.planning.planning_traffic --seeds 10 --jobs 2 --runs DIR \
        --out FILE.csv

`run_traffic` uses the trips in its `--runs DIR` and drives the others. A trip belongs to the code
that drove it: trips of another version are used neither from the folder nor from the table.
"""

from __future__ import annotations

import argparse
import math
import multiprocessing
import sys
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path

import numpy as np

from iits_mj.core.errors import Error, InputError
from iits_mj.core.results import Findings, Line, Panel, Results
from iits_mj.core.units import KMH
from iits_mj.parameters import TruckParameters
from iits_mj.validation.harness.config import ValidateConfig
from iits_mj.validation.harness.run_cache import runs_folder
from iits_mj.validation.harness.statistics import half_width
from iits_mj.validation.planning import traffic_trips
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
_MASS = 55_000.0


def run_traffic(config: ValidateConfig) -> Results:
    """Returns savings, trip times and other figures for each density.

    Raises:
      InputError: a kept trip cannot be read, or none be written.
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
    """Returns cruise and PCC of the same seed, by seed, where both were driven."""
    found = {row.key: row for row in rows if row.density == density and row.length == LENGTH}
    seeds = sorted({key[1] for key in found})
    pairs = []
    for seed in seeds:
        both = [found.get((density, seed, name, LENGTH)) for name in PLANNERS]
        if both[0] is not None and both[1] is not None:
            pairs.append((both[0], both[1]))
    return pairs


def saving_percent(cruise: TripRow, pcc: TripRow, worth: float) -> float:
    """Returns the fuel saved, PCC's corrected for its kinetic energy at the end [%].

    Args:
      cruise: one trip.
      pcc: the other.
      worth: of kinetic energy [kg/J].
    """
    energy = 0.5 * _MASS * (pcc.end_speed**2 - cruise.end_speed**2)
    return 100.0 * (1.0 - (pcc.fuel - worth * energy) / cruise.fuel)


def summarize(results: Results, rows: list[TripRow]) -> None:
    """Adds the figures of a table of trips."""
    worth = worth_of_energy(TruckParameters.load())
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
        # These are the same drive on each of the three stretches.
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
    """Drives the trips that folder and table lack; see the module docstring."""
    parser = argparse.ArgumentParser(description="fuel in traffic, with and without PCC")
    parser.add_argument("--seeds", type=int, default=SEEDS, help="a density")
    parser.add_argument("--jobs", type=int, default=1, help="processes at a time")
    parser.add_argument("--runs", type=Path, help="folder that keeps every finished pair")
    parser.add_argument("--out", type=Path, help="table of the trips, which is read as well")
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
    missing = [
        (density, seed)
        for density, seed in jobs
        if any((density, seed, name, LENGTH) not in known for name in PLANNERS)
    ]
    redone = set(missing)
    rows = [row for row in rows if (row.density, row.seed) not in redone]
    # SUMO is one to a process.
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(processes, mp_context=context) as pool:
        futures = [pool.submit(drive_pair, *job, folder) for job in missing]
        for count, future in enumerate(as_completed(futures), start=1):
            pair = future.result()
            rows += pair
            if out is not None:
                write_rows(out, rows)
            print(f"{count}/{len(missing)}: {_sentence(*pair)}", flush=True)
    return rows


def _sentence(cruise: TripRow, pcc: TripRow) -> str:
    saved = saving_percent(cruise, pcc, worth_of_energy(TruckParameters.load()))
    late = 100.0 * (pcc.time / cruise.time - 1.0)
    if math.isnan(saved):
        return f"{cruise.density}, seed {cruise.seed}: a trip failed"
    return (
        f"{cruise.density}, seed {cruise.seed}: {saved:.1f} % saved, {late:+.2f} % of time, "
        f"{cruise.changes} and {pcc.changes} changes"
    )


if __name__ == "__main__":
    sys.exit(main())
