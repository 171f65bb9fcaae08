"""Orders that overlap in time: the newest one in force holds, and each ends by itself."""

from __future__ import annotations

import itertools
import weakref
from collections.abc import Callable, Iterable, Mapping
from typing import Any, NamedTuple

Undo = Callable[[], None]


class _Order(NamedTuple):
    """A value and who can end it; nobody can any more once `undo` is dead."""

    value: Any
    undo: weakref.ref[Undo]


class Orders:
    """What was ordered of each field of each target, oldest first.

    An order for good, whose undo nobody holds any more, hides the older ones for ever: those are
    dropped, so that orders given again and again take no more and more memory.
    """

    def __init__(self) -> None:
        self._numbers = itertools.count()
        self._of: dict[str, dict[str, dict[int, _Order]]] = {}

    def add(self, target: str, values: Mapping[str, Any], ended: Callable[[], None]) -> Undo:
        """Gives an order; the newest of a target's field is in force.

        Args:
          target: whom it is for.
          values: by field.
          ended: called after the order was ended, unless its target was forgotten before.

        Returns:
          A function that ends the order, once.
        """
        number, fields = next(self._numbers), tuple(values)

        def undo() -> None:
            if self._end(target, fields, number):
                ended()

        for field, value in values.items():
            orders = self._of.setdefault(target, {}).setdefault(field, {})
            if orders:
                last = next(reversed(orders))
                if orders[last].undo() is None:
                    for hidden in [key for key in orders if key != last]:
                        del orders[hidden]
            orders[number] = _Order(value, weakref.ref(undo))
        return undo

    def fields(self, target: str) -> Iterable[str]:
        """The fields of which a target has orders, in the order in which they came."""
        return self._of.get(target, {}).keys()

    def newest(self, field: str, *targets: str) -> Any:
        """The value of the newest order of a field given to any of these; None: there is none."""
        number, value = -1, None
        for target in targets:
            orders = self._of.get(target, {}).get(field)
            if orders and (last := next(reversed(orders))) > number:
                number, value = last, orders[last].value
        return value

    def forget(self, target: str) -> None:
        """Drops all orders of a target; ending them does nothing from now on."""
        self._of.pop(target, None)

    def _end(self, target: str, fields: Iterable[str], number: int) -> bool:
        """Takes an order back; False where it is gone already."""
        found = False
        mine = self._of.get(target, {})
        for field in fields:
            orders = mine.get(field, {})
            found |= orders.pop(number, None) is not None
            if not orders:
                mine.pop(field, None)
        if not mine:
            self._of.pop(target, None)
        return found
