"""Which signal of the bus is which control or sensor of the truck: `signals.csv`, read once.

`commands()` is what the truck receives (the fields of `VehicleCommand`, in the order of `ctrl`),
`reports()` what it sends. Coding, decoding and the manual page's tables are made from them.
"""

from __future__ import annotations

import csv
import functools
from dataclasses import dataclass
from pathlib import Path

from iits_mj.units import KMH, RPM

# EN 590 diesel fuel at 15 C lies at 820 to 845 kg/m3.
DIESEL_DENSITY = 832.0
_LITRE = 1e-3 * DIESEL_DENSITY

# SI units in one unit of the signal.
_UNITS = {
    "": 1.0,
    "percent": 0.01,
    # Retarders take a braking torque as a negative percentage.
    "-percent": -0.01,
    "rpm": RPM,
    "km/h": KMH,
    "kPa": 1e3,
    "L": _LITRE,
    "L/h": _LITRE / 3600.0,
}


@dataclass(frozen=True, slots=True)
class Mapping:
    """One row of `signals.csv`.

    Attributes:
      quantity: field of `VehicleCommand`, `EgoState` or `TruckReport`, or derived from them.
      message, signal: names in the DBC.
      scale: SI units in one unit of the signal.
      address: of the unit that obeys, or sends; None: as the DBC says.
      element: control or sensor of the model; a name that ends in `*` stands for several.
      back: whether `StateReceiver` reads the quantity from this signal.
      paper: the paper's name of it, "yes" for an output that it does not name, or "".
    """

    quantity: str
    message: str
    signal: str
    scale: float
    address: int | None
    element: str
    back: bool
    paper: str


def commands() -> tuple[Mapping, ...]:
    """What the truck receives, in the order of `VehicleCommand`'s fields."""
    return _table()["in"]


def reports() -> tuple[Mapping, ...]:
    """What the truck sends, but for the axle weights, of which there is a frame an axle."""
    return _table()["out"]


@functools.cache
def _table() -> dict[str, tuple[Mapping, ...]]:
    text = Path(__file__).with_name("signals.csv").read_text(encoding="utf-8")
    lines = [line for line in text.splitlines() if not line.startswith("#")]
    found: dict[str, list[Mapping]] = {"in": [], "out": []}
    for row in csv.DictReader(lines):
        found[row["way"]].append(
            Mapping(
                row["quantity"],
                row["message"],
                row["signal"],
                _UNITS[row["unit"]],
                int(row["address"]) if row["address"] else None,
                row["element"],
                row["back"] == "1",
                row["paper"],
            )
        )
    return {way: tuple(rows) for way, rows in found.items()}
