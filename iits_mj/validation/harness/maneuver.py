"""Shared parts of maneuvers: the truck at a steady speed, its full state, and a record of a run."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, fields
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from iits_mj.core.arrays import FloatArray
from iits_mj.core.messages import EgoState, VehicleCommand
from iits_mj.truck import Truck
from iits_mj.validation.harness.recorder import SpeedHold, run_straight, sampled, wheel_slips

_EVERYTHING = mujoco.mjtState.mjSTATE_INTEGRATION


def steady_truck(
    payload: float, speed: float, timestep: float, *, station: float = 20.0, **settings: Any
) -> tuple[Truck, SpeedHold]:
    """The truck on a straight at a steady speed [m/s], and the speed hold to continue with.

    It starts at a station of the route [m]. `settings` are other arguments of `Truck.load`.
    """
    truck = Truck.load(payload, timestep=timestep, visuals=False, **settings)
    truck.reset(station=station, speed=speed)
    return truck, run_straight(truck, speed)


def save_state(truck: Truck) -> NDArray[np.float64]:
    """Everything on which the next step depends, with plugin state and controls, shape (n,)."""
    state = np.empty(mujoco.mj_stateSize(truck.model, _EVERYTHING))
    mujoco.mj_getState(truck.model, truck.data, state, _EVERYTHING)
    return state


def restore_state(truck: Truck, state: NDArray[np.float64]) -> None:
    """Puts the same truck back into a saved state."""
    mujoco.mj_setState(truck.model, truck.data, state, _EVERYTHING)
    mujoco.mj_forward(truck.model, truck.data)


def first_time(time: FloatArray, reached: NDArray[np.bool_]) -> float:
    """Returns the time of the first True [s]; nan without one."""
    places = np.flatnonzero(reached)
    return float(time[places[0]]) if len(places) else float("nan")


@dataclass(frozen=True)
class Run:
    """Time histories every 10 ms, each of shape (n,) unless said otherwise; SI, ISO 8855.

    Attributes:
      time: since the start of the run [s].
      speed to fuel_used: as in `EgoState`; yaw without jumps; shift_in_process is 1 or 0.
      grade: of the road.
      wheel_slips, wheel_pressures: of each wheel, axle by axle, left before right, shape (n, 12).
      extra: further sensors by name.
    """

    time: FloatArray
    speed: FloatArray
    acceleration: FloatArray
    station: FloatArray
    x: FloatArray
    y: FloatArray
    yaw: FloatArray
    yaw_rate: FloatArray
    articulation: FloatArray
    steering_wheel_angle: FloatArray
    gear: FloatArray
    shift_in_process: FloatArray
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

    def locked_share(self, axles: slice, above: float) -> float:
        """Share of time above a speed [m/s] in which a wheel of these axles slips by over 80 %."""
        wheels = self.wheel_slips[:, 2 * axles.start : 2 * axles.stop]
        moving = self.speed > above
        return float(np.mean(np.max(np.abs(wheels[moving]), axis=1) > 0.8)) if moving.any() else 0.0

    def between(self, start: float, end: float) -> Run:
        """The part of the run between two times [s]."""
        keep = (self.time >= start - 1e-9) & (self.time < end - 1e-9)
        columns = {name: getattr(self, name)[keep] for name in _COLUMNS}
        return Run(**columns, extra={name: values[keep] for name, values in self.extra.items()})


_COLUMNS = tuple(column.name for column in fields(Run) if column.name != "extra")
_STATES = _COLUMNS[1 : _COLUMNS.index("grade")]


def run(
    truck: Truck,
    command: Callable[[float, EgoState], VehicleCommand],
    duration: float,
    stop: Callable[[EgoState], bool] | None = None,
    sensors: tuple[str, ...] = (),
) -> Run:
    """Drives the truck from its present state with a command every 10 ms.

    Args:
      truck: reset before, on its road.
      command: by time since the start [s] and state.
      duration: at most [s].
      stop: ends the run early.
      sensors: further sensors to record; nan for a sensor that the model lacks, so that its check
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
        own = [float(getattr(state, name)) for name in _STATES]
        return [*own, *wheel_slips(truck), *truck.data.sensordata[places]]

    table = sampled(truck, command, read, duration, stop)
    count = 1 + len(_STATES)
    columns = dict(zip(_COLUMNS, table[:, :count].T, strict=False))
    columns["yaw"] = np.unwrap(columns["yaw"])
    slips, pressures, others = np.split(table, np.cumsum([count, wheels, wheels]), axis=1)[1:]
    extra = dict.fromkeys(sensors, np.full(len(table), np.nan))
    return Run(
        **columns,
        grade=np.asarray(truck.route.evaluate(columns["station"]).grade),
        wheel_slips=slips,
        wheel_pressures=pressures,
        extra=extra | dict(zip(present, others.T, strict=True)),
    )
