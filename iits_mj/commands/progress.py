"""Bars for the progress of computations, with the time left, on a terminal."""

from __future__ import annotations

import contextlib
import os
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from typing import TYPE_CHECKING

from iits_mj.core.progress import Report, shown_on

if TYPE_CHECKING:
    from rich.progress import Progress, ProgressColumn, Task

_REFRESHES = 4.0  # a second


def shown(*, quiet: bool) -> AbstractContextManager[None]:
    """Shows the progress of computations inside the block, if stderr is a terminal."""
    terminal = sys.stderr.isatty() and os.environ.get("TERM") != "dumb"
    return shown_on(Bars() if terminal and not quiet else None, quiet=quiet)


class Estimate:
    """Estimates the time left from the reports of a computation.

    Its first report may count work that was done before. Before reports show a pace, the usual time
    counts.

    Args:
      total: whole amount, or None.
      end: usual end of the computation [s], or None.

    Attributes:
      total: whole amount, or None.
    """

    def __init__(self, total: float | None, end: float | None = None) -> None:
        self.total = total
        self._end = end
        self._first: tuple[float, float] | None = None
        self._last = (0.0, 0.0)

    def report(self, done: float, now: float) -> None:
        """Takes the finished amount at a time [s]."""
        self._last = (done, now)
        self._first = self._first or self._last

    def left(self, now: float) -> float | None:
        """Returns the time left [s]; None when it is unknown."""
        if self.total is None or self._first is None or self._last[0] <= self._first[0]:
            # A computation that takes longer than usual has an unknown end.
            return None if self._end is None or self._end <= now else self._end - now
        done, time = self._last
        pace = (time - self._first[1]) / (done - self._first[0])
        return max(0.0, pace * (self.total - done) - (now - time))


class Bars:
    """A bar for each computation that runs; bars of finished ones vanish."""

    def __init__(self) -> None:
        self._bars: Progress | None = None
        self._open = 0

    @contextlib.contextmanager
    def task(
        self, what: str, total: float | None, unit: str, usual: float | None
    ) -> Iterator[Report]:
        """Shows a computation while the context is open."""
        if self._bars is None:
            self._bars = _make_bars()
        end = None if usual is None else time.monotonic() + usual
        bars, estimate = self._bars, Estimate(total, end)
        if not self._open:
            bars.start()
        self._open += 1
        number = bars.add_task(what, total=total, unit=unit, text="", estimate=estimate)

        def report(done: float, text: str = "", total: float | None = None) -> None:
            estimate.total = estimate.total if total is None else total
            estimate.report(done, time.monotonic())
            bars.update(number, completed=done, text=text, total=total)

        try:
            yield report
        finally:
            bars.remove_task(number)
            self._open -= 1
            if not self._open:
                bars.stop()


def _make_bars() -> Progress:
    # Only on a terminal.
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn

    return Progress(
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        _text_column(_amount),
        _text_column(_times),
        TextColumn("{task.fields[text]}", markup=False),
        console=Console(stderr=True),
        transient=True,
        refresh_per_second=_REFRESHES,
        # Results on a pipe must not go to the terminal of stderr.
        redirect_stdout=sys.stdout.isatty(),
    )


def _text_column(text: Callable[[Task], str]) -> ProgressColumn:
    from rich.progress import ProgressColumn
    from rich.text import Text

    class Column(ProgressColumn):
        def render(self, task: Task) -> Text:
            return Text(text(task), "cyan")

    return Column()


def _amount(task: Task) -> str:
    """Finished amount and whole amount, or the share in percent."""
    unit = task.fields["unit"]
    if task.total is None:
        return f"{task.completed:.0f} {unit}" if unit else ""
    if unit:
        return f"{task.completed:.0f}/{task.total:.0f} {unit}"
    return f"{task.percentage:.0f} %"


def _times(task: Task) -> str:
    """Time since the start, and the time left if it is known."""
    left = task.fields["estimate"].left(time.monotonic())
    passed = clock(task.elapsed or 0.0)
    return passed if left is None else f"{passed}, {clock(left)} left"


def clock(seconds: float) -> str:
    """Returns a duration as `12 s`, `3:05` or `1:03:05`."""
    minutes, second = divmod(round(seconds), 60)
    if not minutes:
        return f"{second} s"
    hour, minute = divmod(minutes, 60)
    return f"{hour}:{minute:02}:{second:02}" if hour else f"{minute}:{second:02}"
