"""Reads a truck's CSV tables: engine maps, gears with their losses, shift speeds, brake pressures.

Lines that begin with `#` say where the figures come from. A header names the columns; the units are
those that spec sheets have, and the dataclasses hold SI.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from iits_mj.core.arrays import FloatArray
from iits_mj.core.errors import InputError
from iits_mj.core.tables import read_table
from iits_mj.core.units import KMH, RPM

_PERCENT, _GRAMS_PER_KWH, _GRAMS_PER_HOUR = 0.01, 1e-3 / 3.6e6, 1e-3 / 3600.0


@dataclass(frozen=True)
class Table2D:
    """A map: `rows` (n,), `columns` (m,), `values` (n, m), in SI units."""

    rows: FloatArray
    columns: FloatArray
    values: FloatArray

    def at(self, row: ArrayLike, column: ArrayLike) -> FloatArray:
        """Returns the values at places of one shape, bilinear, constant beyond the edges."""
        rows, columns = self.rows, self.columns
        return self.extrapolated(
            np.clip(row, rows[0], rows[-1]), np.clip(column, columns[0], columns[-1])
        )

    def extrapolated(self, row: ArrayLike, column: ArrayLike) -> FloatArray:
        """The same with straight lines beyond the edges."""
        x, y, table = np.asarray(row), np.asarray(column), self.values
        i = np.clip(np.searchsorted(self.rows, x) - 1, 0, self.rows.size - 2)
        j = np.clip(np.searchsorted(self.columns, y) - 1, 0, self.columns.size - 2)
        p = (x - self.rows[i]) / (self.rows[i + 1] - self.rows[i])
        q = (y - self.columns[j]) / (self.columns[j + 1] - self.columns[j])
        low = (1.0 - q) * table[i, j] + q * table[i, j + 1]
        high = (1.0 - q) * table[i + 1, j] + q * table[i + 1, j + 1]
        return np.asarray((1.0 - p) * low + p * high)

    def column(self, place: float) -> FloatArray:
        """Returns the values (n,) at a column, linear between the columns, constant beyond."""
        return np.array([np.interp(place, self.columns, row) for row in self.values])

    def resampled(self, rows: FloatArray, columns: FloatArray) -> Table2D:
        """Returns the map over other axes, linear between its nodes and beyond them."""
        across = np.array([_continued(columns, self.columns, values) for values in self.values])
        down = np.array([_continued(rows, self.rows, values) for values in across.T])
        return Table2D(rows, columns, np.maximum(down.T, 0.0))


def no_numbers() -> FloatArray:
    """Returns an empty array: a table that a truck lacks."""
    return np.zeros(0)


NO_TABLE = Table2D(no_numbers(), no_numbers(), np.zeros((0, 0)))


def read_tables(tree: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """Returns the content of a file with the numbers of its CSV tables in place of their paths.

    Numbers that the file itself gives for a table's fields replace those of the table.

    Args:
      tree: content of the file.
      folder: in which the tables are.

    Raises:
      InputError: a table cannot be read; the message names the file.
    """
    found = dict(tree)
    for (name, key), read in TABLES.items():
        section = found.get(name)
        path = section.get(key) if isinstance(section, Mapping) else None
        path = path.get("value") if isinstance(path, Mapping) else path
        if isinstance(path, str):
            rest = {other: value for other, value in section.items() if other != key}  # type: ignore[union-attr]
            found[name] = {**read(folder / path, key), **rest}
    return found


def _read_numbers(path: Path) -> tuple[list[str], FloatArray]:
    """Returns header and numbers of a CSV table."""
    header, rows = read_table(path, "table")
    try:
        values = np.array([[float(cell) for cell in row] for row in rows])
    except ValueError as error:
        raise InputError(f"table {str(path)!r} cannot be read: {error}") from error
    if values.ndim != 2 or values.shape[1] != len(header) or not np.isfinite(values).all():
        raise InputError(f"table {str(path)!r}: every row must have {len(header)} finite numbers")
    return header, values


def _columns(path: Path, *names: str) -> list[FloatArray]:
    """Returns columns of a CSV table, each by the beginning of its header."""
    header, values = _read_numbers(path)
    found = []
    for name in names:
        places = [i for i, title in enumerate(header) if title.strip().startswith(name)]
        if not places:
            raise InputError(
                f"table {str(path)!r} has no column {name!r}; its columns are {header}"
            )
        found.append(values[:, places[0]])
    return found


def _rising(path: Path, values: FloatArray, name: str) -> FloatArray:
    if (np.diff(values) <= 0.0).any():
        raise InputError(f"table {str(path)!r}: {name} must rise from row to row")
    return values


def _grid(row_unit: float, column_unit: float, value_unit: float) -> Callable[[Path, str], Any]:
    """A reader of tables whose first column holds the rows, and whose header the columns."""

    def read(path: Path, key: str) -> dict[str, Any]:
        header, values = _read_numbers(path)
        try:
            columns = np.array([float(cell) for cell in header[1:]]) * column_unit
        except ValueError as error:
            raise InputError(f"table {str(path)!r}: header {header}: {error}") from error
        rows = _rising(path, values[:, 0] * row_unit, "the first column")
        return {key: Table2D(rows, columns, values[:, 1:] * value_unit)}

    return read


def _points(
    first: str, second: str, third: str, row_unit: float, value_unit: float
) -> Callable[[Path, str], Any]:
    """A reader of lists of points (row, column, value), whose columns may differ between rows.

    Between and beyond the columns of a row its values are continued linearly.
    """

    def read(path: Path, key: str) -> dict[str, Any]:
        rows, columns, values = _columns(path, first, second, third)
        nodes = np.unique(columns)
        speeds = np.unique(rows)
        grid = []
        for speed in speeds:
            here = rows == speed
            order = np.argsort(columns[here])
            at, given = columns[here][order], values[here][order]
            if at.size < 2 or (np.diff(at) <= 0.0).any():
                raise InputError(
                    f"table {str(path)!r}: {first} {speed:g} needs two or more rows with different "
                    f"{second}"
                )
            grid.append(_continued(nodes, at, given))
        return {key: Table2D(speeds * row_unit, nodes, np.array(grid) * value_unit)}

    return read


def _continued(x: FloatArray, at: FloatArray, given: FloatArray) -> FloatArray:
    """Linear interpolation, continued with the slopes of both ends."""
    inside = np.interp(x, at, given)
    low = given[0] + (x - at[0]) * (given[1] - given[0]) / (at[1] - at[0])
    high = given[-1] + (x - at[-1]) * (given[-1] - given[-2]) / (at[-1] - at[-2])
    return np.where(x < at[0], low, np.where(x > at[-1], high, inside))


_loss_points = _points("input_speed", "input_torque", "torque_loss", RPM, 1.0)


def _fuel_rate(path: Path, key: str) -> dict[str, Any]:
    """Fuel rate [g/h] over engine speed [rpm] and torque [N m]; never below zero."""
    table = _points("engine_speed", "torque", "fuel", RPM, _GRAMS_PER_HOUR)(path, key)[key]
    return {key: Table2D(table.rows, table.columns, np.maximum(table.values, 0.0))}


def _full_load(path: Path, _: str) -> dict[str, Any]:
    """Engine speed [rpm], full-load torque [N m], and if there is a third column drag torque."""
    header, values = _read_numbers(path)
    speed = _rising(path, values[:, 0] * RPM, "engine speed")
    found: dict[str, Any] = {"full_load_speed": speed, "full_load_torque": values[:, 1]}
    if len(header) > 2 and header[2].strip().startswith("drag"):
        found |= {"drag_speed": speed.tolist(), "drag_torque": np.abs(values[:, 2]).tolist()}
    return found


def _gears(path: Path, key: str) -> dict[str, Any]:
    """Gears from 1 with ratio and, if there are such columns, inertia and loss map.

    Rows of other gears (0 for neutral) are left out. A loss map is a file beside the table.
    """
    header, rows = read_table(path, "table")
    titles = [title.strip() for title in header]
    maps: dict[str, Table2D] = {}
    found: dict[str, list[float]] = {"ratios": [], "inertias": [], "loss_map": []}
    for row in rows:
        cells = dict(zip(titles, row, strict=False))
        try:
            gear, ratio = int(cells["gear"]), float(cells["ratio"])
            inertia = next((float(cells[t]) for t in titles if t.startswith("inertia_in")), 0.0)
        except (KeyError, ValueError) as error:
            raise InputError(
                f"table {str(path)!r}: row {row}: columns 'gear' and 'ratio' with numbers are "
                f"needed ({error})"
            ) from error
        if gear < 1:
            continue
        if gear != len(found["ratios"]) + 1:
            raise InputError(f"table {str(path)!r}: gear {gear} is not the next one")
        found["ratios"].append(ratio)
        found["inertias"].append(inertia)
        name = cells.get("loss_map", "").strip()
        if name and name not in maps:
            maps[name] = _loss_points(path.parent / name, key)[key]
        found["loss_map"].append(1 + list(maps).index(name) if name else 0)
    numbers = {name: np.array(values) for name, values in found.items()}
    return {
        "ratios": numbers["ratios"],
        "inertias": numbers["inertias"],
        "loss_map": tuple(int(i) for i in numbers["loss_map"]),
        "loss_maps": dict(maps),
    }


def _retarder_drag(path: Path, _: str) -> dict[str, Any]:
    """Speed [rpm] and drag torque [N m] of the retarder when it is off."""
    speed, torque = _columns(path, "retarder_speed", "loss_torque")
    speed = _rising(path, speed * RPM, "retarder_speed")
    return {"drag_speed": speed.tolist(), "drag_torque": torque.tolist()}


def _pressure_table(path: Path, _: str) -> dict[str, Any]:
    """Brake pressures over the demanded deceleration, at two masses."""
    header, pressures = _read_numbers(path)
    pressures = pressures[::-1]

    def circuits(mass: str) -> FloatArray:
        """Pressures of the front, drive and trailer circuit [Pa], shape (n, 3)."""
        names = ("front_wheel_cmd_{}(x0.3)", "rear_wheel_cmd_{}(x0.7)", "trailer_cmd_{}(rear x1.1)")
        return pressures[:, [header.index(name.format(mass)) for name in names]] * 1e3

    return {
        "demand": -pressures[:, 0],
        "pressure_light": circuits("18t"),
        "pressure_heavy": circuits("50t"),
    }


# What a file that gives the first of these keys no longer has from the file that it extends, unless
# it gives that, too: a pedal map belongs to its engine, shift speeds and losses to their gears.
REPLACED: dict[tuple[str, str], tuple[str, ...]] = {
    ("engine", "full_load"): ("pedal_map",),
    ("engine", "fuel_map"): ("fuel_rate_map",),
    ("engine", "fuel_rate_map"): ("fuel_map",),
    ("gearbox", "gears"): ("upshift", "downshift", "loss_maps"),
}
# Readers by section and key of the TOML; each returns fields of the section.
TABLES: dict[tuple[str, str], Callable[[Path, str], dict[str, Any]]] = {
    ("engine", "full_load"): _full_load,
    ("engine", "pedal_map"): _grid(RPM, _PERCENT, 1.0),
    ("engine", "fuel_map"): _grid(1.0, RPM, _GRAMS_PER_KWH),
    ("engine", "fuel_rate_map"): _fuel_rate,
    ("retarder", "drag"): _retarder_drag,
    ("gearbox", "gears"): _gears,
    ("gearbox", "axle_loss"): _loss_points,
    ("gearbox", "upshift"): _grid(1.0, 1.0, KMH),
    ("gearbox", "downshift"): _grid(1.0, 1.0, KMH),
    ("air_brake", "pressure_table"): _pressure_table,
}
