"""Runs tasks in several processes; what is done is kept whatever happens then."""

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

# --- Processes side by side with one thread each: they share the cores, and sums keep their order

# What the libraries of linear algebra read when they are loaded.
VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


@contextmanager
def one_thread_each() -> Iterator[None]:
    """Processes that are started inside have one thread; the environment is put back after it."""
    before = {name: os.environ.get(name) for name in VARIABLES}
    os.environ.update(dict.fromkeys(VARIABLES, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


# --- Runs tasks in several processes; what is done is kept whatever happens then ---

Task = TypeVar("Task")
Outcome = TypeVar("Outcome")
FAULTS_MAX = 5
DEATHS_MAX = 3
_LEAVE_TIME = 5.0  # that a worker has for closing SUMO [s]
_INTERRUPTED = 130  # exit code


class TasksError(Error):
    """Some tasks could not be done; all others were."""


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
    """Does tasks, the first ones first, and gives every outcome to `keep` when it is there.

    A task that cannot be done is left out and the others go on; a worker that dies takes the
    others' tasks with it, which are done again.

    Args:
      tasks: what to do, all different.
      jobs: processes at a time, each one task at a time.
      work: does one; goes to the processes.
      keep: called in this process, in the order in which tasks end.
      describe: a task in a few words, for messages.
      what: the tasks are, for messages.
      make_pool: of that many workers; default: processes of their own.

    Raises:
      TasksError: at the end, when some could not be done, or sooner when many cannot.
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
                            raise TasksError(_told(faults, what)) from error
                    else:
                        keep(outcome)
                    del missing[task]
        except BrokenProcessPool as error:
            deaths += 1
            if deaths >= DEATHS_MAX:
                raise TasksError(
                    f"processes that do {what} died {deaths} times, the last time while "
                    f"{describe(next(iter(missing)))} or one of the next was done (out of "
                    "memory?); what was done is kept, the same command does the rest"
                ) from error
    if faults:
        raise TasksError(_told(faults, what))


def worker_pool(jobs: int) -> ProcessPoolExecutor:
    """Processes of their own, as SUMO is one to a process; they end with this one."""
    context = multiprocessing.get_context("spawn")
    return ProcessPoolExecutor(jobs, mp_context=context, initializer=_begin_worker)


def _told(faults: list[str], what: str) -> str:
    return (
        f"{len(faults)} {what} could not be done: {'; '.join(faults)}; what was done is kept, "
        "the same command does the rest"
    )


@contextmanager
def _running(make_pool: Callable[[int], Executor], jobs: int) -> Iterator[Executor]:
    """A pool whose processes are gone when the block is left, however it is left."""
    before = set(multiprocessing.active_children())
    with one_thread_each():
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
    """Holds Ctrl-C back; processes that are started meanwhile do so until `_begin_worker`."""
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})


def _end(workers: set[multiprocessing.process.BaseProcess]) -> None:
    for worker in workers:
        if worker.pid is not None and worker.is_alive():
            # It may have ended, and been waited for by the pool, since it was asked.
            with suppress(ProcessLookupError):
                os.kill(worker.pid, signal.SIGINT)
    for worker in workers:
        worker.join(_LEAVE_TIME)
        if worker.is_alive():
            worker.kill()


def _guarded(work: Callable[[Any], Outcome], task: Any) -> Outcome:
    """Does a task; ends the process when it was interrupted, after SUMO has been closed."""
    _Worker.busy = True
    try:
        return work(task)
    except KeyboardInterrupt:
        os._exit(_INTERRUPTED)
    finally:
        _Worker.busy = False


class _Worker:
    """What a process of the pool knows of itself."""

    busy = False


def _begin_worker() -> None:
    """Ends the process quietly when it is interrupted, or when its parent is gone."""
    signal.signal(signal.SIGINT, _leave)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
    threading.Thread(target=_leave_with_parent, daemon=True).start()


def _leave(number: int, frame: FrameType | None) -> None:
    del frame
    if not _Worker.busy:
        os._exit(_INTERRUPTED)
    signal.signal(number, signal.SIG_IGN)
    raise KeyboardInterrupt


def _leave_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(_LEAVE_TIME)
        os._exit(_INTERRUPTED)
