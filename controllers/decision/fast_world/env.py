"""Trips of the truck through one fast world, as the `World` of the decision task."""

from __future__ import annotations

import math
from typing import Any, cast

import numpy as np

from controllers.decision.base import DecisionContext, Observation, speed_max_of
from controllers.decision.fast_world.config import HighwayRoad
from controllers.decision.fast_world.traffic import HighwayTraffic
from controllers.decision.fast_world.worlds import FastWorlds
from controllers.decision.rules import compiled
from controllers.decision.trip import RewardTerms, TripConfig, TripStep, TripSummary
from controllers.planning.config import FollowingConfig
from controllers.planning.keep_right import stays_free
from controllers.protocols import DecisionMaker
from iits_mj.core.errors import InputError
from iits_mj.core.messages import Decision, EgoState, Scene
from iits_mj.parameters import TruckParameters
from iits_mj.road import Route


class HighwayEnv:
    """The fast world as a `World`. All randomness comes from the generator given to `reset`.

    Args:
      grade_max: greatest grade of the hills; 0 for a flat road.
    """

    def __init__(self, grade_max: float = 0.045) -> None:
        self._worlds = FastWorlds(1, grade_max)
        self._trip: TripConfig | None = None

    @property
    def state(self) -> Any:
        """The world's numbers by name, see `FastWorlds.states`; assigning to one changes it."""
        return self._worlds.states[0]

    @property
    def summary(self) -> TripSummary:
        """Totals of the trip so far."""
        return self._worlds.summary(0)

    @property
    def road(self) -> HighwayRoad:
        """The trip's road."""
        return self._worlds.road(0)

    @property
    def traffic(self) -> HighwayTraffic:
        """The vehicles around the truck."""
        return HighwayTraffic(self._worlds.states)

    def reset(self, generator: np.random.Generator, trip: TripConfig | None = None) -> Observation:
        """Starts a trip at the traffic's speed in the right lane; returns the observation.

        The trip takes the generator's next 2^64 random numbers.
        """
        trip = trip or TripConfig()
        if self._trip is None or trip.truck is not self._trip.truck:
            self._footprint = TruckParameters.load(trip.truck).footprint
        self._trip = trip
        self._worlds.reset(0, generator, self._trip)
        return self._worlds.observations[0]

    def close(self) -> None:
        """Ends the trip."""
        self._trip = None

    def context(self) -> DecisionContext:
        """Returns the context of a decision now."""
        self._running()
        state = self.state
        station = float(state["front"]) - self._footprint.front_overhang
        ego = EgoState(
            time=float(state["time"]),
            x=station,
            y=float(state["offset"]),
            speed=float(state["speed"]),
            lateral_speed=float(state["lateral_speed"]),
            acceleration=float(state["acceleration"]),
            mass=float(state["mass"]),
            station=station,
            offset=float(state["offset"]),
            trailer_offset=float(state["offset"]),
        )
        scene = Scene(ego.time, ego, self.traffic.tracked(float(state["front"])), self._footprint)
        lane, reference_speed = int(state["lane"]), float(state["reference_speed"])
        may_pass = True
        if state["truck_keeps_right"]:
            leader = scene.neighbors.leader_in_lane(self.road, lane)
            may_pass = not stays_free(leader, ego.speed, reference_speed, FollowingConfig())
        return DecisionContext(
            scene=scene,
            route=cast(Route, self.road),
            lane=lane,
            lanes=tuple(range(int(state["lanes"]))),
            reference_speed=reference_speed,
            observation=self._worlds.observations[0],
            may_pass=may_pass,
        )

    def step(self, decision: Decision, speed_max: float = math.inf) -> TripStep:
        """Carries out a decision, or refuses it, until the next one is due.

        Args:
          decision: about the lane.
          speed_max: highest speed that the truck aims at until then [m/s].

        Raises:
          InputError: no trip has begun, or it is over.
        """
        self._running()
        self._worlds.step([int(decision)], speed_max)
        state = self.state
        return TripStep(
            self._worlds.observations[0],
            RewardTerms(*state["reward"].tolist()),
            float(state["seconds"]),
            bool(state["terminated"]),
            bool(state["truncated"]),
        )

    def drive(self, maker: DecisionMaker) -> None:
        """Drives to the trip's end; by a rule without Python.

        Raises:
          InputError: no trip has begun, or it is over.
        """
        self._running()
        rule = compiled(maker)
        if rule is not None:
            self._worlds.drive(rule)
        while not self._over:
            decision = maker.decide(self.context())
            self.step(decision, speed_max_of(maker))

    @property
    def _over(self) -> bool:
        return bool(self.state["terminated"] or self.state["truncated"])

    def _running(self) -> None:
        if self._trip is None or self._over:
            raise InputError("the trip has not begun: call reset(generator) first")
