from __future__ import annotations

import contextlib
import os
import pty
import re
import subprocess
import sys
from collections.abc import Iterator

import pytest

from iits_mj.commands import validate
from iits_mj.commands.progress import Estimate, clock, shown
from iits_mj.core import progress
from iits_mj.core.progress import Report
from iits_mj.validation import COMMANDS


def test_the_time_left_is_in_proportion_to_what_is_left_and_passes() -> None:
    estimate = Estimate(10.0)
    assert estimate.left(0.0) is None
    estimate.report(0.0, 100.0)
    assert estimate.left(101.0) is None
    estimate.report(4.0, 108.0)
    assert estimate.left(108.0) == 12.0
    assert estimate.left(110.0) == 10.0
    assert estimate.left(200.0) == 0.0


def test_work_done_before_the_start_does_not_count_as_fast() -> None:
    estimate = Estimate(None)
    estimate.report(90.0, 0.0)
    assert estimate.left(0.0) is None
    estimate.total = 100.0
    estimate.report(92.0, 20.0)
    assert estimate.left(20.0) == 80.0


def test_the_usual_time_counts_until_reports_show_a_pace_and_never_below_0() -> None:
    estimate = Estimate(10.0, end=130.0)
    assert estimate.left(100.0) == 30.0
    assert estimate.left(130.0) is None
    estimate.report(0.0, 100.0)
    assert estimate.left(110.0) == 20.0
    estimate.report(4.0, 108.0)
    assert estimate.left(108.0) == 12.0


@pytest.mark.parametrize(
    ("seconds", "text"),
    [(0.2, "0 s"), (59.4, "59 s"), (59.6, "1:00"), (185, "3:05"), (3785, "1:03:05")],
)
def test_durations_are_short(seconds: float, text: str) -> None:
    assert clock(seconds) == text


class Seen:
    """Display that keeps what it is shown."""

    def __init__(self) -> None:
        self.rows: list[tuple[object, ...]] = []

    @contextlib.contextmanager
    def task(
        self, what: str, total: float | None, unit: str, usual: float | None
    ) -> Iterator[Report]:
        del usual
        self.rows.append((what, total, unit))
        yield lambda done, text="", total=None: self.rows.append((done, text))
        self.rows.append((what, "ends"))


def test_each_item_reports_the_weight_of_those_before_it() -> None:
    seen = Seen()
    with progress.shown_on(seen):
        list(progress.each("abc", "letters", str.upper, {"a": 1.0, "b": 5.0, "c": 2.0}.__getitem__))
    assert seen.rows == [
        ("letters", 8.0, ""),
        (0.0, "A"),
        (1.0, "B"),
        (6.0, "C"),
        ("letters", "ends"),
    ]


def test_every_group_of_checks_has_its_share_of_the_time() -> None:
    assert set(validate.SECONDS) == set(COMMANDS) - {"truck"}


def test_without_a_display_nothing_is_shown(capsys: pytest.CaptureFixture[str]) -> None:
    with shown(quiet=False), progress.task("work", 3.0) as report:
        report(1.0)
        progress.remark("hello")
    with shown(quiet=True):
        progress.remark("unseen")
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err == "iits-mj: hello\n"


def on_terminal(text: str, **environment: str) -> str:
    """What Python code prints on a terminal; stdout is a pipe of its own, added at the end."""
    leader, follower = pty.openpty()
    code = f"import iits_mj.cli\n{text}"
    kept = {name: value for name, value in os.environ.items() if name != "NO_COLOR"}
    done = subprocess.Popen(
        [sys.executable, "-c", code],
        stdout=subprocess.PIPE,
        stderr=follower,
        env=kept | {"TERM": "xterm"} | environment,
    )
    os.close(follower)
    shown = b""
    with contextlib.suppress(OSError):  # the end of a terminal
        while part := os.read(leader, 4096):
            shown += part
    os.close(leader)
    assert done.stdout is not None
    printed = done.stdout.read()
    done.wait()
    return shown.decode() + printed.decode()


WORK = """
import sys, time
from iits_mj.commands import progress
from iits_mj.core.progress import task
with progress.shown(quiet=QUIET), task("working", 4.0, "parts") as report:
    for part in range(4):
        report(part, f"part {part}")
        time.sleep(0.3)
    print("result")
"""


def test_a_terminal_shows_a_bar_with_the_time_left_and_a_pipe_only_results() -> None:
    text = on_terminal(WORK.replace("QUIET", "False"))
    assert "working" in text
    assert "/4 parts" in text
    assert re.search(r"\d s, \d s left", text)
    assert text.endswith("result\n")
    assert on_terminal(WORK.replace("QUIET", "True")) == "result\n"
    assert on_terminal(WORK.replace("QUIET", "False"), TERM="dumb") == "result\n"


def test_errors_are_colored_on_a_terminal_unless_no_color_is_set() -> None:
    code = "iits_mj.cli.main(['fly'])"
    assert "\x1b[1;31miits-mj:\x1b[0m command 'fly' is not known" in on_terminal(code)
    assert "\x1b" not in on_terminal(code, NO_COLOR="1")
