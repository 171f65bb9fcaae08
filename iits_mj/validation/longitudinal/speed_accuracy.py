"""Accuracy of the speed in the paper's sense: replay the same commands, compare the speed.

The paper gives 89 % over all its longitudinal experiments without saying of what. Here it is the
fit of one speed history to the other, as system identification has it:

    accuracy = 100 (1 - |v - v_ref| / |v_ref - mean(v_ref)|)

over every experiment's whole duration, averaged over the experiments; the milder sense, mean error
over mean speed, is told besides. The references at hand are the published run (computed anew from
the published tables), the demanded deceleration behind the lag of the brakes, and the force balance
under the truck's own engine torque.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from iits_mj.core.arrays import FloatArray
from iits_mj.core.results import Check, Line, Panel
from iits_mj.core.units import KMH
from iits_mj.parameters import TruckParameters
from iits_mj.parameters.files import Table2D
from iits_mj.validation.harness.recorder import PERIOD, fit
from iits_mj.validation.longitudinal import braking
from iits_mj.validation.longitudinal.acceleration import (
    coast_along,
    full_pedal_run,
    part_throttle_run,
)
from iits_mj.validation.longitudinal.braking import dead_times
from iits_mj.validation.longitudinal.force_balance import ForceBalance
from iits_mj.validation.longitudinal.runs import Run

# --- The published 40 % pedal run, computed anew from the published tables: a point mass, no MuJoCo
# What the paper's authors released of their own truck model are tables: pedal map, full load, shift
# speeds, ratios, torque rates, and that a gear change takes 0.6 to 1.0 s with torque below 60 N m
# for 0.6 to 0.7 s. This puts them together as that model does: one gear at a time, no torque in a
# change, then the ramp; no air drag. Its two known readings are 10th gear near 31 s and 46.9 km/h
# at 40 s; rolling resistance, which was published as 0.012 to 0.02, is chosen so that the second
# comes out.

# Middle of the published 0.6 to 0.7 s without torque [s].
_NO_TORQUE = 0.65
_ROLLING_RESISTANCE = 0.015


@dataclass(frozen=True)
class PublishedRun:
    """Time histories of shape (n,), every 10 ms: time [s], speed [m/s], gear."""

    time: FloatArray
    speed: FloatArray
    gear: FloatArray


def balance() -> ForceBalance:
    """The empty truck with the published rolling resistance, and without air drag."""
    overlay = {
        "aerodynamics": {"density": 0.0},
        "tire_common": {"rolling_resistance": _ROLLING_RESISTANCE},
    }
    return ForceBalance(TruckParameters.load(overlay=overlay), 0.0)


def compute(truck: ForceBalance, pedal: float, duration: float) -> PublishedRun:
    """Standing start on the flat at a constant pedal.

    Args:
      truck: at its payload; its air drag counts when it has any.
      pedal: 0 to 1.
      duration: [s].
    """
    engine, gearbox = truck.parameters.engine, truck.parameters.gearbox
    map_torque, shift_up = _at(engine.pedal_map, pedal), _at(gearbox.upshift, pedal)
    gear, torque, speed, pause = int(gearbox.start_gear), 0.0, 0.0, 0.0
    rows = []
    for k in range(round(duration / PERIOD) + 1):
        rows.append([k * PERIOD, speed, float(gear)])
        spin = max(engine.idle_speed, speed * float(truck.reduction(gear)))
        wanted = float(np.interp(spin, engine.pedal_map.rows, map_torque))
        if pause > 0.0:
            pause -= PERIOD
            torque = 0.0
        elif gear <= len(shift_up) and speed > shift_up[gear - 1]:
            gear, pause, torque = gear + 1, _NO_TORQUE, 0.0
        else:
            torque = _ramp(torque, wanted, truck)
        coupled = torque > 0.0 and speed * float(truck.reduction(gear)) > engine.idle_speed
        mass = truck.mass + (float(truck.rotating_mass(gear)) if coupled else truck.wheel_mass)
        push = float(truck.pull(torque, gear) - truck.resistance(speed))
        speed = max(0.0, speed + PERIOD * push / mass)
    table = np.array(rows)
    return PublishedRun(*table.T)


def _at(table: Table2D, column: float) -> FloatArray:
    """A column of a table, between its columns, shape of its rows."""
    return np.array([np.interp(column, table.columns, row) for row in table.values])


def _ramp(torque: float, wanted: float, balance: ForceBalance) -> float:
    """Torque of the next sample: towards the map at the published rates."""
    engine = balance.parameters.engine
    low = torque < engine.torque_rise_threshold
    rise = engine.torque_rise_rate_low if low else engine.torque_rise_rate
    above = torque > engine.torque_fall_threshold
    fall = engine.torque_fall_rate if above else engine.torque_fall_rate_low
    return float(np.clip(wanted, torque - fall * PERIOD, torque + rise * PERIOD))


# --- Accuracy of the speed in the paper's sense: replay the same commands, compare the speed ---

UPHILL = 0.03
_FLAT_TIME, _UPHILL_TIME = 100.0, 120.0
_PAPER, _WANTED = 89.0, 95.0
_XBR_PAYLOAD = 31_000.0
NOTE = (
    "Accuracy of the speed: 100 (1 - |v - v_ref| / |v_ref - mean|), the fit of system "
    "identification, mean over the experiments. The paper does not define its 89 %."
)


@dataclass(frozen=True)
class Drives:
    """The drives that are compared."""

    pedal: Run
    pedal_without_air: Run
    flat: Run
    uphill: Run
    braking: Run


def record(timestep: float) -> Drives:
    """Drives them."""
    return Drives(
        pedal=part_throttle_run(timestep),
        pedal_without_air=part_throttle_run(timestep, air=False),
        flat=full_pedal_run(timestep, 0.0, _FLAT_TIME),
        uphill=full_pedal_run(timestep, UPHILL, _UPHILL_TIME),
        braking=braking.xbr_run(_XBR_PAYLOAD, timestep),
    )


def compare(drives: Drives) -> tuple[list[Check], list[Panel]]:
    """Accuracy of each drive and of all."""
    parameters = TruckParameters.load()
    laden = ForceBalance(parameters, parameters.payload.mass_max)
    published = compute(balance(), 0.4, 40.0)
    braked = between(drives.braking, braking.START, braking.RELEASE)
    obeyed = braked_speed(braked, parameters)
    rows = [
        ("40 % pedal, 19 t, published run", drives.pedal_without_air, published.speed),
        ("full pedal, 55 t, flat, force balance", drives.flat, coast_along(drives.flat, laden)),
        ("full pedal, 55 t, 3 %, force balance", drives.uphill, coast_along(drives.uphill, laden)),
        ("XBR -1.5 m/s2, 50 t, demand behind the lag of the brakes", braked, obeyed),
    ]
    found = [fit(run.speed, reference) for _, run, reference in rows]
    checks = [
        Check(f"accuracy of the speed: {name}", value, "%")
        for (name, *_), value in zip(rows, found, strict=True)
    ]
    checks.append(
        Check(
            "accuracy of the speed, all experiments",
            float(np.mean(found)),
            "%",
            _PAPER,
            f">= {_WANTED:g}",
        )
    )
    mean = [_mean_accuracy(run.speed, reference) for _, run, reference in rows]
    checks += [
        Check(
            "accuracy of the speed, all experiments, by mean error over mean speed",
            float(np.mean(mean)),
            "%",
            _PAPER,
        ),
        Check(
            "published run, computed anew: speed at 40 s",
            float(published.speed[-1]) / KMH,
            "km/h",
            46.9,
            "44.6 .. 49.2",
        ),
        Check(
            "published run, computed anew: 10th gear engages at",
            float(published.time[published.gear >= 10.0][:1].sum()),
            "s",
            31.0,
            "28 .. 34",
        ),
    ]
    panels = [
        Panel(
            f"accuracy of the speed: {name}",
            "time [s]",
            "speed [km/h]",
            (
                Line("reference", run.time, reference / KMH, "reference"),
                Line("truck", run.time, run.speed / KMH, "simulation"),
            ),
        )
        for name, run, reference in rows
    ]
    return checks, panels


def _mean_accuracy(speed: FloatArray, reference: FloatArray) -> float:
    """`100 (1 - mean |v - v_ref| / mean(v_ref))` [%]: a milder sense that the paper may have."""
    return float(100.0 * (1.0 - np.mean(np.abs(speed - reference)) / np.mean(reference)))


def between(record: Run, start: float, end: float) -> Run:
    """The part of a run between two times [s]."""
    keep = (record.time >= start - 1e-9) & (record.time < end - 1e-9)
    columns = {
        field.name: getattr(record, field.name)[keep]
        for field in dataclasses.fields(Run)
        if field.name != "extra"
    }
    return Run(**columns, extra={name: values[keep] for name, values in record.extra.items()})


def braked_speed(record: Run, parameters: TruckParameters) -> FloatArray:
    """Speed [m/s] (n,) when the demand, there from the first sample on, is obeyed.

    It comes through dead time and lag of the slowest axle, as the truck's parameters have them.
    """
    since = np.maximum(record.time - record.time[0] - max(dead_times(parameters)), 0.0)
    lag = max(parameters.air_brake.build_up_time_constant)
    lost = braking.DEMAND * (since - lag * (1.0 - np.exp(-since / lag)))
    return np.asarray(record.speed[0] - lost)
