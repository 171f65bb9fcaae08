"""Trips of the MuJoCo truck in SUMO traffic, one decision per step."""

from __future__ import annotations

from collections.abc import Callable

import mujoco
import numpy as np

from controllers.decision.base import DecisionContext, Observation
from controllers.decision.trip import TripConfig, TripLog, TripStep, TripSummary
from iits_mj.core.context import Closing
from iits_mj.core.errors import InputError
from iits_mj.core.messages import Decision, EgoFootprint
from iits_mj.core.timing import CYCLE_PERIOD
from iits_mj.road import Route
from iits_mj.simulation.config import DriveConfig
from iits_mj.simulation.loop import Simulation
from traffic_bridge import InterSim, SeparateTraffic, Traffic, TrafficConfig, sumo_runs_here

FAST_TIMESTEP = 0.005
# The lane-change model that the paper names.
LANE_CHANGE = "mobil"
# Road with traffic beyond the end of a trip [m].
_BEYOND = 1_000.0


class PendingDecision:
    """A decision maker that returns the learner's decision once, and otherwise keeps the lane.

    Attributes:
      pending: the next decision; None after its use.
    """

    def __init__(self) -> None:
        self.pending: Decision | None = None

    def reset(self) -> None:
        """Removes the pending decision."""
        self.pending = None

    def decide(self, context: DecisionContext) -> Decision:
        """Returns the pending decision, once."""
        del context
        answer, self.pending = self.pending, None
        return Decision.KEEP if answer is None else answer


class TruckWorld(Closing):
    """The full chain as a `controllers.decision.trip.World`, on the built-in highway.

    InterSim traffic, planner, tracking and truck are those of a drive. A training trip may have a
    larger time step, no bodies for pictures, and traffic on the needed part of the road only.

    Args:
      timestep: of the physics [s].
      payload_height: of the load's centre of gravity above the road [m]; default: the truck's.
      plant: model of the truck's motion; see `Truck.load`.
      aeb: whether emergency braking guards the truck; sensors: see `DriveConfig`.
      visuals: adds bodies for pictures.
      edit_spec: called on the model's `MjSpec` before compilation, for cameras.

    Attributes:
      simulation: of the trip; None before the first one.
      summary: of the trip so far.
    """

    def __init__(
        self,
        timestep: float = FAST_TIMESTEP,
        *,
        payload_height: float | None = None,
        plant: str = "full",
        aeb: bool = False,
        sensors: str = "perfect",
        visuals: bool = False,
        edit_spec: Callable[[mujoco.MjSpec], None] | None = None,
    ) -> None:
        self.timestep = timestep
        self.payload_height = payload_height
        self.plant = plant
        self.aeb, self.sensors = aeb, sensors
        self.visuals = visuals
        self.edit_spec = edit_spec
        self.simulation: Simulation | None = None
        self.summary = TripSummary()
        self._decisions = PendingDecision()

    def reset(self, generator: np.random.Generator, trip: TripConfig | None = None) -> Observation:
        """Starts a trip in the right lane at the traffic's speed; returns the observation.

        Args:
          generator: draws the seed of the traffic.
          trip: default: the densest of the paper's cells.

        Raises:
          InputError: the trip does not fit the road. TrafficError: SUMO is not usable.
        """
        self.close()
        self.trip = trip = trip or TripConfig()
        if (trip.lanes, trip.truck_speed_limit, trip.ramp_probability) != (2, None, 0.0):
            raise InputError(
                "the built-in highway has two lanes, no on-ramps and one speed limit; more lanes, "
                "ramps and a limit of trucks are for the fast world"
            )
        seed = int(generator.integers(2**31 - 1))
        config = DriveConfig(
            speed=trip.reference_speed,
            duration=trip.duration,
            truck=trip.truck,
            payload=trip.payload,
            payload_height=self.payload_height,
            plant=self.plant,
            start_station=trip.start_station,
            start_speed=min(trip.traffic_speed, trip.reference_speed),
            decision="keep",
            keep_right="on" if trip.truck_keeps_right else "off",
            # Observations and rewards assume a constant reference speed.
            speed_planner="cruise",
            seed=seed,
            aeb="on" if self.aeb else "off",
            sensors=self.sensors,
        )
        self.simulation = simulation = Simulation(
            config,
            edit_spec=self.edit_spec,
            traffic=lambda route, footprint: self._traffic(route, footprint, seed),
            visuals=self.visuals,
            timestep=self.timestep,
        )
        simulation.stack.decision_maker = self._decisions
        self._decisions.reset()
        # At the start the stack has asked for a decision and kept its lane.
        while not (self._asks_next(simulation) or self._over(simulation)):
            simulation.cycle()
        self.log = TripLog(trip)
        self.summary = self.log.summary
        return simulation.stack.history.observation()

    def context(self) -> DecisionContext:
        """Returns the input of a decision maker at this instant.

        Raises:
          InputError: no trip has begun.
        """
        simulation = self.running
        return simulation.stack.context(simulation.scene)

    def tell(self, decision: Decision) -> None:
        """Sets the next decision, for callers that advance the simulation themselves."""
        self._decisions.pending = decision

    def step(self, decision: Decision) -> TripStep:
        """Executes or refuses a decision and drives until the next decision is due.

        Raises:
          InputError: no trip has begun, or it is over.
          DivergedError, TrafficError: the simulation failed.
        """
        simulation = self.running
        if self._over(simulation):
            raise InputError("the trip is over: call reset first")
        stack, log = simulation.stack, self.log
        before = stack.lane_changes, stack.refused, stack.unsafe
        self.tell(decision)
        log.begin()
        # The stack asks for a decision in the first cycle, and again after the last one.
        while not self._over(simulation):
            frame = simulation.cycle()
            log.charge_speed(frame.ego.speed, CYCLE_PERIOD)
            log.drive(frame.ego.speed, CYCLE_PERIOD)
            log.quality.add_plan(frame.scene, simulation.route, frame.trajectory, CYCLE_PERIOD)
            self.summary.distance = frame.distance
            self.summary.time_gap_min = min(self.summary.time_gap_min, frame.time_gap)
            if self._asks_next(simulation):
                break
        return log.end(
            decision,
            stack.history.observation(),
            changes=stack.lane_changes - before[0],
            refused=stack.refused - before[1],
            dangerous=stack.unsafe - before[2],
            collision_at=log.elapsed if simulation.failed else None,
            over=self._over(simulation),
        )

    def close(self) -> None:
        """Ends SUMO."""
        if self.simulation is not None:
            self.simulation.close()
            self.simulation = None

    @property
    def running(self) -> Simulation:
        """Simulation of the trip.

        Raises:
          InputError: no trip has begun.
        """
        if self.simulation is None:
            raise InputError("the trip has not begun: call reset first")
        return self.simulation

    def _over(self, simulation: Simulation) -> bool:
        return bool(simulation.ended) or simulation.frame.distance >= self.trip.length

    def _asks_next(self, simulation: Simulation) -> bool:
        return simulation.stack.asks_at(simulation.time + CYCLE_PERIOD)

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
        # libsumo holds one simulation: a second world gets its own process.
        mode = SeparateTraffic if sumo_runs_here() else InterSim
        return mode(route, settings, seed=seed)
