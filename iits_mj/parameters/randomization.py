"""Domain randomization: draws trucks from the uncertainty of the truck's parameters.

    spread = Spread.load()
    drawn = spread.draw(np.random.default_rng(1))
    truck = Truck.load(24_000.0, parameters=drawn.overlay)
    scenario = Scenario(route=road, payload=24_000.0, parameters=drawn.overlay)   # for roll_out

The uncertainties are in `mjcf/spread.toml`, or in a file of the same form.
"""

from __future__ import annotations

import dataclasses
import types
import typing
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from iits_mj.core.arrays import FloatArray
from iits_mj.core.assets import mjcf_path
from iits_mj.core.checks import is_number
from iits_mj.core.errors import InputError
from iits_mj.core.input_files import read_toml
from iits_mj.parameters.files import is_leaf, plain, read_truck
from iits_mj.parameters.quantity import quantity_of
from iits_mj.parameters.tables import Table2D
from iits_mj.parameters.truck import TruckParameters

_Keys = tuple[str, ...]  # of an entry of the truck's tree


@dataclass(frozen=True)
class Quantity:
    """An uncertain quantity.

    Attributes:
      name: of the quantity.
      parameters: that are multiplied by the same factor; `*` means every entry of a table.
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

    A parameter of a unit, axle or kind of tires that the truck lacks is left out.

    Args:
      quantities: of different names; their factors multiply the truck's parameters.
      truck: as of `TruckParameters.load`.

    Raises:
      InputError: a parameter does not exist or is not a number, or two quantities share one.
    """

    def __init__(self, quantities: tuple[Quantity, ...], truck: str | Path | None = None) -> None:
        self.quantities = quantities
        tree = read_truck(truck)
        self._nominal: dict[str, dict[_Keys, FloatArray]] = {}
        taken: set[_Keys] = set()
        for quantity in quantities:
            found: dict[_Keys, FloatArray] = {}
            for path in quantity.parameters:
                keys = tuple(path.split("."))
                values = dict(_values(tree, keys, _number_type(path), path))
                for key in {keys, *values}:
                    if key in taken:
                        raise InputError(f"spread of {quantity.name}: {path} is drawn already")
                    taken.add(key)
                found |= values
            self._nominal[quantity.name] = found

    @classmethod
    def load(cls, path: str | Path | None = None, truck: str | Path | None = None) -> Spread:
        """Reads a TOML file; default: `mjcf/spread.toml`; truck: as of `TruckParameters.load`.

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
        for name, nominal in self._nominal.items():
            for (*tables, last), values in nominal.items():
                table = overlay
                for key in tables:
                    table = table.setdefault(key, {})
                table[last] = (values * factors[name]).tolist()
        return overlay


def _number_type(path: str) -> Any:
    """Returns the annotated type of the number at a path of any truck's parameters.

    Raises:
      InputError: there is no such parameter, or it is not a number.
    """
    kind: Any = TruckParameters
    for key in path.split("."):
        origin, inside = typing.get_origin(kind), typing.get_args(kind)
        if origin in (types.UnionType, typing.Union):
            kind = inside[0]
        if dataclasses.is_dataclass(kind) and kind is not Table2D:
            entries = typing.get_type_hints(kind, include_extras=True)
        elif origin is dict:
            entries = {key: inside[1]}
        elif origin is tuple and dataclasses.is_dataclass(inside[0]):
            entries = {key: inside[0]}
        else:
            entries = {}
        if key not in entries:
            raise InputError(
                f"spread of {path}: there is no such parameter: {key!r} is not one of "
                f"{list(entries)}"
            )
        kind = entries[key]
    item = typing.get_args(kind)[0] if typing.get_origin(kind) is tuple else kind
    plain_type = typing.get_args(item)[0] if hasattr(item, "__metadata__") else item
    if plain_type not in (int, float) and typing.get_origin(item) is not np.ndarray:
        raise InputError(f"spread of {path}: the parameter is not a number")
    return item


def _values(
    node: Any, keys: _Keys, kind: Any, path: str, before: _Keys = ()
) -> Iterator[tuple[_Keys, FloatArray]]:
    """Yields keys and SI values of the numbers at a path of a tree; `*` is any key."""
    if not keys:
        unit = node.get("unit") if is_leaf(node) else None
        factor = quantity_of(kind).factor(unit, path) if unit else 1.0
        yield before, np.asarray(plain(node)) * factor
    elif isinstance(node, Mapping):
        first, *rest = keys
        for key in node if first == "*" else [first] if first in node else []:
            yield from _values(node[key], tuple(rest), kind, path, (*before, key))
