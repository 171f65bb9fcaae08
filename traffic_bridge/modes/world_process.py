"""Runs one traffic simulation in its own process; the caller holds a `WorldProcess`."""

from __future__ import annotations

import contextlib
import inspect
import multiprocessing
import pickle
import shutil
import signal
import sys
import tempfile
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from multiprocessing.connection import Connection
from multiprocessing.reduction import ForkingPickler
from typing import TYPE_CHECKING, Any

from iits_mj.core.errors import Error, InputError, TrafficError
from iits_mj.core.output_files import TemporaryFolder

if TYPE_CHECKING:
    from traffic_bridge.modes.sumo_modes import PureSim

# Raised when a process cannot be started; AssertionError in a daemon, which may have no children.
_NOT_STARTED = (
    OSError,
    RuntimeError,
    AssertionError,
    pickle.PicklingError,
    AttributeError,
    TypeError,
)
END_TIME = 5.0  # [s] for a process to end on request
_TERMINATED = 128 + signal.SIGTERM  # exit code, as in shells


@dataclass(frozen=True)
class Failure:
    """An error in a world.

    Attributes:
      kind: class of the exception to raise.
      text: its message.
      trace: traceback in the process for errors of other classes; else empty.
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


def message_of(content: tuple[Any, ...], what: str) -> bytes:
    """A message to a world as bytes; InputError if its content cannot be pickled."""
    try:
        return bytes(ForkingPickler.dumps(content))
    except Exception as error:  # pickling runs code of the pickled objects
        raise InputError(f"{what} cannot be handed to another process: {error}") from error


class WorldProcess:
    """Handle of a process in which one traffic simulation runs.

    The process has its own folder for temporary files, also SUMO's. Both sides remove it, so that
    no file is left if one of them is killed.

    Args:
      make: makes the simulation in the process; must be picklable.

    Raises:
      TrafficError: the process cannot be started.
    """

    def __init__(self, make: Callable[[], PureSim]) -> None:
        # A forked process would inherit a loaded SUMO, and broken threads of MuJoCo and torch.
        context = multiprocessing.get_context("spawn")
        try:
            self._folder = TemporaryFolder("world")
        except OSError as error:
            raise TrafficError(f"the process of a world cannot be started: {error}") from error
        self._link, far = context.Pipe()
        self._process = context.Process(
            target=serve, args=(far, make, str(self._folder.path)), daemon=True
        )
        self._ended = ""
        self._working = False
        try:
            self._process.start()
        except _NOT_STARTED as error:
            self._link.close()
            self._folder.cleanup()
            raise TrafficError(f"the process of a world cannot be started: {error}") from error
        finally:
            far.close()
        self._working = True  # until its ready message

    @property
    def alive(self) -> bool:
        """Whether the process can answer."""
        return not self._ended and self._process.is_alive()

    @property
    def pid(self) -> int | None:
        """The process id, None if it has ended."""
        return None if self._ended else self._process.pid

    def send(self, message: bytes) -> None:
        """Sends a message of `message_of`; `receive` returns the answer.

        Raises:
          TrafficError: the previous answer was not received.
        """
        if self._working:
            raise TrafficError("a step is under way: receive_step() comes first")
        self._working = True
        # `receive` reports a process that has ended.
        with contextlib.suppress(OSError):
            if not self._ended:
                self._link.send_bytes(message)

    def receive(self, timeout: float) -> Any:
        """The answer or a `Failure`; ends a process that does not answer in time [s]."""
        if self._ended:
            self._working = False
            return Failure(TrafficError, self._ended)
        try:
            if self._link.poll(timeout):
                answer = self._link.recv_bytes()
                self._working = False
                return _read(answer, TrafficError, "its answer")
            self.end(f"gave no answer for {timeout:g} s and was ended; reset it to start it again")
        except (EOFError, OSError):
            self._process.join(1.0)
            self.end(
                f"its process ended unexpectedly ({self._cause()}); reset it to start it again"
            )
        return Failure(TrafficError, self._ended)

    def ask_to_end(self) -> None:
        """Asks the process to close SUMO and end; `end` waits for it."""
        with contextlib.suppress(OSError):
            if not self._ended:
                self._link.send_bytes(b"")

    def end(self, why: str = "was ended", patience: float = 0.0) -> None:
        """Ends the process, at once or after `patience` seconds to end by itself."""
        if self._ended:
            return
        self._ended = why
        self._working = False
        if patience > 0.0:
            self._process.join(patience)
        if self._process.is_alive():
            self._process.kill()
        self._process.join()
        self._link.close()
        self._process.close()
        self._folder.cleanup()

    def _cause(self) -> str:
        code = self._process.exitcode
        if code is None:
            return "it hangs"
        if code < 0:
            return f"killed by {signal.Signals(-code).name}"
        if code == _TERMINATED:
            return "ended by SIGTERM"
        return f"exit code {code}"


def serve(link: Connection, make: Callable[[], PureSim], folder: str) -> None:
    """Answers one message after the other in the process, until the end."""
    # Ctrl-C reaches the whole process group, but only the caller ends its worlds.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    # Python (for daemons) and `timeout` end a process by SIGTERM; SUMO is closed before.
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(_TERMINATED))
    tempfile.tempdir = folder
    traffic: PureSim | None = None

    def begin() -> None:
        nonlocal traffic
        traffic = make()

    try:
        # The link ends when the caller ends.
        with contextlib.suppress(EOFError, OSError):
            _answer(link, begin)
            while traffic is not None and (message := link.recv_bytes()):
                _answer(link, partial(_do, traffic, message))
    finally:
        if traffic is not None:
            traffic.close()
        _remove(folder)


def _answer(link: Connection, action: Callable[[], Any]) -> None:
    try:
        answer = action()
    except Error as error:
        answer = Failure(type(error), str(error))
    except Exception as error:
        answer = Failure(TrafficError, f"{type(error).__name__}: {error}", traceback.format_exc())
    try:
        given = bytes(ForkingPickler.dumps(answer))
    except Exception as error:
        refusal = Failure(TrafficError, f"the answer cannot be handed over: {error}")
        given = bytes(ForkingPickler.dumps(refusal))
    link.send_bytes(given)


def _read(message: bytes, kind: type[Error], what: str) -> Any:
    """The content of a message, or a `Failure` if this process cannot unpickle it."""
    try:
        return pickle.loads(message)
    except Exception as error:
        return Failure(kind, f"{what} cannot be read there: {type(error).__name__}: {error}")


def _remove(folder: str) -> None:
    shutil.rmtree(folder, ignore_errors=True)


def _do(traffic: PureSim, message: bytes) -> Any:
    content = _read(message, InputError, "the message")
    if isinstance(content, Failure):
        return content
    what, *arguments = content
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
    if not callable(value):
        return value
    try:
        inspect.signature(value).bind(*args, **options)
    except TypeError as error:
        raise InputError(f"{path!r} is called with wrong arguments: {error}") from error
    answer = value(*args, **options)
    # A function, such as one that undoes a change, stays in this process.
    return None if callable(answer) else answer
