"""The fail-safe matrix: every command message against every fault."""

import dataclasses
import math
import re

import pytest

from iits_mj.core.errors import InputError
from iits_mj.core.messages import EgoState, TransmissionMode, VehicleCommand, XbrEbiMode, XbrMode
from iits_mj.j1939 import (
    CommandReceiver,
    Frame,
    Heard,
    Reason,
    TimeOuts,
    command_to_frames,
    cycle_time,
    decode,
    state_to_frames,
)
from iits_mj.j1939.command import XBR_DEMAND_MIN
from iits_mj.j1939.frame import tsc1_checksum, with_byte8, xbr_checksum
from iits_mj.j1939.receiver import STEERING_ANGLE_MAX
from iits_mj.parameters import TruckParameters
from iits_mj.truck import Truck
from tests.paths import ROOT

FIRST = VehicleCommand(
    accelerator_pedal=0.4,
    xbr_demand=-1.5,
    xbr_mode=XbrMode.MAXIMUM,
    steering_wheel_angle=-0.7,
    engine_brake=0.5,
    retarder=0.75,
    brake_pedal=0.2,
    xbr_ebi_mode=XbrEbiMode.INTEGRATION,
)
# Another value for every field, so that any accepted field is visible.
OTHER = VehicleCommand(
    accelerator_pedal=0.9,
    xbr_demand=-6.0,
    xbr_mode=XbrMode.ADDITION,
    steering_wheel_angle=2.0,
    parking_brake=1.0,
    engine_brake=0.1,
    transmission_mode=TransmissionMode.NEUTRAL,
    retarder=0.2,
    brake_pedal=0.6,
    xbr_ebi_mode=XbrEbiMode.ENDURANCE_ONLY,
)
UNITS = ("EEC2", "XBR", "TSC1 to 15", "TSC1 to 16", "IITS_COMMAND")
PROTECTED = UNITS[1:]
FIELDS = {
    "EEC2": ("accelerator_pedal",),
    "XBR": ("xbr_demand", "xbr_mode", "xbr_ebi_mode"),
    "TSC1 to 15": ("engine_brake",),
    "TSC1 to 16": ("retarder",),
    "IITS_COMMAND": ("steering_wheel_angle", "parking_brake", "transmission_mode", "brake_pedal"),
}
# Names of the units in `Loss`.
LOSS = dict(
    zip(UNITS, ("pedal", "xbr", "engine_retarder", "driveline_retarder", "body"), strict=True)
)
# Offset of the brake demand (SPN 2920) and of the steering angle, in steps of the signals.
DEMAND_ZERO, ANGLE_ZERO = round(15.687 * 2048), round(31.374 * 1024)


def frame_of(unit, command, counter, time, source=None, priority=None):
    """The frame of a command for one unit, from a sender, with a priority of its request."""
    for frame in command_to_frames(command, counter, time):
        name = decode(frame).name
        if unit == (f"TSC1 to {frame.destination}" if name == "TSC1" else name):
            break
    data = bytearray(frame.data)
    if priority is not None:
        byte, shift = (2, 2) if unit == "XBR" else (0, 4)
        data[byte] = data[byte] & ~(3 << shift) | priority << shift
    can_id = frame.can_id if source is None else frame.can_id & ~0xFF | source
    return sealed(unit, Frame(can_id, bytes(data), frame.time))


def sealed(unit, frame):
    """The frame with the right checksum."""
    if unit == "EEC2":
        return frame
    check = tsc1_checksum if unit.startswith("TSC1") else xbr_checksum
    return with_byte8(frame, frame.data[7] & 0x0F, check(frame))


def edited(unit, frame, first_bit, length, raw):
    """The frame with another value of a field, and the right checksum."""
    word = int.from_bytes(frame.data, "little")
    word = word & ~((1 << length) - 1 << first_bit) | raw << first_bit
    return sealed(unit, dataclasses.replace(frame, data=word.to_bytes(8, "little")))


def driven():
    """A receiver that received the first command at 0 s, with counter 3."""
    receiver = CommandReceiver()
    for frame in command_to_frames(FIRST, 3, 0.0):
        assert receiver.receive(frame)
    return receiver


def counts(receiver):
    return {**receiver.rejected, **receiver.ignored}


def assert_rejected(unit, frame, reason):
    """Asserts that a frame has no effect, is counted by its reason, and extends no time-out."""
    receiver = driven()
    before = receiver.command(0.04)
    assert not receiver.receive(frame)
    assert receiver.command(0.04) == before
    name = "TSC1" if reason in (Reason.ADDRESS, Reason.SENDER) and unit[0] == "T" else unit
    assert counts(receiver) == {f"{name}: {reason.value}": 1}
    assert receiver.command(0.3) == driven().command(0.3)
    # The following valid frame is obeyed.
    following = frame_of(unit, OTHER, 4, 0.06)
    if reason not in (Reason.OUT_OF_RANGE, Reason.ERROR, Reason.NOT_AVAILABLE):
        assert receiver.receive(following)


@pytest.mark.parametrize("unit", UNITS)
def test_silence_ends_a_command_after_its_time_out_and_not_before(unit):
    time_out = 0.25 if unit == "EEC2" or unit.startswith("TSC1") else 0.1
    first, released = driven().command(0.0), VehicleCommand()

    def asked(time):
        """The command at a time, while the other messages are still sent."""
        receiver = driven()
        for k in range(1, math.floor(time / 0.01) + 1):
            for other in UNITS:
                if other != unit:
                    receiver.receive(frame_of(other, FIRST, 3 + k, 0.01 * k))
        return receiver.command(time)

    within, after = asked(time_out), asked(time_out + 0.002)
    for name in FIELDS[unit]:
        assert getattr(within, name) == getattr(first, name)
        left = first if unit == "IITS_COMMAND" else released
        assert getattr(after, name) == getattr(left, name)
    # Without steering, the accelerator is released.
    assert (after.accelerator_pedal == 0.0) == (unit in ("EEC2", "IITS_COMMAND"))


@pytest.mark.parametrize("unit", PROTECTED)
def test_a_repeated_counter_is_rejected(unit):
    assert_rejected(unit, frame_of(unit, OTHER, 3, 0.04), Reason.REPEATED)


@pytest.mark.parametrize("unit", PROTECTED)
@pytest.mark.parametrize("skip", [2, 3, 7])
def test_lost_frames_are_counted_and_the_next_frame_is_obeyed(unit, skip):
    receiver = driven()
    assert receiver.receive(frame_of(unit, OTHER, 3 + skip, 0.04))
    assert receiver.command(0.04) != driven().command(0.04)
    assert counts(receiver) == {}
    assert dict(receiver.lost) == {unit: skip - 1}


@pytest.mark.parametrize("unit", PROTECTED)
def test_the_command_stays_in_force_with_every_second_frame_lost(unit):
    receiver = driven()
    for k in range(1, 50):
        assert receiver.receive(frame_of(unit, OTHER, 3 + 2 * k, 0.04 * k))
        assert getattr(receiver.loss(0.04 * k), LOSS[unit]) is Heard.ALIVE
    assert dict(receiver.lost) == {unit: 49}


@pytest.mark.parametrize("unit", PROTECTED)
def test_a_wrong_checksum_is_rejected(unit):
    good = frame_of(unit, OTHER, 4, 0.04)
    for bit in range(64):
        word = int.from_bytes(good.data, "little") ^ 1 << bit
        receiver = driven()
        assert not receiver.receive(Frame(good.can_id, word.to_bytes(8, "little"), 0.04))
        assert receiver.command(0.04) == driven().command(0.04)
        assert sum(receiver.rejected.values()) == 1
    wrong = with_byte8(good, 4, good.data[7] >> 4 ^ 1)
    assert_rejected(unit, wrong, Reason.CHECKSUM)


OUT, ERROR, MISSING = Reason.OUT_OF_RANGE, Reason.ERROR, Reason.NOT_AVAILABLE
FIELD_FAULTS = [
    ("EEC2", 8, 8, 0xFB, OUT),
    ("EEC2", 8, 8, 0xFE, ERROR),
    ("EEC2", 8, 8, 0xFF, MISSING),
    # -10.01, +0.01 and -15.687 m/s2, and the ranges above the valid numbers.
    ("XBR", 0, 16, DEMAND_ZERO - 20_501, OUT),
    ("XBR", 0, 16, DEMAND_ZERO + 20, OUT),
    ("XBR", 0, 16, 0x0000, OUT),
    ("XBR", 0, 16, 0xFB00, OUT),
    ("XBR", 0, 16, 0xFE00, ERROR),
    ("XBR", 0, 16, 0xFEFF, ERROR),
    ("XBR", 0, 16, 0xFF00, MISSING),
    ("XBR", 0, 16, 0xFFFF, MISSING),
    ("XBR", 16, 2, 3, OUT),
    ("XBR", 20, 2, 3, OUT),
    *(
        (unit, first, length, raw, reason)
        for unit in ("TSC1 to 15", "TSC1 to 16")
        for first, length, raw, reason in (
            # -101 and +1 percent; speed control and limits; undefined counters.
            (24, 8, 24, OUT),
            (24, 8, 126, OUT),
            (24, 8, 0xFB, OUT),
            (24, 8, 0xFE, ERROR),
            (24, 8, 0xFF, MISSING),
            (0, 2, 1, OUT),
            (0, 2, 3, OUT),
            (56, 4, 8, OUT),
            (56, 4, 14, OUT),
            (56, 4, 15, MISSING),
        )
    ),
    ("IITS_COMMAND", 0, 16, ANGLE_ZERO + 16_090, OUT),
    ("IITS_COMMAND", 0, 16, ANGLE_ZERO - 16_090, OUT),
    ("IITS_COMMAND", 0, 16, 0xFD00, OUT),
    ("IITS_COMMAND", 0, 16, 0xFE00, ERROR),
    ("IITS_COMMAND", 0, 16, 0xFFFF, MISSING),
    ("IITS_COMMAND", 16, 2, 2, ERROR),
    ("IITS_COMMAND", 16, 2, 3, MISSING),
    ("IITS_COMMAND", 18, 2, 2, ERROR),
    ("IITS_COMMAND", 18, 2, 3, MISSING),
    ("IITS_COMMAND", 24, 8, 0xFC, OUT),
    ("IITS_COMMAND", 24, 8, 0xFE, ERROR),
]


@pytest.mark.parametrize(("unit", "first", "length", "raw", "reason"), FIELD_FAULTS)
def test_an_invalid_field_is_rejected(unit, first, length, raw, reason):
    assert_rejected(unit, edited(unit, frame_of(unit, OTHER, 4, 0.04), first, length, raw), reason)


def test_an_undefined_selector_position_is_rejected():
    receiver = driven()
    good = frame_of("IITS_COMMAND", OTHER, 4, 0.04)
    assert not receiver.receive(edited("IITS_COMMAND", good, 32, 6, 21))
    assert sum(receiver.rejected.values()) == 1
    assert receiver.command(0.04).transmission_mode is TransmissionMode.DRIVE


@pytest.mark.parametrize("unit", PROTECTED)
def test_a_frame_with_an_invalid_field_does_not_break_the_sequence(unit):
    receiver = driven()
    first, length, raw = (24, 8, 0xFE) if unit.startswith("TSC1") else (0, 16, 0xFE00)
    bad = edited(unit, frame_of(unit, OTHER, 4, 0.04), first, length, raw)
    assert not receiver.receive(bad)
    assert receiver.receive(frame_of(unit, OTHER, 5, 0.06))


@pytest.mark.parametrize("unit", UNITS)
@pytest.mark.parametrize("length", [0, 1, 7])
def test_a_wrong_length_is_rejected(unit, length):
    good = frame_of(unit, OTHER, 4, 0.04)
    assert_rejected(unit, dataclasses.replace(good, data=good.data[:length]), Reason.LENGTH)


@pytest.mark.parametrize("unit", ["XBR", "TSC1 to 15", "TSC1 to 16"])
@pytest.mark.parametrize("destination", [0x00, 0x0C, 0x31, 0xFE])
def test_a_wrong_destination_is_ignored(unit, destination):
    good = frame_of(unit, OTHER, 4, 0.04)
    can_id = good.can_id & ~0xFF00 | destination << 8
    elsewhere = sealed(unit, dataclasses.replace(good, can_id=can_id))
    assert_rejected(unit, elsewhere, Reason.ADDRESS)


@pytest.mark.parametrize("unit", UNITS)
@pytest.mark.parametrize("source", [0x00, 0x03, 0x0B, 0x0F, 0x10, 0xFE, 0xFF])
def test_the_trucks_own_the_null_and_the_global_address_are_ignored(unit, source):
    assert_rejected(unit, frame_of(unit, OTHER, 4, 0.04, source), Reason.SENDER)


@pytest.mark.parametrize("unit", UNITS)
@pytest.mark.parametrize("time", [math.nan, math.inf, -math.inf])
def test_a_time_that_is_not_finite_is_rejected(unit, time):
    assert_rejected(unit, frame_of(unit, OTHER, 4, time), Reason.TIME)


@pytest.mark.parametrize("unit", UNITS)
def test_an_older_frame_is_rejected(unit):
    receiver = driven()
    assert receiver.receive(frame_of(unit, FIRST, 4, 0.04))
    assert not receiver.receive(frame_of(unit, OTHER, 5, 0.02))
    assert counts(receiver) == {f"{unit}: older than the last": 1}
    assert receiver.command(0.04) == driven().command(0.04)


@pytest.mark.parametrize("unit", UNITS)
def test_senders_are_obeyed_again_after_the_clock_restarts(unit):
    receiver = CommandReceiver()
    receiver.receive(frame_of("IITS_COMMAND", FIRST, 3, 3600.0))
    assert receiver.receive(frame_of(unit, FIRST, 4, 3600.0))
    receiver.receive(frame_of("IITS_COMMAND", OTHER, 7, 0.0))
    assert receiver.receive(frame_of(unit, OTHER, 8, 0.0))
    name = FIELDS[unit][0]
    wanted = getattr(OTHER, name)
    assert getattr(receiver.command(0.0), name) == pytest.approx(wanted, abs=0.01)


def test_a_frame_of_the_far_future_is_not_in_force():
    receiver = CommandReceiver()
    for frame in command_to_frames(FIRST, 0, 1000.0):
        receiver.receive(frame)
    command = receiver.command(1.0)
    assert command.accelerator_pedal == 0.0
    assert command.xbr_mode is XbrMode.OFF
    assert command.retarder == 0.0


def test_the_command_at_a_time_that_is_not_a_number_is_the_safe_one():
    command = driven().command(math.nan)
    assert (command.accelerator_pedal, command.xbr_mode) == (0.0, XbrMode.OFF)
    assert (command.engine_brake, command.retarder) == (0.0, 0.0)


def test_a_sender_with_a_stuck_counter_does_not_recover_by_waiting():
    receiver = driven()
    for k in range(1, 50):
        time = 0.3 * k
        for unit in PROTECTED:
            assert not receiver.receive(frame_of(unit, OTHER, 3, time))
        assert receiver.command(time).xbr_mode is XbrMode.OFF
    assert receiver.rejected["XBR: counter repeated"] == 49


def test_the_first_frames_after_a_bus_off_are_obeyed_with_any_counter():
    receiver = driven()
    assert receiver.command(5.0).accelerator_pedal == 0.0
    for frame in command_to_frames(OTHER, 12, 5.0):
        assert receiver.receive(frame)
    again = receiver.command(5.0)
    assert again.accelerator_pedal == pytest.approx(0.9)
    assert again.xbr_demand == pytest.approx(-6.0, abs=0.001)
    assert not receiver.rejected


def test_four_consecutive_lost_frames_leave_the_command_in_force():
    receiver = CommandReceiver()
    for k in range(100):
        if k % 10 > 3:
            for frame in command_to_frames(FIRST, k, 0.02 * k):
                receiver.receive(frame)
        for later in (0.0, 0.01):
            assert k < 5 or not receiver.loss(0.02 * k + later).driver
            assert k < 5 or receiver.command(0.02 * k + later).xbr_mode is XbrMode.MAXIMUM


def test_the_command_stays_in_force_with_one_frame_in_ten_lost():
    receiver = CommandReceiver()
    for k in range(100):
        if k % 10:
            for frame in command_to_frames(FIRST, k, 0.02 * k):
                receiver.receive(frame)
        assert k < 1 or receiver.command(0.02 * k).xbr_mode is XbrMode.MAXIMUM


def test_the_end_stops_are_those_of_the_truck():
    assert TruckParameters.load().steering.angle_max == STEERING_ANGLE_MAX


def test_the_lowest_brake_demand_is_that_of_the_model():
    control = Truck.load(payload=0.0, visuals=False).model.actuator("xbr_demand")
    assert tuple(control.ctrlrange) == (XBR_DEMAND_MIN, 0.0)


def test_an_angle_at_the_end_stop_is_not_rounded_beyond_it():
    receiver = CommandReceiver()
    for sign, counter in ((1, 0), (-1, 1)):
        command = VehicleCommand(steering_wheel_angle=sign * STEERING_ANGLE_MAX)
        assert receiver.receive(frame_of("IITS_COMMAND", command, counter, 0.0))
        assert abs(receiver.command(0.0).steering_wheel_angle) <= STEERING_ANGLE_MAX


def test_the_trucks_own_reports_are_no_commands():
    receiver = CommandReceiver()
    for frame in state_to_frames(EgoState(engine_speed=120.0, speed=20.0)):
        assert not receiver.receive(frame)
    assert not receiver.accepted
    assert not receiver.rejected


def braking(demand, mode=XbrMode.MAXIMUM):
    return VehicleCommand(xbr_demand=demand, xbr_mode=mode)


def test_the_strongest_brake_demand_of_equal_priority_is_obeyed():
    receiver = CommandReceiver()
    receiver.receive(frame_of("XBR", braking(-2.0), 0, 0.0, 0x2A))
    receiver.receive(frame_of("XBR", braking(-5.0), 9, 0.0, 0x30))
    receiver.receive(frame_of("XBR", braking(-1.0), 4, 0.0, 0x31))
    assert receiver.command(0.0).xbr_demand == pytest.approx(-5.0, abs=0.001)


def test_the_brake_demand_with_the_highest_priority_is_obeyed():
    receiver = CommandReceiver()
    receiver.receive(frame_of("XBR", braking(-1.0, XbrMode.ADDITION), 0, 0.0, 0x2A, priority=0))
    receiver.receive(frame_of("XBR", braking(-8.0), 0, 0.0, 0x30, priority=1))
    command = receiver.command(0.0)
    assert command.xbr_demand == pytest.approx(-1.0, abs=0.001)
    assert command.xbr_mode is XbrMode.ADDITION


def test_a_silent_or_released_brake_demand_leaves_the_other_one_in_force():
    receiver = CommandReceiver()
    receiver.receive(frame_of("XBR", braking(-8.0), 0, 0.0, 0x30, priority=0))
    for k in range(6):
        receiver.receive(frame_of("XBR", braking(-2.0), k, 0.02 * k, 0x2A))
    assert receiver.command(0.1).xbr_demand == pytest.approx(-8.0, abs=0.001)
    assert receiver.command(0.12).xbr_demand == pytest.approx(-2.0, abs=0.001)
    receiver.receive(frame_of("XBR", VehicleCommand(), 1, 0.12, 0x30))
    assert receiver.command(0.12).xbr_demand == pytest.approx(-2.0, abs=0.001)


@pytest.mark.parametrize(
    ("unit", "field"), [("TSC1 to 15", "engine_brake"), ("TSC1 to 16", "retarder")]
)
def test_retarder_requests_are_ranked_by_priority_then_by_strength(unit, field):
    receiver = CommandReceiver()

    def ask(share, source, priority, counter=0):
        command = VehicleCommand(**{field: share})
        assert receiver.receive(frame_of(unit, command, counter, 0.0, source, priority))

    ask(0.3, 0x2A, 2)
    ask(0.6, 0x30, 2)
    assert getattr(receiver.command(0.0), field) == pytest.approx(0.6)
    ask(0.1, 0x31, 1)
    assert getattr(receiver.command(0.0), field) == pytest.approx(0.1)


@pytest.mark.parametrize("unit", PROTECTED)
def test_each_sender_has_its_own_counter(unit):
    receiver = CommandReceiver()
    assert receiver.receive(frame_of(unit, FIRST, 3, 0.0, 0x2A))
    receiver.receive(frame_of(unit, FIRST, 3, 0.0, 0x30))
    assert receiver.receive(frame_of(unit, FIRST, 4, 0.02, 0x2A))
    assert not dict(receiver.rejected)
    receiver.receive(frame_of(unit, FIRST, 3, 0.04, 0x30))
    assert dict(receiver.rejected) == {f"{unit}: counter repeated": 1}
    assert not dict(receiver.lost)


@pytest.mark.parametrize("unit", ["EEC2", "IITS_COMMAND"])
def test_pedal_and_steering_belong_to_the_first_sender_until_it_is_silent(unit):
    receiver = CommandReceiver()
    time_out = 0.25 if unit == "EEC2" else 0.1
    name = FIELDS[unit][0]

    def value(time):
        return getattr(receiver.command(time), name)

    step = 0.02
    for k in range(20):
        time = step * k
        if unit == "EEC2":
            receiver.receive(frame_of("IITS_COMMAND", FIRST, k, time, 0x2A))
        if time <= 0.1:
            assert receiver.receive(frame_of(unit, FIRST, k, time, 0x2A))
        taken = receiver.receive(frame_of(unit, OTHER, k, time, 0x30))
        assert taken == (time > 0.1 + time_out)
        wanted = OTHER if taken else FIRST
        if time <= 0.1 + time_out or taken:
            assert value(time) == pytest.approx(getattr(wanted, name), abs=0.003)
    # The previous holder has to wait now.
    assert not receiver.receive(frame_of(unit, FIRST, 20, 0.4, 0x2A))
    assert receiver.ignored[f"{unit}: held by another sender"] > 5
    assert not receiver.rejected


def test_only_the_given_sources_are_obeyed():
    receiver = CommandReceiver(sources={0x00, 0x31})
    assert receiver.receive(frame_of("EEC2", FIRST, 0, 0.0, 0x00))
    assert receiver.receive(frame_of("XBR", FIRST, 0, 0.0, 0x31))
    assert not receiver.receive(frame_of("XBR", OTHER, 0, 0.0, 0x2A))
    assert dict(receiver.ignored) == {"XBR: from an address that is not obeyed": 1}


@pytest.mark.parametrize("sources", [{254}, {-1}, {1.5}, {"42"}, {True}])
def test_sources_that_are_no_addresses_are_refused(sources):
    with pytest.raises(InputError, match="source"):
        CommandReceiver(sources=sources)


@pytest.mark.parametrize("name", [field.name for field in dataclasses.fields(TimeOuts)])
@pytest.mark.parametrize("value", [0.0, -0.1, math.nan, math.inf])
def test_time_outs_are_finite_and_positive(name, value):
    with pytest.raises(InputError, match=name):
        TimeOuts(**{name: value})


def test_time_outs_are_five_periods_of_the_message():
    limits = TimeOuts()
    for time_out, message in (
        (limits.pedal, "EEC2"),
        (limits.xbr, "XBR"),
        (limits.engine_retarder, "TSC1"),
        (limits.driveline_retarder, "TSC1"),
        (limits.body, "IITS_COMMAND"),
    ):
        assert time_out == pytest.approx(5.0 * cycle_time(message))


def test_the_manual_page_has_the_present_time_outs():
    page = ROOT / "docs" / "j1939_fail_safe.md"
    shown = dict(re.findall(r"^\| (\S[^|]*) \| ([\d.]+) s(?: each)? \|", page.read_text(), re.M))
    limits = TimeOuts()
    assert {name: float(seconds) for name, seconds in shown.items()} == {
        "EEC2": limits.pedal,
        "XBR": limits.xbr,
        "TSC1 to 15, to 16": limits.engine_retarder,
        "IITS_COMMAND": limits.body,
    }
    assert limits.engine_retarder == limits.driveline_retarder


@pytest.mark.parametrize("angle", [0.0, -1.0, math.nan, math.inf])
def test_end_stops_are_finite_and_positive(angle):
    with pytest.raises(InputError, match="steering_angle_max"):
        CommandReceiver(steering_angle_max=angle)


def test_a_new_receiver_has_lost_the_driver_but_no_command():
    loss = CommandReceiver().loss(0.0)
    assert loss.silent == ()
    assert loss.body is Heard.NEVER
    assert loss.driver


def test_no_command_is_lost_while_all_are_received():
    loss = driven().loss(0.05)
    assert loss.silent == ()
    assert not loss.driver


def test_silence_is_reported_per_message():
    receiver = driven()
    assert receiver.loss(0.2).silent == ("xbr", "body")
    everything = ("pedal", "xbr", "engine_retarder", "driveline_retarder", "body")
    assert receiver.loss(0.3).silent == everything
    assert receiver.loss(0.3).driver


def test_the_driver_is_lost_when_the_accelerator_falls_silent():
    receiver = CommandReceiver()
    for k in range(20):
        receiver.receive(frame_of("IITS_COMMAND", FIRST, k, 0.02 * k))
    assert not receiver.loss(0.38).driver
    receiver.receive(frame_of("EEC2", FIRST, 0, 0.0))
    assert receiver.loss(0.38).pedal is Heard.SILENT
    assert receiver.loss(0.38).driver


def test_the_driver_is_lost_when_an_active_brake_demand_falls_silent():
    receiver = CommandReceiver()
    for k in range(20):
        receiver.receive(frame_of("IITS_COMMAND", FIRST, k, 0.02 * k))
        if k < 10:
            receiver.receive(frame_of("XBR", FIRST, k, 0.02 * k))
    assert not receiver.loss(0.28).driver
    assert receiver.loss(0.3).silent == ("xbr",)
    assert receiver.loss(0.3).driver


def test_a_released_brake_demand_is_not_lost():
    receiver = CommandReceiver()
    assert receiver.receive(frame_of("XBR", VehicleCommand(), 0, 0.0))
    assert receiver.receive(frame_of("TSC1 to 16", VehicleCommand(), 0, 0.0))
    assert receiver.loss(1.0).xbr is Heard.RELEASED
    assert receiver.loss(1.0).driveline_retarder is Heard.RELEASED
    assert receiver.loss(1.0).silent == ()
