"""Messages of the program to typed groups of the bus, by the rows of `signals.csv`."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import fields

from iits_mj.j1939.database import group_type
from iits_mj.j1939.group import NOT_AVAILABLE, Group, Value
from iits_mj.j1939.mapping import Mapping as Row


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
        self._parts = tuple(
            (self._places[row.signal], quantities[row.quantity], row.scale) for row in rows
        )

    def __call__(self, *sources: object, **signals: Value) -> Group:
        """The group; `signals` are those that no row tells, in the units of the DBC."""
        values: list[Value] = [NOT_AVAILABLE] * len(self._places)
        for place, quantity, scale in self._parts:
            value = quantity(*sources)
            if value is not None:
                values[place] = value / scale
        for name, signal in signals.items():
            values[self._places[name]] = signal
        return self._type(*values)
