"""One traffic simulation in a process of its own: the process's side and the caller's handle."""

from __future__ import annotations

import contextlib
import multiprocessing
import pickle
import signal
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from multiprocessing.connection import Connection
from typing import TYPE_CHECKING, Any

from iits_mj.errors import Error, InputError, TrafficError

if TYPE_CHECKING:
    from traffic_bridge.modes.sumo_modes import PureSim

# What starting a process may raise; an assertion in a daemon, which may have no children.
_NOT_STARTED = (
    OSError,
    RuntimeError,
    AssertionError,
    pickle.PicklingError,
    AttributeError,
    TypeError,
)
END_TIME = 5.0  # [s] for a process to end by itself


@dataclass(frozen=True)
class Failure:
    """What went wrong in a world.

    Attributes:
      kind: our exception that says it.
      text: its message.
      trace: where in the process it came up, for errors that are not ours; else empty.
    """

    kind: type[Error]
    text: str
    trace: str = ""

    def raised_by(self, number: int) -> Error:
        """The exception to raise, naming the world."""
        error = self.kind(f"world {number}: {self.text}")
        if self.trace:
            error.add_note(self.trace)
        return error


class WorldProcess:
    """Handle of a process in which one traffic simulation runs.

    Args:
      make: makes the simulation, in the process; must be picklable.

    Raises:
      TrafficError: the process cannot be started.
    """

    def __init__(self, make: Callable[[], PureSim]) -> None:
        # A forked process would inherit a loaded SUMO, and threads of MuJoCo and torch half-way.
        context = multiprocessing.get_context("spawn")
        self._link, far = context.Pipe()
        self._process = context.Process(target=serve, args=(far, make), daemon=True)
        self._ended = ""
        self._working = False
        try:
            self._process.start()
        except _NOT_STARTED as error:
            self._link.close()
            raise TrafficError(f"the process of a world cannot be started: {error}") from error
        finally:
            far.close()
        self._working = True  # it says when it is ready

    @property
    def alive(self) -> bool:
        """Whether it can be asked."""
        return not self._ended and self._process.is_alive()

    @property
    def pid(self) -> int | None:
        """The process's number, None when it has ended."""
        return None if self._ended else self._process.pid

    def send(self, message: tuple[Any, ...]) -> None:
        """Asks the world; `receive` gives the answer.

        Raises:
          TrafficError: an answer is still to be received.
        """
        if self._working:
            raise TrafficError("a step is under way: receive_step() comes first")
        self._working = True
        # Who has died is told by the answer.
        with contextlib.suppress(OSError):
            if not self._ended:
                self._link.send(message)

    def receive(self, timeout: float) -> Any:
        """The answer, or a `Failure`; a process that does not answer in time is ended [s]."""
        if self._ended:
            self._working = False
            return Failure(TrafficError, self._ended)
        try:
            if self._link.poll(timeout):
                answer = self._link.recv()
                self._working = False
                return answer
            self.end(f"gave no answer for {timeout:g} s and was ended; reset it to start it anew")
        except (EOFError, OSError, pickle.UnpicklingError):
            self._process.join(1.0)
            self.end(f"its process ended by itself ({self._cause()}); reset it to start it anew")
        self._working = False
        return Failure(TrafficError, self._ended)

    def ask_to_end(self) -> None:
        """Lets the process close SUMO and end; `end` waits for it."""
        with contextlib.suppress(OSError):
            if not self._ended:
                self._link.send(None)

    def end(self, why: str = "was ended", patience: float = 0.0) -> None:
        """Ends the process, at once or after some time to end by itself [s]."""
        if self._ended:
            return
        self._ended = why
        if patience > 0.0:
            self._process.join(patience)
        if self._process.is_alive():
            self._process.kill()
        self._process.join()
        self._link.close()
        self._process.close()

    def _cause(self) -> str:
        code = self._process.exitcode
        if code is None:
            return "it hangs"
        if code < 0:
            return f"killed by {signal.Signals(-code).name}"
        return f"exit code {code}"


def serve(link: Connection, make: Callable[[], PureSim]) -> None:
    """Runs in the process: answers one message after the other until told to end."""
    # Ctrl-C reaches the whole group; the caller decides what becomes of its worlds.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    traffic: PureSim | None = None

    def begin() -> None:
        nonlocal traffic
        traffic = make()

    try:
        _answer(link, begin)
        # The end of the link is the end of the caller.
        with contextlib.suppress(EOFError, OSError):
            while (message := link.recv()) is not None:
                assert traffic is not None
                _answer(link, partial(_do, traffic, *message))
    finally:
        if traffic is not None:
            traffic.close()


def _answer(link: Connection, action: Callable[[], Any]) -> None:
    try:
        answer = action()
    except Error as error:
        answer = Failure(type(error), str(error))
    except Exception as error:
        answer = Failure(TrafficError, f"{type(error).__name__}: {error}", traceback.format_exc())
    try:
        link.send(answer)
    except (pickle.PicklingError, TypeError, AttributeError) as error:
        link.send(Failure(TrafficError, f"the answer cannot be handed over: {error}"))


def _do(traffic: PureSim, what: str, *arguments: Any) -> Any:
    if what == "step":
        return traffic.step(*arguments)
    if what == "reset":
        ego, seed = arguments
        if seed is not None:
            traffic.seed = seed
        return traffic.reset(ego)
    path, args, options = arguments
    value: Any = traffic
    for name in path.split("."):
        if name.startswith("_") or not hasattr(value, name):
            raise InputError(f"{path!r}: a traffic simulation has no public {name!r} there")
        value = getattr(value, name)
    answer = value(*args, **options) if callable(value) else value
    # A function, such as one that takes a change back, belongs to the simulation of this process.
    return None if callable(answer) else answer
