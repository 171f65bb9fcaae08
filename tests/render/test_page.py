import re

import numpy as np
import pytest

from iits_mj.core.results import Check, Line, Panel, Results
from iits_mj.render.report import slug, table, write_markdown

X = np.linspace(0.0, 1.0, 20)
PANEL = Panel("Speed", "time [s]", "speed [m/s]", (Line("truck", X, X**2, "simulation"),))


def results() -> Results:
    first = Results("validate one", checks=[Check("fit", 95.0, "%", "model", ">= 97")])
    first.figures["step steer"] = [PANEL]
    second = Results("validate two", checks=[Check("gain", 1.0, "1", 1.0)], notes=["a note"])
    second.figures["step steer"] = [PANEL]
    return Results.merged("validate", [first, second])


def test_every_picture_of_the_page_lies_beside_it(tmp_path):
    page = write_markdown(results(), "1.0", tmp_path)
    pictures = re.findall(r"!\[[^]]*\]\(([^)]+)\)", page.read_text())
    assert len(pictures) == 2
    for picture in pictures:
        assert (tmp_path / picture).read_bytes().startswith(b"\x89PNG")


def test_page_says_what_falls_short_and_has_a_section_for_each_part(tmp_path):
    text = write_markdown(results(), "1.0", tmp_path).read_text()
    assert "- fit: 95 %, must be >= 97" in text
    assert "## One" in text
    assert "## Two" in text
    assert "> a note" in text


def test_pictures_of_an_older_page_go(tmp_path):
    (tmp_path / "validate").mkdir()
    (tmp_path / "validate" / "old.png").write_bytes(b"")
    write_markdown(results(), "1.0", tmp_path)
    assert not (tmp_path / "validate" / "old.png").exists()


def test_same_results_give_the_same_page(tmp_path):
    first = write_markdown(results(), "1.0", tmp_path).read_bytes()
    assert write_markdown(results(), "1.0", tmp_path).read_bytes() == first


def test_only_bounded_checks_get_a_verdict():
    rows = table([Check("a", 1.0, "1", None, ">= 2"), Check("b", 1.0, "1")])
    assert rows[2].endswith("| >= 2 | **falls short** |")
    assert rows[3].endswith("|  |  |")


@pytest.mark.parametrize(("text", "name"), [("validate step-size", "validate-step-size")])
def test_file_names_are_plain(text, name):
    assert slug(text) == name
