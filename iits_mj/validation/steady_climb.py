"""Steady speeds at full pedal, on grades and on the flat, simulated and by the force balance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from iits_mj.messages import VehicleCommand
from iits_mj.parameters import TruckParameters
from iits_mj.results import Check, Line, Panel
from iits_mj.road import Route
from iits_mj.truck import Truck
from iits_mj.units import KMH
from iits_mj.validation.force_balance import ForceBalance

# Steady: the gear stays and the speed changes by less [m/s2] in half a block [s]; so many at most.
_STEADY, _BLOCK, _BLOCKS = 0.01, 20.0, 8
# PBS gradeability B, level 1, on 1 % [km/h].
_LEVEL_SPEED = 80.0


@dataclass(frozen=True)
class Steady:
    """Speed [m/s] in which the truck settles, gear, and what the speed still changes by [m/s2]."""

    speed: float
    gear: int
    rate: float


def steady_speed(payload: float, grade: float, start: float, timestep: float) -> Steady:
    """Full pedal on a grade until speed and gear settle.

    Args:
      payload: [kg].
      grade: of the road.
      start: speed to begin with [m/s].
      timestep: of the physics [s].
    """
    truck = Truck.load(payload, route=Route.straight(grade=grade), timestep=timestep, visuals=False)
    truck.reset(station=100.0, speed=start)
    truck.command(VehicleCommand(accelerator_pedal=1.0))
    half = round(0.5 * _BLOCK / timestep)
    for _ in range(_BLOCKS):
        truck.step(half)
        before = truck.observe()
        truck.step(half)
        after = truck.observe()
        rate = (after.speed - before.speed) / (after.time - before.time)
        if after.gear == before.gear and abs(rate) < _STEADY:
            break
    return Steady(after.speed, after.gear, rate)


def compare(timestep: float, *, quick: bool) -> tuple[list[Check], list[Panel]]:
    """Steady speeds at 55 t, simulated against computed."""
    parameters = TruckParameters.load()
    payload = parameters.payload.mass_max
    balance = ForceBalance(parameters, payload)
    checks = []
    grades = (0.03,) if quick else (0.01, 0.03, 0.05)
    found = []
    for grade in grades:
        expected = balance.best_speed(grade)
        steady = steady_speed(payload, grade, 0.97 * expected, timestep)
        speed, gear = steady.speed, steady.gear
        label = f"55 t, {100.0 * grade:g} % grade, full pedal"
        found.append(speed)
        checks += [
            Check(
                f"{label}: force balance in gear {gear}",
                100.0 * _missing_force(balance, steady, grade),
                "%",
                0.0,
                "-3 .. 3",
            ),
            Check(f"{label}: steady speed", speed / KMH, "km/h", expected / KMH),
        ]
        if grade == 0.01:
            checks.append(
                Check(
                    f"{label}: speed (PBS gradeability B, level 1)",
                    speed / KMH,
                    "km/h",
                    _LEVEL_SPEED,
                    f">= {_LEVEL_SPEED:g}",
                )
            )
    summit = steady_speed(payload, 0.0, 0.97 * balance.best_speed(0.0), timestep)
    top, gear = summit.speed, summit.gear
    governed = parameters.engine.governed_speed / float(balance.reduction(gear))
    lowest = (1.0 - parameters.engine.governor_droop) * governed
    checks += [
        Check("55 t, flat, full pedal: gear at the top", float(gear), "1", 12.0, ">= 12"),
        Check(
            "55 t, flat, full pedal: top speed, governed",
            top / KMH,
            "km/h",
            governed / KMH,
            f"{lowest / KMH:.1f} .. {governed / KMH:.1f}",
        ),
    ]
    line = np.linspace(0.0, 0.06, 25)
    computed = np.array([balance.best_speed(grade) for grade in line]) / KMH
    panel = Panel(
        "55 t, full pedal: steady speed",
        "grade [%]",
        "speed [km/h]",
        (
            Line("force balance, best gear", 100.0 * line, computed, "reference"),
            Line(
                "truck",
                100.0 * np.array([0.0, *grades]),
                np.array([top, *found]) / KMH,
                "simulation",
            ),
        ),
    )
    return checks, [panel]


def _missing_force(balance: ForceBalance, steady: Steady, grade: float) -> float:
    """Pull of the floored pedal less resistances and inertia, over the pull [1]."""
    torque = balance.full_torque(steady.speed * balance.reduction(steady.gear))
    pull = float(balance.pull(torque, steady.gear))
    inertia = (balance.mass + float(balance.rotating_mass(steady.gear))) * steady.rate
    return (pull - float(balance.resistance(steady.speed, grade)) - inertia) / pull
