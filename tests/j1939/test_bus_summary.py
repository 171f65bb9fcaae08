import csv
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from iits_mj.core.errors import BusError, InputError
from iits_mj.j1939 import (
    BusReader,
    Failure,
    Frame,
    Status,
    VehicleIdentification,
    broadcast,
    encode,
    make_id,
    summarize,
    write_table,
)
from iits_mj.j1939.bus_summary import COLUMNS
from iits_mj.j1939.groups import EEC1, VW


def log():
    frames = [
        encode(EEC1(engine_speed_rpm=600.0 + 0.125 * i, engine_torque_mode=1.0), time=0.02 * i)
        for i in range(11)
    ]
    frames.append(encode(EEC1(engine_speed_rpm=Status.ERROR), time=0.22))
    frames.append(Frame(make_id(6, 65000, 0x17), b"\x01\xab", 0.23))
    frames.append(Frame(make_id(3, 61444, 0), b"\x00" * 3, 0.24))
    return frames + broadcast(65260, VehicleIdentification("1ABC" * 4).to_bytes(), 0, time=0.3)


def table(tmp_path, frames, **options):
    path = tmp_path / "table.csv"
    summary = write_table(frames, path, **options)
    with path.open(newline="") as file:
        return list(csv.DictReader(file)), summary


def test_every_signal_of_every_frame_is_a_row(tmp_path):
    rows, _ = table(tmp_path, log())
    assert tuple(rows[0]) == COLUMNS
    speeds = [row for row in rows if row["signal"] == "engine_speed_rpm"]
    assert [row["value"] for row in speeds] == [f"{600 + 0.125 * i:g}" for i in range(11)] + [""]
    assert speeds[1] == {
        "time_s": "0.020000",
        "priority": "3",
        "pgn": "61444",
        "message": "EEC1",
        "source": "0",
        "destination": "255",
        "signal": "engine_speed_rpm",
        "spn": "190",
        "value": "600.125",
        "unit": "rpm",
        "status": "ok",
    }
    assert speeds[-1]["status"] == "error"


def test_unknown_and_malformed_frames_are_listed_with_their_bytes(tmp_path):
    rows, _ = table(tmp_path, log())
    (row,) = [row for row in rows if row["pgn"] == "65000"]
    assert (row["message"], row["signal"], row["value"], row["unit"]) == ("", "data", "01ab", "hex")
    assert row["status"] == "unknown group"
    (row,) = [row for row in rows if row["status"] == "wrong length"]
    assert (row["message"], row["value"]) == ("EEC1", "000000")


def test_a_long_message_follows_its_last_packet(tmp_path):
    rows, summary = table(tmp_path, log())
    row = rows[-1]
    assert (row["message"], row["pgn"], row["priority"], row["spn"]) == ("VI", "65260", "", "237")
    assert row["value"] == "1ABC" * 4
    assert row["time_s"] == "0.450000"
    packets = [r for r in rows if r["status"] == "part of a long message"]
    assert [r["message"] for r in packets] == ["TP.CM", "TP.DT", "TP.DT", "TP.DT"]
    assert summary.transport.messages == 1


def test_unavailable_signals_can_be_omitted(tmp_path):
    rows, _ = table(tmp_path, log(), only_values=True)
    assert {row["status"] for row in rows if not row["value"]} == {"error"}
    assert {row["signal"] for row in rows if row["message"] == "EEC1"} == {
        "engine_torque_mode",
        "engine_speed_rpm",
        "data",
    }


def test_table_keeps_the_resolution_of_the_signals(tmp_path):
    frames = [encode(VW(axle_location=16.0, axle_weight_kg=9677.5), time=1_753_900_000.123456)]
    rows, _ = table(tmp_path, frames)
    assert rows[0]["time_s"] == "1753900000.123456"
    assert {row["signal"]: row["value"] for row in rows if row["value"]} == {
        "axle_location": "16",
        "axle_weight_kg": "9677.5",
    }


def test_summary_has_count_period_and_bounds_per_sender():
    frames = [*log(), encode(EEC1(engine_speed_rpm=900.0), source=0x31, time=1.0)]
    summary = summarize(frames)
    engine = summary.traffic[61444, 0, 255]
    assert (engine.message, engine.count, engine.invalid) == ("EEC1", 13, 1)
    assert engine.period == pytest.approx(0.02)
    speed = engine.signals["engine_speed_rpm"]
    assert (speed.minimum, speed.maximum, speed.unit, speed.missing) == (600.0, 601.25, "rpm", 1)
    assert summary.traffic[61444, 0x31, 255].count == 1
    text = summary.text()
    assert "600 .. 601.25 rpm" in text
    assert "1 of the wrong length" in text
    assert "'1ABC1ABC1ABC1ABC'" in text
    assert "long messages put together: 1" in text


def test_summary_counts_lost_long_messages():
    summary = summarize(log()[:-1])
    assert summary.transport.failures == {Failure.TIME_OUT: 1}
    assert "long messages, time-out: 1" in summary.text()


def test_summary_of_an_empty_log_is_empty():
    summary = summarize([])
    assert summary.traffic == {}
    assert len(summary.text().splitlines()) == 2


def test_a_failed_table_leaves_no_file(tmp_path):
    with pytest.raises(InputError, match=r"table .*cannot be written"):
        write_table(log(), tmp_path / "missing" / "table.csv")

    def broken():
        yield log()[0]
        raise BusError("cut off")

    with pytest.raises(BusError, match="cut off"):
        write_table(broken(), tmp_path / "table.csv")
    assert not list(tmp_path.iterdir())
    link = tmp_path / "stdout"
    link.symlink_to("/dev/null")
    with pytest.raises(BusError, match="cut off"):
        write_table(broken(), link)
    assert link.is_symlink()
    with pytest.raises(InputError, match="table '/dev/full' cannot be written: No space left"):
        write_table(log(), "/dev/full")


def test_an_older_table_stays_whole_on_a_full_disk(tmp_path, full_disk):
    path = tmp_path / "table.csv"
    path.write_text("old")
    with full_disk(1000), pytest.raises(InputError, match=r"table .*table.csv' cannot be written"):
        write_table(log() * 20, path)
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_an_interrupted_table_leaves_no_file(tmp_path):
    def interrupted():
        yield log()[0]
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_table(interrupted(), tmp_path / "table.csv")
    assert not list(tmp_path.iterdir())


def test_a_write_protected_file_keeps_its_content(tmp_path, monkeypatch):
    path = tmp_path / "table.csv"
    path.write_text("kept")

    def refused(*_args, **_options):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "open", refused)
    with pytest.raises(InputError, match="Permission denied"):
        write_table(log(), path)
    monkeypatch.undo()
    assert path.read_text() == "kept"


@settings(max_examples=200, deadline=None)
@given(
    st.builds(
        lambda pgn, source, data, time: Frame(make_id(6, pgn, source), data, time),
        st.sampled_from([61444, 65226, 65242, 65251, 65259, 65260, 0xEB00, 0xEC00])
        | st.integers(0, 0x3FFFF),
        st.integers(0, 255),
        st.binary(max_size=8),
        st.floats(0.0, 1e6),
    )
)
def test_any_frame_can_be_read(frame):
    (reading,) = BusReader().read(frame)
    assert (reading.pgn, reading.source) == (frame.pgn, frame.source)
    assert reading.entries or reading.message == "SOFT"
