"""Stability under braking: split friction with a driver, and a bend with locked wheels.

**Split friction** (ISO 16234; bounds of UN R13, annex 13): full braking on a road with a friction
of 0.8 on the left and 0.3 on the right. The driver aims at a point of the lane's middle one second
ahead, with a delay of 0.2 s (pure pursuit). Further runs are two seconds without steering, and each
of the two surfaces alone. ISO 16234 is the open-loop method for heavy vehicles and combinations;
its figure is the reaction with the steering wheel held. The bounds with a driver (braking rate, 120
and 240 degrees) and their clauses are not checked against the text of UN R13; there they apply to
the laden towing vehicle, here to the whole combination, laden and empty.

**Locked wheels**: the truck runs steadily through a gentle left bend at 60 km/h on a friction of
0.3, then brakes with its steering wheel held. Parameters alone decide which wheels lock: the brakes
of the other groups have no torque, and ABS is off (its least speed is out of reach). The control is
the shipped truck, braked harder than the road allows, so that ABS works on every axle.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import find_peaks

from iits_mj.analytic import Kinematic
from iits_mj.core.arrays import FloatArray
from iits_mj.core.messages import EgoState, VehicleCommand, XbrMode
from iits_mj.core.results import Findings, Line
from iits_mj.core.units import GRAVITY, KMH
from iits_mj.parameters import Axle, TruckParameters
from iits_mj.road import Route
from iits_mj.truck import Truck
from iits_mj.validation.harness.maneuver import Run, run, steady_truck
from iits_mj.validation.harness.recorder import PERIOD, drive

Steering = Callable[[float, EgoState], float]


def brake(
    truck: Truck,
    demand: float,
    steering: Steering,
    *,
    duration: float,
    stop: Callable[[EgoState], bool],
) -> Run:
    """Brakes the rolling truck by a demand [m/s2], positive, for at most a duration [s].

    The steering-wheel angle [rad] is a function of time [s] and state; `stop` ends the run early.
    """

    def command(time: float, state: EgoState) -> VehicleCommand:
        angle = steering(time, state)
        return VehicleCommand(
            xbr_mode=XbrMode.MAXIMUM, xbr_demand=-demand, steering_wheel_angle=angle
        )

    return run(truck, command, duration, stop)


HIGH, LOW = 0.8, 0.3
SPLIT_SPEED = 50.0 * KMH
# More than either surface allows, so that ABS works [m/s2].
SPLIT_DEMAND = 8.0
# UN R13, annex 13, 5.3.6: steering-wheel angle in the first 2 s and in all [deg].
STEER_EARLY, STEER_TOTAL = 120.0, 240.0
# UN R13, annex 13, 5.3.5: least braking rate as a share of gravity, 0.75 (4 k_L + k_H) / 5 and at
# least k_L. Its appendix measures it with the brakes built up, between these speeds [m/s].
RATE = max(0.75 * (4.0 * LOW + HIGH) / 5.0, LOW)
_FROM, _TO = 40.0 * KMH, 20.0 * KMH
_LONG = 30.0
# The driver: reaction [s], preview [s] and its least distance [m].
_DELAY, _PREVIEW, _NEAR = 0.2, 1.0, 5.0
# Half the outer track: beyond it the tires of one side cross the split (UN R13) [m].
_ASTRIDE = 1.0
# Cycles of ABS [1/s], as those of air systems, and the least swing of the pressure in one [Pa]: the
# brakes' hysteresis, below which their torque does not change.
CYCLES, _SWING = "1 .. 3", 15e3
# Speed below which wheels may lock [m/s], and the time in which the brakes build up [s].
_MAY_LOCK, _BUILT_UP = 15.0 * KMH, 1.0
BEND_FRICTION = 0.3
BEND_SPEED = 60.0 * KMH
# Lateral acceleration in the bend [m/s2]: a third of the limit of the road.
LATERAL = 1.0
BEND_DEMAND = 4.0
# Hitch angle of a jack-knifed truck, and greatest hitch angle of a stable truck [rad].
FOLDED, STEADY = np.deg2rad(30.0), np.deg2rad(5.0)
# Hitch angle at which a record ends [rad].
FOLDED_OVER = 2.0 * FOLDED
# A swing that takes the trailer out of its lane: 1 m at the last axle [rad].
SWUNG = np.deg2rad(6.0)
_INTO, _BRAKING = 8.0, 12.0
_SLOW = 3.0 * KMH


def lane_keeper(ratio: float, wheelbase: float) -> Steering:
    """A driver who steers, with a delay, on the arc that meets y = 0 at the preview distance."""
    waiting: deque[float] = deque([0.0] * round(_DELAY / PERIOD))

    def steering(_: float, state: EgoState) -> float:
        reach = max(_PREVIEW * state.speed, _NEAR)
        aside = state.y * np.cos(state.yaw) + reach * np.sin(state.yaw)
        waiting.append(-ratio * wheelbase * 2.0 * aside / reach**2)
        return float(np.clip(waiting.popleft(), -10.0, 10.0))

    return steering


def stop_on(
    parameters: TruckParameters,
    payload: float,
    left: float,
    right: float,
    timestep: float,
    *,
    driver: bool,
    duration: float,
    speed: float = SPLIT_SPEED,
) -> Run:
    """Brakes from a speed [m/s] on a straight road with these coefficients of friction."""
    route = Route.straight(2000.0).with_friction(left, right)
    truck, _ = steady_truck(payload, speed, timestep, route=route, parameters=parameters)
    wheelbase = Kinematic.from_parameters(parameters).L
    keeper = lane_keeper(parameters.steering.ratio, wheelbase)
    steering = keeper if driver else lambda _time, _state: 0.0
    return brake(
        truck, SPLIT_DEMAND, steering, duration=duration, stop=lambda s: s.speed < 0.5 * KMH
    )


def path_length(record: Run) -> float:
    """Length of the steer axle's path [m]."""
    return float(np.sum(np.hypot(np.diff(record.x), np.diff(record.y))))


def braking_rate(record: Run) -> float:
    """Mean deceleration over distance between `_FROM` and `_TO` as a share of gravity [1]."""
    inside = (record.speed <= _FROM) & (record.speed >= _TO)
    x, y, speed = record.x[inside], record.y[inside], record.speed[inside]
    distance = float(np.sum(np.hypot(np.diff(x), np.diff(y))))
    return float((speed[0] ** 2 - speed[-1] ** 2) / (2.0 * distance * GRAVITY))


def abs_cycles(record: Run) -> FloatArray:
    """Cycles of each wheel's pressure between its first and last peak [1/s], shape (n,).

    The brakes have built up and no wheel may lock; 0 with less than two peaks.
    """
    working = (record.speed > _MAY_LOCK) & (record.time > _BUILT_UP)
    found = []
    for wheel in record.wheel_pressures[working].T:
        peaks = find_peaks(wheel, prominence=_SWING)[0]
        found.append((len(peaks) - 1) / (PERIOD * np.ptp(peaks)) if len(peaks) > 1 else 0.0)
    return np.array(found)


def split_figures(parameters: TruckParameters, held: Run) -> dict[str, tuple[float, str, str]]:
    """Value, unit and bound of what a run with a driver on split friction shows."""
    wheel = np.abs(np.rad2deg(held.steering_wheel_angle))
    fast = held.speed > _MAY_LOCK
    early = wheel[held.time <= 2.0].max()
    figures = {
        "steering wheel in the first 2 s (UN R13)": (early, "deg", f"<= {STEER_EARLY:g}"),
        "steering wheel in all (UN R13)": (wheel.max(), "deg", f"<= {STEER_TOTAL:g}"),
        "deviation": (np.max(np.abs(held.y)), "m", f"<= {_ASTRIDE:g}"),
    }
    if len(parameters.units) > 1:
        worst = np.max(np.abs(np.rad2deg(held.articulation[fast])))
        figures["greatest hitch angle above 15 km/h"] = (worst, "deg", "<= 5")
    worst = np.max(np.abs(np.rad2deg(held.yaw_rate[fast])))
    figures["greatest yaw rate above 15 km/h"] = (worst, "deg/s", "")
    return figures


def compare_split(parameters: TruckParameters, payload: float, timestep: float) -> Findings:
    """Split friction with one payload [kg]."""

    def stop(left: float, right: float) -> Run:
        return stop_on(parameters, payload, left, right, timestep, driver=True, duration=_LONG)

    held = stop(HIGH, LOW)
    free = stop_on(parameters, payload, HIGH, LOW, timestep, driver=False, duration=2.0)
    alone = {mu: stop(mu, mu) for mu in (HIGH, LOW)}
    high, low = map(path_length, alone.values())
    found = Findings(f"split friction {HIGH:g}/{LOW:g}, {payload / 1e3:g} t, 50 km/h")
    found.check("stopping distance", path_length(held), "m", must=f"<= {low:.1f}")
    found.check(f"stopping distance on {HIGH:g} alone", high, "m")
    found.check(f"stopping distance on {LOW:g} alone", low, "m")
    rate = braking_rate(held)
    found.check("braking rate 40 to 20 km/h (UN R13)", rate, "g", must=f">= {RATE:g}")
    for name, (value, unit, must) in split_figures(parameters, held).items():
        found.check(name, value, unit, must=must)
    if len(parameters.units) > 1:
        worst = np.max(np.abs(np.rad2deg(held.articulation)))
        found.check("greatest hitch angle", worst, "deg", must="<= 5")
    cycles = abs_cycles(alone[LOW])
    cycles = cycles[cycles > 0.0]  # a lifted axle does not brake
    name = f"ABS cycles on {LOW:g} alone"
    found.check(f"{name}, slowest wheel", cycles.min(initial=np.inf), "1/s", must=CYCLES)
    found.check(f"{name}, fastest wheel", cycles.max(initial=0.0), "1/s", must=CYCLES)
    turned = np.rad2deg(free.yaw[-1] - free.yaw[0])
    found.check("change of heading in 2 s, wheel held", turned, "deg")
    straight = Line("straight on", held.time[[0, -1]], np.zeros(2), "reference")
    without = Line("steering wheel held", free.time, np.rad2deg(free.yaw))
    for name, label, values, more in (
        ("lateral position", "deviation [m]", held.y, ()),
        ("heading", "yaw [deg]", np.rad2deg(held.yaw), (without,)),
        ("steering wheel", "angle [deg]", np.rad2deg(held.steering_wheel_angle), ()),
    ):
        driven = Line("driver", held.time, values, "simulation")
        found.panel(name, "time [s]", label, straight, driven, *more)
    return found


@dataclass(frozen=True)
class Group:
    """Axles whose wheels lock: driven ones, those of the first towed unit, or none with ABS."""

    name: str

    def axles(self, parameters: TruckParameters) -> tuple[int, ...]:
        """Indices of the axles, from front to rear."""
        first = len(parameters.lead.axles)
        if self is DRIVE:
            return tuple(i for i, axle in enumerate(parameters.axles) if axle.driven)
        count = len(parameters.units[1].axles) if self is TRAILER else 0
        return tuple(range(first, first + count))


DRIVE = Group("drive axles locked")
TRAILER = Group("trailer axles locked")
ABS = Group("all axles, ABS")


def locking(parameters: TruckParameters, group: Group) -> TruckParameters:
    """Returns the truck with which the wheels of the group lock and the others do not brake."""
    locked = {parameters.axles[i].name for i in group.axles(parameters)}
    if not locked:
        return parameters

    def released(axle: Axle) -> Axle:
        if axle.name in locked:
            return axle
        return replace(axle, brake=replace(axle.brake, torque_per_pressure=0.0))

    units = tuple(
        replace(unit, axles=tuple(map(released, unit.axles))) for unit in parameters.units
    )
    air_brake = replace(parameters.air_brake, abs_speed_min=100.0)
    return replace(parameters, units=units, air_brake=air_brake)


def steady_bend(
    parameters: TruckParameters, payload: float, timestep: float, friction: float, lateral: float
) -> tuple[Truck, float]:
    """The truck in a steady bend at 60 km/h, and its steering-wheel angle [rad].

    Args:
      parameters: of the truck.
      payload: [kg].
      timestep: [s].
      friction: of the road.
      lateral: acceleration in the bend without understeer [m/s2].
    """
    truck, hold = steady_truck(
        payload,
        BEND_SPEED,
        timestep,
        station=50.0,
        parameters=parameters,
        route=Route.straight(2000.0).with_friction(friction),
    )
    radius = BEND_SPEED**2 / lateral
    wheel = parameters.steering.ratio * parameters.lead.axles[1].position / radius

    # Understeer makes the bend wider, equally for all groups.
    def turn_in(time: float, _: float) -> float:
        return wheel * min(time / 2.0, 1.0)

    drive(truck, turn_in, speed=BEND_SPEED, duration=_INTO, hold=hold)
    return truck, wheel


def bend_is_over(state: EgoState) -> bool:
    """Whether the truck has stopped or jack-knifed."""
    return state.speed < _SLOW or abs(state.articulation) > FOLDED_OVER


def bend(parameters: TruckParameters, payload: float, group: Group, timestep: float) -> Run:
    """Brakes in the bend to 3 km/h or a jack-knife; the record begins with the demand."""
    changed = locking(parameters, group)
    truck, wheel = steady_bend(changed, payload, timestep, BEND_FRICTION, LATERAL)
    return brake(truck, BEND_DEMAND, lambda _, __: wheel, duration=_BRAKING, stop=bend_is_over)


def compare_locked(parameters: TruckParameters, payload: float, timestep: float) -> Findings:
    """Locked wheels with one payload [kg], of a truck that tows."""
    runs = {group: bend(parameters, payload, group, timestep) for group in (DRIVE, TRAILER, ABS)}
    label = f"braking in a bend on {BEND_FRICTION:g}, {payload / 1e3:g} t, 60 km/h"
    change = {g: np.rad2deg(r.articulation - r.articulation[0]) for g, r in runs.items()}
    folded, swung, steady = np.rad2deg((FOLDED, -SWUNG, STEADY))
    least, greatest = np.min(change[TRAILER]), np.max(np.abs(change[ABS]))
    found = Findings()
    for group in (DRIVE, TRAILER):
        axles = group.axles(parameters)
        locked = runs[group].locked_share(slice(axles[0], axles[-1] + 1), 15.0 * KMH)
        name = f"{label}, {group.name}: share of time with one of them locked above 15 km/h"
        found.check(name, locked, "1")
    for name, value, must in (
        (f"{DRIVE.name}: hitch angle (jack-knife)", np.max(change[DRIVE]), f">= {folded:g}"),
        (f"{TRAILER.name}: hitch angle (trailer swing)", least, f"<= {swung:g}"),
        (f"{ABS.name}: greatest change of the hitch angle", greatest, f"<= {steady:g}"),
    ):
        found.check(f"{label}, {name}", value, "deg", must=must)
    name = f"{label}, {ABS.name}: share of time with a wheel locked above 15 km/h"
    locked = runs[ABS].locked_share(slice(0, len(parameters.axles)), 15.0 * KMH)
    found.check(name, locked, "1", must="<= 0.2")

    hitch, tracks = [], []
    for group, record in runs.items():
        role = "reference" if group is ABS else ""
        hitch.append(Line(group.name, record.time, change[group], role))
        x, y = record.x - record.x[0], record.y - record.y[0]
        tracks.append(Line(group.name, x, y, role))
    found.panel(f"{label}: hitch angle", "time [s]", "change of the hitch angle [deg]", *hitch)
    found.panel(f"{label}: steer axle", "x [m]", "y [m]", *tracks)
    return found
