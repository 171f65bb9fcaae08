"""What the site shows beside the pages: the API, the citation, the gallery, the navigation."""

from __future__ import annotations

import importlib
import re
import tomllib
from pathlib import Path

import pytest

from tests.paths import ROOT

DOCS = ROOT / "docs"
API = "\n".join(page.read_text(encoding="utf-8") for page in (DOCS / "api").glob("*.md"))
# Packages that a command needs, without names for other programs.
INTERNAL = {"iits_mj.kernels", "iits_mj.plugin"}


def packages() -> list[str]:
    """Returns the packages that name their public members."""
    return [
        ".".join(file.parent.relative_to(ROOT).parts)
        for root in ("iits_mj", "controllers", "traffic_bridge")
        for file in (ROOT / root).rglob("__init__.py")
        if "__all__" in file.read_text(encoding="utf-8")
    ]


def test_the_api_has_every_package_with_public_names() -> None:
    shown = set(re.findall(r"^::: ([\w.]+)$", API, re.M))
    assert set(packages()) - INTERNAL <= shown


def test_the_modules_of_the_api_exist() -> None:
    for name in re.findall(r"^::: ([\w.]+)$", API, re.M):
        importlib.import_module(name)


def test_the_citation_is_that_of_the_citation_file() -> None:
    file = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    page = (DOCS / "citing.md").read_text(encoding="utf-8")
    version = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
    assert f"version: {version}" in file
    assert f"{{{version}}}" in page
    for given, family in re.findall(r"given-names: (\w+), family-names: (\w+)", file):
        assert f"{family}, {given}" in page


def test_the_gallery_has_twenty_pictures_that_stand_below_their_code() -> None:
    text = (DOCS / "gallery.md").read_text(encoding="utf-8")
    blocks = re.split(r"^## ", text, flags=re.M)
    pictures = 0
    for section in blocks:
        coded = False
        for line in section.splitlines():
            coded |= line.startswith("```")
            if line.startswith("!["):
                assert coded, line
                pictures += 1
    assert pictures >= 20


@pytest.mark.slow
def test_the_site_is_built_without_a_warning(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("material", reason="the site needs the extra docs")
    from mkdocs.commands.build import build
    from mkdocs.config import load_config

    monkeypatch.chdir(ROOT)
    monkeypatch.setenv("NOTEBOOKS", "false")
    config = load_config(str(ROOT / "mkdocs.yml"), site_dir=str(tmp_path), strict=True)
    config.plugins.on_startup(command="build", dirty=False)
    build(config)
    front = (tmp_path / "index.html").read_text(encoding="utf-8")
    assert "api/README.html" in front or "api/index.html" in front
    assert not re.search(r'<(script|link|img)[^>]+(src|href)="https?://', front)
