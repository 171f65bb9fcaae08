"""SUMO's traffic against the closed form of the Intelligent Driver Model (IDM).

Equilibrium gaps and flows of a column of equal vehicles (the fundamental diagram), and the ratio of
the speed oscillations of follower and leader (string stability).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from iits_mj.core.arrays import FloatArray
from iits_mj.core.results import Findings, Line
from iits_mj.road import Route
from iits_mj.validation.harness.recorder import harmonic
from traffic_bridge.config import Departure, TrafficConfig
from traffic_bridge.modes.sumo_modes import PureSim
from traffic_bridge.vehicles.idm import IdmParameters, equilibrium_flow, equilibrium_gap, gain
from traffic_bridge.vehicles.types import VehicleType, default_types

LIMIT = 20.0  # [m/s]: desired speed of all vehicles
COLUMN = 5  # vehicles behind the first
SETTLING = 180.0  # [s] until a column is in equilibrium
SPEEDS = (5.0, 8.0, 11.0, 14.0, 17.0)  # [m/s]
FREQUENCIES = (0.02, 0.04, 0.08)  # [Hz]
AMPLITUDE = 0.2  # [m/s] of the first vehicle's desired speed
PERIODS = 3  # evaluated periods of the oscillation


@dataclass(frozen=True, eq=False)
class Column:
    """Gaps and speeds of a column over time, first vehicle first, shape (steps, n)."""

    time: FloatArray
    gap: FloatArray
    speed: FloatArray


def drive_column(
    kind: VehicleType, speed: float, duration: float, frequency: float = 0.0
) -> Column:
    """Runs a column whose first vehicle has a constant or an oscillating desired speed.

    Args:
      kind: type of all vehicles.
      speed: mean desired speed of the first vehicle [m/s].
      duration: [s].
      frequency: of its oscillation [Hz]; 0 for a constant speed.
    """
    spacing = 3.0 * LIMIT + kind.length
    first = 50.0 + COLUMN * spacing
    route = Route.straight(first + duration * LIMIT + 500.0, lanes=1, speed_limit=LIMIT)
    departures = tuple(
        Departure(time=0.0, type=kind.name, lane=0, station=first - i * spacing, speed=LIMIT)
        for i in range(COLUMN + 1)
    )
    config = TrafficConfig(
        density="empty",
        speed_limit=LIMIT,
        types=(kind,),
        mix=((kind.name, 1.0),),
        departures=departures,
    )
    times, gaps, speeds = [], [], []
    with PureSim(route, config, seed=0) as traffic:
        frame = traffic.reset()
        while traffic.time < duration - 1e-9:
            if len(frame) == COLUMN + 1:
                station = frame.column("station")
                order = np.argsort(-station)
                wanted = speed + AMPLITUDE * math.sin(2.0 * math.pi * frequency * traffic.time)
                traffic.vehicles.change(frame.ids[int(order[0])], desired_speed=wanted)
                times.append(traffic.time)
                gaps.append(-np.diff(station[order]) - kind.length)
                speeds.append(frame.column("speed")[order])
            frame = traffic.step()
    return Column(np.array(times), np.array(gaps), np.array(speeds))


def compare_equilibrium(quick: bool) -> Findings:
    """Fundamental diagram of the default car."""
    kind = default_types()[0]
    values = IdmParameters.of_type(kind, LIMIT).as_array()
    speeds = np.array(SPEEDS[1::2] if quick else SPEEDS)
    gap, flow, density = [], [], []
    for speed in speeds:
        column = drive_column(kind, float(speed), SETTLING)
        gap.append(float(column.gap[-1].mean()))
        length = gap[-1] + kind.length
        density.append(1e3 / length)
        flow.append(3600.0 * float(column.speed[-1].mean()) / length)
    found = Findings()
    error = _greatest_error(gap, equilibrium_gap(values, speeds))
    found.check("equilibrium gap against IDM, greatest error", error, "%", must="<= 1")
    error = _greatest_error(flow, 3600.0 * equilibrium_flow(values, speeds, kind.length))
    found.check("fundamental diagram against IDM, flow error", error, "%", must="<= 1")
    grid = np.linspace(0.1, 0.995 * LIMIT, 200)
    curve = 3600.0 * equilibrium_flow(values, grid, kind.length)
    spacing = equilibrium_gap(values, grid) + kind.length
    found.panel(
        "Fundamental diagram of the default car; points are SUMO",
        "density [1/km]",
        "flow [1/h]",
        Line("IDM, closed form", 1e3 / spacing, curve, "reference"),
        *_points(density, flow),
    )
    return found


def compare_stability(quick: bool) -> Findings:
    """String stability of the default car."""
    kind, speed = default_types()[0], 11.0
    parameters = IdmParameters.of_type(kind, LIMIT)
    frequencies = np.array(FREQUENCIES[1::2] if quick else FREQUENCIES)
    measured = []
    for frequency in frequencies:
        duration = 100.0 + PERIODS / float(frequency)
        column = drive_column(kind, speed, duration, float(frequency))
        use = column.time >= column.time[-1] - PERIODS / frequency
        amplitude = [
            float(abs(harmonic(column.time[use], v[use], np.array([frequency]))[0]))
            for v in column.speed.T
        ]
        measured.append(amplitude[2] / amplitude[1])
    grid = np.geomspace(0.003, 0.3, 200)
    curve = gain(parameters, speed, grid)
    found = Findings()
    error = _greatest_error(measured, gain(parameters, speed, frequencies))
    found.check("oscillation passed on, against linearized IDM", error, "%", must="<= 2")
    found.check("greatest gain of the default car in a string", curve.max(), "1")
    found.panel(
        f"Speed amplitude, follower over leader, at {speed:g} m/s; points are SUMO",
        "frequency [Hz]",
        "gain [1]",
        Line("IDM, linearized", grid, curve, "reference"),
        *_points(frequencies, measured),
    )
    return found


def _greatest_error(measured: Sequence[float], expected: FloatArray) -> float:
    """Greatest relative error [%]."""
    return 100.0 * float(np.max(np.abs(np.array(measured) / expected - 1.0)))


def _points(x: Iterable[float], y: Iterable[float]) -> list[Line]:
    return [Line("", np.array([a]), np.array([b])) for a, b in zip(x, y, strict=True)]
