"""Domain randomization: draws trucks from the uncertainty of the truck's parameters.

    spread = Spread.load()
    drawn = spread.draw(np.random.default_rng(1))
    truck = Truck.load(24_000.0, parameters=drawn.overlay)
    scenario = Scenario(route=road, payload=24_000.0, parameters=drawn.overlay)   # for roll_out

The uncertainties are in `mjcf/spread.toml`, or in a file of the same form.
"""

from __future__ import annotations

import dataclasses
import fnmatch
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from iits_mj.core.assets import mjcf_path
from iits_mj.core.checks import is_number
from iits_mj.core.errors import InputError
from iits_mj.core.input_files import read_toml
from iits_mj.parameters.truck import AnyTruck, TruckParameters


@dataclass(frozen=True)
class Quantity:
    """An uncertain quantity.

    Attributes:
      name: of the quantity.
      parameters: that are multiplied by the same factor; `*` stands for any part of a name.
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
      quantities: of different names; their factors multiply the truck's parameters. Those that it
        lacks, but the shipped truck has, such as a trailer's, change nothing.
      truck: see `TruckParameters.load`.

    Raises:
      InputError: a parameter does not exist or is not a number, or two quantities share one.
    """

    def __init__(self, quantities: tuple[Quantity, ...], truck: AnyTruck | None = None) -> None:
        self.quantities = quantities
        self._tree = _tree_of(TruckParameters.load(truck))
        shipped = self._tree if truck is None else _tree_of(TruckParameters.load())
        # Places of each quantity's parameters in the tree.
        self._places: dict[str, list[tuple[str, ...]]] = {}
        taken: set[tuple[str, ...]] = set()
        for quantity in quantities:
            places = self._places[quantity.name] = []
            for path in quantity.parameters:
                keys = path.split(".")
                found = list(_matches(self._tree, keys))
                if not found and not list(_matches(shipped, keys)):
                    raise InputError(f"spread of {path}: there is no such parameter")
                if taken.intersection(found):
                    raise InputError(f"spread of {quantity.name}: {path} is drawn already")
                taken.update(found)
                places.extend(found)
        self._overlay({quantity.name: 1.0 for quantity in quantities})

    @classmethod
    def load(cls, path: str | Path | None = None, truck: AnyTruck | None = None) -> Spread:
        """Reads a TOML file; default: `mjcf/spread.toml`.

        Raises:
          InputError: unreadable file, unknown key, or see `Spread`.
        """
        tables = read_toml(mjcf_path("spread.toml") if path is None else path, "spread file")
        return cls(tuple(Quantity.from_table(*entry) for entry in tables.items()), truck)

    def draw(self, generator: np.random.Generator) -> Drawn:
        """Draws a truck at random."""
        factors = {q.name: float(generator.uniform(q.low, q.high)) for q in self.quantities}
        return Drawn(factors, self._overlay(factors))

    def nominal(self) -> Drawn:
        """Returns the truck with all factors 1."""
        return Drawn({quantity.name: 1.0 for quantity in self.quantities}, {})

    def _overlay(self, factors: Mapping[str, float]) -> dict[str, Any]:
        overlay: dict[str, Any] = {}
        for name, places in self._places.items():
            for *tables, last in places:
                part, tree = overlay, self._tree
                for key in tables:
                    part, tree = part.setdefault(key, {}), tree[key]
                values = np.asarray(tree[last])
                if values.dtype.kind not in "fi":
                    raise InputError(f"spread of {name}: {tree[last]!r} is not a number")
                part[last] = (values * factors[name]).tolist()
        return overlay


def _tree_of(parameters: TruckParameters) -> dict[str, Any]:
    """Returns a truck's parameters as the tables of its file."""
    tree = dataclasses.asdict(parameters)
    tree["units"] = {unit["name"]: unit for unit in tree["units"]}
    for name, unit in tree["units"].items():
        unit["axles"] = {axle["name"].removeprefix(f"{name}_"): axle for axle in unit["axles"]}
    return tree


def _matches(tree: Any, keys: list[str]) -> Iterator[tuple[str, ...]]:
    """Yields the places in a tree that keys with wildcards name."""
    first, *rest = keys
    if not isinstance(tree, Mapping):
        return
    for name in fnmatch.filter(tree, first):
        if rest:
            yield from ((name, *place) for place in _matches(tree[name], rest))
        elif tree[name] is not None:
            yield (name,)
