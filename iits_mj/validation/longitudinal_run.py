"""Records a straight drive under open-loop pedal and brake commands."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from iits_mj.identification import Log
from iits_mj.identification.log import PRESSURES
from iits_mj.messages import EgoState, VehicleCommand
from iits_mj.truck import Truck
from iits_mj.validation.recorder import sampled, wheel_slips

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Run:
    """Time histories, each of shape (n,), every 10 ms; SI.

    Attributes:
      time, speed, acceleration, station; gear; shift: 1 while the driveline is open.
      engine_speed, engine_torque, fuel_rate, fuel_used.
      pressures: front left, front right, rear left, rear right, trailer, shape (n, 5).
      pitch; grade: of the road; slip: greatest longitudinal slip magnitude of all wheels.
    """

    time: FloatArray
    speed: FloatArray
    acceleration: FloatArray
    station: FloatArray
    gear: FloatArray
    shift: FloatArray
    engine_speed: FloatArray
    engine_torque: FloatArray
    fuel_rate: FloatArray
    fuel_used: FloatArray
    grade: FloatArray
    slip: FloatArray
    pressures: FloatArray

    def log(self, stride: int = 1) -> Log:
        """The run as a log for the longitudinal model."""
        columns = {
            "time": self.time,
            "speed": self.speed,
            "grade": self.grade,
            "gear": self.gear,
            "engine_torque": self.engine_torque,
            "shift_in_process": self.shift,
            **{name: self.pressures[:, i] for i, name in enumerate(PRESSURES)},
        }
        return Log({name: values[::stride] for name, values in columns.items()})


def run(
    truck: Truck,
    command: Callable[[float, EgoState], VehicleCommand],
    duration: float,
    stop: Callable[[EgoState], bool] | None = None,
) -> Run:
    """Drives the truck as it stands (call `truck.reset` before), commands each 10 ms.

    Args:
      truck: on its road.
      command: by time since the start [s] and state.
      duration: at most [s].
      stop: ends the run early.
    """

    def read(state: EgoState) -> list[float]:
        grade = float(truck.route.evaluate(state.station, state.offset).grade)
        slip = max(abs(value) for value in wheel_slips(truck))
        return [*_row(state), grade, slip, *state.brake_pressures]

    table = sampled(truck, command, read, duration, stop)
    names = list(Run.__dataclass_fields__)[:-1]
    columns = dict(zip(names, table[:, : len(names)].T, strict=True))
    return Run(**columns, pressures=table[:, len(names) :])


def _row(state: EgoState) -> list[float]:
    return [
        state.speed,
        state.acceleration,
        state.station,
        float(state.gear),
        float(state.shift_in_process),
        state.engine_speed,
        state.engine_torque,
        state.fuel_rate,
        state.fuel_used,
    ]
