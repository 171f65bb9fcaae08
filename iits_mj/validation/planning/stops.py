"""A wall across the lane, seen late: the MuJoCo truck with its stack brakes before it."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np

from controllers.planning.planner import PlannerConfig
from controllers.planning.speed_plan import SpeedConfig
from controllers.stack import Stack
from iits_mj.core.arrays import FloatArray
from iits_mj.core.messages import LightState, RoadSignals, Scene, TrackedVehicle, TrafficLight
from iits_mj.core.results import Check, Line, Panel, Results
from iits_mj.road import Route
from iits_mj.simulation.frame import BEHIND
from iits_mj.truck import Truck
from iits_mj.validation.harness.config import ValidateConfig
from iits_mj.validation.longitudinal.ideal_drive import car
from iits_mj.validation.planning.closed_loop import CONTROL_PERIOD, PLAN_PERIOD

# --- Red lights on the MuJoCo truck: lines crossed, how hard it brakes, where it stands ---
# Laden and empty, uphill and down, with and without knowledge of when the light changes.

_CALLS = round(PLAN_PERIOD / CONTROL_PERIOD)
_START = 500.0
_SIGHT = 200.0
SPEEDS = (8.0, 12.0, 16.67, 22.0)
GRADES = (-0.06, 0.0, 0.04)


@dataclass(frozen=True)
class RedLight:
    """A drive to a red light.

    Attributes:
      time: shape (n,) [s]; left: front bumper to the line [m]; speed [m/s].
      crossed: time at which the front crossed the line [s], inf for never.
      green: time of the change to green [s].
      braking: strongest deceleration before the truck is as slow as 0.5 m/s, smoothed over
        0.5 s: the jolt at standstill is the suspension's [m/s2].
    """

    time: FloatArray
    left: FloatArray
    speed: FloatArray
    crossed: float
    green: float
    braking: float

    @property
    def ran_red(self) -> bool:
        """Whether the line was crossed before the light was green."""
        return self.crossed < self.green

    @property
    def place(self) -> float:
        """Where the truck stood at red, from the line [m]; nan where it never did."""
        stood = np.flatnonzero((np.abs(self.speed) < 0.02) & (self.time < self.green))
        return float(self.left[stood[-1]]) if stood.size else math.nan


def drive_to_red(
    speed: float,
    payload: float,
    grade: float,
    *,
    known: bool,
    green: float | None = None,
    sight: float = _SIGHT,
) -> RedLight:
    """Drives to a light that is red until `green`, and on.

    Args:
      speed: at the start, and wanted [m/s].
      payload: [kg].
      grade: of the road, positive uphill.
      known: the light tells when it changes.
      green: time of the change [s]; default: 8 s after the truck could stand, or, where it is
        known, so early that arriving slowly will do.
      sight: front bumper to the line at the start [m].
    """
    if green is None:
        green = 1.5 * sight / speed if known else 1.6 * sight / speed + speed + 8.0
    route = Route.straight(length=3000.0, grade=grade)
    truck = Truck.load(payload, route=route, visuals=False)
    truck.reset(station=_START, offset=float(route.lane_offset(0, _START)), speed=speed)
    config = PlannerConfig(speed=SpeedConfig(cruise_speed=speed))
    stack = Stack(route, planner=config, parameters=truck.parameters)
    line = _START + truck.footprint.front_overhang + sight
    rows: list[tuple[float, float, float]] = []
    crossed = math.inf
    for tick in range(round((green + 8.0) / CONTROL_PERIOD)):
        ego = truck.observe()
        left = line - ego.station - truck.footprint.front_overhang
        crossed = ego.time if left < 0.0 and math.isinf(crossed) else crossed
        if tick % _CALLS == 0:
            red = ego.time < green
            told = RoadSignals()
            if left > -BEHIND:
                state = LightState.RED if red else LightState.GREEN
                after = (green - ego.time, LightState.GREEN) if red and known else (None, None)
                told = RoadSignals(TrafficLight(line, state, *after))
            stack.plan(Scene(ego.time, ego, (), truck.footprint, told))
        rows.append((ego.time, left, ego.speed))
        if left < -BEHIND:
            break
        truck.command(stack.control(ego))
        truck.step(round(CONTROL_PERIOD / truck.model.opt.timestep))
    time, way, speeds = np.array(rows).T
    return RedLight(time, way, speeds, crossed, green, _braking(speeds))


def _braking(speed: FloatArray) -> float:
    window = round(0.5 / CONTROL_PERIOD)
    lost = (speed[:-window] - speed[window:]) / (window * CONTROL_PERIOD)
    moving = speed[window:] > 0.5
    return float(lost[moving].max()) if moving.any() else 0.0


def _quick_green(speed: float) -> float:
    """A change to green some seconds after a truck stands that brakes at 1 m/s2 [s]."""
    return (_SIGHT - 0.5 * speed**2) / speed + speed + 5.0


def cases(quick: bool) -> list[tuple[float, float, float, bool]]:
    """Speed [m/s], payload [kg], grade, and whether the change is known."""
    if quick:
        return [(16.67, 36_000.0, -0.06, False)]
    return list(itertools.product(SPEEDS, (0.0, 36_000.0), GRADES, (False, True)))


def run_red_light(config: ValidateConfig) -> Results:
    """The matrix; the quick form is its hardest case."""
    results, lines = Results("red light"), []
    # The quick form does not wait at the line for longer than shows that the truck stays there.
    greens = {case: _quick_green(case[0]) if config.quick else None for case in cases(config.quick)}
    drives = {
        case: drive_to_red(*case[:3], known=case[3], green=green) for case, green in greens.items()
    }
    stops = [drive for case, drive in drives.items() if not case[3]]
    places = np.array([drive.place for drive in stops])
    ran = sum(drive.ran_red for drive in drives.values())
    label = f"red light on the truck, {len(drives)} drives"
    worst = math.nan if np.isnan(places).any() else float(places.max())
    results.checks += [
        Check(f"{label}: lines crossed at red", float(ran), "1", None, "== 0"),
        Check(f"{label}: farthest stand before the line", worst, "m", None, "<= 1.5"),
        Check(f"{label}: nearest stand before the line", float(places.min()), "m", None, ">= 0"),
        Check(
            f"{label}: strongest braking",
            max(drive.braking for drive in drives.values()),
            "m/s2",
            None,
            "<= 3.6",
        ),
    ]
    for (speed, payload, grade, known), drive in drives.items():
        if known == config.quick:
            continue
        name = f"{payload / 1e3:g} t of load, {speed:g} m/s, {100.0 * grade:g} %"
        lines.append(Line(name, -drive.left, drive.speed, "simulation"))
    results.figures["red light on the truck"] = [
        Panel("red light 200 m ahead", "from the line [m]", "speed [m/s]", tuple(lines))
    ]
    return results


# --- A wall across the lane, seen late: the MuJoCo truck with its stack brakes before it ---

_CONTROL, _PLAN = 0.02, 5
_CRUISE = 2.0


@dataclass(frozen=True)
class WallStop:
    """How a stop before a wall went.

    Attributes:
      gap: left between bumper and wall when the truck stands, negative for a hit [m].
      time: shape (n,) [s], the wall is seen at 0; speed [m/s]; place: way to the wall [m].
      emergencies: brakings of the last layer.
    """

    gap: float
    time: FloatArray
    speed: FloatArray
    place: FloatArray
    emergencies: int


def wall_stop(speed: float, sight: float, payload: float, timestep: float) -> WallStop:
    """Drives at a speed [m/s] until a wall appears `sight` metres before the bumper.

    Args:
      speed: [m/s].
      sight: bumper to wall when it is first seen [m].
      payload: [kg].
      timestep: of the physics [s].
    """
    route = Route.straight(length=3000.0)
    truck = Truck.load(payload, route=route, timestep=timestep, visuals=False)
    truck.reset(station=500.0, offset=float(route.lane_offset(0, 500.0)), speed=speed)
    config = PlannerConfig(speed=SpeedConfig(cruise_speed=speed))
    stack = Stack(route, planner=config, parameters=truck.parameters)
    wall, rows = np.inf, []
    for tick in range(round(40.0 / _CONTROL)):
        ego = truck.observe()
        front = ego.station + truck.footprint.front_overhang
        if not np.isfinite(wall) and ego.time >= _CRUISE:
            wall = front + sight
        if tick % _PLAN == 0:
            seen: tuple[TrackedVehicle, ...] = ()
            if np.isfinite(wall):
                # A car's middle stands half its length behind the wall.
                seen = (car(route, "wall", wall + 2.4, 0, 0.0),)
            stack.plan(Scene(ego.time, ego, seen, truck.footprint))
        rows.append((ego.time - _CRUISE, ego.speed, wall - front))
        if wall - front < 0.0 or (np.isfinite(wall) and ego.speed < 0.02):
            break
        truck.command(stack.control(ego))
        truck.step(round(_CONTROL / timestep))
    time, speeds, place = np.array(rows).T
    return WallStop(float(place[-1]), time, speeds, place, stack.planner.emergencies)
