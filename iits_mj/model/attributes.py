"""Numbers and parameter sections as text of MJCF attributes."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

# Significant digits of the numbers of powertrain and air brakes.
PLUGIN_DIGITS = 9


def text(*values: ArrayLike, digits: int = 10) -> str:
    """Returns numbers, and arrays of any shape, as one MJCF attribute."""
    return " ".join(f"{number:.{digits}g}" for value in values for number in np.ravel(value))


def plugin_attributes(section: Any, *without: str, digits: int = 10) -> dict[str, str]:
    """Returns the fields of a parameter section as attributes of a plugin instance, by name.

    Args:
      section: dataclass of numbers, text and arrays; nested sections, maps and empty arrays
        are left out.
      *without: fields that the plugin does not take, or takes in another form.
      digits: significant digits of the numbers.
    """
    return {
        name: value if isinstance(value, str) else text(value, digits=digits)
        for name, value in vars(section).items()
        if name not in without and not dataclasses.is_dataclass(value) and np.size(value)
    }
