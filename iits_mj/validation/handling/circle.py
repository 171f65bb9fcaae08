"""Steady circle of 100 m radius (ISO 14792, constant radius): understeer, and what ends it.

The references are asked the same as the truck: the road-wheel angle at each measured lateral
acceleration and radius, less the wheelbase's share, and the slope of a line through these.
"""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import PchipInterpolator

from iits_mj.analytic import Kinematic, YawSideslip, yaw_rate_gain
from iits_mj.core.arrays import FloatArray
from iits_mj.core.results import Check, Line, Panel
from iits_mj.core.units import GRAVITY
from iits_mj.parameters import TruckParameters
from iits_mj.truck import Truck
from iits_mj.validation.handling.roll_plane import RollPlane
from iits_mj.validation.handling.steady_turn import SteadyTurn
from iits_mj.validation.handling.step_steer import FREE_HITCH
from iits_mj.validation.harness.config import restore, state_of
from iits_mj.validation.harness.recorder import (
    PERIOD,
    Recording,
    SpeedHold,
    drive,
    run_straight,
    trailer_roll,
)

RADIUS = 100.0
# Lateral acceleration up to which a gradient is taken [m/s2].
LINEAR = 2.0
_START = 20.0
_SETTLE = 8.0
_AVERAGE = 4.0
# Natural frequency of the driver who keeps the radius [rad/s].
_DRIVER = 0.6
# Speeds of upshifts against the shipped table, as of a driver who holds the gear by hand.
_LATER = 1.3
# Lowest speed [m/s], growth of speed [m/s2], and its steps at the limit [m/s].
_SLOWEST, _RAMP, _FINE = 6.0, 0.15, 0.25
# Speed and yaw rate are steady when they change by this share within a window; so many windows are
# waited for. A circle is held when radius [m] and speed [m/s] are right within these, and speed and
# yaw rate change by no more than this share.
_STEADY, _WINDOWS = 0.002, 8
_HELD, _HELD_SPEED, _HELD_SWAY = 1.0, 0.3, 0.02
# It is lost when the trailer rolls beyond this [rad] or the steer axle is so far off [m].
_ROLLED, _LOST = np.deg2rad(15.0), 6.0


@dataclass(frozen=True)
class Circle:
    """Steady states on the circle, each of shape (k,).

    Attributes:
      lateral: lateral acceleration [m/s2]; steer: road-wheel angle less the wheelbase's share of
        the curvature driven [rad].
      linear, saturating: the same of the yaw-sideslip model, and of the statics with the tires'
        whole law; NaN beyond its limit.
      gradient: slope of steer over lateral [rad s2/m]; reference: the linear model's;
        saturating_gradient: that of the statics.
    """

    lateral: FloatArray
    steer: FloatArray
    linear: FloatArray
    saturating: FloatArray
    gradient: float
    reference: float
    saturating_gradient: float


def circle(payload: float, timestep: float, speeds: tuple[float, ...]) -> Circle:
    """Drives the circle at ever greater speeds [m/s], each until it is steady."""
    run = _Staircase.start(payload, timestep, speeds[0])
    records = [run.climb(speed) for speed in speeds]
    return _circle(run.truck, records)


def limit(payload: float, timestep: float, *, coarse: float = 2.0) -> tuple[Circle, str]:
    """Drives ever faster until the circle cannot be held; what ended it, in words.

    Args:
      payload: [kg].
      timestep: of the physics [s].
      coarse: steps of speed far from the limit [m/s].
    """
    run = _Staircase.start(payload, timestep, _SLOWEST)
    records, speed, step = [run.climb(_SLOWEST)], _SLOWEST, coarse
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
    """The truck on the circle, from one steady speed to the next."""

    def __init__(self, truck: Truck, hold: SpeedHold, speed: float) -> None:
        self.truck = truck
        self._hold = hold
        self._speed = speed
        self._drift = 0.0
        self._begin = float(truck.data.body("tractor").xpos[0])
        # The linear model's steer angle times radius is a constant and a multiple of v^2.
        model = YawSideslip.from_parameters(truck.parameters, truck.payload, cruise_speed=speed)
        slow, fast = (v / yaw_rate_gain(model.at(v)) for v in (5.0, 15.0))
        self._slope = (fast - slow) / (15.0**2 - 5.0**2)
        self._base = slow - self._slope * 5.0**2

    @classmethod
    def start(cls, payload: float, timestep: float, speed: float) -> _Staircase:
        """Straight on at this speed [m/s], about to enter the circle."""
        truck = Truck.load(payload, parameters=_parameters(), timestep=timestep, visuals=False)
        truck.reset(station=_START, speed=speed)
        return cls(truck, run_straight(truck, speed), speed)

    def climb(self, speed: float) -> Recording:
        """The last seconds at a new speed [m/s], as soon as all is steady or time is over."""
        before, self._speed = self._speed, speed
        rise = abs(speed - before) / _RAMP
        record = self._drive(
            rise + _SETTLE,
            lambda time: before + (speed - before) * min(time / max(rise, 1e-9), 1.0),
        )
        for _ in range(_WINDOWS):
            if self._lost():
                break
            record = self._drive(_AVERAGE, lambda _: speed)
            if _sway(record) < _STEADY:
                break
        return record

    def _drive(self, duration: float, speed: Callable[[float], float]) -> Recording:
        return drive(
            self.truck,
            self._steering,
            speed=speed,
            duration=duration,
            hold=self._hold,
            stop=lambda _: self._lost(),
        )

    def save(self) -> tuple[FloatArray, SpeedHold, float, float]:
        """Everything that a later `load` needs."""
        return state_of(self.truck), copy.copy(self._hold), self._speed, self._drift

    def load(self, saved: tuple[FloatArray, SpeedHold, float, float]) -> None:
        """Goes back to what was saved."""
        restore(self.truck, saved[0])
        self._hold, self._speed, self._drift = copy.copy(saved[1]), saved[2], saved[3]

    def _outside(self) -> tuple[float, float]:
        """Distance from the circle, positive outside [m]; direction of the circle here [rad]."""
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
        # The distance is to vanish, not only to stay: hence its integral.
        wanted = _DRIVER**2 * (outside + 0.15 * self._drift) + 1.6 * _DRIVER * speed * error
        angle = (self._base + self._slope * speed**2) * (1.0 / RADIUS + wanted / speed**2)
        return float(self.truck.parameters.steering.ratio * np.clip(angle, -0.6, 0.6))

    def _lost(self) -> bool:
        rolled = abs(trailer_roll(self.truck)) > _ROLLED
        return rolled or abs(self._outside()[0]) > _LOST


def _circle(truck: Truck, records: list[Recording]) -> Circle:
    """Steady states of recordings, and the references' at the same speed and radius."""
    wheelbase = Kinematic.from_parameters(truck.parameters).L
    turn = SteadyTurn.from_parameters(truck.parameters, truck.payload)
    rows = []
    for record in records:
        rate, speed = float(record.yaw_rate.mean()), float(record.speed.mean())
        curvature, lateral = rate / speed, rate * speed
        model = YawSideslip.from_parameters(truck.parameters, truck.payload, cruise_speed=speed)
        angles = np.array(
            [
                record.road_wheel.mean(),
                rate / yaw_rate_gain(model.at(speed)),
                turn.steer(1.0 / curvature, lateral),
            ]
        )
        rows.append([lateral, *(angles - wheelbase * curvature)])
    lateral, steer, linear, saturating = np.array(rows).T
    low = lateral <= LINEAR
    slopes = [float(np.polyfit(lateral[low], y[low], 1)[0]) for y in (steer, linear, saturating)]
    return Circle(lateral, steer, linear, saturating, *slopes)


def _parameters() -> TruckParameters:
    """A free hitch, and gears held longer: in a bend the automatic would hunt between two."""
    return gears_held(TruckParameters.load(overlay=FREE_HITCH))


def gears_held(parameters: TruckParameters) -> TruckParameters:
    """Gears held longer than the automatic does, as by hand."""
    table = parameters.gearbox.upshift
    later = replace(table, values=_LATER * table.values)
    return replace(parameters, gearbox=replace(parameters.gearbox, upshift=later))


def _ending(record: Recording, speed: float) -> str:
    """Why the circle was not held at a speed [m/s]; empty when it was."""
    if np.max(np.abs(record.trailer_roll)) > _ROLLED:
        return "roll-over"
    if float(record.speed.mean()) < speed - _HELD_SPEED:
        return "the engine no longer holds the speed against the drag of the turn"
    radius = float(record.speed.mean() / record.yaw_rate.mean())
    if abs(radius - RADIUS) < _HELD and _sway(record) < _HELD_SWAY:
        return ""
    # The steer axle at its limit lets the truck run wide, the drive axles' lets it turn in.
    return "steer axle slides" if radius > RADIUS else "drive axles slide"


def _sway(record: Recording) -> float:
    """Greatest change of speed and yaw rate, as a share of their means [1]."""
    return max(
        float(np.ptp(signal) / abs(np.mean(signal))) for signal in (record.speed, record.yaw_rate)
    )


# --- ISO 14792, steady circle of 100 m from walking pace to its end, laden and empty ---

# How near the statics with the tires' whole law must come to the truck, up to `LINEAR` [%].
_ERROR = 10.0
# The slope near the end must exceed that of the beginning by this factor for the tires to saturate.
_SATURATED = 1.5
# Near the end: between these shares of the roll-over threshold by statics, the same at any step.
_LATE = (0.6, 0.8)


def compare(payload: float, timestep: float) -> tuple[list[Check], list[Panel], str]:
    """Checks, panels, and a sentence on what ended the circle."""
    found, end = limit(payload, timestep)
    parameters = TruckParameters.load()
    label = f"ISO 14792 circle of {RADIUS:g} m, {payload / 1e3:g} t"
    scale = float(np.rad2deg(GRAVITY))
    error = 100.0 * abs(found.gradient / found.saturating_gradient - 1.0)
    linear = 100.0 * abs(found.gradient / found.reference - 1.0)
    last = _late_slope(found, GRAVITY * RollPlane.from_parameters(parameters, payload).threshold())
    checks = [
        Check(
            f"{label}: understeer to {LINEAR:g} m/s2",
            found.gradient * scale,
            "deg/g",
            found.saturating_gradient * scale,
        ),
        Check(f"{label}: understeer error to the statics", error, "%", None, f"<= {_ERROR:g}"),
        Check(
            f"{label}: understeer error to the linear model", linear, "%", found.reference * scale
        ),
        Check(f"{label}: greatest lateral acceleration", found.lateral[-1] / GRAVITY, "g"),
        Check(
            f"{label}: slope near the end over slope at the beginning",
            last / found.gradient,
            "1",
            None,
            f">= {_SATURATED:g}",
        ),
    ]
    steer = [np.rad2deg(y) for y in (found.linear, found.saturating, found.steer)]
    lines = (
        Line("statics with the tires' whole law", found.lateral, steer[1], "reference"),
        Line("truck", found.lateral, steer[2], "simulation"),
        Line("yaw-sideslip model", found.lateral, steer[0]),
    )
    panel = Panel(label, "lateral acceleration [m/s2]", "steer beyond Ackermann [deg]", lines)
    return checks, [panel], f"{label} ends at {found.lateral[-1]:.2f} m/s2: {end}."


def _late_slope(found: Circle, threshold: float) -> float:
    """Slope of steer over lateral acceleration [rad s2/m]; NaN when the truck does not get there.

    Args:
      found: steady states.
      threshold: of roll-over [m/s2].
    """
    # At the limit a faster circle may be a wider one: only states that went further count.
    before = np.maximum.accumulate(np.concatenate([[-np.inf], found.lateral[:-1]]))
    further = found.lateral > before
    steer = PchipInterpolator(found.lateral[further], found.steer[further], extrapolate=False)
    low, high = (share * threshold for share in _LATE)
    return float((steer(high) - steer(low)) / (high - low))
