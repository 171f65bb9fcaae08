"""Reports at the end of a test run how many tests were skipped because outside data is missing."""

from __future__ import annotations

from typing import Any

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
