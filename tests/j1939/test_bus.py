"""Frames over python-can, and a bus that is opened again."""

from __future__ import annotations

import itertools
import socket
import time
import uuid

import can
import pytest

from iits_mj.core.errors import BusError, InputError
from iits_mj.core.messages import EgoState, VehicleCommand
from iits_mj.j1939 import (
    Bus,
    CommandReceiver,
    Frame,
    Link,
    LinkState,
    LogWriter,
    StateReceiver,
    command_to_frames,
    read_log,
    state_to_frames,
)
from iits_mj.j1939.bus import is_own_address
from tests.j1939.failing_can import FailingBus, Medium


def _pair():
    channel = uuid.uuid4().hex
    return Bus("virtual", channel), Bus("virtual", channel)


def test_command_crosses_a_virtual_bus_and_the_state_comes_back():
    controller, truck = _pair()
    with controller, truck:
        for frame in command_to_frames(VehicleCommand(0.5, steering_wheel_angle=0.25), 0):
            controller.send(frame)
        receiver = CommandReceiver()
        for frame in truck.receive(time=0.0):
            receiver.receive(frame)
        assert receiver.command(0.0).steering_wheel_angle == pytest.approx(0.25, abs=5e-4)
        for frame in state_to_frames(EgoState(speed=20.0)):
            truck.send(frame)
        watcher = StateReceiver()
        for frame in controller.receive(time=0.1):
            watcher.receive(frame)
        assert watcher.state().speed == pytest.approx(20.0, abs=2e-3)
        assert controller.receive() == []


def test_every_frame_of_many_control_cycles_arrives_over_the_virtual_bus():
    controller, truck = _pair()
    receiver = CommandReceiver()
    with controller, truck:
        for counter in range(200):
            for frame in command_to_frames(VehicleCommand(0.5), counter):
                controller.send(frame)
            for frame in truck.receive(time=0.0):
                receiver.receive(frame)
    assert set(receiver.accepted.values()) == {200}
    assert len(receiver.accepted) == 5
    assert not receiver.lost


@pytest.mark.parametrize("suffix", ["asc", "log", "blf"])
def test_log_file_gives_the_frames_back(tmp_path, suffix):
    path = tmp_path / f"drive.{suffix}"
    frames = command_to_frames(VehicleCommand(0.3), 7, time=1.5)
    writer = LogWriter(path)
    for frame in frames:
        writer.write(frame)
    writer.close()
    read = list(read_log(path))
    assert [(f.can_id, f.data) for f in read] == [(f.can_id, f.data) for f in frames]


def test_unusable_bus_log_and_frame_raise_bus_error(tmp_path):
    with pytest.raises(BusError, match="cannot be opened"):
        Bus("no_such_interface", "x")
    with pytest.raises(BusError, match="cannot be read"):
        list(read_log(tmp_path / "missing.asc"))
    with pytest.raises(BusError, match="at most 8"):
        Frame(1, b"\x00" * 9)


FRAME = Frame(0x18FEF100, bytes(range(8)), 1.25)


class Clock:
    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def medium(monkeypatch: pytest.MonkeyPatch) -> Medium:
    fresh = Medium()
    monkeypatch.setattr(FailingBus, "medium", fresh)
    for name in ("pcan", "socketcan"):
        backend = (FailingBus.__module__, FailingBus.__name__)
        monkeypatch.setitem(can.interfaces.BACKENDS, name, backend)
    return fresh


@pytest.fixture
def clock() -> Clock:
    return Clock()


def _link(clock: Clock, interface: str = "pcan") -> Link:
    return Link(interface, "can0", first_wait=0.1, longest_wait=0.8, patience=0.25, clock=clock)


def _message(**fields: object) -> can.Message:
    plain = {"arbitration_id": 0x18FEF100, "data": bytes(8), "timestamp": 3.5}
    return can.Message(**(plain | fields))  # type: ignore[arg-type]


def test_link_to_a_missing_bus_raises_at_once(medium: Medium) -> None:
    medium.openable = False
    with pytest.raises(BusError, match="pcan:can0 cannot be opened: no such device"):
        Link("pcan", "can0")


def test_vanished_interface_drops_frames_and_recovers(medium: Medium, clock: Clock) -> None:
    link = _link(clock)
    assert link.send(FRAME)
    medium.readable = medium.writable = medium.openable = False
    assert link.receive() == []
    assert link.state is LinkState.DOWN
    assert not link.send(FRAME)
    clock.now += 0.15
    assert not link.send(FRAME)
    assert link.restarts == 0
    medium.readable = medium.writable = medium.openable = True
    clock.now += 10.0
    assert link.send(FRAME)
    medium.waiting.append(_message())
    assert [frame.pgn for frame in link.receive(2.0)] == [0xFEF1]
    assert (link.sent, link.dropped, link.received) == (2, 2, 1)
    assert (link.failures, link.restarts, link.state) == (1, 1, LinkState.UP)
    assert [change.state for change in link.changes] == [LinkState.DOWN, LinkState.UP]
    assert "network is down" in link.changes[0].reason


def test_waits_double_up_to_the_longest_and_reset_after_a_frame(
    medium: Medium, clock: Clock
) -> None:
    link = _link(clock)
    medium.readable = False
    tried = []
    for _ in range(3500):
        before = medium.opened
        link.receive()
        if medium.opened > before:
            tried.append(clock.now)
        clock.now += 0.001
    waits = [round(b - a, 2) for a, b in itertools.pairwise(tried)]
    assert waits == [0.2, 0.4, 0.8, 0.8, 0.8]
    medium.readable = True
    clock.now += 1.0
    assert link.send(FRAME)
    medium.readable = False
    link.receive()
    failed_at = clock.now
    before = medium.opened
    while medium.opened == before:
        clock.now += 0.001
        link.receive()
    assert clock.now - failed_at == pytest.approx(0.1, abs=0.002)


def test_one_refused_frame_is_dropped_without_a_failure(medium: Medium, clock: Clock) -> None:
    link = _link(clock)
    medium.writable = False
    assert not link.send(FRAME)
    medium.writable = True
    clock.now += 1.0
    assert link.send(FRAME)
    assert (link.dropped, link.failures, medium.opened) == (1, 0, 1)


def test_a_bus_that_refuses_all_frames_is_opened_again(medium: Medium, clock: Clock) -> None:
    link = _link(clock)
    medium.writable = False
    for _ in range(60):
        link.send(FRAME)
        clock.now += 0.01
    assert link.failures >= 1
    assert medium.opened >= 2
    assert medium.closed >= 1
    assert link.dropped == 60


@pytest.mark.parametrize("interface", ["pcan", "socketcan"])
def test_bus_off_is_detected_and_stops_sending(
    interface: str, medium: Medium, clock: Clock
) -> None:
    link = _link(clock, interface)
    if interface == "socketcan":
        medium.waiting.append(_message(arbitration_id=0x040, is_error_frame=True))
    else:
        medium.off = True
    link.receive()
    assert link.state is LinkState.BUS_OFF
    assert not link.send(FRAME)
    assert medium.written == []


def test_controller_that_restarts_itself_is_used_again(medium: Medium, clock: Clock) -> None:
    link = _link(clock, "socketcan")
    medium.waiting.append(_message(arbitration_id=0x040, is_error_frame=True))
    link.receive()
    medium.waiting.append(_message(arbitration_id=0x100, is_error_frame=True))
    link.receive()
    assert link.state is LinkState.UP
    assert link.send(FRAME)
    assert (link.restarts, medium.opened, link.failures) == (0, 1, 1)


def test_bus_off_that_ends_in_an_unreadable_bus_is_one_failure(
    medium: Medium, clock: Clock
) -> None:
    link = _link(clock, "socketcan")
    medium.waiting.append(_message(arbitration_id=0x040, is_error_frame=True))
    link.receive()
    medium.readable = False
    link.receive()
    assert (link.state, link.failures) == (LinkState.DOWN, 1)
    medium.readable = True
    clock.now += 10.0
    link.receive()
    states = [LinkState.BUS_OFF, LinkState.DOWN, LinkState.UP]
    assert [change.state for change in link.changes] == states
    assert (link.failures, link.restarts) == (1, 1)


def test_controller_that_stays_bus_off_is_opened_again(medium: Medium, clock: Clock) -> None:
    link = _link(clock)
    medium.off = True
    link.receive()
    medium.off = False
    clock.now += 0.11
    assert link.receive() == []
    assert (link.state, link.restarts, medium.opened) == (LinkState.UP, 1, 2)


def test_frames_read_before_the_failure_are_not_lost(medium: Medium) -> None:
    bus = Bus("pcan", "can0")
    medium.waiting += [_message(), can.CanOperationError("network is down", 100)]
    assert len(bus.receive()) == 1
    with pytest.raises(BusError, match="cannot be read: network is down"):
        bus.receive()
    assert bus.receive() == []


def test_only_j1939_frames_are_received_and_others_are_counted(medium: Medium) -> None:
    bus = Bus("pcan", "can0")
    garbage = can.CanOperationError("could not unpack")
    garbage.__cause__ = KeyError("data")
    medium.waiting += [
        _message(arbitration_id=0x123, is_extended_id=False),
        _message(is_remote_frame=True, data=None),
        _message(is_error_frame=True),
        _message(is_fd=True, data=bytes(64)),
        garbage,
        _message(),
    ]
    frames = bus.receive()
    assert [(f.can_id, f.data, f.time) for f in frames] == [(0x18FEF100, bytes(8), 3.5)]
    assert bus.ignored == {"11-bit": 1, "remote": 1, "error": 1, "FD": 1, "malformed": 1}


def test_a_flood_does_not_block_the_reader(medium: Medium) -> None:
    bus = Bus("pcan", "can0")
    medium.waiting += [_message() for _ in range(50)]
    assert [len(bus.receive(limit=20)) for _ in range(4)] == [20, 20, 10, 0]


def test_virtual_bus_keeps_the_times_of_the_frames() -> None:
    with Bus("virtual", "kept") as here, Bus("virtual", "kept") as there:
        here.send(FRAME)
        assert there.receive() == [FRAME]
        here.send(FRAME)
        assert there.receive(time=7.0)[0].time == 7.0


def free_multicast_channel() -> str:
    """A multicast group with a port that no other test uses."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("", 0))
        return f"239.74.163.2:{probe.getsockname()[1]}"


def await_frames(bus: Bus) -> list[Frame]:
    """The next frames; skips the test where multicast does not come back to this machine."""
    end = time.monotonic() + 2.0
    heard: list[Frame] = []
    while not heard and time.monotonic() < end:
        heard = bus.receive(time=1.25)
    if not heard:
        pytest.skip("UDP multicast does not come back to this machine")
    return heard


def test_only_datagrams_of_other_senders_are_received() -> None:
    channel = free_multicast_channel()
    try:
        here, there = Bus("udp_multicast", channel), Bus("udp_multicast", channel)
    except BusError as error:
        pytest.skip(f"UDP multicast is not routed here: {error}")
    with here, there:
        here.send(FRAME)
        heard = await_frames(there)
        assert heard == [FRAME]
        assert here.receive() == []
        assert (here.ignored, there.ignored) == ({"own": 1}, {})


def test_multicast_from_another_machine_is_dropped_unless_the_network_is_allowed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    assert is_own_address(("127.0.0.1", 4711))
    assert not is_own_address(("192.0.2.7", 4711))  # of documentation alone (RFC 5737)
    channel = free_multicast_channel()
    monkeypatch.setattr("iits_mj.j1939.bus.is_own_address", lambda sender: False)
    try:
        here = Bus("udp_multicast", channel)
        there = Bus("udp_multicast", channel, reach="network")
    except BusError as error:
        pytest.skip(f"UDP multicast is not routed here: {error}")
    with here, there, Bus("udp_multicast", channel) as sender:
        sender.send(FRAME)
        await_frames(there)
        assert here.receive() == []
        assert here.ignored == {"other host": 1}
    with pytest.raises(InputError, match="reach 'world' is not known; use one of: host, network"):
        Bus("udp_multicast", channel, reach="world")


@pytest.mark.parametrize(
    ("interface", "channel"),
    [("no_such", "x"), ("udp_multicast", "239.74.163.2:0"), ("udp_multicast", "239.1.1.1:70000")],
)
def test_unusable_bus_is_named_in_the_error(interface: str, channel: str) -> None:
    with pytest.raises(BusError, match=f"CAN bus {interface}:{channel}"):
        Link(interface, channel)


@pytest.mark.parametrize("bad", [0.0, -1.0, float("nan"), float("inf")])
def test_times_of_a_link_are_positive(bad: float) -> None:
    with pytest.raises(InputError, match=r"patience is .* more than zero is needed"):
        Link("virtual", "x", patience=bad)
