"""Startability, gradeability and steady speeds on grades, simulated and by the force balance.

Startability and gradeability as the Australian Performance Based Standards mean them: the steepest
grade on which the truck sets off and moves 5 m, and the steepest on which it keeps moving. Both are
found by bisection over roads of that grade. The computed figure is what the engine can pull in the
gear that the gearbox chose, or what the drive axles can put on the road, whichever is less.

To set off, the driver holds the truck by the parking brake, floors the pedal until the gearbox has
taken its gear, then asks for 2 % more than the grade needs and lets go. Under way the pedal is
floored, and eased when the drive wheels slip by more than 14 %.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from iits_mj.messages import EgoState, VehicleCommand
from iits_mj.parameters import TruckParameters
from iits_mj.results import Check, Line, Panel
from iits_mj.road import Route
from iits_mj.truck import Truck
from iits_mj.units import KMH
from iits_mj.validation.force_balance import ForceBalance
from iits_mj.validation.recorder import PERIOD, sampled
from iits_mj.validation.slopes import sloping

# Way that counts as having set off [m], and time allowed for it [s].
_SET_OFF, _TIME = 5.0, 20.0
# The parking brake holds while the torque builds up, then while it settles to the pedal's [s].
_FLOORED, _SETTLE = 10.0, 3.0
# More torque than the grade needs; engine speed at which the slipping clutch passes it [rad/s].
_MARGIN, _LAUNCH_SPEED = 1.02, 95.0
_RESOLUTION = 0.0025
_STEEPEST = 0.45
# Of the approach to the steep part [m], its grade, and the way to be climbed there [m].
_APPROACH, _APPROACH_GRADE, _CLIMB = 60.0, 0.12, 40.0
_PATIENCE = 150.0
# Steady: the gear stays and the speed changes by less [m/s2] in half a block [s]; so many at most.
_STEADY, _BLOCK, _BLOCKS = 0.01, 20.0, 8
# The truck rolls back by more than this on a grade that it does not manage [m].
_ROLLED = 0.5
# It has set off when it has moved by this [m].
_MOVED = 0.05
# Slip at which the driver begins to ease the pedal, and at which the pedal is up.
_SLIP_EASE, _SLIP_UP = 0.14, 0.34
_REACTION = 0.4
# PBS level 1: startability, gradeability A [1], gradeability B [km/h on 1 %].
_LEVEL_START, _LEVEL_GRADE, _LEVEL_SPEED = 15.0, 20.0, 80.0


@dataclass(frozen=True)
class Climb:
    """The steepest grade that was managed, and the gear in which the truck set off there."""

    grade: float
    gear: int


@dataclass(frozen=True)
class _Try:
    managed: bool
    gear: int


class Driver:
    """Full pedal, eased while the drive wheels slip; sees their slip as slowly as a person does."""

    def __init__(self, truck: Truck) -> None:
        self._truck, self._seen = truck, 0.0
        self._slips = [
            f"{axle.name}_{side}_tire_slip"
            for axle in truck.parameters.axles
            if axle.tire == "drive"
            for side in ("left", "right")
        ]

    def __call__(self, _: float, __: EgoState) -> VehicleCommand:
        """What to command now, every 10 ms."""
        slip = float(np.mean([self._truck.read(name) for name in self._slips]))
        self._seen += (slip - self._seen) * PERIOD / _REACTION
        pedal = np.clip((_SLIP_UP - self._seen) / (_SLIP_UP - _SLIP_EASE), 0.0, 1.0)
        return VehicleCommand(accelerator_pedal=float(pedal))


def sets_off(payload: float, grade: float, timestep: float) -> _Try:
    """Whether the truck sets off from rest on this grade."""
    truck = Truck.load(
        payload, route=Route.straight(1e4, grade=grade), timestep=timestep, visuals=False
    )
    truck.reset(station=100.0)
    gear = _hold(truck, 1.0, _FLOORED)
    balance = ForceBalance(truck.parameters, payload)
    need = float(balance.resistance(0.0, grade) / balance.pull(1.0, gear))
    pedal = _pedal(balance, _MARGIN * need)
    _hold(truck, pedal, _SETTLE)
    return _climbs(truck, lambda *_: VehicleCommand(accelerator_pedal=pedal), _SET_OFF, _TIME)


def startability(payload: float, timestep: float) -> Climb:
    """The steepest grade on which the truck sets off from rest."""
    return _steepest(lambda grade: sets_off(payload, grade, timestep))


def gradeability(payload: float, timestep: float) -> Climb:
    """The steepest grade on which the truck keeps moving, met from a gentler one."""

    def attempt(grade: float) -> _Try:
        start = 30.0
        steep = start + _APPROACH
        route = sloping(1e3, _APPROACH_GRADE, ((steep + 15.0, grade, 30.0),))
        truck = Truck.load(payload, route=route, timestep=timestep, visuals=False)
        truck.reset(station=start)
        length = truck.footprint.length
        _hold(truck, 1.0, _FLOORED)
        return _climbs(truck, Driver(truck), _APPROACH + 30.0 + length + _CLIMB, _PATIENCE)

    return _steepest(attempt)


@dataclass(frozen=True)
class Steady:
    """Speed [m/s] in which the truck settles, gear, and what the speed still changes by [m/s2]."""

    speed: float
    gear: int
    rate: float


def steady_speed(payload: float, grade: float, start: float, timestep: float) -> Steady:
    """Full pedal on a grade until speed and gear settle.

    Args:
      payload: [kg].
      grade: of the road.
      start: speed to begin with [m/s].
      timestep: of the physics [s].
    """
    truck = Truck.load(payload, route=Route.straight(grade=grade), timestep=timestep, visuals=False)
    truck.reset(station=100.0, speed=start)
    full = VehicleCommand(accelerator_pedal=1.0)
    for _ in range(_BLOCKS):
        table = sampled(truck, lambda *_: full, lambda s: [s.speed, float(s.gear)], _BLOCK)
        half = table[len(table) // 2 :]
        rate = float((half[-1, 1] - half[0, 1]) / (half[-1, 0] - half[0, 0]))
        if np.ptp(half[:, 2]) == 0.0 and abs(rate) < _STEADY:
            break
    return Steady(float(table[-1, 1]), int(table[-1, 2]), rate)


def compare(timestep: float, *, quick: bool) -> tuple[list[Check], list[Panel]]:
    """Climbing at 55 t, simulated against computed."""
    parameters = TruckParameters.load()
    payload = parameters.payload.mass_max
    balance = ForceBalance(parameters, payload)
    checks = [
        *_grade_checks(balance, startability(payload, timestep), "startability", _LEVEL_START),
        *_grade_checks(balance, gradeability(payload, timestep), "gradeability", _LEVEL_GRADE),
    ]
    grades = (0.03,) if quick else (0.01, 0.03, 0.05)
    found = []
    for grade in grades:
        expected = balance.best_speed(grade)
        steady = steady_speed(payload, grade, 0.97 * expected, timestep)
        speed, gear = steady.speed, steady.gear
        label = f"55 t, {100.0 * grade:g} % grade, full pedal"
        found.append(speed)
        checks += [
            Check(
                f"{label}: force balance in gear {gear}",
                100.0 * _missing_force(balance, steady, grade),
                "%",
                0.0,
                "-3 .. 3",
            ),
            Check(f"{label}: steady speed", speed / KMH, "km/h", expected / KMH),
        ]
        if grade == 0.01:
            checks.append(
                Check(
                    f"{label}: speed (PBS gradeability B, level 1)",
                    speed / KMH,
                    "km/h",
                    _LEVEL_SPEED,
                    f">= {_LEVEL_SPEED:g}",
                )
            )
    summit = steady_speed(payload, 0.0, 0.97 * balance.best_speed(0.0), timestep)
    top, gear = summit.speed, summit.gear
    governed = parameters.engine.governed_speed / float(balance.reduction(gear))
    lowest = (1.0 - parameters.engine.governor_droop) * governed
    checks += [
        Check("55 t, flat, full pedal: gear at the top", float(gear), "1", 12.0, ">= 12"),
        Check(
            "55 t, flat, full pedal: top speed, governed",
            top / KMH,
            "km/h",
            governed / KMH,
            f"{lowest / KMH:.1f} .. {governed / KMH:.1f}",
        ),
    ]
    line = np.linspace(0.0, 0.06, 25)
    computed = np.array([balance.best_speed(grade) for grade in line]) / KMH
    panel = Panel(
        "55 t, full pedal: steady speed",
        "grade [%]",
        "speed [km/h]",
        (
            Line("force balance, best gear", 100.0 * line, computed, "reference"),
            Line(
                "truck",
                100.0 * np.array([0.0, *grades]),
                np.array([top, *found]) / KMH,
                "simulation",
            ),
        ),
    )
    return checks, [panel]


def _grade_checks(balance: ForceBalance, climb: Climb, name: str, level: float) -> list[Check]:
    """Simulated against computed: engine's torque in the gear it chose, or the tires' grip."""
    at_launch = float(balance.full_torque(_LAUNCH_SPEED))
    best = float(np.max(balance.full_torque(np.linspace(_LAUNCH_SPEED, 250.0, 500))))
    torque = at_launch if name == "startability" else best
    by_engine = balance.grade_for(float(balance.pull(torque, climb.gear)))
    by_grip = balance.traction_grade()
    computed = 100.0 * min(by_engine, by_grip)
    limit = "the engine" if by_engine < by_grip else "grip"
    found = 100.0 * climb.grade
    return [
        Check(
            f"{name}, 55 t, in gear {climb.gear}, limited by {limit}",
            found,
            "%",
            computed,
            f"{computed - 1.0:.2f} .. {computed + 1.0:.2f}",
        ),
        Check(f"{name}, 55 t (PBS level 1)", found, "%", level, f">= {level:g}"),
    ]


def _missing_force(balance: ForceBalance, steady: Steady, grade: float) -> float:
    """Pull of the floored pedal less resistances and inertia, over the pull [1]."""
    torque = balance.full_torque(steady.speed * balance.reduction(steady.gear))
    pull = float(balance.pull(torque, steady.gear))
    inertia = (balance.mass + float(balance.rotating_mass(steady.gear))) * steady.rate
    return (pull - float(balance.resistance(steady.speed, grade)) - inertia) / pull


def _hold(truck: Truck, pedal: float, duration: float) -> int:
    """Holds the truck by the parking brake under this pedal for so long [s]; the gear it is in."""
    held = VehicleCommand(accelerator_pedal=pedal, parking_brake=1.0)
    sampled(truck, lambda *_: held, lambda _: [], duration)
    return truck.observe().gear


def _pedal(balance: ForceBalance, torque: float) -> float:
    """Pedal that asks for this torque [N m] while the clutch slips."""
    table = balance.parameters.engine.pedal_map
    asked = [np.interp(_LAUNCH_SPEED, table.rows, column) for column in table.values.T]
    return float(np.interp(torque, asked, table.columns))


def _climbs(
    truck: Truck,
    driver: Callable[[float, EgoState], VehicleCommand],
    way: float,
    duration: float,
) -> _Try:
    """Whether the truck, let go, gets so far [m] in so long [s] without rolling back by 0.5 m."""
    start, farthest = truck.observe().station, 0.0

    def stop(state: EgoState) -> bool:
        nonlocal farthest
        done = state.station - start
        farthest = max(farthest, done)
        return done >= way or done < farthest - _ROLLED

    table = sampled(
        truck,
        driver,
        lambda state: [state.station - start, float(state.gear)],
        duration,
        stop,
    )
    moving = table[table[:, 1] > _MOVED]
    last = moving[0] if len(moving) else table[-1]
    return _Try(bool(table[-1, 1] >= way), int(last[2]))


def _steepest(attempt: Callable[[float], _Try]) -> Climb:
    """Bisection between a level road and the steepest that is tried."""
    low, high = 0.0, _STEEPEST
    best = _Try(managed=False, gear=1)
    while high - low > _RESOLUTION:
        middle = 0.5 * (low + high)
        found = attempt(middle)
        if found.managed:
            low, best = middle, found
        else:
            high = middle
    return Climb(0.5 * (low + high), best.gear)
