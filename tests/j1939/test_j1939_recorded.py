"""Frames recorded on real trucks, where the files are at hand."""

import re
import struct
from pathlib import Path

import pytest

from iits_mj.j1939 import CommandReceiver, Frame, Status, decode

DATA = Path(__file__).resolve().parents[2] / "../shared/data/j1939"
KENWORTH = DATA / "KWTruck.txt"
LOGGER = DATA / "SampleTruckData.bin"
_LINE = re.compile(r"\((\d+\.\d+)\)\s+\S+\s+([0-9A-F]{8})\s+\[(\d)\]\s+([0-9A-F ]+)")


def _kenworth():
    for line in KENWORTH.read_text().splitlines():
        match = _LINE.search(line)
        if match:
            data = bytes.fromhex(match.group(4))
            yield Frame(int(match.group(2), 16), data, float(match.group(1)))


def _logger():
    """Blocks of 512 bytes: a count, then records of time, length, identifier, data."""
    content = LOGGER.read_bytes()
    for start in range(0, len(content), 512):
        (count,) = struct.unpack_from("<H", content, start)
        for i in range(min(count, 21)):
            at = start + 4 + 24 * i
            second, _, fraction, can_id = struct.unpack_from("<IIII", content, at)
            length = fraction >> 24
            yield Frame(can_id & 0x1FFFFFFF, content[at + 16 : at + 16 + length], float(second))


def _decoded(frame):
    return decode(frame) if len(frame.data) == 8 else None


def _numbers(frames, name, signal):
    found = []
    for frame in frames:
        decoded = _decoded(frame)
        if decoded is not None and decoded.name == name:
            value = getattr(decoded.group, signal)
            if not isinstance(value, Status):
                found.append(value)
    return found


@pytest.mark.skipif(not KENWORTH.is_file(), reason="the recorded frames are not here")
def test_revved_engine_of_a_real_truck_reads_near_2060_rpm():
    speed = _numbers(_kenworth(), "EEC1", "engine_speed_rpm")
    assert len(speed) > 2000
    running = sorted(s for s in speed if s > 300.0)
    assert 550.0 < running[len(running) // 2] < 2100.0
    assert max(speed) == pytest.approx(2060.0, abs=40.0)


@pytest.mark.skipif(not KENWORTH.is_file(), reason="the recorded frames are not here")
def test_pedal_of_a_real_truck_moves_from_0_to_part_throttle():
    pedal = _numbers(_kenworth(), "EEC2", "accelerator_pedal_position_percent")
    assert min(pedal) == 0.0
    assert max(pedal) == pytest.approx(40.8)


@pytest.mark.skipif(not KENWORTH.is_file(), reason="the recorded frames are not here")
def test_exhaust_brake_of_a_real_truck_reports_no_torque_and_itself_in_control():
    found = [d for d in map(_decoded, _kenworth()) if d is not None and d.name == "ERC1"]
    assert len(found) > 500
    assert {d.source for d in found} == {0x29}
    for decoded in found:
        assert decoded.group.number("actual_retarder_torque_percent") == 0.0
        assert decoded.group.number("retarder_control_source_address") == 0x29


@pytest.mark.skipif(not KENWORTH.is_file(), reason="the recorded frames are not here")
def test_a_real_bus_commands_nothing_but_the_pedal():
    # Its gearbox talks torque control to the engine, which is none of our retarders.
    receiver = CommandReceiver()
    frames = list(_kenworth())
    assert any(frame.pgn == 0 and frame.destination == 0 for frame in frames)
    for frame in frames:
        receiver.receive(frame)
    assert set(receiver.accepted) == {"EEC2"}
    assert receiver.command(frames[-1].time).retarder == 0.0


@pytest.mark.skipif(not LOGGER.is_file(), reason="the recorded frames are not here")
def test_every_frame_of_a_real_logger_decodes_or_passes():
    frames = list(_logger())
    assert len(frames) == 145_278
    assert len({frame.pgn for frame in frames}) == 57
    known = [decode(frame) for frame in frames[::7] if len(frame.data) == 8]
    assert sum(message is not None for message in known) > 5000
    speeds = _numbers(frames, "EEC1", "engine_speed_rpm")
    assert max(speeds, default=0.0) == 0.0
    assert max(_numbers(frames, "EBC2", "front_axle_speed_kph"), default=0.0) == 0.0
