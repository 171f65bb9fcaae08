"""Reads a truck's files: TOML with provenance into a tree, and the tree into checked dataclasses.

A truck may extend another one, `extends = "name or path"`, leave parts of it out, `remove =
["units.trailer"]`, and copy a sibling table, `like = "axle1"`. In an overlay `*` stands for every
entry of a table. Errors name the parameter, its value and what is allowed.
"""

from __future__ import annotations

import copy
import dataclasses
import functools
import types
import typing
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeGuard

import numpy as np

from iits_mj.core.arrays import FloatArray
from iits_mj.core.assets import DEFAULT_TRUCK, mjcf_dir
from iits_mj.core.checks import did_you_mean, is_number, shown
from iits_mj.core.errors import InputError
from iits_mj.core.input_files import read_toml
from iits_mj.parameters.powertrain import EXTENSIVE, EXTENSIVE_TABLES
from iits_mj.parameters.quantity import Quantity, Watts, quantity_of
from iits_mj.parameters.tables import REPLACED, TABLES, Table2D, read_tables

MAGNITUDE_MAX = 1e9  # of a parameter in SI units; the greatest are stiffnesses
TRUCK_FILE = "truck.toml"
_EXTENDS_MAX = 8  # files in a chain
_PROVENANCE = ("value", "unit", "grade", "source")
GRADES = "PRDLJ"

Tree = dict[str, Any]
Overlay = str | Path | Mapping[str, Any]
# Path, time of the last change [ns] and size of files.
Stamps = tuple[tuple[str, int, int], ...]


def shipped_trucks() -> tuple[str, ...]:
    """Returns the names of the trucks in `mjcf/trucks`, the default one first."""
    found = sorted(path.parent.name for path in (mjcf_dir() / "trucks").glob(f"*/{TRUCK_FILE}"))
    return (DEFAULT_TRUCK, *(name for name in found if name != DEFAULT_TRUCK))


def truck_file(truck: str | Path | None, base: Path | None = None) -> Path:
    """Returns the file of a truck.

    Args:
      truck: name of a shipped truck, a file, or a folder with a `truck.toml`; None: the default.
      base: folder of relative paths; default: the working directory.

    Raises:
      InputError: there is no such truck; names those that are shipped.
    """
    name = DEFAULT_TRUCK if truck is None else str(truck)
    shipped = mjcf_dir() / "trucks" / name / TRUCK_FILE
    if Path(name).name == name and shipped.is_file():
        return shipped
    path = (base or Path()) / name
    try:
        if path.is_dir():
            path = path / TRUCK_FILE
        if path.is_file():
            return path
    except (OSError, ValueError):  # a name too long, or with a null character
        pass
    raise InputError(
        f"truck {shown(name)} is neither a file or folder nor one of the shipped trucks"
        f"{did_you_mean(name, shipped_trucks())}: {', '.join(shipped_trucks())}"
    )


def read_truck(truck: str | Path | None = None, overlays: Sequence[Overlay] = ()) -> Tree:
    """Returns a truck's merged tree with its tables in SI units; see `TruckParameters.load`.

    Leaves are plain values or `{ value, unit, grade, source }`.

    Raises:
      InputError: a file cannot be read, or a key, path or reference does not exist.
    """
    file = truck_file(truck)
    tree = _read_file(file, ())
    for overlay in overlays:
        if isinstance(overlay, Mapping):
            extra, folder = dict(overlay), Path()
        else:
            extra, folder = read_toml(overlay, "parameter file"), Path(overlay).parent
        tree = _changed(tree, extra, folder)
    tree["name"] = file.resolve().parent.name if file.name == TRUCK_FILE else file.stem
    tree["units"] = _towing_order(_table(tree, "units"))
    return tree


def provenance(truck: str | Path | None = None) -> list[tuple[str, str, str, str, str]]:
    """Returns (name, value, unit, grade, source) of every quantity of a truck's TOML files."""
    return list(_provenance_rows(_read_file(truck_file(truck), ()), ""))


def _provenance_rows(node: Any, prefix: str) -> Iterator[tuple[str, str, str, str, str]]:
    if is_leaf(node):
        rest = (str(node.get(key, "")) for key in _PROVENANCE[1:])
        yield (prefix, str(node["value"]), *rest)  # type: ignore[misc]
    elif is_number(node):
        yield (prefix, str(node), "", "", "")
    elif isinstance(node, Mapping):
        for key, child in node.items():
            yield from _provenance_rows(child, f"{prefix}.{key}" if prefix else key)


def is_leaf(node: Any) -> bool:
    """Returns whether a node of the tree is a value with its provenance."""
    return isinstance(node, Mapping) and "value" in node


def plain(node: Any) -> Any:
    """Returns a leaf's value, whatever its unit; any other node unchanged."""
    return node["value"] if is_leaf(node) else node


def shipped_state(truck: str | Path | None) -> tuple[Path, Stamps] | None:
    """Returns the file of a shipped truck and the state of all shipped files; else None.

    While both stay the same, what was read of the truck holds.
    """
    file = truck_file(truck).resolve()
    folder = (mjcf_dir() / "trucks").resolve()
    if not file.is_relative_to(folder):
        return None
    states = ((path, path.stat()) for path in sorted(folder.glob("*/*")))
    return file, tuple((str(path), state.st_mtime_ns, state.st_size) for path, state in states)


def _read_file(file: Path, chain: tuple[Path, ...]) -> Tree:
    """Returns the tree of a file, merged with what it extends."""
    shipped = shipped_state(file)
    return copy.deepcopy(_shipped_tree(*shipped, chain)) if shipped else _merged_file(file, chain)


@functools.lru_cache(maxsize=32)
def _shipped_tree(file: Path, _stamps: Stamps, chain: tuple[Path, ...]) -> Tree:
    return _merged_file(file, chain)


def _merged_file(file: Path, chain: tuple[Path, ...]) -> Tree:
    file = file.resolve()
    if file in chain or len(chain) >= _EXTENDS_MAX:
        names = " -> ".join(str(path) for path in (*chain, file))
        raise InputError(f"truck files extend each other without end: {names}")
    tree = read_toml(file, "truck file")
    base = tree.pop("extends", None)
    if base is None:
        return _changed({}, tree, file.parent)
    if not isinstance(base, str):
        raise InputError(f"truck file {str(file)!r}: extends = {base!r}: a name or path is needed")
    return _changed(_read_file(truck_file(base, file.parent), (*chain, file)), tree, file.parent)


def _changed(base: Tree, extra: Tree, folder: Path) -> Tree:
    """Returns `base` without what `extra` removes, overlaid with its values and tables.

    Args:
      base: a truck's tree.
      extra: the content of a file, without `extends`.
      folder: of the CSV tables of `extra`.
    """
    extra = dict(extra)
    removed = extra.pop("remove", [])
    if not isinstance(removed, list):
        raise InputError(f"remove = {removed!r}: a list of parameters is needed")
    for name in removed:
        base = _without(base, str(name).split("."), str(name))
    for (section, key), others in REPLACED.items():
        given, old = extra.get(section), base.get(section)
        if _is_table(given) and key in given and _is_table(old):
            kept = {name: value for name, value in old.items() if name not in others}
            base = {**base, section: kept}
    merged = _copied(merge(base, read_tables(extra, folder), ""), "")
    engine = merged.get("engine")
    if _is_table(engine) and "power" in engine:
        merged["engine"] = _of_power(engine)
    return merged


def _of_power(engine: Mapping[str, Any]) -> Tree:
    """Returns the section of an engine with the full-load curve scaled to its `power`.

    The displacement is in proportion, and with it all torques, the inertia and the fuel.
    """
    found = dict(engine)
    power = build(Watts, found.pop("power"), "engine.power")
    names = [name for name in ("full_load_speed", "full_load_torque") if name in found]
    curve = [_array(plain(found[name]), f"engine.{name}") for name in names]
    whole = len(curve) == 2 and curve[0].shape == curve[1].shape
    given = float((curve[0] * curve[1]).max()) if whole else 0.0
    if not 0.2 * given <= power <= 5.0 * given or power <= 0.0:
        raise InputError(
            f"parameter engine.power = {power:g} W: allowed is a fifth to five times the "
            f"{given:g} W of the full-load curve"
        )

    def scaled(node: Any) -> Any:
        if is_leaf(node):
            return {**node, "value": scaled(node["value"])}
        if isinstance(node, (list, tuple)):
            return [scaled(item) for item in node]
        # `build` refuses anything else.
        return node * (power / given) if is_number(node) or isinstance(node, np.ndarray) else node

    found |= {name: scaled(found[name]) for name in EXTENSIVE if name in found}
    for name, parts in EXTENSIVE_TABLES.items():
        if name in found:
            table = build(Table2D, found[name], f"engine.{name}")
            changed = {part: power / given * getattr(table, part) for part in parts}
            found[name] = dataclasses.replace(table, **changed)
    return found


def _without(tree: Tree, keys: list[str], name: str) -> Tree:
    """Returns a tree without the entry at a path of keys; `*` removes from every table."""
    first, *rest = keys
    if not isinstance(tree, Mapping) or (first != "*" and first not in tree):
        there = list(tree) if isinstance(tree, Mapping) else "no table"
        raise InputError(f"remove {name!r}: there is no {first!r}; there is {there}")
    if not rest:
        return {key: child for key, child in tree.items() if first not in (key, "*")}
    chosen = list(tree) if first == "*" else [first]
    return {
        key: _without(child, rest, name) if key in chosen else child for key, child in tree.items()
    }


def merge(base: Mapping[str, Any], extra: Mapping[str, Any], where: str) -> Tree:
    """Returns `base` overlaid with the values of `extra`, whose key `*` means every table."""
    merged = dict(base)
    for key, value in extra.items():
        tables = [name for name, child in merged.items() if _is_table(child)]
        if key == "*" and not tables:
            raise InputError(f"parameter {where}*: there is no table at this place")
        for name in tables if key == "*" else [key]:
            old = merged.get(name)
            if _is_table(value):
                merged[name] = merge(old if _is_table(old) else {}, value, f"{where}{name}.")
            else:
                merged[name] = value
    return merged


def _is_table(node: Any) -> TypeGuard[Mapping[str, Any]]:
    return isinstance(node, Mapping) and not is_leaf(node)


def _copied(tree: Tree, where: str) -> Tree:
    """Returns a tree in which tables with `like` have their sibling's values as well."""
    found: Tree = {}
    for key, child in tree.items():
        if not _is_table(child):
            found[key] = child
            continue
        child = dict(child)
        sibling = child.pop("like", None)
        if sibling is not None:
            if (
                not isinstance(sibling, str)
                or sibling not in found
                or not _is_table(found[sibling])
            ):
                raise InputError(
                    f"parameter {where}{key}.like = {sibling!r}: name a table before it, one of "
                    f"{[name for name in found if _is_table(found[name])]}"
                )
            child = merge(found[sibling], child, f"{where}{key}.")
        found[key] = _copied(child, f"{where}{key}.")
    return found


def _table(tree: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    found = tree.get(name)
    if not _is_table(found):
        raise InputError(f"the truck's parameters lack the section [{name}]")
    return found


def _towing_order(units: Mapping[str, Any]) -> Tree:
    """Returns the units front to rear, their axles too.

    A unit follows the one before it in the file, or the one that it names as `behind`.
    """
    ahead: dict[str | None, str] = {}
    previous: str | None = None
    found: Tree = {}
    for name, unit in units.items():
        if not _is_table(unit):
            raise InputError(f"parameter units.{name} = {shown(unit)}: a table is needed")
        unit = dict(unit)
        leads = "coupling" not in unit
        front = None if leads else unit.pop("behind", previous)
        if front in ahead or (front is not None and front not in units):
            others = [other for other in units if other != name]
            raise InputError(
                f"parameter units.{name}.behind = {front!r}: name a unit that tows no other one, "
                f"of {others}"
            )
        ahead[front] = name
        if _is_table(unit.get("axles")):
            unit["axles"] = dict(sorted(unit["axles"].items(), key=_position))
        found[name] = unit
        previous = name
    order, at = [], ahead.get(None)
    while at is not None and at not in order:
        order.append(at)
        at = ahead.get(at)
    if len(order) != len(found):
        lost = sorted(set(found) - set(order))
        raise InputError(f"units {lost} are not coupled to the motor vehicle's chain {order}")
    return {name: found[name] for name in order}


def _position(item: tuple[str, Any]) -> float:
    """Position of an axle's table; zero if it is not a number, which `build` refuses later."""
    value = plain(item[1].get("position")) if isinstance(item[1], Mapping) else None
    return float(value) if isinstance(value, (int, float)) else 0.0


def build(kind: Any, node: Any, where: str) -> Any:
    """Builds `kind` (a dataclass, tuple, dict, number or word) from a tree, with checks.

    Args:
      kind: type of the parameter, annotated with its `Quantity` if it has a unit.
      node: plain values, leaves with provenance, or tables.
      where: name of the parameter.

    Raises:
      InputError: names the parameter that is unknown, missing or not allowed.
    """
    quantity = quantity_of(kind)
    if hasattr(kind, "__metadata__"):
        kind = typing.get_args(kind)[0]
    origin = typing.get_origin(kind)
    if origin in (types.UnionType, typing.Union):
        if node is None:
            return None
        return build(typing.get_args(kind)[0], node, where)
    if dataclasses.is_dataclass(kind):
        return _build_dataclass(kind, node, where)
    if origin is tuple:
        return _build_tuple(typing.get_args(kind)[0], node, where)
    if origin is dict:
        item = typing.get_args(kind)[1]
        if not _is_table(node):
            raise InputError(f"parameter {where} = {shown(node)}: a table is needed")
        return {key: build(item, child, f"{where}.{key}") for key, child in node.items()}
    value, factor = _leaf(node, quantity, where)
    if origin is np.ndarray:
        return _array(value, where)
    if kind in (int, float):
        number = _number(kind, value, where)
        return quantity.check(kind(number * factor) if factor != 1.0 else number, where)
    if not isinstance(value, kind):
        what = "true or false" if kind is bool else "a word"
        raise InputError(f"parameter {where} = {shown(value)}: {what} is needed")
    return value


def _build_tuple(item: Any, node: Any, where: str) -> tuple[Any, ...]:
    """Builds a list of numbers with one unit, or of tables by name."""
    if _is_table(node):
        # Axles have their unit's name in the model, "trailer_axle1".
        prefix = f"{where.split('.')[-2]}_" if "." in where else ""
        named = ((key, child) for key, child in node.items())
        return tuple(
            build(
                item, {"name": prefix + key, **_fields(child, f"{where}.{key}")}, f"{where}.{key}"
            )
            for key, child in named
        )
    values, factor = _leaf(node, quantity_of(item), where)
    if not isinstance(values, (list, tuple)):
        raise InputError(f"parameter {where} = {shown(values)}: a list is needed")
    if factor != 1.0 and all(map(is_number, values)):
        values = [factor * value for value in values]
    return tuple(build(item, child, f"{where}[{i}]") for i, child in enumerate(values))


def _fields(node: Any, where: str) -> Mapping[str, Any]:
    if not _is_table(node):
        raise InputError(f"parameter {where} = {shown(node)}: a table is needed")
    return node


def _leaf(node: Any, quantity: Quantity, where: str) -> tuple[Any, float]:
    """Returns a leaf's value and what one of its unit is in the parameter's unit."""
    if not is_leaf(node):
        return node, 1.0
    unknown = sorted(set(node) - set(_PROVENANCE))
    if unknown:
        raise InputError(f"parameter {where}: {unknown[0]!r} is unknown; use {list(_PROVENANCE)}")
    unit = node.get("unit", quantity.unit)
    if not isinstance(unit, str):
        raise InputError(f"parameter {where}: unit {shown(unit)} is not text")
    return node["value"], quantity.factor(unit, where)


def _build_dataclass(kind: Any, node: Any, where: str) -> Any:
    if dataclasses.is_dataclass(node):
        return node
    if not _is_table(node):
        raise InputError(f"parameter {where} = {shown(node)}: a table is needed")
    hints = _hints(kind)
    fields = dataclasses.fields(kind)
    prefix = f"{where}." if where else ""
    names = [field.name for field in fields]
    unknown = sorted(set(node) - set(names))
    if unknown:
        read = [key for section, key in TABLES if section == where and key not in names]
        read += ["power"] if where == "engine" else []
        allowed = [name for name in (*names, *read) if name != "name"]
        raise InputError(
            f"parameter {prefix}{unknown[0]} is unknown{did_you_mean(unknown[0], allowed)}; "
            f"allowed are: {allowed}"
        )
    for field in fields:
        optional = (field.default, field.default_factory) != (dataclasses.MISSING,) * 2
        if field.name not in node and not optional:
            raise InputError(f"parameter {prefix}{field.name} is missing")
    return kind(**{name: build(hints[name], node[name], prefix + name) for name in node})


@functools.cache
def _hints(kind: Any) -> dict[str, Any]:
    return typing.get_type_hints(kind, include_extras=True)


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
        raise InputError(f"parameter {where} = {shown(node)}: numbers are needed") from None
    if not values.size or not (np.abs(values) <= MAGNITUDE_MAX).all():
        raise InputError(f"parameter {where}: a table of numbers up to {MAGNITUDE_MAX:g} is needed")
    return values


def ungraded(truck: str | Path | None) -> Sequence[str]:
    """Returns the quantities of a truck that lack a unit or a grade of `GRADES`."""
    return [
        name
        for name, _, unit, grade, _ in provenance(truck)
        if not (unit and grade in tuple(GRADES))
    ]
