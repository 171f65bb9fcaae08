"""How pedal, brakes and gearbox were used on a drive, and how well the speed was kept."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from iits_mj.core.arrays import FloatArray
from iits_mj.validation.closed_loop import CONTROL_PERIOD, Record

# Positions that count as pressed, and as floored [1].
_PRESSED, _FLOORED = 0.02, 0.99
# The planned speed leads a truck at full pedal: such samples say nothing on tracking. So long after
# the pedal has come back from the floor, and around a gear change, neither [s].
_SETTLING = 3.0


def reversals(record: Record) -> FloatArray:
    """Times at which accelerator and brakes (engine brake, retarder, friction) take turns [s].

    Coasting between them does not count: pedal, coasting, pedal is no reversal.
    """
    pedal = record["pedal"] > _PRESSED
    brake = (
        (record["engine_brake"] > _PRESSED)
        | (record["retarder"] > _PRESSED)
        | (record["xbr_demand"] < 0.0)
    )
    acting = np.where(pedal, 1, np.where(brake, -1, 0))
    rows = np.flatnonzero(acting)
    turns = rows[1:][np.diff(acting[rows]) != 0]
    return np.asarray(record["time"][turns])


def reversals_per_km(record: Record) -> float:
    """Number of reversals over the length driven [1/km]."""
    return 1e3 * reversals(record).size / max(_length(record), 1.0)


def shortest_turn(record: Record) -> float:
    """Least time between two reversals [s]; the whole drive when there are fewer than two."""
    times = reversals(record)
    if times.size < 2:
        return float(record["time"][-1] - record["time"][0])
    return float(np.diff(times).min())


def gear_changes(record: Record) -> int:
    """Number of changes of the gear that is in."""
    gear = record["gear"]
    return int(np.count_nonzero(np.diff(gear[gear > 0.0])))


def full_load_share(record: Record) -> float:
    """Share of the time with the accelerator on the floor [1]."""
    return float(np.mean(record["pedal"] >= _FLOORED))


def gained(record: Record, counter: str) -> float:
    """What a counter, as `brake_work` [J], gained over the drive."""
    column = record[counter]
    return float(column[-1] - column[0])


def within_power(record: Record) -> NDArray[np.bool_]:
    """Samples in which the truck could follow: the accelerator was off the floor, shape (n,)."""
    floored = record["pedal"] >= _FLOORED
    width = round(_SETTLING / CONTROL_PERIOD)
    recent = np.convolve(floored.astype(float), np.ones(width), "full")[: floored.size] > 0.5
    return np.asarray(~recent)


def tracking_error(record: Record) -> FloatArray:
    """Speed less planned speed where the truck could follow [m/s]."""
    return np.asarray((record["speed"] - record["planned"])[within_power(record)])


def _length(record: Record) -> float:
    return float(record["station"][-1] - record["station"][0])
