"""Trips of the truck through the fast world."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
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
from controllers.decision.fast_world.traffic import HighwayTraffic
from controllers.decision.observation import ObservationHistory, observe_frame
from controllers.decision.trip import (
    RewardTerms,
    TripConfig,
    TripStep,
    TripSummary,
    decision_charge,
    speed_charge,
)
from controllers.planning.following import FollowingConfig, follow_acceleration
from controllers.planning.lane_change import LaneChangeConfig
from controllers.planning.safety import SafetyConfig, front_gap_needed, rear_gap_needed
from iits_mj.core.errors import InputError
from iits_mj.core.messages import Decision, EgoFootprint, EgoState, Scene
from iits_mj.core.units import GRAVITY
from iits_mj.parameters import TruckParameters

# --- The truck of the fast world: a point mass on the grade with the engine's full-load power ---


class HighwayTruck:
    """Longitudinal motion of the laden truck; `front` is the front bumper's station [m].

    It follows as the planner does (`controllers.planning.following`). The engine's power through
    the driveline, rolling resistance, air drag and the grade bound it. No gears, no brake lag.
    """

    def __init__(
        self,
        parameters: TruckParameters,
        payload: float,
        following: FollowingConfig | None = None,
    ) -> None:
        engine, gearbox, air = parameters.engine, parameters.gearbox, parameters.aerodynamics
        self.mass = parameters.gross_mass(payload)
        self.following = following or FollowingConfig()
        efficiency = gearbox.efficiency * gearbox.driveline_efficiency
        self._power = float((engine.full_load_speed * engine.full_load_torque).max()) * efficiency
        self._drag = 0.5 * air.density * air.drag_area
        self._rolling = parameters.tire_common.rolling_resistance
        self.front = 0.0
        self.speed = 0.0
        self.acceleration = 0.0

    def power_limit(self, grade: float) -> float:
        """Greatest acceleration [m/s2] at full power on a grade."""
        slope = GRAVITY * (math.sin(math.atan(grade)) + self._rolling)
        drive = self._power / max(self.speed, 4.0)
        return (drive - self._drag * self.speed**2) / self.mass - slope

    def step(
        self,
        dt: float,
        reference: float,
        leaders: list[tuple[float, float, float]],
        grade: float,
    ) -> None:
        """Advances by dt [s]; leaders are (gap [m], speed [m/s], acceleration [m/s2])."""
        config = self.following
        wanted = follow_acceleration(self.speed, reference, math.inf, 0.0, 0.0, config)
        for gap, speed, acceleration in leaders:
            wanted = min(
                wanted,
                follow_acceleration(self.speed, reference, gap, speed, acceleration, config),
            )
        wanted = min(wanted, self.power_limit(grade))
        # A full service brake application of a laden truck; the last layer of the planner.
        wanted = max(wanted, -6.0)
        speed = max(0.0, self.speed + wanted * dt)
        self.front += 0.5 * (self.speed + speed) * dt
        self.acceleration = (speed - self.speed) / dt
        self.speed = speed


# --- Trips of the truck through the fast world ---

if TYPE_CHECKING:
    from iits_mj.road import Route


@dataclass(frozen=True)
class HighwaySettings:
    """What of the fast world is the same in every trip.

    Attributes:
      traffic: how the others drive; a trip gives its density and speed.
      change_duration: shortest and longest lane change of the truck, whole seconds; the full chain
        takes 6 to 9 s by speed, load and road.
      pause: between two changes [s].
      grade_max: greatest grade of the hills; 0 for a flat road.
      safety: gaps without which a change is refused.
    """

    traffic: HighwayConfig = field(default_factory=HighwayConfig)
    change_duration: tuple[int, int] = (6, 9)
    pause: float = LaneChangeConfig.pause
    grade_max: float = 0.045
    safety: SafetyConfig = field(default_factory=SafetyConfig)


class HighwayEnv:
    """The fast world with the truck in it. Everything random comes from `reset`'s generator."""

    def __init__(
        self, settings: HighwaySettings | None = None, parameters: TruckParameters | None = None
    ) -> None:
        self.settings = settings or HighwaySettings()
        self._parameters = parameters or TruckParameters.load()
        self._footprint = EgoFootprint()
        self._history = ObservationHistory()
        self.summary = TripSummary()
        self._ready = False

    def reset(self, generator: np.random.Generator, trip: TripConfig | None = None) -> Observation:
        """Starts a trip at the traffic's speed in the right lane; returns the observation."""
        self.config = trip = trip or TripConfig()
        settings = self.settings
        self._end = trip.start_station + trip.length
        self.road = HighwayRoad(generator, self._end, settings.grade_max)
        self.truck = HighwayTruck(self._parameters, trip.payload)
        self.truck.front = trip.start_station + self._footprint.front_overhang
        self.truck.speed = min(trip.traffic_speed, trip.reference_speed)
        self.lane, self._source = 0, 0
        self._change_left, self._change_lasts = 0.0, 1.0
        self._changed_at = -math.inf
        self._random = generator
        self.time = 0.0
        traffic = replace(
            settings.traffic,
            spawn_probability=trip.spawn_probability,
            traffic_speed=trip.traffic_speed,
            keeps_right=trip.keeps_right,
        )
        self.traffic = HighwayTraffic(traffic, generator)
        self.traffic.fill(self._obstacles()[0])
        self.summary = TripSummary()
        self._history.reset()
        self._ready = True
        self._observe()
        return self._history.observation()

    def close(self) -> None:
        """Holds nothing."""

    def context(self) -> DecisionContext:
        """What a decision maker is given now."""
        return DecisionContext(
            scene=self._scene,
            route=cast("Route", self.road),
            lane=self.lane,
            lanes=tuple(range(LANES)),
            reference_speed=self.config.reference_speed,
            observation=self._history.observation(),
        )

    def safe(self, target: int) -> bool:
        """True when the lane has the room that the planner asks for at both ends."""
        truck, safety, traffic = self.truck, self.settings.safety, self.traffic
        rear = truck.front - self._footprint.length
        lead, follow = traffic.neighbors(truck.front, target)
        if lead >= 0:
            gap = float(traffic.front[lead] - traffic.length[lead]) - truck.front
            if gap < front_gap_needed(truck.speed, float(traffic.speed[lead]), safety):
                return False
        if follow < 0:
            return True
        gap = rear - float(traffic.front[follow])
        return gap >= rear_gap_needed(truck.speed, float(traffic.speed[follow]), safety)

    def step(self, decision: Decision) -> TripStep:
        """Carries out a decision, or refuses it, until the next decision is due.

        Raises:
          InputError: `reset` was not called.
        """
        if not self._ready:
            raise InputError("the trip has not begun: call reset(generator) first")
        changes = decision is not Decision.KEEP
        target = self.lane - int(decision)  # LEFT is -1, lanes count from the right
        rested = self.time - self._changed_at >= self.settings.pause - 1e-6
        possible = 0 <= target < LANES and rested
        dangerous = changes and possible and not self.safe(target)
        reward = decision_charge(changes, dangerous, self.config.reward)
        seconds = 1.0
        self.summary.decisions += 1
        if changes and (dangerous or not possible):
            self.summary.refused += 1
            self.summary.dangerous += int(dangerous)
        elif changes:
            self.summary.changes += 1
            self._source, self.lane = self.lane, target
            shortest, longest = self.settings.change_duration
            seconds = float(self._random.integers(shortest, longest, endpoint=True))
            self._change_left = self._change_lasts = seconds
        terminated = False
        elapsed = 0.0
        while elapsed < seconds - 1e-9 and not terminated and not self._over():
            terminated = self._second()
            charge = speed_charge(
                self.truck.speed, self.config.reference_speed, elapsed, self.config.reward
            )
            reward += RewardTerms(speed=charge)
            elapsed += 1.0
        if terminated:
            factor = self.config.reward.discount ** max(elapsed - 1.0, 0.0)
            reward += RewardTerms(collision=-self.config.reward.collision * factor)
        if self._source != self.lane:
            self._source, self._changed_at = self.lane, self.time
        self._change_left = 0.0
        self.summary.reward += reward
        over = self._over()
        self._ready = not (terminated or over)
        observation = self._history.observation()
        return TripStep(observation, reward, elapsed, terminated, over and not terminated)

    def _over(self) -> bool:
        station = self.truck.front - self._footprint.front_overhang
        return station >= self._end or self.time >= self.config.duration

    def _second(self) -> bool:
        """Advances one second and observes; True after a collision."""
        dt = self.settings.traffic.timestep
        reference = self.config.reference_speed
        collided = False
        for _ in range(round(1.0 / dt)):
            obstacles = self._obstacles()
            leaders = [self._leader(o.lane) for o in obstacles]
            station = self.truck.front - self._footprint.front_overhang
            self.truck.step(dt, reference, leaders, self.road.smoothed_grade(station))
            self.traffic.step(self._obstacles())
            self.time += dt
            self._change_left = max(0.0, self._change_left - dt)
            self.summary.time += dt
            self.summary.distance += self.truck.speed * dt
            self.summary.loss_integral += (reference - self.truck.speed) / reference * dt
            collided = collided or self._collided()
        self.summary.collisions += int(collided)
        self._observe()
        return collided

    def _phase(self) -> float:
        """Progress of the change, 0 to 1."""
        if self._source == self.lane:
            return 1.0
        return 1.0 - self._change_left / self._change_lasts

    def _obstacles(self) -> list[Obstacle]:
        """The lanes the truck's body is in: its own, and the one it leaves for 70 % of a change."""
        truck, length = self.truck, self._footprint.length
        lanes = [self.lane]
        if self._source != self.lane and self._phase() < 0.7:
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
        phase = self._phase()
        blend = phase**3 * (10.0 - 15.0 * phase + 6.0 * phase**2)
        step = (self.lane - self._source) * LANE_WIDTH
        offset = self._source * LANE_WIDTH + step * blend
        rate = 30.0 * phase**2 * (1.0 - phase) ** 2 / self._change_lasts
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
        self._history.add(self.time, observe_frame(self._scene, route, self.config.reference_speed))
