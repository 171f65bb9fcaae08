"""What a learner hands in, checked at the boundary."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from iits_mj.errors import InputError


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
