"""The commands `drive`, `record`, `replay` and `view`, without a display."""

from __future__ import annotations

import csv
import hashlib
import json
import math
import re
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path

import mujoco
import pytest

from controllers.stack import Stack
from iits_mj import cli
from iits_mj.core.messages import EgoState, VehicleCommand
from iits_mj.core.output_files import OutputFile
from iits_mj.simulation import Simulation
from iits_mj.truck import Truck
from tests.render.drives import Content

SHORT = ("--duration", "2", "--seed", "3")


def listing(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


def test_drive_writes_telemetry_summary_and_a_self_contained_report(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    out.mkdir()
    (out / "mine.txt").write_text("keep me")
    assert cli.main(["drive", *SHORT, "--no-video", "--out", str(out)]) == 0
    assert listing(out) == {
        "mine.txt",
        "report.html",
        "telemetry.csv",
        "summary.json",
    }
    shown = capsys.readouterr().out
    for figure in ("distance", "mean speed", "lane changes", "closest gap", "fuel", "real-time"):
        assert figure in shown
    text = (out / "report.html").read_text()
    content = Content(text)
    assert content.sources == []
    command = f"iits-mj drive --duration 2 --seed 3 --out {out} --no-video"
    digest = hashlib.sha256((out / "telemetry.csv").read_bytes()).hexdigest()
    for shown in (command, digest[:16], f"MuJoCo {mujoco.__version__}", "SUMO 1.28.0"):
        assert shown in content.words()
    assert not re.search(r"\b(None|nan)\b", content.words())
    provenance = json.loads((out / "summary.json").read_text())["provenance"]
    assert provenance["telemetry_sha256"] == digest
    assert len(list(csv.reader((out / "telemetry.csv").open()))) == 22
    summary = json.loads((out / "summary.json").read_text())["summary"]
    assert summary["duration_s"] == pytest.approx(2.0)
    assert 25.0 < summary["distance_m"] < 35.0
    assert summary["warnings"] == {}


def test_drive_with_json_prints_one_object(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["drive", *SHORT, "--no-video", "--json", "--traffic-mode", "none"]
    assert cli.main([*words, "--out", str(tmp_path)]) == 0
    captured = capsys.readouterr()
    assert json.loads(captured.out)["command"] == "drive"
    assert json.loads(captured.out)["seed"] == 3
    assert captured.err == ""


def test_drive_without_opengl_reports_why_there_is_no_video(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MUJOCO_GL", "off")
    words = ["drive", *SHORT, "--traffic-mode", "none", "--size", "64x64"]
    assert cli.main([*words, "--out", str(tmp_path)]) == 0
    captured = capsys.readouterr()
    assert len(captured.err.strip().splitlines()) == 1
    assert "driving without a video" in captured.err
    assert "MUJOCO_GL=off switches pictures off" in captured.err
    assert "There is no video" in (tmp_path / "report.html").read_text()
    assert "drive.mp4" not in listing(tmp_path)
    assert not [name for name in listing(tmp_path) if "partial" in name]


def test_interrupted_drive_keeps_its_telemetry_and_report(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    cycle = Simulation.cycle

    def interrupted(self: Simulation, *arguments: object) -> object:
        if self.time > 0.95:
            raise KeyboardInterrupt
        return cycle(self, *arguments)  # type: ignore[arg-type]

    monkeypatch.setattr(Simulation, "cycle", interrupted)
    words = ["drive", *SHORT, "--no-video", "--traffic-mode", "none", "--out", str(tmp_path)]
    assert cli.main(words) == 130
    assert "interrupted" in capsys.readouterr().out
    assert len(list(csv.reader((tmp_path / "telemetry.csv").open()))) == 12
    assert (tmp_path / "report.html").is_file()


def test_drive_that_rolls_over_ends_there_and_fails(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def turn(self: Stack, ego: EgoState) -> VehicleCommand:
        return VehicleCommand(steering_wheel_angle=15.0)

    monkeypatch.setattr(Stack, "control", turn)
    words = ["drive", "--no-video", "--traffic-mode", "none", "--speed", "24"]
    words += ["--start-speed", "24", "--out", str(tmp_path)]
    assert cli.main(words) == 1
    assert "rolled over at t = " in capsys.readouterr().out
    assert "rolled over at t = " in (tmp_path / "report.html").read_text()
    summary = json.loads((tmp_path / "summary.json").read_text())["summary"]
    assert summary["failed"]
    assert not summary["collision"]
    assert 1.0 < summary["duration_s"] < 3.0


def test_drive_that_diverges_keeps_its_telemetry_and_report(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    step = Truck.step

    def broken(self: Truck, n: int = 1) -> None:
        if self.time > 0.95:
            self.data.qvel[0] = math.nan
        step(self, n)

    monkeypatch.setattr(Truck, "step", broken)
    words = ["drive", *SHORT, "--no-video", "--traffic-mode", "none", "--out", str(tmp_path)]
    assert cli.main(words) == 1
    assert "the simulation diverged" in capsys.readouterr().out
    assert len(list(csv.reader((tmp_path / "telemetry.csv").open()))) == 11
    summary = json.loads((tmp_path / "summary.json").read_text())["summary"]
    assert summary["failed"]
    assert summary["duration_s"] == pytest.approx(0.9)
    assert (tmp_path / "report.html").is_file()


def test_recording_is_verified_bit_for_bit_and_replayed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "traffic.npz"
    assert cli.main(["record", str(path), *SHORT]) == 0
    assert cli.main(["replay", str(path), "--verify"]) == 0
    assert "bit for bit, 21 frames" in capsys.readouterr().out
    words = ["replay", str(path), "--duration", "1", "--no-video", "--out", str(tmp_path / "out")]
    assert cli.main(words) == 0
    assert "report.html" in listing(tmp_path / "out")


def test_damaged_recording_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "traffic.npz"
    path.write_bytes(b"PK\x03\x04 nothing")
    assert cli.main(["replay", str(path), "--no-video", "--out", str(tmp_path)]) == 2
    assert len(capsys.readouterr().err.strip().splitlines()) == 1


class Window:
    """Replaces MuJoCo's viewer, which needs a display; closes after 20 pictures."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        self.cam = mujoco.MjvCamera()
        self.pictures = 0
        assert data.time == 0.0
        assert model.body("tractor").id > 0

    def __enter__(self) -> Window:
        return self

    def __exit__(self, *arguments: object) -> None:
        assert self.pictures == 20

    def is_running(self) -> bool:
        return self.pictures < 20

    def sync(self) -> None:
        self.pictures += 1


def test_view_shows_the_drive_until_the_window_is_closed(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("DISPLAY", ":9")
    monkeypatch.setattr("mujoco.viewer.launch_passive", Window)
    assert cli.main(["view", "--traffic-mode", "none", "--pace", "20"]) == 0
    assert "the window was closed" in capsys.readouterr().out


@pytest.mark.slow
def test_twenty_five_minutes_leave_no_warning_and_no_nan(tmp_path: Path) -> None:
    words = ["drive", "--duration", "1500", "--no-video", "--density", "medium"]
    assert cli.main([*words, "--speed", "9", "--out", str(tmp_path)]) == 0
    summary = json.loads((tmp_path / "summary.json").read_text())["summary"]
    assert summary["warnings"] == {}
    assert summary["duration_s"] == pytest.approx(1500.0) or "end of the route" in summary["ended"]
    assert summary["distance_m"] > 10_000.0


def test_two_drives_into_one_folder_do_not_mix(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["drive", *SHORT, "--no-video", "--traffic-mode", "none", "--out", str(tmp_path)]
    with OutputFile(tmp_path / "telemetry.csv", "telemetry") as partial:
        partial.write_text("of the first drive")
        assert cli.main(words) == 2
        assert "another process is writing it" in capsys.readouterr().err
    assert (tmp_path / "telemetry.csv").read_text() == "of the first drive"
    assert listing(tmp_path) == {"telemetry.csv"}


def test_drive_on_a_full_disk_names_the_file_and_keeps_the_old_one(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    full_disk: Callable[[int], AbstractContextManager[None]],
) -> None:
    (tmp_path / "telemetry.csv").write_text("old")
    words = ["drive", *SHORT, "--no-video", "--traffic-mode", "none", "--out", str(tmp_path)]
    with full_disk(3000):
        assert cli.main(words) == 2
    error = capsys.readouterr().err
    assert "telemetry.csv' cannot be written: File too large" in error
    assert len(error.strip().splitlines()) == 1
    assert (tmp_path / "telemetry.csv").read_text() == "old"
    assert listing(tmp_path) == {"telemetry.csv"}


def test_a_drive_beyond_the_range_of_its_plant_says_so(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    limit = "a wheel has lifted off the road"
    monkeypatch.setattr(Truck, "left_range", (limit,))
    options = ("--plant", "yaw-sideslip", "--no-video", "--traffic-mode", "none")
    assert cli.main(["drive", *SHORT, *options, "--out", str(tmp_path)]) == 0
    text = f"The plant yaw-sideslip was not valid all the time: {limit}."
    assert capsys.readouterr().err.count(text) == 1
    assert text in (tmp_path / "report.html").read_text()
    assert limit in (tmp_path / "summary.json").read_text()


def test_replay_in_3d_lies_beside_the_report_which_opens_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["drive", *SHORT, "--no-video", "--traffic-mode", "none", "--out", str(tmp_path)]
    assert cli.main([*words, "--replay"]) == 0
    assert f"replay in 3-D: {tmp_path / 'replay.html'}" in capsys.readouterr().out
    content = Content((tmp_path / "report.html").read_text())
    assert content.sources == ["replay.html"]
    button = next(e for e in content.of("button") if e.get("id") == "replay")
    assert (tmp_path / str(button["data-source"])).stat().st_size > 1_000_000
