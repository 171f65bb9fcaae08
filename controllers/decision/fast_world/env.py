"""Trips of the truck through the fast world, with the truck as a point mass on the grade."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, cast

import numpy as np

from controllers.decision.base import DecisionContext, Observation
from controllers.decision.fast_world.config import (
    LANE_WIDTH,
    LANES,
    HighwayConfig,
    HighwayRoad,
    Obstacle,
)
from controllers.decision.fast_world.traffic import HighwayTraffic, blended
from controllers.decision.observation import ObservationHistory, observe_frame
from controllers.decision.rules import HARDEST_BRAKING
from controllers.decision.trip import TripConfig, TripLog, TripStep, TripSummary
from controllers.planning.config import FollowingConfig, LaneChangeConfig, SafetyConfig
from controllers.planning.following import follow_acceleration
from controllers.planning.safety import front_gap_needed, rear_gap_needed
from iits_mj.core.errors import InputError
from iits_mj.core.messages import Decision, EgoState, Scene
from iits_mj.core.units import GRAVITY
from iits_mj.parameters import AnyTruck, TruckParameters
from iits_mj.parameters.mass_state import rolling_resistance

if TYPE_CHECKING:
    from iits_mj.road import Route

# Share of a change during which the truck also occupies the lane that it leaves.
_LEAVES = 0.7
# Shortest and longest change, whole seconds; the full chain takes 6 to 9 s, depending on speed,
# load and road.
_CHANGE_DURATION = (6, 9)
_FOLLOWING, _SAFETY = FollowingConfig(), SafetyConfig()


class HighwayTruck:
    """Longitudinal motion of the laden truck; `front` is the front bumper's station [m].

    It follows its leader as the planner does (`controllers.planning.following`), within the
    engine's power after driveline, rolling resistance, air drag and grade. No gears, no brake lag.
    """

    def __init__(self, parameters: TruckParameters, payload: float | None) -> None:
        engine, gearbox, air = parameters.engine, parameters.gearbox, parameters.aerodynamics
        self.mass = parameters.gross_mass(payload)
        efficiency = gearbox.efficiency * gearbox.driveline_efficiency
        self._power = float((engine.full_load_speed * engine.full_load_torque).max()) * efficiency
        self._drag = 0.5 * air.density * air.mean_drag_area()
        self._rolling = rolling_resistance(parameters, parameters.check_payload(payload))
        self.front = 0.0
        self.speed = 0.0
        self.acceleration = 0.0

    def power_limit(self, grade: float) -> float:
        """Returns the greatest acceleration [m/s2] at full power on a grade."""
        slope = GRAVITY * (math.sin(math.atan(grade)) + self._rolling)
        drive = self._power / max(self.speed, 4.0)
        return (drive - self._drag * self.speed**2) / self.mass - slope

    def step(
        self, dt: float, reference: float, leaders: list[tuple[float, float, float]], grade: float
    ) -> None:
        """Advances by dt [s]; leaders are (gap [m], speed [m/s], acceleration [m/s2])."""
        wanted = self.power_limit(grade)
        for leader in ((math.inf, 0.0, 0.0), *leaders):
            wanted = min(wanted, follow_acceleration(self.speed, reference, *leader, _FOLLOWING))
        wanted = max(wanted, -HARDEST_BRAKING)
        speed = max(0.0, self.speed + wanted * dt)
        self.front += 0.5 * (self.speed + speed) * dt
        self.acceleration = (speed - self.speed) / dt
        self.speed = speed


class HighwayEnv:
    """The fast world as a `World`. All randomness comes from the generator given to `reset`.

    Args:
      grade_max: greatest grade of the hills; 0 for a flat road.
    """

    def __init__(self, grade_max: float = 0.045) -> None:
        self._grade_max = grade_max
        self._load(None)
        self._history = ObservationHistory()
        self.summary = TripSummary()
        self._ready = False

    def reset(self, generator: np.random.Generator, trip: TripConfig | None = None) -> Observation:
        """Starts a trip at the traffic's speed in the right lane; returns the observation."""
        trip = trip or TripConfig()
        if trip.truck is not self._truck:
            self._load(trip.truck)
        self.log = TripLog(trip)
        self.summary = self.log.summary
        self._end = trip.start_station + trip.length
        self.road = HighwayRoad(generator, self._end, self._grade_max)
        self.truck = HighwayTruck(self._parameters, trip.payload)
        self.truck.front = trip.start_station + self._footprint.front_overhang
        self.truck.speed = min(trip.traffic_speed, trip.reference_speed)
        self.lane, self._source = 0, 0
        self._change_left, self._change_lasts = 0.0, 1.0
        self._changed_at = -math.inf
        self._random = generator
        self.time = 0.0
        config = HighwayConfig(trip.spawn_probability, trip.traffic_speed, trip.keeps_right)
        self.traffic = HighwayTraffic(config, generator)
        self.traffic.fill(self._obstacles()[0])
        self._history.reset()
        self._ready = True
        self._observe()
        return self._history.observation()

    def _load(self, truck: AnyTruck | None) -> None:
        self._truck = truck
        self._parameters = TruckParameters.load(truck)
        self._footprint = self._parameters.footprint

    def close(self) -> None:
        """Does nothing."""

    def context(self) -> DecisionContext:
        """Returns the context of a decision now."""
        return DecisionContext(
            scene=self._scene,
            route=cast("Route", self.road),
            lane=self.lane,
            lanes=tuple(range(LANES)),
            reference_speed=self.log.trip.reference_speed,
            observation=self._history.observation(),
        )

    def safe(self, target: int) -> bool:
        """Returns whether the gaps in a lane are at least the planner's safety gaps."""
        truck, traffic = self.truck, self.traffic
        rear = truck.front - self._footprint.length
        lead, follow = traffic.neighbors(truck.front, target)
        if lead >= 0:
            gap = float(traffic.front[lead] - traffic.length[lead]) - truck.front
            if gap < front_gap_needed(truck.speed, float(traffic.speed[lead]), _SAFETY):
                return False
        if follow < 0:
            return True
        gap = rear - float(traffic.front[follow])
        return gap >= rear_gap_needed(truck.speed, float(traffic.speed[follow]), _SAFETY)

    def step(self, decision: Decision) -> TripStep:
        """Carries out a decision, or refuses it, until the next one is due.

        Raises:
          InputError: `reset` was not called.
        """
        if not self._ready:
            raise InputError("the trip has not begun: call reset(generator) first")
        target = self.lane - int(decision)  # LEFT is -1, lanes count from the right
        rested = self.time - self._changed_at >= LaneChangeConfig.pause - 1e-6
        changes = decision is not Decision.KEEP
        possible = 0 <= target < LANES and rested
        dangerous = changes and possible and not self.safe(target)
        refused = changes and (dangerous or not possible)
        seconds = 1.0
        if changes and not refused:
            self._source, self.lane = self.lane, target
            seconds = float(self._random.integers(*_CHANGE_DURATION, endpoint=True))
            self._change_left = self._change_lasts = seconds
        log, collided = self.log, False
        log.begin()
        while log.elapsed < seconds - 1e-9 and not collided and not self._over():
            collided = self._second()
            log.charge_speed(self.truck.speed, 1.0)
        if self._source != self.lane:
            self._source, self._changed_at = self.lane, self.time
        self._change_left = 0.0
        over = self._over()
        self._ready = not (collided or over)
        return log.end(
            decision,
            self._history.observation(),
            changes=int(changes and not refused),
            refused=int(refused),
            dangerous=int(dangerous),
            collision_at=max(log.elapsed - 1.0, 0.0) if collided else None,
            over=over,
        )

    def _over(self) -> bool:
        station = self.truck.front - self._footprint.front_overhang
        return station >= self._end or self.time >= self.log.trip.duration

    def _second(self) -> bool:
        """Advances one second and observes; returns whether there was a collision."""
        dt = self.traffic.config.timestep
        reference = self.log.trip.reference_speed
        collided = False
        for _ in range(round(1.0 / dt)):
            obstacles = self._obstacles()
            leaders = [self._leader(o.lane) for o in obstacles]
            station = self.truck.front - self._footprint.front_overhang
            self.truck.step(dt, reference, leaders, self.road.smoothed_grade(station))
            self.traffic.step(self._obstacles())
            self.time += dt
            self._change_left = max(0.0, self._change_left - dt)
            self.log.drive(self.truck.speed, dt)
            self.summary.distance += self.truck.speed * dt
            collided = collided or self._collided()
        self._observe()
        return collided

    def _phase(self) -> float:
        """Returns the progress of the change, 0 to 1."""
        if self._source == self.lane:
            return 1.0
        return 1.0 - self._change_left / self._change_lasts

    def _obstacles(self) -> list[Obstacle]:
        """Returns the truck in its own lane, and for 70 % of a change in the one that it leaves."""
        truck, length = self.truck, self._footprint.length
        lanes = [self.lane]
        if self._source != self.lane and self._phase() < _LEAVES:
            lanes.append(self._source)
        return [Obstacle(truck.front, length, truck.speed, lane) for lane in lanes]

    def _leader(self, lane: int) -> tuple[float, float, float]:
        lead, _ = self.traffic.neighbors(self.truck.front, lane)
        if lead < 0:
            return math.inf, 0.0, 0.0
        traffic = self.traffic
        gap = float(traffic.front[lead] - traffic.length[lead]) - self.truck.front
        if lane == self.lane and self.truck.speed > 1.0 and gap >= 0.0:
            time_gap = gap / self.truck.speed
            self.summary.time_gap_min = min(self.summary.time_gap_min, time_gap)
        return gap, float(traffic.speed[lead]), float(traffic.acceleration[lead])

    def _collided(self) -> bool:
        traffic, front = self.traffic, self.truck.front
        rear = front - self._footprint.length
        overlaps = (traffic.front > rear) & (traffic.front - traffic.length < front)
        if not overlaps.any():
            return False
        return bool(np.isin(traffic.lane[overlaps], [o.lane for o in self._obstacles()]).any())

    def _observe(self) -> None:
        """Makes the scene and adds its frame to the history."""
        step = (self.lane - self._source) * LANE_WIDTH
        blend, rate = blended(self._phase(), self._change_lasts)
        offset = self._source * LANE_WIDTH + step * blend
        station = self.truck.front - self._footprint.front_overhang
        ego = EgoState(
            time=self.time,
            x=station,
            y=offset,
            speed=self.truck.speed,
            lateral_speed=step * rate,
            acceleration=self.truck.acceleration,
            mass=self.truck.mass,
            station=station,
            offset=offset,
            trailer_offset=offset,
        )
        self._scene = Scene(self.time, ego, self.traffic.tracked(self.truck.front), self._footprint)
        route = cast("Route", self.road)
        self._history.add(
            self.time, observe_frame(self._scene, route, self.log.trip.reference_speed)
        )
