"""Response of the service brake on the standing truck, as UN R13, annex 6 measures it.

The pedal goes down at once and in full; what counts is the least favorable chamber: the time until
it has 75 % of its final pressure must not exceed 0.6 s. Pressure begins to rise after the dead time
of the lines; the trailer's control line adds its own.
"""

from __future__ import annotations

import numpy as np

from iits_mj.core.messages import VehicleCommand, XbrEbiMode, XbrMode
from iits_mj.core.results import Check, Line, Panel
from iits_mj.core.units import KMH
from iits_mj.parameters import TruckParameters
from iits_mj.truck import Truck
from iits_mj.validation.harness.recorder import PERIOD
from iits_mj.validation.longitudinal.full_stop import (
    FULL,
    first_rise,
    mean_jerk,
    mean_pressure,
    panel,
    rise_time,
    smooth_rate,
)
from iits_mj.validation.longitudinal.runs import Run, run

# --- XBR -1.5 m/s2 at 60 km/h as in the paper: build-up, mean, overshoot, pressure, release ---

SPEED = 60.0 * KMH
DEMAND = 1.5
START, RELEASE, END = 1.0, 8.0, 13.0
# After it the deceleration has built up [s].
_BUILD_UP = 2.0
_ANCHOR_MASS = 50.0
# Jerk that ISO 15622 allows at low speed, over a time in which brakes let go at once exceed it.
_JERK, _JERK_WINDOW = 5.0, 0.2
# Time for the deceleration to be gone after the release [s].
_GONE = 1.5


def xbr_run(payload: float, timestep: float, ebi: XbrEbiMode = XbrEbiMode.FRICTION_ONLY) -> Run:
    """60 km/h, pedal up; XBR -1.5 m/s2 from 1 to 8 s, then nothing until 13 s."""
    truck = Truck.load(payload, timestep=timestep, visuals=False)
    truck.reset(speed=SPEED)
    braking = VehicleCommand(xbr_demand=-DEMAND, xbr_mode=XbrMode.MAXIMUM, xbr_ebi_mode=ebi)
    rolling = VehicleCommand()
    return run(truck, lambda time, _: braking if START <= time < RELEASE else rolling, END)


def xbr(payload: float, timestep: float) -> tuple[list[Check], list[Panel]]:
    """The paper's brake test at one payload [kg]; friction alone, then with endurance brakes."""
    record = xbr_run(payload, timestep)
    mass = Truck.load(payload, timestep=timestep, visuals=False).parameters.gross_mass(payload)
    tons = mass / 1e3
    label = f"XBR -1.5 m/s2 at 60 km/h, {tons:g} t"
    pressure = mean_pressure(record)
    built = (record.time > START + _BUILD_UP) & (record.time < RELEASE)
    checks = [
        *_deceleration(label, record),
        *_release(label, record),
        *_response(label, record),
    ]
    if abs(tons - _ANCHOR_MASS) < 0.5:
        level = float(pressure[built].mean()) / 1e3
        checks.append(Check(f"{label}: mean pressure", level, "kPa", 150.0, "120 .. 180"))
    blended = xbr_run(payload, timestep, XbrEbiMode.INTEGRATION)
    name = f"{label}, endurance brakes integrated"
    checks += [*_deceleration(name, blended), *_release(name, blended)]
    saved = 1.0 - mean_pressure(blended)[built].mean() / pressure[built].mean()
    checks.append(Check(f"{name}: brake pressure saved", 100.0 * float(saved), "%", None, ">= 10"))
    panels = [
        panel(f"{label}: speed", "speed [km/h]", record, record.speed / KMH),
        panel(f"{label}: acceleration", "acceleration [m/s2]", record, smooth_rate(record)),
        panel(f"{label}: mean brake pressure", "pressure [kPa]", record, pressure / 1e3),
        panel(f"{name}: acceleration", "acceleration [m/s2]", blended, smooth_rate(blended)),
        panel(f"{name}: mean pressure", "pressure [kPa]", blended, mean_pressure(blended) / 1e3),
    ]
    return checks, panels


def _deceleration(label: str, record: Run) -> list[Check]:
    built = np.flatnonzero((record.time > START + _BUILD_UP) & (record.time < RELEASE))
    lost = record.speed[built[0]] - record.speed[built[-1]]
    mean = float(lost / (record.time[built[-1]] - record.time[built[0]]))
    greatest = -float(smooth_rate(record)[record.time < RELEASE].min())
    return [
        Check(f"{label}: mean deceleration", mean, "m/s2", DEMAND, "1.455 .. 1.545"),
        Check(f"{label}: overshoot", 100.0 * (greatest / DEMAND - 1.0), "%", None, "<= 10"),
    ]


def _release(label: str, record: Run) -> list[Check]:
    """Released smoothly: no jerk, no kick beyond coasting, and over in a second and a half."""
    rate = smooth_rate(record)
    after = record.time >= RELEASE
    coasting = float(rate[record.time > END - 1.0].mean())
    jerk = mean_jerk(record, _JERK_WINDOW)
    times = record.time[: len(jerk)]
    late = rate[record.time > RELEASE + _GONE]
    return [
        Check(
            f"{label}: jerk of the release, mean over {_JERK_WINDOW:g} s",
            float(np.max(np.abs(jerk[times >= RELEASE - _JERK_WINDOW]))),
            "m/s3",
            None,
            f"<= {_JERK:g}",
        ),
        Check(
            f"{label}: kick beyond coasting after the release",
            100.0 * max(0.0, float(rate[after].max()) - coasting) / DEMAND,
            "%",
            None,
            "<= 10",
        ),
        Check(
            f"{label}: braking left {_GONE:g} s after the release",
            100.0 * float(np.max(coasting - late)) / DEMAND,
            "%",
            None,
            "<= 10",
        ),
    ]


def _response(label: str, record: Run) -> list[Check]:
    """75 % of the pressure at the least favorable chamber; first rise at the first and last."""
    time = record.time - START
    held = (time > _BUILD_UP) & (record.time < RELEASE)
    slowest, first, last = 0.0, np.inf, 0.0
    for pressure in record.wheel_pressures.T:
        final = float(pressure[held].mean())
        slowest = np.fmax(slowest, rise_time(time, pressure, 0.75, final))
        begun = first_rise(time, pressure)
        first, last = np.fmin(first, begun), np.fmax(last, begun)
    return [
        Check(f"{label}: 75 % of the pressure after", float(slowest), "s", None, "<= 0.6"),
        Check(f"{label}: first chamber's pressure rises after", float(first), "s", None, ""),
        Check(f"{label}: last chamber's pressure rises after", float(last), "s", None, ""),
    ]


# --- Response of the service brake on the standing truck, as UN R13, annex 6 measures it ---

_START, _RELEASE, _END = 1.0, 4.0, 7.0
_LIMIT = 0.6
_SHARE = 0.75
# A rise is seen later than it begins: 2 kPa have to be there, sampled every 10 ms [s].
_DETECTED = 0.03


def dead_times(parameters: TruckParameters) -> list[float]:
    """Time before a chamber's pressure rises [s], of each axle; the trailer's with its line."""
    brakes, count = parameters.air_brake, len(parameters.tractor.axles)
    return [
        time + (brakes.trailer_line_delay if axle >= count else 0.0)
        for axle, time in enumerate(brakes.dead_time)
    ]


def compare(payload: float, timestep: float) -> tuple[list[Check], list[Panel]]:
    """Pedal down in full for 3 s on the standing truck, payload [kg]."""
    truck = Truck.load(payload, timestep=timestep, visuals=False)
    truck.reset()
    down, up = FULL, VehicleCommand()
    record = run(truck, lambda time, _: down if _START <= time < _RELEASE else up, _END)
    time = record.time - _START
    label = f"brake pedal down at standstill, {truck.parameters.gross_mass(payload) / 1e3:g} t"
    checks, lines = [], []
    for axle, dead_time in enumerate(dead_times(truck.parameters)):
        pressure = record.wheel_pressures[:, 2 * axle : 2 * axle + 2].min(axis=1)
        final = float(pressure[record.time < _RELEASE][-1])
        checks += [
            Check(
                f"{label}, axle {axle + 1}: first rise after",
                first_rise(time, pressure),
                "s",
                dead_time,
                f"{dead_time - PERIOD:.2f} .. {dead_time + _DETECTED:.2f}",
            ),
            Check(
                f"{label}, axle {axle + 1}: 75 % of the pressure after (UN R13)",
                rise_time(time, pressure, _SHARE, final),
                "s",
                None,
                f"<= {_LIMIT:g}",
            ),
        ]
        lines.append(Line(f"axle {axle + 1}", record.time, pressure / 1e3))
    final = float(record.wheel_pressures[record.time < _RELEASE][-1].min())
    left = record.wheel_pressures.max(axis=1)
    gone = np.flatnonzero((record.time > _RELEASE) & (left < 0.1 * final))
    released = float(record.time[gone[0]] - _RELEASE) if len(gone) else float("nan")
    checks += [
        Check(f"{label}: least final pressure", final / 1e3, "kPa"),
        Check(f"{label}: down to 10 % after the release", released, "s", None, "<= 2"),
    ]
    return checks, [Panel(f"{label}: pressures", "time [s]", "pressure [kPa]", tuple(lines))]
