"""Trips driven by worker processes; what they bring home does not depend on how many there are.

Each worker is a fresh interpreter on one thread, without torch. It makes a world at the first trip
in it and keeps it. One thread of this process waits for each worker, so that a worker which has
brought home a trip gets the next one while the learner learns. When this process is gone, however
it ended, the workers meet the closed pipe and end too.
"""

from __future__ import annotations

import abc
import contextlib
import multiprocessing
import queue
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

from controllers.decision.learning.replay import Batch, Returns, Transition
from controllers.decision.policy import ACTIONS, QNetwork
from controllers.decision.rules import Mobil
from controllers.decision.trip import TripConfig, TripSummary, World
from iits_mj.core.context import Closing
from iits_mj.core.errors import Error
from iits_mj.core.process_pool import single_threaded_workers

WorldFactory = Callable[[], World]


@dataclass(frozen=True)
class Drive:
    """One trip to be driven.

    Attributes:
      name: for messages; world: index of the factory.
      trip: what is driven; generator: of everything random in it.
      epsilon: share of random decisions; guided: share of those that MOBIL makes instead.
      steps: n of the n-step transitions that are wanted, 0 for none.
    """

    name: str
    world: int
    trip: TripConfig
    generator: np.random.Generator
    epsilon: float = 0.0
    guided: float = 0.0
    steps: int = 0


@dataclass(frozen=True)
class Driven:
    """What a trip came to; its transitions, None where none were wanted."""

    summary: TripSummary
    transitions: Batch | None


def drive_trip(world: World, job: Drive, network: QNetwork) -> Driven:
    """Drives one trip, epsilon-greedy on a network.

    Most random changes are senseless, and how a sensible one pays off is what is to be learned:
    some of the exploration is left to a rule.
    """
    exploration = job.generator.spawn(1)[0]
    guide = Mobil()
    observation = world.reset(job.generator, job.trip)
    returns = Returns(max(1, job.steps))
    transitions: list[Transition] = []
    over = False
    while not over:
        action = greedy = ACTIONS.index(network.greedy(observation))
        if exploration.random() < job.epsilon:
            action = int(exploration.integers(len(ACTIONS)))
            if exploration.random() < job.guided:
                action = ACTIONS.index(guide.decide(world.context()))
        if action != greedy:
            transitions += returns.cut()
        step = world.step(ACTIONS[action])
        over = step.terminated or step.truncated
        if job.steps:
            # Truncation is not termination: the value of what follows still counts.
            future = 0.0 if step.terminated else job.trip.reward.discount**step.seconds
            reward = step.reward.total
            symmetric = not job.trip.keeps_right
            single = Transition(observation, action, reward, future, step.observation, symmetric)
            transitions += returns.add(single, over)
        observation = step.observation
    return Driven(world.summary, Batch.of(transitions) if job.steps else None)


class TripDrivers(Closing, abc.ABC):
    """Who drive trips for a training: processes of this machine, or of others."""

    @abc.abstractmethod
    def submit(self, jobs: Sequence[Drive], network: QNetwork) -> list[Future[Driven]]:
        """Asks for trips on a network; a trip that fails makes its future raise an `Error`."""


# Makes drivers for worlds, by their factories; `Drive.world` chooses among them.
MakeDrivers = Callable[[Sequence[WorldFactory]], TripDrivers]


class Workers(TripDrivers):
    """Processes of this machine that drive trips.

    Args:
      jobs: how many.
      worlds: picklable factories, chosen by `Drive.world`.
    """

    def __init__(self, jobs: int, worlds: Sequence[WorldFactory]) -> None:
        self._queue: queue.SimpleQueue[_Task | None] = queue.SimpleQueue()
        context = multiprocessing.get_context("spawn")
        self._processes = []
        self._threads = []
        with _inherited_by_workers():
            for _ in range(jobs):
                ours, theirs = context.Pipe()
                process = context.Process(target=_work, args=(theirs, tuple(worlds)), daemon=True)
                process.start()
                theirs.close()
                thread = threading.Thread(target=self._serve, args=(ours, process), daemon=True)
                thread.start()
                self._processes.append(process)
                self._threads.append(thread)

    def submit(self, jobs: Sequence[Drive], network: QNetwork) -> list[Future[Driven]]:
        """Asks for trips on a network; a trip that fails makes its future raise an `Error`."""
        tasks = [_Task(job, network, Future()) for job in jobs]
        for task in tasks:
            self._queue.put(task)
        return [task.outcome for task in tasks]

    def close(self) -> None:
        """Ends the processes, also in the middle of a trip."""
        for process in self._processes:
            process.terminate()
        for _ in self._threads:
            self._queue.put(None)
        for process in self._processes:
            process.join()
        for thread in self._threads:
            thread.join()

    def _serve(self, pipe: Connection, process: Any) -> None:
        """Hands tasks to one worker, one after the other."""
        sent: QNetwork | None = None
        while (task := self._queue.get()) is not None:
            try:
                pipe.send((task.job, None if task.network is sent else task.network))
                sent = task.network
                answer = pipe.recv()
            except (EOFError, OSError):
                process.join()
                answer = f"its process ended with exit code {process.exitcode}"
            if isinstance(answer, Driven):
                task.outcome.set_result(answer)
            else:
                task.outcome.set_exception(Error(f"{task.job.name}: {answer}"))
        pipe.close()


@dataclass(frozen=True)
class _Task:
    job: Drive
    network: QNetwork
    outcome: Future[Driven]


def _work(pipe: Connection, factories: tuple[WorldFactory, ...]) -> None:
    """A worker's life: answers each trip with a `Driven`, or with the reason of a failure."""
    worlds: dict[int, World] = {}
    network: Any = None
    with contextlib.suppress(EOFError, OSError):  # the other end is gone: nobody to drive for
        while True:
            job, news = pipe.recv()
            network = network if news is None else news
            answer: Driven | str
            try:
                if job.world not in worlds:
                    worlds[job.world] = factories[job.world]()
                answer = drive_trip(worlds[job.world], job, network)
            except Exception as error:
                answer = f"{type(error).__name__}: {error}"
            pipe.send(answer)


@contextlib.contextmanager
def _inherited_by_workers() -> Iterator[None]:
    """One thread for each worker, and Ctrl-C is for this process alone."""
    main = threading.current_thread() is threading.main_thread()
    handler = signal.signal(signal.SIGINT, signal.SIG_IGN) if main else None
    try:
        with single_threaded_workers():
            yield
    finally:
        if main:
            signal.signal(signal.SIGINT, handler)
