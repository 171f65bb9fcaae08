"""Progress of long computations: any layer reports it, the command line shows it.

Without a display, as in a library or in a worker process, the reports cost nothing.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager
from contextvars import ContextVar
from typing import Protocol, TypeVar

Item = TypeVar("Item")


class Report(Protocol):
    """Receives the progress of one computation."""

    def __call__(self, done: float, text: str = "", total: float | None = None) -> None:
        """Reports the finished amount, what is being done, and the whole amount if it changed."""


class Display(Protocol):
    """Shows the progress of computations, which may contain others."""

    def task(self, what: str, total: float | None, unit: str) -> AbstractContextManager[Report]:
        """Shows a computation while the context is open."""


_display: ContextVar[Display | None] = ContextVar("display", default=None)


def _unseen(done: float, text: str = "", total: float | None = None) -> None:
    del done, text, total


@contextlib.contextmanager
def shown_on(display: Display | None) -> Iterator[None]:
    """Shows the progress of computations inside the block on a display."""
    token = _display.set(display)
    try:
        yield
    finally:
        _display.reset(token)


@contextlib.contextmanager
def task(what: str, total: float | None = None, unit: str = "") -> Iterator[Report]:
    """Reports a computation.

    Args:
      what: is being done, in a few words.
      total: whole amount of work; None when it is unknown.
      unit: of the amount.
    """
    display = _display.get()
    if display is None:
        yield _unseen
        return
    with display.task(what, total, unit) as report:
        yield report


def each(
    items: Iterable[Item], what: str, name: Callable[[Item], str] | None = None
) -> Iterator[Item]:
    """Yields items and reports how many are done, and the name of the next one."""
    listed = list(items)
    with task(what, len(listed)) as report:
        for number, item in enumerate(listed):
            report(number, "" if name is None else name(item))
            yield item
