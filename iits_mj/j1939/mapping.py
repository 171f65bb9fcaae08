"""Which signal of the bus is which control or sensor of the truck: `signals.csv`, read once.

`commands()` is what the truck receives (the fields of `VehicleCommand`, in the order of `ctrl`),
`reports()` what it sends. Coding, decoding and the manual page's tables are made from them.
"""

from __future__ import annotations

import csv
import functools
from dataclasses import dataclass
from pathlib import Path

from iits_mj.core.units import DIESEL_DENSITY, GRAVITY, KMH, RPM
from iits_mj.j1939.frame import Frame
from iits_mj.j1939.group import layouts

_LITRE = DIESEL_DENSITY  # of fuel [kg]

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
    # Metres a kilogram of fuel.
    "km/L": 1e3 / _LITRE,
    # A weight force in newtons is sent as the mass that it belongs to.
    "kg of weight": GRAVITY,
}


@dataclass(frozen=True, slots=True)
class PaperSignal:
    """What the paper or its release calls a signal.

    Attributes:
      name: the paper's for its inputs, a description for the outputs, which it does not name.
      number: 1 to 4 of the inputs, 1 to 16 of the outputs; None for what the release has more.
    """

    name: str
    number: int | None


@dataclass(frozen=True, slots=True)
class Mapping:
    """One row of `signals.csv`.

    Attributes:
      quantity: field of `VehicleCommand`, `EgoState` or `TruckReport`, or derived from them.
      message, signal: names in the DBC.
      scale: SI units in one unit of the signal.
      address: of the unit that obeys, or sends; None: as the DBC says.
      elements: controls or sensors of the model; "[k]" is the place of a number in a sensor.
      back: whether `StateReceiver` reads the quantity from this signal.
      paper: the paper's inputs or outputs that it is, or a part of.
    """

    quantity: str
    message: str
    signal: str
    scale: float
    address: int | None
    elements: tuple[str, ...]
    back: bool
    paper: tuple[PaperSignal, ...]


def commands() -> tuple[Mapping, ...]:
    """What the truck receives, in the order of `VehicleCommand`'s fields."""
    return _table()["in"]


def reports() -> tuple[Mapping, ...]:
    """What the truck sends. Rows of VW stand for a frame an axle."""
    return _table()["out"]


def sender(row: Mapping) -> int:
    """Address of the control unit that sends a report."""
    return _default_sender(row.message) if row.address is None else row.address


@functools.cache
def _default_sender(message: str) -> int:
    return Frame(layouts().get_message_by_name(message).frame_id, b"").source


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
                tuple(row["elements"].split()),
                row["back"] == "1",
                tuple(_paper(item) for item in row["paper"].split(";") if item),
            )
        )
    return {way: tuple(rows) for way, rows in found.items()}


def _paper(item: str) -> PaperSignal:
    """From "3 engine speed", or "fuel rate" for what has no number."""
    first, _, rest = item.strip().partition(" ")
    return PaperSignal(rest, int(first)) if first.isdigit() else PaperSignal(item.strip(), None)
