"""Open-loop drives of the truck at a held speed, their records, and measures of time histories."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from iits_mj.analytic import UnitHistories
from iits_mj.core.arrays import FloatArray
from iits_mj.core.errors import InputError
from iits_mj.core.messages import EgoState, VehicleCommand, XbrMode
from iits_mj.parameters import TruckParameters
from iits_mj.parameters.mass_state import group_center
from iits_mj.road import Route
from iits_mj.truck import Truck

# Period of recording and of the speed hold [s].
PERIOD = 0.01
# Pedal per speed error [s/m], and its integral [1/m]: time constants of about 4 and 10 s at 55 t.
_GAIN = 0.5
_INTEGRAL = 0.05
# The speed is steady when its error stays in this band [m/s] for this time [s]; greatest time until
# then [s].
_STEADY_BAND = 0.003
_STEADY_TIME = 1.0
_STEADY_LIMIT = 90.0


def fit(signal: FloatArray, reference: FloatArray) -> float:
    """Returns `100 (1 - |y - y_ref| / |y_ref - mean(y_ref)|)` [%], NaN for a constant reference."""
    spread = np.linalg.norm(reference - reference.mean())
    if spread == 0.0:
        return float("nan")
    return float(100.0 * (1.0 - np.linalg.norm(signal - reference) / spread))


def peak_ratio(signal: FloatArray, reference: FloatArray) -> float:
    """Returns the ratio of the greatest magnitudes of signal and reference."""
    return float(np.max(np.abs(signal)) / np.max(np.abs(reference)))


def harmonic(
    time: FloatArray, signal: FloatArray, frequencies: FloatArray
) -> NDArray[np.complex128]:
    """Returns complex amplitudes (k,) of a signal (n,) at frequencies [Hz] (k,), by least squares.

    A constant and a drift are removed. The amplitude `c` means `Re(c exp(2 pi i f t))`.
    """
    phase = 2.0 * np.pi * np.outer(time, frequencies)
    basis = np.hstack([np.cos(phase), np.sin(phase), np.ones((len(time), 1)), time[:, None]])
    found = np.linalg.lstsq(basis, signal, rcond=None)[0]
    count = len(frequencies)
    return np.asarray(found[:count] - 1j * found[count : 2 * count])


@dataclass(frozen=True)
class SteeringRecord(UnitHistories):
    """Time histories of a steered maneuver of n units every 10 ms; SI, ISO 8855.

    Attributes of shape (m,) where not noted:
      time, speed; steering_wheel: actual angle; road_wheel: mean of left and right.
      yaw, lateral_velocity: of the steer axle's center, frame of the lead unit.
      x, y: steer axle's center.
      rear_x, rear_y: center of the last unit's axle group.
      yaw_rates: of the units, shape (m, n).
      articulations: yaw ahead minus yaw behind, shape (m, n - 1).
      lateral_accelerations: of the units' CGs, gravity removed, shape (m, n).
      rolls: of the units, positive to the right, shape (m, n).
    """

    time: FloatArray
    speed: FloatArray
    steering_wheel: FloatArray
    road_wheel: FloatArray
    yaw: FloatArray
    x: FloatArray
    y: FloatArray
    lateral_velocity: FloatArray
    rear_x: FloatArray
    rear_y: FloatArray
    yaw_rates: FloatArray
    articulations: FloatArray
    lateral_accelerations: FloatArray
    rolls: FloatArray

    @property
    def rear_yaw(self) -> FloatArray:
        """Of the last unit [rad]."""
        return np.asarray(self.yaw - self.articulations.sum(axis=1))

    def poses(self, parameters: TruckParameters, payload: float) -> FloatArray:
        """Poses of the center of each unit's rear axle group: x, y [m], yaw [rad], (m, n, 3)."""
        at, yaw, found = np.column_stack([self.x, self.y]), self.yaw, []
        for index, unit in enumerate(parameters.units):
            if unit.coupling is not None:
                at = at - unit.coupling.position * _direction(yaw)
                yaw = yaw - self.articulations[:, index - 1]
            center = at - group_center(unit.groups(payload)[-1]) * _direction(yaw)
            found.append(np.column_stack([center, yaw]))
        return np.stack(found, axis=1)

    def after(self, start: float) -> SteeringRecord:
        """Returns the record from a time [s] on, with the time counted from there."""
        keep = self.time >= start - 1e-9
        columns = {name: getattr(self, name)[keep] for name in self.__dataclass_fields__}
        columns["time"] = columns["time"] - columns["time"][0]
        return SteeringRecord(**columns)


def _direction(angle: FloatArray) -> FloatArray:
    return np.column_stack([np.cos(angle), np.sin(angle)])


class SpeedHold:
    """Cruise control by pedal and, well above the set speed, light braking."""

    def __init__(self) -> None:
        self._integral = 0.0

    def command(self, error: float, steering_wheel_angle: float) -> VehicleCommand:
        """Returns the command of a speed error [m/s] and a steering angle [rad], every `PERIOD`."""
        pedal = _GAIN * error + self._integral
        if 0.0 < pedal < 1.0:  # no wind-up at the pedal's ends
            self._integral += _INTEGRAL * error * PERIOD
        braking = error < -0.3
        return VehicleCommand(
            accelerator_pedal=float(np.clip(pedal, 0.0, 1.0)),
            steering_wheel_angle=steering_wheel_angle,
            xbr_mode=XbrMode.MAXIMUM if braking else XbrMode.OFF,
            xbr_demand=max(2.0 * error, -3.0) if braking else 0.0,
        )


def placed_truck(
    parameters: TruckParameters,
    payload: float,
    timestep: float,
    route: Route | None = None,
    **start: float,
) -> Truck:
    """The truck without visual geoms, on a plane or a route; `start` is passed to `Truck.reset`."""
    truck = Truck.load(
        payload, parameters=parameters, route=route, timestep=timestep, visuals=False
    )
    truck.reset(**start)
    return truck


def run_straight(truck: Truck, speed: float) -> SpeedHold:
    """Drives straight on until the speed [m/s] is steady; returns the speed hold to continue with.

    Call `truck.reset` before.

    Raises:
      InputError: the truck does not reach and keep this speed.
    """
    hold = SpeedHold()
    quiet, start = 0.0, truck.time
    while quiet < _STEADY_TIME:
        error = speed - truck.observe().speed
        quiet = quiet + PERIOD if abs(error) < _STEADY_BAND else 0.0
        if truck.time - start > _STEADY_LIMIT:
            raise InputError(
                f"speed {speed:g} m/s is not steady after {_STEADY_LIMIT:g} s: {error:+.3f} m/s "
                "are missing; choose a speed that the truck can hold on a level road"
            )
        truck.command(hold.command(error, 0.0))
        truck.step(round(PERIOD / truck.model.opt.timestep))
    return hold


def drive(
    truck: Truck,
    steering: Callable[[float, float], float],
    *,
    speed: float | Callable[[float], float],
    duration: float,
    stop: Callable[[EgoState], bool] | None = None,
    hold: SpeedHold | None = None,
) -> SteeringRecord:
    """Runs a maneuver from the truck's present state (call `truck.reset` before).

    Args:
      truck: on a road of sufficient length.
      steering: steering-wheel angle [rad] by (time [s], yaw [rad]).
      speed: set speed [m/s], or a function of time.
      duration: at most [s].
      stop: ends the run early.
      hold: the speed hold of `run_straight` to continue with; default: a new one.
    """
    keeper = hold or SpeedHold()
    wanted = speed if callable(speed) else lambda _: speed

    def command(time: float, state: EgoState) -> VehicleCommand:
        return keeper.command(wanted(time) - state.speed, steering(time, state.yaw))

    table = sampled(truck, command, lambda state: _row(truck, state), duration, stop)
    units = len(truck.parameters.units)
    *parts, rolls = np.split(table, np.cumsum([10, units, units - 1, units]), axis=1)
    return SteeringRecord(*(*parts[0].T, *parts[1:], rolls))


def sampled(
    truck: Truck,
    command: Callable[[float, EgoState], VehicleCommand],
    read: Callable[[EgoState], list[float]],
    duration: float,
    stop: Callable[[EgoState], bool] | None = None,
) -> FloatArray:
    """Drives the truck from its present state and samples it every 10 ms.

    Args:
      truck: call its `reset` before.
      command: by time since the start [s] and state.
      read: gives the k numbers of a sample.
      duration: at most [s].
      stop: ends the run early.

    Returns:
      Time [s] and the numbers, shape (n, 1 + k).
    """
    start, timestep = truck.time, truck.model.opt.timestep
    rows: list[list[float]] = []
    for tick in range(round(duration / PERIOD) + 1):
        state = truck.observe()
        rows.append([tick * PERIOD, *read(state)])
        if stop is not None and stop(state):
            break
        truck.command(command(tick * PERIOD, state))
        truck.step(round((start + (tick + 1) * PERIOD - truck.time) / timestep))
    return np.array(rows)


def wheel_slips(truck: Truck) -> list[float]:
    """Returns the longitudinal slip of each wheel [1], axle by axle, left before right."""
    return [
        truck.read(f"{axle.name}_{side}_tire_slip")
        for axle in truck.parameters.axles
        for side in ("left", "right")
    ]


def unit_roll(truck: Truck, unit: int = -1) -> float:
    """Returns the roll of a unit [rad], positive to the right; default: the last one."""
    attitude = truck.data.body(truck.parameters.units[unit].name).xmat
    return float(np.arctan2(attitude[7], attitude[8]))


def unit_lateral_acceleration(truck: Truck, unit: int = -1) -> float:
    """Returns the lateral acceleration of a unit's CG, gravity removed [m/s2]."""
    name = truck.parameters.units[unit].name
    axes = truck.data.body(name).xmat.reshape(3, 3)
    gravity = float(axes[:, 1] @ truck.model.opt.gravity)
    return truck.read(f"{name}_acceleration", 1) + gravity


def _row(truck: Truck, state: EgoState) -> list[float]:
    """Returns a sample of the last observation, in the order of `SteeringRecord` after time."""
    units = truck.parameters.units
    rear = truck.data.site(f"{units[-1].name}_axle_center").xpos
    bent = (state.articulation, *state.rear_articulations) if len(units) > 1 else ()
    return [
        state.speed,
        state.steering_wheel_angle,
        state.road_wheel_angle,
        state.yaw,
        state.x,
        state.y,
        # The integrator's velocities are half a step older than its positions.
        state.lateral_speed + 0.5 * truck.model.opt.timestep * state.speed * state.yaw_rate,
        float(rear[0]),
        float(rear[1]),
        *(truck.read(f"{unit.name}_gyro", 2) for unit in units),
        *bent,
        *(unit_lateral_acceleration(truck, index) for index in range(len(units))),
        *(unit_roll(truck, index) for index in range(len(units))),
    ]
