"""Fuel saved in traffic by predictive cruise control, full stack, against constant-speed cruise.

Sixty trips take the better part of an hour of one core, so that they can be driven beforehand by
`traffic_runner`. `run_traffic` takes what its `--runs DIR` holds and drives the rest. A trip
belongs to the code that drove it: those of another version are not taken.
"""

from __future__ import annotations

import math

import numpy as np

from iits_mj.parameters import TruckParameters
from iits_mj.results import Check, Line, Panel, Results
from iits_mj.units import KMH
from iits_mj.validation import traffic_trips
from iits_mj.validation.config import ValidateConfig
from iits_mj.validation.evaluate import half_width
from iits_mj.validation.kept_runs import runs_folder
from iits_mj.validation.traffic_trips import (
    DENSITIES,
    LENGTH,
    PLANNERS,
    SPEED,
    TRAFFIC_SPEED,
    TripRow,
    drive_pair,
    worth_of_energy,
)

SEEDS = 10
FIRST_SEED = 100  # lower ones were looked at while the planner was made
FEWEST = 3  # seeds a density that say anything
PART = "planning-traffic"
_MASS = 55_000.0


def run_traffic(config: ValidateConfig) -> Results:
    """Savings, trip times and what else there is to know, a density each.

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
    """Density and seed of every pair."""
    wanted = range(FIRST_SEED, FIRST_SEED + seeds)
    return [(density, seed) for seed in wanted for density in DENSITIES]


def pairs_of(rows: list[TripRow], density: str) -> list[tuple[TripRow, TripRow]]:
    """Cruise and PCC of the same seed, by seed, where both were driven."""
    found = {row.key: row for row in rows if row.density == density and row.length == LENGTH}
    seeds = sorted({key[1] for key in found})
    pairs = []
    for seed in seeds:
        both = [found.get((density, seed, name, LENGTH)) for name in PLANNERS]
        if both[0] is not None and both[1] is not None:
            pairs.append((both[0], both[1]))
    return pairs


def saving_percent(cruise: TripRow, pcc: TripRow, worth: float) -> float:
    """Fuel saved, PCC's being corrected for its kinetic energy at the end [%].

    Args:
      cruise: one trip.
      pcc: the other.
      worth: of a joule [kg/J].
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
        saved = np.array([saving_percent(c, p, worth) for c, p in driven])
        late = np.array([100.0 * (p.time / c.time - 1.0) for c, p in driven])
        name = f"in traffic, {density}: "
        changes = np.mean([p.changes - c.changes for c, p in driven])
        planned = sum(p.plans for _, p in driven)
        others = sum(p.other_plans for _, p in driven)
        failed = sum(c.failed + p.failed for c, p in pairs)
        results.checks += [
            Check(
                name + f"fuel saved, mean of {len(driven)}",
                float(saved.mean()),
                "%",
                f"±{half_width(saved):.2f}",
                "> 0",
            ),
            Check(
                name + "trip time, mean over the cruise's", float(late.mean()), "%", 0.0, "-1 .. 1"
            ),
            Check(name + "trip time, greatest difference", float(np.abs(late).max()), "%"),
            Check(name + "lane changes, pcc less cruise", float(changes), "1"),
            Check(name + "collisions and trips not ended", float(failed), "1", None, "<= 0"),
            Check(name + "plans by the optimizer", 100.0 * planned / max(planned + others, 1), "%"),
            Check(
                name + "friction brakes on, pcc, a trip (reference: cruise)",
                float(np.mean([p.friction for _, p in driven])),
                "s",
                float(np.mean([c.friction for c, _ in driven])),
            ),
            # These are the same drive on each of the three stretches.
            Check(
                name + "trips that had nobody ahead",
                float(sum(math.isinf(c.closest) for c, _ in driven)),
                "1",
            ),
            Check(
                name + "solve, median",
                1e3 * float(np.median([p.solve_p50 for _, p in driven])),
                "ms",
            ),
        ]
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
