"""Limits of the planner alone: plans from random states, and drives in ordinary traffic."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from controllers.decision.base import DecisionContext
from controllers.decision.fast_world.config import LANE_WIDTH, HighwayConfig, Obstacle
from controllers.decision.fast_world.traffic import HighwayTraffic
from controllers.decision.rules import Mobil
from controllers.planning.lane_change import lateral_limit
from controllers.planning.planner import Planner, PlannerConfig
from controllers.planning.rollover_limits import RollMargins
from controllers.planning.speed_plan import power_acceleration
from iits_mj.core.messages import (
    Decision,
    EgoState,
    PlanMode,
    Scene,
    SpeedProfile,
    TrackedVehicle,
    Trajectory,
)
from iits_mj.core.timing import CYCLE_PERIOD
from iits_mj.core.units import GRAVITY
from iits_mj.parameters import TruckParameters
from iits_mj.road import Route
from iits_mj.validation.planning.ideal_drive import IdealDrive, car

# Share by which a breach exceeds the limit.
_SLACK = 0.01
_CYCLES = 4


@dataclass
class Breaches:
    """Checked trajectories and their breaches of limits.

    Attributes:
      trajectories: their number; changes: number in a lane change.
      found: description of every breach.
      lateral: greatest lateral acceleration of the path in a change over its limit.
      total: greatest lateral acceleration, road included, over the roll-over threshold.
      jump: greatest step of the offset from one plan to the next at the same time [m].
    """

    trajectories: int = 0
    changes: int = 0
    found: list[str] = field(default_factory=list)
    lateral: float = 0.0
    total: float = 0.0
    jump: float = 0.0


def random_breaches(routes: list[Route], count: int, seed: int = 0) -> Breaches:
    """Plans from random states and counts the trajectories that break a limit.

    Speed, place in the lane, load, traffic, decision and speed profile are random. Each state is
    planned four times; the truck follows its plans. The routes are used in turn.
    """
    generator, result = np.random.default_rng(seed), Breaches()
    margins = RollMargins(TruckParameters.load(), 1.0 / PlannerConfig().change.duration_min)
    drives = [IdealDrive(route, 1000.0, 0, 15.0) for route in routes]
    for i in range(count):
        drive = drives[i % len(drives)]
        drive.planner.reset()
        _one(drive, generator, margins, result)
    return result


def _one(
    drive: IdealDrive, generator: np.random.Generator, margins: RollMargins, result: Breaches
) -> None:
    route, planner = drive.route, drive.planner
    station = float(generator.uniform(200.0, route.length - 1500.0))
    lane = int(generator.integers(0, 2))
    speed = float(generator.uniform(0.0, 25.0))
    ego = EgoState(
        station=station,
        offset=float(route.lane_offset(lane, station)) + float(generator.uniform(-0.7, 0.7)),
        speed=speed,
        mass=float(generator.uniform(19e3, 55e3)),
    )
    around = tuple(
        car(
            route,
            f"v{k}",
            station + float(generator.uniform(-120.0, 200.0)),
            int(generator.integers(0, route.lane_count(station))),
            float(generator.uniform(0.0, 25.0)),
        )
        for k in range(int(generator.integers(0, 6)))
    )
    profile = None
    if generator.random() < 0.5:
        places = np.array([station, station + 200.0, station + 800.0])
        profile = SpeedProfile(places, generator.uniform(10.0, 25.0, 3))
    decision = Decision(int(generator.integers(-1, 2)))
    last: Trajectory | None = None
    for cycle in range(_CYCLES):
        scene = Scene(ego.time, ego, around)
        plan = planner.plan(scene, decision if cycle == 0 else Decision.KEEP, profile)
        _judge(planner, scene, plan, last, margins, result)
        last, step = plan, 5
        ego = EgoState(
            time=float(plan.time[step]),
            station=float(plan.station[step]),
            offset=float(plan.offset[step]),
            speed=float(plan.speed[step]),
            mass=ego.mass,
        )


def _judge(
    planner: Planner,
    scene: Scene,
    plan: Trajectory,
    last: Trajectory | None,
    margins: RollMargins,
    result: Breaches,
) -> None:
    """Adds the breaches of one trajectory."""
    config, ego = planner.config, scene.ego
    result.trajectories += 1
    where = f"{ego.speed:.1f} m/s at {ego.station:.0f} m, {ego.mass:.0f} kg, {plan.mode.value}"

    def require(holds: bool, what: str) -> None:
        if not holds:
            result.found.append(f"{what}: {where}")

    arrays = (plan.station, plan.offset, plan.x, plan.y, plan.z, plan.yaw, plan.curvature)
    speeds = (plan.speed, plan.acceleration)
    require(all(np.isfinite(array).all() for array in (*arrays, *speeds)), "not finite")
    require(bool((np.diff(plan.time) > 0.0).all()), "time does not rise")
    require(bool((np.diff(plan.station) >= 0.0).all() and (plan.speed >= 0.0).all()), "backwards")
    _judge_along(planner, ego, plan, last, require)
    preview = planner.preview
    right, left = planner.route.surface_edges(plan.station)
    half = 0.5 * scene.footprint.width
    inside = (plan.offset - half > right - 0.01) & (plan.offset + half < left + 0.01)
    require(bool(inside.all()), "off the road")
    if last is not None:
        planned = float(np.interp(scene.time, last.time, last.offset))
        result.jump = max(result.jump, abs(float(plan.offset[0]) - planned))
        require(abs(float(plan.offset[0]) - planned) < 0.02, "jump across the road")
    margin, quintic = margins.at(ego.mass), planner.maneuver.residual
    if quintic is None:
        return
    own = np.abs(quintic.evaluate(plan.station)[2]) * plan.speed**2
    felt = np.abs(
        np.interp(plan.station, preview.station, preview.curvature) * plan.speed**2
        + GRAVITY * np.tan(np.interp(plan.station, preview.station, preview.superelevation))
    )
    amplified = margin.amplified(float(plan.speed.max()))
    result.total = max(result.total, float((own * amplified + felt).max()) / margin.threshold)
    if plan.mode is PlanMode.LANE_CHANGE:
        result.changes += 1
        allowed = lateral_limit(margin, float(plan.speed.max()), 0.0, config.change)
        result.lateral = max(result.lateral, float(own.max()) / allowed)
        require(bool(own.max() <= allowed * (1.0 + _SLACK)), "lateral acceleration")
        jerk = np.abs(quintic.evaluate(plan.station)[3]) * plan.speed**3
        require(bool(jerk.max() <= config.change.jerk * (1.0 + _SLACK)), "lateral jerk")
        total = config.change.total_share * (1.0 + _SLACK)
        require(bool((own * amplified + felt).max() <= total * margin.threshold), "roll-over share")


def _judge_along(
    planner: Planner,
    ego: EgoState,
    plan: Trajectory,
    last: Trajectory | None,
    require: Callable[[bool, str], None],
) -> None:
    """Checks limits along the road: deceleration, acceleration, power, jerk, continuity."""
    speed, a = planner.config.speed, plan.acceleration
    emergency = plan.mode is PlanMode.EMERGENCY
    least = speed.emergency_deceleration if emergency else speed.following.deceleration_max
    require(bool(a.min() >= -least - 1e-9), "deceleration")
    require(bool(a.max() <= speed.following.acceleration_max + 1e-9), "acceleration")
    grade = float(np.interp(plan.station[0], planner.preview.station, planner.preview.grade))
    left = [power_acceleration(float(v), ego.mass, grade, speed) for v in plan.speed]
    # Under the jerk limit a drive force above the present limit fades instead of ending.
    fades = a[:-1] - speed.following.jerk_max * planner.config.step - 1e-9
    powered = (a[1:] <= np.array(left[1:]) + 1e-9) | (a[1:] <= fades + 2e-9)
    require(bool(powered.all()), "power")
    if not emergency:
        down = -speed.following.jerk_max * planner.config.step - 1e-9
        require(bool((np.diff(a) >= down)[plan.speed[1:] > 0.0].all()), "jerk")
    if last is not None:
        planned = float(np.interp(ego.time, last.time, last.speed))
        require(abs(float(plan.speed[0]) - planned) < 1e-6, "jump of the speed")


@dataclass(frozen=True)
class OrdinaryDrive:
    """Figures of a drive in ordinary traffic.

    Attributes:
      duration: [s]; emergencies: emergency brakings; changes: completed; aborted: changes.
      gap: least bumper gap to a vehicle in line with the truck [m].
      braking: strongest planned [m/s2]; cost: CPU time of a plan, median [s].
    """

    duration: float
    emergencies: int
    changes: int
    aborted: int
    gap: float
    braking: float
    cost: float


def ordinary_drive(probability: float, duration: float, seed: int = 0) -> OrdinaryDrive:
    """Drives in traffic at 12.5 m/s that fills both lanes.

    The vehicles follow by IDM and change lanes by MOBIL, also just in front of the truck. The truck
    follows its plans exactly and asks the MOBIL decision maker once a second.

    Args:
      probability: of a vehicle per second and lane; 0.05 in the paper's densest traffic.
      duration: [s].
      seed: of the traffic.
    """
    route = Route.straight(length=30_000.0, lanes=2, lane_width=LANE_WIDTH)
    config = HighwayConfig(probability, traffic_speed=12.5, timestep=CYCLE_PERIOD)
    traffic = HighwayTraffic.of(config, np.random.default_rng(seed))
    drive = IdealDrive(route, 400.0, 0, 12.5)
    traffic.fill(_obstacles(drive.ego, route)[0])
    right = float(route.lane_offset(0, 0.0))
    # MOBIL uses the scene, not the network's observation.
    maker, unseen = Mobil(), np.zeros(216, dtype=np.float32)

    def vehicles(ego: EgoState) -> tuple[TrackedVehicle, ...]:
        traffic.step(_obstacles(ego, route))
        return tuple(dataclasses.replace(v, offset=v.offset + right) for v in traffic.tracked())

    def decide(scene: Scene) -> Decision:
        if round(scene.time / CYCLE_PERIOD) % 10 or drive.planner.changing:
            return Decision.KEEP
        lane = drive.planner.lane(scene)
        reference = drive.planner.config.speed.cruise_speed
        return maker.decide(DecisionContext(scene, route, lane, (0, 1), reference, unseen))

    drive.run(duration, vehicles, decide)
    return OrdinaryDrive(
        duration=duration,
        emergencies=drive.planner.emergencies,
        changes=drive.planner.lane_changes,
        aborted=drive.planner.aborted,
        gap=drive.least_gap(),
        braking=drive.strongest_braking(),
        cost=float(np.median(drive.cost)),
    )


def _obstacles(ego: EgoState, route: Route) -> list[Obstacle]:
    """Returns the truck as an obstacle in every lane that its body touches."""
    return [
        Obstacle(ego.station + 1.4, 16.5, ego.speed, lane)
        for lane in range(2)
        if abs(ego.offset - float(route.lane_offset(lane, ego.station))) < 0.5 * LANE_WIDTH + 0.9
    ]
