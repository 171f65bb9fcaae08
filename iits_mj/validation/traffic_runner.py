"""Drives the trips in traffic several at a time, and goes on where it was stopped.

    python -m iits_mj.validation.traffic_runner --seeds 10 --jobs 2 --runs DIR --out FILE.csv

A trip belongs to the code that drove it: those of another version are taken neither from the folder
nor from the table.
"""

from __future__ import annotations

import argparse
import math
import multiprocessing
import sys
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path

from iits_mj.errors import Error, InputError
from iits_mj.parameters import TruckParameters
from iits_mj.results import Results
from iits_mj.validation import traffic_trips
from iits_mj.validation.config import ValidateConfig
from iits_mj.validation.kept_runs import runs_folder
from iits_mj.validation.planning_traffic import (
    PART,
    SEEDS,
    all_pairs,
    saving_percent,
    summarize,
)
from iits_mj.validation.traffic_trips import (
    LENGTH,
    PLANNERS,
    TripRow,
    drive_pair,
    read_rows,
    trip_code,
    worth_of_energy,
    write_rows,
)


def main(arguments: list[str] | None = None) -> int:
    """Drives the trips that folder and table lack; see the module."""
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
    """The trips of densities and seeds; what is not in the table of this code is driven."""
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
