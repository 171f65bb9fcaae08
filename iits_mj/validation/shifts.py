"""What a gear change looks like in a recorded drive: how long, how deep, and taken back or not."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from iits_mj.validation.longitudinal_run import Run

# After this speed the launch is over and changes are those of a moving truck [m/s].
_MOVING = 0.5
# A crankshaft below it drives nothing to speak of [N m].
_NO_TORQUE = 60.0
# The dip lasts while less than this share of the pull before it is there.
_LEFT = 0.2
# So long before a change the pull is still whole [s].
_BEFORE = 0.2


@dataclass(frozen=True)
class Shift:
    """One gear change.

    Attributes:
      start: [s]; gear: the new one; duration: while the driveline is open [s].
      idle: for how long the crankshaft has less than 60 N m [s].
      dip: for how long the acceleration is near that of coasting, less than a fifth of the way to
        what it was before [s].
    """

    start: float
    gear: int
    duration: float
    idle: float
    dip: float


def shifts(record: Run) -> list[Shift]:
    """The gear changes of a moving truck, complete ones only."""
    edges = np.flatnonzero(np.diff(record.shift) != 0.0) + 1
    edges = edges[record.speed[edges] > _MOVING]
    step = float(record.time[1] - record.time[0])
    found = []
    for a, b in itertools.pairwise(edges):
        if record.shift[a] < 0.5 or record.shift[b] > 0.5:
            continue
        idle = _span(record.engine_torque < _NO_TORQUE, int(a), int(b)) * step
        found.append(
            Shift(
                float(record.time[a]),
                int(record.gear[b]),
                float(record.time[b] - record.time[a]),
                idle,
                _dip(record, int(a), int(b), step),
            )
        )
    return found


def hunting(record: Run, within: float = 5.0) -> int:
    """Number of gear changes that the gearbox takes back within some seconds."""
    changes = np.flatnonzero(np.diff(record.gear))
    return sum(
        record.time[b] - record.time[a] < within and record.gear[b + 1] == record.gear[a]
        for a, b in itertools.pairwise(changes)
    )


def _dip(record: Run, start: int, end: int, step: float) -> float:
    """Time for which the acceleration is missing [s]; nan when it began before the drive."""
    rate, before = record.acceleration, start - round(_BEFORE / step)
    if before < 0:
        return float("nan")
    # The driveline swings when it lets go: its quarter quantile is what the truck coasts with.
    coasting = float(np.quantile(rate[start:end], 0.25))
    return _span(rate < coasting + _LEFT * (rate[before] - coasting), start, end) * step


def _span(low: NDArray[np.bool_], start: int, end: int) -> int:
    """Samples from the first to the last low one between start and end, and those joined to it."""
    places = np.flatnonzero(low[start:end])
    if not len(places):
        return 0
    last = start + int(places[-1])
    while last + 1 < len(low) and low[last + 1]:
        last += 1
    return last + 1 - (start + int(places[0]))
