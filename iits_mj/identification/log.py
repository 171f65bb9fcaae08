"""A recorded drive: named signals in SI units, each with the times at which it was sampled.

A telemetry table samples all signals at once; on a bus every message has a rhythm of its own.
Neither is resampled here: a fit asks for the samples themselves (`series`) or for values at times
of its choice (`at` for what changes steadily, `held` for what stays until it is sent anew).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from iits_mj.core.arrays import FloatArray
from iits_mj.core.errors import InputError

PRESSURES = tuple(
    f"brake_pressure_{place}"
    for place in ("front_left", "front_right", "rear_left", "rear_right", "trailer")
)
# Every signal that a fit may ask for: unit and meaning.
SIGNALS: dict[str, str] = {
    "time": "[s]",
    "speed": "[m/s] forward",
    "station": "[m] along the road",
    "z": "[m] height of the road under the steer axle",
    "grade": "[1] of the road, dz/ds, under the steer axle",
    "gear": "[1] 1 to 12, 0 neutral, -1 reverse",
    "shift_in_process": "[1] 1 while the driveline is open for a gear change",
    "engine_speed": "[rad/s]",
    "engine_torque": "[N m] at the crankshaft, negative in overrun and under engine brake",
    "retarder_torque": "[N m] at the propeller shaft, positive when it brakes",
    "command_accelerator_pedal": "[1] 0 to 1",
    "command_engine_brake": "[1] 0 to 1",
    "command_retarder": "[1] 0 to 1",
    "command_xbr_demand": "[m/s2] zero or negative",
    "command_xbr_mode": "[1] 0 off, 1 addition, 2 maximum",
    "command_brake_pedal": "[1] 0 to 1",
    **dict.fromkeys(PRESSURES, "[Pa] in the chambers"),
    "steering_wheel_angle": "[rad] actual",
    "road_wheel_angle": "[rad] mean of left and right",
    "yaw_rate": "[rad/s] of the tractor",
    "trailer_yaw_rate": "[rad/s]",
    "articulation": "[rad] tractor yaw minus trailer yaw",
    "lateral_acceleration": "[m/s2] of the tractor's centre of gravity",
}
_ROWS_MIN = 50


@dataclass(frozen=True)
class Series:
    """Samples of one signal: time [s], strictly increasing, and value, both of shape (n,)."""

    time: FloatArray
    value: FloatArray


@dataclass(frozen=True)
class Log:
    """The signals of a drive by name; see `SIGNALS` for names, units and signs.

    Attributes:
      signals: name to values of shape (n,), sampled at the signal "time"; or to a `Series`.
    """

    signals: Mapping[str, FloatArray | Series]

    def __post_init__(self) -> None:
        if not self.signals:
            raise InputError("the log has no signal that can be used")
        for name in self.signals:
            series = self.series(name)
            if len(series.value) != len(series.time) or not np.isfinite(series.value).all():
                raise InputError(f"signal {name!r} of the log has gaps or is not finite")
            if not np.isfinite(series.time).all() or np.any(np.diff(series.time) <= 0.0):
                raise InputError(f"the time of signal {name!r} must increase from row to row")
        length = max(len(self.series(name).time) for name in self.signals)
        if length < _ROWS_MIN:
            raise InputError(f"the log has {length} rows: at least {_ROWS_MIN} are wanted")

    def __contains__(self, name: str) -> bool:
        return name in self.signals

    def series(self, name: str) -> Series:
        """The samples of a signal. Raises InputError when the log lacks it."""
        found = self.signals.get(name)
        if found is None:
            raise InputError(f"the log lacks the signal {name!r}; it has {sorted(self.signals)}")
        if isinstance(found, Series):
            return found
        time = self.signals.get("time")
        if not isinstance(time, np.ndarray):
            raise InputError(f"the log lacks the signal 'time' that {name!r} was sampled at")
        return Series(time, np.asarray(found, dtype=float))

    def __getitem__(self, name: str) -> FloatArray:
        return self.series(name).value

    def missing(self, *names: str) -> list[str]:
        """Those of the names that the log lacks."""
        return [name for name in names if name not in self.signals]

    def at(self, name: str, time: ArrayLike) -> FloatArray:
        """Values at other times, on straight lines between the samples."""
        series = self.series(name)
        return np.asarray(np.interp(np.asarray(time, dtype=float), series.time, series.value))

    def held(self, name: str, time: ArrayLike) -> FloatArray:
        """Values at other times, each sample holding until the next."""
        series = self.series(name)
        index = np.searchsorted(series.time, np.asarray(time, dtype=float) + 1e-9, side="right")
        return np.asarray(series.value[np.maximum(index - 1, 0)])

    def only(self, names: list[str]) -> Log:
        """The log with these signals alone; "time" always stays.

        Raises:
          InputError: the log lacks one of them.
        """
        for name in names:
            self.series(name)
        return Log({k: v for k, v in self.signals.items() if k in names or k == "time"})
