"""The planner in situations: the paper's three of its lane-change figure, and what it has not.

The paper's: (a) no lane, (b) collision risk, (c) valid and safe. Ours: a lane that ends beside a
stream, a red light, a wall seen late, ordinary traffic, bends, and states drawn at random.
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
from iits_mj.core.results import Check, Line, Panel, Results
from iits_mj.parameters import TruckParameters
from iits_mj.road import RoadMap, Route
from iits_mj.road.measured import Lanes, measured_route
from iits_mj.validation.harness.config import ValidateConfig
from iits_mj.validation.planning.ideal_drive import IdealDrive, Vehicles, car, once
from iits_mj.validation.planning.ordinary_traffic import Ordinary, ordinary_drive
from iits_mj.validation.planning.planner_limits import random_breaches
from iits_mj.validation.planning.stops import run_red_light, wall_stop

# --- Situations seen from above: lanes, vehicles, and the truck with its trailer over time ---


def seen_from_above(
    title: str,
    drive: IdealDrive,
    moments: tuple[float, ...],
    plan: Trajectory,
    reach: tuple[float, float],
) -> Panel:
    """A drive on a straight road in road coordinates: x is the station, y the offset.

    Args:
      title: of the panel.
      drive: what was driven.
      moments: times at which the bodies are drawn [s].
      plan: whose path is drawn as a line.
      reach: stations shown [m].
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
        trailer, tractor = swept.trailer_corners[row], swept.tractor_corners[row]
        lines.append(_closed(trailer, "trailer" if last else "", "trailer"))
        lines.append(_closed(tractor, "tractor" if last else "", "tractor"))
    when = ", ".join(f"{moment:g}" for moment in moments)
    title = f"{title}; at {when} s" if len(moments) > 1 else title
    inside = tuple(line for line in lines if _within(line, reach))
    return Panel(title, "station [m]", "offset [m]", inside)


def _lanes(route: Route, reach: tuple[float, float]) -> list[Line]:
    """Boundaries of the lanes."""
    station = np.linspace(*reach, 2)
    middle = 0.5 * (reach[0] + reach[1])
    boundaries = sorted(route.lane_boundaries_at(middle))
    outer = (boundaries[0], boundaries[-1])
    return [
        Line("", station, np.full(2, offset), "edge" if offset in outer else "mark")
        for offset in boundaries
    ]


def _closed(corners: FloatArray, label: str, role: str) -> Line:
    ring = np.vstack([corners, corners[:1]])
    return Line(label, ring[:, 0], ring[:, 1], role)


def _within(line: Line, reach: tuple[float, float]) -> bool:
    return bool(line.x.max() >= reach[0] and line.x.min() <= reach[1])


# --- The planner in situations: the paper's three of its lane-change figure, and what it has not

SPEED = 16.67
_START = 500.0
_RADIUS, _RAMP_LANE = 100.0, 3.5


def run_situations(config: ValidateConfig) -> Results:
    """All situations; the quick form drives shorter, draws fewer states and has no wall laden."""
    highway = RoadMap.builtin().route()
    parts = [
        _three_situations(),
        _lane_end(highway, config.quick),
        _red_light(config.quick),
        run_red_light(config),
        _wall(config),
        _ordinary(config.quick),
        _ramp(),
        _random(highway, config.quick),
    ]
    results = Results("planning situations")
    for part in parts:
        results.checks += part.checks
        results.figures |= part.figures
        results.notes += part.notes
    return results


def _three_situations() -> Results:
    """The paper's Fig. lc."""
    route, results = Route.straight(length=3000.0), Results("situations")
    there = (_START - 40.0, _START + 140.0)

    invalid = IdealDrive(route, _START, 0, SPEED).run(2.0, decide=once(1.0, Decision.RIGHT))
    unsafe = IdealDrive(route, _START, 0, SPEED)
    unsafe.run(2.0, _beside(route), once(1.0, Decision.LEFT))
    safe = IdealDrive(route, _START, 0, SPEED)
    safe.run(12.0, _far(route), once(1.0, Decision.LEFT))
    begun = next(plan for plan in safe.plans if plan.mode is PlanMode.LANE_CHANGE)
    changing = sum(plan.mode is PlanMode.LANE_CHANGE for plan in safe.plans) * 0.1
    middle = float(route.lane_offset(1, _START))
    kept = max(
        abs(state.offset - drive.states[0].offset)
        for drive in (invalid, unsafe)
        for state in drive.states
    )
    results.checks += [
        Check("no lane: refused", float(invalid.planner.refused), "1", None, "== 1"),
        Check("collision risk: refused as unsafe", float(unsafe.planner.unsafe), "1", None, "== 1"),
        Check("refused changes: greatest offset from the lane's middle", kept, "m", 0.0, "<= 0.01"),
        Check("valid and safe: changed", float(safe.planner.lane_changes), "1", None, "== 1"),
        Check("valid and safe: duration laden", changing, "s", None, "4.5 .. 9"),
        Check(
            "valid and safe: offset from the target lane's middle at the end",
            abs(safe.ego.offset - middle),
            "m",
            0.0,
            "<= 0.05",
        ),
        Check("valid and safe: least gap", min(map(safe.gap, safe.scenes)), "m", None, ">= 10"),
    ]
    results.figures["lane change, seen from above"] = [
        seen_from_above("(a) no lane to the right", invalid, (1.0,), invalid.plans[10], there),
        seen_from_above("(b) collision risk: kept", unsafe, (1.0,), unsafe.plans[10], there),
        seen_from_above("(c) valid and safe", safe, (1.0, 4.0, 7.0), begun, there),
    ]
    results.notes.append(f"(a) {invalid.plans[10].reason}; (b) {unsafe.plans[10].reason}")
    return results


def _beside(route: Route) -> Vehicles:
    return lambda ego: (car(route, "car", _START - 8.0 + SPEED * ego.time, 1, SPEED),)


def _far(route: Route) -> Vehicles:
    return lambda ego: (
        car(route, "ahead", _START + 70.0 + SPEED * ego.time, 1, SPEED),
        car(route, "behind", _START - 60.0 + SPEED * ego.time, 1, SPEED),
    )


def _lane_end(route: Route, quick: bool) -> Results:
    """The highway's third lane ends; on the lane beside it drives a stream with one hole.

    The cars of the stream do not make room, so that what opens is what the truck has aimed for.
    """
    results, speed, begin = Results("lane end"), 14.0, 4050.0
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
    gap = min(drive.gap(scene) for scene in drive.scenes)
    results.checks += [
        Check("lane end: changed", float(drive.planner.lane_changes), "1", None, "== 1"),
        Check("lane end: slowest speed", slowest, "m/s", speed, ">= 7"),
        Check("lane end: least gap to cars that make no room", gap, "m", None, ">= 8"),
        Check("lane end: strongest braking", _braking(drive), "m/s2", None, "<= 2"),
    ]
    place = drive.states[begun].station
    results.figures["lane end, seen from above"] = [
        seen_from_above(
            "a lane that ends: the hole of the stream is taken",
            drive,
            (begun * 0.1, begun * 0.1 + 5.0),
            drive.plans[begun],
            (place - 60.0, place + 160.0),
        )
    ]
    results.notes.append(f"lane end: {drive.plans[max(begun - 1, 0)].reason}")
    return results


def _red_light(quick: bool) -> Results:
    """A light that is red for 26 s, seen from 180 m."""
    results, line, green = Results("red light"), 700.0, 26.0
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
    results.checks += [
        Check("red light: bumper before the line", left, "m", None, "0 .. 1"),
        Check("red light: strongest braking", _braking(drive), "m/s2", None, "<= 1.5"),
        Check("red light: 0.5 m/s after green", started, "s", None, "<= 3"),
    ]
    return results


def _wall(config: ValidateConfig) -> Results:
    """A wall 70 m before the bumper at 90 km/h, on the MuJoCo truck."""
    results, sight = Results("wall"), 70.0
    panel: list[Line] = []
    for payload in (36_000.0,) if config.quick else config.payloads():
        stop = wall_stop(25.0, sight, payload, 0.002)
        label = f"wall {sight:g} m ahead at 90 km/h, {payload / 1e3:g} t of load"
        results.checks.append(
            Check(f"{label}: room left", float(stop.record["left"][-1]), "m", None, ">= 0")
        )
        panel.append(
            Line(f"{payload / 1e3:g} t", stop.record["time"], stop.record["speed"], "simulation")
        )
    results.figures["emergency stop"] = [
        Panel("wall seen 70 m ahead", "time [s]", "speed [m/s]", tuple(panel))
    ]
    return results


def _ordinary(quick: bool) -> Results:
    """Traffic of the fast world: the last layer must not act, and gaps stay."""
    results = Results("ordinary traffic")
    cases = [(0.05, 0)] if quick else [(p, s) for p in (0.12, 0.05) for s in (0, 1)]
    drives: list[Ordinary] = [ordinary_drive(p, 8.0 if quick else 300.0, s) for p, s in cases]
    minutes = sum(drive.duration for drive in drives) / 60.0
    label = f"{minutes:g} min of traffic"
    changes, aborted = (sum(getattr(d, name) for d in drives) for name in ("changes", "aborted"))
    results.checks += [
        Check(
            f"{label}: emergency brakings",
            float(sum(drive.emergencies for drive in drives)),
            "1",
            None,
            "== 0",
        ),
        Check(f"{label}: lane changes", float(changes), "1"),
        Check(f"{label}: changes given up", float(aborted), "1"),
        Check(f"{label}: least gap", min(d.gap for d in drives), "m", None, ">= 2"),
        Check(
            f"{label}: strongest braking", max(d.braking for d in drives), "m/s2", None, "<= 2.8"
        ),
        Check("CPU time of a plan, median", 1e3 * drives[0].cost, "ms"),
    ]
    return results


def _ramp() -> Results:
    """A bend of 100 m in a lane of 3.5 m at walking pace: where tractor and trailer run."""
    results, parameters = Results("ramp"), TruckParameters.load()
    station = np.arange(0.0, 500.0, 5.0)
    curvature = np.interp(station, [150.0, 190.0, 310.0, 350.0], [0.0, 1.0, 1.0, 0.0]) / _RADIUS
    lanes = Lanes(1, _RAMP_LANE, 8.0)
    route = measured_route(station, np.zeros_like(station), curvature=curvature, lanes=lanes)
    preview = RoadPreview(route)
    laden = parameters.gross_mass(parameters.payload.mass_max)
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
            for s, (x, y) in zip(along, swept.trailer_axle, strict=True)
        ]
        at, offset = np.array(places).T
        beside = offset - lane.offset_at(at)
        room = 0.5 * (_RAMP_LANE - parameters.semitrailer.width) - np.abs(beside[at > 100.0])
        must = ">= 0.2" if shifted else ""
        label = f"R = {_RADIUS:g} m, lane of {_RAMP_LANE:g} m, {name}: trailer's room"
        results.checks.append(Check(label, float(room.min()), "m", None, must))
        role = "simulation" if shifted else "reference"
        lines.append(Line(f"trailer, steer axle {name}", at, beside, role))
        if shifted:
            lines.append(Line("steer axle", along, lane.driven_at(along) - lane.offset_at(along)))
    results.figures["trailer in a bend"] = [
        Panel("off-tracking, 100 m to the left", "station [m]", "from the middle [m]", tuple(lines))
    ]
    return results


def _random(highway: Route, quick: bool) -> Results:
    """Random states on both roads."""
    results = Results("random states")
    count = 30 if quick else 1500
    found = random_breaches([Route.straight(length=6000.0), highway], count)
    label = f"{found.trajectories} trajectories from {count} random states"
    results.checks += [
        Check(f"{label}: limits broken", float(len(found.found)), "1", None, "== 0"),
        Check(f"{label}: of them in a change", float(found.changes), "1"),
        Check(
            "of the lateral limit, greatest share in a change", found.lateral, "1", 1.0, "<= 1.01"
        ),
        Check("of the roll-over threshold, greatest share", found.total, "1", 1.0, "<= 0.45"),
        Check("step between successive plans across the road", found.jump, "m", 0.0, "<= 0.01"),
    ]
    results.notes += found.found[:3]
    return results


def _braking(drive: IdealDrive) -> float:
    """Strongest planned [m/s2]."""
    return -min(float(plan.acceleration[0]) for plan in drive.plans)
