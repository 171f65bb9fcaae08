"""`iits-mj validate plant`: error of the planar plants against the full truck.

The same commands, or the same driver, drive the truck of each plant; the tables give the greatest
difference of its motion from that of the full truck. `iits_mj/plugin/README_plant.md` says what a
planar plant leaves out.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from iits_mj.core.arrays import FloatArray
from iits_mj.core.messages import EgoState, VehicleCommand, XbrMode
from iits_mj.core.results import Findings, Line, Results
from iits_mj.core.timing import PLANTS
from iits_mj.core.units import KMH
from iits_mj.road import RoadMap, Route
from iits_mj.truck import Truck
from iits_mj.validation.harness.config import ValidateConfig, laden
from iits_mj.validation.longitudinal.hills import SpeedKeeper

# Time step [s]: the one of training, and that for which the planar plants' speed is given.
_TIMESTEP = 0.005
_PERIOD = 0.01
# Driver on a road: preview time of the error [s], steer angle per error [rad/m], and lead of the
# road's curvature [s].
_PREVIEW, _GAIN, _LEAD = 2.0, 0.006, 0.3
# Signals below these peaks are not compared: yaw rate [rad/s], hitch angle [rad].
_STILL = 1e-3

Command = Callable[[Truck, float, EgoState], VehicleCommand]


@dataclass(frozen=True)
class Trace:
    """Motion every 10 ms, each of shape (n,): SI units; `offset` is the lateral position [m]."""

    time: FloatArray
    speed: FloatArray
    yaw_rate: FloatArray
    articulation: FloatArray
    offset: FloatArray
    fuel: FloatArray


@dataclass(frozen=True)
class Maneuver:
    """A maneuver and the allowed errors of the planar plants.

    Attributes:
      route: the road; None: a plane.
      payload: [kg]; speed: at the start [m/s]; duration: [s].
      driver: makes the command of a new drive.
      bounds: greatest errors: speed [m/s], yaw rate and hitch angle [% of their peaks], lateral
        position [m], fuel [%].
    """

    name: str
    route: Route | None
    payload: float
    speed: float
    duration: float
    driver: Callable[[], Command]
    bounds: tuple[float, float, float, float, float]

    def drive(self, plant: str) -> tuple[Trace, tuple[str, ...]]:
        """Returns the motion with a plant, and the limits of validity that it exceeded."""
        truck = Truck.load(
            self.payload, route=self.route, timestep=_TIMESTEP, plant=plant, visuals=False
        )
        state, command = truck.reset(speed=self.speed, station=30.0), self.driver()
        rows = []
        for _ in range(round(self.duration / _PERIOD)):
            truck.command(command(truck, state.time, state))
            truck.step(round(_PERIOD / _TIMESTEP))
            state = truck.observe()
            offset = state.y if self.route is None else state.offset
            rows.append(
                (state.time, state.speed, state.yaw_rate, state.articulation, offset,
                 state.fuel_used)
            )  # fmt: skip
        return Trace(*np.array(rows).T), truck.left_range


def _open_loop(pedal: float, steering: Callable[[float], float]) -> Callable[[], Command]:
    """Driver with a fixed pedal and a steering-wheel angle over time."""

    def command(truck: Truck, time: float, state: EgoState) -> VehicleCommand:
        del truck, state
        return VehicleCommand(accelerator_pedal=pedal, steering_wheel_angle=steering(time))

    return lambda: command


def _step(time: float) -> float:
    return np.deg2rad(40.0) * float(np.clip((time - 1.0) / 0.4, 0.0, 1.0))


def _sine(time: float) -> float:
    phase = 0.4 * (time - 1.0)
    return np.deg2rad(45.0) * float(np.sin(2.0 * np.pi * phase)) if 0.0 < phase < 1.0 else 0.0


def _straight(time: float) -> float:
    del time
    return 0.0


def _brake(demand: float) -> Callable[[], Command]:
    def command(truck: Truck, time: float, state: EgoState) -> VehicleCommand:
        del truck, state
        on = time > 1.0
        return VehicleCommand(
            xbr_demand=-demand if on else 0.0, xbr_mode=XbrMode.MAXIMUM if on else XbrMode.OFF
        )

    return lambda: command


def _road_driver(speed: float) -> Callable[[], Command]:
    """Driver who keeps the middle of the road and a speed [m/s]."""

    def start() -> Command:
        keeper = SpeedKeeper(0.3)

        def command(truck: Truck, time: float, state: EgoState) -> VehicleCommand:
            del time
            route, parameters = truck.route, truck.parameters
            ahead = state.station + _LEAD * state.speed
            point = route.evaluate(ahead)
            heading = float(route.evaluate(state.station).heading)
            error = state.yaw - heading
            error = (error + np.pi) % (2.0 * np.pi) - np.pi
            previewed = state.offset + _PREVIEW * state.speed * np.sin(error)
            wheelbase = parameters.lead.axles[1].position + 0.7
            angle = wheelbase * float(point.curvature) - _GAIN * previewed
            wheel = float(np.clip(parameters.steering.ratio * angle, -6.0, 6.0))
            return replace(keeper.command(state.speed, speed), steering_wheel_angle=wheel)

        return command

    return start


def maneuvers(quick: bool) -> list[Maneuver]:
    """Returns the maneuvers; the quick form has a short long haul."""
    highway = RoadMap.builtin().route()
    haul = 60.0 if quick else 700.0
    return [
        Maneuver("step steer 40 deg, 70 km/h", None, laden(), 70 * KMH, 10.0,
                 _open_loop(0.4, _step), (0.05, 2.5, 3.0, 0.5, 0.2)),
        Maneuver("lane change 0.4 Hz, 80 km/h", None, laden(), 80 * KMH, 8.0,
                 _open_loop(0.4, _sine), (0.05, 5.0, 5.0, 0.15, 0.2)),
        Maneuver("low-speed turn 300 deg, 10 km/h", None, 0.0, 10 * KMH, 30.0,
                 _open_loop(0.1, lambda t: np.deg2rad(300.0) * min(1.0, t / 4.0)),
                 (0.02, 1.0, 1.0, 0.1, 0.2)),
        Maneuver("bends of the highway, 60 km/h", highway, laden(), 60 * KMH,
                 30.0 if quick else 120.0, _road_driver(60 * KMH), (0.2, 5.0, 5.0, 0.1, 0.5)),
        Maneuver("braking 3 m/s2, 80 km/h", None, laden(), 80 * KMH, 10.0, _brake(3.0),
                 (0.25, 5.0, 5.0, 0.1, 1.0)),
        Maneuver("braking with ABS on friction 0.3, 60 km/h", Route.straight(friction=0.3), 0.0,
                 60 * KMH, 8.0, _brake(6.0), (0.25, 5.0, 5.0, 0.1, 1.0)),
        Maneuver("climb 5 %, full pedal", Route.straight(grade=0.05), laden(), 60 * KMH, 60.0,
                 _open_loop(1.0, _straight), (0.1, 5.0, 5.0, 0.1, 0.2)),
        Maneuver("long haul on the highway, 75 km/h", highway, laden(), 75 * KMH, haul,
                 _road_driver(75 * KMH), (0.2, 6.0, 6.0, 0.2, 0.3)),
    ]  # fmt: skip


def compare(maneuver: Maneuver) -> Findings:
    """Errors of both planar plants in one maneuver."""
    found = Findings(maneuver.name)
    full, _ = maneuver.drive(PLANTS[0])
    lines = [Line("full", full.time, full.yaw_rate, "reference")]
    fuel = float(full.fuel[-1])
    for plant in PLANTS[1:]:
        trace, left = maneuver.drive(plant)
        speed, yaw, hitch, lateral, share = maneuver.bounds

        def error(name: str, trace: Trace = trace) -> float:
            return float(np.max(np.abs(getattr(trace, name) - getattr(full, name))))

        found.check(f"{plant}, speed", error("speed"), "m/s", None, f"<= {speed:g}")
        for name, title, bound in (
            ("yaw_rate", "yaw rate", yaw), ("articulation", "hitch angle", hitch)
        ):  # fmt: skip
            peak = float(np.max(np.abs(getattr(full, name))))
            if peak > _STILL:
                text = f"<= {bound:g}"
                found.check(f"{plant}, {title}", 100.0 * error(name) / peak, "%", peak, text)
        found.check(f"{plant}, lateral position", error("offset"), "m", None, f"<= {lateral:g}")
        if fuel > 0.01:
            change = 100.0 * abs(trace.fuel[-1] / fuel - 1.0)
            found.check(f"{plant}, fuel", change, "%", fuel, f"<= {share:g}")
        found.check(f"{plant}, limits exceeded", len(left), "1", None, "<= 0")
        lines.append(Line(plant, trace.time, trace.yaw_rate, "simulation"))
    if np.max(np.abs(full.yaw_rate)) > _STILL:
        found.panel("yaw rate", "time [s]", "yaw rate [rad/s]", *lines)
    return found


def run(config: ValidateConfig) -> Results:
    """Errors of the planar plants in all maneuvers."""
    results = Results("validate plant")
    for maneuver in maneuvers(config.quick):
        results.add(maneuver.name.split(",")[0].replace(" ", "_"), compare(maneuver))
    results.notes.append(
        "Greatest difference over the maneuver at steps of 5 ms; yaw rate and hitch angle in "
        "percent of their peaks, which the reference column gives."
    )
    return results
