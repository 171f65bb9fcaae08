"""What every setting of the traffic is checked by."""

from __future__ import annotations

import math

from iits_mj.errors import InputError


def is_number(value: object) -> bool:
    """Whether a value is a finite number; True and False are none."""
    return isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)


def is_whole(value: object) -> bool:
    """Whether a value is a whole number; True and False are none."""
    return isinstance(value, int) and not isinstance(value, bool)


def in_range(name: str, value: object, low: float, high: float) -> None:
    """Refuses what is not a number between two bounds, which are allowed.

    Raises:
      InputError: names the value and the bounds.
    """
    if not is_number(value) or not low <= value <= high:  # type: ignore[operator]
        raise InputError(f"{name} = {value!r}: allowed is {low:g} to {high:g}")
