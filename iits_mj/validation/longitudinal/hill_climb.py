"""Startability and gradeability, simulated and by the force balance.

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

from iits_mj.core.messages import EgoState, VehicleCommand
from iits_mj.core.results import Check
from iits_mj.parameters import TruckParameters
from iits_mj.road import Route
from iits_mj.road.elements import DEFAULT_FRICTION
from iits_mj.truck import Truck
from iits_mj.validation.harness.recorder import PERIOD, sampled
from iits_mj.validation.longitudinal.force_balance import ForceBalance
from iits_mj.validation.longitudinal.runs import sloping

# Way that counts as having set off [m], and time allowed for it [s].
_SET_OFF, _TIME = 5.0, 20.0
# The parking brake holds while the torque builds up, then while it settles to the pedal's [s].
_FLOORED, _SETTLE = 10.0, 3.0
# More torque than the grade needs.
_MARGIN = 1.02
# Of the grade that is found; quick.
_RESOLUTION, _COARSE = 0.0025, 0.01
_STEEPEST = 0.45
# A road on which the engine is the limit, not the tires.
_ROUGH = 1.2
# Of the approach to the steep part [m], its grade, and the way to be climbed there [m].
_APPROACH, _APPROACH_GRADE, _CLIMB = 30.0, 0.12, 25.0
_PATIENCE = 120.0
# The truck rolls back by more than this on a grade that it does not manage [m].
_ROLLED = 0.5
# It has set off when it has moved by this [m].
_MOVED = 0.05
# Slip at which the driver begins to ease the pedal, and at which the pedal is up.
_SLIP_EASE, _SLIP_UP = 0.14, 0.34
_REACTION = 0.4
# PBS level 1: startability, gradeability A [%].
_LEVEL_START, _LEVEL_GRADE = 15.0, 20.0


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


def sets_off(
    payload: float, grade: float, timestep: float, surface: float = DEFAULT_FRICTION
) -> _Try:
    """Whether the truck sets off from rest on this grade, on a road of this friction."""
    route = Route.straight(1e4, grade=grade, friction=surface)
    truck = Truck.load(payload, route=route, timestep=timestep, visuals=False)
    truck.reset(station=100.0)
    gear = _hold(truck, 1.0, _FLOORED)
    balance = ForceBalance(truck.parameters, payload)
    need = float(balance.resistance(0.0, grade) / balance.pull(1.0, gear))
    pedal = _pedal(balance, _MARGIN * need)
    _hold(truck, pedal, _SETTLE)
    return _climbs(truck, lambda *_: VehicleCommand(accelerator_pedal=pedal), _SET_OFF, _TIME)


def startability(
    payload: float, timestep: float, resolution: float, surface: float = DEFAULT_FRICTION
) -> Climb:
    """The steepest grade on which the truck sets off from rest."""
    return _steepest(lambda grade: sets_off(payload, grade, timestep, surface), resolution)


def gradeability(payload: float, timestep: float, resolution: float) -> Climb:
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

    return _steepest(attempt, resolution)


def compare(timestep: float, *, quick: bool) -> list[Check]:
    """Both at 55 t, simulated against computed; quick: found within 1 % grade instead of 0.25."""
    parameters = TruckParameters.load()
    payload = parameters.payload.mass_max
    balance = ForceBalance(parameters, payload)
    resolution = _COARSE if quick else _RESOLUTION
    checks = []
    for surface in (DEFAULT_FRICTION,) if quick else (DEFAULT_FRICTION, _ROUGH):
        climb = startability(payload, timestep, resolution, surface)
        torque = float(balance.full_torque(balance.launch_speed))
        checks.append(_computed("startability", balance, climb, torque, surface))
        if surface == DEFAULT_FRICTION:
            checks.append(_level("startability", climb, _LEVEL_START))
    climb = gradeability(payload, timestep, resolution)
    torque = float(np.max(balance.full_torque(np.linspace(balance.launch_speed, 250.0, 500))))
    checks.append(_computed("gradeability", balance, climb, torque, DEFAULT_FRICTION))
    checks.append(_level("gradeability", climb, _LEVEL_GRADE))
    return checks


def _computed(
    name: str, balance: ForceBalance, climb: Climb, torque: float, surface: float
) -> Check:
    """Simulated against computed: this torque [N m] in the gear it chose, or the tires' grip."""
    by_engine = balance.grade_for(float(balance.pull(torque, climb.gear)))
    by_grip = balance.traction_grade(surface)
    computed = 100.0 * min(by_engine, by_grip)
    limit = "the engine" if by_engine < by_grip else "grip"
    return Check(
        f"{name}, 55 t, friction {surface:g}, in gear {climb.gear}, limited by {limit}",
        100.0 * climb.grade,
        "%",
        computed,
        f"{computed - 1.0:.2f} .. {computed + 1.0:.2f}",
    )


def _level(name: str, climb: Climb, level: float) -> Check:
    title = f"{name}, 55 t (PBS level 1)"
    return Check(title, 100.0 * climb.grade, "%", level, f">= {level:g}")


def _hold(truck: Truck, pedal: float, duration: float) -> int:
    """Holds the truck by the parking brake under this pedal for so long [s]; the gear it is in."""
    truck.command(VehicleCommand(accelerator_pedal=pedal, parking_brake=1.0))
    truck.step(round(duration / truck.model.opt.timestep))
    return truck.observe().gear


def _pedal(balance: ForceBalance, torque: float) -> float:
    """Pedal that asks for this torque [N m] while the clutch slips."""
    table = balance.parameters.engine.pedal_map
    asked = [np.interp(balance.launch_speed, table.rows, column) for column in table.values.T]
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


def _steepest(attempt: Callable[[float], _Try], resolution: float) -> Climb:
    """Bisection between a gentle grade and the steepest that is tried."""
    low, high = _APPROACH_GRADE, _STEEPEST
    best = _Try(managed=False, gear=1)
    while high - low > resolution:
        middle = 0.5 * (low + high)
        found = attempt(middle)
        if found.managed:
            low, best = middle, found
        else:
            high = middle
    return Climb(0.5 * (low + high), best.gear)
