"""Messages of the program to the bytes of messages of the bus, by the rows of `signals.csv`."""

from __future__ import annotations

import operator
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, cast

from iits_mj.j1939.database import codec_of
from iits_mj.j1939.group import Value
from iits_mj.j1939.mapping import Mapping as Row


@dataclass(frozen=True, slots=True)
class FieldOf:
    """A quantity that is a field of one of the sources, which are counted from 0."""

    source: int
    name: str

    def __call__(self, *sources: object) -> float | None:
        """The field."""
        return cast("float | None", getattr(sources[self.source], self.name))


class DataMaker:
    """Makes the bytes of one message; what nobody knows says "not available".

    Args:
      message: name in the DBC.
      rows: what it carries.
      quantities: how to find a row's quantity in the sources of a call, SI units; None is "not
        available".
      extra: signals that each call tells itself, instead of their rows.
      saturate: put a number outside its signal's range at its limit instead of refusing it.
    """

    def __init__(
        self,
        message: str,
        rows: Iterable[Row],
        quantities: Mapping[str, Callable[..., float | None]],
        *,
        extra: Sequence[str] = (),
        saturate: bool = False,
    ) -> None:
        # Plain fields of a source are fetched at once, which takes half the time.
        plain: dict[int, list[tuple[str, Row]]] = {}
        derived: list[tuple[Callable[..., float | None], Row]] = []
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
        """The bytes of the message from its sources; `extra` in the units of the DBC.

        Raises:
          BusError: a number is not finite, or out of range and not to be put at the limit.
        """
        values: list[Value | None] = []
        for source, fetch in self._plain:
            values += fetch(sources[source])
        for quantity in self._derived:
            values.append(quantity(*sources))
        values += extra
        return self._codec.pack(values, saturate=self._saturate)


def _fields_getter(names: list[str]) -> Callable[[Any], tuple[Any, ...]]:
    """Fetches fields as a tuple, a single one, too."""
    if len(names) > 1:
        return operator.attrgetter(*names)
    (name,) = names
    return lambda source: (getattr(source, name),)
