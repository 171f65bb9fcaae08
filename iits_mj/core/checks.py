"""Checks of values that a user gives: numbers, ranges, choices, arrays.

Each check raises `InputError` with the name, the value, its unit and the allowed values. NumPy
numbers pass like Python's; `plain` and `make_plain` convert them to Python's, so that a stored
configuration stays JSON. True and False are not numbers.
"""

from __future__ import annotations

import dataclasses
import math
import numbers
import operator
from collections.abc import Iterable
from typing import Any

import numpy as np

from iits_mj.core.arrays import FloatArray
from iits_mj.core.errors import InputError

_SHOWN = 80  # characters of a value in a message


def is_number(value: object) -> bool:
    """Returns whether a value is a finite number."""
    # The first test saves the time of the second one.
    if type(value) is not float and (
        not isinstance(value, numbers.Real) or isinstance(value, bool)
    ):
        return False
    try:
        return math.isfinite(value)
    except OverflowError:  # a whole number beyond the range of a float
        return False


def is_whole(value: object) -> bool:
    """Returns whether a value is a whole number."""
    # The usual type first: asking the abstract class takes ten times as long.
    return type(value) is int or (
        isinstance(value, numbers.Integral) and not isinstance(value, bool)
    )


def shown(value: object) -> str:
    """Returns a value as text for a message, cut after 80 characters."""
    try:
        text = repr(value)
    except ValueError:  # Python does not print a whole number of some thousand digits
        return "a number of thousands of digits"
    return text if len(text) <= _SHOWN else f"{text[:_SHOWN]}..."


def in_range(name: str, value: Any, low: float, high: float, unit: str = "") -> float:
    """Returns a number from `low` to `high`; raises InputError for anything else."""
    if not is_number(value) or not low <= value <= high:
        given = f"{shown(value)} {unit}".rstrip()
        raise InputError(f"{name} = {given}: allowed is {low:g} to {high:g} {unit}".rstrip())
    return float(value)


def positive(name: str, value: Any, unit: str = "", *, zero: bool = False) -> float:
    """Returns a finite number above zero (or zero, if `zero`); raises InputError otherwise."""
    if not is_number(value) or not (value > 0.0 or (zero and value == 0.0)):
        least = "zero or more" if zero else "more than zero"
        given = f"{shown(value)} {unit}".rstrip()
        raise InputError(f"{name} is {given}: a finite number of {least} is needed")
    return float(value)


def require_positive(settings: object, *names: str, zero: bool = False) -> None:
    """Applies `positive` to attributes of settings; the message names their class."""
    for name in names:
        positive(f"{type(settings).__name__}: {name}", getattr(settings, name), zero=zero)


def whole(name: str, value: Any) -> int:
    """Returns a whole number as int; raises InputError for anything else."""
    if not is_whole(value):
        raise InputError(f"{name} {shown(value)}: must be a whole number")
    return operator.index(value)


def one_of(name: str, value: Any, allowed: Iterable[str]) -> Any:
    """Returns a value that is one of those allowed; raises InputError for anything else."""
    choices = list(allowed)
    if value not in choices:
        raise InputError(
            f"{name} {shown(value)} is not known{did_you_mean(value, choices)}; use one of: "
            f"{', '.join(choices)}"
        )
    return value


def did_you_mean(value: object, allowed: Iterable[str]) -> str:
    """Returns a question in brackets that names the allowed word most like a value, or ""."""
    # Wrong values only.
    import difflib

    words = {word.casefold(): word for word in allowed}
    near = difflib.get_close_matches(str(value)[:_SHOWN].casefold(), words, n=1, cutoff=0.6)
    return f" (did you mean {words[near[0]]}?)" if near else ""


def check_fields(what: str, given: Iterable[str], known: Iterable[str]) -> None:
    """Raises InputError if a name of a table is not among its fields."""
    known = list(known)
    for name in given:
        if name not in known:
            raise InputError(
                f"{what}: {shown(name)} is unknown{did_you_mean(name, known)}; the fields are "
                f"{', '.join(known)}"
            )


def read_action(action: Any, shape: tuple[int, ...], name: str = "action") -> FloatArray:
    """Returns an array of finite numbers of a shape; raises InputError for anything else."""
    try:
        values = np.asarray(action, dtype=float)
    except (TypeError, ValueError):
        values = None
    if values is None or values.shape != shape or not np.isfinite(values).all():
        raise InputError(f"{name} {action!r} is not allowed; use finite numbers of shape {shape}")
    return values


def plain(value: Any) -> Any:
    """Returns numbers as int or float, also inside tuples and lists; anything else unchanged."""
    if isinstance(value, (tuple, list)):
        return tuple(plain(entry) for entry in value)
    if type(value) in (int, float) or not is_number(value):
        return value
    return operator.index(value) if is_whole(value) else float(value)


def make_plain(settings: Any) -> None:
    """Applies `plain` to every field of a frozen dataclass; lists become tuples."""
    for field in dataclasses.fields(settings):
        object.__setattr__(settings, field.name, plain(getattr(settings, field.name)))
