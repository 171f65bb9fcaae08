"""The commands `drive --can-log` and `replay-can`."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import pytest

from iits_mj import cli
from iits_mj.core.messages import VehicleCommand, XbrMode
from iits_mj.j1939 import LogWriter, command_to_frames, pgn_of, read_log
from tests.paths import outside

Capture = pytest.CaptureFixture[str]


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("drive")
    words = ["drive", "--duration", "2", "--no-video", "--seed", "3", "--payload", "9000"]
    words += ["--start-speed", "12", "--commands", "j1939"]
    assert cli.main([*words, "--out", str(out), "--can-log", str(out / "bus.asc")]) == 0
    return out


def rows(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def telemetry(out: Path) -> list[dict[str, str]]:
    return rows(out / "telemetry.csv")


def test_log_of_a_drive_in_traffic_gives_the_same_motion_on_an_empty_road(
    drive: Path, tmp_path: Path, capsys: Capture
) -> None:
    words = ["replay-can", str(drive / "bus.asc"), "--payload", "9000", "--start-speed", "12"]
    assert cli.main([*words, "--out", str(tmp_path)]) == 0
    shown = capsys.readouterr().out
    assert "reached the end of the log" in shown
    assert "frames rejected" in shown
    assert "100 x XBR" in shown
    before, after = telemetry(drive), telemetry(tmp_path)
    assert len(before) == len(after) == 21
    for name in ("x [m]", "y [m]", "yaw [rad]", "speed [m/s]", "fuel_used [kg]", "gear [-]"):
        assert [row[name] for row in before] == [row[name] for row in after]
    assert {row["planned_speed [m/s]"] for row in after} == {""}
    assert (tmp_path / "report.html").is_file()


def test_json_of_a_drive_by_a_log_counts_accepted_and_rejected_frames(
    tmp_path: Path, capsys: Capture
) -> None:
    log = tmp_path / "bus.log"
    with LogWriter(log) as writer:
        for cycle in range(60):
            # A counter that repeats for one cycle and then jumps.
            counter = 9 if cycle == 10 else cycle
            for frame in command_to_frames(VehicleCommand(0.4), counter, 0.02 * cycle):
                writer.write(frame)
    assert cli.main(["replay-can", str(log), "--out", str(tmp_path / "out"), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["command"] == "replay-can"
    assert found["accepted"]["EEC2"] == 60
    assert found["accepted"]["XBR"] == 59
    sealed = ("XBR", "IITS_COMMAND", "TSC1 to 15", "TSC1 to 16")
    assert found["rejected"] == {f"{name}: counter repeated": 1 for name in sealed}
    assert found["lost"]["XBR"] == 1


def test_decoding_writes_a_table_and_does_not_drive(
    drive: Path, tmp_path: Path, capsys: Capture
) -> None:
    table = tmp_path / "table.csv"
    assert cli.main(["replay-can", str(drive / "bus.asc"), "--decode", str(table)]) == 0
    shown = capsys.readouterr().out
    assert "engine_speed_rpm" in shown
    assert "distance" not in shown
    speeds = [float(r["value"]) for r in rows(table) if r["signal"] == "wheel_based_speed_kph"]
    assert speeds[0] == pytest.approx(12.0 * 3.6, rel=0.02)
    assert not [r for r in rows(table) if r["status"] == "not available"]
    few = len(rows(table))
    words = ["replay-can", str(drive / "bus.asc"), "--decode", str(table), "--all-signals"]
    assert cli.main(words) == 0
    assert len(rows(table)) > few


def test_json_of_a_decoded_log_summarizes_the_bus(
    drive: Path, tmp_path: Path, capsys: Capture
) -> None:
    words = ["replay-can", str(drive / "bus.asc"), "--decode", str(tmp_path / "t.csv"), "--json"]
    assert cli.main(words) == 0
    found = json.loads(capsys.readouterr().out)
    brakes = next(g for g in found["groups"] if g["message"] == "XBR")
    assert (brakes["pgn"], brakes["source"], brakes["destination"]) == (1024, 42, 11)
    assert (brakes["count"], brakes["period_s"]) == (100, pytest.approx(0.02))
    engine = next(g for g in found["groups"] if g["message"] == "EEC1")
    assert 500.0 < engine["signals"]["engine_speed_rpm"]["minimum"] < 2500.0
    assert found["long_messages"] == 3
    assert found["long_message_failures"] == {}


@pytest.mark.parametrize("flag", ["--decode", "--can-log"])
def test_a_log_is_never_overwritten_by_its_own_output(
    flag: str, tmp_path: Path, capsys: Capture
) -> None:
    log, other = tmp_path / "bus.csv", tmp_path / "link.csv"
    with LogWriter(log) as writer:
        for frame in command_to_frames(VehicleCommand(), 0):
            writer.write(frame)
    other.symlink_to(log)
    before = log.read_bytes()
    for path in (log, other):
        assert cli.main(["replay-can", str(log), flag, str(path), "--out", str(tmp_path)]) == 2
        assert "name another file" in capsys.readouterr().err
    assert log.read_bytes() == before


@pytest.fixture(scope="module")
def revved(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Log of 1.5 s of a recorded truck whose driver presses the pedal."""
    recorded = outside("j1939/KWTruck.txt")
    path = tmp_path_factory.mktemp("revved") / "revved.log"
    first = None
    with LogWriter(path) as writer:
        for frame in read_log(recorded):
            first = frame.time if first is None else first
            if frame.time - first >= 30.0:
                writer.write(frame)
            if frame.time - first > 31.5:
                break
    return path


def test_recorded_pedal_drives_the_truck_in_its_lane(
    revved: Path, tmp_path: Path, capsys: Capture
) -> None:
    words = ["replay-can", str(revved), "--source", "0", "--keep-lane", "--out", str(tmp_path)]
    assert cli.main(words) == 0
    assert "x EEC2" in capsys.readouterr().out
    pedals = [float(row["command_accelerator_pedal [-]"]) for row in telemetry(tmp_path)]
    assert max(pedals) > 0.05


def test_recorded_pedal_is_not_obeyed_without_steering(
    revved: Path, tmp_path: Path, capsys: Capture
) -> None:
    assert cli.main(["replay-can", str(revved), "--source", "0", "--out", str(tmp_path)]) == 0
    assert "--keep-lane" in capsys.readouterr().err
    assert "No steering command" in (tmp_path / "report.html").read_text()
    assert {row["command_accelerator_pedal [-]"] for row in telemetry(tmp_path)} == {"0"}


@pytest.mark.parametrize(
    ("words", "reported"),
    [
        (["replay-can"], "FILE"),
        (["replay-can", "missing.asc"], "missing.asc"),
        (["replay-can", "missing.asc", "--decode", "table.csv"], "missing.asc"),
        (["replay-can", "README.md"], "cannot be read"),
        (["replay-can", "x.asc", "--source", "300"], "0 to 253"),
        (["replay-can", "x.asc", "--duration", "nan"], "finite"),
        (["drive", "--commands", "bytes"], "direct, j1939"),
        (["drive", "--duration", "1", "--no-video", "--can-log", "bus.xyz"], ".asc"),
    ],
)
def test_wrong_use_is_one_line(
    words: list[str],
    reported: str,
    tmp_path: Path,
    capsys: Capture,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "README.md").write_text("# Not a log\n")
    assert cli.main(words) == 2
    captured = capsys.readouterr()
    assert reported in captured.err
    assert captured.err.count("\n") == 1
    assert captured.out == ""


def test_two_senders_of_a_brake_demand_in_a_log_are_named(tmp_path: Path, capsys: Capture) -> None:
    log = tmp_path / "bus.log"
    braking = VehicleCommand(xbr_demand=-1.0, xbr_mode=XbrMode.MAXIMUM)
    with LogWriter(log) as writer:
        for cycle in range(60):
            for frame in command_to_frames(VehicleCommand(0.4), cycle, 0.02 * cycle):
                writer.write(frame)
            for frame in command_to_frames(braking, cycle, 0.02 * cycle, source=0x2B):
                if frame.pgn == pgn_of("XBR"):
                    writer.write(frame)
    assert cli.main(["replay-can", str(log), "--out", str(tmp_path / "out")]) == 0
    error = capsys.readouterr().err
    assert "XBR was obeyed from several senders (0x2A, 0x2B): --source selects one." in error
