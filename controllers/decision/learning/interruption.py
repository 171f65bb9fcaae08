"""Ctrl-C where it does no harm: only while waiting, never in the middle of a change of state."""

from __future__ import annotations

import signal
import threading
from concurrent.futures import Future
from types import FrameType
from typing import TypeVar

from iits_mj.closing import Closing

T = TypeVar("T")
_POLL = 0.2


class Interrupted(KeyboardInterrupt):
    """The first Ctrl-C, told at the next wait: the state is whole."""


class Interruption(Closing):
    """Takes Ctrl-C over until closed. A second one is told at once, as Python does.

    Python hands signals to the main thread only; in another one, nothing is taken over.
    """

    def __init__(self) -> None:
        self._asked = False
        self._main = threading.current_thread() is threading.main_thread()
        if self._main:
            self._before = signal.signal(signal.SIGINT, self._ask)

    def wait(self, outcome: Future[T]) -> T:
        """The outcome, or its error; `Interrupted` when Ctrl-C was pressed."""
        while True:
            if self._asked:
                raise Interrupted
            try:
                return outcome.result(timeout=_POLL)
            except TimeoutError:
                if outcome.done():
                    raise

    def close(self) -> None:
        """Gives Ctrl-C back."""
        if self._main:
            signal.signal(signal.SIGINT, self._before)

    def _ask(self, number: int, frame: FrameType | None) -> None:
        del number, frame
        if self._asked:
            raise KeyboardInterrupt
        self._asked = True
