"""Rearward amplification in lane changes: a sine at the steering wheel, and a path.

ISO 14791 has one full sine of 0.4 Hz at the steering wheel, open loop. It compares the center of
gravity of the last unit with the steer axle of the first unit.

In SAE J2179 and the Australian Performance Based Standards (PBS) the steer axle follows the path
`y = a / w^2 (w t - sin w t)` over one period of 2.5 s with a = 0.15 g: it moves 1.46 m to the left,
in the standard at 88 km/h. Transient off-tracking is how far the last axle swings beyond the final
line of the path. The driver has practiced: the first try steers by the inverse of the linear model
(the road-wheel angle that moves the steer axle along the path), and each further try adds the
inverse of the remaining error, so the last run is a smooth open-loop input.

PBS allows an amplification of 5.7 times the roll-over threshold in g, and an off-tracking by level,
0.6 m on level 1. These numbers are not checked against the text of the PBS Rules.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass

import numpy as np
from scipy import signal

from iits_mj.analytic import (
    LateralSystem,
    Response,
    YawPlane,
    simulate,
    single_sine,
    unit_track,
)
from iits_mj.core.arrays import FloatArray
from iits_mj.core.results import Findings, Line
from iits_mj.core.units import KMH
from iits_mj.parameters import TruckParameters
from iits_mj.parameters.mass_state import group_center
from iits_mj.truck import Truck
from iits_mj.validation.harness.maneuver import restore_state, save_state, steady_truck
from iits_mj.validation.harness.recorder import PERIOD, SpeedHold, SteeringRecord, drive
from iits_mj.validation.pbs import maneuvers
from iits_mj.validation.pbs.limits import STANDARDS, level_of_length

# PBS: rearward amplification is at most this many times the roll-over threshold in g.
PBS_FACTOR = STANDARDS["amplification"].limits[0]
# The sine: frequency [Hz], peak lateral acceleration of the steer axle [m/s2], and allowed error of
# the held speed [km/h], a choice of this project.
SINE_FREQUENCY = 0.4
SINE_PEAK = 1.5
SPEED_TOLERANCE = 1.0
_SINE_LEAD, _SINE_LENGTH = 0.5, 10.0
_PATH = maneuvers.LaneChange()
# How far the steer axle may leave the path (SAE J2179) [m].
PATH_TOLERANCE = 0.15
_LEAD, _LENGTH = 1.0, 7.0
# End of the path since the start of a recording [s].
_PATH_END = _LEAD + _PATH.period
# Tries after the first one, and the band in which the driver corrects [Hz].
_REPEATS = 3
_BAND = 1.5


def steer_axle_acceleration(record: SteeringRecord) -> FloatArray:
    """Lateral acceleration of the steer axle's center on the ground [m/s2], shape (n,)."""
    return np.asarray(
        np.gradient(record.lateral_velocity, record.time) + record.speed * record.yaw_rate
    )


def linear_system(truck: Truck, speed: float) -> LateralSystem:
    """The yaw-sideslip model of this truck at this speed [m/s], with axle loads as at cruise."""
    model = YawPlane.from_parameters(truck.parameters, truck.payload, cruise_speed=speed)
    return model.at(speed)


@dataclass(frozen=True)
class LaneChange:
    """A lane change of the truck, and the linear model's answer.

    Attributes:
      recording: of the truck; model: of the linear model `system`.
    """

    recording: SteeringRecord
    model: Response
    system: LateralSystem

    def front(self) -> FloatArray:
        """Lateral acceleration of the steer axle in the lane change [m/s2]."""
        return steer_axle_acceleration(self.recording)

    def amplification(self) -> float:
        """Rearward amplification of the truck [1]."""
        rear = np.max(np.abs(self.recording.trailer_lateral_acceleration))
        return float(rear / np.max(np.abs(self.front())))

    def model_amplification(self) -> float:
        """Rearward amplification of the linear model [1]."""
        rear = np.max(np.abs(self.model.trailer_lateral_acceleration))
        return float(rear / np.max(np.abs(self.model.steer_axle_acceleration)))

    def peak(self) -> float:
        """Greatest lateral acceleration of the steer axle [m/s2]."""
        return float(np.max(np.abs(self.front())))

    def speed_error(self) -> float:
        """Greatest deviation from the wanted speed [km/h]."""
        return float(np.max(np.abs(self.recording.speed - self.system.speed)) / KMH)


def sine_steer(
    parameters: TruckParameters, payload: float, speed: float, timestep: float
) -> LaneChange:
    """One sine at this speed [m/s]; the linear model sets its size for `SINE_PEAK`."""
    truck, hold = steady_truck(payload, speed, timestep, parameters=parameters)
    system = linear_system(truck, speed)
    time, unit = single_sine(1.0 / SINE_FREQUENCY, 1.0 / SINE_FREQUENCY + 4.0)
    answer = simulate(system, time, 1e-3 * unit)
    per_steer = float(np.max(np.abs(answer.steer_axle_acceleration))) / 1e-3
    height = SINE_PEAK / per_steer * truck.parameters.steering.ratio

    def steering(time: float, _: float) -> float:
        phase = (time - _SINE_LEAD) * SINE_FREQUENCY
        return float(height * np.sin(2.0 * np.pi * phase)) if 0.0 <= phase <= 1.0 else 0.0

    duration = _SINE_LEAD + _SINE_LENGTH
    record = drive(truck, steering, speed=speed, duration=duration, hold=hold)
    return LaneChange(record, simulate(system, record.time, record.road_wheel), system)


def compare_sine(
    parameters: TruckParameters, payload: float, kph: float, threshold: float, timestep: float
) -> Findings:
    """The sine at one speed [km/h]; threshold: static roll-over threshold [g]."""
    done = sine_steer(parameters, payload, kph * KMH, timestep)
    found = Findings(f"ISO 14791 single sine, {payload / 1e3:g} t, {kph:g} km/h")
    name, most = "rearward amplification", f"<= {PBS_FACTOR * threshold:.2f}"
    found.check(name, done.amplification(), "1", done.model_amplification(), most)
    found.check("peak at the steer axle", done.peak(), "m/s2", SINE_PEAK)
    found.check("speed error", done.speed_error(), "km/h", must=f"<= {SPEED_TOLERANCE:g}")
    record, model, time = done.recording, done.model, done.recording.time - _SINE_LEAD
    for name, wanted, measured in (
        ("steer axle", model.steer_axle_acceleration, steer_axle_acceleration(record)),
        ("trailer", model.trailer_lateral_acceleration, record.trailer_lateral_acceleration),
    ):
        linear = Line(f"yaw-sideslip model, {name}", time, wanted, "reference")
        truck = Line(f"truck, {name}", time, measured, "simulation")
        found.panel(name, "time [s]", "lateral acceleration [m/s2]", linear, truck)
    return found


@dataclass(frozen=True)
class PathChange(LaneChange):
    """The truck on the path, and the linear model on the path without error.

    Attributes:
      last, model_last: tracks of the last axle's center from the start, (n, 2) [m].
      error: greatest distance of the steer axle from the path [m].
    """

    last: FloatArray
    model_last: FloatArray
    error: float

    def front(self) -> FloatArray:
        """As of a lane change; afterwards the driver answers the pull of the trailer."""
        return super().front()[self.recording.time <= _PATH_END]

    def off_tracking(self) -> float:
        """High-speed transient off-tracking [m]; zero if the last axle does not swing beyond."""
        return max(float(np.max(self.last[:, 1])) - _PATH.offset, 0.0)

    def model_off_tracking(self) -> float:
        """Off-tracking of the linear model [m]."""
        return max(float(np.max(self.model_last[:, 1])) - _PATH.offset, 0.0)


def inverse_steer(system: LateralSystem, time: FloatArray, acceleration: FloatArray) -> FloatArray:
    """Road-wheel angle [rad], (n,), for a lateral acceleration of the steer axle [m/s2], (n,).

    `a = C s + D delta` of the linear model is solved for delta, and inserted into
    `s' = A s + B delta`.
    """
    model = system.model
    lever = model.reference - float(model.position[0])
    row = system.A[0] + lever * system.A[1]
    row[1] += system.speed
    direct = float(system.B[0] + lever * system.B[1])
    closed = system.A - np.outer(system.B, row) / direct
    output = (closed, system.B[:, None] / direct, -row[None, :] / direct, np.array([[1 / direct]]))
    return np.asarray(signal.lsim(output, acceleration, time)[1]).ravel()


def follow_path(
    parameters: TruckParameters, payload: float, speed: float, timestep: float
) -> PathChange:
    """Drives the path at this speed [m/s] several times from the same state."""
    truck, hold = steady_truck(payload, speed, timestep, parameters=parameters)
    system = linear_system(truck, speed)
    grid = np.arange(0.0, _LEAD + _LENGTH + 0.5 * _PATH.period, PERIOD)
    phase = 2.0 * np.pi * np.clip((grid - _LEAD) / _PATH.period, 0.0, 1.0)
    ideal = inverse_steer(system, grid, _PATH.peak * np.sin(phase))
    start = save_state(truck)
    steer = ideal
    record = _try(truck, steer, grid, speed, copy.copy(hold))
    for _ in range(_REPEATS):
        missing = _missing(record, _path_error(record, speed), grid)
        steer = steer + inverse_steer(system, grid, missing)
        restore_state(truck, start)
        record = _try(truck, steer, grid, speed, copy.copy(hold))
    answer = simulate(system, grid, ideal)
    group = parameters.last.groups(payload)[-1]
    last_axle = group[-1].position
    behind = last_axle - group_center(group)
    heading = record.rear_yaw
    x = record.rear_x - behind * np.cos(heading) - record.x[0]
    y = record.rear_y - behind * np.sin(heading) - record.y[0]
    last = np.column_stack([x, y])
    model_last = unit_track(answer, system, -1, last_axle)
    worst = float(np.max(np.abs(_path_error(record, speed))))
    return PathChange(record, answer, system, last, model_last, worst)


def compare_path(
    parameters: TruckParameters, payload: float, kph: float, threshold: float, timestep: float
) -> Findings:
    """The path at one speed [km/h]; threshold: static roll-over threshold [g]."""
    done = follow_path(parameters, payload, kph * KMH, timestep)
    found = Findings(f"SAE J2179 path, {payload / 1e3:g} t, {kph:g} km/h")
    level, linear = level_of_length(parameters.length), done.model_off_tracking()
    name, must = (
        f"transient off-tracking (PBS level {level})",
        STANDARDS["off_tracking"].must(level),
    )
    found.check(name, done.off_tracking(), "m", linear, must)
    name, linear = "rearward amplification (PBS)", done.model_amplification()
    found.check(name, done.amplification(), "1", linear, f"<= {PBS_FACTOR * threshold:.2f}")
    found.check("path error of the steer axle", done.error, "m", 0.0, f"<= {PATH_TOLERANCE:g}")
    record = done.recording
    x = record.x - record.x[0]
    found.panel(
        "",
        "x [m]",
        "y [m]",
        Line("path", x, _path(record, done.system.speed), "reference"),
        Line("steer axle", x, record.y - record.y[0]),
        Line("last axle, yaw-sideslip model", *done.model_last.T),
        Line("last axle", done.last[:, 0], done.last[:, 1], "simulation"),
    )
    return found


def _path(record: SteeringRecord, speed: float) -> FloatArray:
    """Lateral position of the path [m] at the stations of the steer axle, shape (n,)."""
    return maneuvers.LaneChange(speed).path(record.x - record.x[0] - _LEAD * speed)


def _path_error(record: SteeringRecord, speed: float) -> FloatArray:
    """Distance of the path to the left of the steer axle [m], shape (n,)."""
    return _path(record, speed) - (record.y - record.y[0])


def _try(
    truck: Truck, steer: FloatArray, grid: FloatArray, speed: float, hold: SpeedHold
) -> SteeringRecord:
    """One drive with a road-wheel angle [rad] over the times of the grid [s], both (n,)."""
    gear = truck.parameters.steering

    def steering(time: float, _: float) -> float:
        # The actuator lags by its time constant.
        return gear.ratio * float(np.interp(time + gear.time_constant, grid, steer))

    return drive(truck, steering, speed=speed, duration=_LEAD + _LENGTH, hold=hold)


def _missing(record: SteeringRecord, error: FloatArray, grid: FloatArray) -> FloatArray:
    """Lateral acceleration [m/s2] over the grid that would bring the steer axle onto the path."""
    numerator, denominator = signal.butter(2, _BAND, fs=1.0 / PERIOD)
    smooth = signal.filtfilt(numerator, denominator, error)
    return np.interp(grid, record.time, np.gradient(np.gradient(smooth, PERIOD), PERIOD))
