"""How often the identification's 95 % intervals contain the truth, on synthetic drives.

    python benchmarks/identification_coverage.py --csv docs/identification_coverage.csv
    python benchmarks/identification_coverage.py --csv docs/identification_coverage.csv --summary

The first form draws trucks around the shipped one, drives each for 5 to 30 minutes on a random road
of its own, straight or winding, and identifies the truck from telemetry or from CAN frames, with
the shipped truck as the prior. Each row of the table is an estimate. The same command continues
after an interruption: it skips the trucks of the table. The second form prints the coverage of each
parameter as a table of Markdown.

A truck takes half a minute; `--only` lists the numbers of trucks to drive.
"""

from __future__ import annotations

import argparse
import functools
import math
import sys
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.stats import beta

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from iits_mj.core.tables import read_rows, write_rows
from iits_mj.identification import Log, from_frames, identify
from iits_mj.identification.engine import with_engine
from iits_mj.identification.log import with_grade
from iits_mj.parameters import TruckParameters
from iits_mj.parameters.mass_state import rolling_resistance
from iits_mj.truck import Truck
from tests.identification.synthetic_drives import (
    LATERAL,
    LONGITUDINAL,
    Driver,
    drive,
    frames,
    random_road,
    table,
)

WHAT = "estimates"
TRUCKS = 60
MINUTES = (5.0, 30.0)
SPEED_NOISE, YAW_NOISE = (0.002, 0.01), 0.002  # shares of the speed; [rad/s] and half of it in rad
PAYLOAD = (4_000.0, 34_000.0)  # [kg]
START, SPEED = 80.0, 15.0  # [m], [m/s]
TIMESTEP = 0.002  # of the physics [s]
# Messages with longer periods than a bus has them, which makes frames cheaper [s].
MESSAGES = LONGITUDINAL | LATERAL | dict.fromkeys(("VDC2", "IITS_TRAILER", "IITS_MOTION"), 0.04)
GRADE_STEP = 12.5  # of the given table of grades [m]
# Factors on the shipped truck's parameters.
TIRES, ROLLING, DRAG, BRAKES, ENGINE = (
    (0.85, 1.15),
    (0.8, 1.25),
    (0.8, 1.25),
    (0.8, 1.2),
    (0.9, 1.1),
)
ENGINE, FRICTION, TIMES, RATIO = (0.9, 1.1), (0.85, 1.3), (0.7, 1.5), (0.88, 1.12)


@dataclass(frozen=True)
class Row:
    """An estimate of a parameter from the drive of a truck.

    Attributes:
      truck: number of the draw; minutes: of the drive; winding: 1 on a road with bends.
      kind: of the log, "table" or "can"; known_mass: 1 if the mass was given.
      parameter: its name; truth, value, half_width: of the parameter, in its unit.
      shown: 1 if the log shows it, otherwise its interval and value mean nothing.
    """

    truck: int
    minutes: float
    winding: int
    kind: str
    known_mass: int
    parameter: str
    truth: float
    value: float
    half_width: float
    shown: int

    @property
    def covered(self) -> bool:
        return abs(self.value - self.truth) <= self.half_width


@dataclass(frozen=True)
class Case:
    """A truck with hidden parameters and its log; see `Row`."""

    minutes: float
    winding: bool
    kind: str
    known_mass: bool
    truths: dict[str, float]
    log: Log


@functools.cache
def shipped() -> TruckParameters:
    return TruckParameters.load()


def hidden(rng: np.random.Generator) -> tuple[TruckParameters, float, dict[str, float]]:
    """Draws a truck, its payload [kg] and the true values of its parameters."""
    p = shipped()
    payload = rng.uniform(*PAYLOAD)
    tires = {kind: rng.uniform(*TIRES) for kind in p.tires}
    rolling, brakes = rng.uniform(*ROLLING), rng.uniform(*BRAKES)
    times = {circuit: rng.uniform(*TIMES, 2) for circuit in ("front", "drive", "trailer")}
    circuit = {"steer": "front", "drive": "drive", "trailer": "trailer"}
    gearbox = p.gearbox
    cut, synchronization = rng.uniform(*TIMES, 2)
    overlay = {
        "tires": {
            kind: {
                "cornering_coefficient": factor * p.tires[kind].cornering_coefficient,
                "rolling_resistance": rolling * p.tires[kind].rolling_resistance,
            }
            for kind, factor in tires.items()
        },
        "aerodynamics": {"drag_area": rng.uniform(*DRAG) * p.aerodynamics.drag_area},
        "steering": {"ratio": rng.uniform(*RATIO) * p.steering.ratio},
        "gearbox": {
            "shift_cut_time": cut * gearbox.shift_cut_time,
            "synchronization_time": synchronization * gearbox.synchronization_time,
            "synchronization_time_max": synchronization * gearbox.synchronization_time_max,
        },
        "units": {
            unit.name: {
                "axles": {
                    axle.name.removeprefix(f"{unit.name}_"): {
                        "brake": {
                            "torque_per_pressure": brakes * axle.brake.torque_per_pressure,
                            "dead_time": dead * axle.brake.dead_time,
                            "build_up_time_constant": lag * axle.brake.build_up_time_constant,
                        }
                    }
                    for axle in unit.axles
                    for dead, lag in [times[circuit[axle.tire]]]
                }
            }
            for unit in p.units
        },
    }
    engine = {
        "torque_map_scale": rng.uniform(*ENGINE),
        "engine_drag_scale": rng.uniform(*FRICTION),
        "boost_lag": rng.uniform(*TIMES) * p.engine.boost_lag,
        "torque_rise_rate": rng.uniform(*TIMES) * p.engine.torque_rise_rate,
    }
    truck = with_engine(TruckParameters.load(overlay=overlay), engine)
    truths = {
        "mass": truck.gross_mass(payload),
        "rolling_resistance": rolling_resistance(truck, payload),
        "drag_area": truck.aerodynamics.drag_area,
        "engine_torque_scale": 1.0,
        "brake_gain": brakes,
        **engine,
        "shift_cut_time": truck.gearbox.shift_cut_time,
        "synchronization_time": truck.gearbox.synchronization_time,
        "steering_ratio": truck.steering.ratio,
    }
    for kind, tire in truck.tires.items():
        truths[f"cornering_coefficient_{kind}"] = tire.cornering_coefficient
    for axle in truck.axles:
        name, brake = circuit[axle.tire], axle.brake
        line = truck.air_brake.trailer_line_delay if name == "trailer" else 0.0
        truths[f"brake_gain_{name}"] = brakes
        truths[f"{name}_dead_time"] = brake.dead_time + line
        truths[f"{name}_build_up_time"] = brake.build_up_time_constant
    return truck, payload, truths


def case(number: int) -> Case:
    """The truck of a number, its drive and its log."""
    rng = np.random.default_rng([number, 0])
    minutes, winding = math.exp(rng.uniform(*np.log(MINUTES))), bool(rng.random() < 0.5)
    kind, known = "can" if rng.random() < 0.5 else "table", bool(rng.random() < 0.5)
    parameters, payload, truths = hidden(rng)
    noise = rng.uniform(*SPEED_NOISE)
    road = random_road(rng, 60.0 * minutes * 22.0 + 1_000.0, winding=winding)
    truck = Truck.load(payload, parameters=parameters, route=road, visuals=False, timestep=TIMESTEP)
    truck.reset(station=START, speed=SPEED)
    driver = Driver(rng, road, parameters, weave=0.1 if winding else 0.4)
    rows = drive(truck, driver, 60.0 * minutes)
    if kind == "can":
        sent = frames(rows, shipped(), MESSAGES, noise=noise, yaw_noise=YAW_NOISE, seed=number)
        log = from_frames(sent, shipped())
    else:
        log = table(rows, noise=noise, yaw_noise=YAW_NOISE, seed=number)
    station = np.arange(0.0, rows[-1][0].station + 100.0, GRADE_STEP)
    log = with_grade(log, station, np.asarray(road.smoothed_grade(station)))
    return Case(minutes, winding, kind, known, truths, log)


def estimates(number: int, made: Case) -> list[Row]:
    """Rows of all parameters that have a truth."""
    mass = made.truths["mass"] if made.known_mass else None
    found = identify(made.log, shipped(), mass=mass)
    labels = (number, round(made.minutes, 2), int(made.winding), made.kind, int(made.known_mass))
    return [
        Row(*labels, e.name, made.truths[e.name], e.value, e.half_width, int(e.identifiable))
        for e in found.estimates
        if e.name in made.truths
    ]


def summary(rows: Iterable[Row]) -> str:
    """Coverage of each parameter, as a table of Markdown."""
    lines = [
        "| parameter | drives | shown | covered | share, 95 % range | error | half-width |",
        "|---|---|---|---|---|---|---|",
    ]
    groups: dict[str, list[Row]] = {}
    for row in rows:
        groups.setdefault(row.parameter, []).append(row)
    groups["all"] = [row for group in groups.values() for row in group]
    for name, group in groups.items():
        shown = [row for row in group if row.shown]
        line = f"| {name} | {len(group)} | {len(shown)} |"
        if not shown:
            lines.append(f"{line} | | | | |")
            continue
        hits = sum(row.covered for row in shown)
        low, high = _range(hits, len(shown))
        error = 100.0 * np.median([abs(row.value / row.truth - 1.0) for row in shown])
        half = 100.0 * np.median([row.half_width / row.truth for row in shown])
        share = f"{100 * hits / len(shown):.0f} % ({100 * low:.0f} to {100 * high:.0f})"
        lines.append(f"{line} {hits} | {share} | {error:.2g} % | {half:.2g} % |")
    return "\n".join(lines)


def _range(hits: int, trials: int) -> tuple[float, float]:
    """Clopper-Pearson's 95 % interval of a share."""
    low = float(beta.ppf(0.025, hits, trials - hits + 1)) if hits else 0.0
    high = float(beta.ppf(0.975, hits + 1, trials - hits)) if hits < trials else 1.0
    return low, high


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("--csv", type=Path, required=True, metavar="FILE.csv", help="the table")
    parser.add_argument("--trucks", type=int, default=TRUCKS, help=f"default {TRUCKS}")
    parser.add_argument("--only", type=int, nargs="+", metavar="NUMBER", help="these trucks only")
    parser.add_argument("--summary", action="store_true", help="print the coverage, drive nothing")
    options = parser.parse_args(arguments)
    rows = read_rows(options.csv, Row, WHAT)
    if not options.summary:
        done = {row.truck for row in rows}
        for number in options.only or range(options.trucks):
            if number in done:
                continue
            rows += estimates(number, case(number))
            write_rows(options.csv, Row, rows, WHAT)
            print(f"truck {number}: {sum(r.covered for r in rows if r.shown)} covered", flush=True)
    print(summary(rows))
    return 0


if __name__ == "__main__":
    sys.exit(main())
