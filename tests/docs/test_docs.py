"""What the README and the manual show must run, and what they link to must be there."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from iits_mj import cli
from tests.paths import ROOT

ROOT = ROOT
PAGES = [
    ROOT / "README.md",
    ROOT / "CONTRIBUTING.md",
    *sorted((ROOT / "docs").glob("*.md")),
    *sorted((ROOT / "docs" / "environments").glob("*.md")),
]


def blocks(page: Path, language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_lead_somewhere(page: Path) -> None:
    links = re.findall(r"\]\(([^)#]+)\)", page.read_text(encoding="utf-8"))
    missing = [link for link in links if "://" not in link and not (page.parent / link).exists()]
    assert missing == []


def test_readme_python_runs() -> None:
    examples = blocks(ROOT / "README.md", "python")
    assert len(examples) == 3
    for example in examples:
        exec(compile(example.replace("duration=60.0", "duration=1.0"), "README.md", "exec"), {})


def test_shown_command_lines_are_understood(capsys: pytest.CaptureFixture[str]) -> None:
    lines = [
        line
        for page in PAGES
        for block in blocks(page, "sh")
        for line in block.splitlines()
        if line.startswith("iits-mj ")
    ]
    assert len(lines) > 8
    for line in lines:
        words = line.split("#")[0].split()[1:]
        assert cli.understood(words), line


def test_the_learning_pages_python_runs() -> None:
    examples = blocks(ROOT / "docs" / "learning.md", "python")
    assert len(examples) == 6
    for example in examples:
        exec(compile(example, "learning.md", "exec"), {})
