"""Timing of gear changes: how long the driveline is open, and how fast the torque is cut."""

from __future__ import annotations

import numpy as np
from scipy import stats

from iits_mj.core.arrays import FloatArray
from iits_mj.identification.estimate import Estimate, Free, too_weak, unseen
from iits_mj.identification.log import Log
from iits_mj.parameters import TruckParameters

# Fewer changes give no reliable mean.
_CHANGES_MIN = 4
# Coarsest sampling of the flag, as a share of a change.
_COARSEST = 0.1
# Least torque of a loaded change, of the reference; the part of its fall that counts.
_LOADED = 0.2
_FALL = (0.1, 0.9)
_FALL_SAMPLES = 3
# Time after which a truck without pedal coasts [s].
_COASTED = 1.5
# A longer change is a launch or a fault, not a shift [s].
_LONGEST = 3.0
# Changes further from the median than this share of it are outliers.
_STRAY = 0.2


def identify_shifts(log: Log, parameters: TruckParameters) -> list[Estimate]:
    """Duration of a gear change, of its torque cut and of its synchronization.

    The closing time of the clutch cannot be separated from synchronization: it keeps its value.
    """
    gearbox = parameters.gearbox
    total = gearbox.shift_cut_time + gearbox.synchronization_time + gearbox.clutch_close_time
    free = (
        Free("shift_duration", "s", total),
        Free("shift_cut_time", "s", gearbox.shift_cut_time),
        Free("synchronization_time", "s", gearbox.synchronization_time),
    )
    lacks = log.lacks("shift_in_process")
    if lacks:
        return unseen(free, lacks)
    changes = _changes(log)
    if len(changes) < _CHANGES_MIN:
        reason = f"the log has {len(changes)} gear changes, {_CHANGES_MIN} are needed"
        return unseen(free, reason)
    lengths = np.array([end - start for start, end in changes])
    step = float(np.median(np.diff(log.series("shift_in_process").time)))
    # Flags are sampled: half a sample stays hidden if changes are in step with the samples.
    duration = _mean(free[0], lengths, 0.5 * step)
    if step > _COARSEST * float(lengths.mean()):
        # The mean of many changes would suffice only for random phases.
        reason = f"the log shows the change in steps of {1e3 * step:.0f} ms only"
        return unseen(free, reason)
    cuts = _cuts(log, parameters, changes)
    if len(cuts) >= _CHANGES_MIN:
        cut = _mean(free[1], np.array(cuts))
    else:
        cut = free[1].unseen("the log has too few loaded changes, or samples the torque too slowly")
    rest = duration.value - cut.value - gearbox.clutch_close_time
    if not duration.identifiable or rest <= 0.0:
        reason = duration.reason or "shorter than torque cut and clutch closing"
        synchronization = free[2].unseen(reason)
    else:
        half = float(np.hypot(duration.half_width, cut.half_width if cut.identifiable else 0.0))
        synchronization = free[2].judged(rest, half, too_weak(half / rest))
    return [duration, cut, synchronization]


def _changes(log: Log) -> list[tuple[float, float]]:
    """Start and end of the changes from one forward gear to another [s]."""
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
        changes.append((float(start), float(later[0])))
    return changes


def _cuts(log: Log, parameters: TruckParameters, changes: list[tuple[float, float]]) -> list[float]:
    """Times in which loaded changes cut the torque to zero [s], by the slope of its fall."""
    if log.missing("engine_torque", "engine_speed"):
        return []
    engine, series = parameters.engine, log.series("engine_torque")
    drag, cuts = _drag_scale(log, parameters), []
    for start, end in changes:
        before = int(np.searchsorted(series.time, start)) - 1
        level = float(series.value[max(before - 1, 0)])
        if level < _LOADED * engine.reference_torque:
            continue
        speed = float(log.at("engine_speed", start))
        bottom = -drag * float(np.interp(speed, engine.drag_speed, engine.drag_torque))
        near = (series.time > start - 0.1) & (series.time < end)
        time, share = series.time[near], (series.value[near] - bottom) / (level - bottom)
        last = int(np.argmax(share < _FALL[0])) if np.any(share < _FALL[0]) else 0
        time, share = time[:last], share[:last]
        falling = share < _FALL[1]
        if np.count_nonzero(falling) >= _FALL_SAMPLES:
            slope = float(np.polyfit(time[falling], share[falling], 1)[0])
            if slope < 0.0:
                cuts.append(-1.0 / slope)
    return cuts


def _drag_scale(log: Log, parameters: TruckParameters) -> float:
    """Engine drag over the parameters', by the torque of the coasting truck; 1 if it never does."""
    if "command_accelerator_pedal" not in log:
        return 1.0
    series, engine = log.series("engine_torque"), parameters.engine
    pressed = log.held("command_accelerator_pedal", series.time) > 0.0
    used = pressed | (log.held("shift_in_process", series.time) > 0.5)
    if "command_engine_brake" in log:
        used |= log.held("command_engine_brake", series.time) > 0.0
    last = np.maximum.accumulate(np.where(used, series.time, -np.inf))
    coasting = series.time - last > _COASTED
    if not coasting.any():
        return 1.0
    speed = log.at("engine_speed", series.time[coasting])
    drag = np.interp(speed, engine.drag_speed, engine.drag_torque)
    return float(np.median(-series.value[coasting] / drag))


def _mean(free: Free, values: FloatArray, unseen_part: float = 0.0) -> Estimate:
    """Mean without outliers; its 95 % interval with the unseen part added."""
    median = float(np.median(values))
    kept = values[np.abs(values - median) <= _STRAY * median]
    if len(kept) < 2:
        return free.unseen(f"the {len(values)} changes differ by more than {100.0 * _STRAY:g} %")
    deviation = float(np.std(kept, ddof=1)) / np.sqrt(len(kept))
    half = float(stats.t.ppf(0.975, len(kept) - 1)) * deviation + unseen_part
    mean = float(kept.mean())
    return free.judged(mean, half, too_weak(half / mean))
