"""The map between signals of the bus and controls and sensors of the truck (`signals.csv`).

`commands()` are the signals that the truck receives (the fields of `VehicleCommand`, in the order
of `ctrl`), `reports()` those that it sends. Coding, decoding and the manual page use them.
"""

from __future__ import annotations

import functools
import operator
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

from iits_mj.core.tables import read_table
from iits_mj.core.units import DIESEL_DENSITY, GRAVITY, KMH, RPM
from iits_mj.j1939.database import codec_of, identifier
from iits_mj.j1939.groups import Value

_LITER = DIESEL_DENSITY  # of fuel [kg]

# SI units in one unit of the signal.
_UNITS = {
    "": 1.0,
    "percent": 0.01,
    # Braking torques of retarders are negative percentages.
    "-percent": -0.01,
    "rpm": RPM,
    "km/h": KMH,
    "kPa": 1e3,
    "L": _LITER,
    "L/h": _LITER / 3600.0,
    # Fuel economy in m/kg.
    "km/L": 1e3 / _LITER,
    # A weight force in newtons is sent as its mass.
    "kg of weight": GRAVITY,
}


@dataclass(frozen=True, slots=True)
class PaperSignal:
    """An input or output of the paper or its release.

    Attributes:
      name: the paper's name of an input; a description of an output, which the paper does not name.
      number: of the inputs 1 to 4, of the outputs 1 to 16; None for additions of the release.
    """

    name: str
    number: int | None


@dataclass(frozen=True, slots=True)
class SignalRow:
    """One row of `signals.csv`.

    Attributes:
      quantity: field of `VehicleCommand`, `EgoState` or `TruckReport`, or derived from them.
      message, signal: names in the DBC.
      scale: SI units in one unit of the signal.
      address: of the unit that obeys or sends; None: that of the DBC.
      elements: controls or sensors of the model; "[k]" is the index of a number in a sensor.
      back: whether `StateReceiver` reads the quantity from this signal.
      paper: the inputs or outputs of the paper that the signal carries, whole or in part.
    """

    quantity: str
    message: str
    signal: str
    scale: float
    address: int | None
    elements: tuple[str, ...]
    back: bool
    paper: tuple[PaperSignal, ...]


def commands() -> tuple[SignalRow, ...]:
    """Signals that the truck receives, in the order of `VehicleCommand`'s fields."""
    return _table()["in"]


def reports() -> tuple[SignalRow, ...]:
    """Signals that the truck sends. The rows of VW are sent once for each axle."""
    return _table()["out"]


def sender(row: SignalRow) -> int:
    """Address of the control unit that sends a report."""
    return identifier(row.message) & 0xFF if row.address is None else row.address


@functools.cache
def _table() -> dict[str, tuple[SignalRow, ...]]:
    names, table = read_table(Path(__file__).with_name("signals.csv"), "table of signals")
    found: dict[str, list[SignalRow]] = {"in": [], "out": []}
    for cells in table:
        row = dict(zip(names, cells, strict=True))
        found[row["way"]].append(
            SignalRow(
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
    """Parses "3 engine speed", or "fuel rate" for a signal without a number."""
    first, _, rest = item.strip().partition(" ")
    return PaperSignal(rest, int(first)) if first.isdigit() else PaperSignal(item.strip(), None)


@dataclass(frozen=True, slots=True)
class FieldOf:
    """A quantity that is a field of one of the sources, given by its index."""

    source: int
    name: str

    def __call__(self, *sources: object) -> float | None:
        """Returns the field."""
        return cast("float | None", getattr(sources[self.source], self.name))


class DataMaker:
    """Makes the bytes of one message from the quantities of `signals.csv`.

    Args:
      message: name in the DBC.
      rows: of the signals; all other signals are sent as "not available".
      quantities: functions that compute the quantities from the sources of a call, in SI units;
        None is "not available".
      extra: signals whose values are arguments of each call and do not come from their rows.
      saturate: whether to send the limit of a signal for a number outside its range.
    """

    def __init__(
        self,
        message: str,
        rows: Iterable[SignalRow],
        quantities: Mapping[str, Callable[..., float | None]],
        *,
        extra: Sequence[str] = (),
        saturate: bool = False,
    ) -> None:
        # One call fetches all plain fields of a source, which takes half the time.
        plain: dict[int, list[tuple[str, SignalRow]]] = {}
        derived: list[tuple[Callable[..., float | None], SignalRow]] = []
        for row in rows:
            if row.signal in extra:
                continue
            quantity = quantities[row.quantity]
            if isinstance(quantity, FieldOf):
                plain.setdefault(quantity.source, []).append((quantity.name, row))
            else:
                derived.append((quantity, row))
        self._plain = [
            (source, _fields_getter([name for name, _ in part])) for source, part in plain.items()
        ]
        self._derived = [quantity for quantity, _ in derived]
        ordered = [row for part in plain.values() for _, row in part] + [row for _, row in derived]
        units = {row.signal: row.scale for row in ordered} | dict.fromkeys(extra, 1.0)
        self._codec = codec_of(message).part(units)
        self._saturate = saturate

    def __call__(self, *sources: object, extra: Sequence[Value] = ()) -> bytes:
        """Returns the bytes of the message; `extra` is in the units of the DBC.

        Raises:
          BusError: a number is not finite, or out of range without `saturate`.
        """
        values: list[Value | None] = []
        for source, fetch in self._plain:
            values += fetch(sources[source])
        for quantity in self._derived:
            values.append(quantity(*sources))
        values += extra
        return self._codec.pack(values, saturate=self._saturate)


def _fields_getter(names: list[str]) -> Callable[[Any], tuple[Any, ...]]:
    """A function that returns fields as a tuple, also for a single field."""
    if len(names) > 1:
        return operator.attrgetter(*names)
    (name,) = names
    return lambda source: (getattr(source, name),)
