"""What a recording's arrays must be like: nothing that is not finite, nobody twice in a frame."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from iits_mj.errors import InputError
from traffic_bridge.recording.rows import COMMAND_COLUMNS, EGO_COLUMNS
from traffic_bridge.vehicles.types import KINDS

if TYPE_CHECKING:
    from traffic_bridge.recording.recording import Recording

PIECE = 1 << 18  # rows looked at together, so that a mapped file is not read into memory at once


def check_arrays(recording: Recording, name: str) -> None:
    """Holds the arrays of a recording against each other.

    Args:
      recording: the recording.
      name: how messages call it.

    Raises:
      InputError: says which array is wrong and where.
    """
    r = recording
    n, m, k = len(r.time), len(r.ids), r.columns.shape[-1]
    from traffic_bridge.recording.recording import COLUMNS

    for array, shape, what in (
        (r.time, (n,), "time"),
        (r.kinds, (m,), "vehicle_kind"),
        (r.sizes, (m, 3), "vehicle_size"),
        (r.start, (n + 1,), "frame_start"),
        (r.vehicle, (k,), "vehicle"),
        (r.lane, (k,), "lane"),
        (r.columns, (len(COLUMNS), k), "columns"),
        (r.ego, (n, len(EGO_COLUMNS)), "ego"),
        (r.commands, (len(r.command_time), len(COMMAND_COLUMNS)), "command"),
    ):
        found = np.shape(array)
        if found != shape:
            raise InputError(f"{name}: {what} has the shape {found}, wanted is {shape}")
    _finite(r.time, name, "time")
    _finite(r.sizes, name, "vehicle_size")
    _finite(r.command_time, name, "command_time")
    _finite(r.commands, name, "command")
    for array, what in ((r.time, "time"), (r.command_time, "command_time")):
        if (np.diff(array) <= 0.0).any():
            place = int(np.argmax(np.diff(array) <= 0.0)) + 1
            raise InputError(
                f"{name}: {what} does not increase: [{place}] = {array[place]:g} s after "
                f"{array[place - 1]:g} s"
            )
    if (r.sizes <= 0.0).any():
        raise InputError(f"{name}: vehicle_size has values that are not positive")
    strange = sorted(set(r.kinds) - set(KINDS))
    if strange:
        raise InputError(f"{name}: vehicle_kind {strange[0]!r}: allowed are {', '.join(KINDS)}")
    _check_rows(r, name, m, k)
    _check_ego(r.ego, name)


def _check_rows(r: Recording, name: str, m: int, k: int) -> None:
    from traffic_bridge.recording.recording import COLUMNS, ranks

    counts = np.diff(r.start)
    if len(r.start) and (r.start[0] != 0 or r.start[-1] != k or (counts < 0).any()):
        raise InputError(f"{name}: frame_start does not fit the other arrays")
    for column, values in zip(COLUMNS, r.columns, strict=True):
        _finite(values, name, column)
    rank, first = ranks(r.ids), np.zeros(k + 1, dtype=bool)
    first[r.start] = True
    before = -1
    for low in range(0, k, PIECE):
        who = np.asarray(r.vehicle[low : low + PIECE])
        if who.min() < 0 or who.max() >= m:
            raise InputError(f"{name}: vehicle has an index that is not 0 to {m - 1}")
        place = np.concatenate(([before], rank[who]))
        bad = (np.diff(place) <= 0) & ~first[low : low + len(who)]
        if bad.any():
            row = int(np.argmax(bad))
            raise InputError(
                f"{name}: vehicle {r.ids[who[row]]!r} is twice in a frame, or a frame is not "
                f"sorted by name (row {low + row})"
            )
        before = int(place[-1])


def _check_ego(ego: NDArray[np.float64], name: str) -> None:
    absent = np.isnan(ego)
    some = absent.any(axis=1) & ~absent.all(axis=1)
    if some.any() or np.isinf(ego).any():
        row = int(np.argmax(some | np.isinf(ego).any(axis=1)))
        raise InputError(f"{name}: ego has values that are not finite in frame {row}")


def _finite(values: NDArray[Any], name: str, what: str) -> None:
    for low in range(0, len(values), PIECE):
        if not np.isfinite(values[low : low + PIECE]).all():
            raise InputError(f"{name}: column {what!r} has values that are not finite")
