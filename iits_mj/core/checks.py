"""What every setting of the traffic is checked by.

numpy's numbers are numbers like Python's own; settings keep them as Python's own (`plain`), so that
a stored configuration stays JSON.
"""

from __future__ import annotations

import dataclasses
import math
import numbers
import operator
from numbers import Real
from typing import Any

import numpy as np
from numpy.typing import NDArray

from iits_mj.core.errors import InputError

# --- What a learner hands in, checked at the boundary ---


def read_action(action: Any, shape: tuple[int, ...], name: str = "action") -> NDArray[np.float64]:
    """An action as numbers of that shape.

    Args:
      action: what was given.
      shape: what it has to have.
      name: what it is called in the error.

    Raises:
      InputError: it is of another shape, no numbers, or not finite.
    """
    try:
        values = np.asarray(action, dtype=float)
    except (TypeError, ValueError):
        values = None
    if values is None or values.shape != shape or not np.isfinite(values).all():
        raise InputError(f"{name} {action!r} is not allowed; use finite numbers of shape {shape}")
    return values


# --- Settings that cannot be are refused by name ---


def require_positive(settings: object, *names: str, zero: bool = False) -> None:
    """Holds attributes of settings against their only bound.

    Args:
      settings: whose attributes; its class is named in the message.
      names: of the attributes.
      zero: is allowed, too.

    Raises:
      InputError: one is not a finite number above zero.
    """
    for name in names:
        value = getattr(settings, name)
        number = isinstance(value, Real) and not isinstance(value, bool) and math.isfinite(value)
        if not number or not (value > 0.0 or (zero and value == 0.0)):
            least = "zero or more" if zero else "more than zero"
            raise InputError(
                f"{type(settings).__name__}: {name} is {value!r}: a finite number of {least} is "
                "needed"
            )


# --- What every setting of the traffic is checked by ---

_SHOWN = 80  # letters of a value in a message


def is_number(value: object) -> bool:
    """Whether a value is a finite number; True and False are none."""
    if not isinstance(value, numbers.Real) or isinstance(value, bool):
        return False
    try:
        return math.isfinite(value)
    except OverflowError:  # a whole number beyond what a float holds
        return False


def is_whole(value: object) -> bool:
    """Whether a value is a whole number; True and False are none."""
    return isinstance(value, numbers.Integral) and not isinstance(value, bool)


def in_range(name: str, value: object, low: float, high: float) -> None:
    """Refuses what is not a number between two bounds, which are allowed.

    Raises:
      InputError: names the value and the bounds.
    """
    if not is_number(value) or not low <= value <= high:  # type: ignore[operator]
        raise InputError(f"{name} = {shown(value)}: allowed is {low:g} to {high:g}")


def shown(value: object) -> str:
    """A value as a message shows it: not longer than can be read."""
    try:
        text = repr(value)
    except ValueError:  # Python writes no whole number of more than some thousand digits
        return "a number of thousands of digits"
    return text if len(text) <= _SHOWN else f"{text[:_SHOWN]}..."


def whole(name: str, value: Any) -> int:
    """A whole number as Python's own.

    Raises:
      InputError: it is none; True and False are none either.
    """
    if not is_whole(value):
        raise InputError(f"{name} {shown(value)}: must be a whole number")
    return operator.index(value)


def plain(value: Any) -> Any:
    """A number as Python's own, those in tuples and lists too; anything else as it is."""
    if isinstance(value, (tuple, list)):
        return tuple(plain(entry) for entry in value)
    if type(value) in (int, float) or not is_number(value):
        return value
    return operator.index(value) if is_whole(value) else float(value)


def make_plain(settings: Any) -> None:
    """Keeps the numbers in a frozen dataclass's fields as Python's own; lists become tuples."""
    for field in dataclasses.fields(settings):
        object.__setattr__(settings, field.name, plain(getattr(settings, field.name)))
