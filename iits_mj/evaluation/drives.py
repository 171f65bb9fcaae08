"""Drives one trial of a decision maker, in the full chain or in the fast world."""

from __future__ import annotations

import functools
import math
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

from controllers import decision as decisions
from controllers.decision import fast_world
from controllers.decision.base import DecisionContext, speed_max_of
from controllers.decision.fast_world.env import HighwayEnv
from controllers.decision.prices import Prices
from controllers.decision.quality import QualityLog
from controllers.decision.trip import SPAWN_PROBABILITY, TripConfig
from controllers.protocols import DecisionMaker
from controllers.stack import Stack
from iits_mj.core.errors import InputError
from iits_mj.core.messages import Decision
from iits_mj.core.timing import CYCLE_PERIOD
from iits_mj.evaluation import trials
from iits_mj.evaluation.trials import (
    CLOSE,
    EMPTY,
    LEFT_RANGE,
    Task,
    Trial,
    quality_columns,
    weights_digest,
)
from iits_mj.parameters import AnyTruck, TruckParameters
from iits_mj.road import Route
from iits_mj.simulation import DriveConfig, DriveFrame, Observer, Simulation
from iits_mj.simulation.frame import DivergedError
from iits_mj.simulation.lock_step import LockStep
from iits_mj.simulation.parts import make_stack
from iits_mj.simulation.truck_world import LANE_CHANGE
from iits_mj.truck import Truck
from iits_mj.validation.harness.run_cache import drive_digest

REFERENCE_SPEED = TripConfig().reference_speed
_TIMED_OUT = "reached the end of the time"


@functools.cache
def trial_code(world: str) -> str:
    """Digest of the code that drives trials in a world; see `Task.world`."""
    drivers = [trials, sys.modules[__name__]]
    return drive_digest(*drivers, fast_world) if world == "fast" else drive_digest(*drivers)


def drive(
    task: Task,
    weights: Path | None = None,
    truck: AnyTruck | None = None,
    prices: Prices | None = None,
) -> Trial:
    """Drives a trial.

    Args:
      task: which trial.
      weights: file of the policy of the method "ddqn"; default: the shipped policy.
      truck: of the task; see `TruckParameters.load`.
      prices: of the method "ddqn", for its policy for every price.

    Raises:
      InputError: the weights or the truck are not those of the task.
      TrafficError: SUMO failed.
    """
    code = trial_code(task.world)
    if weights_digest(task.method, weights, prices) != task.weights:
        raise InputError("the file of weights has changed since the trials were planned")
    parameters = TruckParameters.load(truck)
    if not parameters.has_label(task.truck):
        raise InputError(f"the trial is of truck {task.truck!r}, not of {parameters.name!r}")
    learned = task.method == "ddqn"
    policy = str(weights) if weights is not None and learned else None
    offered = {"parameters": parameters, "seed": task.seed}
    maker = decisions.make(task.method, policy, prices if learned else None, **offered)
    began = time.perf_counter()
    run = _drive_fast if task.world == "fast" else _drive_full
    figures = run(task, maker, parameters)
    wall_time = round(time.perf_counter() - began, 3)
    return Trial(**vars(task), **figures, wall_time=wall_time, code=code)


class _CountingMaker:
    """A decision maker that counts its decisions to change lanes."""

    def __init__(self, maker: DecisionMaker) -> None:
        self._maker = maker
        self.asked = 0

    @property
    def speed_max(self) -> float:
        return speed_max_of(self._maker)

    def reset(self) -> None:
        self._maker.reset()
        self.asked = 0

    def decide(self, context: DecisionContext) -> Decision:
        decision = self._maker.decide(context)
        self.asked += decision is not Decision.KEEP
        return decision


class _TripObserver(Observer):
    """Measures time gaps, speed error and quality every 100 ms, and ends the trip at its length."""

    period = CYCLE_PERIOD

    def __init__(self, length: float, route: Route) -> None:
        self._length, self._route = length, route
        self.quality = QualityLog()
        self.time_gap = math.inf
        self._close = self._frames = 0
        self._error = 0.0

    def observe(self, simulation: LockStep, frame: DriveFrame) -> None:
        speed = frame.ego.speed
        self.quality.add_plan(frame.scene, self._route, frame.trajectory, self.period)
        self._frames += 1
        self._error += abs(speed - REFERENCE_SPEED)
        self.time_gap = min(self.time_gap, frame.time_gap)
        self._close += frame.time_gap < CLOSE
        if frame.distance >= self._length:
            simulation.stop("reached the end of the trip")

    @property
    def close_share(self) -> float:
        return self._close / self._frames

    @property
    def speed_error(self) -> float:
        return self._error / self._frames


def full_chain(
    task: Task, maker: DecisionMaker, parameters: TruckParameters | None = None
) -> Simulation:
    """The simulation of a trip in the full chain: MuJoCo truck, planner, tracking, SUMO traffic.

    Args:
      task: which trial; the trip ends after its duration, not after its length.
      maker: of the decisions.
      parameters: of the truck; default: the shipped one's.

    Raises:
      TrafficError: SUMO failed.
    """
    config = DriveConfig(
        truck=parameters,
        density=task.density,
        traffic_speed=task.traffic_speed,
        traffic_mode="none" if task.density == EMPTY else "inter",
        lane_change=LANE_CHANGE,
        lane_discipline=task.lane_discipline,
        keep_right=task.keep_right,
        decision="keep",  # replaced in `driver`
        duration=task.duration_limit,
        seed=task.seed,
        payload=task.payload,
        plant=task.world,
        speed=REFERENCE_SPEED,
        start_speed=task.traffic_speed,
        speed_planner="cruise",
    )

    def driver(route: Route, truck: Truck) -> Stack:
        stack = make_stack(config, route, truck.parameters)
        stack.decision_maker = maker
        return stack

    return Simulation(config, driver=driver, visuals=False, timestep=task.timestep)


def _drive_full(task: Task, maker: DecisionMaker, parameters: TruckParameters) -> dict[str, Any]:
    """Figures of a trip in the full chain."""
    counting = _CountingMaker(maker)
    with full_chain(task, counting, parameters) as simulation:
        observer = _TripObserver(task.length_limit, simulation.route)
        try:
            result = simulation.run([observer])
        except DivergedError:
            result = simulation.summary()
        unsafe, limits = simulation.stack.unsafe, simulation.truck.left_range
    ended = "".join((result.ended, *(f"{LEFT_RANGE}{limit}" for limit in limits)))
    timed_out = result.ended == _TIMED_OUT
    return {
        "speed_loss": 1.0 - result.mean_speed / REFERENCE_SPEED,
        "speed_error": observer.speed_error,
        "changes": result.lane_changes,
        "asked": counting.asked,
        "refused": result.refused,
        "unsafe": unsafe,
        "collisions": int(result.collision),
        "failures": int(result.failed or timed_out),
        "ended": " ".join(ended.split()),
        "time_gap": observer.time_gap,
        "close_share": observer.close_share,
        "box_distance": result.closest_box,
        "fuel": result.fuel,
        "distance": result.distance,
        "time": result.duration,
        **quality_columns(observer.quality.quality, result.lane_changes, result.duration),
    }


def _drive_fast(task: Task, maker: DecisionMaker, parameters: TruckParameters) -> dict[str, Any]:
    """Figures of a trip in the fast world: a point-mass truck in simulated traffic."""
    empty = task.density == EMPTY
    trip = TripConfig(
        truck=parameters,
        spawn_probability=0.0 if empty else SPAWN_PROBABILITY[task.density],
        traffic_speed=task.traffic_speed,
        keeps_right=task.lane_discipline == "right",
        truck_keeps_right=task.keep_right == "on",
        payload=task.payload,
        length=task.length_limit,
        duration=task.duration_limit,
    )
    env = HighwayEnv()
    maker.reset()
    env.reset(np.random.default_rng(task.seed), trip)
    env.drive(maker)
    result = env.summary
    timed_out = not result.collisions and result.time >= task.duration_limit
    ended = "collision" if result.collisions else "reached the end of the trip"
    return dict(
        speed_loss=result.speed_loss,
        changes=result.changes,
        asked=result.changes + result.refused,
        refused=result.refused,
        unsafe=result.dangerous,
        collisions=result.collisions,
        failures=int(bool(result.collisions) or timed_out),
        ended=_TIMED_OUT if timed_out else ended,
        time_gap=result.time_gap_min,
        distance=result.distance,
        time=result.time,
        **quality_columns(result.quality, result.changes, result.time),
        **dict.fromkeys(("speed_error", "close_share", "box_distance", "fuel"), math.nan),
    )
