"""Training of the decision maker: worker processes drive, this process learns, with checkpoints.

A round is a fixed number of whole trips on one state of the network. While this process learns from
round r, the workers drive round r + 1 on the network of before, so the result depends neither on
the number nor on the speed of the workers: one seed gives bit-identical results. A checkpoint
stores the settings of the current round, which is driven again after an interruption.

A training has one stage or two: `fast_decisions` in the fast world, then the rest in another one.
The second stage continues with the weights of the first; memory, exploration and best score start
again. Every `evaluate_interval` decisions the greedy policy drives validation trips, whose seeds
neither training nor the final evaluation uses. Every validated policy is stored, and the best one
as the result.

torch is imported when a training starts, not with this module.
"""

from __future__ import annotations

import functools
import json
import math
import time
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from controllers.decision.fast_world.env import HighwayEnv
from controllers.decision.learning import checkpoint
from controllers.decision.learning.collection import (
    Drive,
    Driven,
    Interrupted,
    Interruption,
    MakeDrivers,
    Workers,
    WorldFactory,
)
from controllers.decision.learning.config import TrainConfig
from controllers.decision.learning.log import LOG, Means, TrainLog, trip_figures
from controllers.decision.learning.replay import ReplayMemory, mirror_half
from controllers.decision.learning.trips import sample_trip, training_generator, validate
from controllers.decision.policy import OBSERVATION_SIZE, QNetwork
from controllers.decision.trip import TRAINING_SEEDS
from iits_mj.core.errors import InputError

__all__ = ["TrainConfig", "TrainSummary", "train"]

BEST, POLICIES = "ddqn.npz", "policies"
FAST, FULL = 0, 1
# Attributes of the training that a checkpoint keeps.
_COUNTERS = ("decisions", "trips", "stage", "stage_began", "evaluated", "best", "wall", "debt")


@dataclass(frozen=True)
class TrainSummary:
    """Result of a training.

    Attributes:
      weights: file of the best policy, None when every validation had a collision.
      score: its validation score, -inf without one; log: the table.
      decisions: of the whole training; wall_time: of the whole training [s].
    """

    weights: Path | None
    log: Path
    score: float
    decisions: int
    wall_time: float


def train(
    config: TrainConfig,
    out: str | Path,
    progress: Callable[[int, int], None] | None = None,
    command: str = "",
    world: WorldFactory | None = None,
    note: Callable[[str], None] | None = None,
    drivers: MakeDrivers | None = None,
) -> TrainSummary:
    """Trains; writes `ddqn.npz`, `policies/`, `training.csv` and `checkpoint.pt` to `out`.

    Args:
      config: settings.
      out: folder, created if missing.
      progress: called with (decisions done, decisions in all).
      command: the command line, for the weights' metadata.
      world: picklable factory of the second stage's world; None for the fast world.
      note: called with messages for the user.
      drivers: makes the drivers of the trips; default: `config.jobs` processes of this machine.

    Raises:
      InputError: torch is missing, the folder is not usable, or the checkpoint does not fit.
      Error: a trip failed, its worker died, or the training diverged.
      KeyboardInterrupt: after Ctrl-C; a checkpoint is written first.
    """
    try:
        import torch
    except ImportError as error:
        raise InputError("training needs torch: pip install 'iits-mj[train]'") from error
    torch.set_num_threads(1)
    if world is not None and config.fast_decisions >= config.decisions:
        raise InputError(
            f"fast-decisions {config.fast_decisions} is not allowed; use less than decisions "
            f"({config.decisions}), or train in the fast world alone"
        )
    training = Training(config, Path(out), command, world, note, drivers)
    training.run(progress)
    weights = Path(out) / BEST if math.isfinite(training.best) else None
    return TrainSummary(weights, Path(out) / LOG, training.best, training.decisions, training.wall)


@dataclass(frozen=True)
class Round:
    """Settings of a round.

    Attributes:
      index: number of the round; stage: `FAST` or `FULL`.
      epsilon: share of random decisions; network: makes the other decisions.
    """

    index: int
    stage: int
    epsilon: float
    network: QNetwork


class Training:
    """State of a training: learner, memory, counters and the current round."""

    def __init__(
        self,
        config: TrainConfig,
        out: Path,
        command: str,
        world: WorldFactory | None,
        note: Callable[[str], None] | None,
        drivers: MakeDrivers | None = None,
    ) -> None:
        from controllers.decision.learning.ddqn import DoubleDqn

        self._make_drivers = drivers or functools.partial(Workers, config.jobs)
        self.config, self.out, self.command, self.world = config, out, command, world
        self.learner = DoubleDqn(config, config.seed)
        self.random = np.random.default_rng([config.seed, TRAINING_SEEDS])
        self.memory = self._new_memory()
        self.decisions = self.trips = self.stage_began = 0
        self.evaluated = self.saved = 0
        self.saved_at = time.monotonic()
        self.best, self.wall, self.debt = -math.inf, 0.0, 0.0
        self.stage = FULL if world is not None and config.fast_decisions == 0 else FAST
        self.flight = Round(0, self.stage, config.epsilon_start, self.learner.network())
        self.means, self.round = Means(), Means()
        rows: list[str] = []
        try:
            (out / POLICIES).mkdir(parents=True, exist_ok=True)
            if config.resume:
                rows = self.restore()
            elif (out / checkpoint.CHECKPOINT).exists():
                raise InputError(
                    f"folder {str(out)!r} contains a checkpoint; continue it with --resume, "
                    "or use another folder"
                )
            self.log = TrainLog(out, rows, self.decisions, note)
        except OSError as error:
            raise InputError(f"folder {str(out)!r} cannot be used: {error}") from error

    @property
    def finished(self) -> bool:
        """Whether all decisions are made."""
        return self.decisions >= self.config.decisions

    def run(self, progress: Callable[[int, int], None] | None) -> None:
        """Runs rounds until all decisions are made; the state is consistent between two rounds."""
        config = self.config
        start = time.monotonic() - self.wall
        worlds = (HighwayEnv, self.world or HighwayEnv)
        with Interruption() as self.interruption, self._make_drivers(worlds) as self.workers:
            try:
                under_way = [] if self.finished else self._send(self.flight)
                while True:
                    self.wall = time.monotonic() - start
                    if progress is not None:
                        progress(min(self.decisions, config.decisions), config.decisions)
                    if self._validation_due():
                        self._validate()
                    if self.flight.stage != self.stage:
                        self._switch()
                    if self._checkpoint_due():
                        self.save()
                    if self.finished:
                        break
                    began = time.monotonic()
                    driven = [self.interruption.wait(outcome) for outcome in under_way]
                    self.trips += len(driven)
                    self.decisions += sum(trip.summary.decisions for trip in driven)
                    following = self._next_round()
                    under_way = [] if self.finished else self._send(following)
                    self._learn(driven)
                    self.flight = following
                    self._log_round(driven, time.monotonic() - began)
            except Interrupted:
                self.save()
                raise
            finally:
                self.log.close()

    def _send(self, flight: Round) -> list[Future[Driven]]:
        """Starts the trips of a round; returns their outcomes."""
        config, drives = self.config, []
        for trip in range(config.trips_per_round):
            generator = training_generator(config, flight.index, trip)
            sampled = sample_trip(config, generator)
            name = f"training trip {trip} of round {flight.index}"
            shares = flight.epsilon, config.guided_share
            drives.append(Drive(name, flight.stage, sampled, generator, *shares, learns=True))
        return self.workers.submit(drives, flight.network)

    def _next_round(self) -> Round:
        """Returns the next round, driven while this process learns from the previous one."""
        config = self.config
        full = self.world is not None and self.decisions >= config.fast_decisions
        stage = FULL if full else FAST
        done = self.decisions - self.stage_began if stage == self.stage else 0
        second = stage == FULL and config.fast_decisions > 0
        start = config.epsilon_stage if second else config.epsilon_start
        share = min(1.0, done / config.epsilon_decisions)
        epsilon = start + (config.epsilon_end - start) * share
        return Round(self.flight.index + 1, stage, epsilon, self.learner.network())

    def _learn(self, driven: list[Driven]) -> None:
        """Stores the trips' transitions, then takes the gradient steps that are due."""
        config, decisions = self.config, 0
        for trip in driven:
            assert trip.transitions is not None
            self.memory.add(trip.transitions)
            decisions += len(trip.transitions)
        if len(self.memory) >= config.warm_up:
            self.debt += config.updates_per_decision * decisions
        rates = config.learning_rate, config.learning_rate_end
        self.learner.set_rate(self._between(*rates, config.learning_rate_decisions))
        while self.debt >= 1.0:
            self.debt -= 1.0
            batch = self.memory.sample(config.batch_size, self.random)
            if config.mirror:
                batch = mirror_half(batch, self.random)
            update = self.learner.update(batch)
            value, error = (x / config.reward_scale for x in (update.value, update.error))
            self.round.add({"loss": update.loss, "mean_q": value, "td_error": error})

    def _log_round(self, driven: list[Driven], seconds: float) -> None:
        """Logs figures of a round and adds them to the means of the table's next row."""
        summaries = [trip.summary for trip in driven]
        self.round.add(trip_figures(summaries), weight=len(driven))
        rate = sum(summary.decisions for summary in summaries) / seconds
        self.round.add({"decisions_per_s": rate}, weight=seconds)
        self.means.join(self.round)
        self.log.scalars("training", self.decisions, {**self._progress(), **self.round.take()})

    def _between(self, start: float, end: float, over: int) -> float:
        """Returns a value that changes linearly from start to end over some decisions."""
        return start + (end - start) * min(1.0, self.decisions / over)

    def _progress(self) -> dict[str, float]:
        return {
            "epsilon": self.flight.epsilon,
            "replay_size": len(self.memory),
            "updates": self.learner.updates,
            "trips": self.trips,
        }

    def _switch(self) -> None:
        """Starts the second stage with an empty memory, because the world is another one."""
        self.stage, self.stage_began = self.flight.stage, self.decisions
        self.memory, self.debt, self.best = self._new_memory(), 0.0, -math.inf

    def _new_memory(self) -> ReplayMemory:
        return ReplayMemory(self.config.replay_capacity, OBSERVATION_SIZE)

    def _validation_due(self) -> bool:
        since = self.decisions - self.evaluated
        stops = self.finished or self.flight.stage != self.stage
        return since >= self.config.evaluate_interval or (stops and since > 0)

    def _validate(self) -> None:
        """Validates the greedy policy on the six cells and writes it, also as the best if so."""
        network = self.learner.policy()
        result = validate(network, self.config, self.workers, self.stage, self.interruption)
        self.evaluated = self.decisions
        training = {**self._progress(), **self.means.take()}
        self.log.row(self.decisions, self.wall, training, result)
        self.log.scalars("validation", self.decisions, result)
        origin = self._origin(result)
        network.save(self.out / POLICIES / f"ddqn_{self.decisions:07d}.npz", **origin)
        if result["score_per_s"] > self.best and result["collisions"] == 0.0:
            self.best = result["score_per_s"]
            network.save(self.out / BEST, **origin)

    def _origin(self, result: dict[str, float]) -> dict[str, Any]:
        """Returns the metadata of a weights file."""
        return {
            "command": self.command,
            "world": self._worlds()[self.stage],
            "config": self.config.identity(),
            "decisions": self.decisions,
            "validation": result,
        }

    def _worlds(self) -> list[str]:
        """Returns the names of both stages' worlds."""
        fast = "fast world (controllers.decision.fast_world)"
        if self.world is None:
            return [fast, fast]
        return [fast, getattr(self.world, "__qualname__", type(self.world).__qualname__)]

    def _settings(self) -> dict[str, Any]:
        """Returns the settings that a resumed training must share with its checkpoint."""
        return {**self.config.identity(), "world": self._worlds()[FULL]}

    def _checkpoint_due(self) -> bool:
        since = self.decisions - self.saved
        late = time.monotonic() - self.saved_at >= self.config.checkpoint_seconds
        return since > 0 and (self.finished or late or since >= self.config.checkpoint_interval)

    def save(self) -> None:
        """Writes a checkpoint."""
        flight = self.flight
        network = [flight.network.weights, flight.network.biases]
        state = {
            "settings": self._settings(),
            "learner": self.learner.state(),
            "replay": self.memory.state(),
            "generator": json.dumps(self.random.bit_generator.state),
            "flight": [flight.index, flight.stage, flight.epsilon, *network],
            "counters": {name: getattr(self, name) for name in _COUNTERS},
            "means": self.means.sums,
            "rows": self.log.rows,
        }
        checkpoint.write(self.out, state)
        self.saved, self.saved_at = self.decisions, time.monotonic()

    def restore(self) -> list[str]:
        """Restores the checkpoint; returns the rows of its table.

        Raises:
          InputError: there is none, or it is not of such a training.
        """
        state = checkpoint.read(self.out)
        try:
            checkpoint.check_settings(state["settings"], self._settings())
            return self._take(state)
        except InputError:
            raise
        except Exception as error:  # torch and numpy raise many kinds
            path = str(self.out / checkpoint.CHECKPOINT)
            reason = f"{type(error).__name__}: {error}"
            raise InputError(f"resume: checkpoint {path!r} is not usable: {reason}") from error

    def _take(self, state: dict[str, Any]) -> list[str]:
        for name in _COUNTERS:
            setattr(self, name, type(getattr(self, name))(state["counters"][name]))
        self.saved = self.decisions
        self.learner.restore(state["learner"])
        self.memory.restore(state["replay"])
        self.random.bit_generator.state = json.loads(state["generator"])
        index, stage, epsilon, weights, biases = state["flight"]
        margin = self.learner.network().margin
        network = QNetwork(tuple(weights), tuple(biases), margin=margin)
        self.flight = Round(index, stage, epsilon, network)
        self.means = Means(state["means"])
        return [str(row) for row in state["rows"]]
