"""The page of decision makers from a file of trials."""

import json
import math
import re
from dataclasses import MISSING, fields, replace

import pytest

from controllers.decision.trip import CELLS
from iits_mj import cli
from iits_mj.evaluation import trials
from iits_mj.evaluation.evaluate import EvaluateConfig, tasks_of
from iits_mj.evaluation.figures import figures
from iits_mj.evaluation.page import command_of
from tests.evaluation.rows_of import trial

LOSS = {"conservative": 0.3, "neutral": 0.27, "aggressive": 0.25, "mobil": 0.22, "ddqn": 0.2}


@pytest.fixture
def file(tmp_path):
    """Three trials of each method and cell, of two versions of the code."""
    rows = []
    for task in tasks_of(EvaluateConfig(trials=3)):
        loss = LOSS.get(task.method, 0.1) + 1e-3 * (task.seed % 1000) * (
            1.0 + LOSS.get(task.method, 0.1)
        )
        code = "aaaaaaaaaaaa" if task.method == "neutral" else "bbbbbbbbbbbb"
        rows.append(trial(task, loss, unsafe=2, code=code))
    path = tmp_path / "trials.csv"
    trials.write_trials(path, rows)
    return path


def show(file, *words):
    return cli.main(["evaluate", "--trials", "3", "--no-drive", "--file", str(file), *words])


def test_page_has_tables_pictures_and_the_origin_of_the_figures(file, tmp_path, capsys):
    out = tmp_path / "page"
    assert show(file, "--report", str(out)) == 1
    text = (out / "evaluate.md").read_text()
    for heading in ("The paper's table and ours", "Verdicts", "Safety", "Fuel, time and reward"):
        assert f"## {heading}" in text
    assert "| dense 12.5 | 10.00 | 38.9 / 30.13 ± 0.32 |" in text
    assert "`iits-mj evaluate --trials 3`" in text
    assert "2 versions of the code" in text
    assert "aaaaaaaaaaaa (neutral)" in text
    # Two unsafe decisions in 14.93 km.
    safety = text.split("## Safety")[1].split("##")[0]
    assert "| dense 12.5 | neutral | 0 | 0 | 13.40 | 6.70 | 1.50 | 1.50 | 1.00 | 0.90 |" in safety
    quality = text.split("## Lane changes and use of lanes")[1].split("##")[0]
    # One hard braking in three changes a trip; 4 kg in 14.93 km.
    row = "| dense 12.5 | neutral | 33.33 | 0.80 | 20.00 | - | 2.50 | 1.20 | 60.0 | 20.0 | 32.2 |"
    assert row in quality
    assert str(tmp_path) not in text
    for picture in re.findall(r"\]\((evaluate/[^)]+\.png)\)", text):
        assert (out / picture).stat().st_size > 10_000
    web = (out / "evaluate.html").read_text()
    pages = {path: path.read_bytes() for path in out.rglob("*.*")}
    show(file, "--report", str(out))
    assert {path: path.read_bytes() for path in out.rglob("*.*")} == pages
    assert web.count("data:image/png;base64,") == 2
    assert "<strong>" in web
    assert "**" not in re.sub(r"<style>.*?</style>", "", web, flags=re.DOTALL)


def test_page_of_a_part_of_the_rows(file, tmp_path, capsys):
    whole = file.read_text().splitlines(keepends=True)
    file.write_text("".join(line for line in whole if "sparse" not in line and "mobil" not in line))
    show(file, "--report", str(tmp_path / "part"))
    text = (tmp_path / "part" / "evaluate.md").read_text()
    assert "| medium 15 |" in text
    assert "| sparse" not in text
    file.write_text(whole[0])
    assert show(file, "--report", str(tmp_path / "none")) == 2
    assert "has none of these trials" in capsys.readouterr().err


def test_trials_without_figures_of_quality_have_no_table_of_them(file, tmp_path, capsys):
    unknown = {f.name: math.nan for f in fields(trials.Trial) if f.default is not MISSING}
    unknown = {n: v for n, v in unknown.items() if n not in ("lane_discipline", "keep_right")}
    known = trials.read_trials(file, print).values()
    trials.write_trials(file, [replace(trial, **unknown) for trial in known])
    show(file, "--report", str(tmp_path / "page"))
    assert "use of lanes" not in (tmp_path / "page" / "evaluate.md").read_text()
    assert "TTC" not in capsys.readouterr().out


def test_the_page_of_rules_with_options_has_their_points(tmp_path, capsys):
    names = "lookahead,lookahead:horizon=30,mobil:threshold=0.4"
    config = EvaluateConfig(trials=2, methods=names, cells="dense-15")
    path = tmp_path / "trials.csv"
    trials.write_trials(
        path, [trial(task, 0.1 + 1e-3 * (task.seed % 7)) for task in tasks_of(config)]
    )
    words = ["--trials", "2", "--methods", names, "--cells", "dense-15"]
    show(path, *words, "--report", str(tmp_path / "page"))
    text = (tmp_path / "page" / "evaluate.md").read_text()
    assert "| dense 15 | lookahead:horizon=30 |" in text


def test_json_has_the_checks(file, capsys):
    assert show(file, "--json") == 1
    shown = json.loads(capsys.readouterr().out)
    checks = {check["name"]: check for check in shown["checks"]}
    hard = checks["dense 12.5, mobil: changes that impose hard braking"]
    assert (hard["unit"], round(hard["value"], 2)) == ("%", 33.33)
    assert checks["dense 12.5, conservative: speed loss"]["reference"] == 38.9
    assert checks["dense 12.5: speed loss, ddqn less aggressive"]["ok"]


def test_tables_for_the_terminal_fit_100_columns(file, capsys):
    show(file)
    table = [line for line in capsys.readouterr().out.splitlines() if line.startswith("  ")]
    # Cells, methods and the names of the columns, the second table with a row of units.
    assert len(table) == 6 * (7 + 8)
    assert max(map(len, table)) <= 100


def test_command_has_the_settings_that_differ_from_the_defaults(tmp_path):
    config = EvaluateConfig(trials=5, cells="dense-15", weights=tmp_path / "mine.npz", jobs=4)
    assert command_of(config) == "iits-mj evaluate --trials 5 --cells dense-15 --weights mine.npz"


def test_cells_without_trials_are_left_out():
    assert figures([], CELLS, ("ddqn",)) == []
