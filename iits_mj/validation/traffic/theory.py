"""SUMO's traffic against the Intelligent Driver Model's closed form; needs no recorded data.

Equilibrium gaps and flows of a column of equal vehicles (the fundamental diagram), and how much of
its leader's speed oscillation a follower takes over (string stability).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from iits_mj.core.arrays import FloatArray
from iits_mj.core.results import Check, Line, Panel
from iits_mj.road import Route
from iits_mj.validation.harness.recorder import harmonic
from traffic_bridge.config import Departure, TrafficConfig
from traffic_bridge.modes.sumo_modes import PureSim
from traffic_bridge.vehicles.idm import IdmParameters, equilibrium_flow, equilibrium_gap, gain
from traffic_bridge.vehicles.types import VehicleType, default_types

LIMIT = 20.0  # [m/s]: desired speed of everybody
COLUMN = 5  # vehicles behind the first
SETTLING = 180.0  # [s] until a column drives evenly
SPEEDS = (5.0, 8.0, 11.0, 14.0, 17.0)  # [m/s]
FREQUENCIES = (0.02, 0.04, 0.08)  # [Hz]
AMPLITUDE = 0.2  # [m/s] of the first vehicle's desired speed
PERIODS = 3  # of the oscillation that are evaluated


@dataclass(frozen=True, eq=False)
class Column:
    """A column of vehicles over time, the foremost first: gap and speed, shape (steps, n)."""

    time: FloatArray
    gap: FloatArray
    speed: FloatArray


def drive_column(
    kind: VehicleType, speed: float, duration: float, frequency: float = 0.0
) -> Column:
    """Runs a column whose first vehicle wants a constant or an oscillating speed.

    Args:
      kind: of all vehicles.
      speed: the first one's desired speed, or its mean [m/s].
      duration: [s].
      frequency: of its oscillation [Hz]; 0 for none.
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


def compare(quick: bool) -> tuple[list[Check], list[Panel], list[Panel]]:
    """Fundamental diagram and string stability of the default car.

    Returns:
      Checks, panels of the fundamental diagram, panels of the stability.
    """
    kind = default_types()[0]
    parameters = IdmParameters.of_type(kind, LIMIT)
    speeds = np.array(SPEEDS[1::2] if quick else SPEEDS)
    frequencies = np.array(FREQUENCIES[1::2] if quick else FREQUENCIES)
    checks, diagram = _equilibrium(kind, parameters, speeds)
    more, stability = _stability(kind, parameters, frequencies)
    return checks + more, diagram, stability


def _equilibrium(
    kind: VehicleType, parameters: IdmParameters, speeds: FloatArray
) -> tuple[list[Check], list[Panel]]:
    values = parameters.as_array()
    gap, flow, density = [], [], []
    for speed in speeds:
        column = drive_column(kind, float(speed), SETTLING)
        gap.append(float(column.gap[-1].mean()))
        length = gap[-1] + kind.length
        density.append(1e3 / length)
        flow.append(3600.0 * float(column.speed[-1].mean()) / length)
    expected = equilibrium_gap(values, speeds)
    error = 100.0 * float(np.max(np.abs(np.array(gap) / expected - 1.0)))
    flow_expected = 3600.0 * equilibrium_flow(values, speeds, kind.length)
    flow_error = 100.0 * float(np.max(np.abs(np.array(flow) / flow_expected - 1.0)))
    grid = np.linspace(0.1, 0.995 * LIMIT, 200)
    curve = 3600.0 * equilibrium_flow(values, grid, kind.length)
    spacing = equilibrium_gap(values, grid) + kind.length
    checks = [
        Check("equilibrium gap against IDM, greatest error", error, "%", None, "<= 1"),
        Check("fundamental diagram against IDM, flow error", flow_error, "%", None, "<= 1"),
    ]
    lines = (
        Line("IDM, closed form", 1e3 / spacing, curve, "reference"),
        *(Line("", np.array([k]), np.array([q])) for k, q in zip(density, flow, strict=True)),
    )
    title = "Fundamental diagram of the default car; points are SUMO"
    return checks, [Panel(title, "density [1/km]", "flow [1/h]", lines)]


def _stability(
    kind: VehicleType, parameters: IdmParameters, frequencies: FloatArray
) -> tuple[list[Check], list[Panel]]:
    speed = 11.0
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
    expected = gain(parameters, speed, frequencies)
    error = 100.0 * float(np.max(np.abs(np.array(measured) / expected - 1.0)))
    grid = np.geomspace(0.003, 0.3, 200)
    curve = gain(parameters, speed, grid)
    checks = [
        Check("oscillation passed on, against linearized IDM", error, "%", None, "<= 2"),
        Check("greatest gain of the default car in a string", float(curve.max()), "1"),
    ]
    lines = (
        Line("IDM, linearized", grid, curve, "reference"),
        *(
            Line("", np.array([f]), np.array([g]))
            for f, g in zip(frequencies, measured, strict=True)
        ),
    )
    title = f"Speed amplitude, follower over leader, at {speed:g} m/s; points are SUMO"
    return checks, [Panel(title, "frequency [Hz]", "gain [1]", lines)]
