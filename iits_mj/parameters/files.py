"""Reads the truck's files: TOML with provenance and CSV tables, into checked dataclasses.

Errors name the file or parameter, its value and the allowed values.
"""

from __future__ import annotations

import dataclasses
import typing
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from iits_mj.core.arrays import FloatArray
from iits_mj.core.assets import mjcf_dir
from iits_mj.core.checks import is_number, shown
from iits_mj.core.errors import InputError
from iits_mj.core.input_files import read_toml
from iits_mj.core.tables import read_table
from iits_mj.core.units import KMH, RPM

MAGNITUDE_MAX = 1e9  # of a parameter in SI units; the greatest are stiffnesses


@dataclass(frozen=True)
class Table2D:
    """A map: `rows` (n,), `columns` (m,), `values` (n, m), in SI units."""

    rows: FloatArray
    columns: FloatArray
    values: FloatArray


def provenance() -> list[tuple[str, str, str, str, str]]:
    """Returns (name, value, unit, grade, source) of every quantity of the shipped truck's TOML."""
    return list(_provenance_rows(read_toml(mjcf_dir() / "truck.toml", "parameter file"), ""))


def _provenance_rows(node: Any, prefix: str) -> Iterator[tuple[str, str, str, str, str]]:
    if isinstance(node, Mapping) and "value" in node:
        yield (prefix, str(node["value"]), node["unit"], node["grade"], node["source"])
    elif isinstance(node, Mapping):
        for key, child in node.items():
            yield from _provenance_rows(child, f"{prefix}.{key}" if prefix else key)
    elif isinstance(node, list):
        for child in node:
            yield from _provenance_rows(child, f"{prefix}[{child['name']}]")


def plain(node: Any) -> Any:
    """Returns the tree with every `{ value, unit, grade, source }` replaced by its value."""
    if isinstance(node, Mapping):
        if "value" in node:
            return node["value"]
        return {key: plain(child) for key, child in node.items()}
    if isinstance(node, list):
        return [plain(child) for child in node]
    return node


def merge(base: Any, extra: Mapping[str, Any], where: str) -> dict[str, Any]:
    """Returns `base` overlaid with the values of `extra`; axles are matched by name."""
    merged = dict(base)
    for key, value in extra.items():
        name = f"{where}{key}"
        if isinstance(value, Mapping) and isinstance(base.get(key), Mapping):
            merged[key] = merge(base[key], value, f"{name}.")
        elif isinstance(value, list) and value and isinstance(value[0], Mapping):
            merged[key] = _merge_named(base.get(key, []), value, name)
        else:
            merged[key] = value
    return merged


def _merge_named(base: list[Any], extra: list[Any], where: str) -> list[Any]:
    """Merges a list of tables by their `name`: an overlay may change one axle of three."""
    rows = {row["name"]: row for row in base}
    for row in extra:
        name = row.get("name")
        if name not in rows:
            raise InputError(f"parameter {where}: no entry named {name!r}; there are {list(rows)}")
        rows[name] = merge(rows[name], row, f"{where}[{name}].")
    return list(rows.values())


def section(tree: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    """Returns a table of the tree; raises InputError if it is missing."""
    found = tree.get(name)
    if not isinstance(found, Mapping):
        raise InputError(f"the truck's parameters lack the section [{name}]")
    return found


def build(kind: Any, node: Any, where: str) -> Any:
    """Builds `kind` (a dataclass, tuple, dict or number type) from a plain tree, with checks."""
    origin = typing.get_origin(kind)
    if dataclasses.is_dataclass(kind):
        return _build_dataclass(kind, node, where)
    if origin is tuple:
        item = typing.get_args(kind)[0]
        if not isinstance(node, (list, tuple)):
            raise InputError(f"parameter {where} = {node!r}: a list is needed")
        return tuple(build(item, child, f"{where}[{i}]") for i, child in enumerate(node))
    if origin is dict:
        item = typing.get_args(kind)[1]
        return {key: build(item, child, f"{where}.{key}") for key, child in node.items()}
    if origin is np.ndarray:
        return _array(node, where)
    return _number(kind, node, where) if kind in (int, float) else node


def _build_dataclass(kind: Any, node: Any, where: str) -> Any:
    if dataclasses.is_dataclass(node):
        return node
    if not isinstance(node, Mapping):
        raise InputError(f"parameter {where} = {node!r}: a table is needed")
    hints = typing.get_type_hints(kind)
    names = [f.name for f in dataclasses.fields(kind)]
    unknown = sorted(set(node) - set(names))
    if unknown:
        raise InputError(f"parameter {where}.{unknown[0]} is unknown; allowed are: {names}")
    missing = [name for name in names if name not in node]
    if missing:
        raise InputError(f"parameter {where}.{missing[0]} is missing")
    return kind(**{name: build(hints[name], node[name], f"{where}.{name}") for name in names})


def _number(kind: type, node: Any, where: str) -> int | float:
    if not is_number(node):
        raise InputError(f"parameter {where} = {shown(node)}: a finite number is needed")
    if abs(node) > MAGNITUDE_MAX:
        raise InputError(f"parameter {where} = {shown(node)}: more than {MAGNITUDE_MAX:g}")
    if kind is int and node != int(node):
        raise InputError(f"parameter {where} = {node!r}: a whole number is needed")
    return kind(node)


def _array(node: Any, where: str) -> FloatArray:
    """Returns a table's numbers, which an overlay may give as lists."""
    try:
        values = np.asarray(node, dtype=float)
    except (TypeError, ValueError):
        raise InputError(f"parameter {where} = {node!r}: a table of numbers is needed") from None
    if not values.size or not (np.abs(values) <= MAGNITUDE_MAX).all():
        raise InputError(f"parameter {where}: a table of numbers up to {MAGNITUDE_MAX:g} is needed")
    return values


def _read_csv(path: Path) -> tuple[list[str], FloatArray]:
    """Returns header and numbers of a CSV table."""
    header, rows = read_table(path, "table")
    try:
        values = np.array([[float(cell) for cell in row] for row in rows])
    except ValueError as error:
        raise InputError(f"table {str(path)!r} cannot be read: {error}") from error
    if values.ndim != 2 or values.shape[1] != len(header) or not np.isfinite(values).all():
        raise InputError(f"table {str(path)!r}: every row must have {len(header)} finite numbers")
    return header, values


def _table(path: Path, row_unit: float, column_unit: float, value_unit: float) -> Table2D:
    header, values = _read_csv(path)
    columns = np.array([float(cell) for cell in header[1:]]) * column_unit
    return Table2D(values[:, 0] * row_unit, columns, values[:, 1:] * value_unit)


def csv_tables(folder: Path) -> dict[str, dict[str, Any]]:
    """Returns the CSV tables of a truck in SI units, by section and field of `TruckParameters`."""
    _, full = _read_csv(folder / "engine_full_load.csv")
    _, gears = _read_csv(folder / "gearbox.csv")
    forward = gears[gears[:, 0] >= 1]
    header, pressures = _read_csv(folder / "air_brake_pressure_demand.csv")
    pressures = pressures[::-1]

    def circuits(mass: str) -> FloatArray:
        """Pressures of the front, drive and trailer circuit [Pa], shape (n, 3)."""
        names = ("front_wheel_cmd_{}(x0.3)", "rear_wheel_cmd_{}(x0.7)", "trailer_cmd_{}(rear x1.1)")
        return pressures[:, [header.index(name.format(mass)) for name in names]] * 1e3

    return {
        "engine": {
            "full_load_speed": full[:, 0] * RPM,
            "full_load_torque": full[:, 1],
            "pedal_map": _table(folder / "engine_pedal_map.csv", RPM, 0.01, 1.0),
            "fuel_map": _table(folder / "engine_fuel_map.csv", 1.0, RPM, 1e-3 / 3.6e6),
        },
        "gearbox": {
            "ratios": forward[:, 1],
            "inertias": forward[:, 2],
            "upshift": _table(folder / "gearbox_upshift.csv", 1.0, 1.0, KMH),
            "downshift": _table(folder / "gearbox_downshift.csv", 1.0, 1.0, KMH),
        },
        "air_brake": {
            "demand": -pressures[:, 0],
            "pressure_light": circuits("18t"),
            "pressure_heavy": circuits("50t"),
        },
    }
