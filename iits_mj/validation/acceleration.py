"""Pedal tests: the paper's 40 % for 40 s; full pedal at 55 t with force balance and fuel."""

from __future__ import annotations

import itertools

import numpy as np

from iits_mj.identification.longitudinal import acceleration, prepare
from iits_mj.messages import VehicleCommand
from iits_mj.parameters import TruckParameters
from iits_mj.results import Check, Line, Panel
from iits_mj.road import Route
from iits_mj.truck import Truck
from iits_mj.units import KMH
from iits_mj.validation.longitudinal_run import Run, run

# What the paper's Fig. "Drive-line" and the published reference run read.
_PAPER_SPEED_KPH = 46.9


def part_throttle(timestep: float) -> tuple[list[Check], list[Panel]]:
    """40 % pedal for 40 s from standstill at 19 t, the paper's test."""
    truck = Truck.load(0.0, timestep=timestep, visuals=False)
    truck.reset()
    record = run(truck, lambda *_: VehicleCommand(accelerator_pedal=0.4), 40.0)
    moving = record.gear[record.speed > 0.5]
    label = "40 % pedal, 19 t"
    checks = [
        Check(f"{label}: first gear used", float(moving[0]), "1", 2.0, "2 .. 2"),
        Check(f"{label}: gear at 40 s", float(record.gear[-1]), "1", 10.0, "9 .. 10"),
        Check(
            f"{label}: speed at 40 s",
            float(record.speed[-1]) / KMH,
            "km/h",
            _PAPER_SPEED_KPH,
            "40 .. 50",
        ),
        Check(
            f"{label}: longest shift", max(shift_times(record), default=0.0), "s", None, "<= 1.0"
        ),
    ]
    return checks, _panels(label, record)


def full_pedal(
    timestep: float, *, grade: float, duration: float
) -> tuple[list[Check], list[Panel]]:
    """Full pedal at 55 t on a constant grade: force balance in every gear, fuel, end speed."""
    parameters = TruckParameters.load()
    payload = parameters.payload.mass_max
    route = Route.straight(grade=grade)
    truck = Truck.load(payload, route=route, timestep=timestep, visuals=False)
    truck.reset()
    record = run(truck, lambda *_: VehicleCommand(accelerator_pedal=1.0), duration)
    label = f"full pedal, 55 t, {100.0 * grade:g} % grade"
    checks = [
        Check(f"{label}: force balance", force_balance_error(record, truck), "%", None, "<= 3"),
        Check(f"{label}: fuel against the map", fuel_error(record, parameters), "%", None, "<= 1"),
        Check(f"{label}: gear changes taken back", float(hunting(record)), "1", 0.0, "<= 0"),
        Check(f"{label}: speed at the end", float(record.speed[-1]) / KMH, "km/h"),
    ]
    fast = np.flatnonzero(record.speed >= 80.0 * KMH)
    if len(fast):
        checks.append(Check(f"{label}: time to 80 km/h", float(record.time[fast[0]]), "s"))
    return checks, _panels(label, record)


def force_balance_error(record: Run, truck: Truck) -> float:
    """Speed gained in one gear, truck against point mass: worst window's error [%]."""
    parameters = truck.parameters
    inputs = prepare(record.log(stride=5), parameters)
    rate = acceleration(
        inputs,
        {
            "mass": parameters.gross_mass(truck.payload),
            "rolling_resistance": parameters.tire_common.rolling_resistance,
            "drag_area": parameters.aerodynamics.drag_area,
            "brake_gain": 1.0,
            "engine_torque_scale": 1.0,
        },
    )
    errors = []
    for window in inputs.windows:
        time, speed = inputs.time[window], inputs.speed[window]
        gained = float(np.trapezoid(rate[window], time))
        # The drive's own work, not the small difference of large forces, is the measure.
        driven = float(
            np.trapezoid(inputs.drive_force[window], time)
            / (parameters.gross_mass(truck.payload) + inputs.rotating_mass[window].mean())
        )
        errors.append(abs(gained - float(speed[-1] - speed[0])) / abs(driven))
    return 100.0 * max(errors, default=float("nan"))


def fuel_error(record: Run, parameters: TruckParameters) -> float:
    """Median error of fuel rate against BSFC times power, where the engine pulls steadily [%]."""
    table = parameters.engine.fuel_map
    change = np.abs(np.gradient(record.engine_torque, record.time))
    inside = (
        (record.engine_torque > table.rows[0])
        & (record.engine_torque < table.rows[-1])
        & (record.engine_speed > table.columns[0])
        & (record.engine_speed < table.columns[-1])
        & (change < 100.0)
    )
    if not inside.any():
        return float("nan")
    torque, speed = record.engine_torque[inside], record.engine_speed[inside]
    column = np.array([np.interp(speed, table.columns, row) for row in table.values])
    bsfc = np.array([np.interp(t, table.rows, column[:, k]) for k, t in enumerate(torque)])
    wanted = bsfc * torque * speed
    return float(100.0 * np.median(np.abs(record.fuel_rate[inside] / wanted - 1.0)))


def hunting(record: Run, within: float = 5.0) -> int:
    """Number of gear changes that the gearbox takes back within some seconds."""
    changes = np.flatnonzero(np.diff(record.gear))
    return sum(
        record.time[b] - record.time[a] < within and record.gear[b + 1] == record.gear[a]
        for a, b in itertools.pairwise(changes)
    )


def shift_times(record: Run) -> list[float]:
    """Durations of the gear changes after the launch [s]."""
    edges = np.flatnonzero(np.diff(record.shift) != 0.0)
    edges = edges[record.speed[edges] > 0.5]
    starts = edges[record.shift[edges] < 0.5]
    ends = edges[record.shift[edges] > 0.5]
    return [
        float(record.time[ends[ends > start][0]] - record.time[start])
        for start in starts
        if (ends > start).any()
    ]


def _panels(label: str, record: Run) -> list[Panel]:
    rows = (
        ("speed", "km/h", record.speed / KMH),
        ("gear", "1", record.gear),
        ("acceleration", "m/s2", record.acceleration),
        ("engine torque", "N m", record.engine_torque),
    )
    return [
        Panel(
            f"{label}: {name}",
            "time [s]",
            f"{name} [{unit}]",
            (Line("truck", record.time, values, "simulation"),),
        )
        for name, unit, values in rows
    ]
