"""Records a straight drive under open-loop pedal and brake commands."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from iits_mj.messages import EgoState, VehicleCommand
from iits_mj.truck import BRAKE_PRESSURES, Truck
from iits_mj.validation.recorder import sampled, wheel_slips

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Run:
    """Time histories, each of shape (n,) unless said otherwise, every 10 ms; SI.

    Attributes:
      time, speed, acceleration, station; gear; shift: 1 while the driveline is open.
      engine_speed, engine_torque, fuel_rate, fuel_used; grade: of the road.
      pressures: front left, front right, rear left, rear right, trailer, shape (n, 5).
      wheel_slips, wheel_pressures: of each wheel, axle by axle, left before right, shape (n, 12).
      extra: further sensors by name.
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
    pressures: FloatArray
    wheel_slips: FloatArray
    wheel_pressures: FloatArray
    extra: dict[str, FloatArray] = field(default_factory=dict)

    @property
    def slip(self) -> FloatArray:
        """Greatest slip magnitude of all wheels, shape (n,)."""
        return np.asarray(np.max(np.abs(self.wheel_slips), axis=1))

    def columns(self, stride: int = 1) -> dict[str, FloatArray]:
        """Every so many samples under the names of the telemetry, as an identification takes it."""
        columns = {
            "time": self.time,
            "speed": self.speed,
            "grade": self.grade,
            "gear": self.gear,
            "engine_speed": self.engine_speed,
            "engine_torque": self.engine_torque,
            "shift_in_process": self.shift,
            **{name: self.pressures[:, i] for i, name in enumerate(BRAKE_PRESSURES)},
            **self.extra,
        }
        return {name: values[::stride] for name, values in columns.items()}


def run(
    truck: Truck,
    command: Callable[[float, EgoState], VehicleCommand],
    duration: float,
    stop: Callable[[EgoState], bool] | None = None,
    sensors: tuple[str, ...] = (),
) -> Run:
    """Drives the truck as it stands (call `truck.reset` before), commands each 10 ms.

    Args:
      truck: on its road.
      command: by time since the start [s] and state.
      duration: at most [s].
      stop: ends the run early.
      sensors: to be recorded besides; one that the model lacks reads nan, so that a check of it
        falls short.
    """
    known = {truck.model.sensor(i).name for i in range(truck.model.nsensor)}
    ends = [
        f"axle{axle + 1}_{side}"
        for axle in range(len(truck.parameters.axles))
        for side in ("left", "right")
    ]
    wheels = [f"brake_pressure_{end}" for end in ends]

    def read(state: EgoState) -> list[float]:
        return [
            *_row(state),
            float(truck.route.evaluate(state.station, state.offset).grade),
            *state.brake_pressures,
            *wheel_slips(truck),
            *[truck.read(name) if name in known else np.nan for name in (*wheels, *sensors)],
        ]

    table = sampled(truck, command, read, duration, stop)
    names = list(Run.__dataclass_fields__)[:-4]
    columns = dict(zip(names, table[:, : len(names)].T, strict=True))
    bounds = np.cumsum([len(names), len(BRAKE_PRESSURES), len(ends), len(wheels)])
    pressures, slips, wheel_pressures, extra = np.split(table, bounds, axis=1)[1:]
    return Run(
        **columns,
        pressures=pressures,
        wheel_slips=slips,
        wheel_pressures=wheel_pressures,
        extra=dict(zip(sensors, extra.T, strict=True)),
    )


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
