"""`iits-mj validate plant`: error of the planar plants against the full truck.

The same commands, or the same driver, drive each shipped truck with each plant; the tables give the
greatest difference of its motion from that of the full truck, and of the saving of a fuel-optimal
plan. `iits_mj/plugin/README_plant.md` says what a planar plant leaves out.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from iits_mj.core.angles import wrap_angles
from iits_mj.core.arrays import FloatArray
from iits_mj.core.assets import DEFAULT_TRUCK
from iits_mj.core.messages import EgoState, VehicleCommand, XbrMode
from iits_mj.core.progress import each
from iits_mj.core.results import Findings, Line, Results
from iits_mj.core.timing import DYNAMIC_PLANTS
from iits_mj.core.units import KMH
from iits_mj.parameters import TruckParameters, shipped_trucks
from iits_mj.road import RoadMap, Route
from iits_mj.truck import Truck
from iits_mj.validation.harness.config import ValidateConfig
from iits_mj.validation.longitudinal.hills import SpeedKeeper
from iits_mj.validation.planning import replay_drives
from iits_mj.validation.planning.pcc_replay import valley_case

# Time step [s]: the one of training, and that for which the planar plants' speed is given.
_TIMESTEP = 0.005
_PERIOD = 0.01
# Driver on a road: preview time of the error [s], steer angle per error [rad/m], and lead of the
# road's curvature [s].
_PREVIEW, _GAIN, _LEAD = 2.0, 0.006, 0.3
# Signals below these peaks are not compared: yaw rate [rad/s], hitch angle [rad].
_STILL = 1e-3
# Compared quantities in the order of `Maneuver.bounds`, with the units of their errors.
_QUANTITIES = {
    "speed": "m/s",
    "yaw rate": "%",
    "hitch angle": "%",
    "lateral position": "m",
    "fuel": "%",
}
# A gear that is changed later by this time [s] leaves a difference of speed, which climbs even out
# within some tens of seconds [s].
_LATE, _SETTLING = 0.5, 30.0
# On a road, a driver wanders within the steering's dead band, at times that depend on rounding.
_FIRM = {"steering": {"dead_band": 0.0}}
_VALLEY = 1000.0  # [m] with grades from -4 to 4 %

Command = Callable[[Truck, float, EgoState], VehicleCommand]


@dataclass(frozen=True)
class Trace:
    """Motion every 10 ms in SI units, of shape (n,); `offset` is the lateral position [m].

    `articulation` has a row for each coupling.
    """

    time: FloatArray
    station: FloatArray
    speed: FloatArray
    yaw_rate: FloatArray
    offset: FloatArray
    fuel: FloatArray
    gear: FloatArray
    articulation: FloatArray

    def at(self, station: FloatArray) -> Trace:
        """The motion at these places of the road [m], shape (m,); beyond the end it stays."""
        moved = {
            name: np.interp(station, self.station, getattr(self, name))
            for name in ("time", "speed", "yaw_rate", "offset", "fuel")
        }
        nearest = np.searchsorted(self.station, station).clip(max=len(self.station) - 1)
        bent = np.array([np.interp(station, self.station, row) for row in self.articulation])
        return Trace(station=station, gear=self.gear[nearest], articulation=bent, **moved)

    def settled(self, other: Trace) -> NDArray[np.bool_]:
        """Where both have the same gear, and speeds are even after a change, shape (n,)."""
        differs = self.gear != other.gear
        edges = np.flatnonzero(np.diff(np.concatenate(([False], differs, [False]))))
        same = np.ones(len(differs), bool)
        for start, end in edges.reshape(-1, 2):
            late = (end - start) * _PERIOD >= _LATE
            same[start : end + round(_SETTLING / _PERIOD) * late] = False
        return same


@dataclass(frozen=True)
class Maneuver:
    """A maneuver and the allowed errors of the planar plants.

    Attributes:
      route: the road; None: a plane.
      share: of the greatest payload; speed: at the start [m/s]; duration: [s].
      driver: makes the command of a new drive.
      bounds: greatest errors: speed [m/s], yaw rate and hitch angle [% of their peaks], lateral
        position [m], fuel [%].
      other_gear: greatest share of the time in another gear [%]. Where it is given, the drives are
        compared at the same places of the road, where `Trace.settled`.
    """

    name: str
    route: Route | None
    share: float
    speed: float
    duration: float
    driver: Callable[[], Command]
    bounds: tuple[float, float, float, float, float]
    other_gear: float | None = None

    def drive(self, name: str, plant: str) -> tuple[Trace, tuple[str, ...]]:
        """Returns the motion of a truck with a plant, and the limits of validity exceeded."""
        truck = Truck.load(
            self.share * TruckParameters.load(name).payload_max,
            truck=name,
            parameters=None if self.route is None else _FIRM,
            route=self.route,
            timestep=_TIMESTEP,
            plant=plant,
            visuals=False,
        )
        state, command = truck.reset(speed=self.speed, station=30.0), self.driver()
        rows = []
        for _ in range(round(self.duration / _PERIOD)):
            truck.command(command(truck, state.time, state))
            truck.step(round(_PERIOD / _TIMESTEP))
            state = truck.observe()
            offset = state.y if self.route is None else state.offset
            rows.append(
                (state.time, state.station, state.speed, state.yaw_rate, offset, state.fuel_used,
                 state.gear, state.articulation, *state.rear_articulations)
            )  # fmt: skip
        columns = np.array(rows).T
        time, station, speed, yaw_rate, offset, fuel, gear = columns[:7]
        trace = Trace(time, station, speed, yaw_rate, offset, fuel, gear, columns[7:])
        return trace, truck.left_range


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
            error = wrap_angles(state.yaw - route.evaluate(state.station).heading)
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
        Maneuver("step steer 40 deg, 70 km/h", None, 1.0, 70 * KMH, 10.0,
                 _open_loop(0.4, _step), (0.05, 2.5, 3.0, 0.5, 0.2)),
        Maneuver("lane change 0.4 Hz, 80 km/h", None, 1.0, 80 * KMH, 8.0,
                 _open_loop(0.4, _sine), (0.05, 5.0, 5.0, 0.15, 0.2)),
        Maneuver("low-speed turn 300 deg, 10 km/h", None, 0.0, 10 * KMH, 30.0,
                 _open_loop(0.1, lambda t: np.deg2rad(300.0) * min(1.0, t / 4.0)),
                 (0.02, 1.0, 1.0, 0.1, 0.2)),
        Maneuver("bends of the highway, 60 km/h", highway, 1.0, 60 * KMH,
                 30.0 if quick else 120.0, _road_driver(60 * KMH), (0.2, 5.0, 5.0, 0.1, 0.5)),
        Maneuver("braking 3 m/s2, 80 km/h", None, 1.0, 80 * KMH, 10.0, _brake(3.0),
                 (0.25, 5.0, 5.0, 0.1, 1.0)),
        Maneuver("braking with ABS on friction 0.3, 60 km/h", Route.straight(friction=0.3), 0.0,
                 60 * KMH, 8.0, _brake(6.0), (0.25, 5.0, 5.0, 0.1, 1.0)),
        Maneuver("climb 5 %, full pedal", Route.straight(grade=0.05), 1.0, 60 * KMH, 60.0,
                 _open_loop(1.0, _straight), (0.1, 5.0, 5.0, 0.1, 0.2)),
        Maneuver("long haul on the highway, 75 km/h", highway, 1.0, 75 * KMH, haul,
                 _road_driver(75 * KMH), (0.2, 3.0, 3.0, 0.2, 0.3), 3.0),
    ]  # fmt: skip


def compare(maneuver: Maneuver, truck: str = DEFAULT_TRUCK) -> Findings:
    """Errors of both planar plants in one maneuver of a shipped truck; the default has bounds."""
    bounded = truck == DEFAULT_TRUCK
    found = Findings(f"{truck}, {maneuver.name}" if not bounded else maneuver.name)
    full, _ = maneuver.drive(truck, DYNAMIC_PLANTS[0])
    lines = [Line("full", full.time, full.yaw_rate, "reference")]
    peaks = _peaks(full)
    for plant in DYNAMIC_PLANTS[1:]:
        trace, left = maneuver.drive(truck, plant)
        errors = _errors(trace, full, maneuver.other_gear is not None)
        if maneuver.other_gear is not None:
            other = 100.0 * np.mean(trace.at(full.station).gear != full.gear)
            must = f"<= {maneuver.other_gear:g}" if bounded else ""
            found.check(f"{plant}, time in another gear", float(other), "%", must=must)
        for (name, unit), bound in zip(_QUANTITIES.items(), maneuver.bounds, strict=True):
            if name in errors:
                must = f"<= {bound:g}" if bounded else ""
                found.check(f"{plant}, {name}", errors[name], unit, peaks.get(name), must)
        found.check(f"{plant}, limits exceeded", len(left), "1", None, "<= 0")
        lines.append(Line(plant, trace.time, trace.yaw_rate, "simulation"))
    if bounded and peaks["yaw rate"] > _STILL:
        found.panel("yaw rate", "time [s]", "yaw rate [rad/s]", *lines)
    return found


def _peaks(full: Trace) -> dict[str, float]:
    """References of the errors in percent: yaw rate [rad/s], hitch angle [rad], fuel [kg]."""
    return {
        "yaw rate": float(np.max(np.abs(full.yaw_rate))),
        "hitch angle": float(np.max(np.abs(full.articulation))),
        "fuel": float(full.fuel[-1]),
    }


def _errors(trace: Trace, full: Trace, by_place: bool) -> dict[str, float]:
    """Greatest differences of the motion, of the quantities that the maneuver excites."""
    peaks = _peaks(full)
    counts = np.ones(len(full.time), bool)
    fuel = 100.0 * np.abs(trace.fuel[-1] / full.fuel[-1] - 1.0) if peaks["fuel"] > 0.01 else None
    if by_place:
        trace = trace.at(full.station)
        counts = trace.settled(full)

    def greatest(name: str) -> float:
        change = np.abs(getattr(trace, name) - getattr(full, name))
        return float(np.max(change[..., counts]))

    found = {"speed": greatest("speed"), "lateral position": greatest("offset")}
    for quantity, name in (("yaw rate", "yaw_rate"), ("hitch angle", "articulation")):
        if peaks[quantity] > _STILL:
            found[quantity] = 100.0 * greatest(name) / peaks[quantity]
    if fuel is not None:
        found["fuel"] = float(fuel)
    return found


def compare_savings() -> Findings:
    """Saving of a fuel-optimal plan against a cruise through a valley, with each plant."""
    found = Findings("PCC replay through a valley")
    case = valley_case(_VALLEY, _TIMESTEP)
    drives = {plant: replay_drives.run(replace(case, plant=plant)) for plant in DYNAMIC_PLANTS}
    full = drives.pop(DYNAMIC_PLANTS[0])
    for plant, drive in drives.items():
        change = 100.0 * abs(drive.raw_saving - full.raw_saving)
        found.check(f"{plant}, saving", change, "points", 100.0 * full.raw_saving, "<= 0.3")
        fuel = 100.0 * abs(drive.cruise.fuel / full.cruise.fuel - 1.0)
        found.check(f"{plant}, fuel of the cruise", fuel, "%", full.cruise.fuel, "<= 0.5")
    return found


def run(config: ValidateConfig) -> Results:
    """Errors of the planar plants in all maneuvers; the quick form has the default truck only."""
    parts = []
    for name in each((DEFAULT_TRUCK,) if config.quick else shipped_trucks(), "plants", str):
        part = Results(f"validate plant {name}")
        for maneuver in maneuvers(config.quick):
            figure = maneuver.name.split(",")[0].replace(" ", "_")
            part.add(figure, compare(maneuver, name))
        parts.append(part)
    parts[0].add("pcc_replay", compare_savings())
    parts[0].notes.append(
        "Greatest difference over the maneuver at steps of 5 ms; yaw rate and hitch angle in "
        "percent of their peaks, which the reference column gives. The hitch angle is the worst of "
        "all couplings. On roads the steering has no dead band, because within it a driver wanders "
        "at times that depend on rounding. The long haul is compared at the same places of the "
        "road, where both trucks have the same gear, and not for 30 s after one of them changed it "
        "0.5 s or more after the other: such a change shifts all that follows. "
        f"The bounds are those of the truck {DEFAULT_TRUCK}; the others' errors inform."
    )
    return Results.merged("validate plant", parts)
