"""Drives with a planner that sees no vehicle, guarded by emergency braking or a careful driver."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from controllers.emergency_braking import EmergencyState
from controllers.emergency_braking.braking import EMERGENCY_DEMAND
from controllers.planning.planner import Planner
from iits_mj.core.arrays import FloatArray
from iits_mj.core.assets import regulation_path
from iits_mj.core.messages import (
    Decision,
    EgoState,
    Scene,
    SpeedProfile,
    Trajectory,
    VehicleCommand,
)
from iits_mj.core.timing import TIMESTEP
from iits_mj.core.units import GRAVITY, KMH
from iits_mj.core.vehicles import VehicleFrame
from iits_mj.road import Route
from iits_mj.simulation import DriveConfig, DriveFrame, Observer, Simulation
from iits_mj.simulation.lock_step import LockStep
from iits_mj.simulation.sensors import Perception, Sensor
from traffic_bridge import EventSim, TrafficConfig, read_events
from traffic_bridge.signals.events import Event

LANE_WIDTH = 4.0  # of `Route.straight` [m]
WARNED = (EmergencyState.WARNING, EmergencyState.PARTIAL, EmergencyState.BRAKING)
# UN R157, annex 3, performance model 1: perception and delay [s], deviation of a vehicle that cuts
# in from its lane's middle [m], deceleration of one ahead [m/s2], time to collision [s] of a risk,
# and the build-up [m/s3] and the end [m/s2] of the braking.
PERCEPTION, DELAY, DEVIATION, RISKY_BRAKING, NEAR = 0.4, 0.75, 0.375, 5.0, 2.0
JERK, DECELERATION = 12.65, 0.774 * GRAVITY


class BlindPlanner(Planner):
    """The planner, to which no vehicle is shown: it keeps lane and speed."""

    def plan(
        self,
        scene: Scene,
        decision: Decision = Decision.KEEP,
        profile: SpeedProfile | None = None,
    ) -> Trajectory:
        """Returns the plan on an empty road."""
        empty = dataclasses.replace(scene, vehicles=VehicleFrame.empty())
        return super().plan(empty, decision, profile)


class CarefulDriver:
    """A guard that brakes as the driver of UN R157 with perfect sight and the truck's brakes.

    A vehicle ahead hides those before it until it leaves the middle of the lane by `DEVIATION`. A
    slower vehicle in the lane that becomes visible so is a risk.

    Args:
      near: time to collision of a risk [s].
      risky: deceleration of a vehicle ahead that is a risk, positive [m/s2].
      at_time: of a risk in any case [s].
    """

    def __init__(
        self, near: float = NEAR, risky: float = RISKY_BRAKING, at_time: float = math.inf
    ) -> None:
        self._near, self._risky, self._at_time = near, risky, at_time
        self.reset()

    def reset(self) -> None:
        """Prepares for a new drive."""
        self._risk_at = self._at_time
        self._hidden: set[str] = set()

    def observe(self, scene: Scene) -> None:
        """Notes the time of the first risk."""
        ego, half = scene.ego, 0.5 * scene.footprint.width
        before, self._hidden = self._hidden, set()
        in_view = True
        for other in sorted(scene.vehicles, key=lambda vehicle: vehicle.station):
            aside = abs(other.offset - ego.offset)
            gap = other.station - 0.5 * other.length - ego.station - scene.footprint.front_overhang
            if gap < 0.0 or aside > 5.0:
                continue
            if not in_view:
                self._hidden.add(other.id)
                continue
            own_lane = aside < 0.5 * other.width + half
            comes = abs(other.lateral_speed) > 0.1 and aside < LANE_WIDTH - DEVIATION
            near = 0.0 < gap < self._near * (ego.speed - other.speed)
            risk = near and (own_lane or comes)
            risk |= own_lane and other.acceleration < -self._risky
            risk |= own_lane and other.id in before and other.speed < ego.speed
            if risk:
                self._risk_at = min(self._risk_at, scene.time)
            in_view = aside > DEVIATION

    def demand(self, ego: EgoState, wanted: VehicleCommand) -> float:
        """Returns the demand [m/s2]: a ramp after perception and delay."""
        del wanted
        since = ego.time - self._risk_at - PERCEPTION - DELAY
        return -min(JERK * since, DECELERATION) if since > 0.0 else 0.0


@dataclass(frozen=True)
class Drive:
    """What a drive came to; histories every 20 ms, shape (n,).

    Attributes:
      time [s], station [m], speed [m/s], demand [m/s2]: of the truck and of its guard.
      ttc: time to collision with the target [s]; states: stages of the emergency braking.
      gap: least gap to a vehicle in the way [m]; ended: reason of the end.
      room: least distance of tractor and trailer from the edges of the first lane [m].
      impact: relative speed at the contact [m/s], 0 without one.
    """

    time: FloatArray
    station: FloatArray
    speed: FloatArray
    demand: FloatArray
    ttc: FloatArray
    states: tuple[EmergencyState, ...]
    gap: float
    room: float
    impact: float
    ended: str

    def first(self, *states: EmergencyState) -> float:
        """Time of the first of some stages [s]; nan without one."""
        found = (t for t, state in zip(self.time, self.states, strict=True) if state in states)
        return float(next(found, math.nan))

    @property
    def braked_at(self) -> float:
        """Time at which the emergency braking phase begins: a demand of 4 m/s2 [s]."""
        strong = np.flatnonzero(self.demand <= -EMERGENCY_DEMAND)
        return float(self.time[strong[0]]) if strong.size else math.nan

    @property
    def warned_before(self) -> float:
        """Time from the first warning to the emergency braking phase [s]."""
        return self.braked_at - self.first(*WARNED)

    @property
    def haptic_before(self) -> float:
        """Time from the partial braking, the haptic warning, to that phase [s]."""
        return self.braked_at - self.first(EmergencyState.PARTIAL, EmergencyState.BRAKING)

    @property
    def reacted(self) -> bool:
        """Whether the emergency braking warned or braked."""
        return any(state in WARNED for state in self.states)


class _Log(Observer):
    """Keeps a row for each command and a gap for each frame."""

    def __init__(self, simulation: Simulation) -> None:
        self._simulation = simulation
        self.rows: list[tuple[float, float, float, float, float]] = []
        self.states: list[EmergencyState] = []
        self.gap = self.room = math.inf

    def commanded(self, ego: EgoState, wanted: VehicleCommand, obeyed: VehicleCommand) -> None:
        del wanted
        report = self._simulation.emergency
        self.states.append(EmergencyState.OFF if report is None else report.state)
        demand = obeyed.xbr_demand if report is None else report.demand
        ttc = math.inf if report is None else report.time_to_collision
        self.rows.append((ego.time, ego.station, ego.speed, demand, ttc))

    def observe(self, simulation: LockStep, frame: DriveFrame) -> None:
        self.gap = min(self.gap, frame.gap_ahead)
        run, ego = self._simulation, frame.ego
        lane, station = run.config.start_lane, ego.station
        middle = float(run.route.lane_offset(lane, station))
        aside = max(abs(offset - middle) for offset in (ego.offset, ego.trailer_offset))
        half = 0.5 * float(run.route.lane_width(lane, station)) - aside
        self.room = min(self.room, half - 0.5 * frame.scene.footprint.width)
        if frame.ego.speed < 0.05:
            simulation.stop("the truck stands")


# On `straight`, in the middle one of three lanes: targets have lanes on both sides.
BASE = DriveConfig(
    traffic_mode="none",
    start_station=300.0,
    start_lane=1,
    speed_planner="cruise",
    decision="keep",
    keep_right="off",
    planner=BlindPlanner,
    sensors="front",
    aeb="on",
)


def at(config: DriveConfig, speed_kmh: float, duration: float = 20.0) -> DriveConfig:
    """Returns a drive at another speed and of another duration [s]."""
    speed = speed_kmh * KMH
    return dataclasses.replace(config, speed=speed, start_speed=speed, duration=duration)


def scenario(name: str, **values: float) -> tuple[Event, ...]:
    """Returns the events of `examples/regulations/NAME.toml` with values of its parameters."""
    given = {key: repr(float(value)) for key, value in values.items()}
    return read_events(regulation_path(f"{name}.toml"), given)


def straight(friction: float = 0.8, grade: float = 0.0, length: float = 3_000.0) -> Route:
    """Returns a straight road of three lanes, that of `examples/regulations/road.csv`."""
    return Route.straight(length=length, friction=friction, grade=grade, speed_limit=30.0)


def drive(
    config: DriveConfig,
    events: Sequence[Event] = (),
    route: Route | None = None,
    *,
    guard: CarefulDriver | None = None,
    sensors: Sequence[Sensor] = (),
    timestep: float = TIMESTEP,
) -> Drive:
    """Drives until the truck stands, touches a target or the time is over.

    Args:
      config: of the drive.
      events: place and lead the targets.
      route: default: `straight`.
      guard: in place of the emergency braking, with perfect sight.
      sensors: in place of those of `config`.
      timestep: of the physics [s].
    """
    if guard is not None:
        config = dataclasses.replace(config, aeb="off", sensors="perfect")
    with Simulation(
        config,
        traffic=lambda road, footprint: EventSim(
            road, TrafficConfig(events=tuple(events), footprint=footprint)
        ),
        route=route or straight(),
        visuals=False,
        timestep=timestep,
    ) as simulation:
        if sensors:
            size = simulation.truck.footprint
            simulation.perception = Perception(sensors, simulation.route, size, config.seed)
        if guard is not None:
            simulation.guard = guard
            guard.observe(simulation.scene)
        log = _Log(simulation)
        ended = simulation.run([log]).ended
        time, station, speed, demand, ttc = np.array(log.rows).T
        impact = 0.0 if simulation.impact is None else simulation.impact.speed
    return Drive(
        time, station, speed, demand, ttc, tuple(log.states), log.gap, log.room, impact, ended
    )
