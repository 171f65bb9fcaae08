"""Settings that cannot be are refused by name."""

from __future__ import annotations

import math
from numbers import Real

from iits_mj.errors import InputError


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
