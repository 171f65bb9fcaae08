"""Steady circle of 100 m radius (ISO 14792, constant radius): understeer, and its limit.

The references are evaluated like the truck: the road-wheel angle at each measured lateral
acceleration and radius, less the share of the wheelbase, and the slope of a line through these.
"""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import PchipInterpolator

from iits_mj.analytic import Kinematic, YawPlane, yaw_rate_gain
from iits_mj.core.arrays import FloatArray
from iits_mj.core.results import Findings, Line
from iits_mj.core.units import GRAVITY
from iits_mj.parameters import TruckParameters
from iits_mj.truck import Truck
from iits_mj.validation.handling.roll_plane import RollPlane
from iits_mj.validation.handling.steady_turn import SteadyTurn
from iits_mj.validation.handling.step_steer import free_couplings
from iits_mj.validation.harness.maneuver import restore_state, save_state, steady_truck
from iits_mj.validation.harness.recorder import (
    PERIOD,
    SpeedHold,
    SteeringRecord,
    drive,
    unit_roll,
)

RADIUS = 100.0
# Lateral acceleration up to which the gradient is measured [m/s2].
LINEAR = 2.0
_SETTLE = 8.0
_AVERAGE = 4.0
# Natural frequency of the driver, who keeps the radius [rad/s].
_DRIVER = 0.6
# Speeds of upshifts relative to the shipped table: the driver holds the gear by hand.
_LATER = 1.3
# Least speed [m/s], growth of speed [m/s2], and its steps at first and at the limit [m/s].
_SLOWEST, _RAMP, _COARSE, _FINE = 6.0, 0.15, 2.0, 0.25
# Speed and yaw rate are steady when they change by less than this share in a window; the greatest
# number of windows. A circle is held within these errors of radius [m] and speed [m/s], and this
# change of speed and yaw rate [1].
_STEADY, _WINDOWS = 0.002, 8
_HELD, _HELD_SPEED, _HELD_SWAY = 1.0, 0.3, 0.02
# A circle is lost when the trailer rolls beyond this [rad] or the steer axle is this far off [m].
_ROLLED, _LOST = np.deg2rad(15.0), 6.0
# Allowed error of the statics with the full law of the tires, up to `LINEAR` [%].
_ERROR = 10.0
# The tires saturate when the slope near the end exceeds the slope at the beginning by this factor.
_SATURATED = 1.5
# Near the end: between these shares of the static roll-over threshold, at any time step.
_LATE = (0.6, 0.8)
_SCALE = float(np.rad2deg(GRAVITY))  # from rad s2/m to deg/g


@dataclass(frozen=True)
class Circle:
    """Steady states on the circle, each of shape (k,).

    Attributes:
      lateral: lateral acceleration [m/s2]; steer: road-wheel angle less the share of the
        wheelbase [rad].
      linear, saturating: the same of the yaw-sideslip model, and of the statics with the full law
        of the tires; NaN beyond its limit.
      gradient: slope of steer over lateral [rad s2/m]; reference: slope of the linear model;
        saturating_gradient: slope of the statics.
    """

    lateral: FloatArray
    steer: FloatArray
    linear: FloatArray
    saturating: FloatArray
    gradient: float
    reference: float
    saturating_gradient: float


def circle(
    parameters: TruckParameters, payload: float, timestep: float, speeds: tuple[float, ...]
) -> Circle:
    """Drives the circle at rising speeds [m/s], each until it is steady."""
    run = _Staircase.start(parameters, payload, timestep, speeds[0])
    records = [run.climb(speed) for speed in speeds]
    return _circle(run.truck, records)


def limit(parameters: TruckParameters, payload: float, timestep: float) -> tuple[Circle, str]:
    """Drives faster and faster until the circle cannot be held; also returns the reason, in words.

    The first steps of speed [m/s] are coarse; they shrink near the limit.
    """
    run = _Staircase.start(parameters, payload, timestep, _SLOWEST)
    records, speed, step = [run.climb(_SLOWEST)], _SLOWEST, _COARSE
    while True:
        before = run.save()
        record = run.climb(speed + step)
        end = _ending(record, speed + step)
        if not end:
            records.append(record)
            speed += step
        elif step > _FINE:
            run.load(before)
            step *= 0.5
        else:
            return _circle(run.truck, records), end


class _Staircase:
    """The truck on the circle, driven from one steady speed to the next."""

    def __init__(self, truck: Truck, hold: SpeedHold, speed: float) -> None:
        self.truck = truck
        self._hold = hold
        self._speed = speed
        self._drift = 0.0
        self._begin = float(truck.data.body("tractor").xpos[0])
        # In the linear model steer angle times radius is a constant plus a multiple of v^2.
        model = YawPlane.from_parameters(truck.parameters, truck.payload, cruise_speed=speed)
        slow, fast = (v / yaw_rate_gain(model.at(v)) for v in (5.0, 15.0))
        self._slope = (fast - slow) / (15.0**2 - 5.0**2)
        self._base = slow - self._slope * 5.0**2

    @classmethod
    def start(
        cls, parameters: TruckParameters, payload: float, timestep: float, speed: float
    ) -> _Staircase:
        """The truck on the straight at this speed [m/s], at the entry of the circle."""
        # In a bend the automatic gearbox would change between two gears.
        driven = gears_held(free_couplings(parameters))
        return cls(*steady_truck(payload, speed, timestep, parameters=driven), speed)

    def climb(self, speed: float) -> SteeringRecord:
        """Returns the last seconds at a new speed [m/s], when it is steady or the time is over."""
        before, self._speed = self._speed, speed
        rise = abs(speed - before) / _RAMP

        def ramp(time: float) -> float:
            return before + (speed - before) * min(time / max(rise, 1e-9), 1.0)

        record = self._drive(rise + _SETTLE, ramp)
        for _ in range(_WINDOWS):
            if self._lost():
                break
            record = self._drive(_AVERAGE, lambda _: speed)
            if _sway(record) < _STEADY:
                break
        return record

    def _drive(self, duration: float, speed: Callable[[float], float]) -> SteeringRecord:
        return drive(
            self.truck,
            self._steering,
            speed=speed,
            duration=duration,
            hold=self._hold,
            stop=lambda _: self._lost(),
        )

    def save(self) -> tuple[FloatArray, SpeedHold, float, float]:
        """State for a later `load`."""
        return save_state(self.truck), copy.copy(self._hold), self._speed, self._drift

    def load(self, saved: tuple[FloatArray, SpeedHold, float, float]) -> None:
        """Returns to a saved state."""
        restore_state(self.truck, saved[0])
        self._hold, self._speed, self._drift = copy.copy(saved[1]), saved[2], saved[3]

    def _outside(self) -> tuple[float, float]:
        """Distance outside of the circle [m], and direction of the circle at this place [rad]."""
        position = self.truck.data.body("tractor").xpos
        east, north = float(position[0]) - self._begin, float(position[1]) - RADIUS
        return float(np.hypot(east, north)) - RADIUS, float(np.arctan2(east, -north))

    def _steering(self, _: float, yaw: float) -> float:
        velocity = self.truck.data.sensor("tractor_velocity").data
        speed = max(float(velocity[0]), 1.0)
        outside, direction = self._outside()
        course = yaw + np.arctan2(float(velocity[1]), speed)
        error = float(np.angle(np.exp(1j * (direction - course))))
        self._drift += PERIOD * outside
        # The integral brings the distance to zero.
        wanted = _DRIVER**2 * (outside + 0.15 * self._drift) + 1.6 * _DRIVER * speed * error
        angle = (self._base + self._slope * speed**2) * (1.0 / RADIUS + wanted / speed**2)
        return float(self.truck.parameters.steering.ratio * np.clip(angle, -0.6, 0.6))

    def _lost(self) -> bool:
        rolled = abs(unit_roll(self.truck)) > _ROLLED
        return rolled or abs(self._outside()[0]) > _LOST


def _circle(truck: Truck, records: list[SteeringRecord]) -> Circle:
    """Steady states of recordings, and of the references at the same speed and radius."""
    wheelbase = Kinematic.from_parameters(truck.parameters).L
    turn = SteadyTurn.from_parameters(truck.parameters, truck.payload)
    rows = []
    for record in records:
        rate, speed = float(record.yaw_rate.mean()), float(record.speed.mean())
        curvature, lateral = rate / speed, rate * speed
        model = YawPlane.from_parameters(truck.parameters, truck.payload, cruise_speed=speed)
        linear = rate / yaw_rate_gain(model.at(speed))
        statics = turn.steer(1.0 / curvature, lateral)
        angles = np.array([record.road_wheel.mean(), linear, statics])
        rows.append([lateral, *(angles - wheelbase * curvature)])
    accelerations, *curves = np.array(rows).T
    low = accelerations <= LINEAR
    slopes = [float(np.polyfit(accelerations[low], y[low], 1)[0]) for y in curves]
    return Circle(accelerations, *curves, *slopes)


def gears_held(parameters: TruckParameters) -> TruckParameters:
    """Parameters with later upshifts, as by a driver who holds the gear by hand."""
    table = parameters.gearbox.upshift
    later = replace(table, values=_LATER * table.values)
    return replace(parameters, gearbox=replace(parameters.gearbox, upshift=later))


def _ending(record: SteeringRecord, speed: float) -> str:
    """Reason why the circle was not held at a speed [m/s]; "" if it was held."""
    if np.max(np.abs(record.trailer_roll)) > _ROLLED:
        return "roll-over"
    if float(record.speed.mean()) < speed - _HELD_SPEED:
        return "the engine no longer holds the speed against the drag of the turn"
    radius = float(record.speed.mean() / record.yaw_rate.mean())
    if abs(radius - RADIUS) < _HELD and _sway(record) < _HELD_SWAY:
        return ""
    # The truck runs wide when the steer axle slides, and turns in when the drive axles slide.
    return "steer axle slides" if radius > RADIUS else "drive axles slide"


def _sway(record: SteeringRecord) -> float:
    """Greatest change of speed and yaw rate as a share of their means [1]."""
    return max(
        float(np.ptp(signal) / abs(np.mean(signal))) for signal in (record.speed, record.yaw_rate)
    )


def compare(
    parameters: TruckParameters,
    payload: float,
    timestep: float,
    speeds: tuple[float, ...],
    linear_must: str = "<= 10",
) -> Findings:
    """Understeer at some speeds [m/s] against the linear model and the statics."""
    done = circle(parameters, payload, timestep, speeds)
    found = Findings(f"steady circle of {RADIUS:g} m, {payload / 1e3:g} t")
    errors = [
        100.0 * abs(done.gradient / reference - 1.0)
        for reference in (done.reference, done.saturating_gradient)
    ]
    found.check("understeer", done.gradient * _SCALE, "deg/g", done.reference * _SCALE)
    found.check("understeer error", errors[0], "%", "yaw-sideslip", linear_must)
    found.check(
        "understeer error of the statics with load transfer, rolling resistance and bending tires",
        errors[1],
        "%",
        done.saturating_gradient * _SCALE,
        "<= 10",
    )
    _panel(
        found,
        Line("yaw-sideslip model", done.lateral, np.rad2deg(done.linear), "reference"),
        Line("statics of the steady turn", done.lateral, np.rad2deg(done.saturating)),
        Line("truck", done.lateral, np.rad2deg(done.steer), "simulation"),
    )
    return found


def compare_limit(parameters: TruckParameters, payload: float, timestep: float) -> Findings:
    """Understeer up to the limit of the circle, with a note on what ended it."""
    done, end = limit(parameters, payload, timestep)
    found = Findings(f"ISO 14792 circle of {RADIUS:g} m, {payload / 1e3:g} t")
    plane = RollPlane.from_parameters(parameters, payload)
    last = _late_slope(done, GRAVITY * plane.threshold())
    statics, linear = done.saturating_gradient, done.reference
    name = f"understeer to {LINEAR:g} m/s2"
    found.check(name, done.gradient * _SCALE, "deg/g", statics * _SCALE)
    error = 100.0 * abs(done.gradient / statics - 1.0)
    found.check("understeer error to the statics", error, "%", must=f"<= {_ERROR:g}")
    error = 100.0 * abs(done.gradient / linear - 1.0)
    found.check("understeer error to the linear model", error, "%", linear * _SCALE)
    found.check("greatest lateral acceleration", done.lateral[-1] / GRAVITY, "g")
    name = "slope near the end over slope at the beginning"
    found.check(name, last / done.gradient, "1", must=f">= {_SATURATED:g}")
    statics_line = np.rad2deg(done.saturating)
    _panel(
        found,
        Line("statics with the tires' whole law", done.lateral, statics_line, "reference"),
        Line("truck", done.lateral, np.rad2deg(done.steer), "simulation"),
        Line("yaw-sideslip model", done.lateral, np.rad2deg(done.linear)),
    )
    found.notes.append(f"{found.label} ends at {done.lateral[-1]:.2f} m/s2: {end}.")
    return found


def _panel(found: Findings, *lines: Line) -> None:
    found.panel("", "lateral acceleration [m/s2]", "steer beyond Ackermann [deg]", *lines)


def _late_slope(found: Circle, threshold: float) -> float:
    """Slope of steer over lateral acceleration near the end [rad s2/m]; NaN if it is not reached.

    The end is near the roll-over threshold [m/s2].
    """
    # At the limit a faster circle may be wider: only states with more acceleration count.
    before = np.maximum.accumulate(np.concatenate([[-np.inf], found.lateral[:-1]]))
    further = found.lateral > before
    steer = PchipInterpolator(found.lateral[further], found.steer[further], extrapolate=False)
    low, high = (share * threshold for share in _LATE)
    return float((steer(high) - steer(low)) / (high - low))
