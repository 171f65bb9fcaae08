"""Names in the prose of the pages: options, Python names and files of the code exist."""

from __future__ import annotations

import dataclasses
import importlib
import re

import pytest

from iits_mj.commands import COMMANDS
from iits_mj.commands.arguments import General
from tests.docs.test_blocks import PAGES
from tests.paths import ROOT

# Options of other programs that pages name.
FOREIGN = {
    *("address", "bus-type", "crossings", "default", "frame-id-mask", "gpus", "head", "index-url"),
    *("logdir", "network", "no-deps", "no-install-recommends", "osc", "rand", "single-line"),
    "window",
}
# A beginning that stands for several options, and the misspelled one of the example.
SHORT = {"start-", "densty"}
PROSE = re.compile(r"```.*?```", re.DOTALL)


def options_of_the_package() -> set[str]:
    """Returns the options of all commands, and those of tools, benchmarks and examples."""
    kinds = [General]
    for name in COMMANDS:
        kinds.append(importlib.import_module(f"iits_mj.commands.{name.replace('-', '_')}").Options)
    found = {"help", "version"}
    for kind in kinds:
        for field in dataclasses.fields(kind):
            name = field.name.replace("_", "-")
            found |= {name, f"no-{name}"}
    for folder in ("benchmarks", "docs", "examples", "tests", "tools"):
        for file in (ROOT / folder).rglob("*.py"):
            found |= set(re.findall(r"\"--([\w-]+)\"", file.read_text(encoding="utf-8")))
    return found


def test_the_options_that_pages_name_exist() -> None:
    known = options_of_the_package() | FOREIGN | SHORT
    missing = {
        f"{name}: --{option}"
        for name, page in PAGES.items()
        if "validation/" not in name
        for option in re.findall(r"(?<![\w-])--([a-z][\w-]*)", page.read_text(encoding="utf-8"))
        if option not in known
    }
    assert sorted(missing) == []


def resolves(name: str) -> bool:
    """Returns whether a dotted name is a module, or a member of one."""
    words = name.split(".")
    for count in range(len(words), 0, -1):
        try:
            found = importlib.import_module(".".join(words[:count]))
        except ModuleNotFoundError:
            continue
        for word in words[count:]:
            if not hasattr(found, word):
                return False
            found = getattr(found, word)
        return True
    return False


def test_the_python_names_that_pages_name_exist() -> None:
    pattern = re.compile(r"`((?:iits_mj|controllers|traffic_bridge)(?:\.\w+)+)[`(]")
    named = {
        (dotted, name)
        for name, page in PAGES.items()
        for dotted in pattern.findall(PROSE.sub("", page.read_text(encoding="utf-8")))
        if not (ROOT / "iits_mj" / "j1939" / dotted).is_file()
    }
    assert len(named) > 50
    assert [found for found in sorted(named) if not resolves(found[0])] == []


@pytest.mark.parametrize("folder", ["controllers", "iits_mj/road"])
def test_the_page_of_a_package_lists_its_modules(folder: str) -> None:
    page = (ROOT / folder / "README.md").read_text(encoding="utf-8")
    modules = [
        file
        for file in (ROOT / folder).rglob("*.py")
        # The fast world has one line as a whole.
        if file.name != "__init__.py" and file.parent.name != "fast_world"
    ]
    missing = [str(file) for file in modules if not re.search(rf"`{file.stem}(\.py)?`", page)]
    assert len(modules) > 10
    assert missing == []


def test_an_unknown_name_does_not_resolve() -> None:
    assert resolves("iits_mj.core.errors.InputError")
    assert not resolves("iits_mj.core.errors.OutputError")
    assert not resolves("iits_mj.nothing")
