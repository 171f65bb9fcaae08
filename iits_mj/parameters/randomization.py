"""Domain randomization: draws trucks from what is not known of the truck's figures.

    spread = Spread.load()
    drawn = spread.draw(np.random.default_rng(1))
    truck = Truck.load(24_000.0, parameters=drawn.overlay)
    scenario = Scenario(route=road, payload=24_000.0, parameters=drawn.overlay)   # for roll_out

The figures' spread lies in `mjcf/spread.toml`, or in a file of yours of the same form.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from iits_mj.core.assets import mjcf_path
from iits_mj.core.errors import InputError
from iits_mj.parameters.files import read_toml
from iits_mj.parameters.truck import TruckParameters

_KEYS = {"parameters", "low", "high", "grade", "source"}


@dataclass(frozen=True)
class Quantity:
    """One quantity that is not known exactly.

    Attributes:
      name: of the quantity.
      parameters: that are multiplied, all by the same factor; `*` stands for every axle.
      low, high: bounds of the factor, which is uniform between them.
      grade, source: as of the truck's figures.
    """

    name: str
    parameters: tuple[str, ...]
    low: float
    high: float
    grade: str = "J"
    source: str = ""

    def __post_init__(self) -> None:
        if not self.parameters:
            raise InputError(f"spread of {self.name}: at least one parameter is wanted")
        if not (math.isfinite(self.high) and 0.0 <= self.low <= self.high):
            raise InputError(
                f"spread of {self.name}: factors {self.low!r} to {self.high!r} are not allowed; "
                "use finite ones, 0 or more, low first"
            )


@dataclass(frozen=True)
class Drawn:
    """One truck.

    Attributes:
      factors: by quantity.
      overlay: for `TruckParameters.load(overlay=...)`.
    """

    factors: dict[str, float]
    overlay: dict[str, Any]


class Spread:
    """What is drawn from.

    Args:
      quantities: of different names.
      base: parameters that are multiplied; default: the shipped truck's.

    Raises:
      InputError: a parameter does not exist or is no number, or two quantities share one.
    """

    def __init__(
        self, quantities: tuple[Quantity, ...], base: TruckParameters | None = None
    ) -> None:
        self.quantities = quantities
        self._tree = dataclasses.asdict(base or TruckParameters.load())
        taken: set[str] = set()
        for quantity in quantities:
            for path in quantity.parameters:
                if path in taken:
                    raise InputError(f"spread of {quantity.name}: {path} is drawn already")
                taken.add(path)
        self._overlay({quantity.name: 1.0 for quantity in quantities})

    @classmethod
    def load(cls, path: str | Path | None = None, base: TruckParameters | None = None) -> Spread:
        """Reads a TOML file; default: `mjcf/spread.toml`.

        Raises:
          InputError: unreadable file, unknown key, or see `Spread`.
        """
        file = Path(path) if path is not None else mjcf_path("spread.toml")
        return cls(tuple(_quantity(name, told) for name, told in read_toml(file).items()), base)

    def draw(self, generator: np.random.Generator) -> Drawn:
        """A truck; the generator alone decides which."""
        factors = {q.name: float(generator.uniform(q.low, q.high)) for q in self.quantities}
        return Drawn(factors, self._overlay(factors))

    def nominal(self) -> Drawn:
        """The truck as it is: all factors 1."""
        factors = {quantity.name: 1.0 for quantity in self.quantities}
        return Drawn(factors, {})

    def _overlay(self, factors: Mapping[str, float]) -> dict[str, Any]:
        found: dict[str, Any] = {}
        for quantity in self.quantities:
            for path in quantity.parameters:
                _put(found, self._tree, path.split("."), factors[quantity.name], path)
        return found


def _quantity(name: str, told: Any) -> Quantity:
    if not isinstance(told, Mapping):
        raise InputError(f"spread {name!r} is no table")
    unknown, missing = set(told) - _KEYS, {"parameters", "low", "high"} - set(told)
    if unknown or missing:
        raise InputError(
            f"spread of {name}: unknown {sorted(unknown)}, missing {sorted(missing)}; allowed are "
            f"{sorted(_KEYS)}"
        )
    try:
        return Quantity(
            name,
            tuple(map(str, told["parameters"])),
            float(told["low"]),
            float(told["high"]),
            str(told.get("grade", "J")),
            str(told.get("source", "")),
        )
    except (TypeError, ValueError) as error:
        raise InputError(f"spread of {name}: {error}") from error


def _put(found: dict[str, Any], tree: Any, keys: list[str], factor: float, path: str) -> None:
    """Writes one parameter, multiplied, into an overlay."""
    first, *rest = keys
    if not isinstance(tree, Mapping) or first not in tree:
        raise InputError(f"spread of {path}: there is no such parameter")
    part = tree[first]
    if rest[:1] == ["*"] and isinstance(part, (list, tuple)):
        rows = found.setdefault(first, [{"name": row["name"]} for row in part])
        for row, original in zip(rows, part, strict=True):
            _put(row, original, rest[1:], factor, path)
    elif rest:
        _put(found.setdefault(first, {}), part, rest, factor, path)
    else:
        values = np.asarray(part)
        if values.dtype.kind not in "fi":
            raise InputError(f"spread of {path}: {part!r} is no number")
        found[first] = (values * factor).tolist()
