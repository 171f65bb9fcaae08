"""The planner in situations: the three of the paper's lane-change figure, and others.

The paper has (a) no lane, (b) collision risk, (c) valid and safe. Added are a lane that ends beside
a stream of cars, a red light, a wall seen late, ordinary traffic, bends, and random states.
"""

from __future__ import annotations

import math

import numpy as np

from controllers.planning.planner import PlannerConfig
from controllers.planning.predicted_boxes import swept_path
from controllers.planning.road_preview import RoadPreview, lane_shift
from iits_mj.core.arrays import FloatArray
from iits_mj.core.messages import (
    Decision,
    EgoState,
    LightState,
    PlanMode,
    RoadSignals,
    TrackedVehicle,
    TrafficLight,
    Trajectory,
)
from iits_mj.core.results import Findings, Line, Panel, Results
from iits_mj.core.timing import CYCLE_PERIOD, TIMESTEP
from iits_mj.parameters import TruckParameters
from iits_mj.road import RoadMap, Route
from iits_mj.road.measured import Lanes, measured_route
from iits_mj.validation.harness.config import ValidateConfig, laden
from iits_mj.validation.planning.ideal_drive import IdealDrive, Vehicles, car, once
from iits_mj.validation.planning.planner_limits import ordinary_drive, random_breaches
from iits_mj.validation.planning.stops import red_light_on_truck, wall_stop

SPEED = 16.67
_START = 500.0
_RADIUS, _RAMP_LANE = 100.0, 3.5


def run_situations(config: ValidateConfig) -> Results:
    """Drives all situations; the quick form is shorter, with fewer random states and one wall."""
    highway = RoadMap.builtin().route()
    results = Results("planning situations")
    results.add("lane change, seen from above", _three_situations())
    results.add("lane end, seen from above", _lane_end(highway, config.quick))
    results.add("", _red_light(config.quick))
    results.add("red light on the truck", red_light_on_truck(config.quick))
    results.add("emergency stop", _wall(config))
    results.add("", _ordinary(config.quick))
    results.add("trailer in a bend", _ramp())
    results.add("", _random(highway, config.quick))
    return results


def _three_situations() -> Findings:
    """The three situations of the paper's Fig. lc."""
    route, found = Route.straight(length=3000.0), Findings()
    there = (_START - 40.0, _START + 140.0)
    invalid = IdealDrive(route, _START, 0, SPEED).run(2.0, decide=once(1.0, Decision.RIGHT))
    unsafe = IdealDrive(route, _START, 0, SPEED)
    unsafe.run(2.0, _beside(route), once(1.0, Decision.LEFT))
    safe = IdealDrive(route, _START, 0, SPEED)
    safe.run(12.0, _far(route), once(1.0, Decision.LEFT))
    begun = next(plan for plan in safe.plans if plan.mode is PlanMode.LANE_CHANGE)
    changing = sum(plan.mode is PlanMode.LANE_CHANGE for plan in safe.plans) * CYCLE_PERIOD
    middle = float(route.lane_offset(1, _START))
    kept = max(
        abs(state.offset - drive.states[0].offset)
        for drive in (invalid, unsafe)
        for state in drive.states
    )
    apart = abs(safe.ego.offset - middle)
    at_end = "valid and safe: offset from the target lane's middle at the end"
    found.check("no lane: refused", invalid.planner.refused, "1", must="== 1")
    found.check("collision risk: refused as unsafe", unsafe.planner.unsafe, "1", must="== 1")
    found.check(
        "refused changes: greatest offset from the lane's middle", kept, "m", 0.0, "<= 0.01"
    )
    found.check("valid and safe: changed", safe.planner.lane_changes, "1", must="== 1")
    found.check("valid and safe: duration laden", changing, "s", must="4.5 .. 9")
    found.check(at_end, apart, "m", 0.0, "<= 0.05")
    found.check("valid and safe: least gap", safe.least_gap(), "m", must=">= 10")
    found.panels += [
        seen_from_above("(a) no lane to the right", invalid, (1.0,), invalid.plans[10], there),
        seen_from_above("(b) collision risk: kept", unsafe, (1.0,), unsafe.plans[10], there),
        seen_from_above("(c) valid and safe", safe, (1.0, 4.0, 7.0), begun, there),
    ]
    found.notes.append(f"(a) {invalid.plans[10].reason}; (b) {unsafe.plans[10].reason}")
    return found


def _beside(route: Route) -> Vehicles:
    return lambda ego: (car(route, "car", _START - 8.0 + SPEED * ego.time, 1, SPEED),)


def _far(route: Route) -> Vehicles:
    return lambda ego: (
        car(route, "ahead", _START + 70.0 + SPEED * ego.time, 1, SPEED),
        car(route, "behind", _START - 60.0 + SPEED * ego.time, 1, SPEED),
    )


def _lane_end(route: Route, quick: bool) -> Findings:
    """The highway's third lane ends beside a stream of cars with one gap.

    The cars do not make room: the truck must use the gap that it has aimed for.
    """
    found, speed, begin = Findings("lane end"), 14.0, 4050.0
    drive = IdealDrive(route, begin, 2, speed)
    hole = -30.0

    def stream(ego: EgoState) -> tuple[TrackedVehicle, ...]:
        places = [begin + hole + 34.0 * k + speed * ego.time for k in range(-12, 13) if k != 0]
        return tuple(car(route, f"c{k}", place, 1, speed) for k, place in enumerate(places))

    drive.run(22.0 if quick else 40.0, stream)
    begun = next(
        (row for row, plan in enumerate(drive.plans) if plan.mode is PlanMode.LANE_CHANGE), 0
    )
    slowest = min(state.speed for state in drive.states)
    found.check("changed", drive.planner.lane_changes, "1", must="== 1")
    found.check("slowest speed", slowest, "m/s", speed, ">= 7")
    gap = "least gap to cars that make no room"
    found.check(gap, drive.least_gap(), "m", must=">= 8")
    found.check("strongest braking", drive.strongest_braking(), "m/s2", must="<= 2")
    place, time = drive.states[begun].station, begun * CYCLE_PERIOD
    found.panels.append(
        seen_from_above(
            "a lane that ends: the hole of the stream is taken",
            drive,
            (time, time + 5.0),
            drive.plans[begun],
            (place - 60.0, place + 160.0),
        )
    )
    found.notes.append(f"lane end: {drive.plans[max(begun - 1, 0)].reason}")
    return found


def _red_light(quick: bool) -> Findings:
    """A light that is red for 26 s, seen from 180 m."""
    found, line, green = Findings("red light"), 700.0, 26.0
    drive = IdealDrive(Route.straight(length=3000.0), 518.6, 0, SPEED)

    def lights(ego: EgoState) -> RoadSignals:
        if ego.station + 1.4 > line:
            return RoadSignals()
        state = LightState.RED if ego.time < green else LightState.GREEN
        return RoadSignals(TrafficLight(line, state))

    drive.run(green + (2.0 if quick else 15.0), signals=lights)
    stood = [state for state in drive.states if state.speed < 0.05 and state.time < green]
    left = line - (stood[-1].station + 1.4) if stood else math.nan
    started = next((s.time - green for s in drive.states if s.time > green and s.speed > 0.5), 60.0)
    found.check("bumper before the line", left, "m", must="0 .. 1")
    found.check("strongest braking", drive.strongest_braking(), "m/s2", must="<= 1.5")
    found.check("0.5 m/s after green", started, "s", must="<= 3")
    return found


def _wall(config: ValidateConfig) -> Findings:
    """A wall 70 m before the bumper at 90 km/h, on the MuJoCo truck."""
    found, lines, sight = Findings(), [], 70.0
    for payload in (laden(),) if config.quick else config.payloads():
        record = wall_stop(25.0, sight, payload, TIMESTEP).record
        label = f"wall {sight:g} m ahead at 90 km/h, {payload / 1e3:g} t of load: room left"
        found.check(label, record["left"][-1], "m", must=">= 0")
        lines.append(Line(f"{payload / 1e3:g} t", record["time"], record["speed"], "simulation"))
    found.panel("wall seen 70 m ahead", "time [s]", "speed [m/s]", *lines)
    return found


def _ordinary(quick: bool) -> Findings:
    """Traffic of the fast world: no emergency braking, and sufficient gaps."""
    cases = [(0.05, 0)] if quick else [(p, s) for p in (0.12, 0.05) for s in (0, 1)]
    drives = [ordinary_drive(p, 8.0 if quick else 300.0, s) for p, s in cases]
    minutes = sum(drive.duration for drive in drives) / 60.0
    found = Findings(f"{minutes:g} min of traffic")
    alarms, braking = sum(d.emergencies for d in drives), max(d.braking for d in drives)
    found.check("emergency brakings", alarms, "1", must="== 0")
    found.check("lane changes", sum(d.changes for d in drives), "1")
    found.check("changes given up", sum(d.aborted for d in drives), "1")
    found.check("least gap", min(d.gap for d in drives), "m", must=">= 2")
    found.check("strongest braking", braking, "m/s2", must="<= 2.8")
    found.label = ""
    found.check("CPU time of a plan, median", 1e3 * drives[0].cost, "ms")
    return found


def _ramp() -> Findings:
    """A bend of 100 m in a lane of 3.5 m at walking pace: positions of tractor and trailer."""
    found, parameters = Findings(), TruckParameters.load()
    station = np.arange(0.0, 500.0, 5.0)
    curvature = np.interp(station, [150.0, 190.0, 310.0, 350.0], [0.0, 1.0, 1.0, 0.0]) / _RADIUS
    lanes = Lanes(1, _RAMP_LANE, 8.0)
    route = measured_route(station, np.zeros_like(station), curvature=curvature, lanes=lanes)
    preview = RoadPreview(route)
    laden = parameters.gross_mass(parameters.payload_max)
    shift = lane_shift(preview, parameters, laden, PlannerConfig().speed.curve_acceleration)
    lines = []
    for name, shifted in (("on the lane's middle", False), ("placed for the trailer", True)):
        preview.shift = shift if shifted else np.zeros_like(shift)
        lane = preview.follow(0, 100.0, 400.0, 100.0)
        along = np.arange(60.0, 470.0, 0.5)
        point = route.evaluate(along, lane.driven_at(along))
        swept = swept_path(parameters, np.column_stack([point.x, point.y]), float(point.heading[0]))
        places = [
            route.locate(float(x), float(y), float(s))
            for s, (x, y) in zip(along, swept[-1].group, strict=True)
        ]
        at, offset = np.array(places).T
        beside = offset - lane.offset_at(at)
        room = 0.5 * (_RAMP_LANE - parameters.last.width) - np.abs(beside[at > 100.0])
        must = ">= 0.2" if shifted else ""
        label = f"R = {_RADIUS:g} m, lane of {_RAMP_LANE:g} m, {name}: trailer's room"
        found.check(label, room.min(), "m", must=must)
        role = "simulation" if shifted else "reference"
        lines.append(Line(f"trailer, steer axle {name}", at, beside, role))
        if shifted:
            lines.append(Line("steer axle", along, lane.driven_at(along) - lane.offset_at(along)))
    found.panel("off-tracking, 100 m to the left", "station [m]", "from the middle [m]", *lines)
    return found


def _random(highway: Route, quick: bool) -> Findings:
    """Random states on both roads."""
    count = 30 if quick else 1500
    breaches = random_breaches([Route.straight(length=6000.0), highway], count)
    label = f"{breaches.trajectories} trajectories from {count} random states"
    found = Findings(notes=breaches.found[:3])
    found.check(f"{label}: limits broken", len(breaches.found), "1", must="== 0")
    found.check(f"{label}: of them in a change", breaches.changes, "1")
    lateral = "of the lateral limit, greatest share in a change"
    found.check(lateral, breaches.lateral, "1", 1.0, "<= 1.01")
    found.check("of the roll-over threshold, greatest share", breaches.total, "1", 1.0, "<= 0.45")
    found.check("step between successive plans across the road", breaches.jump, "m", 0.0, "<= 0.01")
    return found


def seen_from_above(
    title: str,
    drive: IdealDrive,
    moments: tuple[float, ...],
    plan: Trajectory,
    reach: tuple[float, float],
) -> Panel:
    """Returns a drive on a straight road in road coordinates: x is the station, y the offset.

    The bodies are drawn at the `moments` [s], the path of the plan as a line, between the stations
    of `reach` [m].
    """
    lines = _lanes(drive.route, reach)
    lines.append(Line("planned path", plan.station, plan.offset, "reference"))
    parameters = TruckParameters.load()
    path = np.array([[state.station, state.offset] for state in drive.states])
    swept = swept_path(parameters, path, 0.0)
    times = np.array([state.time for state in drive.states])
    for number, moment in enumerate(moments):
        row = int(np.argmin(np.abs(times - moment)))
        for vehicle in drive.scenes[row].vehicles:
            half, side = 0.5 * vehicle.length, 0.5 * vehicle.width
            center = np.array([vehicle.station, vehicle.offset])
            box = center + np.array([[half, side], [half, -side], [-half, -side], [-half, side]])
            lines.append(_closed(box, "", "vehicle"))
        last = number == len(moments) - 1
        for track in reversed(swept):
            role = "tractor" if track is swept[0] else "trailer"
            lines.append(_closed(track.corners[row], role if last else "", role))
    when = ", ".join(f"{moment:g}" for moment in moments)
    title = f"{title}; at {when} s" if len(moments) > 1 else title
    inside = tuple(line for line in lines if _within(line, reach))
    return Panel(title, "station [m]", "offset [m]", inside)


def _lanes(route: Route, reach: tuple[float, float]) -> list[Line]:
    """Returns the boundaries of the lanes."""
    boundaries = sorted(route.lane_boundaries_at(0.5 * (reach[0] + reach[1])))
    outer = (boundaries[0], boundaries[-1])
    return [
        Line("", np.array(reach), np.full(2, offset), "edge" if offset in outer else "mark")
        for offset in boundaries
    ]


def _closed(corners: FloatArray, label: str, role: str) -> Line:
    ring = np.vstack([corners, corners[:1]])
    return Line(label, ring[:, 0], ring[:, 1], role)


def _within(line: Line, reach: tuple[float, float]) -> bool:
    return bool(line.x.max() >= reach[0] and line.x.min() <= reach[1])
