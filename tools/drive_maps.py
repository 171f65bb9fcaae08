"""Drives every OpenDRIVE file of some folders for a short time and tabulates the outcomes.

    python tools/drive_maps.py --table out/maps.csv maps/ road.xodr
    python tools/drive_maps.py --table out/maps.csv --page      # table in Markdown, and sums

Each drive has a process of its own with a time limit. A row is appended when a drive is complete;
the same command continues after an interruption and skips the maps that have a row. Outcomes:

    drives    the truck drove for the time asked without a failure
    end       it reached the end of the route before
    refused   the project's own error; the reason is its message
    failed    collision, roll-over, off the road, or divergence
    crashes   a traceback or a signal
    hangs     the process did not end within the time limit
"""

from __future__ import annotations

import argparse
import csv
import json
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

FIELDS = ("map", "scope", "outcome", "distance_m", "route_m", "load_s", "drive_s", "reason")
FINE = ("drives", "end")


def main(words: list[str] | None = None) -> int:
    """Drives the maps that have no row yet; exit code 1 if one hangs or crashes."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("maps", nargs="*", type=Path, help="files or folders")
    parser.add_argument("--table", type=Path, help="CSV file of the outcomes")
    parser.add_argument("--seconds", type=float, default=20.0, help="simulated time of a drive [s]")
    parser.add_argument("--limit", type=float, default=180.0, help="longest time of a process [s]")
    parser.add_argument("--scopes", default="route,map", help="scopes of the traffic")
    parser.add_argument("--page", action="store_true", help="print the table in Markdown")
    parser.add_argument("--one", help=argparse.SUPPRESS)
    options = parser.parse_args(words)
    if options.one:
        print(json.dumps(_drive(options.maps[0], options.one, options.seconds)))
        return 0
    if options.table is None:
        parser.error("--table is needed")
    rows = _read(options.table)
    if options.page:
        print(page(rows))
        return 0
    known = {(row["map"], row["scope"]) for row in rows}
    options.table.parent.mkdir(parents=True, exist_ok=True)
    for path in _files(options.maps):
        for scope in options.scopes.split(","):
            if (path.stem, scope) in known:
                continue
            row = {"map": path.stem, "scope": scope} | _guarded(path, scope, options)
            rows.append(row)
            _append(options.table, row)
            print(*(row.get(field, "") for field in FIELDS), sep="\t", flush=True)
    counts = Counter(row["outcome"] for row in rows)
    print(", ".join(f"{count} {outcome}" for outcome, count in sorted(counts.items())))
    return 1 if counts["hangs"] or counts["crashes"] else 0


def page(rows: list[dict[str, Any]]) -> str:
    """Returns the table of the outcomes in Markdown, and how many maps drive in each scope."""
    scopes = sorted({row["scope"] for row in rows}, reverse=True)
    maps: dict[str, dict[str, dict[str, Any]]] = {}
    for row in rows:
        maps.setdefault(row["map"], {})[row["scope"]] = row
    lines = [f"| map | {' | '.join(scopes)} | reason |", "|---" * (len(scopes) + 2) + "|"]
    for name, found in sorted(maps.items()):
        cells = [found[scope]["outcome"] if scope in found else "" for scope in scopes]
        reasons = dict.fromkeys(row["reason"] for row in found.values() if row["reason"])
        lines.append(f"| {name} | {' | '.join(cells)} | {'; '.join(reasons)} |")
    for scope in scopes:
        outcomes = [row["outcome"] for row in rows if row["scope"] == scope]
        fine = sum(outcome in FINE for outcome in outcomes)
        lines.append(f"\nScope {scope}: {fine} of {len(outcomes)} maps drive.")
    return "\n".join(lines)


def _files(paths: list[Path]) -> Iterator[Path]:
    for path in paths:
        yield from sorted(path.rglob("*.xodr")) if path.is_dir() else [path]


def _read(table: Path) -> list[dict[str, Any]]:
    if not table.is_file():
        return []
    with table.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def _append(table: Path, row: dict[str, Any]) -> None:
    new = not table.is_file()
    with table.open("a", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, FIELDS)
        if new:
            writer.writeheader()
        writer.writerow(row)


def _guarded(path: Path, scope: str, options: argparse.Namespace) -> dict[str, Any]:
    """The outcome of one drive in its own process."""
    command = [sys.executable, __file__, str(path), "--one", scope]
    command += ["--seconds", str(options.seconds)]
    try:
        done = subprocess.run(
            command, capture_output=True, text=True, timeout=options.limit, check=False
        )
    except subprocess.TimeoutExpired:
        return {"outcome": "hangs", "reason": f"no end within {options.limit:g} s"}
    lines = done.stdout.splitlines()
    if done.returncode == 0 and lines:
        return dict(json.loads(lines[-1]))
    last = (done.stderr.strip().splitlines() or [""])[-1]
    return {"outcome": "crashes", "reason": f"exit code {done.returncode}: {last}"}


def _drive(path: Path, scope: str, seconds: float) -> dict[str, Any]:
    """Drives one map in this process."""
    from iits_mj.core.errors import Error
    from iits_mj.simulation import DriveConfig, Simulation

    begin = time.perf_counter()
    try:
        config = DriveConfig(map=path, duration=seconds, traffic_scope=scope, density="medium")
        simulation = Simulation(config, visuals=False)
    except Error as error:
        return {"outcome": "refused", "reason": str(error)}
    loaded = time.perf_counter()
    row: dict[str, Any] = {
        "route_m": round(simulation.route.length, 1),
        "load_s": round(loaded - begin, 2),
    }
    try:
        summary = simulation.run()
    except Error as error:
        return row | {"outcome": "failed", "reason": str(error)}
    finally:
        simulation.close()
    end = "end of the route" in summary.ended
    outcome = "failed" if summary.failed else "end" if end else "drives"
    return row | {
        "outcome": outcome,
        "distance_m": round(summary.distance, 1),
        "drive_s": round(time.perf_counter() - loaded, 2),
        "reason": summary.ended if summary.failed else "",
    }


if __name__ == "__main__":
    raise SystemExit(main())
