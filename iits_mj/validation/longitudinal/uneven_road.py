"""Axle loads and stopping distance on the roughness classes of ISO 8608.

The surface itself: the mean spectrum of two wheel tracks must lie within the class in every octave
of the standard's band, before the tires' contact smooths it.

The dynamic load coefficient is the standard deviation of an axle's load over its mean at a steady
speed. The tires' vertical motion is linear until a wheel lifts, so the coefficient grows with the
amplitude, twofold from class to class. On typical roads it is 0.1 to 0.3 at highway speed (Cebon,
Handbook of Vehicle-Road Interaction, 1999); the road of class B must yield 0.05 to 0.3.

The tires' forces lag behind their loads (relaxation), and a lifted wheel does not brake: a full
stop takes longer on a rough road.
"""

from __future__ import annotations

import numpy as np

from iits_mj.core.arrays import FloatArray
from iits_mj.core.messages import EgoState, VehicleCommand
from iits_mj.core.results import Findings, Line
from iits_mj.core.units import KMH
from iits_mj.parameters import TruckParameters
from iits_mj.road import Route
from iits_mj.road.unevenness import (
    ACROSS,
    ALONG,
    BAND,
    CLASSES,
    REFERENCE,
    ROWS,
    Unevenness,
    random_surface,
)
from iits_mj.validation.harness.recorder import SpeedHold, placed_truck, sampled
from iits_mj.validation.longitudinal.braking import UN_R13, distance, stop_run

SPEED = 80.0 * KMH
# Time until the start's motion has decayed, and end of the ride [s].
_SETTLED, _END = 5.0, 35.0
# Distance of the wheel tracks [m].
_TRACKS = 2.0
# Allowed dynamic load coefficients.
_LOADS = {"smooth": "<= 0.01", "B": "0.05 .. 0.3"}
_SIDES = ("left", "right")


def octaves(heights: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Mean spectrum of the columns of a surface in octaves.

    Args:
      heights: shape (ROWS, n) [m].

    Returns:
      Middle frequencies [1/m] and densities over `(n / 0.1)^-2` [m3], each of shape (k,).
    """
    frequency = np.fft.rfftfreq(ROWS, ALONG)[1:]
    density = 2.0 * ALONG / ROWS * np.mean(np.abs(np.fft.rfft(heights, axis=0)[1:]) ** 2, axis=1)
    edges = BAND[0] * 2.0 ** np.arange(int(np.log2(BAND[1] / BAND[0])) + 1)
    reduced = density * (frequency / REFERENCE) ** 2
    parts = [reduced[(frequency >= a) & (frequency < 2.0 * a)].mean() for a in edges[:-1]]
    return edges[:-1] * np.sqrt(2.0), np.array(parts)


def load_coefficients(
    parameters: TruckParameters, payload: float, route: Route, timestep: float
) -> dict[str, float]:
    """Dynamic load coefficient of each axle at 80 km/h, by the axle's name."""
    truck = placed_truck(parameters, payload, timestep, route, speed=SPEED)
    hold, axles = SpeedHold(), [axle.name for axle in parameters.axles]

    def read(_: EgoState) -> list[float]:
        return [
            sum(truck.read(f"{axle}_{side}_tire_force", 2) for side in _SIDES) for axle in axles
        ]

    def command(_: float, state: EgoState) -> VehicleCommand:
        return hold.command(SPEED - state.speed, 0.0)

    table = sampled(truck, command, read, _END)
    loads = table[table[:, 0] > _SETTLED, 1:]
    return dict(zip(axles, (loads.std(axis=0) / loads.mean(axis=0)).tolist(), strict=True))


def compare(
    parameters: TruckParameters, payload: float, timestep: float, *, quick: bool = False
) -> Findings:
    """Spectrum, axle loads and stops on each class at one payload [kg]; quick: up to class B."""
    found = Findings(f"uneven road, {parameters.gross_mass(payload) / 1e3:g} t")
    stops: dict[str, float] = {}
    lines = []
    for name, middle in list(CLASSES.items())[: 3 if quick else None]:
        route = Route.straight(2000.0).with_unevenness(Unevenness(name))
        if middle:
            surface = random_surface(middle, np.random.default_rng(0))
            frequency, density = octaves(surface[:, [0, round(_TRACKS / ACROSS)]])
            lines.append(Line(f"class {name}", frequency, density / 1e-6))
            for bound, value in (("least", density.min()), ("greatest", density.max())):
                title = f"class {name}: {bound} density of an octave at 0.1 per m"
                limits = f"{0.5e6 * middle:g} .. {2e6 * middle:g}"
                found.check(title, 1e6 * value, "1e-6 m3", 1e6 * middle, limits)
        loads = load_coefficients(parameters, payload, route, timestep)
        worst = max(loads, key=lambda axle: loads[axle])
        title = f"{name} road: dynamic load coefficient at 80 km/h, {worst}"
        found.check(title, loads[worst], "1", must=_LOADS.get(name, ""))
        stops[name] = distance(stop_run(parameters, payload, UN_R13.speed, timestep, route))
        title = f"{name} road: full stop from {UN_R13.name}"
        found.check(title, stops[name], "m", stops["smooth"], f"<= {UN_R13.laden:.1f}")
    found.panel("spectrum", "spatial frequency [1/m]", "density at 0.1 1/m [1e-6 m3]", *lines)
    return found
