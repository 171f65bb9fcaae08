"""The command `sweep`: rows, resuming, refusals, pictures, and drives that its rows repeat."""

import csv
import json
import shlex
from concurrent.futures import ThreadPoolExecutor

import pytest

from iits_mj import cli
from iits_mj.commands import sweep as command
from iits_mj.core.errors import Error
from iits_mj.evaluation.sweep import runs as sweep_runs
from iits_mj.evaluation.sweep.runs import SweepRun
from tests.paths import ROOT

CUT_IN = str(ROOT / "examples/cut_in.toml")
FAST = ["--traffic-mode", "none", "--plant", "yaw-sideslip"]


@pytest.mark.parametrize("name", ["reason", "events", "gap_m"])
def test_a_parameter_named_as_a_column_of_the_rows_is_refused(name, tmp_path, capsys):
    scenario = tmp_path / "scenario.toml"
    scenario.write_text(
        f'[parameters]\n{name} = 20.0\n[[events]]\nevent = "place_vehicle"\nname = "car"\n'
        f'gap = "${name}"\nrelative_lane = 0\nspeed = 3.0\n'
    )
    out = tmp_path / "out"
    words = ["sweep", str(scenario), *FAST, "--param", f"{name}=20,30", "--out", str(out)]
    assert cli.main(words) == 2
    assert f"param {name}: runs.csv has a column of this name" in capsys.readouterr().err
    assert not out.exists()


class Stop(BaseException):
    """Ends a sweep from outside."""


class Fake:
    """Stands for the drives: an outcome by a formula, at once and in this process."""

    def __init__(self):
        self.driven = []
        self.stops_after = None

    def __call__(self, point, sweep):
        if self.stops_after is not None and len(self.driven) >= self.stops_after:
            raise Stop
        self.driven.append(point)
        values = {name: float(text) for name, text in point}
        gap, dv = values.get("gap", 15.0), values.get("dv", -2.0)
        text = json.dumps(point)
        if gap == 12.9:
            return SweepRun(text, error="no such gap")
        if gap < -2.0 * dv:
            return SweepRun(
                text, ended="collision", collision=1, failed=1, road_user="car", impact_speed=-dv
            )
        ttc = 10.0 if dv >= 0.0 else -0.1 * gap / dv
        return SweepRun(text, ended="time", road_user="car", ttc=ttc, gap=gap, events=3)


@pytest.fixture
def fake(monkeypatch):
    made = Fake()
    monkeypatch.setattr(sweep_runs, "drive_point", made)
    monkeypatch.setattr(command, "worker_pool", lambda _: ThreadPoolExecutor(1))
    return made


def run(folder, *words, scenario=CUT_IN):
    return cli.main(["sweep", scenario, "--out", str(folder), "--shard", "1", *words])


def rows(folder):
    with (folder / "runs.csv").open(encoding="utf-8") as stream:
        return list(csv.DictReader(stream))


GRID = ["--param", "gap=4:28:5", "--param", "dv=-8:0:5"]


def test_each_point_has_a_row_with_its_outcome_and_its_command(fake, tmp_path, capsys):
    assert run(tmp_path, *GRID) == 0
    found = rows(tmp_path)
    assert [(row["gap"], row["dv"]) for row in found[:2]] == [("4", "-8"), ("4", "-6")]
    assert len(found) == 25
    first = found[0]
    assert (first["outcome"], first["reason"]) == ("collision", "28.8 km/h into car")
    assert first["command"] == f"iits-mj drive --events {CUT_IN} --param gap=4 --param dv=-8"
    assert {row["outcome"] for row in found} == {"collision", "near miss", "comfortable"}
    assert (tmp_path / "sweep.png").read_bytes().startswith(b"\x89PNG")
    page = (tmp_path / "sweep.html").read_text(encoding="utf-8")
    assert "A near miss has a time to collision below 1.5 s" in page
    text = capsys.readouterr().out
    assert "25 runs: 5 collision, 0 failure" in text
    assert f"the worst again: {first['command']}" in text


def test_an_interrupted_sweep_goes_on_with_the_missing_points_and_gives_the_same(fake, tmp_path):
    assert run(tmp_path / "whole", *GRID) == 0
    fake.driven.clear()
    fake.stops_after = 7
    with pytest.raises(Stop):
        run(tmp_path / "parts", *GRID)
    fake.stops_after = None
    assert len(fake.driven) == 7
    assert run(tmp_path / "parts", *GRID) == 0
    assert len(fake.driven) == len(set(fake.driven)) == 25
    whole, parts = (tmp_path / name / "runs.csv" for name in ("whole", "parts"))
    assert whole.read_bytes() == parts.read_bytes()


def test_a_finer_grid_and_other_thresholds_use_the_finished_drives(fake, tmp_path):
    assert run(tmp_path, *GRID) == 0
    assert run(tmp_path, "--param", "gap=4:28:9", "--param", "dv=-8:0:5") == 0
    assert len(fake.driven) == 45
    near = sum(row["outcome"] == "near miss" for row in rows(tmp_path))
    run(tmp_path, "--param", "gap=4:28:9", "--param", "dv=-8:0:5", "--near-ttc", "0.3")
    assert len(fake.driven) == 45
    assert sum(row["outcome"] == "near miss" for row in rows(tmp_path)) < near


def test_a_failed_drive_has_a_row_with_its_error_and_the_others_are_driven(fake, tmp_path, capsys):
    assert run(tmp_path, "--param", "gap=12,12.9,14", "--near-ttc", "0.1") == 1
    found = rows(tmp_path)
    assert [row["outcome"] for row in found] == ["comfortable", "error", "comfortable"]
    assert found[1]["reason"] == "no such gap"
    assert found[1]["gap_m"] == ""
    assert "1 error" in capsys.readouterr().out


def test_a_folder_of_another_sweep_is_refused_with_the_difference(
    fake, tmp_path, capsys, monkeypatch
):
    scenario = tmp_path / "e.toml"
    scenario.write_text((ROOT / "examples/cut_in.toml").read_text())
    out = tmp_path / "out"
    words = ["--param", "gap=12,14", "--payload", "1000"]
    assert run(out, *words, scenario=str(scenario)) == 0
    before = (out / "runs.csv").read_bytes()
    assert run(out, *words[:2], scenario=str(scenario)) == 2
    assert "its payload was 1000.0, now it is" in capsys.readouterr().err
    scenario.write_text(scenario.read_text().replace("-20.0", "-21.0"))
    assert run(out, *words, scenario=str(scenario)) == 2
    text = capsys.readouterr().err
    assert "has the drives of another sweep: its events was e.toml, SHA-256" in text
    assert "use another --out" in text
    scenario.write_text(scenario.read_text().replace("-21.0", "-20.0"))
    monkeypatch.setattr(sweep_runs, "sweep_code", lambda: "another")
    assert run(out, *words, scenario=str(scenario)) == 2
    assert "its version of the code was" in capsys.readouterr().err
    assert (out / "runs.csv").read_bytes() == before
    assert len(fake.driven) == 2


def test_the_adaptive_design_locates_the_boundary_with_few_drives(fake, tmp_path, capsys):
    words = ["--param", "gap=4:28", "--param", "dv=-8:0"]
    assert run(tmp_path / "a", *words, "--adaptive", "80") == 0
    text = capsys.readouterr().out
    assert "runs locate the boundaries between the outcomes within" in text
    times = float(text.split(" times as many")[0].split()[-1])
    assert times > 5.0
    assert len(fake.driven) <= 80
    # The boundary between collisions and the others is gap = -2 dv.
    near = [row for row in rows(tmp_path / "a") if row["outcome"] == "collision"]
    least = max(float(row["gap"]) + 2.0 * float(row["dv"]) for row in near)
    assert -0.5 < least < 0.0
    assert run(tmp_path / "b", *words, "--adaptive", "80") == 0
    one, other = (tmp_path / name / "runs.csv" for name in "ab")
    assert one.read_bytes() == other.read_bytes()
    assert run(tmp_path / "a", *words, "--adaptive", "20") == 2
    assert "adaptive 20 is less than the first grid of 5 x 5 points" in capsys.readouterr().err


@pytest.mark.parametrize(
    "words",
    [
        ["--param", "gap=4:28:5"],
        ["--param", "gap=4:28", "--param", "dv=-8:0", "--samples", "12"],
        ["--param", "gap=4:28:3", "--param", "dv=-8:0:3", "--param", "start-lane=0,1"],
        ["--param", "gap=4:9", "--param", "dv=-8:0", "--param", "payload=0:9", "--samples", "9"],
        ["--param", "gap=4:9", "--param", "dv=-8:0", "--param", "payload=0:9", "--adaptive", "30"],
        ["--param", "gap=4:28:2", "--param", "start_lane=0,1"],
        ["--param", "gap=5"],
    ],
)
def test_every_number_of_parameters_has_a_picture_and_json(fake, tmp_path, capsys, words):
    assert run(tmp_path, *words, "--json") == 0
    found = json.loads(capsys.readouterr().out)
    assert sum(found["outcomes"].values()) == len(found["runs"]) == len(rows(tmp_path))
    assert (tmp_path / "sweep.png").stat().st_size > 5000


def test_a_row_of_a_real_sweep_is_repeated_by_its_command(tmp_path, capsys):
    scenario = tmp_path / "hit.toml"
    scenario.write_text(
        '[parameters]\nspeed = 9.0\n[[events]]\nevent = "place_vehicle"\nname = "car"\n'
        'gap = 8.0\nspeed = "$speed"\nreactive = false\n'
    )
    words = ["--duration", "2", *FAST, "--param", "speed=2,16,80", "--jobs", "2"]
    assert run(tmp_path / "s", *words, scenario=str(scenario)) == 1
    hit, free, wrong = rows(tmp_path / "s")
    assert (hit["outcome"], free["outcome"], wrong["outcome"]) == (
        *("collision", "comfortable", "error"),
    )
    assert "speed = 80.0: allowed is 0 to 70" in wrong["reason"]
    assert wrong["distance_m"] == ""
    capsys.readouterr()
    line = shlex.split(hit["command"])
    again = [*line[1:], "--no-video", "--json", "--out", str(tmp_path / "d")]
    assert cli.main(again) == 1
    found = json.loads(capsys.readouterr().out)
    assert found["summary"]["impact_speed_mps"] == float(hit["impact_speed_mps"]) > 10.0
    assert found["summary"]["distance_m"] == float(hit["distance_m"])
    assert found["greatest_deceleration_mps2"] == float(hit["deceleration_mps2"])


def test_a_fault_of_the_program_is_a_row_too(monkeypatch):
    def fail(point, asked):
        raise ZeroDivisionError("by nothing")

    class AnySweep:
        def asked(self, point):
            return None

    monkeypatch.setattr(sweep_runs, "_driven", fail)
    run = sweep_runs.drive_point((("gap", "1"),), AnySweep())
    assert run.error == "ZeroDivisionError: by nothing"
    monkeypatch.setattr(sweep_runs, "_driven", lambda *_: (_ for _ in ()).throw(Error("over")))
    assert sweep_runs.drive_point((("gap", "1"),), AnySweep()).error == "Error: over"
