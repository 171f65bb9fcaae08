"""Progress with the time left, and remarks: on stderr, bars only on a terminal, none if quiet."""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Iterator
from contextvars import ContextVar
from typing import TYPE_CHECKING

from iits_mj.core.progress import Report, shown_on

if TYPE_CHECKING:
    from rich.progress import Progress

_quiet: ContextVar[bool] = ContextVar("quiet", default=False)
# The time left follows from the speed of the last minutes [s].
_WINDOW = 900.0
_REFRESHES = 4.0  # a second


@contextlib.contextmanager
def shown(*, quiet: bool) -> Iterator[None]:
    """Shows the progress of computations inside the block, if stderr is a terminal."""
    token = _quiet.set(quiet)
    terminal = sys.stderr.isatty() and os.environ.get("TERM") != "dumb"
    try:
        with shown_on(Bars() if terminal and not quiet else None):
            yield
    finally:
        _quiet.reset(token)


def remark(text: str) -> None:
    """Prints a remark that is neither a result nor an error."""
    if not _quiet.get():
        print(f"iits-mj: {text}", file=sys.stderr, flush=True)


class Bars:
    """A bar for each computation that runs; bars of finished ones vanish."""

    def __init__(self) -> None:
        self._bars: Progress | None = None
        self._open = 0

    @contextlib.contextmanager
    def task(self, what: str, total: float | None, unit: str) -> Iterator[Report]:
        """Shows a computation while the context is open."""
        if self._bars is None:
            self._bars = _make_bars()
        bars, self._open = self._bars, self._open + 1
        if self._open == 1:
            bars.start()
        number = bars.add_task(what, total=total, unit=unit, text="")

        def report(done: float, text: str = "", total: float | None = None) -> None:
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
    from rich.progress import BarColumn, Progress, ProgressColumn, Task, TextColumn
    from rich.text import Text

    class Times(ProgressColumn):
        """Time since the start, and the time left if it is known."""

        def render(self, task: Task) -> Text:
            left = task.time_remaining
            rest = "" if left is None else f", {clock(left)} left"
            return Text(f"{clock(task.elapsed or 0.0)}{rest}", "cyan")

    class Amount(ProgressColumn):
        """Finished amount and whole amount."""

        def render(self, task: Task) -> Text:
            if task.total is None:
                return Text(f"{task.completed:.0f} {task.fields['unit']}" * bool(task.completed))
            return Text(f"{task.completed:.0f}/{task.total:.0f} {task.fields['unit']}")

    return Progress(
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        Amount(),
        Times(),
        TextColumn("{task.fields[text]}", markup=False),
        console=Console(stderr=True),
        transient=True,
        refresh_per_second=_REFRESHES,
        speed_estimate_period=_WINDOW,
        # Results on a pipe must not go to the terminal of stderr.
        redirect_stdout=sys.stdout.isatty(),
    )


def clock(seconds: float) -> str:
    """Returns a duration as `12 s`, `3:05` or `1:03:05`."""
    minutes, second = divmod(round(seconds), 60)
    if not minutes:
        return f"{second} s"
    hour, minute = divmod(minutes, 60)
    return f"{hour}:{minute:02}:{second:02}" if hour else f"{minute}:{second:02}"
