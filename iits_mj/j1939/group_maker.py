"""Messages of the program to typed groups of the bus, by the rows of `signals.csv`."""

from __future__ import annotations

import operator
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, fields
from typing import Any, cast

from iits_mj.j1939.database import group_type
from iits_mj.j1939.group import NOT_AVAILABLE, Group, Value
from iits_mj.j1939.mapping import Mapping as Row


@dataclass(frozen=True, slots=True)
class FieldOf:
    """A quantity that is a field of one of the sources, which are counted from 0."""

    source: int
    name: str

    def __call__(self, *sources: object) -> float | None:
        """The field."""
        return cast("float | None", getattr(sources[self.source], self.name))


class GroupMaker:
    """Makes one kind of group; what nobody knows stays "not available".

    Args:
      message: name in the DBC.
      rows: what it carries.
      quantities: how to find a row's quantity in the arguments of a call, SI units; None is "not
        available".
    """

    def __init__(
        self,
        message: str,
        rows: Iterable[Row],
        quantities: Mapping[str, Callable[..., float | None]],
    ) -> None:
        self._type = group_type(message)
        self._places = {field.name: place for place, field in enumerate(fields(self._type))}
        self._unknown: list[Value] = [NOT_AVAILABLE] * len(self._places)
        self._parts: list[tuple[int, Callable[..., float | None], float]] = []
        plain: dict[int, list[tuple[str, int, float]]] = {}
        for row in rows:
            place, quantity = self._places[row.signal], quantities[row.quantity]
            if isinstance(quantity, FieldOf):
                plain.setdefault(quantity.source, []).append((quantity.name, place, row.scale))
            else:
                self._parts.append((place, quantity, row.scale))
        # All plain fields of a source are fetched at once, which takes half the time.
        self._plain = [
            (source, fields_getter([name for name, _, _ in part]), [entry[1:] for entry in part])
            for source, part in plain.items()
        ]

    def __call__(self, *sources: object, **signals: Value) -> Group:
        """The group; `signals` are those that no row tells, in the units of the DBC."""
        values = self._unknown.copy()
        for source, fetch, places in self._plain:
            for value, (place, scale) in zip(fetch(sources[source]), places, strict=True):
                if value is not None:
                    values[place] = value / scale
        for place, quantity, scale in self._parts:
            value = quantity(*sources)
            if value is not None:
                values[place] = value / scale
        for name, signal in signals.items():
            values[self._places[name]] = signal
        return self._type(*values)


def fields_getter(names: list[str]) -> Callable[[Any], tuple[Any, ...]]:
    """Fetches fields as a tuple, a single one, too."""
    if len(names) > 1:
        return operator.attrgetter(*names)
    (name,) = names
    return lambda source: (getattr(source, name),)
