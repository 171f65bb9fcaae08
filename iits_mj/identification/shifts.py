"""Timing of gear changes: how long the driveline is open, how fast the torque is taken away."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import stats

from iits_mj.core.arrays import FloatArray
from iits_mj.identification.estimate import WIDEST, Estimate
from iits_mj.identification.log import Log
from iits_mj.parameters import TruckParameters

# Fewer changes leave no honest mean.
_CHANGES_MIN = 4
# A flag sampled coarser than this share of a change says little about it.
_COARSEST = 0.1
# Torque that is worth taking away, of the reference; the part of its fall that counts.
_LOADED = 0.2
_FALL = (0.1, 0.9)
_FALL_SAMPLES = 3
# After this long the change is a launch or a fault, not a shift [s].
_LONGEST = 3.0
# Changes further from the median than this share of it are another kind of change.
_STRAY = 0.2


@dataclass(frozen=True)
class _Change:
    start: float
    end: float


def identify_shifts(log: Log, parameters: TruckParameters) -> list[Estimate]:
    """Duration of a gear change, of its torque cut and of its synchronisation.

    The time that the clutch takes to close is not told apart from synchronisation: it stays.
    """
    gearbox = parameters.gearbox
    names = ("shift_duration", "shift_cut_time", "synchronization_time")
    total = gearbox.shift_cut_time + gearbox.synchronization_time + gearbox.clutch_close_time
    priors = (total, gearbox.shift_cut_time, gearbox.synchronization_time)

    def unseen(k: int, reason: str) -> Estimate:
        return Estimate.unseen(names[k], "s", priors[k], reason)

    if "shift_in_process" not in log:
        return [unseen(k, "the log lacks shift_in_process") for k in range(3)]
    changes = _changes(log)
    if len(changes) < _CHANGES_MIN:
        reason = f"the log has {len(changes)} gear changes, {_CHANGES_MIN} are wanted"
        return [unseen(k, reason) for k in range(3)]
    lengths = np.array([change.end - change.start for change in changes])
    step = float(np.median(np.diff(log.series("shift_in_process").time)))
    # Flags are sampled: where changes keep step with the samples, half of one stays unseen.
    duration = _mean(names[0], priors[0], lengths, 0.5 * step)
    if step > _COARSEST * float(lengths.mean()):
        # Averages of many changes would do, were their phases known to be random.
        reason = f"the log shows the change in steps of {1e3 * step:.0f} ms only"
        return [unseen(k, reason) for k in range(3)]
    cuts = _cuts(log, parameters, changes)
    if len(cuts) >= _CHANGES_MIN:
        cut = _mean(names[1], priors[1], np.array(cuts))
    else:
        cut = unseen(1, "the log has too few loaded changes, or samples the torque too slowly")
    rest = duration.value - cut.value - gearbox.clutch_close_time
    if not duration.identifiable or rest <= 0.0:
        synchronization = unseen(2, duration.reason or "shorter than torque cut and clutch closing")
    else:
        half = float(np.hypot(duration.half_width, cut.half_width if cut.identifiable else 0.0))
        synchronization = _judged(names[2], priors[2], rest, half)
    return [duration, cut, synchronization]


def _changes(log: Log) -> list[_Change]:
    """Changes from one forward gear to another."""
    flag = log.series("shift_in_process")
    edges = np.diff((flag.value > 0.5).astype(int))
    starts, ends = flag.time[1:][edges > 0], flag.time[1:][edges < 0]
    changes = []
    for start in starts:
        later = ends[ends > start]
        if not len(later) or later[0] - start > _LONGEST:
            continue
        if "gear" in log and min(log.held("gear", [start - 0.2, later[0] + 0.2])) < 1:
            continue
        changes.append(_Change(float(start), float(later[0])))
    return changes


def _cuts(log: Log, parameters: TruckParameters, changes: list[_Change]) -> list[float]:
    """Times in which loaded changes take the torque to nothing [s], by the slope of its fall."""
    if log.missing("engine_torque", "engine_speed"):
        return []
    engine, series = parameters.engine, log.series("engine_torque")
    cuts = []
    for change in changes:
        before = int(np.searchsorted(series.time, change.start)) - 1
        level = float(series.value[max(before - 1, 0)])
        if level < _LOADED * engine.reference_torque:
            continue
        speed = float(log.at("engine_speed", change.start))
        bottom = -float(np.interp(speed, engine.drag_speed, engine.drag_torque))
        near = (series.time > change.start - 0.1) & (series.time < change.end)
        time, share = series.time[near], (series.value[near] - bottom) / (level - bottom)
        last = int(np.argmax(share < _FALL[0])) if np.any(share < _FALL[0]) else 0
        time, share = time[:last], share[:last]
        falling = share < _FALL[1]
        if np.count_nonzero(falling) >= _FALL_SAMPLES:
            slope = float(np.polyfit(time[falling], share[falling], 1)[0])
            if slope < 0.0:
                cuts.append(-1.0 / slope)
    return cuts


def _mean(name: str, prior: float, values: FloatArray, unseen: float = 0.0) -> Estimate:
    """Mean with its 95 % interval and what is unseen on top, without strays far from the median."""
    median = float(np.median(values))
    kept = values[np.abs(values - median) <= _STRAY * median]
    deviation = float(np.std(kept, ddof=1)) / np.sqrt(len(kept))
    half = float(stats.t.ppf(0.975, len(kept) - 1)) * deviation
    return _judged(name, prior, float(kept.mean()), half + unseen)


def _judged(name: str, prior: float, value: float, half_width: float) -> Estimate:
    if half_width <= WIDEST * value:
        return Estimate(name, value, "s", prior, half_width, True)
    reason = f"the log is too weak: +/-{100.0 * half_width / value:.0f} % of the value"
    return Estimate(name, prior, "s", prior, half_width, False, reason)
