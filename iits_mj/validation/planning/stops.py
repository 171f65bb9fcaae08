"""Stops of the MuJoCo truck with its stack: before red lights, and before a wall seen late.

Red lights: laden and empty, uphill and down, with and without knowledge of when the light changes.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np

from controllers.planning.planner import PlannerConfig
from controllers.planning.speed_plan import SpeedConfig
from controllers.stack import Stack
from iits_mj.core.messages import (
    EgoState,
    LightState,
    RoadSignals,
    Scene,
    TrackedVehicle,
    TrafficLight,
)
from iits_mj.core.results import Findings, Line
from iits_mj.core.timing import CONTROL_PERIOD, TIMESTEP
from iits_mj.road import Route
from iits_mj.simulation.frame import BEHIND
from iits_mj.truck import Truck
from iits_mj.validation.harness.config import laden
from iits_mj.validation.planning.closed_loop import Record, Recorder, run_recorded
from iits_mj.validation.planning.ideal_drive import car

_START = 500.0
_LENGTH = 3000.0
_SIGHT = 200.0
SPEEDS = (8.0, 12.0, 16.67, 22.0)
GRADES = (-0.06, 0.0, 0.04)
# The wall appears after this time [s]; the drive before it ends after _WALL_DURATION [s].
_WALL_TIME, _WALL_DURATION = 2.0, 40.0
_COLUMNS = ("time", "left", "speed")


@dataclass(frozen=True)
class StopDrive:
    """A drive to a line across the lane: a stop line, or a wall.

    Attributes:
      record: time [s]; left: front bumper to the line [m], inf before it is seen; speed [m/s].
      green: time of the change to green [s]; inf for a wall.
      emergencies: emergency brakings of the planner.
    """

    record: Record
    green: float
    emergencies: int

    @property
    def crossed(self) -> float:
        """Time at which the front bumper crossed the line [s]; inf if it did not."""
        beyond = np.flatnonzero(self.record["left"] < 0.0)
        return float(self.record["time"][beyond[0]]) if beyond.size else math.inf

    @property
    def ran_red(self) -> bool:
        """Whether the truck crossed the line before the light was green."""
        return self.crossed < self.green

    @property
    def place(self) -> float:
        """Distance to the line of the last standstill at red [m]; nan without one."""
        record = self.record
        stood = np.flatnonzero((np.abs(record["speed"]) < 0.02) & (record["time"] < self.green))
        return float(record["left"][stood[-1]]) if stood.size else math.nan

    @property
    def braking(self) -> float:
        """Strongest deceleration above 0.5 m/s, smoothed over 0.5 s [m/s2].

        The jolt of the suspension at standstill does not count.
        """
        speed, window = self.record["speed"], round(0.5 / CONTROL_PERIOD)
        lost = (speed[:-window] - speed[window:]) / (window * CONTROL_PERIOD)
        moving = speed[window:] > 0.5
        return float(lost[moving].max()) if moving.any() else 0.0


def _truck_and_stack(
    speed: float, payload: float, route: Route, timestep: float = TIMESTEP
) -> tuple[Truck, Stack]:
    """Returns the truck at a speed [m/s] and a stack with the same cruise speed."""
    truck = Truck.load(payload, route=route, timestep=timestep, visuals=False)
    truck.reset(station=_START, offset=float(route.lane_offset(0, _START)), speed=speed)
    config = PlannerConfig(speed=SpeedConfig(cruise_speed=speed))
    return truck, Stack(route, planner=config, parameters=truck.parameters)


def drive_to_red(
    speed: float,
    payload: float,
    grade: float,
    *,
    known: bool,
    green: float | None = None,
    sight: float = _SIGHT,
) -> StopDrive:
    """Drives to a light that is red until `green`, and past it.

    Args:
      speed: at the start, and of the cruise [m/s].
      payload: [kg].
      grade: of the road, positive uphill.
      known: whether the light announces its change.
      green: time of the change [s]; default: 8 s after a possible standstill; of a known change so
        early that a slow approach suffices.
      sight: front bumper to the line at the start [m].
    """
    if green is None:
        green = 1.5 * sight / speed if known else 1.6 * sight / speed + speed + 8.0
    change = green
    route = Route.straight(length=_LENGTH, grade=grade)
    truck, stack = _truck_and_stack(speed, payload, route)
    overhang = truck.footprint.front_overhang
    line = _START + overhang + sight

    def left(ego: EgoState) -> float:
        return line - ego.station - overhang

    def scene(ego: EgoState) -> Scene:
        red = ego.time < change
        signals = RoadSignals()
        if left(ego) > -BEHIND:
            state = LightState.RED if red else LightState.GREEN
            after = (change - ego.time, LightState.GREEN) if red and known else (None, None)
            signals = RoadSignals(TrafficLight(line, state, *after))
        return Scene(ego.time, ego, (), truck.footprint, signals)

    record, _ = run_recorded(
        truck,
        stack,
        Recorder(_COLUMNS, lambda ego, _: (ego.time, left(ego), ego.speed)),
        scene,
        timestep=TIMESTEP,
        duration=green + 8.0,
        until=lambda ego: left(ego) < -BEHIND,
    )
    return StopDrive(record, green, stack.planner.emergencies)


def wall_stop(speed: float, sight: float, payload: float, timestep: float) -> StopDrive:
    """Drives at a speed [m/s] until a wall appears at a distance `sight` [m] from the bumper.

    The time of the record starts with the wall. Payload [kg], time step of the physics [s].
    """
    route = Route.straight(length=_LENGTH)
    truck, stack = _truck_and_stack(speed, payload, route, timestep)
    wall = math.inf

    def left(ego: EgoState) -> float:
        nonlocal wall
        front = ego.station + truck.footprint.front_overhang
        if math.isinf(wall) and ego.time >= _WALL_TIME:
            wall = front + sight
        return wall - front

    def scene(ego: EgoState) -> Scene:
        seen: tuple[TrackedVehicle, ...] = ()
        if math.isfinite(left(ego)):
            # A car's middle is half its length behind the wall.
            seen = (car(route, "wall", wall + 2.4, 0, 0.0),)
        return Scene(ego.time, ego, seen, truck.footprint)

    record, _ = run_recorded(
        truck,
        stack,
        Recorder(_COLUMNS, lambda ego, _: (ego.time - _WALL_TIME, left(ego), ego.speed)),
        scene,
        timestep=timestep,
        duration=_WALL_DURATION,
        until=lambda ego: left(ego) < 0.0 or (math.isfinite(wall) and ego.speed < 0.02),
    )
    return StopDrive(record, math.inf, stack.planner.emergencies)


def cases(quick: bool) -> list[tuple[float, float, float, bool]]:
    """Returns speed [m/s], payload [kg], grade, and whether the change is known, of all drives."""
    if quick:
        return [(16.67, laden(), -0.06, False)]
    return list(itertools.product(SPEEDS, (0.0, laden()), GRADES, (False, True)))


def _quick_green(speed: float) -> float:
    """Returns a time of change [s] some seconds after the standstill of braking at 1 m/s2."""
    return (_SIGHT - 0.5 * speed**2) / speed + speed + 5.0


def red_light_on_truck(quick: bool) -> Findings:
    """Drives the matrix of red lights; the quick form is its hardest case."""
    drives, lines = {}, []
    for case in cases(quick):
        # The quick form waits at the line only long enough to show that the truck stays there.
        green = _quick_green(case[0]) if quick else None
        drives[case] = drive_to_red(*case[:3], known=case[3], green=green)
    places = np.array([drive.place for case, drive in drives.items() if not case[3]])
    ran = sum(drive.ran_red for drive in drives.values())
    worst = math.nan if np.isnan(places).any() else float(places.max())
    braking = max(drive.braking for drive in drives.values())
    found = Findings(f"red light on the truck, {len(drives)} drives")
    found.check("lines crossed at red", ran, "1", must="== 0")
    found.check("farthest stand before the line", worst, "m", must="<= 1.5")
    found.check("nearest stand before the line", places.min(), "m", must=">= 0")
    found.check("strongest braking", braking, "m/s2", must="<= 3.6")
    for (speed, payload, grade, known), drive in drives.items():
        if known == quick:
            continue
        name = f"{payload / 1e3:g} t of load, {speed:g} m/s, {100.0 * grade:g} %"
        lines.append(Line(name, -drive.record["left"], drive.record["speed"], "simulation"))
    found.label = ""
    found.panel("red light 200 m ahead", "from the line [m]", "speed [m/s]", *lines)
    return found
