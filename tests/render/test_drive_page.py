"""The page of a drive: its structure, its data, and that nothing is empty."""

import itertools
import re
from pathlib import Path

import numpy as np
import pytest

from iits_mj.core.errors import InputError
from iits_mj.core.results import Line, Panel
from iits_mj.render import interactive
from iits_mj.render.drive_page import ROWS
from iits_mj.render.interactive import PageData, Plot, rounded
from tests.render.drives import Content, drive, plotted, report

TEMPLATES = Path(interactive.__file__).with_name("templates")


@pytest.fixture(scope="module")
def text() -> str:
    return report(drive()).page().to_html()


@pytest.fixture(scope="module")
def content(text: str) -> Content:
    return Content(text)


def test_every_plot_has_data_and_no_text_says_none_or_nan(text: str, content: Content) -> None:
    page, arrays = plotted(text)
    assert len(page["plots"]) == 15
    for plot in page["plots"]:
        assert plot["lines"]
        for line in plot["lines"]:
            for places in (line["x"], line["y"]):
                assert all(np.isfinite(arrays[place]).any() for place in places)
    assert not re.search(r"\b(None|nan|NaN|inf)\b", content.words())


def test_arrays_are_the_columns_of_the_telemetry(text: str) -> None:
    table = drive()
    page, arrays = plotted(text)
    speed = next(plot for plot in page["plots"] if plot["title"] == "Speed")
    assert speed["x"] == ["time [s]", "station [m]"]
    line = next(line for line in speed["lines"] if line["label"] == "truck")
    for place, name, scale in (
        (line["x"][0], "time [s]", 1.0),
        (line["x"][1], "station [m]", 1.0),
        (line["y"][0], "speed [m/s]", 3.6),
    ):
        wanted = scale * table.column(name)
        assert arrays[place] == pytest.approx(wanted, abs=2.0**-17 * np.ptp(wanted))
    assert line["y"][0] == line["y"][1]
    assert page["clocks"][0]["time"] == line["x"][0]
    assert page["clocks"][0]["station"] == line["x"][1]


def test_a_plot_without_values_is_left_out_with_its_line(text: str) -> None:
    page, _ = plotted(text)
    distance = next(plot for plot in page["plots"] if plot["title"] == "Distance to the traffic")
    assert [line["label"] for line in distance["lines"]] == ["bumper to bumper ahead"]
    lonely = drive()
    gone = {"gap_ahead [m]": np.full(len(lonely), np.nan)}
    alone = report(type(lonely)({**lonely.columns, **gone})).page().to_html()
    assert "Distance to the traffic" not in alone


def test_a_truck_alone_has_no_lines_of_towed_units() -> None:
    def titles(articulation: float) -> dict[str, int]:
        table = drive()
        angle = {"articulation [rad]": np.full(len(table), articulation)}
        page, _ = plotted(report(type(table)({**table.columns, **angle})).page().to_html())
        return {plot["title"].partition(",")[0]: len(plot["lines"]) for plot in page["plots"]}

    towing, alone = titles(1e-16), titles(0.0)
    assert towing.keys() - alone.keys() == {"Articulation"}
    assert towing["Brake pressure"] - alone["Brake pressure"] == 1


def test_headings_landmarks_and_names_let_a_screen_reader_find_everything(content: Content) -> None:
    levels = [int(tag[1]) for tag, _ in content.elements if re.fullmatch(r"h\d", tag)]
    assert levels[0] == 1
    assert levels.count(1) == 1
    assert all(after - before <= 1 for before, after in itertools.pairwise(levels))
    assert {"header", "nav", "main", "section"} <= {tag for tag, _ in content.elements}
    skip = next(e for e in content.of("a") if e.get("class") == "skip")
    ids = [e["id"] for _, e in content.elements if "id" in e]
    assert len(ids) == len(set(ids))
    assert str(skip["href"]).lstrip("#") in ids
    for link in content.of("a"):
        if str(link["href"]).startswith("#"):
            assert str(link["href"])[1:] in ids
    canvases = [e for e in content.of("div") if "canvas" in str(e.get("class"))]
    assert len(canvases) == 15
    assert all(e["role"] == "img" and e["aria-label"] for e in canvases)
    assert len([e for e in content.of("details") if e.get("class") == "numbers"]) == 15
    assert content.of("html")[0]["lang"] == "en"


def test_the_table_of_a_plot_tells_its_extremes() -> None:
    x = np.array([0.0, 1.0, 2.0, 3.0])
    panel = Panel(
        "Speed", "time [s]", "v [m/s]", (Line("a", x, np.array([5.0, -1.0, np.nan, 9.0])),)
    )
    header, rows = Plot((panel,)).table()
    assert header[1] == "first v [m/s]"
    assert rows == [("a", "5", "9", "\u22121", "1", "9", "3", "4.333")]


def test_the_page_stands_alone_but_for_the_film(tmp_path: Path, content: Content) -> None:
    assert content.sources == []
    film = tmp_path / "out" / "my drive.mp4"
    made = Content(report(drive(), film).page().to_html(tmp_path / "out"))
    assert set(made.sources) == {"my%20drive.mp4"}
    assert made.of("video")


def test_the_page_says_how_the_drive_was_made_and_what_the_map_marks(content: Content) -> None:
    words = content.words()
    for part in ("iits-mj drive --seed 3", "a remark", "lane change, now in lane 1", "dense"):
        assert part in words
    # Of the legend, the numbers and the places of the map; the other light is far.
    assert words.count("traffic light") == 3


def test_a_long_drive_keeps_its_extremes_in_few_rows() -> None:
    table = drive(40_000)
    table.columns["speed [m/s]"][12_345] = 99.0
    thin = table.thinned(ROWS)
    assert len(thin) <= ROWS
    assert thin.column("speed [m/s]").max() == 99.0
    assert thin.column("time [s]")[[0, -1]].tolist() == table.column("time [s]")[[0, -1]].tolist()
    assert (np.diff(thin.column("time [s]")) >= 0.0).all()
    assert np.isnan(thin.column("plan_mode [-]")).all()
    made = report(table).page().to_html()
    assert "The drive has 40000 rows" in made
    assert len(made) < 4_500_000


def test_a_drive_of_one_row_has_a_page_without_plots() -> None:
    made = Content(report(drive(1)).page().to_html())
    assert "distance" in made.words()
    assert not [e for e in made.of("div") if "canvas" in str(e.get("class"))]


def test_equal_arrays_are_stored_once_and_rounding_keeps_the_order() -> None:
    data, x = PageData(), np.sort(np.random.default_rng(0).uniform(0.0, 3000.0, 5000))
    assert data.array(x) == data.array(x.copy())
    small = rounded(x)
    assert (np.diff(small) >= 0.0).all()
    assert small == pytest.approx(x, abs=2.0**-17 * 3000.0)
    assert rounded(np.array([np.inf, 1.5])).tolist() == pytest.approx([np.nan, 1.5], nan_ok=True)
    assert rounded(np.full(3, 101.3)).tolist() == pytest.approx([101.3] * 3)


def test_lines_over_another_axis_must_be_the_same() -> None:
    x = np.array([0.0, 1.0])
    first, second = (Panel("p", axis, "y", (Line(axis, x, x),)) for axis in ("a", "b"))
    with pytest.raises(InputError, match="the same lines"):
        Plot((first, second))


def test_missing_plotly_is_one_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    interactive.plotly_base64.cache_clear()
    monkeypatch.setattr(interactive.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(InputError, match="pip install 'plotly"):
        report(drive()).page().to_html()


# --- colors -------------------------------------------------------------------------------------


def _luminance(color: str) -> float:
    """Relative luminance of a color, WCAG 2.2."""
    parts = np.array([int(color[i : i + 2], 16) for i in (1, 3, 5)]) / 255.0
    linear = np.where(parts <= 0.04045, parts / 12.92, ((parts + 0.055) / 1.055) ** 2.4)
    return float(linear @ [0.2126, 0.7152, 0.0722])


def _contrast(first: str, second: str) -> float:
    low, high = sorted((_luminance(first), _luminance(second)))
    return (high + 0.05) / (low + 0.05)


STYLE = (TEMPLATES / "page.css").read_text()
COLORS = dict(re.findall(r"--([\w-]+): light-dark\((#\w{6}, #\w{6})\)", STYLE))


@pytest.mark.parametrize("dark", [0, 1])
def test_text_lines_and_controls_have_the_contrast_of_wcag_aa(dark: int) -> None:
    color = {name: pair.split(", ")[dark] for name, pair in COLORS.items()}
    for ground in ("paper", "soft"):
        for name in ("ink", "muted", "link", "short", "ok"):
            assert _contrast(color[name], color[ground]) >= 4.5, (name, ground)
    graphics = [f"c{i}" for i in range(6)] + ["reference", "edge", "mark", "control", "note"]
    for name in graphics:
        assert _contrast(color[name], color["paper"]) >= 3.0, name


def test_every_color_of_the_script_and_the_style_sheet_is_defined() -> None:
    script = (TEMPLATES / "page.js").read_text()
    used = set(re.findall(r"var\(--([\w-]+)\)", STYLE)) | set(
        re.findall(r'color\("(\w+)"\)', script)
    )
    assert used - {"color"} <= set(COLORS)
