"""Workers of a Ray cluster as a `concurrent.futures.Executor`, and training trips on them."""

from __future__ import annotations

import contextlib
import os
import socket
import threading
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import Executor, Future
from dataclasses import dataclass
from typing import Any

from controllers.decision import fast_world
from controllers.decision.learning import collection
from controllers.decision.learning.collection import Drive, Driven, TripDrivers, WorldFactory
from controllers.decision.policy import QNetwork
from controllers.decision.trip import World
from iits_mj.core.errors import Error, InputError
from iits_mj.core.process_pool import THREAD_VARIABLES
from iits_mj.validation.harness.run_cache import drive_digest

# Number of times that a task is repeated when its worker or node dies.
RETRIES = 10
# Tasks submitted to Ray per core, running and waiting.
_AHEAD = 3
_POLL_TIME = 0.2  # [s]
_CONNECT_TIMEOUT = 5.0  # [s]


class ClusterError(Error):
    """The cluster is not available, or a task failed on it permanently."""


class RayExecutor(Executor):
    """Runs tasks on all cores of a cluster, each on one core and one thread.

    A task whose worker process or node dies is repeated elsewhere. Functions and arguments are
    pickled. The package must be installed on every node in the same version; each worker checks the
    digest of its code.

    Args:
      address: "HOST:PORT" of the cluster's head, "auto" for the cluster of this machine, or "local"
        for a new cluster of this machine alone, which ends with the executor.
      digest: returns the digest of the code that runs the tasks; picklable.

    Raises:
      InputError: Ray is not installed. ClusterError: there is no cluster at the address.
    """

    def __init__(self, address: str, digest: Callable[[], str]) -> None:
        self._ray = _ray()
        _connect(self._ray, address)
        self._digest = digest
        self._expected = digest()
        self._remote = self._ray.remote(
            num_cpus=1,
            max_retries=RETRIES,
            runtime_env={"env_vars": dict.fromkeys(THREAD_VARIABLES, "1")},
        )(_call)
        self._waiting: deque[_Call] = deque()
        self._running: dict[Any, _Call] = {}
        self._lock = threading.Lock()
        self._news = threading.Event()
        self._ending = False
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    @property
    def cores(self) -> int:
        """Number of cores of the cluster at present."""
        return max(1, int(self._ray.cluster_resources().get("CPU", 1)))

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Schedules a call of a function; see `concurrent.futures.Executor.submit`."""
        task = _Call(fn, args, kwargs, Future())
        with self._lock:
            if self._ending:
                raise RuntimeError("cannot submit after shutdown")
            self._waiting.append(task)
        self._news.set()
        return task.future

    def share(self, value: Any) -> Any:
        """Puts a large value into the cluster's store once; pass the result to `submit`."""
        return self._ray.put(value)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Leaves the cluster after the tasks, or at once if they are cancelled."""
        with self._lock:
            if cancel_futures:
                for task in self._waiting:
                    task.future.cancel()
                self._waiting.clear()
                for reference in self._running:
                    with contextlib.suppress(Exception):
                        self._ray.cancel(reference, force=True)
            self._ending = True
        self._news.set()
        if wait or cancel_futures:
            self._thread.join()

    def _serve(self) -> None:
        """Submits tasks to the cluster and collects their results."""
        ray = self._ray
        while True:
            self._submit_waiting()
            with self._lock:
                if self._ending and not self._waiting and not self._running:
                    break
                references = list(self._running)
            if not references:
                self._news.wait(_POLL_TIME)
                self._news.clear()
                continue
            ready, _ = ray.wait(references, num_returns=1, timeout=_POLL_TIME)
            if ready and len(references) > 1:
                # Collect all finished tasks: a query for thousands costs as much as for one.
                ready, _ = ray.wait(references, num_returns=len(references), timeout=0)
            for reference in ready:
                with self._lock:
                    task = self._running.pop(reference)
                self._collect(reference, task)
        ray.shutdown()

    def _submit_waiting(self) -> None:
        with self._lock:
            while self._waiting and len(self._running) < _AHEAD * self.cores:
                task = self._waiting.popleft()
                if not task.future.set_running_or_notify_cancel():
                    continue
                reference = self._remote.remote(
                    task.function, self._digest, self._expected, *task.arguments, **task.named
                )
                self._running[reference] = task

    def _collect(self, reference: Any, task: _Call) -> None:
        try:
            answer = self._ray.get(reference)
        except Exception as error:
            # Ray puts the remote traceback before the error itself.
            reason = _lines(error)[-1]
            task.future.set_exception(ClusterError(f"the cluster gave up a task: {reason}"))
            return
        if isinstance(answer, _Refused):
            task.future.set_exception(Error(answer.reason))
        else:
            task.future.set_result(answer)


@dataclass(frozen=True)
class _Call:
    function: Callable[..., Any]
    arguments: tuple[Any, ...]
    named: dict[str, Any]
    future: Future[Any]


@dataclass(frozen=True)
class _Refused:
    """A worker's answer instead of a result."""

    reason: str


def _call(
    function: Callable[..., Any],
    digest: Callable[[], str],
    expected: str,
    *args: Any,
    **kwargs: Any,
) -> Any:
    """Runs a task in a worker; an `Error` is returned as its reason, without traceback."""
    here = digest()
    if here != expected:
        return _Refused(
            f"node {os.uname().nodename} has another version of the code ({here[:12]}) than the "
            f"head ({expected[:12]}): install the same package on all"
        )
    try:
        return function(*args, **kwargs)
    except Error as error:
        return _Refused(str(error))


def _ray() -> Any:
    # No usage statistics leave the machine.
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    try:
        import ray
    except ImportError as error:
        raise InputError("a cluster needs Ray: pip install 'iits-mj[scale]'") from error
    return ray


def _connect(ray: Any, address: str) -> None:
    if ray.is_initialized():
        raise ClusterError("this process already belongs to a Ray cluster")
    if address not in ("auto", "local"):
        _check_port(address)
    try:
        ray.init(
            address=address,
            log_to_driver=False,
            logging_level="ERROR",
            **({"include_dashboard": False} if address == "local" else {}),
        )
    except Exception as error:
        raise _no_cluster(address, _lines(error)[0]) from error


def _lines(error: Exception) -> list[str]:
    return str(error).strip().splitlines() or [type(error).__name__]


def _check_port(address: str) -> None:
    """Connects once, because Ray itself retries a closed port for a quarter of an hour."""
    host, _, port = address.rpartition(":")
    if not host or not port.isdecimal() or not 0 < int(port) < 65_536:
        raise _no_cluster(address, "not an address of this form")
    try:
        socket.create_connection((host, int(port)), _CONNECT_TIMEOUT).close()
    except OSError as error:
        raise _no_cluster(address, error.strerror or str(error)) from error


def _no_cluster(address: str, reason: str) -> ClusterError:
    return ClusterError(
        f"there is no Ray cluster at {address!r} ({reason}); use HOST:PORT of its head, auto, or "
        "local"
    )


class ClusterDrivers(TripDrivers):
    """Drives training trips on a Ray cluster, with the results of local processes.

    Args:
      address: of the cluster, see `RayExecutor`.
      worlds: picklable factories, chosen by `Drive.world`.

    Raises:
      InputError: Ray is not installed. ClusterError: there is no cluster at the address.
    """

    def __init__(self, address: str, worlds: Sequence[WorldFactory]) -> None:
        self._worlds = tuple(worlds)
        self._executor = RayExecutor(address, trips_code)

    def submit(self, jobs: Sequence[Drive], network: QNetwork) -> list[Future[Driven]]:
        """Submits trips with a network, which is sent to each node once."""
        shared = self._executor.share(network)
        return [
            self._executor.submit(drive_in_worker, self._worlds[job.world], job, shared)
            for job in jobs
        ]

    def close(self) -> None:
        """Leaves the cluster, also during a trip."""
        self._executor.shutdown(cancel_futures=True)


def trips_code() -> str:
    """Returns the digest of the code that drives training trips."""
    return drive_digest(collection, fast_world)


def drive_in_worker(factory: WorldFactory, job: Drive, network: QNetwork) -> Driven:
    """Drives a trip in a worker, which caches its worlds."""
    if factory not in _worlds:
        _worlds[factory] = factory()
    return collection.drive_trip(_worlds[factory], job, network)


_worlds: dict[Any, World] = {}
