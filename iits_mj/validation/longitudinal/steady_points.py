"""Fuel at steady points: the truck on a dynamometer against consumption map times power.

The dynamometer is a road whose grade is set so that the speed stays: the direction of gravity is
turned in the truck's frame, which is a grade in all but the map. The map is interpolated here anew.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import RegularGridInterpolator

from iits_mj.core.messages import EgoState, VehicleCommand
from iits_mj.core.results import Check, Line, Panel
from iits_mj.core.units import GRAVITY, KMH, RPM
from iits_mj.parameters import TruckParameters
from iits_mj.road import Route
from iits_mj.truck import Truck
from iits_mj.validation.longitudinal.force_balance import ForceBalance
from iits_mj.validation.longitudinal.runs import run

# --- Steady speeds at full pedal, on grades and on the flat, simulated and by the force balance ---

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


def compare_climb(timestep: float, *, quick: bool) -> tuple[list[Check], list[Panel]]:
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


# --- Fuel at steady points: the truck on a dynamometer against consumption map times power ---

# Speed [km/h] and pedal of each point.
POINTS = ((30.0, 0.35), (45.0, 0.5), (60.0, 0.4), (60.0, 0.7), (80.0, 0.6), (85.0, 0.75))
_DURATION, _MEASURED = 30.0, 3.0
# Grade per speed error [s/m], and its integral [1/m].
_GAIN, _INTEGRAL = 0.06, 0.02
# Joule of a kilowatt hour, per kilogram: [kg/J] to [g/kWh].
_G_PER_KWH = 3.6e9
_STEADY_TORQUE = 0.005


@dataclass(frozen=True)
class Point:
    """A steady point: engine speed [rad/s], torque [N m], fuel rate [kg/s], and of what spread.

    Attributes:
      spread: greatest less smallest torque while measured, over the mean [1].
      used: fuel that the counter counted while measured [kg]; time: for how long [s].
    """

    speed: float
    torque: float
    rate: float
    spread: float
    used: float
    time: float


def measure(speed: float, pedal: float, timestep: float) -> Point:
    """Holds a vehicle speed [m/s] at a pedal by grade, and measures for 3 s."""
    truck = Truck.load(timestep=timestep, visuals=False)
    truck.reset(speed=speed)
    integral = 0.0

    def command(_: float, state: EgoState) -> VehicleCommand:
        nonlocal integral
        error = state.speed - speed
        integral = float(np.clip(integral + _INTEGRAL * error * 0.01, -0.3, 0.3))
        angle = np.arctan(integral + _GAIN * error)
        truck.model.opt.gravity[:] = (-GRAVITY * np.sin(angle), 0.0, -GRAVITY * np.cos(angle))
        return VehicleCommand(accelerator_pedal=pedal)

    record = run(truck, command, _DURATION)
    end = record.time >= record.time[-1] - _MEASURED
    torque = record.engine_torque[end]
    mean = float(torque.mean())
    return Point(
        speed=float(record.engine_speed[end].mean()),
        torque=mean,
        rate=float(record.fuel_rate[end].mean()),
        spread=float(np.ptp(torque)) / abs(mean),
        used=float(record.fuel_used[end][-1] - record.fuel_used[end][0]),
        time=float(record.time[end][-1] - record.time[end][0]),
    )


def consumption(parameters: TruckParameters, point: Point) -> float:
    """Specific consumption of the map at the point [kg/J]; nan outside the map."""
    table = parameters.engine.fuel_map
    lookup = RegularGridInterpolator(
        (table.rows, table.columns), table.values, bounds_error=False, fill_value=np.nan
    )
    return float(lookup((point.torque, point.speed)))


def compare_fuel(timestep: float, *, quick: bool) -> tuple[list[Check], list[Panel]]:
    """Fuel rate of each point against the map."""
    parameters = TruckParameters.load()
    checks, powers, rates, wanted = [], [], [], []
    for kph, pedal in POINTS[1::2] if quick else POINTS:
        point = measure(kph * KMH, pedal, timestep)
        power = point.torque * point.speed
        expected = consumption(parameters, point) * power
        label = (
            f"fuel at {kph:g} km/h, {100.0 * pedal:g} % pedal "
            f"({point.torque:.0f} N m, {point.speed / RPM:.0f} rpm)"
        )
        specific = _G_PER_KWH * consumption(parameters, point)
        checks += [
            Check(f"{label}: torque's spread", 100.0 * point.spread, "%", None, "<= 0.5"),
            Check(
                f"{label}: specific consumption",
                _G_PER_KWH * point.rate / power,
                "g/kWh",
                specific,
                f"{0.99 * specific:.2f} .. {1.01 * specific:.2f}",
            ),
            Check(
                f"{label}: counter against rate",
                100.0 * abs(point.used / point.time / point.rate - 1.0),
                "%",
                None,
                "<= 0.5",
            ),
        ]
        powers.append(power / 1e3)
        rates.append(point.rate * 1e3)
        wanted.append(expected * 1e3)
    order = np.argsort(powers)
    x = np.array(powers)[order]
    lines = (
        Line("map x power", x, np.array(wanted)[order], "reference"),
        Line("truck", x, np.array(rates)[order], "simulation"),
    )
    return checks, [Panel("Fuel at steady points", "power [kW]", "fuel rate [g/s]", lines)]
