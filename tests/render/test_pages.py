"""Pages as HTML and Markdown, and the plots in them."""

import re
from pathlib import Path

import numpy as np
import pytest

from iits_mj.core.errors import InputError
from iits_mj.core.results import Check, Line, Panel, Results
from iits_mj.render import pages, plots
from iits_mj.render.interactive import Plot
from iits_mj.render.pages import Page, Section, check_section, picture_section, write_results_page
from tests.render.drives import Content, plotted

X = np.linspace(0.0, 10.0, 50)
PANEL = Panel(
    "Speed",
    "time [s]",
    "speed [m/s]",
    (Line("measured", X, np.sin(X), "reference"), Line("simulated", X, np.cos(X), "simulation")),
)


def read(text: str) -> Content:
    return Content(text)


def results() -> Results:
    first = Results("validate one", checks=[Check("fit", 95.0, "%", "model", ">= 97")])
    first.figures["step steer"] = [PANEL]
    second = Results("validate two", checks=[Check("gain", 1.0, "1", 1.0)], notes=["a note"])
    second.figures["step steer"] = [PANEL]
    return Results.merged("validate", [first, second])


def test_same_panels_give_the_same_png_bytes() -> None:
    first, second = (plots.to_png(plots.draw([PANEL, PANEL])) for _ in range(2))
    assert first.startswith(b"\x89PNG")
    assert first == second


def test_both_axes_have_units() -> None:
    figure = plots.draw([PANEL])
    assert figure.axes[0].get_xlabel() == "time [s]"
    assert figure.axes[0].get_ylabel() == "speed [m/s]"


@pytest.mark.parametrize(("value", "below"), [(0.0, False), (0.4, False), (-2.0, True)])
def test_a_constant_that_is_not_negative_gets_no_range_below_zero(
    value: float, below: bool
) -> None:
    x = np.array([0.0, 1.0])
    panel = Panel("Brakes", "time [s]", "pressure [kPa]", (Line("", x, np.full(2, value)),))
    low, high = plots.draw([panel]).axes[0].get_ylim()
    assert low <= value < high
    assert (low < 0.0) == below


def test_plan_views_are_drawn_to_scale() -> None:
    plan = Panel("path", "x [m]", "y [m]", PANEL.lines)
    assert plots.draw([plan]).axes[0].get_aspect() == 1.0
    assert plots.draw([PANEL]).axes[0].get_aspect() == "auto"


def test_lines_that_do_not_match_are_refused() -> None:
    with pytest.raises(InputError, match="must be"):
        plots.draw([Panel("p", "x", "y", (Line("l", X, X[:-1]),))])
    with pytest.raises(InputError, match="no panels"):
        plots.draw([])


def test_page_embeds_its_pictures_and_plots() -> None:
    sections = [
        Section("Summary", header=("figure", "value"), rows=[("distance", "1 km")]),
        Section("Curves", plots=[Plot((PANEL,))]),
        picture_section("Speed", plots.to_png(plots.draw([PANEL]))),
    ]
    text = Page("A drive", sections=sections).to_html()
    assert plotted(text)[0]["plots"][0]["title"] == "Speed"
    assert len(read(text).sources) == 1
    assert read(text).sources[0].startswith("data:image/png")


def test_a_page_without_plots_carries_no_plotly() -> None:
    text = Page("A table", sections=[Section(header=("a", "b"), rows=[("1", "2")])]).to_html()
    assert len(text) < 50_000


def test_an_empty_section_is_left_out_with_its_title() -> None:
    assert "Nothing" not in Page("x", sections=[Section("Nothing")]).to_html()


def test_text_cannot_become_markup() -> None:
    mark = "<img src=x>"
    section = Section(
        mark, notes=[mark], sentences=[mark], header=[mark], rows=[[f"**{mark}**"]],
        checks=[Check(mark, 1.0, mark, mark)],
    )  # fmt: skip
    page = read(Page("<script>x</script>", mark, [section]).to_html())
    assert not page.of("img")
    assert "<script>x" not in Page("<script>x</script>", mark, [section]).to_html()
    assert len(page.of("strong")) == 1


def test_results_page_names_checks_that_fall_short(tmp_path: Path) -> None:
    found = Results("bench", checks=[Check("step", 20.0, "us", 10.0, "<= 15")])
    found.figures["cost_of_a_step"] = [PANEL]
    web, _ = write_results_page(found, "0.1.0", tmp_path)
    page = read(web.read_text())
    assert "falls short: step" in page.words()
    assert plotted(web.read_text())[0]["plots"]


def test_writing_replaces_the_old_page_and_leaves_no_other_file(tmp_path: Path) -> None:
    path = tmp_path / "report.html"
    path.write_text("old")
    Page("new").write(path)
    assert "new" in path.read_text()
    assert [p.name for p in tmp_path.iterdir()] == ["report.html"]


def test_every_picture_of_a_markdown_page_is_in_its_folder(tmp_path: Path) -> None:
    _, page = write_results_page(results(), "1.0", tmp_path)
    pictures = re.findall(r"!\[[^]]*\]\(([^)]+)\)", page.read_text())
    assert len(pictures) == 2
    for picture in pictures:
        assert (tmp_path / picture).read_bytes().startswith(b"\x89PNG")


def test_markdown_page_lists_failed_checks_and_has_a_section_for_each_part(
    tmp_path: Path,
) -> None:
    text = write_results_page(results(), "1.0", tmp_path)[1].read_text()
    assert "- fit: 95 %, must be >= 97" in text
    assert "## One" in text
    assert "## Two" in text
    assert "> a note" in text


def test_pictures_of_an_older_page_are_removed(tmp_path: Path) -> None:
    (tmp_path / "validate").mkdir()
    (tmp_path / "validate" / "old.png").write_bytes(b"")
    write_results_page(results(), "1.0", tmp_path)
    assert not (tmp_path / "validate" / "old.png").exists()


def test_same_results_give_the_same_pages(tmp_path: Path) -> None:
    first = [page.read_bytes() for page in write_results_page(results(), "1.0", tmp_path)]
    assert [p.read_bytes() for p in write_results_page(results(), "1.0", tmp_path)] == first


def test_only_bounded_checks_get_a_verdict_in_markdown() -> None:
    checks = [Check("a", 1.0, "1", None, ">= 2"), Check("b", 1.0, "1")]
    lines = Page("x", sections=[check_section(checks)]).to_markdown().splitlines()
    assert "| >= 2 | **falls short** |" in "\n".join(lines)
    assert lines[-1].endswith("|  |  |")


def test_cells_cannot_break_a_markdown_table() -> None:
    page = Page("x", sections=[Section(header=("a|b", "c"), rows=[("1|2", "3")])])
    assert "| 1\\|2 | 3 |" in page.to_markdown()


@pytest.mark.parametrize(("text", "name"), [("validate step-size", "validate-step-size")])
def test_file_names_have_no_special_characters(text: str, name: str) -> None:
    assert pages.slug(text) == name
