"""Drives towards targets with a silent planner, guarded by emergency braking or a careful driver.

The planner sees no vehicle: it keeps lane and speed. So nothing but the guard brakes.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from controllers.emergency_braking import EmergencyState
from controllers.emergency_braking.braking import EMERGENCY_DEMAND
from controllers.stack import Stack
from iits_mj.core.arrays import FloatArray
from iits_mj.core.messages import Decision, EgoState, Scene, Trajectory, VehicleCommand
from iits_mj.core.timing import TIMESTEP
from iits_mj.core.units import GRAVITY, KMH
from iits_mj.core.vehicles import VehicleFrame
from iits_mj.parameters import AnyTruck
from iits_mj.road import Route
from iits_mj.simulation import DriveConfig, DriveFrame, Observer, Simulation
from iits_mj.simulation.lock_step import Guard, LockStep
from iits_mj.simulation.parts import make_stack
from iits_mj.simulation.sensors import Perception, SensorSuite
from traffic_bridge import EventSim, TrafficConfig
from traffic_bridge.scenario.actions import SceneEvent

START = 300.0  # station of the steer axle at the start [m]
LANE = 1  # of three: targets have lanes on both sides
_LENGTH = 3_000.0
_WARNED = (EmergencyState.WARNING, EmergencyState.PARTIAL, EmergencyState.BRAKING)


class BlindStack:
    """A driving stack to which no vehicle is shown."""

    last_decision = Decision.KEEP

    def __init__(self, stack: Stack) -> None:
        self.stack = stack

    @property
    def lane_changes(self) -> int:
        """Of the stack."""
        return self.stack.lane_changes

    @property
    def refused(self) -> int:
        """Of the stack."""
        return self.stack.refused

    def reset(self) -> None:
        """Prepares for a new drive."""
        self.stack.reset()

    def plan(self, scene: Scene) -> Trajectory:
        """Returns the plan on an empty road."""
        return self.stack.plan(dataclasses.replace(scene, vehicles=VehicleFrame.empty()))

    def control(self, ego: EgoState) -> VehicleCommand:
        """Returns the command of that plan."""
        return self.stack.control(ego)

    def reference_speed(self, station: float) -> float:
        """Returns the stack's reference speed [m/s]."""
        return self.stack.reference_speed(station)


@dataclass(frozen=True, slots=True)
class CarefulDriver:
    """Numbers of the competent and careful driver of UN R157, annex 3 (performance model 1).

    Attributes:
      perception: time in which a risk is perceived [s]; delay: from there to the brakes [s].
      lateral: deviation from the lane's middle with which a cut-in is a risk [m].
      braking: deceleration of the vehicle ahead that is a risk [m/s2].
      time_to_collision: below which a cut-in, or a slower vehicle, is a risk [s].
      jerk: with which the braking builds up [m/s3]; deceleration: demanded in the end [m/s2].
    """

    perception: float = 0.4
    delay: float = 0.75
    lateral: float = 0.375
    braking: float = 5.0
    time_to_collision: float = 2.0
    jerk: float = 12.65
    deceleration: float = 0.774 * GRAVITY


class DriverModel:
    """Brakes as that driver does; the brakes are the truck's own, and the sight is perfect."""

    def __init__(self, driver: CarefulDriver | None = None) -> None:
        self.driver = driver or CarefulDriver()
        self.reset()

    def reset(self) -> None:
        """Prepares for a new drive."""
        self._scene: Scene | None = None
        self._risk_at = math.inf

    def observe(self, scene: Scene) -> None:
        """Notes the first risk."""
        self._scene = scene
        ego, driver = scene.ego, self.driver
        for other in scene.vehicles:
            aside = abs(other.offset - ego.offset)
            gap = other.station - 0.5 * other.length - ego.station - scene.footprint.front_overhang
            if gap < 0.0 or aside > 5.0:
                continue
            own_lane = aside < 0.5 * (other.width + scene.footprint.width)
            comes = abs(other.lateral_speed) > 0.1 and aside < _LANE_WIDTH - driver.lateral
            closing = ego.speed - other.speed
            near = closing > 0.0 and gap / closing < driver.time_to_collision
            brakes = own_lane and other.acceleration < -driver.braking
            if brakes or (near and (own_lane or comes)):
                self._risk_at = min(self._risk_at, scene.time)

    def demand(self, ego: EgoState, wanted: VehicleCommand) -> float:
        """Returns the demand: a ramp after perception and delay, to the end."""
        del wanted
        driver = self.driver
        since = ego.time - self._risk_at - driver.perception - driver.delay
        return -min(driver.jerk * since, driver.deceleration) if since > 0.0 else 0.0


_LANE_WIDTH = 4.0  # of `Route.straight`


@dataclass(frozen=True)
class Drive:
    """What a drive came to; histories every 20 ms, shape (n,).

    Attributes:
      time [s], speed [m/s], demand [m/s2]: of the truck and of its guard.
      states: stage of the emergency braking.
      ttc: time to collision with its target [s], inf without one.
      gap: least gap to a vehicle in the truck's way [m], every 100 ms; gap_time: its times [s].
      impact: relative speed at the contact [m/s], 0 without one.
      ended: reason of the end.
    """

    time: FloatArray
    speed: FloatArray
    demand: FloatArray
    states: tuple[EmergencyState, ...]
    ttc: FloatArray
    gap_time: FloatArray
    gap: FloatArray
    impact: float
    ended: str

    def first(self, *states: EmergencyState) -> float:
        """Time of the first of some stages [s]; nan without one."""
        found = [t for t, state in zip(self.time, self.states, strict=True) if state in states]
        return float(found[0]) if found else math.nan

    @property
    def braked_at(self) -> float:
        """Time at which the emergency braking phase begins: a demand of 4 m/s2 [s]."""
        strong = np.flatnonzero(self.demand <= -EMERGENCY_DEMAND)
        return float(self.time[strong[0]]) if strong.size else math.nan

    @property
    def warned_before(self) -> float:
        """Time from the first warning to the emergency braking phase [s]."""
        return self.braked_at - self.first(*_WARNED)

    @property
    def haptic_before(self) -> float:
        """Time from the partial braking, the haptic warning, to that phase [s]."""
        return self.braked_at - self.first(EmergencyState.PARTIAL, EmergencyState.BRAKING)

    def speed_at(self, time: float) -> float:
        """Speed at a time [m/s]."""
        return float(np.interp(time, self.time, self.speed))

    @property
    def reacted(self) -> bool:
        """Whether the emergency braking warned or braked."""
        return any(state in _WARNED for state in self.states)


class _Log(Observer):
    """Keeps a row for each command and each frame."""

    def __init__(self, simulation: Simulation) -> None:
        self._simulation = simulation
        self.rows: list[tuple[float, float, float, EmergencyState, float]] = []
        self.gaps: list[tuple[float, float]] = []
        self._stood = 0.0

    def commanded(self, ego: EgoState, wanted: VehicleCommand, obeyed: VehicleCommand) -> None:
        del wanted
        report = self._simulation.emergency
        state = EmergencyState.OFF if report is None else report.state
        ttc = math.inf if report is None else report.time_to_collision
        demand = obeyed.xbr_demand if report is None else report.demand
        self.rows.append((ego.time, ego.speed, demand, state, ttc))

    def observe(self, simulation: LockStep, frame: DriveFrame) -> None:
        self.gaps.append((frame.time, frame.gap_ahead))
        if frame.ego.speed < 0.05:
            simulation.stop("the truck stands")


@dataclass(frozen=True, kw_only=True)
class Setup:
    """A drive on a straight road of three lanes, in the middle one, or on another road.

    Attributes:
      speed: of the truck [m/s]; payload: [kg], None for the greatest.
      friction, grade: of the road.
      events: place and lead the targets.
      sensors: option of a drive; guard: "aeb", "driver" (the careful one) or "none".
      duration: at most [s]; seed: of the sensors.
      truck: see `DriveConfig`; timestep: of the physics [s].
      route: other road; station, lane: of the start on it [m].
      suite: other sensors than `sensors`.
    """

    speed: float
    events: Sequence[SceneEvent]
    payload: float | None = None
    friction: float = 0.8
    grade: float = 0.0
    sensors: str = "front"
    guard: str = "aeb"
    duration: float = 30.0
    seed: int = 0
    truck: AnyTruck | None = None
    timestep: float = TIMESTEP
    route: Route | None = None
    station: float = START
    lane: int = LANE
    suite: SensorSuite | None = None


def drive(setup: Setup) -> Drive:
    """Drives until the truck stands, touches a target or the time is over."""
    route = setup.route or Route.straight(
        length=_LENGTH, friction=setup.friction, grade=setup.grade, speed_limit=30.0
    )
    config = DriveConfig(
        truck=setup.truck,
        payload=setup.payload,
        traffic_mode="none",
        start_station=setup.station,
        start_lane=setup.lane,
        start_speed=setup.speed,
        speed=setup.speed,
        speed_planner="cruise",
        decision="keep",
        keep_right="off",
        duration=setup.duration,
        seed=setup.seed,
        sensors=setup.sensors if setup.guard == "aeb" else "perfect",
        aeb="on" if setup.guard == "aeb" else "off",
    )
    with Simulation(
        config,
        driver=lambda road, truck: BlindStack(make_stack(config, road, truck.parameters)),
        traffic=lambda road, footprint: EventSim(
            road, TrafficConfig(events=tuple(setup.events), footprint=footprint)
        ),
        route=route,
        visuals=False,
        timestep=setup.timestep,
    ) as simulation:
        if setup.suite is not None:
            simulation.perception = Perception(
                setup.suite, route, simulation.truck.footprint, setup.seed
            )
        if setup.guard == "driver":
            driver: Guard = DriverModel()
            simulation.guard = driver
            driver.observe(simulation.scene)
        log = _Log(simulation)
        ended = simulation.run([log]).ended
        impact = 0.0
        if simulation.contact is not None:
            when, name, _ = simulation.contact
            hit = simulation.vehicles.find(name)
            time, speed = (np.array([row[k] for row in log.rows]) for k in (0, 1))
            impact = float(np.interp(when, time, speed)) - (hit.speed if hit else 0.0)
    numbers = [np.array([row[k] for row in log.rows]) for k in (0, 1, 2, 4)]
    gap_time, gap = np.array(log.gaps).T
    return Drive(
        numbers[0],
        numbers[1],
        numbers[2],
        tuple(row[3] for row in log.rows),
        numbers[3],
        gap_time,
        gap,
        max(impact, 0.0),
        ended,
    )


def kmh(speed: float) -> float:
    """Returns a speed of [m/s] in km/h."""
    return speed / KMH
