"""A full disk, and a report of the tests that were skipped because outside data is missing."""

from __future__ import annotations

import contextlib
import resource
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from tests.paths import DATA, MISSING


def pytest_terminal_summary(terminalreporter: Any) -> None:
    """One line with the number of these tests, the missing files and where to get them."""
    reasons = [
        report.longrepr[2].removeprefix("Skipped: ")
        for report in terminalreporter.stats.get("skipped", [])
        if isinstance(report.longrepr, tuple) and MISSING in report.longrepr[2]
    ]
    if reasons:
        names = sorted({reason.split(": ", 1)[1] for reason in reasons})
        terminalreporter.write_line(
            f"{len(reasons)} tests were skipped because outside data is missing in {DATA} "
            f"({', '.join(names)}): tests/README.md says where to get it"
        )


@contextlib.contextmanager
def _size_limit(size: int) -> Iterator[None]:
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.fixture
def full_disk() -> Callable[[int], contextlib.AbstractContextManager[None]]:
    """Makes every write beyond a size [bytes] of a file fail, as on a full disk."""
    return _size_limit
