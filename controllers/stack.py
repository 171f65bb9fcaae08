"""The pipeline: scene -> decision -> trajectory -> command.

It depends on messages and roads only, so that it could run on a real truck's computer.
"""

from __future__ import annotations

import functools
import math
from dataclasses import replace
from typing import TYPE_CHECKING

from controllers.decision.base import DecisionContext, Keep, speed_max_of
from controllers.decision.observation import ObservationHistory, observe_frame
from controllers.own_parts import (
    AnyPlanner,
    guarded_decision,
    guarded_planner,
    guarded_speed,
)
from controllers.planning.planner import Planner, PlannerConfig, named_decision
from controllers.planning.speed_reference import CruiseReference, ProfileReference, SpeedReference
from controllers.protocols import (
    DecisionMaker,
    LateralControl,
    LongitudinalControl,
    SpeedSource,
    TrajectoryPlanner,
)
from controllers.tracking.controller import Tracker, TrackingConfig
from controllers.tracking.gear_requests import GearKeeper, in_planned_gear
from iits_mj.core.errors import InputError
from iits_mj.core.messages import (
    Decision,
    EgoState,
    Scene,
    SpeedProfile,
    Trajectory,
    VehicleCommand,
)
from iits_mj.core.timing import CYCLE_PERIOD
from iits_mj.parameters import TruckParameters

if TYPE_CHECKING:
    from iits_mj.road import Route


class Stack:
    """Decision maker, planner and tracker at their own rates.

    Call `plan` every 100 ms and `control` every 20 ms; the decision maker decides once every
    `decision_period` seconds, and not during a lane change. Parts of your own need the methods of
    `controllers.protocols`.

    Attributes:
      last_decision: of the decision maker; speed_max: highest speed [m/s] that it allows.
      last_trajectory: the tracked one, or None before the first plan.
      reference: desired speed of the truck.
    """

    def __init__(
        self,
        route: Route,
        decision_maker: DecisionMaker | None = None,
        planner: PlannerConfig | None = None,
        tracking: TrackingConfig | None = None,
        parameters: TruckParameters | None = None,
        profile: SpeedProfile | None = None,
        decision_period: float = 1.0,
        reference: SpeedReference | SpeedSource | None = None,
        trajectory_planner: TrajectoryPlanner | None = None,
        lateral: LateralControl | None = None,
        longitudinal: LongitudinalControl | None = None,
    ) -> None:
        """Builds the pipeline.

        Args:
          route: the truck's road.
          decision_maker: default: keeps the lane.
          planner: settings; default: the paper's 16.67 m/s on the two outermost lanes.
          tracking: settings.
          parameters: of the truck; default: the shipped one.
          profile: reference speed over station, planned before the drive.
          decision_period: [s].
          reference: of the speed, as `controllers.pcc.PccReference`; default: the profile, or
            without one the planner's cruise speed.
          trajectory_planner: default: the paper's planner with the settings `planner`.
          lateral: controller of the steering; default: with the settings `tracking`.
          longitudinal: controller of the speed; default: with the settings `tracking`.

        Raises:
          InputError: profile and reference are both given, the profile is not valid, or a part
            lacks a method.
        """
        if profile is not None and reference is not None:
            raise InputError("a stack has one speed reference: give profile or reference, not both")
        self.route = route
        self.decision_maker = guarded_decision(Keep() if decision_maker is None else decision_maker)
        self.planner: AnyPlanner
        if trajectory_planner is None:
            self.planner = Planner(route, planner, parameters)
        else:
            config = planner or PlannerConfig()
            self.planner = guarded_planner(trajectory_planner, route, config)
        self.tracker = Tracker(route, parameters, tracking, lateral, longitudinal)
        self.reference: SpeedReference
        if reference is not None:
            self.reference = guarded_speed(reference)
        elif profile is not None:
            self.reference = ProfileReference(profile)
        else:
            self.reference = CruiseReference(self.planner.config.speed.cruise_speed)
        self.decision_period = decision_period
        self.history = ObservationHistory()
        self._gear_keeper = GearKeeper()
        self.reset()

    def reset(self) -> None:
        """Clears all memory and counters, for a new drive."""
        self.planner.reset()
        self.tracker.reset()
        self._gear_keeper.reset()
        self.history.reset()
        self.decision_maker.reset()
        self.reference.reset()
        self.last_decision = Decision.KEEP
        self.speed_max = math.inf
        self.last_trajectory: Trajectory | None = None
        self._profile: SpeedProfile | None = None
        self.decisions = 0
        self._decided_at: float | None = None

    @property
    def lane_changes(self) -> int:
        """Lane changes completed."""
        return self.planner.lane_changes

    @property
    def refused(self) -> int:
        """Decisions to change that the planner refused, unsafe ones included."""
        return self.planner.refused

    @property
    def unsure_decisions(self) -> int:
        """Decisions that the decision maker left to a rule because it was unsure."""
        return int(getattr(self.decision_maker, "unsure_decisions", 0))

    @property
    def unsafe(self) -> int:
        """Decisions to change that were refused because of a vehicle."""
        return self.planner.unsafe

    def reference_speed(self, station: float) -> float:
        """Returns the desired speed at a station now [m/s]."""
        return self.reference.at(station)

    def asks_at(self, time: float) -> bool:
        """Returns whether a plan at a time [s] would ask the decision maker."""
        if self.planner.changing:
            return False
        last = self._decided_at
        return last is None or time - last >= self.decision_period - 0.5 * CYCLE_PERIOD

    def plan(self, scene: Scene) -> Trajectory:
        """Returns a new trajectory from a scene; call it every 100 ms.

        Raises:
          InputError: a number of the scene is not finite.
        """
        profile = self.reference.update(scene, lambda: self.planner.leader(scene))
        reference = self.reference.free(scene.ego.station)
        frame = functools.partial(observe_frame, scene, self.route, reference)
        self.history.add(scene.time, frame)
        decision = Decision.KEEP
        if self.asks_at(scene.time):
            self._decided_at = scene.time
            decision = self._decide(scene)
        profile = profile.capped(self.speed_max)
        self._profile = profile
        self.last_trajectory = self.planner.plan(scene, decision, profile)
        return self.last_trajectory

    def control(self, ego: EgoState) -> VehicleCommand:
        """Returns the command on the last trajectory; call it every 20 ms.

        Raises:
          InputError: there is no plan yet, or the state is not finite.
        """
        if self.last_trajectory is None:
            raise InputError("control requested before the first plan: call Stack.plan first")
        command = self.tracker.command(ego, self.last_trajectory)
        profile = self._profile
        if profile is not None:
            if ego.speed > profile.coast_above:
                command = replace(command, accelerator_pedal=0.0)
            command = in_planned_gear(command, ego, self.last_trajectory, profile)
        return self._gear_keeper.keep(command, ego, self.last_trajectory)

    def context(self, scene: Scene) -> DecisionContext:
        """Returns the context of a decision in a scene whose frame is in the history."""
        return DecisionContext(
            scene=scene,
            route=self.route,
            lane=self.planner.lane(scene),
            lanes=self.planner.config.lanes,
            # The plan's speed behind a slow leader would hide the gain of passing.
            reference_speed=self.reference.free(scene.ego.station),
            observation=self.history.observation(),
            may_pass=self.planner.may_pass(scene),
        )

    def _decide(self, scene: Scene) -> Decision:
        self.last_decision = named_decision(self.decision_maker.decide(self.context(scene)))
        self.speed_max = speed_max_of(self.decision_maker)
        self.decisions += 1
        return self.last_decision
