"""Overrides of settings that overlap in time: the newest one holds, and each ends on its own."""

from __future__ import annotations

import itertools
import weakref
from collections.abc import Callable, Iterable, Mapping
from typing import Any, NamedTuple

Undo = Callable[[], None]


class _Override(NamedTuple):
    """A value and a weak reference to its undo function, without which it cannot end."""

    value: Any
    undo: weakref.ref[Undo]


class Overrides:
    """The overrides of each field of each target, oldest first.

    An override whose undo function no longer exists is permanent and hides the older ones. Those
    are dropped, so repeated overrides do not use more and more memory.
    """

    def __init__(self) -> None:
        self._numbers = itertools.count()
        self._of: dict[str, dict[str, dict[int, _Override]]] = {}

    def __len__(self) -> int:
        """Number of values that are stored."""
        return sum(len(kept) for fields in self._of.values() for kept in fields.values())

    def add(self, target: str, values: Mapping[str, Any], ended: Callable[[], None]) -> Undo:
        """Adds an override; the newest override of a target's field holds.

        Args:
          target: name of the vehicle, type or light.
          values: by field.
          ended: called after the override has ended, unless its target was dropped before.

        Returns:
          A function that ends the override; further calls do nothing.
        """
        number, fields = next(self._numbers), tuple(values)

        def undo() -> None:
            if self._end(target, fields, number):
                ended()

        for field, value in values.items():
            kept = self._of.setdefault(target, {}).setdefault(field, {})
            if kept:
                last = next(reversed(kept))
                if kept[last].undo() is None:
                    for hidden in [key for key in kept if key != last]:
                        del kept[hidden]
            kept[number] = _Override(value, weakref.ref(undo))
        return undo

    def fields(self, target: str) -> Iterable[str]:
        """The fields of a target that have overrides, in the order of their first override."""
        return self._of.get(target, {}).keys()

    def newest(self, field: str, *targets: str) -> Any:
        """The value of the newest override of a field of any of the targets; None without one."""
        number, value = -1, None
        for target in targets:
            kept = self._of.get(target, {}).get(field)
            if kept and (last := next(reversed(kept))) > number:
                number, value = last, kept[last].value
        return value

    def forget(self, target: str) -> None:
        """Drops all overrides of a target; afterwards their undo functions do nothing."""
        self._of.pop(target, None)

    def _end(self, target: str, fields: Iterable[str], number: int) -> bool:
        """Removes an override; returns False if it is already removed."""
        found = False
        mine = self._of.get(target, {})
        for field in fields:
            kept = mine.get(field, {})
            found |= kept.pop(number, None) is not None
            if not kept:
                mine.pop(field, None)
        if not mine:
            self._of.pop(target, None)
        return found
