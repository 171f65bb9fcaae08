"""Progress of long computations, and remarks: any layer reports them, the command line shows them.

Without a display, as in a library or in a worker process, the reports cost nothing.
"""

from __future__ import annotations

import contextlib
import sys
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

    def task(
        self, what: str, total: float | None, unit: str, usual: float | None
    ) -> AbstractContextManager[Report]:
        """Shows a computation while the context is open."""


_display: ContextVar[Display | None] = ContextVar("display", default=None)
_quiet: ContextVar[bool] = ContextVar("quiet", default=False)


def _unseen(done: float, text: str = "", total: float | None = None) -> None:
    del done, text, total


@contextlib.contextmanager
def shown_on(display: Display | None, *, quiet: bool = False) -> Iterator[None]:
    """Shows the progress of computations inside the block on a display; `quiet`: no remarks."""
    tokens = _display.set(display), _quiet.set(quiet)
    try:
        yield
    finally:
        _display.reset(tokens[0])
        _quiet.reset(tokens[1])


def remark(text: str) -> None:
    """Prints a remark on stderr that is neither a result nor an error."""
    if not _quiet.get():
        print(f"iits-mj: {text}", file=sys.stderr, flush=True)


@contextlib.contextmanager
def task(
    what: str, total: float | None = None, unit: str = "", usual: float | None = None
) -> Iterator[Report]:
    """Reports a computation.

    Args:
      what: is being done, in a few words.
      total: whole amount of work; None when it is unknown.
      unit: of the amount.
      usual: time that it takes [s], for work that reports no amounts; None when it is unknown.
    """
    display = _display.get()
    if display is None:
        yield _unseen
        return
    with display.task(what, total, unit, usual) as report:
        yield report


def each(
    items: Iterable[Item],
    what: str,
    name: Callable[[Item], str] | None = None,
    weight: Callable[[Item], float] = lambda _: 1.0,
) -> Iterator[Item]:
    """Yields items and reports how much is done.

    Args:
      items: that the caller works on.
      what: is being done, in a few words.
      name: of an item, to show.
      weight: of an item: in proportion to the time that it takes.
    """
    listed, done = list(items), 0.0
    with task(what, sum(map(weight, listed))) as report:
        for item in listed:
            report(done, "" if name is None else name(item))
            yield item
            done += weight(item)
