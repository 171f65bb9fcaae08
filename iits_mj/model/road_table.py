"""Adds the road's surface to the model as a numeric, which `plugin/tire.cc` reads."""

from __future__ import annotations

import mujoco
import numpy as np

from iits_mj.core.arrays import FloatArray
from iits_mj.core.errors import MapError
from iits_mj.road import Route
from iits_mj.road.unevenness import ACROSS, ALONG, SMOOTH, Unevenness

NUMERIC_NAME = "iits_road"
TABLE_VERSION, UNEVEN_VERSION = 1, 2
# First number of the rows in the table, numbers of a row, and the first of the three of friction.
_HEADERS, _COLUMNS, _FRICTION = {TABLE_VERSION: 4, UNEVEN_VERSION: 8}, 11, 8
TABLE_STEP = 1.0  # [m], approximate: the table spans the route in equal steps


def add_road_table(spec: mujoco.MjSpec, route: Route) -> None:
    """Adds the route's surface as numeric `iits_road`; see `add_surface`."""
    table = route.table(TABLE_STEP)
    add_surface(spec, table, route.length / (len(table) - 1), route.unevenness)


def add_surface(
    spec: mujoco.MjSpec,
    table: FloatArray,
    spacing: float,
    unevenness: Unevenness = SMOOTH,
) -> None:
    """Adds a surface as numeric `iits_road`; heights are C1 between its rows.

    Args:
      spec: with the truck.
      table: rows of `TABLE_COLUMNS`, shape (n, 10).
      spacing: of the rows along the road [m].
      unevenness: in addition to the table; it does not affect the bits of a smooth road.

    Raises:
      MapError: the table holds a number that is not finite.
    """
    if not np.isfinite(table).all():
        row = int(np.argwhere(~np.isfinite(table))[0, 0])
        raise MapError(f"the road's surface table is not finite at row {row} of {len(table)}")
    x, y, z, heading, curvature, grade, superelevation, left, right, split = table.T
    rows = np.column_stack(
        [
            *(x, y, z, np.cos(heading), np.sin(heading), curvature, grade),
            *(np.tan(superelevation), left, right, split),
        ]
    )
    header, grid = [TABLE_VERSION, len(table), 0.0, spacing], np.zeros(0)
    if unevenness:
        grid = unevenness.heights()
        header = [UNEVEN_VERSION, *header[1:], *grid.shape, ALONG, ACROSS]
    numeric = spec.add_numeric()
    numeric.name = NUMERIC_NAME
    values = np.concatenate([header, rows.ravel(), grid.ravel()])
    numeric.data = values
    numeric.size = values.size


def friction_table(model: mujoco.MjModel) -> tuple[FloatArray, FloatArray]:
    """Returns the friction of a compiled model's road, which may be changed between two steps.

    Args:
      model: with a road table, or without one.

    Returns:
      A view of friction left, friction right and offset of the split [m], shape (n, 3), and the
      stations of its rows [m], shape (n,); n is 0 without a road table.
    """
    number = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_NUMERIC, NUMERIC_NAME)
    if number < 0:
        return np.zeros((0, 3)), np.zeros(0)
    first = int(model.numeric_adr[number])
    version, count, start, step = model.numeric_data[first : first + 4].tolist()
    first += _HEADERS[int(version)]
    rows = model.numeric_data[first : first + _COLUMNS * int(count)].reshape(-1, _COLUMNS)
    return rows[:, _FRICTION : _FRICTION + 3], start + step * np.arange(len(rows))
