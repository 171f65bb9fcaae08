"""Trips of the MuJoCo truck in SUMO traffic, one decision a step: the world that counts."""

from __future__ import annotations

from collections.abc import Callable

import mujoco
import numpy as np

from controllers.decision.base import DecisionContext, Observation
from controllers.decision.trip import (
    RewardTerms,
    TripConfig,
    TripStep,
    TripSummary,
    decision_charge,
    speed_charge,
)
from iits_mj.core.context import Closing
from iits_mj.core.errors import InputError
from iits_mj.core.messages import Decision, EgoFootprint
from iits_mj.core.timing import CYCLE_PERIOD
from iits_mj.road import Route
from iits_mj.simulation.config import DriveConfig
from iits_mj.simulation.frame import Frame
from iits_mj.simulation.loop import Simulation
from traffic_bridge import InterSim, SeparateTraffic, Traffic, TrafficConfig, sumo_runs_here

FAST_TIMESTEP = 0.005
# The lane-change model that the paper names.
LANE_CHANGE = "mobil"
# What the truck's observers see beyond the end of a trip.
_BEYOND = 1_000.0


class Asked:
    """A decision maker that answers what the learner chose; keeps the lane when not told.

    Attributes:
      pending: the answer to the next question, None when it was given.
    """

    name = "asked"

    def __init__(self) -> None:
        self.pending: Decision | None = None

    def reset(self) -> None:
        """Forgets the pending answer."""
        self.pending = None

    def decide(self, context: DecisionContext) -> Decision:
        """Gives the pending answer, once."""
        del context
        answer, self.pending = self.pending, None
        return Decision.KEEP if answer is None else answer


class TruckWorld(Closing):
    """The full chain as a `controllers.decision.trip.World`, on the built-in highway.

    InterSim traffic, planner, tracking and the truck are those of a drive. What a trip of training
    may have otherwise: a larger time step of the physics, no bodies that are only seen, and traffic
    on no more of the road than the trip needs.

    Args:
      timestep: of the physics [s].
      payload_height: of the load's centre of gravity above the road [m]; default: the truck's.
      visuals: adds what is only seen.
      edit_spec: called on the model's `MjSpec` before it is compiled, for cameras.

    Attributes:
      simulation: of the trip; None before the first.
      summary: of the trip so far.
    """

    def __init__(
        self,
        timestep: float = FAST_TIMESTEP,
        *,
        payload_height: float | None = None,
        visuals: bool = False,
        edit_spec: Callable[[mujoco.MjSpec], None] | None = None,
    ) -> None:
        self.timestep = timestep
        self.payload_height = payload_height
        self.visuals = visuals
        self.edit_spec = edit_spec
        self.simulation: Simulation | None = None
        self.summary = TripSummary()
        self._asked = Asked()

    def reset(self, generator: np.random.Generator, trip: TripConfig | None = None) -> Observation:
        """Starts a trip at the traffic's speed in the right lane; returns the observation.

        Args:
          generator: gives the seed of the traffic.
          trip: default: the densest of the paper's cells.

        Raises:
          InputError: the trip does not fit the road. TrafficError: SUMO is not usable.
        """
        self.close()
        self.trip = trip = trip or TripConfig()
        seed = int(generator.integers(2**31 - 1))
        config = DriveConfig(
            speed=trip.reference_speed,
            duration=trip.duration,
            payload=trip.payload,
            payload_height=self.payload_height,
            start_station=trip.start_station,
            start_speed=min(trip.traffic_speed, trip.reference_speed),
            decision="keep",
            # Its observations and rewards are those of a constant reference speed.
            speed_planner="cruise",
            seed=seed,
        )
        self.simulation = simulation = Simulation(
            config,
            edit_spec=self.edit_spec,
            traffic=lambda route, footprint: self._traffic(route, footprint, seed),
            visuals=self.visuals,
            timestep=self.timestep,
        )
        simulation.stack.decision_maker = self._asked
        self._asked.reset()
        # The question at the very start was answered with "keep".
        while not (self._asks_next(simulation) or self._over(simulation)):
            simulation.cycle()
        self.summary = TripSummary()
        return simulation.stack.history.observation()

    def context(self) -> DecisionContext:
        """What a decision maker is given now.

        Raises:
          InputError: no trip was begun.
        """
        simulation = self._running()
        return simulation.stack.context(simulation.scene)

    def tell(self, decision: Decision) -> None:
        """What the stack is answered when it next asks, for who advances the simulation itself."""
        self._asked.pending = decision

    def step(self, decision: Decision) -> TripStep:
        """Carries out a decision, or refuses it, until the next one is due.

        Raises:
          InputError: no trip was begun, or it is over.
          DivergedError, TrafficError: the simulation failed.
        """
        simulation = self._running()
        if self._over(simulation):
            raise InputError("the trip is over: call reset first")
        stack, reward = simulation.stack, self.trip.reward
        before = (stack.lane_changes, stack.refused, stack.unsafe)
        self.tell(decision)
        terms = RewardTerms()
        elapsed = 0.0
        # It is asked in the first cycle, and after the last one it is about to be asked again.
        while not self._over(simulation):
            frame = simulation.cycle()
            speed = speed_charge(frame.ego.speed, self.trip.reference_speed, elapsed, reward)
            terms += RewardTerms(speed=speed * CYCLE_PERIOD)
            elapsed += CYCLE_PERIOD
            self._note(frame)
            if self._asks_next(simulation):
                break
        changes, refused, unsafe = (
            now - then
            for now, then in zip(
                (stack.lane_changes, stack.refused, stack.unsafe), before, strict=True
            )
        )
        terms += decision_charge(decision is not Decision.KEEP, unsafe > 0, reward)
        if simulation.failed:
            factor = reward.discount**elapsed
            terms += RewardTerms(collision=-reward.collision * factor)
        summary = self.summary
        summary.decisions += 1
        summary.changes += changes
        summary.refused += refused
        summary.dangerous += unsafe
        summary.collisions += int(simulation.failed)
        summary.reward += terms
        over = self._over(simulation)
        return TripStep(
            stack.history.observation(),
            terms,
            elapsed,
            terminated=simulation.failed,
            truncated=over and not simulation.failed,
        )

    def close(self) -> None:
        """Ends SUMO."""
        if self.simulation is not None:
            self.simulation.close()
            self.simulation = None

    def _running(self) -> Simulation:
        if self.simulation is None:
            raise InputError("the trip has not begun: call reset first")
        return self.simulation

    def _over(self, simulation: Simulation) -> bool:
        return bool(simulation.ended) or simulation.frame.distance >= self.trip.length

    def _asks_next(self, simulation: Simulation) -> bool:
        return simulation.stack.asks_at(simulation.time + CYCLE_PERIOD)

    def _note(self, frame: Frame) -> None:
        summary, reference = self.summary, self.trip.reference_speed
        summary.time += CYCLE_PERIOD
        summary.distance = frame.distance
        summary.loss_integral += (reference - frame.ego.speed) / reference * CYCLE_PERIOD
        summary.time_gap_min = min(summary.time_gap_min, frame.time_gap)

    def _traffic(self, route: Route, footprint: EgoFootprint, seed: int) -> Traffic:
        trip = self.trip
        reach = min(trip.length, trip.reference_speed * trip.duration)
        settings = TrafficConfig(
            density=trip.spawn_probability,
            speed_limit=trip.traffic_speed,
            lane_change=LANE_CHANGE,
            lane_discipline="right" if trip.keeps_right else "free",
            footprint=footprint,
            fill_ahead=min(TrafficConfig.fill_ahead, reach + _BEYOND),
        )
        # libsumo holds one simulation: where another world of this process has it, ours goes out.
        mode = SeparateTraffic if sumo_runs_here() else InterSim
        return mode(route, settings, seed=seed)
