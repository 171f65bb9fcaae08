"""Trains the decision maker: worker processes drive, this one learns, with checkpoints.

A round is a fixed number of whole trips on one state of the network. While this process learns from
round r, the workers drive round r + 1 on the network as it was before that, so the outcome depends
neither on their number nor on who is faster: one seed gives bit-identical results. What is in
flight is stored as the settings it was begun with, and driven again after an interruption.

A training has one stage or two: `fast_decisions` in the fast world, then the rest in another one.
Weights are kept at the switch; the memory, exploration and the best score begin anew. Every
`evaluate_interval` decisions the greedy policy drives validation trips, whose seeds neither
training nor the final evaluation uses. Its policy is kept, and the best one so far apart from it.
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
    MakeDrivers,
    Workers,
    WorldFactory,
)
from controllers.decision.learning.config import TrainConfig, settings
from controllers.decision.learning.ddqn import DoubleDqn
from controllers.decision.learning.log import (
    Interrupted,
    Interruption,
    Means,
    TrainLog,
    trip_figures,
)
from controllers.decision.learning.replay import Replay, mirror_half
from controllers.decision.learning.trips import sample_trip, training_generator, validate
from controllers.decision.policy import OBSERVATION_SIZE, QNetwork
from controllers.decision.trip import TRAINING_SEEDS
from iits_mj.core.errors import InputError

BEST, POLICIES = "ddqn.npz", "policies"
FAST, FULL = 0, 1
# What a checkpoint keeps of the loop's attributes.
_COUNTERS = ("decisions", "trips", "stage", "stage_began", "evaluated", "best", "wall", "debt")


@dataclass(frozen=True)
class Round:
    """What a round is driven with.

    Attributes:
      index: counts rounds; stage: `FAST` or `FULL`.
      epsilon: share of random decisions; network: that the others come from.
    """

    index: int
    stage: int
    epsilon: float
    network: QNetwork


class Training:
    """The loop's state: learner, memory, counters, and the round in flight."""

    def __init__(
        self,
        config: TrainConfig,
        out: Path,
        command: str,
        world: WorldFactory | None,
        note: Callable[[str], None] | None,
        drivers: MakeDrivers | None = None,
    ) -> None:
        self._make_drivers = drivers or functools.partial(Workers, config.jobs)
        self.config, self.out, self.command, self.world = config, out, command, world
        self.learner = DoubleDqn(config, config.seed)
        self.random = np.random.default_rng([config.seed, TRAINING_SEEDS])
        self.replay = self._memory()
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
                rows = self._restore()
            elif (out / checkpoint.CHECKPOINT).exists():
                raise InputError(
                    f"folder {str(out)!r} holds a checkpoint; continue it with --resume, "
                    "or begin in another folder"
                )
            self.log = TrainLog(out, rows, self.decisions, note)
        except OSError as error:
            raise InputError(f"folder {str(out)!r} cannot be used: {error}") from error

    @property
    def finished(self) -> bool:
        """True when all decisions are made."""
        return self.decisions >= self.config.decisions

    def run(self, progress: Callable[[int, int], None] | None) -> None:
        """Rounds until all decisions are made. Between two rounds the state is whole."""
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
                        self._save()
                    if self.finished:
                        break
                    began = time.monotonic()
                    driven = self._gather(under_way)
                    self._count(driven)
                    following = self._next_round()
                    under_way = [] if self.finished else self._send(following)
                    self._learn(driven)
                    self.flight = following
                    self._tell(driven, time.monotonic() - began)
            except Interrupted:
                self._save()
                raise
            finally:
                self.log.close()

    def _send(self, flight: Round) -> list[Future[Driven]]:
        """Has a round driven."""
        drives = []
        for trip in range(self.config.trips_per_round):
            generator = training_generator(self.config, flight.index, trip)
            sampled = sample_trip(self.config, generator)
            name = f"training trip {trip} of round {flight.index}"
            drives.append(
                Drive(
                    name,
                    flight.stage,
                    sampled,
                    generator,
                    epsilon=flight.epsilon,
                    guided=self.config.guided_share,
                    steps=self.config.steps,
                )
            )
        return self.workers.submit(drives, flight.network)

    def _gather(self, under_way: list[Future[Driven]]) -> list[Driven]:
        """The trips in their order, whoever was faster."""
        return [self.interruption.wait(outcome) for outcome in under_way]

    def _count(self, driven: list[Driven]) -> None:
        self.trips += len(driven)
        self.decisions += sum(trip.summary.decisions for trip in driven)

    def _next_round(self) -> Round:
        """Driven while this process learns from the round before it."""
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
        """Stores the trips' transitions, then takes as many gradient steps as they are worth."""
        config, decisions = self.config, 0
        for trip in driven:
            assert trip.transitions is not None
            self.replay.add(trip.transitions)
            decisions += len(trip.transitions)
        if len(self.replay) >= config.warm_up:
            self.debt += config.updates_per_decision * decisions
        beta = self._between(config.importance_exponent, 1.0, config.importance_decisions)
        rates = config.learning_rate, config.learning_rate_end
        self.learner.set_rate(self._between(*rates, config.learning_rate_decisions))
        while self.debt >= 1.0:
            self.debt -= 1.0
            draw = self.replay.sample(config.batch_size, self.random, beta)
            batch = mirror_half(draw.batch, self.random) if config.mirror else draw.batch
            update = self.learner.update(batch, draw.weight)
            self.replay.renew(draw.indices, update.error)
            unscaled = 1.0 / config.reward_scale
            error = float(update.error.mean()) * unscaled
            self.round.add(
                {"loss": update.loss, "mean_q": update.value * unscaled, "td_error": error}
            )

    def _tell(self, driven: list[Driven], seconds: float) -> None:
        """Figures of a round for the event files, and into the means of the table's next row."""
        summaries = [trip.summary for trip in driven]
        self.round.add(trip_figures(summaries), weight=len(driven))
        rate = sum(summary.decisions for summary in summaries) / seconds
        self.round.add({"decisions_per_s": rate}, weight=seconds)
        self.means.join(self.round)
        self.log.scalars("training", self.decisions, {**self._progress(), **self.round.take()})

    def _between(self, start: float, end: float, over: int) -> float:
        """From start to end, linearly over a number of decisions."""
        return start + (end - start) * min(1.0, self.decisions / over)

    def _progress(self) -> dict[str, float]:
        return {
            "epsilon": self.flight.epsilon,
            "replay_size": len(self.replay),
            "updates": self.learner.updates,
            "trips": self.trips,
        }

    def _switch(self) -> None:
        """From the fast world to the other one: its transitions are not those of this one."""
        self.stage, self.stage_began = self.flight.stage, self.decisions
        self.replay, self.debt, self.best = self._memory(), 0.0, -math.inf

    def _memory(self) -> Replay:
        config = self.config
        exponent = config.priority_exponent if config.prioritized else None
        return Replay(config.replay_capacity, OBSERVATION_SIZE, exponent)

    def _validation_due(self) -> bool:
        since = self.decisions - self.evaluated
        stops = self.finished or self.flight.stage != self.stage
        return since >= self.config.evaluate_interval or (stops and since > 0)

    def _validate(self) -> None:
        """Drives the greedy policy over the six cells; keeps it, and apart when it is the best."""
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
        """What a weights file tells of itself."""
        return {
            "command": self.command,
            "world": self._worlds()[self.stage],
            "config": settings(self.config),
            "decisions": self.decisions,
            "validation": result,
        }

    def _worlds(self) -> list[str]:
        """Names of the worlds of both stages."""
        fast = "fast world (controllers.decision.fast_world)"
        if self.world is None:
            return [fast, fast]
        return [fast, getattr(self.world, "__qualname__", type(self.world).__qualname__)]

    def _settings(self) -> dict[str, Any]:
        """What a continued training must have in common with the one before."""
        return {**settings(self.config), "world": self._worlds()[FULL]}

    def _checkpoint_due(self) -> bool:
        since = self.decisions - self.saved
        late = time.monotonic() - self.saved_at >= self.config.checkpoint_seconds
        return since > 0 and (self.finished or late or since >= self.config.checkpoint_interval)

    def _save(self) -> None:
        """Writes all that the rounds to come depend on."""
        flight = self.flight
        network = [flight.network.weights, flight.network.biases]
        state = {
            "settings": self._settings(),
            "learner": self.learner.state(),
            "replay": self.replay.state(),
            "generator": json.dumps(self.random.bit_generator.state),
            "flight": [flight.index, flight.stage, flight.epsilon, *network],
            "counters": {name: getattr(self, name) for name in _COUNTERS},
            "means": self.means.sums,
            "rows": self.log.rows,
        }
        checkpoint.write(self.out, state)
        self.saved, self.saved_at = self.decisions, time.monotonic()

    def _restore(self) -> list[str]:
        """Takes up the checkpoint; returns the rows of its table."""
        state = checkpoint.read(self.out)
        checkpoint.check_settings(state["settings"], self._settings())
        for name in _COUNTERS:
            setattr(self, name, state["counters"][name])
        self.saved = self.decisions
        self.learner.restore(state["learner"])
        self.replay.restore(state["replay"])
        self.random.bit_generator.state = json.loads(state["generator"])
        index, stage, epsilon, weights, biases = state["flight"]
        margin = self.learner.network().margin
        network = QNetwork(tuple(weights), tuple(biases), margin=margin)
        self.flight = Round(index, stage, epsilon, network)
        self.means = Means(state["means"])
        return list(state["rows"])
