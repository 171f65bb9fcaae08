import itertools
import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from iits_mj.core.errors import BusError
from iits_mj.j1939 import BroadcastSender, Failure, Frame, Reassembler, broadcast, make_id

CM, DT = 0xEC00, 0xEB00
RTS, CTS, END, BAM, ABORT = 16, 17, 19, 32, 255


def cm(kind, body, pgn, source, destination, time=0.0):
    data = bytes([kind]) + bytes(body).ljust(4, b"\xff") + pgn.to_bytes(3, "little")
    return Frame(make_id(7, CM, source, destination), data, time)


def dt(number, content, source, destination=0xFF, time=0.0):
    data = bytes([number]) + content.ljust(7, b"\xff")
    return Frame(make_id(7, DT, source, destination), data, time)


def rts(data, pgn, source, destination, time=0.0):
    packets = -(-len(data) // 7)
    body = [len(data) & 0xFF, len(data) >> 8, packets, 0xFF]
    return cm(RTS, body, pgn, source, destination, time)


def put_together(frames, reader=None):
    reader = reader or Reassembler()
    messages = [message for frame in frames if (message := reader.receive(frame))]
    return messages, reader


def content(length, seed=0):
    return random.Random(seed * 10_000 + length).randbytes(length)


@pytest.mark.parametrize("length", [9, 13, 14, 15, 100, 1784, 1785])
def test_broadcast_of_any_length_is_reassembled(length):
    data = content(length)
    frames = broadcast(65226, data, 0x0B, time=2.0)
    ((message,), reader) = put_together(frames)
    assert message.data == data
    assert (message.pgn, message.source, message.destination) == (65226, 0x0B, 255)
    assert (message.started, message.time) == (2.0, frames[-1].time)
    assert reader.messages == 1
    assert not reader.failures


def test_broadcast_known_answer():
    frames = broadcast(65260, b"TESTVIN0123456789*", 0)
    assert [(frame.can_id, frame.data.hex()) for frame in frames] == [
        (0x1CECFF00, "20120003ffecfe00"),
        (0x1CEBFF00, "015445535456494e"),
        (0x1CEBFF00, "0230313233343536"),
        (0x1CEBFF00, "033738392affffff"),
    ]


def test_packets_of_a_broadcast_are_50_ms_apart():
    times = [frame.time for frame in broadcast(65226, bytes(1785), 0, time=10.0)]
    assert times == [round(10.0 + 0.05 * i, 6) for i in range(256)]


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ({"data": bytes(8)}, "8 bytes"),
        ({"data": bytes(1786)}, "1786 bytes"),
        ({"spacing": 0.04}, "0.04"),
        ({"spacing": float("nan")}, "nan"),
        ({"time": float("inf")}, "inf"),
        ({"pgn": 1 << 18}, "PGN"),
        ({"source": 256}, "source"),
    ],
)
def test_invalid_broadcasts_are_refused(change, why):
    arguments = {"pgn": 65226, "data": bytes(20), "source": 0} | change
    with pytest.raises(BusError, match=why):
        broadcast(**arguments)


def test_a_sender_sends_one_message_at_a_time_with_50_ms_between_packets():
    sender = BroadcastSender(0x0B)
    sender.put(65226, content(30))
    sender.put(65259, content(20))
    sender.put(65259, content(21))
    frames = [frame for tick in range(100) for frame in sender.due(tick * 0.01)]
    messages, reader = put_together(frames)
    assert [(m.pgn, m.data) for m in messages] == [(65226, content(30)), (65259, content(21))]
    assert not reader.failures
    gaps = [b.time - a.time for a, b in itertools.pairwise(frames)]
    assert gaps == pytest.approx([0.05] * 9)


def test_packets_after_a_late_call_keep_their_spacing():
    sender = BroadcastSender(0x0B, spacing=0.06)
    sender.put(65226, content(30))
    asked = [0.0, 0.2, 0.21, 0.22, 0.5, 0.55, 0.57, 1.0]
    times = [frame.time for time in asked for frame in sender.due(time)]
    assert times == [0.0, 0.2, 0.5, 0.57, 1.0]


def test_a_sender_refuses_invalid_messages_times_and_spacings():
    sender = BroadcastSender(0)
    with pytest.raises(BusError, match="8 bytes"):
        sender.put(65226, bytes(8))
    with pytest.raises(BusError, match="nan"):
        sender.due(float("nan"))
    with pytest.raises(BusError, match=r"0\.3"):
        BroadcastSender(0, spacing=0.3)
    assert sender.due(0.0) == []


def test_transfers_of_several_sources_and_to_several_addresses_do_not_mix():
    streams = [broadcast(65226, content(40, source), source) for source in range(5)]
    for destination in (3, 5):
        data = content(40, destination + 50)
        stream = [rts(data, 65259, 0, destination)]
        stream += [dt(i + 1, data[7 * i : 7 * i + 7], 0, destination) for i in range(6)]
        streams.append(stream)
    frames = [frame for turn in zip(*streams, strict=True) for frame in turn]
    messages, reader = put_together([Frame(f.can_id, f.data, 0.0) for f in frames])
    assert len(messages) == 7
    for message in messages:
        seed = message.source if message.destination == 255 else message.destination + 50
        assert message.data == content(40, seed)
    assert not reader.failures


@settings(max_examples=100, deadline=None)
@given(st.data())
def test_messages_of_several_senders_are_reassembled_in_any_order_of_frames(data):
    lengths = data.draw(st.lists(st.integers(9, 60), min_size=1, max_size=5))
    streams = [broadcast(65226, content(n, s), s) for s, n in enumerate(lengths)]
    order = data.draw(st.permutations([s for s, fs in enumerate(streams) for _ in fs]))
    rest = [list(frames) for frames in streams]
    messages, _ = put_together(Frame(f.can_id, f.data) for f in (rest[s].pop(0) for s in order))
    assert {m.source: m.data for m in messages} == {s: content(n, s) for s, n in enumerate(lengths)}


@settings(max_examples=150, deadline=None)
@given(st.data())
def test_lost_repeated_and_swapped_packets_never_give_a_wrong_message(data):
    frames = [f for s in range(3) for f in broadcast(65226, content(50, s), s)]
    heads = [frame for frame in frames if frame.pgn == CM]
    packets = [frame for frame in frames if frame.pgn == DT]
    hurt = data.draw(st.lists(st.sampled_from(packets), max_size=40))
    messages, _ = put_together(Frame(f.can_id, f.data) for f in heads + hurt)
    for message in messages:
        assert message.data == content(50, message.source)


def test_a_packet_after_more_than_750_ms_is_too_late():
    def sent(gap):
        first, *others = broadcast(65226, content(20), 0, time=1_700_000_000.0)
        return [first] + [Frame(f.can_id, f.data, f.time + gap - 0.05) for f in others]

    assert len(put_together(sent(0.75))[0]) == 1
    messages, reader = put_together(sent(0.751))
    assert messages == []
    # The packets after it belong to no transfer.
    assert reader.failures == {Failure.TIME_OUT: 1, Failure.NO_SESSION: 3}


def test_a_lost_packet_loses_the_message_and_is_counted_once():
    frames = broadcast(65226, content(30), 0)
    messages, reader = put_together(frames[:2] + frames[3:])
    assert messages == []
    assert reader.failures == {Failure.SEQUENCE: 1, Failure.NO_SESSION: 2}


def test_packets_out_of_order_lose_the_message():
    first, a, b, c = broadcast(65226, content(21), 0)
    messages, reader = put_together([first, b, a, c])
    assert messages == []
    assert reader.failures[Failure.SEQUENCE] == 1


def test_a_repeated_packet_is_ignored():
    first, a, b, c = broadcast(65226, content(21), 0)
    messages, reader = put_together([first, a, a, b, b, c, c])
    assert [m.data for m in messages] == [content(21)]
    assert reader.failures == {Failure.REPEATED: 3}


def test_a_repeated_packet_with_other_bytes_loses_the_message():
    first, a, b, c = broadcast(65226, content(21), 0)
    other = Frame(a.can_id, a.data[:-1] + bytes([a.data[-1] ^ 1]))
    messages, reader = put_together([first, a, other, b, c])
    assert messages == []
    assert reader.failures[Failure.SEQUENCE] == 1


def test_a_new_broadcast_replaces_an_incomplete_one():
    old, new = broadcast(65226, content(30), 0), broadcast(65259, content(20), 0)
    messages, reader = put_together(old[:3] + new)
    assert [(m.pgn, m.data) for m in messages] == [(65259, content(20))]
    assert reader.failures == {Failure.REPLACED: 1}


def test_a_restarted_log_does_not_continue_an_old_transfer():
    frames = broadcast(65226, content(21), 0, time=100.0)
    again = [Frame(f.can_id, f.data, f.time - 100.0) for f in frames]
    messages, reader = put_together(frames[:2] + again[2:])
    assert messages == []
    assert reader.failures[Failure.TIME_OUT] == 1


def test_a_time_that_is_not_a_number_ends_a_transfer():
    first, a, *_ = broadcast(65226, content(21), 0)
    messages, reader = put_together([first, Frame(a.can_id, a.data, float("nan"))])
    assert messages == []
    assert reader.failures[Failure.TIME_OUT] == 1


def addressed(data, windows, source=0x00, destination=0x03, pgn=65260):
    """A transfer to one address; a window has its first packet and the number of packets."""
    frames = [rts(data, pgn, source, destination)]
    for first, count in windows:
        frames.append(cm(CTS, [count, first], pgn, destination, source))
        for number in range(first, first + count):
            part = data[7 * (number - 1) : 7 * number]
            frames.append(dt(number, part, source, destination))
    packets = -(-len(data) // 7)
    body = [len(data) & 0xFF, len(data) >> 8, packets, 0xFF]
    return [*frames, cm(END, body, pgn, destination, source)]


@pytest.mark.parametrize(
    "windows",
    [[(1, 6)], [(1, 2), (3, 2), (5, 2)], [(1, 4), (3, 4)], [(1, 6), (2, 1)], [(1, 2), (1, 6)]],
)
def test_transfer_to_one_address_is_reassembled_with_repeated_requests(windows):
    data = content(40)
    messages, reader = put_together(addressed(data, windows))
    assert [(m.pgn, m.source, m.destination, m.data) for m in messages] == [(65260, 0, 3, data)]
    assert set(reader.failures) <= {Failure.REPEATED}


def test_a_receiver_that_requests_a_pause_keeps_the_transfer_open():
    head, clear, *rest = addressed(content(20), [(1, 3)])
    wait = [cm(CTS, [0, 0xFF], 65260, 3, 0, time=t) for t in (1.0, 2.0, 3.0)]
    rest = [Frame(f.can_id, f.data, 3.5) for f in [clear, *rest]]
    messages, reader = put_together([head, *wait, *rest])
    assert [m.data for m in messages] == [content(20)]
    assert not reader.failures


@pytest.mark.parametrize("who", [(0, 3), (3, 0)])
def test_either_side_can_abort(who):
    frames = addressed(content(40), [(1, 6)])
    abort = cm(ABORT, [3], 65260, *who)
    messages, reader = put_together([*frames[:4], abort])
    assert messages == []
    assert reader.failures == {Failure.ABORTED: 1}


def test_abort_of_another_message_does_not_end_a_transfer():
    head, *rest = addressed(content(40), [(1, 6)])
    messages, reader = put_together([head, cm(ABORT, [3], 65259, 3, 0), *rest])
    assert len(messages) == 1
    assert reader.failures == {Failure.NO_SESSION: 1}


def test_a_message_that_only_its_receiver_has_completely_is_lost():
    frames = addressed(content(40), [(1, 6)])
    messages, reader = put_together(frames[:5] + frames[-1:])
    assert messages == []
    assert reader.failures == {Failure.SEQUENCE: 1}


def test_a_clear_to_send_beyond_a_missed_packet_ends_the_transfer():
    frames = addressed(content(40), [(1, 2), (3, 4)])
    messages, reader = put_together([f for i, f in enumerate(frames) if i != 3])
    assert messages == []
    assert reader.failures[Failure.SEQUENCE] == 1


@pytest.mark.parametrize(
    "frame",
    [
        cm(BAM, [0, 0, 0], 65226, 0, 255),
        cm(BAM, [20, 0, 2], 65226, 0, 255),
        cm(BAM, [0xFA, 6, 255], 65226, 0, 255),
        cm(BAM, [20, 0, 3], 1 << 18, 0, 255),
        cm(BAM, [20, 0, 3], 65226, 0, 3),
        cm(RTS, [20, 0, 3], 65226, 0, 255),
        cm(CTS, [1, 1], 65226, 0, 255),
        cm(77, [20, 0, 3], 65226, 0, 255),
        Frame(make_id(7, CM, 0, 255), bytes([BAM, 20, 0, 3])),
        Frame(make_id(7, CM, 0, 255), b""),
    ],
)
def test_invalid_connection_frames_are_counted_and_start_no_transfer(frame):
    _, reader = put_together([frame])
    assert reader.failures == {Failure.HEADER: 1}
    messages, reader = put_together([dt(1, b"", 0)], reader)
    assert messages == []
    assert reader.failures[Failure.NO_SESSION] == 1


def test_open_transfers_at_the_end_are_counted():
    reader = Reassembler()
    put_together(broadcast(65226, content(30), 0)[:-1], reader)
    put_together(broadcast(65226, content(30), 1), reader)
    reader.finish()
    assert reader.failures == {Failure.TIME_OUT: 1}


def test_too_many_transfers_end_the_one_with_the_longest_silence():
    reader = Reassembler(max_sessions=2)
    streams = [broadcast(65226, content(20, s), s) for s in range(3)]
    started = [stream[0] for stream in streams] + [f for s in streams for f in s[1:]]
    messages, _ = put_together((Frame(f.can_id, f.data) for f in started), reader)
    assert [m.source for m in messages] == [1, 2]
    assert reader.failures == {Failure.CROWDED: 1, Failure.NO_SESSION: 3}
    with pytest.raises(BusError, match="max_sessions"):
        Reassembler(max_sessions=0)


transport_frames = st.builds(
    lambda pgn, priority, source, destination, head, rest, time: Frame(
        make_id(priority, pgn, source, destination), bytes([head, *rest])[:8], time
    ),
    st.sampled_from([CM, DT]),
    st.integers(0, 7),
    st.integers(0, 3),
    st.sampled_from([0, 1, 2, 255]),
    st.sampled_from([RTS, CTS, END, BAM, ABORT, 0, 1, 2, 3]),
    st.lists(st.sampled_from([0, 1, 2, 3, 9, 21, 0xFE, 0xCA, 0xFF]), max_size=7),
    st.floats(allow_nan=True, allow_infinity=True),
)
any_frames = st.builds(
    Frame, st.integers(0, (1 << 29) - 1), st.binary(max_size=8), st.floats(0.0, 10.0)
)


@settings(max_examples=300, deadline=None)
@given(st.lists(transport_frames | any_frames, max_size=60))
def test_any_frames_are_received_without_an_error(frames):
    messages, reader = put_together(frames)
    reader.finish()
    assert len(messages) == reader.messages
    assert all(1 <= len(message.data) <= 1785 for message in messages)


def test_number_of_open_transfers_is_bounded():
    reader = Reassembler()
    for source in range(40):
        for destination in range(250):
            data = content(20)
            reader.receive(rts(data, 65226, source, destination))
            reader.receive(dt(1, data[:7], source, destination))
    reader.finish()
    lost = reader.failures[Failure.CROWDED] + reader.failures[Failure.TIME_OUT]
    assert lost == 40 * 250
    assert reader.failures[Failure.TIME_OUT] == 256
