import base64
import gzip
import math
import struct
import zlib

import can
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from iits_mj.core.errors import BusError
from iits_mj.j1939 import Frame, LogWriter, read_log

SUFFIXES = [".asc", ".blf", ".csv", ".log", ".trc", ".asc.gz", ".csv.gz", ".log.gz"]
FRAMES = [
    Frame(0x0CF00400, bytes(range(8)), 1.000001),
    Frame(0x18FEF100, b"\x01\x02\x03", 1.000002),
    Frame(0x00000001, b"", 1.5),
    Frame(0x1FFFFFFF, b"\xff" * 8, 12.345678),
]


def write(path, frames):
    with LogWriter(path) as writer:
        for frame in frames:
            writer.write(frame)
    return path


def moved(frames, by):
    return [Frame(f.can_id, f.data, round(f.time + by, 6)) for f in frames]


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("start", [0.0, 1_753_900_000.25])
def test_log_is_read_back_with_its_times(tmp_path, suffix, start):
    frames = moved(FRAMES, start)
    path = write(tmp_path / f"drive{suffix}", frames)
    assert list(read_log(path)) == frames


@settings(
    max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(
    suffix=st.sampled_from(SUFFIXES),
    start=st.integers(0, 2_000_000_000 * 10**6),
    steps=st.lists(st.integers(0, 3 * 10**6), max_size=8),
)
def test_times_are_kept_to_the_microsecond(tmp_path, suffix, start, steps):
    times = [start + sum(steps[:i]) for i in range(len(steps) + 1)]
    frames = [Frame(0x18FEF100, b"\x00" * 8, round(time * 1e-6, 6)) for time in times]
    path = write(tmp_path / f"drive{suffix}", frames)
    assert [round(f.time * 1e6) for f in read_log(path)] == times


@pytest.mark.parametrize("suffix", [".asc", ".blf", ".csv", ".log", ".trc"])
def test_other_tools_read_our_logs_as_extended_frames(tmp_path, suffix):
    path = write(tmp_path / f"drive{suffix}", moved(FRAMES, 1_753_900_000.0))
    with can.LogReader(path) as reader:
        messages = list(reader)
    assert [(m.arbitration_id, bytes(m.data)) for m in messages] == [
        (f.can_id, f.data) for f in FRAMES
    ]
    assert all(m.is_extended_id and not m.is_fd and not m.is_remote_frame for m in messages)
    first = messages[0].timestamp
    for message, frame in zip(messages, FRAMES, strict=True):
        assert message.timestamp - first == pytest.approx(frame.time - FRAMES[0].time, abs=1e-6)


@pytest.mark.parametrize("suffix", [".asc", ".blf", ".csv", ".log"])
def test_frames_of_other_kinds_are_omitted(tmp_path, suffix):
    path = tmp_path / f"mixed{suffix}"
    with can.Logger(path) as logger:
        logger(can.Message(timestamp=1.0, arbitration_id=0x123, is_extended_id=False, data=b"a"))
        logger(can.Message(timestamp=1.1, arbitration_id=0x18FEF100, is_remote_frame=True))
        logger(can.Message(timestamp=1.2, is_error_frame=True))
        logger(can.Message(timestamp=1.3, arbitration_id=0x18FEF100, data=b"abc"))
    assert [(f.can_id, f.data) for f in read_log(path)] == [(0x18FEF100, b"abc")]


def test_can_fd_frames_are_omitted(tmp_path):
    path = tmp_path / "fd.log"
    path.write_text("(1.0) can0 18FEF100##1001122334455667788\n(2.0) can0 18FEF100#00 R\n")
    assert [(f.data, f.time) for f in read_log(path)] == [(b"\x00", 2.0)]


def test_times_of_a_log_do_not_decrease(tmp_path):
    frames = [Frame(1, b"", 5.0), Frame(2, b"", 4.0), Frame(3, b"", 6.0)]
    for suffix in SUFFIXES:
        path = write(tmp_path / f"back{suffix}", frames)
        assert [f.time for f in read_log(path)] == [5.0, 5.0, 6.0]


CONSOLE = """
 (000.000000)  can1  18F11031   [8]  00 01 FF ff FF FF FF FF
 (001.500041)  can1  18EBFF00   [3]  01 02 03   '...'
 (001.500042)  can0       123   [2]  01 02
 (001.600000)  vcan0  RX - -  0CF00400   [1]  7D
 (001.700000)  can0  TX B E  0CF00400  [12]  00 00 00 00 00 00 00 00 00 00 00 00
 (001.800000)  can0  20000004   [8]  00 02 00 00 00 00 00 00   ERRORFRAME
 (001.900000)  can0  18EA00F9   [3]  remote request
 (002.000000)  can0  18EAFF00   [0]
"""


@pytest.mark.parametrize("name", ["drive.txt", "drive.log", "no_suffix"])
def test_console_text_of_candump_is_read_from_a_file_of_any_name(tmp_path, name):
    path = tmp_path / name
    path.write_text(CONSOLE)
    assert list(read_log(path)) == [
        Frame(0x18F11031, b"\x00\x01" + b"\xff" * 6, 0.0),
        Frame(0x18EBFF00, b"\x01\x02\x03", 1.500041),
        Frame(0x0CF00400, b"\x7d", 1.6),
        Frame(0x18EAFF00, b"", 2.0),
    ]


def test_console_text_with_dates_counts_from_1970(tmp_path, monkeypatch):
    path = tmp_path / "drive.txt"
    path.write_text(
        " (2026-01-02 03:04:05.000001)  can1  18F11031   [1]  00\n"
        " (2026-01-02 03:04:06.000003)  can1  18F11031   [1]  00\n"
    )
    first, second = (frame.time for frame in read_log(path))
    assert first > 1.7e9
    assert second - first == pytest.approx(1.000002, abs=1e-6)


def test_an_incomplete_last_line_is_dropped_and_one_in_the_middle_is_an_error(tmp_path):
    line = " (000.000000)  can1  18F11031   [8]  00 01 FF FF FF FF FF FF\n"
    path = tmp_path / "drive.txt"
    path.write_text(line + line[:50])
    assert len(list(read_log(path))) == 1
    path.write_text(line + line[:50] + "\n" + line)
    frames = read_log(path)
    assert next(frames).can_id == 0x18F11031
    with pytest.raises(BusError, match=r"drive\.txt.*line 2"):
        next(frames)


def block(records):
    rows = [
        struct.pack("<IIII8s", 1_700_000_000 + i, 0, 0x0800_0000 | 250_000, 0x18FEF10B, bytes(8))
        for i in range(records)
    ]
    return (struct.pack("<I", records) + b"".join(rows)).ljust(508, b"\x00") + b"\x5a" * 4


def test_a_loggers_blocks_are_read_with_their_microseconds(tmp_path):
    path = tmp_path / "logger.bin"
    path.write_bytes(block(21) + block(3))
    frames = list(read_log(path))
    assert len(frames) == 24
    assert frames[2] == Frame(0x18FEF10B, bytes(8), 1_700_000_002.25)
    path.write_bytes(block(21) + block(3)[:-1])
    with pytest.raises(BusError, match="block 1 is cut off after 511"):
        list(read_log(path))
    path.write_bytes(block(21) + b"\xff" * 512)
    with pytest.raises(BusError, match="block 1 does not hold"):
        list(read_log(path))


def test_a_log_with_a_wrong_suffix_is_read(tmp_path):
    for suffix in [".asc", ".blf", ".csv", ".log", ".trc"]:
        right = write(tmp_path / f"a{suffix}", FRAMES)
        wrong = right.rename(tmp_path / "wrong.bin")
        assert list(read_log(wrong)) == FRAMES


def test_python_cans_database_is_read(tmp_path):
    path = tmp_path / "drive.db"
    with can.Logger(path) as logger:
        logger(can.Message(timestamp=1.25, arbitration_id=0x18FEF100, data=b"abc"))
    assert list(read_log(path)) == [Frame(0x18FEF100, b"abc", 1.25)]


def test_asc_of_another_tool_is_read_with_its_date(tmp_path):
    lines = (
        "date Sat Sep 30 15:06:13.191 2017\nbase hex  timestamps absolute\n"
        "internal events logged\n{}"
        "   1.500000 1  18FEF100x       Rx   d 3 01 02 03  Length = 0 BitCount = 64\n"
    )
    path = tmp_path / "drive.asc"
    path.write_text(lines.format("Begin Triggerblock Sat Sep 30 15:06:14.000 2017\n"))
    (frame,) = read_log(path)
    assert frame.time % 60 == pytest.approx(15.5)
    assert frame.time > 1.5e9
    path.write_text(lines.format("").replace("date", "// date"))
    (frame,) = read_log(path)
    assert frame.time == 1.5
    path.write_text(lines.format("").replace("absolute", "relative"))
    with pytest.raises(BusError, match="absolute ones are needed"):
        list(read_log(path))


@pytest.mark.parametrize("name", ["drive.log", "drive.txt", "drive.trc"])
def test_an_empty_log_has_no_frames(tmp_path, name):
    path = tmp_path / name
    path.write_text("\n")
    assert list(read_log(path)) == []


@pytest.mark.parametrize(
    ("name", "bytes_", "why"),
    [
        ("x.log", b"hello\n", "none of"),
        ("x.csv", b"time,speed\n0,1\n", "none of"),
        ("x.blf", b"", "empty"),
        ("x.blf", b"LOGG", "unpack"),
        ("x.log", b"(1.0) can0 18FEF100#00\n(garbage\n", "unpack"),
        ("x.log", b"(nan) can0 18FEF100#00\n", "none of"),
        ("x.log", b"(1.0) can0 18FEF100#00\n(nan) can0 18FEF100#00\n", "nan"),
        ("x.txt", b" (" + b"9" * 400 + b".0)  can0  18FEF100   [0]\n", "inf"),
        ("x.csv", b"timestamp,arbitration_id,x\n1,2\n", "unpack"),
        ("x.db", b"SQLite format 3\0 and no more", "database"),
        ("x.asc.gz", gzip.compress(b"date x\n" * 10, mtime=0)[:-9], "end"),
    ],
)
def test_a_damaged_or_foreign_file_is_named_in_the_error(tmp_path, name, bytes_, why):
    path = tmp_path / name
    path.write_bytes(bytes_)
    with pytest.raises(BusError, match=rf"(?s)CAN log .*{name}.*cannot be read.*{why}"):
        list(read_log(path))


def test_missing_files_and_folders_are_named_in_the_error(tmp_path):
    with pytest.raises(BusError, match=r"missing\.asc.*No such file"):
        list(read_log(tmp_path / "missing.asc"))
    with pytest.raises(BusError, match="cannot be read"):
        list(read_log(tmp_path))
    with pytest.raises(BusError, match="cannot be written"):
        LogWriter(tmp_path / "missing" / "drive.asc")


@pytest.mark.parametrize("name", ["drive.txt", "drive", "drive.blf.gz", "drive.mf4", "drive.db"])
def test_an_unknown_suffix_is_refused_with_the_allowed_ones(tmp_path, name):
    with pytest.raises(BusError, match=r"must be one of \.asc, \.blf"):
        LogWriter(tmp_path / name)
    assert not list(tmp_path.iterdir())


def test_a_writer_refuses_invalid_times_and_frames_after_closing(tmp_path):
    writer = LogWriter(tmp_path / "drive.log")
    for time in (math.nan, math.inf, -1e-6, 1e12):
        with pytest.raises(BusError, match="allowed"):
            writer.write(Frame(1, b"", time))
    writer.write(Frame(1, b"", 0.0))
    writer.close()
    writer.close()
    with pytest.raises(BusError, match="closed"):
        writer.write(Frame(1, b"", 1.0))
    assert list(read_log(tmp_path / "drive.log")) == [Frame(1, b"", 0.0)]


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("times", [(0.0, 1e10), (1.7e9, 1e10)])
def test_every_format_stores_every_allowed_time(tmp_path, suffix, times):
    path = tmp_path / f"drive{suffix}"
    with LogWriter(path) as writer:
        for time in times:
            writer.write(Frame(0x18FEF100, bytes(8), time))
    assert [frame.time for frame in read_log(path)] == pytest.approx(times, rel=1e-12)


SAMPLES = {
    ".asc": b"date Sat Sep 30 15:06:13 2017\nbase hex timestamps absolute\n",
    ".blf": b"LOGG",
    ".csv": b"timestamp,arbitration_id,extended,remote,error,dlc,data\n1.0,0x1,1,0,0,1,"
    + base64.b64encode(b"a"),
    ".log": b"(1.0) can0 18FEF100#00\n",
    ".trc": b";$FILEVERSION=2.1\n;$STARTTIME=42000.5\n;$COLUMNS=N,O,T,B,I,d,R,L,D\n",
    ".txt": b" (000.000000)  can1  18F11031   [1]  00\n",
    ".bin": block(2),
}


@settings(
    max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(
    suffix=st.sampled_from(list(SAMPLES)),
    rest=st.binary(max_size=600) | st.text("0123456789ABCDEFx#() \n.[],;DTdrR", max_size=200),
)
def test_any_file_gives_frames_or_a_bus_error(tmp_path, suffix, rest):
    path = tmp_path / f"any{suffix}"
    path.write_bytes(SAMPLES[suffix] + (rest.encode() if isinstance(rest, str) else rest))
    frames, said = [], str(path)
    try:
        frames = list(read_log(path))
    except BusError as error:
        said = str(error)
    assert str(path) in said
    assert all(math.isfinite(frame.time) for frame in frames)


def test_a_blf_object_without_a_size_is_refused_and_not_read_without_end(tmp_path):
    path = write(tmp_path / "log.blf", FRAMES[:1])
    raw = path.read_bytes()
    start = raw.index(b"LOBJ")
    content = bytearray(zlib.decompress(raw[start + 32 :]))
    content[8:12] = bytes(4)  # the object's size
    container = struct.pack("<4sHHIIH6xI4x", b"LOBJ", 16, 1, 32 + len(content), 10, 0, len(content))
    path.write_bytes(raw[:start] + container + content)
    with pytest.raises(BusError, match="an object of 0 bytes"):
        list(read_log(path))
