import html.parser
from pathlib import Path

import numpy as np
import pytest

from iits_mj.core.errors import InputError
from iits_mj.core.results import Check, Line, Panel, Results
from iits_mj.render import plots, report

X = np.linspace(0.0, 10.0, 50)
PANEL = Panel(
    "Speed",
    "time [s]",
    "speed [m/s]",
    (Line("measured", X, np.sin(X), "reference"), Line("simulated", X, np.cos(X), "simulation")),
)


class Page(html.parser.HTMLParser):
    """Collects tags and what they refer to."""

    def __init__(self) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.sources: list[str] = []
        self.text: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.sources += [value or "" for name, value in attrs if name in ("src", "href")]

    def handle_data(self, data: str) -> None:
        self.text.append(data)


def read(text: str) -> Page:
    page = Page()
    page.feed(text)
    return page


def test_same_panels_give_the_same_png_bytes() -> None:
    first, second = (plots.to_png(plots.draw([PANEL, PANEL])) for _ in range(2))
    assert first.startswith(b"\x89PNG")
    assert first == second


def test_units_stand_on_both_axes() -> None:
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


def test_page_carries_its_pictures_and_video_inside(tmp_path: Path) -> None:
    video = tmp_path / "drive.mp4"
    video.write_bytes(b"moving pictures")
    page = read(
        report.Report(
            title="A drive",
            video=video,
            rows=[("distance", "1 km")],
            images=[("Speed", plots.to_png(plots.draw([PANEL])))],
        ).to_html()
    )
    assert "video" in page.tags
    assert "img" in page.tags
    assert page.sources
    assert all(source.startswith("data:") for source in page.sources)


def test_large_video_is_linked_instead(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(report, "INLINE_VIDEO_BYTES", 10)
    video = tmp_path / "drive.mp4"
    video.write_bytes(b"0" * 11)
    page = read(report.Report(title="A drive", video=video).to_html(tmp_path))
    assert page.sources == ["drive.mp4", "drive.mp4"]


def test_text_from_outside_cannot_become_markup() -> None:
    page = read(report.Report(title="<script>x</script>", notes=["<img src=x>"]).to_html())
    assert "script" not in page.tags
    assert "img" not in page.tags


def test_results_page_names_what_falls_short() -> None:
    results = Results("bench", checks=[Check("step", 20.0, "us", 10.0, "<= 15")])
    results.figures["cost_of_a_step"] = [PANEL]
    page = read(report.from_results(results, "0.1.0").to_html())
    assert "falls short: step" in " ".join(page.text)
    assert "img" in page.tags


def test_writing_replaces_the_old_page_whole_and_leaves_nothing_beside_it(tmp_path: Path) -> None:
    path = tmp_path / "report.html"
    path.write_text("old")
    report.Report(title="new").write(path)
    assert "new" in path.read_text()
    assert [p.name for p in tmp_path.iterdir()] == ["report.html"]
