"""`iits-mj evaluate --scenario hoel2020`: decision makers in a published truck scenario.

The stack's decision makers choose the lane. Their speed is that of the planner's car following
(`follow_acceleration`), rounded to the accelerations that the scenario allows. A change for which
the planner's gaps are not free is refused, as in a drive. A learned policy of the scenario chooses
both and nothing guards it.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from controllers.decision.base import DecisionContext, speed_max_of
from controllers.decision.observation import ObservationHistory, observe_frame
from controllers.decision.rules import imposed_braking
from controllers.planning.config import FollowingConfig
from controllers.planning.following import follow_acceleration
from controllers.protocols import DecisionMaker
from iits_mj.core.messages import Decision, Scene
from iits_mj.core.process_pool import run_all
from iits_mj.core.results import Findings, Results
from iits_mj.core.tables import write_rows
from iits_mj.road import Route
from iits_mj.validation.harness.statistics import estimate
from traffic_bridge.hoel2020 import ACTIONS, LANES, SPEED_MAX, STEP, STEPS, HoelHighway

_FOLLOWING = FollowingConfig()


class Driver(Protocol):
    """Chooses the actions of an episode."""

    def reset(self) -> None:
        """Begins an episode."""

    def act(self, world: HoelHighway) -> int:
        """Returns the action now."""


class StackDriver:
    """A decision maker of the stack with car following as an agent of the scenario."""

    def __init__(self, maker: DecisionMaker) -> None:
        self._maker = maker
        self._history = ObservationHistory()

    def reset(self) -> None:
        """Begins an episode."""
        self._maker.reset()
        self._history.reset()

    def act(self, world: HoelHighway) -> int:
        """Returns the action now."""
        scene, route, lane = world.scene(), world.route, world.lane
        self._history.add(scene.time, observe_frame(scene, route, SPEED_MAX))
        decision = Decision.KEEP
        if not world.changing:
            context = DecisionContext(
                scene=scene,
                route=route,
                lane=lane,
                lanes=tuple(range(LANES)),
                reference_speed=SPEED_MAX,
                observation=self._history.observation(),
            )
            decision = self._maker.decide(context)
            if decision is not Decision.KEEP and math.isinf(imposed_braking(context)[decision]):
                decision = Decision.KEEP
        side = -int(decision)
        station = scene.ego.station
        lanes = {lane, lane + side, route.lane_at(station, scene.ego.offset)}
        top = min(SPEED_MAX, speed_max_of(self._maker))
        wanted = min(_acceleration(scene, route, number, top) for number in lanes)
        allowed = [a for a, s in ACTIONS if s == side]
        return ACTIONS.index((min(allowed, key=lambda a: abs(a - wanted)), side))


def _acceleration(scene: Scene, route: Route, lane: int, top: float) -> float:
    """Acceleration of car following behind the leader of a lane, up to a speed [m/s2]."""
    speed = scene.ego.speed
    leader = scene.neighbors.leader_in_lane(route, lane)
    if leader is None:
        return follow_acceleration(speed, top, math.inf, speed, 0.0, _FOLLOWING)
    ahead = leader.gap, leader.speed, leader.acceleration
    return follow_acceleration(speed, top, *ahead, _FOLLOWING)


class PolicyDriver:
    """A policy of the scenario, from observations of shape (104,) to the number of an action."""

    def __init__(self, policy: Callable[[Any], Any]) -> None:
        self._policy = policy

    def reset(self) -> None:
        """Begins an episode."""

    def act(self, world: HoelHighway) -> int:
        """Returns the action now."""
        return int(self._policy(world.observation()))


@dataclass(frozen=True)
class Episode:
    """Figures of an episode.

    Attributes:
      method, seed: of the episode.
      total: sum of the rewards, at most 100.
      steps: until its end.
      speed: mean [m/s].
      changes, near_collisions, hard_brakings: numbers, see `HoelStep`.
      collided: the truck collided or left the road.
    """

    method: str
    seed: int
    total: float
    steps: int
    speed: float
    changes: int
    near_collisions: int
    hard_brakings: int
    collided: bool


@functools.cache
def _world() -> HoelHighway:
    """The world of this process."""
    return HoelHighway()


def drive(task: tuple[str, int], driver_of: Callable[[str], Driver]) -> Episode:
    """Drives the episode of a method and a seed."""
    method, seed = task
    world, driver = _world(), driver_of(method)
    world.reset(np.random.default_rng(seed))
    driver.reset()
    total = distance = 0.0
    changes = near = hard = 0
    collided = False
    while world.step_number < STEPS and not collided:
        step = world.step(driver.act(world))
        total, distance = total + step.reward, distance + float(world.speed[0]) * STEP
        changes, near = changes + step.lane_change, near + step.near_collision
        hard, collided = hard + step.hard_braking, step.terminated
    number = world.step_number
    speed = distance / (number * STEP)
    return Episode(method, seed, total, number, speed, changes, near, hard, collided)


def evaluate(
    methods: Sequence[str],
    driver_of: Callable[[str], Driver],
    seeds: Sequence[int],
    jobs: int = 1,
    progress: Callable[[int, int], None] | None = None,
) -> list[Episode]:
    """Drives all methods through the episodes of all seeds, the same traffic for each method.

    Args:
      methods: names.
      driver_of: returns the driver of a name; must be picklable.
      seeds: of the episodes.
      jobs: number of processes.
      progress: called with the numbers of finished episodes and of all.

    Raises:
      TasksError: some episodes failed.
    """
    tasks = [(method, seed) for seed in seeds for method in methods]
    found: dict[tuple[str, int], Episode] = {}

    def keep(episode: Episode) -> None:
        found[episode.method, episode.seed] = episode
        if progress is not None:
            progress(len(found), len(tasks))

    work = functools.partial(drive, driver_of=driver_of)
    run_all(tasks, jobs, work, keep, lambda task: f"{task[0]}, seed {task[1]}", what="episodes")
    return [found[task] for task in tasks]


_TITLE = "Hoel et al. 2020: 100 steps of 1 s, return at most 100; means of the episodes"
_HEADINGS = (
    *("method", "return (95 % interval)", "without collision", "mean speed [m/s]"),
    *("lane changes", "gaps below 2.5 m", "hard brakings"),
)


def summarize(episodes: Sequence[Episode]) -> Results:
    """Returns the table of the methods; return and steps without collision also as checks."""
    results = Results("evaluate --scenario hoel2020")
    findings = Findings()
    rows: list[Sequence[str]] = [_HEADINGS]
    for method in dict.fromkeys(episode.method for episode in episodes):
        own = [episode for episode in episodes if episode.method == method]
        mean = estimate([episode.total for episode in own])
        free = 100.0 * sum(not episode.collided for episode in own) / len(own)
        findings.check(f"{method}: return", mean.mean, "1")
        findings.check(f"{method}: episodes without collision", free, "%")
        averages = [
            float(np.mean([getattr(episode, name) for episode in own]))
            for name in ("speed", "changes", "near_collisions", "hard_brakings")
        ]
        interval = f" ({mean.low:.1f} to {mean.high:.1f})" if mean.count > 1 else ""
        rows.append(
            (
                method,
                f"{mean.mean:.1f}{interval}",
                f"{free:.1f} %",
                *(f"{value:.2f}" for value in averages),
            )
        )
    results.add("", findings)
    results.tables[_TITLE] = rows
    return results


def write(path: Path, episodes: Sequence[Episode]) -> None:
    """Writes the episodes as CSV.

    Raises:
      InputError: the file cannot be written.
    """
    write_rows(path, Episode, episodes, "episodes")
