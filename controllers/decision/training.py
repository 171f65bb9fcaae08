"""Trains the decision maker in the fast world, with checkpoints.

One process, one core: a decision, a stored transition, a gradient step. Trips are drawn from the
paper's six cells and, for breadth, from randomized densities and traffic speeds. Every
`evaluate_interval` decisions the greedy policy drives validation trips, whose seeds neither
training nor the final evaluation uses, and the best one so far is kept.
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from controllers.decision.highway_env import HighwayEnv
from controllers.decision.network import ACTIONS, OBSERVATION_SIZE, QNetwork
from controllers.decision.replay import Replay, Returns, Transition
from controllers.decision.trip import CELLS, TripConfig, cell_trip
from iits_mj.errors import InputError

TRAINING_SEEDS, VALIDATION_SEEDS, TEST_SEEDS = 1_000_000, 2_000_000, 3_000_000
CHECKPOINT, BEST, LOG = "checkpoint.pt", "ddqn.npz", "training.csv"

_LOG_HEADER = (
    "decisions,wall_s,epsilon,loss,trips,score_per_s,speed_loss,changes_per_trip,"
    "dangerous_per_trip,collisions,reward_change,reward_speed,reward_danger,reward_collision\n"
)


@dataclass(frozen=True)
class TrainConfig:
    """What `train` is asked for.

    Attributes:
      decisions: of the truck during training.
      seed: fixes the network's start, exploration, traffic and replay draws.
      trip_duration: trips are cut off (truncated, not terminated) after this time [s].
      random_share: share of the trips with randomized density and traffic speed.
      replay_capacity: transitions kept; warm_up: transitions before the first update.
      updates_per_decision: gradient steps a decision.
      steps: n of the n-step returns; 1 is the plain double DQN.
      epsilon_start, epsilon_end: share of random decisions; epsilon_decisions: it falls over these.
      learning_rate: of Adam; batch_size; target_interval: see `LearnerConfig`.
      evaluate_interval: decisions between two validations; validation_trips: a cell.
      checkpoint_interval: decisions between two checkpoints.
      resume: continue from the checkpoint in the output folder. The replay memory is not stored:
        it is filled again, to `warm_up`, before updates go on.
    """

    decisions: int = 300_000
    seed: int = 0
    trip_duration: float = 300.0
    random_share: float = 0.4
    replay_capacity: int = 100_000
    warm_up: int = 4_000
    updates_per_decision: float = 0.5
    steps: int = 3
    epsilon_start: float = 1.0
    epsilon_end: float = 0.03
    epsilon_decisions: int = 80_000
    learning_rate: float = 5e-4
    batch_size: int = 64
    target_interval: int = 1000
    evaluate_interval: int = 20_000
    validation_trips: int = 3
    checkpoint_interval: int = 20_000
    resume: bool = False

    def __post_init__(self) -> None:
        """Refuses numbers that cannot work."""
        positive = ["decisions", "trip_duration", "replay_capacity", "warm_up", "steps"]
        positive += ["epsilon_decisions", "learning_rate", "batch_size", "target_interval"]
        positive += ["evaluate_interval", "validation_trips", "checkpoint_interval"]
        for name in positive:
            value = getattr(self, name)
            if not math.isfinite(value) or value <= 0:
                raise InputError(f"{name} = {value!r} is not allowed: use a number above 0")
        for name in ("random_share", "epsilon_start", "epsilon_end"):
            if not 0.0 <= getattr(self, name) <= 1.0:
                raise InputError(f"{name} = {getattr(self, name)!r} is not allowed: use 0 to 1")
        if self.warm_up > self.replay_capacity:
            raise InputError(f"warm_up = {self.warm_up} exceeds replay_capacity")


@dataclass(frozen=True)
class TrainSummary:
    """Outcome: the weights file of the best policy, its validation score, and the log."""

    weights: Path
    log: Path
    score: float
    decisions: int
    wall_time: float


def train(
    config: TrainConfig,
    out: str | Path,
    progress: Callable[[int, int], None] | None = None,
    command: str = "",
) -> TrainSummary:
    """Trains and leaves `ddqn.npz`, `training.csv` and `checkpoint.pt` in the folder `out`.

    Args:
      config: settings.
      out: folder, made when missing.
      progress: called with (decisions done, decisions in all).
      command: the command line, recorded in the weights' metadata.

    Raises:
      InputError: torch is missing, the folder is not writable, or the checkpoint is not usable.
    """
    try:
        import torch
    except ImportError as error:
        raise InputError("training needs torch: pip install 'iits-mj[train]'") from error
    torch.set_num_threads(1)
    return _Training(config, Path(out), command).run(progress)


def sample_trip(config: TrainConfig, generator: np.random.Generator) -> TripConfig:
    """A trip of the training mixture: one of the six cells, or a randomized traffic."""
    density, speed = CELLS[int(generator.integers(len(CELLS)))]
    trip = cell_trip(density, speed, TripConfig(duration=config.trip_duration))
    if generator.random() < config.random_share:
        trip = replace(
            trip,
            spawn_probability=math.exp(generator.uniform(math.log(0.005), math.log(0.12))),
            traffic_speed=float(generator.uniform(11.0, 16.0)),
            payload=float(generator.uniform(0.0, 36_000.0)),
        )
    return trip


def validate(network: QNetwork, trips: int, duration: float) -> dict[str, float]:
    """Drives the greedy policy over the six cells on validation seeds; means over all trips."""
    env = HighwayEnv()
    totals = dict.fromkeys(("score_per_s", "speed_loss", "changes", "dangerous", "collisions"), 0.0)
    for cell, (density, speed) in enumerate(CELLS):
        for trip in range(trips):
            seed = VALIDATION_SEEDS + 1000 * cell + trip
            config = cell_trip(density, speed, TripConfig(duration=duration))
            observation = env.reset(np.random.default_rng(seed), config)
            over = False
            while not over:
                step = env.step(network.greedy(observation))
                observation, over = step.observation, step.terminated or step.truncated
            summary = env.summary
            totals["score_per_s"] += summary.reward.total / summary.time
            totals["speed_loss"] += summary.speed_loss
            totals["changes"] += summary.changes
            totals["dangerous"] += summary.dangerous
            totals["collisions"] += summary.collisions
    count = trips * len(CELLS)
    return {name: total / count for name, total in totals.items()}


class _Training:
    """The loop's state: learner, replay, counters and generator."""

    def __init__(self, config: TrainConfig, out: Path, command: str) -> None:
        from controllers.decision.ddqn import DoubleDqn, LearnerConfig

        self.config, self.out, self.command = config, out, command
        self.learner = DoubleDqn(
            LearnerConfig(config.learning_rate, config.batch_size, config.target_interval),
            config.seed,
        )
        self.random = np.random.default_rng([config.seed, TRAINING_SEEDS])
        self.replay = Replay(config.replay_capacity, OBSERVATION_SIZE)
        self.env = HighwayEnv()
        self.decisions, self.trips = 0, 0
        self.best = -math.inf
        self.wall = 0.0
        self.loss = 0.0
        self._debt = 0.0
        self._terms = np.zeros(4)
        try:
            out.mkdir(parents=True, exist_ok=True)
            if config.resume:
                self._restore()
            else:
                (out / LOG).write_text(_LOG_HEADER, encoding="utf-8")
        except OSError as error:
            raise InputError(f"folder {str(out)!r} cannot be used: {error}") from error

    def run(self, progress: Callable[[int, int], None] | None) -> TrainSummary:
        began = time.monotonic() - self.wall
        evaluated = saved = self.decisions
        while self.decisions < self.config.decisions:
            self._trip()
            self.wall = time.monotonic() - began
            if progress is not None:
                progress(min(self.decisions, self.config.decisions), self.config.decisions)
            last = self.decisions >= self.config.decisions
            if last or self.decisions - evaluated >= self.config.evaluate_interval:
                evaluated = self.decisions
                self._evaluate()
            if last or self.decisions - saved >= self.config.checkpoint_interval:
                saved = self.decisions
                self._save()
        out = self.out
        return TrainSummary(out / BEST, out / LOG, self.best, self.decisions, self.wall)

    def epsilon(self) -> float:
        """Share of random decisions now."""
        done = min(1.0, self.decisions / self.config.epsilon_decisions)
        start, end = self.config.epsilon_start, self.config.epsilon_end
        return start + (end - start) * done

    def _trip(self) -> None:
        config = self.config
        discount = TripConfig().reward.discount
        network = self.learner.network()
        observation = self.env.reset(self.random, sample_trip(config, self.random))
        returns = Returns(config.steps)
        over = False
        while not over:
            if self.random.random() < self.epsilon():
                action = int(self.random.integers(len(ACTIONS)))
            else:
                action = int(np.argmax(network.values(observation)))
            step = self.env.step(ACTIONS[action])
            over = step.terminated or step.truncated
            # Truncation is not termination: the value of what follows still counts.
            future = 0.0 if step.terminated else discount**step.seconds
            single = Transition(observation, action, step.reward.total, future, step.observation)
            for transition in returns.add(single, over):
                self.replay.add(transition)
            terms = step.reward
            self._terms += (terms.change, terms.speed, terms.danger, terms.collision)
            observation = step.observation
            self.decisions += 1
            if len(self.replay) >= config.warm_up:
                self._debt += config.updates_per_decision
                while self._debt >= 1.0:
                    self._debt -= 1.0
                    batch = self.replay.sample(config.batch_size, self.random)
                    self.loss += 0.01 * (self.learner.update(batch) - self.loss)
        self.trips += 1

    def _evaluate(self) -> None:
        network = self.learner.network()
        result = validate(network, self.config.validation_trips, 2.0 * self.config.trip_duration)
        row = [self.decisions, round(self.wall, 1), round(self.epsilon(), 4)]
        row += [float(f"{x:.6g}") for x in (self.loss, self.trips, *result.values())]
        row += [float(f"{x:.6g}") for x in self._terms]
        self._terms = np.zeros(4)
        with (self.out / LOG).open("a", encoding="utf-8") as stream:
            stream.write(",".join(str(x) for x in row) + "\n")
        if result["score_per_s"] > self.best and result["collisions"] == 0.0:
            self.best = result["score_per_s"]
            network.save(self.out / BEST, **self._origin(result))

    def _origin(self, result: dict[str, float]) -> dict[str, Any]:
        return {
            "command": self.command,
            "world": "fast world (controllers.decision.highway)",
            "config": asdict(self.config),
            "decisions": self.decisions,
            "validation": result,
        }

    def _save(self) -> None:
        """Writes the checkpoint beside its place, then moves it there: a kill leaves one whole."""
        import torch

        state = {
            "learner": self.learner.state(),
            "generator": json.dumps(self.random.bit_generator.state),
            "counters": [self.decisions, self.trips, self.best, self.wall, self.loss],
        }
        partial = self.out / (CHECKPOINT + ".partial")
        torch.save(state, partial)
        partial.replace(self.out / CHECKPOINT)

    def _restore(self) -> None:
        import torch

        path = self.out / CHECKPOINT
        if not path.is_file():
            raise InputError(f"resume: there is no checkpoint {str(path)!r}")
        try:
            state = torch.load(path, weights_only=True)
            self.learner.restore(state["learner"])
            self.random.bit_generator.state = json.loads(state["generator"])
            counters = state["counters"]
        except Exception as error:  # torch raises many kinds for a damaged file
            raise InputError(f"resume: checkpoint {str(path)!r} is not usable: {error}") from error
        self.decisions, self.trips = int(counters[0]), int(counters[1])
        self.best, self.wall, self.loss = (float(x) for x in counters[2:])
