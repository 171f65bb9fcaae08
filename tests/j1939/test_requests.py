"""Requests in the command messages, their ranges, and the receiver's choice between senders."""

import dataclasses
import math

import pytest

from iits_mj.core.errors import InputError
from iits_mj.core.messages import TransmissionMode, VehicleCommand, XbrEbiMode, XbrMode
from iits_mj.j1939 import CommandReceiver, Frame, Heard, TimeOuts, command_to_frames, decode
from iits_mj.j1939.command import COMMAND_MESSAGES, CommandSender
from iits_mj.j1939.frame import GLOBAL_ADDRESS, tsc1_checksum, with_byte8
from iits_mj.j1939.groups import NOT_AVAILABLE
from iits_mj.j1939.network import BRAKES, CONTROLLER, DRIVELINE_RETARDER, ENGINE_RETARDER
from iits_mj.j1939.receiver import _MOST_STRANGERS, STEERING_ANGLE_MAX, Loss
from iits_mj.j1939.requests import (
    BodyRequest,
    PedalRequest,
    Reason,
    RejectedError,
    RetarderRequest,
    XbrRequest,
)
from tests.j1939.test_fail_safe import FIRST, OTHER, PROTECTED, UNITS, counts, driven, frame_of

ANGLE_STEP = 1.0 / 1024


def assert_reason(read, reason):
    with pytest.raises(RejectedError) as caught:
        read()
    assert caught.value.reason is reason
    assert str(caught.value) == reason.value


# --- ranges ---------------------------------------------------------------------------------


def test_a_pedal_is_0_to_100_percent():
    assert PedalRequest.read(0.0).position == 0.0
    assert PedalRequest.read(100.0).position == 1.0
    assert PedalRequest.read(37.0).position == pytest.approx(0.37)
    for wrong in (-0.1, 100.1):
        assert_reason(lambda wrong=wrong: PedalRequest.read(wrong), Reason.OUT_OF_RANGE)
    assert_reason(lambda: PedalRequest.read(NOT_AVAILABLE), Reason.NOT_AVAILABLE)


def test_a_brake_demand_is_a_deceleration_up_to_10():
    assert XbrRequest.read(2, -10.0, 1, 3) == XbrRequest(
        XbrMode.MAXIMUM, -10.0, XbrEbiMode.ENDURANCE_ONLY, 3
    )
    # Zero is off the grid of the signal; a demand never accelerates.
    assert XbrRequest.read(1, 5e-4, 0, 0).demand == 0.0
    assert XbrRequest.read(1, -2.5, 0, 0).demand == -2.5
    for wrong in ((1, -10.001, 0, 0), (1, 2e-3, 0, 0), (3, -1.0, 0, 0), (1, -1.0, 3, 0)):
        assert_reason(lambda wrong=wrong: XbrRequest.read(*wrong), Reason.OUT_OF_RANGE)
    for priority in (-1, 4):
        assert_reason(lambda p=priority: XbrRequest.read(1, -1.0, 0, p), Reason.OUT_OF_RANGE)
    # Without a demand the other signals do not count.
    off = XbrRequest.read(0, NOT_AVAILABLE, NOT_AVAILABLE, NOT_AVAILABLE)
    assert (off, off.active) == (XbrRequest(XbrMode.OFF), False)
    assert (off.demand, off.ebi_mode, off.priority) == (0.0, XbrEbiMode.FRICTION_ONLY, 3)
    assert XbrRequest.read(1, 0.0, 0, 0).active


def test_a_retarder_obeys_torque_control_from_minus_100_to_0_percent():
    assert RetarderRequest.read(2, -100.0, 0) == RetarderRequest(True, 1.0, 0)
    assert RetarderRequest.read(2, -35.0, 3).share == pytest.approx(0.35)
    assert math.copysign(1.0, RetarderRequest.read(2, 0.0, 0).share) == 1.0
    off = RetarderRequest.read(0, NOT_AVAILABLE, NOT_AVAILABLE)
    assert (off.active, off.share, off.priority) == (False, 0.0, 3)
    wrongs = ((1, -5.0, 0), (3, -5.0, 0), (4, -5.0, 0), (2, -100.5, 0), (2, 0.5, 0), (2, -5.0, 4))
    for wrong in wrongs:
        assert_reason(lambda wrong=wrong: RetarderRequest.read(*wrong), Reason.OUT_OF_RANGE)


def body(steering=1, angle=0.5, parking=0, selector=1, pedal=NOT_AVAILABLE, most=3.0):
    return BodyRequest.read(steering, angle, parking, selector, pedal, angle_max=most)


def test_the_drivers_controls_are_read_within_their_ranges():
    assert body() == BodyRequest(0.5, 0.0, TransmissionMode(1), None)
    assert body(parking=1).parking_brake == 1.0
    assert body(pedal=20.0).brake_pedal == pytest.approx(0.2)
    assert body(pedal=100.0).brake_pedal == 1.0
    assert body(steering=0, angle=NOT_AVAILABLE).steering_wheel_angle is None
    for mode in TransmissionMode:
        assert body(selector=mode.value).transmission_mode is mode
    wrongs = (
        *({"steering": 2}, {"parking": 2}, {"parking": -1}, {"selector": 21}, {"selector": -1}),
        *({"pedal": 100.4}, {"pedal": -0.4}, {"angle": 3.01}, {"angle": -3.01}),
    )
    for wrong in wrongs:
        assert_reason(lambda wrong=wrong: body(**wrong), Reason.OUT_OF_RANGE)


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_half_a_step_beyond_the_end_stop_is_rounding(side):
    assert body(angle=side * (3.0 + 0.49 * ANGLE_STEP)).steering_wheel_angle == side * 3.0
    assert body(angle=side * 2.9).steering_wheel_angle == side * 2.9
    beyond = side * (3.0 + 0.51 * ANGLE_STEP)
    assert_reason(lambda: body(angle=beyond), Reason.OUT_OF_RANGE)


# --- the sender -----------------------------------------------------------------------------


def test_the_messages_have_their_destinations_counters_and_priority():
    found = {
        name: (sent.name, sent.address, sent.counters) for name, sent in COMMAND_MESSAGES.items()
    }
    assert found == {
        "pedal": ("EEC2", GLOBAL_ADDRESS, 0),
        "xbr": ("XBR", BRAKES, 16),
        "engine_retarder": ("TSC1 to 15", ENGINE_RETARDER, 8),
        "driveline_retarder": ("TSC1 to 16", DRIVELINE_RETARDER, 8),
        "body": ("IITS_COMMAND", GLOBAL_ADDRESS, 16),
    }
    xbr = decode(frame_of("XBR", FIRST, 0, 0.0)).group
    assert xbr.xbr_priority == 1
    # A retarder without a request has no override, so that other senders may use it.
    for share, mode in ((0.0, 0), (0.3, 2)):
        command = dataclasses.replace(FIRST, retarder=share)
        frame = frame_of("TSC1 to 16", command, 0, 0.0)
        assert decode(frame).group.override_control_mode == mode


@pytest.mark.parametrize(("position", "requested"), [(0.0, 0), (0.49, 0), (0.5, 1), (1.0, 1)])
def test_the_parking_brake_is_requested_from_half_of_its_travel(position, requested):
    command = dataclasses.replace(FIRST, parking_brake=position)
    frame = frame_of("IITS_COMMAND", command, 0, 0.0)
    assert decode(frame).group.parking_brake_request == requested


@pytest.mark.parametrize("name", [field.name for field in dataclasses.fields(VehicleCommand)])
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_a_command_that_is_not_finite_is_named(name, value):
    with pytest.raises(InputError, match=f"command {name} = {value!r}: a finite number is needed"):
        command_to_frames(dataclasses.replace(FIRST, **{name: value}), 0)


def test_the_ends_of_the_ranges_are_allowed():
    for name in ("accelerator_pedal", "engine_brake", "retarder", "brake_pedal"):
        for value in (0.0, 1.0):
            assert len(command_to_frames(dataclasses.replace(FIRST, **{name: value}), 0)) == 5
    assert len(command_to_frames(dataclasses.replace(FIRST, xbr_demand=-10.0), 0)) == 5


def test_each_message_has_its_own_counter_and_rate():
    sender = CommandSender()
    sent = {}
    for k in range(26):
        for frame in sender.frames(FIRST, 0.02 * k):
            assert frame.source == CONTROLLER
            decoded = decode(frame)
            name = f"TSC1 {frame.destination}" if decoded.name == "TSC1" else decoded.name
            counter = {
                "XBR": "xbr_message_counter",
                "TSC1": "tsc1_message_counter",
                "IITS_COMMAND": "command_message_counter",
            }.get(decoded.name, "source")
            found = getattr(decoded.group, counter, None)
            sent.setdefault(name, []).append(found)
    assert sent["XBR"] == [k % 16 for k in range(26)]
    assert sent["IITS_COMMAND"] == sent["XBR"]
    assert sent["TSC1 15"] == sent["TSC1 16"] == [k % 8 for k in range(len(sent["EEC2"]))]
    assert 10 <= len(sent["EEC2"]) <= 12
    assert all(frame.source == 0x33 for frame in CommandSender(0x33).frames(FIRST, 0.0))
    with pytest.raises(InputError):
        CommandSender(254)


# --- time -----------------------------------------------------------------------------------


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_a_request_is_in_force_within_its_time_out_either_way_up_to_a_microsecond(sign):
    for beyond, mode in ((0.9e-6, XbrMode.MAXIMUM), (1.6e-6, XbrMode.OFF)):
        receiver = CommandReceiver()
        receiver.receive(frame_of("XBR", FIRST, 3, 5.0))
        assert receiver.command(5.0 + sign * (0.1 + beyond)).xbr_mode is mode


@pytest.mark.parametrize("unit", PROTECTED)
def test_frames_are_lost_only_within_the_time_out(unit):
    time_out = 0.25 if unit.startswith("TSC1") else 0.1
    for gap, lost in ((time_out, 2), (time_out + 0.9e-6, 2), (time_out + 1.6e-6, 0), (5.0, 0)):
        receiver = CommandReceiver()
        receiver.receive(frame_of(unit, FIRST, 3, 5.0))
        assert receiver.receive(frame_of(unit, FIRST, 6, 5.0 + gap))
        assert sum(receiver.lost.values()) == lost
    # After a restart of the clock the sequence starts again.
    receiver = CommandReceiver()
    receiver.receive(frame_of(unit, FIRST, 3, 5.0))
    assert receiver.receive(frame_of(unit, FIRST, 6, 5.0 - time_out - 1.0))
    assert receiver.lost == {}


@pytest.mark.parametrize("unit", UNITS)
def test_an_older_frame_is_late_only_within_the_time_out(unit):
    time_out = 0.25 if unit.startswith(("TSC1", "EEC2")) else 0.1
    for back, taken in (
        (0.5e-6, True),
        (2e-6, False),
        (0.9 * time_out, False),
        (time_out + 1e-5, True),
    ):
        receiver = CommandReceiver()
        receiver.receive(frame_of(unit, FIRST, 3, 8.0))
        assert receiver.receive(frame_of(unit, OTHER, 4, 8.0 - back)) is taken


def test_a_frame_is_counted_lost_by_the_number_of_counters():
    receiver = driven()
    assert receiver.receive(frame_of("XBR", OTHER, 2, 0.04))
    assert receiver.receive(frame_of("TSC1 to 15", OTHER, 2, 0.04))
    # From 3 to 2: all values between were skipped.
    assert receiver.lost == {"XBR": 14, "TSC1 to 15": 6}


# --- senders --------------------------------------------------------------------------------


def test_of_equal_priority_the_strongest_brake_demand_counts():
    receiver = CommandReceiver()
    weak = dataclasses.replace(FIRST, xbr_demand=-1.0)
    strong = dataclasses.replace(FIRST, xbr_demand=-3.0, retarder=0.9, engine_brake=0.1)
    for source, command, priority in ((0x21, weak, 1), (0x22, strong, 1)):
        for unit in ("XBR", "TSC1 to 15", "TSC1 to 16"):
            assert receiver.receive(frame_of(unit, command, 3, 0.0, source, priority))
    found = receiver.command(0.0)
    assert found.xbr_demand == pytest.approx(-3.0, abs=1e-3)
    assert (found.retarder, found.engine_brake) == pytest.approx((0.9, 0.5))
    # A higher priority counts before the strength.
    assert receiver.receive(frame_of("XBR", weak, 4, 0.02, 0x21, 0))
    assert receiver.receive(frame_of("TSC1 to 16", FIRST, 4, 0.02, 0x21, 0))
    found = receiver.command(0.02)
    assert found.xbr_demand == pytest.approx(-1.0, abs=1e-3)
    assert found.retarder == pytest.approx(0.75)


@pytest.mark.parametrize(
    ("unit", "field"), [("EEC2", "accelerator_pedal"), ("IITS_COMMAND", "steering_wheel_angle")]
)
def test_the_first_sender_holds_a_message_until_its_silence(unit, field):
    receiver = CommandReceiver()
    assert receiver.receive(frame_of("IITS_COMMAND", FIRST, 0, 0.0, 0x21))
    receiver.receive(frame_of("EEC2", FIRST, 0, 0.0, 0x21))
    assert not receiver.receive(frame_of(unit, OTHER, 1, 0.02, 0x22))
    assert receiver.ignored == {f"{unit}: held by another sender": 1}
    assert not receiver.rejected
    assert receiver.receive(frame_of(unit, FIRST, 2, 0.04, 0x21))
    # Silent for longer than the time-out: the next sender takes over.
    assert receiver.receive(frame_of(unit, OTHER, 2, 0.6, 0x22))
    assert receiver._units["pedal" if unit == "EEC2" else "body"].holder == 0x22
    assert getattr(receiver.command(0.6), field) == pytest.approx(
        0.0 if unit == "EEC2" else 2.0, abs=1e-3
    )


def test_a_message_to_all_is_obeyed_if_one_unit_obeys_it():
    receiver = CommandReceiver()
    assert receiver.receive(frame_of("TSC1 to 15", FIRST, 1, 0.0))
    frame = frame_of("TSC1 to 15", OTHER, 1, 0.02)
    frame = dataclasses.replace(frame, can_id=frame.can_id | 0xFF00)
    # The engine's retarder has heard this counter, the driveline's has not.
    assert receiver.receive(with_byte8(frame, 1, tsc1_checksum(frame)))
    assert receiver.accepted == {"TSC1 to 15": 1, "TSC1 to 16": 1}
    assert receiver.rejected == {"TSC1 to 15: counter repeated": 1}


def test_strangers_are_counted_by_message_and_address():
    receiver = CommandReceiver(sources=[CONTROLLER])
    for source in (0x55, 0x55, 0x56):
        assert not receiver.receive(frame_of("XBR", FIRST, 1, 0.0, source))
    assert receiver.strangers == {("XBR", 0x55): 2, ("XBR", 0x56): 1}
    assert counts(receiver) == {"XBR: from an address that is not obeyed": 3}
    # A frame to another unit is none of this truck's.
    frame = frame_of("XBR", FIRST, 1, 0.0, 0x57)
    assert not receiver.receive(dataclasses.replace(frame, can_id=frame.can_id ^ 0x0100))
    assert len(receiver.strangers) == 2
    receiver.strangers.update({("x", k): 1 for k in range(_MOST_STRANGERS - 2)})
    receiver.receive(frame_of("XBR", FIRST, 1, 0.0, 0x58))
    assert len(receiver.strangers) == _MOST_STRANGERS


def test_a_frame_that_is_no_command_is_not_counted():
    receiver = CommandReceiver()
    assert not receiver.receive(Frame(0x18FEF100, bytes(8), 0.0))
    assert counts(receiver) == {}


# --- states ---------------------------------------------------------------------------------


def test_the_driver_is_missing_without_steering_or_with_a_silent_pedal_or_brake():
    alive = dict.fromkeys(COMMAND_MESSAGES, Heard.ALIVE)
    assert not Loss(**alive).driver
    assert Loss(**alive).silent == ()
    for name, state, missing in (
        ("body", Heard.NEVER, True),
        ("body", Heard.SILENT, True),
        ("pedal", Heard.SILENT, True),
        ("xbr", Heard.SILENT, True),
        ("xbr", Heard.RELEASED, False),
        ("pedal", Heard.NEVER, False),
        ("engine_retarder", Heard.SILENT, False),
    ):
        loss = Loss(**(alive | {name: state}))
        assert loss.driver is missing
        assert loss.silent == ((name,) if state is Heard.SILENT else ())


def test_a_released_request_may_fall_silent():
    released = dataclasses.replace(FIRST, xbr_mode=XbrMode.OFF, xbr_demand=0.0, retarder=0.0)
    receiver = CommandReceiver()
    assert receiver.loss(0.0).xbr is Heard.NEVER
    for frame in command_to_frames(released, 0, 0.0):
        receiver.receive(frame)
    assert receiver.loss(0.1).xbr is Heard.ALIVE
    later = receiver.loss(1.0)
    assert (later.xbr, later.driveline_retarder) == (Heard.RELEASED, Heard.RELEASED)
    assert (later.engine_retarder, later.pedal, later.body) == (Heard.SILENT,) * 3
    # The last sender's request decides, not the first one's.
    receiver.receive(frame_of("XBR", FIRST, 5, 2.0, 0x22))
    assert receiver.loss(3.0).xbr is Heard.SILENT


def test_time_outs_are_positive_and_by_unit():
    for name in ("pedal", "xbr", "engine_retarder", "driveline_retarder", "body"):
        with pytest.raises(InputError, match=name):
            TimeOuts(**{name: 0.0})
    receiver = CommandReceiver(TimeOuts(pedal=0.5, body=0.7))
    for frame in command_to_frames(FIRST, 0, 0.0):
        receiver.receive(frame)
    assert receiver.command(0.5).accelerator_pedal == pytest.approx(0.4)
    assert receiver.command(0.51).accelerator_pedal == 0.0
    with pytest.raises(InputError, match="steering_angle_max"):
        CommandReceiver(steering_angle_max=0.0)
    assert CommandReceiver().steering_angle_max == STEERING_ANGLE_MAX


def test_controls_that_a_request_leaves_out_keep_their_positions():
    receiver = driven()
    assert receiver.receive(frame_of("IITS_COMMAND", OTHER, 4, 0.02))
    held = receiver.command(0.5)
    assert (held.parking_brake, held.transmission_mode) == (1.0, TransmissionMode.NEUTRAL)
    assert held.brake_pedal == pytest.approx(0.6)
    assert held.steering_wheel_angle == pytest.approx(2.0, abs=1e-3)
