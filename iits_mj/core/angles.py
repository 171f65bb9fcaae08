"""Angles wrapped to one turn."""

from __future__ import annotations

import math

import numpy as np

from iits_mj.core.arrays import FloatArray


def wrap_angle(angle: float) -> float:
    """The same angle between -pi and pi [rad], both included."""
    return math.remainder(angle, math.tau)


def wrap_angles(angles: FloatArray) -> FloatArray:
    """The same angles from -pi up to, but not including, pi [rad], of any shape.

    Rounds otherwise than `wrap_angle`: the two are not interchangeable to the last bit.
    """
    return np.asarray(np.remainder(angles + np.pi, 2.0 * np.pi) - np.pi)
