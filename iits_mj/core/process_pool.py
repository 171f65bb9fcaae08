"""Runs tasks in several processes, keeps finished work after faults, and ends cleanly on Ctrl-C."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from types import FrameType
from typing import Any, TypeVar

from iits_mj.core.errors import Error

Task = TypeVar("Task")
Outcome = TypeVar("Outcome")
# Libraries of linear algebra read these variables when they are loaded.
THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
FAULTS_MAX = 5
DEATHS_MAX = 3
_LEAVE_TIME = 5.0  # [s] for a worker to close SUMO
_INTERRUPTED = 130  # exit code
_ENDINGS = (signal.SIGINT, signal.SIGTERM)


class TasksError(Error):
    """Some tasks failed; the results of all others were kept."""


@contextmanager
def single_threaded_workers() -> Iterator[None]:
    """Processes started inside the block use one thread each.

    Parallel processes then share the cores, and sums keep their order. The environment is restored
    at the end of the block.
    """
    before = {name: os.environ.get(name) for name in THREAD_VARIABLES}
    os.environ.update(dict.fromkeys(THREAD_VARIABLES, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def run_all(
    tasks: Sequence[Task],
    jobs: int,
    work: Callable[[Task], Outcome],
    keep: Callable[[Outcome], None],
    describe: Callable[[Task], str],
    *,
    what: str = "tasks",
    make_pool: Callable[[int], Executor] | None = None,
) -> None:
    """Runs tasks in their order and passes each outcome to `keep` as soon as it is available.

    A task that raises an `Error` is skipped and the others continue. A worker that dies ends the
    other running tasks, too; they are run again.

    Args:
      tasks: without duplicates.
      jobs: number of processes; each runs one task at a time.
      work: runs one task in a worker.
      keep: called in this process, in the order in which the tasks end.
      describe: a task in a few words, for messages.
      what: what the tasks are, for messages.
      make_pool: makes a pool of that many workers; default: `worker_pool`.

    Raises:
      TasksError: at the end when some tasks failed, or early when many fail.
    """
    missing = dict.fromkeys(tasks)
    faults: list[str] = []
    deaths = 0
    while missing:
        try:
            with _running(make_pool or worker_pool, min(jobs, len(missing))) as pool:
                with _interrupts_held():
                    futures: dict[Future[Outcome], Task] = {
                        pool.submit(_guarded, work, task): task for task in missing
                    }
                for future in as_completed(futures):
                    task = futures[future]
                    try:
                        outcome = future.result()
                    except Error as error:
                        faults.append(f"{describe(task)}: {error}")
                        if len(faults) >= FAULTS_MAX:
                            raise TasksError(_failed_text(faults, what)) from error
                    else:
                        keep(outcome)
                    del missing[task]
        except BrokenProcessPool as error:
            deaths += 1
            if deaths >= DEATHS_MAX:
                raise TasksError(
                    f"worker processes died {deaths} times, the last time in "
                    f"{describe(next(iter(missing)))} or one of the next {what} (out of memory?); "
                    "finished ones are kept, run the same command again for the rest"
                ) from error
    if faults:
        raise TasksError(_failed_text(faults, what))


def worker_pool(jobs: int) -> ProcessPoolExecutor:
    """A pool of new processes, because SUMO allows one instance in each; they end with this one."""
    context = multiprocessing.get_context("spawn")
    return ProcessPoolExecutor(jobs, mp_context=context, initializer=_begin_worker)


class SharedPool(Executor):
    """A pool that several calls of `run_all` share, as their `make_pool`; a context manager.

    Args:
      make: makes the pool of that many workers; see `run_all`.
    """

    def __init__(self, make: Callable[[int], Executor]) -> None:
        self._make, self._jobs = make, 1
        self._pool: Executor | None = None

    def __call__(self, jobs: int) -> SharedPool:
        """Returns itself; the workers start with the first task."""
        self._jobs = max(jobs, self._jobs)
        return self

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Schedules a call of a function."""
        if self._pool is None:
            self._pool = self._make(self._jobs)
        return self._pool.submit(fn, *args, **kwargs)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Ends the workers after a failure; otherwise they wait for the next call."""
        if cancel_futures and self._pool is not None:
            self._pool.shutdown(wait, cancel_futures=True)
            self._pool = None

    def __exit__(self, *error: object) -> None:
        self.shutdown(cancel_futures=True)


def _failed_text(faults: list[str], what: str) -> str:
    return (
        f"{len(faults)} {what} could not be done: {'; '.join(faults)}; the finished ones are kept, "
        "run the same command again for the rest"
    )


@contextmanager
def _running(make_pool: Callable[[int], Executor], jobs: int) -> Iterator[Executor]:
    """A pool whose processes end before the block is left, also by an exception."""
    before = set(multiprocessing.active_children())
    with single_threaded_workers():
        pool = make_pool(jobs)
        try:
            yield pool
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            _end(set(multiprocessing.active_children()) - before)
            raise
        pool.shutdown()


@contextmanager
def _interrupts_held() -> Iterator[None]:
    """Blocks Ctrl-C and SIGTERM; processes started meanwhile do so until `_begin_worker`."""
    signal.pthread_sigmask(signal.SIG_BLOCK, _ENDINGS)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_UNBLOCK, _ENDINGS)


def _end(workers: set[multiprocessing.process.BaseProcess]) -> None:
    """Interrupts workers; kills those that do not end in time."""
    for worker in workers:
        if worker.pid is not None and worker.is_alive():
            # The process may have ended since `is_alive`.
            with suppress(ProcessLookupError):
                os.kill(worker.pid, signal.SIGINT)
    for worker in workers:
        worker.join(_LEAVE_TIME)
        if worker.is_alive():
            worker.kill()


def _guarded(work: Callable[[Any], Outcome], task: Any) -> Outcome:
    """Runs a task; an interrupt ends the process after SUMO is closed."""
    _Worker.busy = True
    try:
        return work(task)
    except KeyboardInterrupt:
        os._exit(_INTERRUPTED)
    finally:
        _Worker.busy = False


class _Worker:
    """State of a worker process."""

    busy = False


def _begin_worker() -> None:
    """Makes the process end without a message when it is interrupted or its parent has ended."""
    for kind in _ENDINGS:
        signal.signal(kind, _leave)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, _ENDINGS)
    threading.Thread(target=_leave_with_parent, daemon=True).start()


def _leave(number: int, frame: FrameType | None) -> None:
    del number, frame
    if not _Worker.busy:
        os._exit(_INTERRUPTED)
    for kind in _ENDINGS:
        signal.signal(kind, signal.SIG_IGN)
    raise KeyboardInterrupt


def _leave_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(_LEAVE_TIME)
        os._exit(_INTERRUPTED)
