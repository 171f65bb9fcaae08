"""Domain randomization: draws trucks from the uncertainty of the truck's parameters.

    spread = Spread.load()
    drawn = spread.draw(np.random.default_rng(1))
    truck = Truck.load(24_000.0, parameters=drawn.overlay)
    scenario = Scenario(route=road, payload=24_000.0, parameters=drawn.overlay)   # for roll_out

The uncertainties are in `mjcf/spread.toml`, or in a file of the same form.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from iits_mj.core.assets import mjcf_path
from iits_mj.core.checks import is_number
from iits_mj.core.errors import InputError
from iits_mj.core.input_files import read_toml
from iits_mj.parameters.truck import TruckParameters


@dataclass(frozen=True)
class Quantity:
    """An uncertain quantity.

    Attributes:
      name: of the quantity.
      parameters: that are multiplied by the same factor; `*` means every axle.
      low, high: bounds of the factor, which is distributed uniformly.
      grade, source: as in the truck's TOML.
    """

    name: str
    parameters: tuple[str, ...]
    low: float
    high: float
    grade: str = "J"
    source: str = ""

    def __post_init__(self) -> None:
        if not self.parameters:
            raise InputError(f"spread of {self.name}: at least one parameter is needed")
        if not (is_number(self.low) and is_number(self.high) and 0.0 <= self.low <= self.high):
            raise InputError(
                f"spread of {self.name}: factors {self.low!r} to {self.high!r} are not allowed; "
                "use finite ones, 0 or more, low first"
            )

    @classmethod
    def from_table(cls, name: str, table: Any) -> Quantity:
        """Reads a quantity from its TOML table.

        Raises:
          InputError: it is not a table, or a key or value is wrong.
        """
        if not isinstance(table, Mapping):
            raise InputError(f"spread {name!r} is not a table")
        allowed = {field.name for field in dataclasses.fields(cls)} - {"name"}
        unknown, missing = set(table) - allowed, {"parameters", "low", "high"} - set(table)
        if unknown or missing:
            raise InputError(
                f"spread of {name}: unknown {sorted(unknown)}, missing {sorted(missing)}; allowed "
                f"are {sorted(allowed)}"
            )
        try:
            return cls(name, **{**table, "parameters": tuple(map(str, table["parameters"]))})
        except TypeError as error:
            raise InputError(f"spread of {name}: {error}") from error


@dataclass(frozen=True)
class Drawn:
    """A randomly drawn truck.

    Attributes:
      factors: by quantity.
      overlay: for `TruckParameters.load(overlay=...)`.
    """

    factors: dict[str, float]
    overlay: dict[str, Any]


class Spread:
    """The uncertain quantities of a truck.

    Args:
      quantities: of different names; their factors multiply the shipped truck's parameters.

    Raises:
      InputError: a parameter does not exist or is not a number, or two quantities share one.
    """

    def __init__(self, quantities: tuple[Quantity, ...]) -> None:
        self.quantities = quantities
        self._tree = dataclasses.asdict(TruckParameters.load())
        taken: set[str] = set()
        for quantity in quantities:
            for path in quantity.parameters:
                if path in taken:
                    raise InputError(f"spread of {quantity.name}: {path} is drawn already")
                taken.add(path)
        self._overlay({quantity.name: 1.0 for quantity in quantities})

    @classmethod
    def load(cls, path: str | Path | None = None) -> Spread:
        """Reads a TOML file; default: `mjcf/spread.toml`.

        Raises:
          InputError: unreadable file, unknown key, or see `Spread`.
        """
        tables = read_toml(mjcf_path("spread.toml") if path is None else path, "spread file")
        return cls(tuple(Quantity.from_table(*entry) for entry in tables.items()))

    def draw(self, generator: np.random.Generator) -> Drawn:
        """Draws a truck at random."""
        factors = {q.name: float(generator.uniform(q.low, q.high)) for q in self.quantities}
        return Drawn(factors, self._overlay(factors))

    def nominal(self) -> Drawn:
        """Returns the truck with all factors 1."""
        return Drawn({quantity.name: 1.0 for quantity in self.quantities}, {})

    def _overlay(self, factors: Mapping[str, float]) -> dict[str, Any]:
        overlay: dict[str, Any] = {}
        for quantity in self.quantities:
            for path in quantity.parameters:
                _multiply(overlay, self._tree, path.split("."), factors[quantity.name], path)
        return overlay


def _multiply(
    overlay: dict[str, Any], tree: Any, keys: list[str], factor: float, path: str
) -> None:
    """Writes the parameter at `keys` of a tree, multiplied, into an overlay."""
    first, *rest = keys
    if not isinstance(tree, Mapping) or first not in tree:
        raise InputError(f"spread of {path}: there is no such parameter")
    part = tree[first]
    if rest[:1] == ["*"] and isinstance(part, (list, tuple)):
        rows = overlay.setdefault(first, [{"name": row["name"]} for row in part])
        for row, original in zip(rows, part, strict=True):
            _multiply(row, original, rest[1:], factor, path)
    elif rest:
        _multiply(overlay.setdefault(first, {}), part, rest, factor, path)
    else:
        values = np.asarray(part)
        if values.dtype.kind not in "fi":
            raise InputError(f"spread of {path}: {part!r} is not a number")
        overlay[first] = (values * factor).tolist()
