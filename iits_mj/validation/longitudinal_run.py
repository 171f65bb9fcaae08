"""Records a straight drive under open-loop pedal and brake commands."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from iits_mj.core.arrays import FloatArray
from iits_mj.messages import EgoState, VehicleCommand
from iits_mj.truck import Truck
from iits_mj.validation.recorder import sampled, wheel_slips

# What of a run is not one number a sample of the truck's own report.
_NOT_SCALAR = ("grade", "wheel_slips", "wheel_pressures", "extra")


@dataclass(frozen=True)
class Run:
    """Time histories, each of shape (n,) unless said otherwise, every 10 ms; SI.

    Attributes:
      time, speed, acceleration, station; gear; shift: 1 while the driveline is open.
      engine_speed, engine_torque, fuel_rate, fuel_used; grade: of the road.
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
    wheel_slips: FloatArray
    wheel_pressures: FloatArray
    extra: dict[str, FloatArray] = field(default_factory=dict)

    @property
    def slip(self) -> FloatArray:
        """Greatest slip magnitude of all wheels, shape (n,)."""
        return np.asarray(np.max(np.abs(self.wheel_slips), axis=1))


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
    known = {truck.model.sensor(i).name: truck.model.sensor(i) for i in range(truck.model.nsensor)}
    present = [name for name in sensors if name in known]
    wheels = 2 * len(truck.parameters.axles)
    first = int(known["brake_pressures"].adr[0])
    places = np.array(
        [*range(first, first + wheels), *(int(known[name].adr[0]) for name in present)]
    )

    def read(state: EgoState) -> list[float]:
        return [*_row(state), *wheel_slips(truck), *truck.data.sensordata[places]]

    table = sampled(truck, command, read, duration, stop)
    scalars = [name for name in Run.__dataclass_fields__ if name not in _NOT_SCALAR]
    columns = dict(zip(scalars, table[:, : len(scalars)].T, strict=True))
    bounds = np.cumsum([len(scalars), wheels, wheels])
    slips, wheel_pressures, others = np.split(table, bounds, axis=1)[1:]
    extra = dict.fromkeys(sensors, np.full(len(table), np.nan))
    extra |= dict(zip(present, others.T, strict=True))
    return Run(
        **columns,
        grade=np.asarray(truck.route.evaluate(columns["station"]).grade),
        wheel_slips=slips,
        wheel_pressures=wheel_pressures,
        extra=extra,
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
