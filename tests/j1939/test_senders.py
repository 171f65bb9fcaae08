"""Frames of truck and controller, and their rates."""

from collections import Counter

import pytest

from iits_mj.core.errors import BusError, InputError
from iits_mj.core.messages import EgoState, TransmissionMode, TruckReport, VehicleCommand, XbrMode
from iits_mj.j1939 import (
    CommandReceiver,
    CommandSender,
    StateReceiver,
    StateSender,
    Status,
    decode,
    pgn_of,
    state_to_frames,
)
from iits_mj.truck import Truck

# Frames a second, from the repetition rates that J1939-71 gives to its groups.
RATES = {
    "EEC1": 50,
    "EEC2": 20,
    "EEC3": 4,
    "ERC1": 2 * 10,
    "ETC1": 100,
    "ETC2": 10,
    "CCVS1": 10,
    "EBC1": 10,
    "EBC2": 10,
    "EBC3": 10,
    "EBC5": 10,
    "VDC2": 100,
    "LFE1": 10,
    "HRLFC": 1,
    "AIR1": 1,
    "VW": 6,
    "CVW": 1,
}
OWN = ("IITS_TRAILER", "IITS_POSE", "IITS_ATTITUDE", "IITS_ROUTE", "IITS_MOTION")
REPORT = TruckReport(axle_loads=(6e4,) * 6)


def name(frame):
    return decode(frame).name


def ticks(sender, seconds, tick=0.01):
    """Frames of every tick."""
    return [sender.frames(EgoState(time=k * tick), REPORT) for k in range(round(seconds / tick))]


def test_every_report_has_its_rate():
    sent = Counter(name(frame) for frames in ticks(StateSender(), 10.0) for frame in frames)
    wanted = RATES | dict.fromkeys(OWN, 50)
    assert sent == {message: 10 * rate for message, rate in wanted.items()}


def test_every_report_is_sent_within_the_first_tenth_of_a_second():
    first = {(name(f), f.source) for frames in ticks(StateSender(), 0.1) for f in frames}
    assert first == {(name(f), f.source) for f in state_to_frames(EgoState(), REPORT)}


def test_reports_of_the_trucks_motion_are_sent_at_the_same_instant():
    for frames in ticks(StateSender(), 1.0):
        own = {name(frame) for frame in frames} & set(OWN)
        assert own in (set(), set(OWN))


def test_no_tick_has_more_than_twice_the_mean_load_without_axle_weights():
    loads = [sum(name(f) != "VW" for f in frames) for frames in ticks(StateSender(), 2.0)]
    assert max(loads) <= 2 * sum(loads) / len(loads)


def test_the_bus_is_less_than_half_full_at_250_kbit_a_second():
    reports = sum(len(frames) for frames in ticks(StateSender(), 10.0)) / 10.0
    commands = CommandSender()
    given = sum(len(commands.frames(VehicleCommand(), 0.01 * k)) for k in range(1000)) / 10.0
    # A frame of 8 bytes takes 131 bits and, at the worst, 29 stuff bits.
    assert 131 * (reports + given) < 0.5 * 250e3


def test_the_senders_are_deterministic():
    assert ticks(StateSender(), 3.0) == ticks(StateSender(), 3.0)


def test_rates_are_kept_with_a_longer_tick():
    sent = Counter(
        name(frame) for frames in ticks(StateSender(), 10.0, tick=0.02) for frame in frames
    )
    assert sent["EEC1"] == pytest.approx(500, abs=1)
    # A group is not sent more often than its sender is called.
    assert sent["VDC2"] == 500
    assert sent["CCVS1"] == 100


def test_a_request_is_answered_by_the_sender_of_the_group():
    sender, state = StateSender(), EgoState(mass=19_000.0)
    answer = sender.answer(pgn_of("CVW"), 0xFF, state, REPORT)
    assert [name(frame) for frame in answer] == ["CVW"]
    assert decode(answer[0]).group.number("gross_combination_weight_kg") == 19_000.0
    assert sender.answer(pgn_of("CVW"), 0x0B, state) != []
    assert sender.answer(pgn_of("CVW"), 0x00, state) == []
    assert [f.source for f in sender.answer(pgn_of("ERC1"), 0xFF, state)] == [0x0F, 0x10]
    assert len(sender.answer(pgn_of("VW"), 0xFF, state, REPORT)) == 6
    # Neither a command's group nor an unknown one.
    assert sender.answer(pgn_of("XBR"), 0xFF, state) == []
    assert sender.answer(65535, 0xFF, state) == []


def test_a_late_controller_has_the_complete_state_within_a_second():
    truck = Truck.load(payload=0.0, visuals=False)
    truck.reset(speed=15.0)
    sender, receiver = StateSender(), StateReceiver()
    for _ in range(123):
        sender.frames(truck.observe(), truck.report())
        truck.step(5)
    for _ in range(100):
        for frame in sender.frames(truck.observe(), truck.report()):
            receiver.receive(frame)
        truck.step(5)
    state = receiver.state()
    assert state.mass == pytest.approx(19_000.0, abs=5.0)
    assert state.speed == pytest.approx(truck.observe().speed, abs=0.05)
    report = receiver.report()
    unheard = {field for field in TruckReport.__slots__ if getattr(report, field) in (None, ())}
    # Only quantities derived from these fields are sent.
    assert unheard == {*("clutch_engagement", "xbr_mode", "xbr_active", "steering_wheel_torque")}


def test_a_state_that_is_not_finite_is_refused():
    sender = StateSender()
    with pytest.raises(BusError, match="speed"):
        sender.frames(EgoState(speed=float("nan")))
    with pytest.raises(InputError, match="time"):
        sender.frames(EgoState(time=float("nan")))
    with pytest.raises(BusError, match="wheel_speeds"):
        sender.frames(EgoState(), TruckReport(wheel_speeds=(1.0, float("inf"))))


def test_every_command_has_its_rate_and_the_first_call_sends_all_messages():
    sender = CommandSender()
    times = {}
    for k in range(1000):
        for frame in sender.frames(VehicleCommand(), 0.01 * k):
            times.setdefault((name(frame), frame.destination), []).append(k)
    assert {key: len(found) for key, found in times.items()} == {
        ("EEC2", 0xFF): 200,
        ("XBR", 0x0B): 500,
        ("TSC1", 0x0F): 200,
        ("TSC1", 0x10): 200,
        ("IITS_COMMAND", 0xFF): 500,
    }
    assert all(found[0] == 0 for found in times.values())


def test_counters_of_commands_run_without_gap_or_repetition():
    sender = CommandSender()
    seen = {}
    for k in range(200):
        for frame in sender.frames(VehicleCommand(retarder=0.5), 0.02 * k):
            seen.setdefault((name(frame), frame.destination), []).append(frame.data[7] & 0x0F)
    for message, modulus in {
        ("XBR", 0x0B): 16,
        ("TSC1", 0x10): 8,
        ("IITS_COMMAND", 0xFF): 16,
    }.items():
        counters = seen[message]
        assert counters == [k % modulus for k in range(len(counters))]


def test_commands_at_their_rates_are_all_accepted_and_never_time_out():
    sender, receiver = CommandSender(), CommandReceiver()
    command = VehicleCommand(
        accelerator_pedal=0.4, xbr_demand=-1.0, xbr_mode=XbrMode.MAXIMUM, retarder=0.5
    )
    for k in range(500):
        for frame in sender.frames(command, 0.01 * k):
            assert receiver.receive(frame)
        obeyed = receiver.command(0.01 * k)
        assert obeyed.accelerator_pedal == pytest.approx(0.4)
        assert obeyed.retarder == pytest.approx(0.5)
        assert obeyed.xbr_mode is XbrMode.MAXIMUM
    assert not receiver.rejected


def test_a_controller_sends_from_its_own_address():
    frames = CommandSender(source=0x21).frames(VehicleCommand(), 0.0)
    assert {frame.source for frame in frames} == {0x21}
    assert {frame.source for frame in CommandSender().frames(VehicleCommand(), 0.0)} == {0x2A}


@pytest.mark.parametrize("change", [{"accelerator_pedal": 1.1}, {"xbr_demand": float("nan")}])
def test_a_command_out_of_range_is_refused(change):
    with pytest.raises(InputError, match=next(iter(change))):
        CommandSender().frames(VehicleCommand(**change), 0.0)


@pytest.mark.parametrize("source", [-1, 254, 255, "42"])
def test_a_controller_address_must_be_valid(source):
    with pytest.raises(InputError, match="source"):
        CommandSender(source)


def test_undefined_codes_are_sent_as_not_available():
    report = TruckReport(transmission_mode=21.0, xbr_mode=9.0, xbr_active=1.0, gear_engaged=99.0)
    groups = {d.name: d.group for d in map(decode, state_to_frames(EgoState(), report))}
    assert groups["ETC2"].requested_range is Status.NOT_AVAILABLE
    assert groups["EBC5"].xbr_active_control_mode == 0.0


@pytest.mark.parametrize(
    ("mode", "text"),
    [
        (TransmissionMode.DRIVE, " D"),
        (TransmissionMode.forward(7), " 7"),
        (TransmissionMode.forward(12), "12"),
    ],
)
def test_requested_range_is_the_selectors_letter_or_the_requested_gear(mode, text):
    report = TruckReport(transmission_mode=mode)
    groups = {d.name: d.group for d in map(decode, state_to_frames(EgoState(), report))}
    assert int(groups["ETC2"].requested_range).to_bytes(2, "little").decode() == text
