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
