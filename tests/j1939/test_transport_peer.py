"""Transfers to and from can-j1939, an independent implementation of the transport protocol."""

import random
import time

import pytest

from iits_mj.j1939 import Frame, Reassembler, broadcast

peer = pytest.importorskip("j1939.j1939_21", reason="can-j1939 is not installed")
peer_id = pytest.importorskip("j1939.message_id", reason="can-j1939 is not installed")

TRUCK, TOOL = 0x00, 0xF9


class Unit:
    """A control unit of the peer on our wire; its clock is controlled by the test."""

    def __init__(self, address, wire, window=3):
        self.address, self.wire, self.received = address, wire, []
        self.layer = peer.J1939_21(
            lambda can_id, extended, data, **_: wire.append(Frame(can_id, bytes(data))),
            lambda: None,
            self._notify,
            window,
            None,
            None,
            lambda destination: destination in (address, 0xFF),
        )

    def _notify(self, priority, pgn, source, *rest):
        self.received.append((pgn, source, bytes(rest[-1])))

    def send(self, pgn, data, destination=0xFF):
        pdu_format, specific = pgn >> 8 & 0xFF, pgn & 0xFF
        if pdu_format < 240:
            specific = destination
        assert self.layer.send_pgn(0, pdu_format, specific, 6, self.address, list(data), 0, None)

    def hear(self, frame):
        message_id = peer_id.MessageId(can_id=frame.can_id)
        if message_id.source_address != self.address and frame.destination in (self.address, 0xFF):
            handler = (
                self.layer._process_tp_cm if frame.pgn == 0xEC00 else self.layer._process_tp_dt
            )
            handler(message_id, frame.destination, bytearray(frame.data), frame.time)


def run(units, wire):
    """Runs the units until none sends any more; returns all frames on the wire."""
    said = 0
    for _ in range(600):
        heard = len(wire)
        while said < len(wire):
            for unit in units:
                unit.hear(wire[said])
            said += 1
        for unit in units:
            # 0.06 s later: past the spacing of packets, before any time-out.
            unit.layer.async_job_thread(time.time() + 0.06)
        if heard == len(wire) == said:
            break
    return wire


def read(frames):
    reader = Reassembler()
    return [message for frame in frames if (message := reader.receive(frame))], reader


@pytest.mark.parametrize("length", [9, 14, 15, 300, 1785])
def test_a_broadcast_of_the_peer_is_reassembled(length):
    wire = []
    unit = Unit(TRUCK, wire)
    data = random.Random(length).randbytes(length)
    unit.send(65226, data)
    messages, reader = read(run([unit], wire))
    assert [(m.pgn, m.source, m.destination, m.data) for m in messages] == [
        (65226, TRUCK, 0xFF, data)
    ]
    assert not reader.failures


@pytest.mark.parametrize("length", [9, 14, 15, 300, 1785])
def test_our_broadcast_is_reassembled_by_the_peer(length):
    unit = Unit(TOOL, [])
    data = random.Random(length).randbytes(length)
    for frame in broadcast(65226, data, TRUCK):
        unit.hear(frame)
    assert unit.received == [(65226, TRUCK, data)]


@pytest.mark.parametrize("window", [1, 3, 255])
def test_a_transfer_between_two_peers_is_reassembled(window):
    wire = []
    units = [Unit(TRUCK, wire, window), Unit(TOOL, wire, window)]
    data = random.Random(window).randbytes(100)
    units[0].send(0xDA00, data, TOOL)
    messages, reader = read(run(units, wire))
    assert [data for *_, data in units[1].received] == [data]
    assert [(m.pgn, m.source, m.destination, m.data) for m in messages] == [
        (0xDA00, TRUCK, TOOL, data)
    ]
    assert not reader.failures
    assert {frame.data[0] for frame in wire if frame.pgn == 0xEC00} == {16, 17, 19}
