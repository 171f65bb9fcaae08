"""Units of the truck's parameters: which one a field has, its bounds, and what is converted to it.

A field of a parameter dataclass is annotated with its quantity, for instance `mass: Kilograms`. A
file may give other units of the same kind, `{ value = 7.1, unit = "t" }`; the dataclasses hold SI.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

from iits_mj.core.errors import InputError
from iits_mj.core.units import GRAVITY

_DEGREE = math.pi / 180.0
# What one of a unit is in the SI unit of its kind, for the units of spec sheets.
CONVERSIONS: dict[str, dict[str, float]] = {
    "m": {"mm": 1e-3, "cm": 1e-2, "km": 1e3, "in": 0.0254, "ft": 0.3048},
    "m2": {"cm2": 1e-4, "ft2": 0.3048**2},
    "m3": {"l": 1e-3, "cm3": 1e-6, "in3": 0.0254**3},
    "kg": {"t": 1e3, "g": 1e-3, "lb": 0.45359237},
    "s": {"ms": 1e-3, "min": 60.0},
    "rad": {"deg": _DEGREE, "mrad": 1e-3},
    "rad/s": {"rpm": math.pi / 30.0, "deg/s": _DEGREE},
    "m/s": {"km/h": 1.0 / 3.6, "mph": 0.44704},
    "N": {"kN": 1e3, "kgf": GRAVITY, "lbf": 4.4482216152605},
    "N m": {"kN m": 1e3, "lbf ft": 1.3558179483314004},
    "N m/s": {"kN m/s": 1e3},
    "N/m": {"N/mm": 1e3, "kN/m": 1e3, "kN/mm": 1e6},
    "N s/m": {"kN s/m": 1e3},
    "N m/rad": {"kN m/rad": 1e3, "N m/deg": 1.0 / _DEGREE, "kN m/deg": 1e3 / _DEGREE},
    "N m s/rad": {"kN m s/rad": 1e3},
    "Pa": {"kPa": 1e3, "MPa": 1e6, "bar": 1e5, "mbar": 1e2, "psi": 6894.757293168},
    "Pa/s": {"kPa/s": 1e3, "bar/s": 1e5},
    "W": {"kW": 1e3, "hp": 745.6998715822702, "PS": 735.49875},
    "J": {"kJ": 1e3, "kWh": 3.6e6},
    "kg/s": {"g/s": 1e-3, "g/h": 1e-3 / 3600.0, "kg/h": 1.0 / 3600.0},
    "m3/rad": {"cm3/rad": 1e-6, "cm3": 1e-6 / (2.0 * math.pi), "l": 1e-3 / (2.0 * math.pi)},
    "N m/Pa": {"N m/kPa": 1e-3, "N m/bar": 1e-5},
    "1": {"%": 1e-2},
    "1/rad": {"1/deg": 1.0 / _DEGREE},
}


@dataclass(frozen=True)
class Quantity:
    """Unit and inclusive bounds of a parameter.

    Attributes:
      unit: SI unit, "1" for pure numbers and words.
      low, high: bounds in that unit; no real truck is beyond them.
    """

    unit: str
    low: float = -1e9
    high: float = 1e9

    def factor(self, unit: str, name: str) -> float:
        """Returns what one `unit` is in this quantity's unit.

        Raises:
          InputError: it is not a unit of this quantity; names the parameter and the units allowed.
        """
        if unit == self.unit:
            return 1.0
        others = CONVERSIONS.get(self.unit, {})
        if unit not in others:
            allowed = ", ".join(map(repr, (self.unit, *others)))
            raise InputError(f"parameter {name}: unit {unit!r} is not one of {allowed}")
        return others[unit]

    def check(self, value: float, name: str) -> float:
        """Returns a value within the bounds; raises InputError otherwise."""
        if self.low <= value <= self.high:
            return value
        unit = "" if self.unit == "1" else f" {self.unit}"
        raise InputError(
            f"parameter {name} = {value:g}{unit}: allowed is {self.low:g} to {self.high:g}{unit}"
        )


PLAIN = Quantity("1")
_POSITIVE = 1e-9

Pure = Annotated[float, PLAIN]
Share = Annotated[float, Quantity("1", 0.0, 1.0)]
Efficiency = Annotated[float, Quantity("1", 0.5, 1.0)]
Ratio = Annotated[float, Quantity("1", 0.1, 100.0)]
Count = Annotated[int, Quantity("1", 0, 1000)]
Tires = Annotated[int, Quantity("1", 1, 4)]
Meters = Annotated[float, Quantity("m", -100.0, 100.0)]
Length = Annotated[float, Quantity("m", _POSITIVE, 100.0)]
Radius = Annotated[float, Quantity("m", 0.1, 2.0)]
Distance = Annotated[float, Quantity("m", 0.0, 100.0)]
SquareMeters = Annotated[float, Quantity("m2", 0.0, 1e3)]
CubicMeters = Annotated[float, Quantity("m3", 0.0, 1e3)]
CubicMetersPerRadian = Annotated[float, Quantity("m3/rad", 0.0, 1.0)]
Kilograms = Annotated[float, Quantity("kg", 0.0, 1e6)]
Mass = Annotated[float, Quantity("kg", 1.0, 1e6)]
KilogramsPerSecond = Annotated[float, Quantity("kg/s", 0.0, 10.0)]
Density = Annotated[float, Quantity("kg/m3", 0.0, 10.0)]
Inertia = Annotated[float, Quantity("kg m2", 0.0, 1e9)]
Seconds = Annotated[float, Quantity("s", 0.0, 1e4)]
PerSecond = Annotated[float, Quantity("1/s", 0.0, 1e4)]
Radians = Annotated[float, Quantity("rad", -100.0, 100.0)]
RadiansPerSecond = Annotated[float, Quantity("rad/s", 0.0, 1e4)]
PerRadian = Annotated[float, Quantity("1/rad", 0.0, 100.0)]
Speed = Annotated[float, Quantity("m/s", 0.0, 1e3)]
Acceleration = Annotated[float, Quantity("m/s2", 0.0, 100.0)]
Jerk = Annotated[float, Quantity("m/s3", 0.0, 1e6)]
Newtons = Annotated[float, Quantity("N", 0.0, 1e7)]
NewtonMeters = Annotated[float, Quantity("N m", -1e6, 1e6)]
NewtonMetersPerSecond = Annotated[float, Quantity("N m/s", 0.0, 1e7)]
NewtonMetersPerPascal = Annotated[float, Quantity("N m/Pa", 0.0, 10.0)]
Stiffness = Annotated[float, Quantity("N/m", 0.0, 1e9)]
SpringRate = Annotated[float, Quantity("N/m", 1.0, 1e9)]
Damping = Annotated[float, Quantity("N s/m", 0.0, 1e9)]
RollStiffness = Annotated[float, Quantity("N m/rad", 0.0, 1e9)]
RollDamping = Annotated[float, Quantity("N m s/rad", 0.0, 1e9)]
Pascals = Annotated[float, Quantity("Pa", 0.0, 1e8)]
PascalsPerSecond = Annotated[float, Quantity("Pa/s", 0.0, 1e9)]
Watts = Annotated[float, Quantity("W", 0.0, 1e8)]


def quantity_of(hint: object) -> Quantity:
    """Returns the quantity that annotates a field's type; a pure number without one."""
    for entry in getattr(hint, "__metadata__", ()):
        if isinstance(entry, Quantity):
            return entry
    return PLAIN
