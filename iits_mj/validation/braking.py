"""Brake tests: XBR -1.5 m/s2 at 60 km/h as in the paper, response, and the full stop."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from iits_mj.messages import VehicleCommand, XbrMode
from iits_mj.results import Check, Line, Panel
from iits_mj.truck import Truck
from iits_mj.units import KMH
from iits_mj.validation.longitudinal_run import Run, run

FloatArray = NDArray[np.float64]

_SPEED = 60.0 * KMH
_START = 1.0
_DEMAND = -1.5
# Axles of the front, drive and trailer circuits.
_AXLES = np.array([1.0, 2.0, 3.0])


def xbr(payload: float, timestep: float) -> tuple[list[Check], list[Panel]]:
    """XBR -1.5 m/s2 from 60 km/h: mean deceleration, overshoot, pressure."""
    truck = Truck.load(payload, timestep=timestep, visuals=False)
    truck.reset(speed=_SPEED)

    def command(time: float, _: object) -> VehicleCommand:
        if time < _START:
            return VehicleCommand()
        return VehicleCommand(xbr_demand=_DEMAND, xbr_mode=XbrMode.MAXIMUM)

    record = run(truck, command, 12.0, stop=lambda state: state.speed < 0.5)
    built = (record.time > _START + 2.0) & (record.speed > 1.0)
    deceleration = -float(record.acceleration[built].mean())
    # The chassis pitches: a tenth of a second's mean is what a speed sensor would show.
    smooth = np.convolve(record.acceleration, np.ones(10) / 10.0, mode="same")[5:-5]
    mass = truck.parameters.gross_mass(payload) / 1e3
    label = f"XBR -1.5 m/s2 at 60 km/h, {mass:g} t"
    pressure = mean_pressure(record)
    checks = [
        Check(f"{label}: mean deceleration", deceleration, "m/s2", 1.5, "1.455 .. 1.545"),
        Check(f"{label}: overshoot", 100.0 * (-smooth.min() / 1.5 - 1.0), "%", None, "<= 10"),
        Check(
            f"{label}: 75 % of the pressure after",
            rise_time(record.time - _START, pressure, 0.75),
            "s",
            None,
            "<= 0.6",
        ),
        Check(
            f"{label}: first rise after",
            first_rise(record.time - _START, pressure),
            "s",
            max(truck.parameters.air_brake.dead_time),
        ),
    ]
    if abs(mass - 50.0) < 0.5:
        level = float(pressure[built].mean()) / 1e3
        checks.append(Check(f"{label}: mean pressure", level, "kPa", 150.0, "120 .. 180"))
    panels = [
        _panel(f"{label}: speed", "speed [km/h]", record, record.speed / KMH),
        _panel(f"{label}: acceleration", "acceleration [m/s2]", record, record.acceleration),
        _panel(f"{label}: mean brake pressure", "pressure [kPa]", record, pressure / 1e3),
    ]
    return checks, panels


def full_stop(payload: float, timestep: float) -> tuple[list[Check], list[Panel]]:
    """The greatest demand from 60 km/h: UN R13 type 0 distance, and no wheel that stays locked."""
    truck = Truck.load(payload, timestep=timestep, visuals=False)
    truck.reset(speed=_SPEED)
    record = run(
        truck,
        lambda *_: VehicleCommand(xbr_demand=-10.0, xbr_mode=XbrMode.MAXIMUM),
        12.0,
        stop=lambda state: state.speed < 0.05,
    )
    distance = float(record.station[-1] - record.station[0])
    # UN R13 annex 4, category N, engine disconnected: s <= 0.15 v + v^2 / 130, v in km/h.
    allowed = 0.15 * 60.0 + 60.0**2 / 130.0
    label = f"full stop from 60 km/h, {truck.parameters.gross_mass(payload) / 1e3:g} t"
    checks = [
        Check(f"{label}: distance", distance, "m", allowed, f"<= {allowed:.1f}"),
        Check(f"{label}: longest lock-up above 15 km/h", lock_time(record), "s", None, "<= 1"),
        Check(f"{label}: speed at the end", abs(float(record.speed[-1])), "m/s", 0.0, "<= 0.1"),
    ]
    return checks, [
        _panel(f"{label}: speed", "speed [km/h]", record, record.speed / KMH),
        _panel(f"{label}: greatest slip", "slip [1]", record, record.slip),
    ]


def mean_pressure(record: Run) -> FloatArray:
    """Pressure averaged over the six axles [Pa], shape (n,)."""
    circuits = np.column_stack(
        [
            record.pressures[:, :2].mean(axis=1),
            record.pressures[:, 2:4].mean(axis=1),
            record.pressures[:, 4],
        ]
    )
    return np.asarray(circuits @ _AXLES / _AXLES.sum())


def rise_time(time: FloatArray, pressure: FloatArray, share: float) -> float:
    """Time [s] after which the pressure has reached this share of its final level."""
    final = float(pressure[time > 2.0].mean())
    reached = np.flatnonzero((time >= 0.0) & (pressure >= share * final))
    return float(time[reached[0]]) if len(reached) else float("nan")


def first_rise(time: FloatArray, pressure: FloatArray) -> float:
    """Time [s] after which the pressure has risen by 2 kPa."""
    before = float(pressure[time <= 0.0][-1])
    risen = np.flatnonzero((time >= 0.0) & (pressure > before + 2e3))
    return float(time[risen[0]]) if len(risen) else float("nan")


def lock_time(record: Run) -> float:
    """Longest time [s] for which some wheel slips by 80 % or more above 15 km/h."""
    locked = (record.slip > 0.8) & (record.speed > 15.0 * KMH)
    longest = current = 0
    for now in locked:
        current = current + 1 if now else 0
        longest = max(longest, current)
    return longest * float(record.time[1] - record.time[0])


def _panel(title: str, y_label: str, record: Run, values: FloatArray) -> Panel:
    return Panel(title, "time [s]", y_label, (Line("truck", record.time, values, "simulation"),))
