"""Climbing with the greatest load, simulated and by the force balance: limits and steady speeds.

Startability and gradeability are those of the Australian Performance Based Standards (PBS): the
steepest grade on which the truck sets off and moves 5 m, and the steepest on which it keeps moving.
Both are found by bisection over roads of that grade. The computed figure is what the engine can
pull in the gear that the gearbox chose, or the grip of the drive axles, whichever is less.

To set off, the driver holds the truck by the parking brake and floors the pedal, or nearly so,
until the gearbox has chosen its gear. Then the driver sets the pedal for a grade steeper by 0.7 %,
releases the brake, and presses the pedal further until the truck moves. Under way the pedal is
floored; it is eased while the drive wheels slip by more than 14 %. The steep part is approached on
half its grade, at most 12 %, with the pedal for that grade.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from iits_mj.core.messages import EgoState, VehicleCommand
from iits_mj.core.results import Findings, Line
from iits_mj.core.units import KMH
from iits_mj.parameters import TruckParameters
from iits_mj.road import Route
from iits_mj.road.elements import DEFAULT_FRICTION
from iits_mj.truck import Truck
from iits_mj.validation.harness.recorder import PERIOD, placed_truck, sampled
from iits_mj.validation.longitudinal.force_balance import ForceBalance
from iits_mj.validation.longitudinal.hills import sloping
from iits_mj.validation.pbs.limits import STANDARDS, Standard

# Distance that counts as having set off [m], and time allowed for it [s].
_SET_OFF, _TIME = 5.0, 20.0
# Times of the held truck: the gearbox chooses a gear, then the torque settles to the pedal [s].
_CHOOSE, _SETTLE = 10.0, 3.0
# The driver's torque suffices for a grade that is steeper by this.
_SURPLUS = 0.007
# Resolution of the grade.
_RESOLUTION = 0.0025
_GENTLEST, _STEEPEST = 0.03, 0.45
# Friction of a road on which the engine is the limit, not the tires.
_ROUGH = 1.2
# Length and grade of the approach to the steep part, and distance to climb there [m]: so long that
# the energy of the run-up, up to half a meter of height, adds less than 0.5 % to the grade.
_APPROACH, _APPROACH_GRADE, _CLIMB = 30.0, 0.12, 125.0
_PATIENCE = 200.0
# Rolling back by more than this ends an attempt [m].
_ROLLED = 0.5
# Distance at which the truck has begun to move [m].
_MOVED = 0.05
# Slip at which the driver begins to ease the pedal, and at which the pedal is up.
_SLIP_EASE, _SLIP_UP = 0.14, 0.34
_REACTION = 0.4
# Rise of the pedal while the truck is slower than this [1/s], [m/s].
_RISE, _MOVING = 0.03, 0.05
# Part of the computed speed at which a climb to its steady speed begins.
_BEGIN = 0.97
# Speed is steady when the gear stays and the speed changes by less [m/s2] in two blocks [s] in a
# row; greatest number of blocks.
_STEADY, _BLOCK, _BLOCKS = 0.01, 10.0, 16


@dataclass(frozen=True)
class Climb:
    """Steepest grade that was climbed, and the gear in which the truck set off there."""

    grade: float
    gear: int


@dataclass(frozen=True)
class Attempt:
    """Whether a grade was climbed, and the gear in which the truck set off."""

    managed: bool
    gear: int


class HillDriver:
    """A pedal that rises until the truck moves, eased while the drive wheels slip.

    The driver reacts to slip with the reaction time of a person. Call it every 10 ms.
    """

    def __init__(self, truck: Truck, pedal: float = 1.0) -> None:
        """`pedal`: at the start; 1.0 is full pedal."""
        self._truck, self._pedal, self._seen = truck, pedal, 0.0
        self._slips = [
            f"{axle.name}_{side}_tire_slip"
            for axle in truck.parameters.axles
            if axle.driven
            for side in ("left", "right")
        ]

    def __call__(self, _: float, state: EgoState) -> VehicleCommand:
        """The command now."""
        slip = float(np.mean([self._truck.read(name) for name in self._slips]))
        self._seen += (slip - self._seen) * PERIOD / _REACTION
        eased = np.clip((_SLIP_UP - self._seen) / (_SLIP_UP - _SLIP_EASE), 0.0, 1.0)
        if state.speed < _MOVING and eased == 1.0:
            self._pedal = min(self._pedal + _RISE * PERIOD, 1.0)
        return VehicleCommand(accelerator_pedal=float(self._pedal * eased))


def sets_off(
    parameters: TruckParameters,
    payload: float,
    grade: float,
    timestep: float,
    surface: float = DEFAULT_FRICTION,
) -> Attempt:
    """Whether the truck sets off from rest on this grade, on a road of this friction."""
    route = Route.straight(1e4, grade=grade, friction=surface)
    truck = placed_truck(parameters, payload, timestep, route, station=100.0)
    driver = HillDriver(truck, _hold_for(truck, grade))
    return _climbs(truck, driver, _SET_OFF, _TIME)


def startability(
    parameters: TruckParameters,
    payload: float,
    timestep: float,
    surface: float = DEFAULT_FRICTION,
) -> Climb:
    """Steepest grade on which the truck sets off from rest."""
    return steepest(lambda grade: sets_off(parameters, payload, grade, timestep, surface))


def gradeability(parameters: TruckParameters, payload: float, timestep: float) -> Climb:
    """Steepest grade on which the truck keeps moving, approached from a gentler one."""

    def attempt(grade: float) -> Attempt:
        start, gentle = 30.0, min(_APPROACH_GRADE, 0.5 * grade)
        steep = start + _APPROACH
        route = sloping(1e3, gentle, ((steep + 15.0, grade, 30.0),))
        truck = placed_truck(parameters, payload, timestep, route, station=start)
        length, full = truck.footprint.length, HillDriver(truck)
        gently = HillDriver(truck, _hold_for(truck, gentle))

        def command(time: float, state: EgoState) -> VehicleCommand:
            return (gently if state.station < start + _APPROACH else full)(time, state)

        return _climbs(truck, command, _APPROACH + 30.0 + length + _CLIMB, _PATIENCE)

    return steepest(attempt)


def compare_limits(parameters: TruckParameters, timestep: float, *, quick: bool) -> Findings:
    """Startability and gradeability; quick: on the ordinary surface only."""
    payload = parameters.payload_max
    balance = ForceBalance(parameters, payload)
    found = Findings()
    for surface in (DEFAULT_FRICTION,) if quick else (DEFAULT_FRICTION, _ROUGH):
        climb = startability(parameters, payload, timestep, surface)
        _check_computed(found, "startability", balance, climb, balance.launch_speed, surface)
        if surface == DEFAULT_FRICTION:
            _check_level(found, "startability", balance, climb, STANDARDS["startability"])
    climb = gradeability(parameters, payload, timestep)
    strongest = strongest_speed(balance)
    _check_computed(found, "gradeability", balance, climb, strongest, DEFAULT_FRICTION)
    _check_level(found, "gradeability", balance, climb, STANDARDS["gradeability_a"])
    return found


def strongest_speed(balance: ForceBalance) -> float:
    """Engine speed of the greatest full torque [rad/s]."""
    turns = np.linspace(balance.launch_speed, 250.0, 500)
    return float(turns[np.argmax(balance.full_torque(turns))])


def computed_grades(
    balance: ForceBalance, gear: int, speed: float, surface: float = DEFAULT_FRICTION
) -> tuple[float, float]:
    """Grades by full torque in a gear at an engine speed [rad/s], and by grip on a surface."""
    pull = balance.pull(balance.full_torque(speed), gear, speed)
    return balance.grade_for(float(pull)), balance.traction_grade(surface)


def _check_computed(
    found: Findings, name: str, balance: ForceBalance, climb: Climb, speed: float, surface: float
) -> None:
    """Simulated grade against the computed one at an engine speed [rad/s]."""
    by_engine, by_grip = computed_grades(balance, climb.gear, speed, surface)
    computed = 100.0 * min(by_engine, by_grip)
    limit = "the engine" if by_engine < by_grip else "grip"
    found.check(
        f"{name}, {_tons(balance)}, friction {surface:g}, in gear {climb.gear}, limited by {limit}",
        100.0 * climb.grade,
        "%",
        computed,
        f"{computed - 1.0:.2f} .. {computed + 1.0:.2f}",
    )


def _tons(balance: ForceBalance) -> str:
    return f"{balance.mass / 1e3:g} t"


def _check_level(
    found: Findings, name: str, balance: ForceBalance, climb: Climb, standard: Standard
) -> None:
    title = f"{name}, {_tons(balance)} (PBS level 1)"
    found.check(title, 100.0 * climb.grade, "%", standard.limits[0], standard.must(1))


def _hold(truck: Truck, pedal: float, duration: float) -> int:
    """Holds the truck by the parking brake at a pedal for a time [s]; returns the gear."""
    truck.command(VehicleCommand(accelerator_pedal=pedal, parking_brake=1.0))
    truck.step(round(duration / truck.model.opt.timestep))
    return truck.observe().gear


def _hold_for(truck: Truck, grade: float) -> float:
    """Holds the truck until its torque suffices for a grade; returns the pedal."""
    balance = ForceBalance(truck.parameters, truck.payload)

    def pedal(gear: int, slope: float) -> float:
        force = float(balance.resistance(0.0, slope))
        torque = balance.needed_torque(force, gear, balance.launch_speed)
        # The slipping clutch carries the torque.
        return balance.pedal(torque, balance.carrying_speed(torque))

    # The gearbox chooses the gear by the pedal; a light truck would overcome its parking brake.
    gear = _hold(truck, pedal(1, _STEEPEST), _CHOOSE)
    found = pedal(gear, grade + _SURPLUS)
    _hold(truck, found, _SETTLE)
    return found


def _climbs(
    truck: Truck,
    driver: Callable[[float, EgoState], VehicleCommand],
    way: float,
    duration: float,
) -> Attempt:
    """Whether the released truck drives a distance [m] within a time [s] without rolling back."""
    start, farthest = truck.observe().station, 0.0

    def stop(state: EgoState) -> bool:
        nonlocal farthest
        done = state.station - start
        farthest = max(farthest, done)
        return done >= way or done < farthest - _ROLLED

    def read(state: EgoState) -> list[float]:
        return [state.station - start, float(state.gear)]

    table = sampled(truck, driver, read, duration, stop)
    moving = table[table[:, 1] > _MOVED]
    last = moving[0] if len(moving) else table[-1]
    return Attempt(bool(table[-1, 1] >= way), int(last[2]))


def steepest(attempt: Callable[[float], Attempt]) -> Climb:
    """Returns the steepest grade that is climbed, by bisection."""
    low, high = _GENTLEST, _STEEPEST
    best = Attempt(managed=False, gear=1)
    while high - low > _RESOLUTION:
        middle = 0.5 * (low + high)
        tried = attempt(middle)
        if tried.managed:
            low, best = middle, tried
        else:
            high = middle
    return Climb(0.5 * (low + high), best.gear)


@dataclass(frozen=True)
class Steady:
    """Steady speed [m/s], gear, remaining change of the speed [m/s2], engine speed [rad/s].

    The engine turns faster than in proportion to the speed, by the slip of the drive wheels.
    """

    speed: float
    gear: int
    rate: float
    turns: float


def steady_speed(balance: ForceBalance, grade: float, expected: float, timestep: float) -> Steady:
    """Full pedal on a grade from just below `expected` [m/s] until speed and gear settle."""
    start = {"station": 100.0, "speed": _BEGIN * expected}
    route = Route.straight(grade=grade)
    truck = placed_truck(balance.parameters, balance.payload, timestep, route, **start)
    truck.command(VehicleCommand(accelerator_pedal=1.0))
    before, calm = truck.observe(), 0
    for _ in range(_BLOCKS):
        truck.step(round(_BLOCK / timestep))
        after = truck.observe()
        rate = (after.speed - before.speed) / (after.time - before.time)
        # Two in a row: the speed falls and rises again while torque builds up after a change.
        calm = calm + 1 if after.gear == before.gear and abs(rate) < _STEADY else 0
        before = after
        if calm == 2:
            break
    return Steady(after.speed, after.gear, rate, after.engine_speed)


def compare_speeds(parameters: TruckParameters, timestep: float, *, quick: bool) -> Findings:
    """Steady speeds with the greatest load, simulated against computed."""
    balance = ForceBalance(parameters, parameters.payload_max)
    grades = (0.03,) if quick else (0.01, 0.03, 0.05)
    found, speeds = Findings(), []
    for grade in grades:
        steady = check_climb(found, balance, grade, timestep)
        speeds.append(steady.speed)
        if grade == 0.01:
            name, standard = "speed (PBS gradeability B, level 1)", STANDARDS["gradeability_b"]
            found.check(name, steady.speed / KMH, "km/h", standard.limits[0], standard.must(1))
    fastest = balance.best_speed(0.0)
    top = steady_speed(balance, 0.0, fastest, timestep)
    governed = parameters.engine.governed_speed / float(balance.reduction(top.gear))
    lowest = (1.0 - parameters.engine.governor_droop) * governed
    found.label = f"{_tons(balance)}, flat, full pedal"
    highest = len(parameters.gearbox.ratios)
    found.check("gear at the top", top.gear, "1", float(highest), f">= {highest}")
    if fastest < lowest:
        missing = 100.0 * _missing_force(balance, top, 0.0)
        found.check("top speed, force balance", missing, "%", 0.0, "-3 .. 3")
    else:
        must = f"{lowest / KMH:.1f} .. {governed / KMH:.1f}"
        found.check("top speed, governed", top.speed / KMH, "km/h", governed / KMH, must)
    line = np.linspace(0.0, 0.06, 25)
    computed = np.array([balance.best_speed(grade) for grade in line]) / KMH
    simulated = np.array([top.speed, *speeds]) / KMH
    found.label = f"{_tons(balance)}, full pedal"
    found.panel(
        "steady speed",
        "grade [%]",
        "speed [km/h]",
        Line("force balance, best gear", 100.0 * line, computed, "reference"),
        Line("truck", 100.0 * np.array([0.0, *grades]), simulated, "simulation"),
    )
    return found


def check_climb(found: Findings, balance: ForceBalance, grade: float, timestep: float) -> Steady:
    """Adds the checks of a steady climb at full pedal, and returns its state."""
    expected = balance.best_speed(grade)
    steady = steady_speed(balance, grade, expected, timestep)
    found.label = f"{_tons(balance)}, {100.0 * grade:g} % grade, full pedal"
    missing = 100.0 * _missing_force(balance, steady, grade)
    found.check(f"force balance in gear {steady.gear}", missing, "%", 0.0, "-3 .. 3")
    found.check("steady speed", steady.speed / KMH, "km/h", expected / KMH)
    return steady


def _missing_force(balance: ForceBalance, steady: Steady, grade: float) -> float:
    """Pull at full pedal less resistances and inertia, as a share of the pull [1]."""
    torque = balance.full_torque(steady.turns)
    pull = float(balance.pull(torque, steady.gear, steady.turns))
    inertia = (balance.mass + float(balance.rotating_mass(steady.gear))) * steady.rate
    return (pull - float(balance.resistance(steady.speed, grade)) - inertia) / pull
