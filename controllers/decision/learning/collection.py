"""Trips driven by worker processes; the results do not depend on the number of processes.

Each worker is a new interpreter on one thread, without torch. It makes each world at the first trip
in that world. One thread of this process serves each worker, so that a free worker gets the next
trip while the learner learns. When this process ends, for whatever reason, the pipes close and the
workers end as well.
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
from types import FrameType
from typing import Any, TypeVar

import numpy as np

from controllers.decision.learning.replay import Batch, Transition
from controllers.decision.policy import ACTIONS, QNetwork
from controllers.decision.rules import Mobil
from controllers.decision.trip import TripConfig, TripSummary, World
from iits_mj.core.context import Closing
from iits_mj.core.errors import Error
from iits_mj.core.process_pool import single_threaded_workers

WorldFactory = Callable[[], World]
T = TypeVar("T")
_POLL = 0.2


@dataclass(frozen=True)
class Drive:
    """One trip to drive.

    Attributes:
      name: for messages; world: index of the factory.
      trip: its settings; generator: source of all its randomness.
      epsilon: share of random decisions; guided: share of those that MOBIL makes instead.
      learns: whether its transitions are returned.
    """

    name: str
    world: int
    trip: TripConfig
    generator: np.random.Generator
    epsilon: float = 0.0
    guided: float = 0.0
    learns: bool = False


@dataclass(frozen=True)
class Driven:
    """Result of a trip: summary and transitions, None for a drive without them."""

    summary: TripSummary
    transitions: Batch | None


def drive_trip(world: World, job: Drive, network: QNetwork) -> Driven:
    """Drives one trip, epsilon-greedy on a network.

    Most random lane changes are useless, so MOBIL makes a share of the random decisions.
    """
    exploration = job.generator.spawn(1)[0]
    guide = Mobil()
    observation = world.reset(job.generator, job.trip)
    transitions: list[Transition] = []
    over = False
    while not over:
        action = ACTIONS.index(network.greedy(observation))
        if exploration.random() < job.epsilon:
            action = int(exploration.integers(len(ACTIONS)))
            if exploration.random() < job.guided:
                action = ACTIONS.index(guide.decide(world.context()))
        step = world.step(ACTIONS[action])
        over = step.terminated or step.truncated
        if job.learns:
            # After a truncation the next value still counts.
            future = 0.0 if step.terminated else job.trip.reward.discount**step.seconds
            reward = step.reward.total
            symmetric = job.trip.symmetric
            transitions.append(
                Transition(observation, action, reward, future, step.observation, symmetric)
            )
        observation = step.observation
    return Driven(world.summary, Batch.of(transitions) if job.learns else None)


class Interrupted(KeyboardInterrupt):
    """Raised after the first Ctrl-C at the next wait, where the state is consistent."""


class Interruption(Closing):
    """Defers Ctrl-C to the next wait until closed; the second Ctrl-C takes effect at once.

    It has no effect outside the main thread, which alone receives signals.
    """

    def __init__(self) -> None:
        self._asked = False
        self._main = threading.current_thread() is threading.main_thread()
        if self._main:
            self._before = signal.signal(signal.SIGINT, self._ask)

    def wait(self, outcome: Future[T]) -> T:
        """Returns the outcome or raises its error; raises `Interrupted` after Ctrl-C."""
        while True:
            if self._asked:
                raise Interrupted
            try:
                return outcome.result(timeout=_POLL)
            except TimeoutError:
                if outcome.done():
                    raise

    def close(self) -> None:
        """Restores the previous handler of Ctrl-C."""
        if self._main:
            signal.signal(signal.SIGINT, self._before)

    def _ask(self, number: int, frame: FrameType | None) -> None:
        del number, frame
        if self._asked:
            raise KeyboardInterrupt
        self._asked = True


class TripDrivers(Closing, abc.ABC):
    """Drives trips for a training, in processes of this machine or of others."""

    @abc.abstractmethod
    def submit(self, jobs: Sequence[Drive], network: QNetwork) -> list[Future[Driven]]:
        """Starts trips on a network; the future of a trip that fails raises an `Error`."""


_Task = tuple[Drive, QNetwork, Future[Driven]]
# Makes drivers for the worlds of some factories; `Drive.world` is an index into them.
MakeDrivers = Callable[[Sequence[WorldFactory]], TripDrivers]


class Workers(TripDrivers):
    """Processes of this machine that drive trips.

    Args:
      jobs: number of processes.
      worlds: picklable factories; `Drive.world` is an index into them.
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
        """Starts trips on a network; the future of a trip that fails raises an `Error`."""
        outcomes: list[Future[Driven]] = [Future() for _ in jobs]
        for job, outcome in zip(jobs, outcomes, strict=True):
            self._queue.put((job, network, outcome))
        return outcomes

    def close(self) -> None:
        """Ends the processes, even in the middle of a trip."""
        for process in self._processes:
            process.terminate()
        for _ in self._threads:
            self._queue.put(None)
        for process in self._processes:
            process.join()
        for thread in self._threads:
            thread.join()

    def _serve(self, pipe: Connection, process: Any) -> None:
        """Passes tasks to one worker, one at a time."""
        sent: QNetwork | None = None
        while (task := self._queue.get()) is not None:
            job, network, outcome = task
            try:
                pipe.send((job, None if network is sent else network))
                sent = network
                answer = pipe.recv()
            except (EOFError, OSError):
                process.join()
                answer = f"its process ended with exit code {process.exitcode}"
            if isinstance(answer, Driven):
                outcome.set_result(answer)
            else:
                outcome.set_exception(Error(f"{job.name}: {answer}"))
        pipe.close()


def _work(pipe: Connection, factories: tuple[WorldFactory, ...]) -> None:
    """Runs a worker: answers each trip with a `Driven`, or with the reason of its failure."""
    worlds: dict[int, World] = {}
    network: Any = None
    with contextlib.suppress(EOFError, OSError):  # until the other end closes
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
    """Starts workers with one thread each that ignore Ctrl-C, which this process handles."""
    main = threading.current_thread() is threading.main_thread()
    handler = signal.signal(signal.SIGINT, signal.SIG_IGN) if main else None
    try:
        with single_threaded_workers():
            yield
    finally:
        if main:
            signal.signal(signal.SIGINT, handler)
