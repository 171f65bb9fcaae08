"""Two drives compared: a planted difference is found where it is, figures, and input errors."""

import csv
import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

from iits_mj import cli
from iits_mj.commands.drive import Kept
from iits_mj.core.errors import InputError
from iits_mj.render.compare_page import Comparison
from iits_mj.simulation.compare import Run, differing, figures, partings, resample
from iits_mj.simulation.drive_table import DriveTable
from tests.render.drives import Content, drive, plotted


def write(table: DriveTable, path: Path, **settings: object) -> Path:
    """Writes an output folder with telemetry and, with settings, a summary."""
    path.mkdir(parents=True)
    with (path / "telemetry.csv").open("w", newline="") as stream:
        rows = csv.writer(stream)
        rows.writerow(table.columns)
        for row in zip(*table.columns.values(), strict=True):
            rows.writerow("" if np.isnan(value) else f"{value:.9g}" for value in row)
    if settings:
        (path / "summary.json").write_text(json.dumps({"settings": settings}))
    return path


def planted(row: int, column: str, by: float) -> DriveTable:
    """The drive with one column changed from a row on."""
    table = drive()
    values = table.column(column).copy()
    values[row:] += by
    return DriveTable({**table.columns, column: values})


def runs(tmp_path: Path, other: DriveTable) -> tuple[Run, Run]:
    return (
        Run.read(write(drive(), tmp_path / "a", density="dense", seed="1")),
        Run.read(write(other, tmp_path / "b", density="sparse", seed="1")),
    )


def test_a_planted_difference_is_found_at_its_row(tmp_path: Path) -> None:
    a, b = runs(tmp_path, planted(123, "engine_torque [N m]", 0.001))
    (found,) = partings(a, b)
    assert found.name == "engine_torque [N m]"
    assert found.time == pytest.approx(12.3)
    assert found.station == pytest.approx(drive().column("station [m]")[123])
    assert (found.first, found.second) == (0.0, 0.001)
    assert "diverge at 12.3 s" in Comparison(a, b).verdict


def test_a_difference_becomes_visible_above_one_percent_of_the_range(tmp_path: Path) -> None:
    table = drive()
    speed = table.column("speed [m/s]").copy()
    speed[50:] += 0.001
    speed[200:] += 1.0
    a, b = runs(tmp_path, DriveTable({**table.columns, "speed [m/s]": speed}))
    (found,) = partings(a, b)
    assert (found.time, found.visible) == pytest.approx((5.0, 20.0))
    assert found.greatest == pytest.approx(1.001)


def test_the_earliest_column_comes_first_and_a_missing_value_is_a_difference(
    tmp_path: Path,
) -> None:
    table = planted(80, "yaw [rad]", 0.1)
    gap = table.column("gap_ahead [m]").copy()
    gap[60] = np.nan
    a, b = runs(tmp_path, DriveTable({**table.columns, "gap_ahead [m]": gap}))
    assert [found.name for found in partings(a, b)] == ["gap_ahead [m]", "yaw [rad]"]


def test_equal_drives_are_equal_and_a_shorter_one_is_called_so(tmp_path: Path) -> None:
    a, b = runs(tmp_path, drive(200))
    assert partings(a, b) == []
    assert "equal in 200 rows; one drive is longer" in Comparison(a, b).verdict
    assert Comparison(a, a).as_dict()["equal"] is True


def test_figures_have_their_difference(tmp_path: Path) -> None:
    a, b = runs(tmp_path, drive(faster=2.0))
    found = {figure.name: figure for figure in figures(a, b)}
    assert found["distance"].difference == pytest.approx(0.002 * 28.1, abs=2e-3)
    assert found["fuel"].first == pytest.approx(0.3)
    assert found["lane changes"].cells() == ("lane changes", "2", "2", "+0")
    assert next(f for f in found.values() if "time at station" in f.name).difference < -2.0
    assert "closest vehicle" not in found  # Neither drive has a value.


def test_tracking_is_compared_by_the_largest_deviation_from_the_plan(tmp_path: Path) -> None:
    table = drive()
    planned = table.column("offset [m]") + 0.1
    planned[5] += 0.2
    planned[7] = np.nan  # A row without a plan does not count.
    columns = {**table.columns, "planned_offset [m]": planned}
    _, b = runs(tmp_path, DriveTable(columns))
    found = {figure.name: figure for figure in figures(b, b)}
    assert found["largest deviation from the planned offset"].first == pytest.approx(0.3)
    del columns["planned_offset [m]"]
    c = Run.read(write(DriveTable(columns), tmp_path / "c"))
    assert not any("planned offset" in figure.name for figure in figures(c, c))


def test_only_settings_that_change_a_drive_are_compared(tmp_path: Path) -> None:
    a, b = runs(tmp_path, drive())
    assert Comparison(a, b).configuration() == [("density", "dense", "sparse")]
    assert differing({"out": "x", "seed": "1"}, {"out": "y"}) == [("seed", "1", "not set")]
    outputs = [field.name.replace("_", " ") for field in dataclasses.fields(Kept)]
    assert differing(dict.fromkeys(outputs, "x"), dict.fromkeys(outputs, "y")) == []


def test_page_has_curves_differences_and_no_empty_plot(tmp_path: Path) -> None:
    a, b = runs(tmp_path, drive(250, faster=1.0))
    text = Comparison(a, b).page("1.0").to_html()
    page, arrays = plotted(text)
    titles = [plot["title"] for plot in page["plots"]]
    assert "Speed: truck" in titles
    assert "Speed: truck, difference" in titles
    assert "Equal in both" in text
    assert len(page["clocks"]) == 2
    for plot in page["plots"]:
        for line in plot["lines"]:
            assert all(np.isfinite(arrays[place]).any() for place in line["y"])
    difference = page["plots"][titles.index("Speed: truck, difference")]["lines"][0]
    over_time = arrays[difference["y"][0]]
    assert np.nanmax(over_time) == pytest.approx(3.6, abs=0.01)
    assert not {"None", "nan"} & set(Content(text).words().split())


def test_drives_with_other_rows_are_interpolated() -> None:
    x = np.array([0.0, 1.0, 2.0])
    at = np.array([0.5, 1.0, 1.75])
    assert resample(x, np.array([0.5, 1.5, 3.5]), at).tolist() == [1.0, 1.5, 3.0]
    assert resample(x, np.array([1.0, 2.0, 5.0]), at).tolist() == [1.0, 2.0, 2.0]


def test_folders_tables_and_recordings_of_the_same_drive_are_equal(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["--duration", "2", "--seed", "3", "--density", "empty"]
    assert cli.main(["record", str(tmp_path / "r.npz"), *words]) == 0
    assert cli.main(["drive", *words, "--no-video", "--out", str(tmp_path / "d")]) == 0
    capsys.readouterr()
    table = str(tmp_path / "d" / "telemetry.csv")
    for first, second in ((str(tmp_path / "d"), table), (table, str(tmp_path / "r.npz"))):
        assert cli.main(["compare", first, second, "--json"]) == 0
        found = json.loads(capsys.readouterr().out)
        assert found["equal"]
        assert found["configuration"] == {}


def test_command_prints_tables_and_writes_the_page(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    a = write(drive(), tmp_path / "a", density="dense")
    b = write(planted(100, "speed [m/s]", 1.0), tmp_path / "b", density="sparse")
    page = tmp_path / "pages" / "two.html"
    assert cli.main(["compare", str(a), str(b), "--out", str(page)]) == 0
    shown = capsys.readouterr().out
    for part in ("They diverge at 10.0 s", "density", "mean speed", f"page: {page}"):
        assert part in shown
    assert page.is_file()
    assert cli.main(["compare", str(a), str(b / "telemetry.csv"), "--out", str(tmp_path)]) == 0
    assert (tmp_path / "compare.html").is_file()


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("gone", None, "does not exist"),
        ("empty/", None, "has no telemetry.csv"),
        ("a.txt", "x", "is no output folder, .csv or .npz"),
        ("a.csv", "a,b\n1,2\n", "lacks the column 'time \\[s\\]'"),
        ("b.csv", "time [s],station [m]\n", "has no row"),
        ("c.csv", "time [s],station [m]\n0,1\n0,2\n", "must increase"),
        ("d.csv", "time [s],station [m]\n0,1\n1\n", "row 2 has 1 cells, must have 2"),
        ("e.csv", "time [s],station [m]\n0,1\n1,\n", "has gaps"),
        ("f.npz", "x", "recording"),
    ],
)
def test_unusable_input_is_named(
    tmp_path: Path, name: str, content: str | None, message: str
) -> None:
    path = tmp_path / name
    if name.endswith("/"):
        path.mkdir()
    elif content is not None:
        path.write_text(content)
    with pytest.raises(InputError, match=message):
        Run.read(path)


def test_drives_without_common_time_are_refused(tmp_path: Path) -> None:
    a, b = runs(tmp_path, drive(start=100.0))
    with pytest.raises(InputError, match="no time in common"):
        partings(a, b)


def test_a_damaged_summary_is_named(tmp_path: Path) -> None:
    folder = write(drive(), tmp_path / "a")
    (folder / "summary.json").write_text("{")
    with pytest.raises(InputError, match="summary"):
        Run.read(folder)
