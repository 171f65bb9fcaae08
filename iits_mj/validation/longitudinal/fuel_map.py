"""Fuel at steady points: the truck on a dynamometer against consumption map times power.

The dynamometer is a road whose grade keeps the speed constant: gravity is turned in the frame of
the truck, which has the same effect as a grade. The map is interpolated independently here.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import RegularGridInterpolator

from iits_mj.core.messages import EgoState, VehicleCommand
from iits_mj.core.results import Findings, Line
from iits_mj.core.units import GRAVITY, KMH, RPM
from iits_mj.parameters import TruckParameters
from iits_mj.truck import Truck
from iits_mj.validation.harness.maneuver import run
from iits_mj.validation.harness.recorder import PERIOD

# Speed [km/h] and pedal of each point.
POINTS = ((30.0, 0.35), (45.0, 0.5), (60.0, 0.4), (60.0, 0.7), (80.0, 0.6), (85.0, 0.75))
_DURATION, _MEASURED = 30.0, 3.0
# Grade per speed error [s/m], and per its integral [1/m].
_GAIN, _INTEGRAL = 0.06, 0.02
# From [kg/J] to [g/kWh].
_G_PER_KWH = 3.6e9


@dataclass(frozen=True)
class Point:
    """Means of a steady point: engine speed [rad/s], torque [N m] and fuel rate [kg/s].

    Attributes:
      spread: greatest less least measured torque over the mean [1].
      used: fuel by the counter [kg] in the measured time [s].
    """

    speed: float
    torque: float
    rate: float
    spread: float
    used: float
    time: float


def measure(speed: float, pedal: float, timestep: float) -> Point:
    """Holds a vehicle speed [m/s] at a pedal by the grade, and measures for 3 s."""
    truck = Truck.load(timestep=timestep, visuals=False)
    truck.reset(speed=speed)
    integral = 0.0

    def command(_: float, state: EgoState) -> VehicleCommand:
        nonlocal integral
        error = state.speed - speed
        integral = float(np.clip(integral + _INTEGRAL * error * PERIOD, -0.3, 0.3))
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
    """Specific consumption of the map at the point [kg/J]; nan outside of the map."""
    table = parameters.engine.fuel_map
    lookup = RegularGridInterpolator(
        (table.rows, table.columns), table.values, bounds_error=False, fill_value=np.nan
    )
    return float(lookup((point.torque, point.speed)))


def compare(timestep: float, *, quick: bool) -> Findings:
    """Fuel rate of each point against the map."""
    parameters, found = TruckParameters.load(), Findings()
    powers, rates, wanted = [], [], []
    for kph, pedal in POINTS[1::2] if quick else POINTS:
        point = measure(kph * KMH, pedal, timestep)
        power = point.torque * point.speed
        expected = consumption(parameters, point) * power
        found.label = (
            f"fuel at {kph:g} km/h, {100.0 * pedal:g} % pedal "
            f"({point.torque:.0f} N m, {point.speed / RPM:.0f} rpm)"
        )
        specific = _G_PER_KWH * consumption(parameters, point)
        found.check("torque's spread", 100.0 * point.spread, "%", must="<= 0.5")
        must = f"{0.99 * specific:.2f} .. {1.01 * specific:.2f}"
        measured = _G_PER_KWH * point.rate / power
        found.check("specific consumption", measured, "g/kWh", specific, must)
        counter = 100.0 * abs(point.used / point.time / point.rate - 1.0)
        found.check("counter against rate", counter, "%", must="<= 0.5")
        powers.append(power / 1e3)
        rates.append(point.rate * 1e3)
        wanted.append(expected * 1e3)
    found.label = ""
    order = np.argsort(powers)
    x = np.array(powers)[order]
    by_map = Line("map x power", x, np.array(wanted)[order], "reference")
    truck = Line("truck", x, np.array(rates)[order], "simulation")
    found.panel("Fuel at steady points", "power [kW]", "fuel rate [g/s]", by_map, truck)
    return found
