"""The Python that the manual's pages show runs as it stands."""

import re

import pytest

from tests.paths import ROOT

ROOT = ROOT
PAGES = (
    "docs/powertrain.md",
    "docs/brakes.md",
    "docs/j1939_drive.md",
    "docs/j1939_logs.md",
    "docs/j1939_serve.md",
    "iits_mj/j1939/README.md",
)


@pytest.mark.parametrize("page", PAGES)
def test_examples_of_the_page_run_one_after_the_other(page, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    text = (ROOT / page).read_text(encoding="utf-8")
    examples = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    assert examples
    names: dict[str, object] = {}
    for example in examples:
        exec(compile(example, page, "exec"), names)
    assert capsys.readouterr().out
