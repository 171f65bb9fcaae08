"""Blocks of code in the pages of the manual: they run, or are at least what they claim to be.

Blocks of a page run in their order, in one namespace and one empty folder:

- `python` runs. A page whose blocks stand each for itself is in `ALONE`.
- `sh` with `<!-- run -->` above it runs, through the command line's own parser and dispatcher;
  `<!-- run slow -->` runs among the slow tests. In other `sh` and `console` blocks the parser must
  accept the commands of the package, and the files, make targets and extras of others must exist.
- `py` (incomplete or long) compiles; `toml`, `json` and `xml` parse.
"""

from __future__ import annotations

import contextlib
import json
import re
import shlex
import tomllib
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib
import pytest

from iits_mj import cli
from tests.paths import ROOT

matplotlib.use("Agg")
PAGES = {
    str(page.relative_to(ROOT)): page
    for folder in ("docs", "mjcf", "iits_mj", "controllers", "traffic_bridge")
    for page in (ROOT / folder).rglob("*.md")
} | {name: ROOT / name for name in ("README.md", "CONTRIBUTING.md")}
# Pages with python blocks that take minutes or need the results of another command, and why.
SLOW = {
    "docs/identification.md": "fits a drive of two minutes",
    "docs/python.md": "drives a minute, with a video",
    "docs/tutorials/rl.md": "trains an agent",
}
# Pages that tests of their own run.
OTHERS = ("docs/tutorials/own_truck.md", "docs/learning.md", "README.md")
BLOCK = re.compile(r"(?:<!-- (run|run slow) -->\n)?^```(\w+)\n(.*?)^```", re.M | re.S)
TARGETS = re.findall(r"^([\w-]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.M)
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]


class Block(NamedTuple):
    """A block of a page: what is above it, its language and its text."""

    mark: str
    language: str
    text: str


def blocks(page: Path) -> list[Block]:
    return [Block(*match) for match in BLOCK.findall(page.read_text(encoding="utf-8"))]


def commands(block: Block) -> Iterator[list[str]]:
    """Yields the commands of a shell block as words, without comments and continued over lines."""
    for line in block.text.replace("\\\n", " ").splitlines():
        line = line.removeprefix("$ ")
        with contextlib.suppress(ValueError):  # a quotation that goes on in the next line
            if words := shlex.split(line, comments=True):
                yield words


def with_language(*languages: str) -> list[str]:
    return [
        name for name, page in PAGES.items() if any(b.language in languages for b in blocks(page))
    ]


def runnable(mark: str) -> list[str]:
    """Returns the pages with something to run: python, or commands with the mark."""
    names = []
    for name, page in PAGES.items():
        python = any(block.language == "python" for block in blocks(page))
        slow = name in SLOW or any(block.mark == "run slow" for block in blocks(page))
        quick = (python or any(block.mark == "run" for block in blocks(page))) and not slow
        if name not in OTHERS and (slow if mark == "slow" else quick):
            names.append(name)
    return names


def run_page(name: str, folder: Path) -> None:
    names: dict[str, Any] = {"__name__": name}
    for block in blocks(PAGES[name]):
        if block.language == "python":
            exec(compile(block.text, name, "exec"), names)
        elif block.language in ("sh", "console") and block.mark:
            for words in commands(block):
                assert words[0] == "iits-mj", f"only commands of the package run: {words}"
                assert cli.main(words[1:]) == 0, " ".join(words)
        elif block.language in ("toml", "csv") and (file := file_named(PAGES[name], block)):
            (folder / file).write_text(block.text, encoding="utf-8")


def in_folder(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Enters an empty folder from which the repository's files have their usual paths."""
    for name in ("controllers", "examples", "iits_mj", "mjcf", "traffic_bridge"):
        (folder / name).symlink_to(ROOT / name)
    monkeypatch.chdir(folder)


def file_named(page: Path, block: Block) -> str | None:
    """Returns the file that a block shows: `a.toml` in the line above it, or # a.toml on top."""
    if first := re.match(r"# ([\w-]+\.\w+)\n", block.text):
        return first[1]
    before = page.read_text(encoding="utf-8").partition(block.text)[0]
    lines = before.rstrip().splitlines()[:-1]
    named = re.search(r"`([\w.-]+)`:$", "\n".join(lines).rstrip())
    return named[1] if named else None


@pytest.mark.parametrize("name", runnable("quick"))
def test_the_blocks_of_the_page_run(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    in_folder(tmp_path, monkeypatch)
    run_page(name, tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("name", runnable("slow"))
def test_the_long_blocks_of_the_page_run(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    in_folder(tmp_path, monkeypatch)
    run_page(name, tmp_path)


@pytest.mark.parametrize("name", with_language("py", "toml", "json", "xml"))
def test_blocks_that_do_not_run_are_well_formed(name: str) -> None:
    for block in blocks(PAGES[name]):
        if block.language == "py":
            compile(block.text, name, "exec")
        elif block.language == "toml":
            tomllib.loads(block.text)
        elif block.language == "json":
            json.loads(block.text)
        elif block.language == "xml":
            ElementTree.fromstring(f"<all>{block.text}</all>")


@pytest.mark.parametrize("name", with_language("sh", "console"))
def test_the_commands_of_the_page_exist(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    in_folder(tmp_path, monkeypatch)
    for block in blocks(PAGES[name]):
        if block.language == "toml" and (file := file_named(PAGES[name], block)):
            (tmp_path / file).write_text(block.text, encoding="utf-8")
        if block.language not in ("sh", "console") or name == "docs/tutorials/own_truck.md":
            continue
        for words in commands(block):
            if words[0] == "iits-mj":
                assert cli.understood(words[1:]), words
            elif words[0] == "make":
                assert all(word in TARGETS for word in words[1:] if re.match(r"[a-z-]+$", word))
            elif words[0] == "python" and words[1].endswith(".py"):
                assert (ROOT / words[1]).is_file(), words
            elif words[:2] == ["pip", "install"]:
                extras = re.findall(r"(?:\.|iits-mj)\[([\w,]+)\]", " ".join(words))
                known = PROJECT["optional-dependencies"]
                assert all(extra in known for extra in ",".join(extras).split(",") if extra)
