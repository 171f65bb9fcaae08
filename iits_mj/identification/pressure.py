"""Dead time and build-up time of the brake circuits, from the pressures after a brake demand.

A demand counts from the row that first shows it, so a log sampled every h seconds leaves the dead
time uncertain by h / 2 more than the fit's own interval says; that share is added.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np
from numpy.typing import NDArray

from iits_mj.identification.estimate import Estimate, Free, fit
from iits_mj.identification.log import Log
from iits_mj.parameters import TruckParameters

FloatArray = NDArray[np.float64]

CIRCUITS = {"front": ("brake_pressure_front_left", 0), "rear": ("brake_pressure_rear_left", 1)}
CIRCUITS["trailer"] = ("brake_pressure_trailer", 3)
# A demand that grows by this much [m/s2] at once and then holds this long [s] is an event.
_STEP = 0.3
_HOLD = 2.0
_EVENTS_MIN = 3


def identify_pressures(log: Log, parameters: TruckParameters) -> list[Estimate]:
    """Dead time and time constant of each circuit: a delayed first order to the pressure reached.

    Each event's initial and final pressures are solved for; only the times are shared.
    """
    estimates = []
    events = _events(log)
    for circuit, (column, axle) in CIRCUITS.items():
        brake = parameters.air_brake
        free = [
            Free(f"{circuit}_dead_time", "s", brake.dead_time[axle], 1e-3, 1.0),
            Free(f"{circuit}_build_up_time", "s", brake.build_up_time_constant[axle], 0.05, 3.0),
        ]
        if len(events) < _EVENTS_MIN:
            reason = f"the log has {len(events)} held brake demands, {_EVENTS_MIN} are wanted"
            estimates += [
                Estimate(f.name, f.prior, f.unit, f.prior, math.inf, False, reason) for f in free
            ]
            continue
        estimates += _fit_circuit(log["time"], log[column], events, free)
    return estimates


def _fit_circuit(
    time: FloatArray, pressure: FloatArray, events: list[slice], free: list[Free]
) -> list[Estimate]:
    scale = max(float(np.ptp(pressure)), 1.0)

    def residual(values: FloatArray) -> list[FloatArray]:
        groups = []
        for event in events:
            since = time[event] - time[event.start + 1] - values[0]
            shape = 1.0 - np.exp(-np.maximum(since, 0.0) / values[1])
            basis = np.column_stack([np.ones_like(shape), shape])
            measured = pressure[event]
            level, *_ = np.linalg.lstsq(basis, measured, rcond=None)
            groups.append((basis @ level - measured) / scale)
        return groups

    (dead_time, build_up), _ = fit(free, residual)
    sampling = 0.5 * float(np.median(np.diff(time)))
    wider = dead_time.half_width + sampling
    return [dataclasses.replace(dead_time, half_width=wider), build_up]


def _events(log: Log) -> list[slice]:
    """Index ranges from the last row before a step of the brake demand to the end of its hold."""
    if "command_xbr_demand" not in log:
        return []
    time, demand = log["time"], log["command_xbr_demand"]
    if "command_xbr_mode" in log:
        demand = np.where(log["command_xbr_mode"] > 0.5, demand, 0.0)
    events = []
    for index in np.flatnonzero(np.diff(demand) < -_STEP):
        held = index + 1
        while held < len(time) and abs(demand[held] - demand[index + 1]) < 0.02:
            held += 1
        if time[held - 1] - time[index + 1] >= _HOLD:
            events.append(slice(int(index), held))
    return events
