"""Drives the truck with the recorded commands, to check the identified parameters.

The truck gets the recorded commands, not the recorded speed, on a straight road of the recorded
grade. Errors accumulate along the drive, and the gear changes are those of the simulated gearbox.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.signal import savgol_filter

from iits_mj.core.arrays import FloatArray
from iits_mj.core.errors import InputError
from iits_mj.core.messages import VehicleCommand, XbrEbiMode, XbrMode
from iits_mj.core.progress import each
from iits_mj.core.timing import CONTROL_PERIOD
from iits_mj.identification.log import Log
from iits_mj.j1939.command import XBR_DEMAND_MIN
from iits_mj.parameters import TruckParameters
from iits_mj.road import Route
from iits_mj.road.design import Design
from iits_mj.truck import Truck

_NEEDED = ("speed", "grade", "command_accelerator_pedal")
_COMMANDS = {
    "accelerator_pedal": (0.0, 1.0),
    "xbr_demand": (XBR_DEMAND_MIN, 0.0),
    "xbr_mode": (0.0, 2.0),
    "engine_brake": (0.0, 1.0),
    "retarder": (0.0, 1.0),
    "brake_pedal": (0.0, 1.0),
    "xbr_ebi_mode": (0.0, 2.0),
}
_MODES = {"xbr_mode": XbrMode, "xbr_ebi_mode": XbrEbiMode}
_STEP = 0.005
# Station of the steer axle at the start, with road for the trailer; margin at the road's end.
_START, _MARGIN = 50.0, 200.0
# Spacing of the grade's changes along the road, and length of the parabolas between them [m].
_SPACING, _CURVE = 25.0, 24.0
# The record's noise is smoothed over this time before the comparison [s].
_SMOOTH = 2.0


@dataclass(frozen=True)
class Replay:
    """Time [s], recorded speed and the truck's speed [m/s], each of shape (n,)."""

    time: FloatArray
    recorded: FloatArray
    simulated: FloatArray

    def smoothed(self) -> FloatArray:
        """The record smoothed by parabolas over 2 s: its noise is not an error of the truck."""
        step = float(np.median(np.diff(self.time)))
        length = max(round(_SMOOTH / step) // 2 * 2 + 1, 5)
        return np.asarray(savgol_filter(self.recorded, length, 2))

    def accuracy(self) -> float:
        """Speed accuracy: 100 (1 - mean |v - v_rec| / mean v_rec) [%]."""
        record = self.smoothed()
        mean = float(np.mean(record))
        error = float(np.mean(np.abs(self.simulated - record)))
        return 100.0 * (1.0 - error / mean) if mean > 0.0 else float("nan")

    def fit(self) -> float:
        """The stricter NRMSE fit: 100 (1 - |v - v_rec| / |v_rec - mean|) [%], Euclidean norms."""
        record = self.smoothed()
        spread = float(np.linalg.norm(record - record.mean()))
        error = float(np.linalg.norm(self.simulated - record))
        return 100.0 * (1.0 - error / spread) if spread > 0.0 else float("nan")


def replay(
    log: Log,
    parameters: TruckParameters | Mapping[str, Any] | str | Path | None = None,
    payload: float | None = None,
) -> Replay:
    """Drives the truck with the log's commands.

    Args:
      log: with `_NEEDED`; missing commands are zero.
      parameters: of the truck, or an overlay.
      payload: [kg]; default: the parameters' greatest.

    Raises:
      InputError: the log lacks a signal, or has a maneuver that the road does not allow.
    """
    lacks = log.lacks(*_NEEDED)
    if lacks:
        raise InputError(f"the drive cannot be replayed: {lacks}")
    speed = log.series("speed")
    truck = Truck.load(
        payload, parameters=parameters, route=_road(log), timestep=_STEP, visuals=False
    )
    truck.reset(station=_START, speed=_initial_speed(log))
    start = float(speed.time[0])
    time = np.arange(start, float(speed.time[-1]), CONTROL_PERIOD)
    columns = {
        name: np.clip(log.held(f"command_{name}", time), low, high)
        for name, (low, high) in _COMMANDS.items()
        if f"command_{name}" in log
    }
    steps = round(CONTROL_PERIOD / _STEP)
    simulated = np.empty(len(time))
    for index in each(range(len(time)), "replaying the log"):
        simulated[index] = truck.read("tractor_velocity")
        fields: dict[str, Any] = {name: float(values[index]) for name, values in columns.items()}
        for name, kind in _MODES.items():
            if name in fields:
                fields[name] = kind(round(fields[name]))
        truck.command(VehicleCommand(**fields))
        truck.step(steps)
    return Replay(time, log.at("speed", time), simulated)


def _initial_speed(log: Log) -> float:
    """Speed at the log's start, by a straight line over its first second [m/s]."""
    speed = log.series("speed")
    first = speed.time - speed.time[0] <= 1.0
    if np.count_nonzero(first) < 3:
        return max(float(speed.value[0]), 0.0)
    line = np.polyfit(speed.time[first] - speed.time[0], speed.value[first], 1)
    return max(float(line[1]), 0.0)


def _road(log: Log) -> Route:
    """A straight road with the log's grade over the driven distance."""
    speed = log.series("speed")
    place = np.maximum.accumulate(speed.integral()) + _START
    moved = np.concatenate([[True], np.diff(place) > 1e-6])
    # The simulated truck may drive further than the recorded truck: the last grade continues.
    length = float(place[-1]) + 0.1 * float(place[-1] - _START) + _MARGIN
    return graded_road(place[moved], log.at("grade", speed.time)[moved], length)


def graded_road(station: FloatArray, grade: FloatArray, length: float) -> Route:
    """A straight road of a length [m] with grades from a table over station [m], (n,) both.

    Every 25 m the mean grade changes, over a parabola of nearly that length.
    """
    middles = np.arange(0.5 * _SPACING, length, _SPACING)
    means = np.interp(middles, station, grade)
    breaks = np.arange(_SPACING, length - _CURVE, _SPACING)
    design = Design(
        name="graded",
        alignment=((length, 0.0, 0.0, 0.0, 0.0),),
        initial_grade=float(means[0]),
        grades=tuple(
            (float(at), float(after), _CURVE) for at, after in zip(breaks, means[1:], strict=False)
        ),
    )
    return design.route()
