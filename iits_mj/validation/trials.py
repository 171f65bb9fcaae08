"""Trials of decision makers: what is driven in one, and the row of figures that it gives."""

from __future__ import annotations

import functools
import hashlib
import math
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from controllers import decision as decisions
from controllers.decision.base import DecisionContext, DecisionMaker
from controllers.decision.highway_env import HighwayEnv
from controllers.decision.policy import SHIPPED
from controllers.decision.reward import RewardConfig
from controllers.decision.trip import SPAWN_PROBABILITY, TripConfig
from iits_mj.errors import InputError
from iits_mj.messages import Decision
from iits_mj.road import Route
from iits_mj.simulation import DriveConfig, Frame, Simulation
from iits_mj.simulation.ending import DivergedError
from iits_mj.simulation.parts import make_stack
from iits_mj.simulation.truck_world import LANE_CHANGE
from iits_mj.truck import Truck
from iits_mj.validation.kept_runs import drive_digest

WORLDS = ("full", "fast")
EMPTY = "empty"
REFERENCE_SPEED = TripConfig().reference_speed
CLOSE = 1.0  # time gap that is called close [s]
_SLOWEST = 1.0  # below, a time gap says nothing [m/s]
_PERIOD = 0.1  # [s]


@dataclass(frozen=True)
class Task:
    """A trial that is to be driven.

    Attributes:
      world: one of `WORLDS`; density: "empty" is a road without traffic.
      traffic_speed: the traffic's limit, and the truck's speed at the start [m/s].
      method: the decision maker; weights: digest of its policy, "" of a rule.
      payload: of the truck [kg]; timestep: of its physics in the full chain [s].
      length_limit: the trip ends there [m], or at the road's end; duration_limit: cut off [s].
      seed: of the traffic.
    """

    world: str
    density: str
    traffic_speed: float
    method: str
    weights: str
    payload: float
    timestep: float
    length_limit: float
    duration_limit: float
    seed: int


@dataclass(frozen=True)
class Trial(Task):
    """One trip of one decision maker; a figure that its world does not have is nan.

    Attributes:
      speed_loss: mean over time of (v_ref - v) / v_ref.
      speed_error: mean over time of |v_ref - v| [m/s], the reward's.
      changes: carried out; asked: decisions to change; refused: of those; unsafe: of the refused,
        those because of a vehicle.
      collisions: with a vehicle; failures: collision, roll-over, divergence, or cut off by time.
      ended: how, in words.
      time_gap: least time gap to the vehicle ahead [s], while faster than 1 m/s, inf without one.
        One that cuts in counts from where its box reaches into the truck's width.
      close_share: share of the time with a time gap under 1 s.
      box_distance: least to any vehicle, box to box [m]; fuel: [kg].
      distance: [m]; time: of the trip [s]; wall_time: [s]; code: digest of what drove it.
    """

    speed_loss: float
    speed_error: float
    changes: int
    asked: int
    refused: int
    unsafe: int
    collisions: int
    failures: int
    ended: str
    time_gap: float
    close_share: float
    box_distance: float
    fuel: float
    distance: float
    time: float
    wall_time: float
    code: str

    @property
    def task(self) -> Task:
        """What was driven: makes a trial unique."""
        return task_of(self)

    @property
    def reward_rates(self) -> tuple[float, float, float]:
        """Charges for changes, danger and speed, a second, not discounted."""
        config = RewardConfig()
        changes, danger = config.change * self.asked, config.danger * self.unsafe
        return -changes / self.time, -danger / self.time, -config.speed * self.speed_error


def task_of(trial: Task) -> Task:
    """The task in a trial."""
    return Task(
        trial.world,
        trial.density,
        trial.traffic_speed,
        trial.method,
        trial.weights,
        trial.payload,
        trial.timestep,
        trial.length_limit,
        trial.duration_limit,
        trial.seed,
    )


def order_of(task: Task) -> tuple[object, ...]:
    """What rows are sorted by: the paper's cells in its order, trial by trial."""
    cell = [*SPAWN_PROBABILITY, EMPTY].index(task.density), task.traffic_speed
    rest = (task.payload, task.timestep, task.length_limit, task.duration_limit, task.seed)
    return (task.world, *cell, *rest, task.method, task.weights)


def weights_digest(method: str, weights: Path | None) -> str:
    """Twelve hexadecimal digits of a policy's file, the shipped one's without one; "" of a rule.

    Raises:
      InputError: the file cannot be read.
    """
    if method != "ddqn":
        return ""
    path = weights or SHIPPED
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()[:12]
    except OSError as error:
        raise InputError(f"weights file {str(path)!r} cannot be read: {error.strerror}") from error


@functools.cache
def trial_code() -> str:
    """Digest of the code that drives trials."""
    return drive_digest(sys.modules[__name__])


def drive(task: Task, weights: Path | None = None) -> Trial:
    """Drives a trial.

    Args:
      task: what.
      weights: file of the policy, for the method "ddqn"; default: the shipped one.

    Raises:
      InputError: the weights are not those of the task. TrafficError: SUMO failed.
    """
    code = trial_code()
    if weights_digest(task.method, weights) != task.weights:
        raise InputError("the weights' file is not the one that was asked for: it has been changed")
    policy = str(weights) if weights is not None and task.method == "ddqn" else None
    maker = _Counted(decisions.make(task.method, policy))
    return (_drive_full if task.world == "full" else _drive_fast)(task, maker, code)


class _Counted:
    """A decision maker whose decisions to change are counted."""

    def __init__(self, maker: DecisionMaker) -> None:
        self._maker = maker
        self.name = maker.name
        self.asked = 0

    def reset(self) -> None:
        self._maker.reset()
        self.asked = 0

    def decide(self, context: DecisionContext) -> Decision:
        decision = self._maker.decide(context)
        self.asked += decision is not Decision.KEEP
        return decision


class _Watch:
    """Time gaps and the speed's distance from the reference, every 100 ms; ends the trip."""

    period = _PERIOD

    def __init__(self, length: float) -> None:
        self._length = length
        self.time_gap = math.inf
        self._close = self._frames = 0
        self._error = 0.0

    def observe(self, simulation: Simulation, frame: Frame) -> None:
        speed = frame.ego.speed
        self._frames += 1
        self._error += abs(speed - REFERENCE_SPEED)
        if speed > _SLOWEST:
            gap = frame.gap_ahead / speed
            self.time_gap = min(self.time_gap, gap)
            self._close += gap < CLOSE
        if frame.distance >= self._length:
            simulation.stop("reached the end of the trip")

    @property
    def close_share(self) -> float:
        return self._close / self._frames

    @property
    def speed_error(self) -> float:
        return self._error / self._frames


def _drive_full(task: Task, maker: _Counted, code: str) -> Trial:
    """The full chain: MuJoCo truck, planner and tracking in SUMO traffic."""
    config = DriveConfig(
        density=task.density,
        traffic_speed=task.traffic_speed,
        traffic_mode="none" if task.density == EMPTY else "inter",
        lane_change=LANE_CHANGE,
        lane_discipline="free",
        decision="keep",  # `driver` puts the one that is counted in its place
        duration=task.duration_limit,
        seed=task.seed,
        payload=task.payload,
        speed=REFERENCE_SPEED,
        start_speed=task.traffic_speed,
        speed_planner="cruise",
    )

    def driver(route: Route, truck: Truck) -> object:
        stack = make_stack(config, route, truck.parameters)
        stack.decision_maker = maker
        return stack

    began = time.perf_counter()
    watch = _Watch(task.length_limit)
    with Simulation(
        config,
        driver=driver,  # type: ignore[arg-type]
        visuals=False,
        timestep=task.timestep,
    ) as simulation:
        try:
            result = simulation.run([watch])
        except DivergedError:
            result = simulation.summary()
        unsafe = simulation.stack.unsafe
    timed_out = result.ended == "reached the end of the time"
    return Trial(
        **vars(task),
        speed_loss=1.0 - result.mean_speed / REFERENCE_SPEED,
        speed_error=watch.speed_error,
        changes=result.lane_changes,
        asked=maker.asked,
        refused=result.refused,
        unsafe=unsafe,
        collisions=int(result.collision),
        failures=int(result.failed or timed_out),
        ended=" ".join(result.ended.split()),
        time_gap=watch.time_gap,
        close_share=watch.close_share,
        box_distance=result.closest_box,
        fuel=result.fuel,
        distance=result.distance,
        time=result.duration,
        wall_time=round(time.perf_counter() - began, 3),
        code=code,
    )


def _drive_fast(task: Task, maker: _Counted, code: str) -> Trial:
    """The fast world: point-mass truck in numpy traffic."""
    empty = task.density == EMPTY
    trip = TripConfig(
        spawn_probability=0.0 if empty else SPAWN_PROBABILITY[task.density],
        traffic_speed=task.traffic_speed,
        payload=task.payload,
        length=task.length_limit,
        duration=task.duration_limit,
    )
    began = time.perf_counter()
    env = HighwayEnv()
    maker.reset()
    env.reset(np.random.default_rng(task.seed), trip)
    over = False
    while not over:
        step = env.step(maker.decide(env.context()))
        over = step.terminated or step.truncated
    result = env.summary
    timed_out = not result.collisions and result.time >= task.duration_limit
    ended = "collision" if result.collisions else "reached the end of the trip"
    return Trial(
        **vars(task),
        speed_loss=result.speed_loss,
        speed_error=math.nan,
        changes=result.changes,
        asked=maker.asked,
        refused=result.refused,
        unsafe=result.dangerous,
        collisions=result.collisions,
        failures=int(bool(result.collisions) or timed_out),
        ended="reached the end of the time" if timed_out else ended,
        time_gap=result.time_gap_min,
        close_share=math.nan,
        box_distance=math.nan,
        fuel=math.nan,
        distance=result.distance,
        time=result.time,
        wall_time=round(time.perf_counter() - began, 3),
        code=code,
    )


def codes_of(trials: Sequence[Trial]) -> list[str]:
    """The versions of the code that drove these trials."""
    return sorted({trial.code for trial in trials})


__all__ = [
    "EMPTY",
    "WORLDS",
    "Task",
    "Trial",
    "codes_of",
    "drive",
    "order_of",
    "task_of",
    "trial_code",
    "weights_digest",
]
