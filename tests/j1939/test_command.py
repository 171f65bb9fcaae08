import dataclasses

import pytest

from iits_mj.core.errors import InputError
from iits_mj.core.messages import TransmissionMode, VehicleCommand, XbrEbiMode, XbrMode
from iits_mj.j1939 import CommandReceiver, Frame, TimeOuts, command_to_frames, decode
from iits_mj.j1939.frame import tsc1_checksum, with_byte8, xbr_checksum
from iits_mj.j1939.mapping import commands

COMMAND = VehicleCommand(
    accelerator_pedal=0.4,
    xbr_demand=-1.5,
    xbr_mode=XbrMode.MAXIMUM,
    steering_wheel_angle=-0.7,
    parking_brake=0.0,
    engine_brake=0.5,
    transmission_mode=TransmissionMode.DRIVE,
    retarder=0.75,
    brake_pedal=0.2,
    xbr_ebi_mode=XbrEbiMode.INTEGRATION,
)


def _send(receiver, command, counter, time):
    return [receiver.receive(frame) for frame in command_to_frames(command, counter, time)]


def _frame(command, counter, name, time=0.0, destination=None):
    frames = command_to_frames(command, counter, time)
    return next(
        f for f in frames if decode(f).name == name and destination in (None, f.destination)
    )


def _to_all_units(frame):
    return Frame(frame.can_id | 0xFF00, frame.data, frame.time)


def test_command_crosses_the_bus_within_the_resolution_of_the_signals():
    receiver = CommandReceiver()
    assert all(_send(receiver, COMMAND, 0, 1.0))
    received = receiver.command(1.0)
    assert received.accelerator_pedal == pytest.approx(0.4, abs=0.002)
    assert received.xbr_demand == pytest.approx(-1.5, abs=0.5 / 2048)
    assert received.xbr_mode is XbrMode.MAXIMUM
    assert received.steering_wheel_angle == pytest.approx(-0.7, abs=0.5 / 1024)
    assert received.engine_brake == pytest.approx(0.5, abs=0.005)
    assert received.retarder == pytest.approx(0.75, abs=0.005)
    assert received.brake_pedal == pytest.approx(0.2, abs=0.002)
    assert received.xbr_ebi_mode is XbrEbiMode.INTEGRATION


def test_every_field_of_the_command_has_its_row_in_the_order_of_the_controls():
    names = [field.name for field in dataclasses.fields(VehicleCommand)]
    assert [row.quantity for row in commands()] == names
    assert [row.elements[0] for row in commands()] == names


def test_every_selector_position_and_the_parking_brake_cross_the_bus():
    receiver = CommandReceiver()
    for counter, mode in enumerate(TransmissionMode):
        command = VehicleCommand(parking_brake=1.0, transmission_mode=mode)
        _send(receiver, command, counter, 0.0)
        assert receiver.command(0.0).transmission_mode is mode
        assert receiver.command(0.0).parking_brake == 1.0


def test_xbr_checksum_known_answer():
    # Bytes 7F 71 E0 FF FF FF FF, counter 5, identifier 0C 04 0B 2A.
    frame = Frame(0x0C040B2A, bytes([0x7F, 0x71, 0xE0, 0xFF, 0xFF, 0xFF, 0xFF, 0x05]))
    total = 0x7F + 0x71 + 0xE0 + 4 * 0xFF + 5 + 0x0C + 0x04 + 0x0B + 0x2A
    assert total == 1558
    assert xbr_checksum(frame) == (97 + 1558) % 16 == 7


def test_tsc1_checksum_known_answer():
    frame = Frame(0x0C000011, bytes([0x01, 0x20, 0x1C, 0xFF, 0xFF, 0xFF, 0xFF, 0x03]))
    total = 0x01 + 0x20 + 0x1C + 4 * 0xFF + 3 + 0x11 + 0x0C
    assert total == 1113
    assert tsc1_checksum(frame) == ((1113 >> 6) % 4 + (1113 >> 3) + 1113) % 8


def test_silent_bus_leads_to_the_safe_command():
    receiver = CommandReceiver()
    _send(receiver, COMMAND, 0, 0.0)
    safe = receiver.command(1.0)
    assert safe.accelerator_pedal == 0.0
    assert (safe.xbr_mode, safe.xbr_demand) == (XbrMode.OFF, 0.0)
    assert (safe.engine_brake, safe.retarder) == (0.0, 0.0)
    assert safe.xbr_ebi_mode is XbrEbiMode.FRICTION_ONLY
    # The driver's brake pedal keeps its position.
    assert safe.brake_pedal == pytest.approx(0.2, abs=0.002)
    assert safe.steering_wheel_angle == pytest.approx(-0.7, abs=1e-3)


def test_command_before_the_first_frame_is_the_safe_one():
    assert CommandReceiver().command(0.0) == VehicleCommand()


def test_xbr_is_released_after_100_ms_and_not_before():
    receiver = CommandReceiver()
    _send(receiver, COMMAND, 0, 5.0)
    assert receiver.command(5.1).xbr_mode is XbrMode.MAXIMUM
    assert receiver.command(5.101).xbr_mode is XbrMode.OFF


def test_each_retarder_has_its_own_value_counter_and_time_out():
    receiver = CommandReceiver(TimeOuts(engine_retarder=0.1, driveline_retarder=0.3))
    assert receiver.receive(_frame(COMMAND, 3, "TSC1", 0.0, 0x0F))
    assert receiver.command(0.0).retarder == 0.0
    # The same counter, but to the other unit.
    assert receiver.receive(_frame(COMMAND, 3, "TSC1", 0.0, 0x10))
    both = receiver.command(0.05)
    assert (both.engine_brake, both.retarder) == pytest.approx((0.5, 0.75))
    later = receiver.command(0.2)
    assert (later.engine_brake, later.retarder) == pytest.approx((0.0, 0.75))
    assert receiver.command(0.31).retarder == 0.0
    assert receiver.accepted == {"TSC1 to 15": 1, "TSC1 to 16": 1}


def test_torque_control_of_the_engine_is_ignored_by_the_retarders():
    to_engine = Frame(_frame(COMMAND, 1, "TSC1").can_id & ~0xFF00, b"\xff" * 8)
    receiver = CommandReceiver()
    assert not receiver.receive(to_engine)
    assert not receiver.rejected


def test_torque_control_to_the_global_address_reaches_both_retarders():
    frame = _to_all_units(_frame(COMMAND, 1, "TSC1", 0.0, 0x0F))
    receiver = CommandReceiver()
    assert receiver.receive(with_byte8(frame, 1, tsc1_checksum(frame)))
    received = receiver.command(0.0)
    assert (received.engine_brake, received.retarder) == pytest.approx((0.5, 0.5))


def test_override_off_releases_the_retarder_at_once():
    receiver = CommandReceiver()
    _send(receiver, COMMAND, 0, 0.0)
    _send(receiver, dataclasses.replace(COMMAND, retarder=0.0), 1, 0.02)
    assert receiver.command(0.02).retarder == 0.0
    assert receiver.command(0.02).engine_brake == pytest.approx(0.5)


def test_a_sender_without_a_driver_keeps_the_brake_pedal():
    good = _frame(COMMAND, 1, "IITS_COMMAND")
    frame = Frame(good.can_id, good.data[:3] + b"\xff" + good.data[4:])
    receiver = CommandReceiver()
    assert receiver.receive(with_byte8(frame, 1, xbr_checksum(frame)))
    assert receiver.command(0.0).brake_pedal == 0.0
    assert receiver.command(0.0).steering_wheel_angle == pytest.approx(-0.7, abs=1e-3)


@pytest.mark.parametrize("mode", XbrEbiMode)
def test_every_endurance_brake_integration_mode_crosses_the_bus(mode):
    receiver = CommandReceiver()
    _send(receiver, dataclasses.replace(COMMAND, xbr_ebi_mode=mode), 0, 0.0)
    assert receiver.command(0.0).xbr_ebi_mode is mode


def test_repeated_counter_is_rejected_and_counted():
    receiver = CommandReceiver()
    _send(receiver, COMMAND, 3, 0.0)
    assert not receiver.receive(_frame(COMMAND, 3, "XBR", 0.02))
    assert receiver.rejected["XBR: counter repeated"] == 1
    assert receiver.receive(_frame(COMMAND, 4, "XBR", 0.04))


@pytest.mark.parametrize(
    ("name", "destination"),
    [("XBR", None), ("TSC1", 0x0F), ("TSC1", 0x10), ("IITS_COMMAND", None)],
)
def test_any_flipped_bit_in_a_protected_frame_is_rejected(name, destination):
    good = _frame(COMMAND, 1, name, 0.0, destination)
    for bit in range(64):
        data = bytearray(good.data)
        data[bit // 8] ^= 1 << bit % 8
        receiver = CommandReceiver()
        accepted = receiver.receive(Frame(good.can_id, bytes(data)))
        # TSC1's checksum uses 3 of the 4 bits; the highest bit must be checked as well.
        assert not accepted, bit


def _reworked(name, byte, value):
    good = _frame(COMMAND, 1, name)
    data = bytearray(good.data)
    data[byte] = value
    frame = Frame(good.can_id, bytes(data))
    check = tsc1_checksum if name == "TSC1" else xbr_checksum
    return frame if name == "EEC2" else with_byte8(frame, 1, check(frame))


@pytest.mark.parametrize(
    ("name", "byte", "value"),
    [
        ("EEC2", 1, 0xFE),
        ("EEC2", 1, 0xFF),
        ("EEC2", 1, 0xFC),
        ("XBR", 1, 0xFE),
        ("XBR", 1, 0x00),
        ("XBR", 1, 0xF0),
        ("XBR", 2, 0xFF),
        ("XBR", 2, 0xE7),
        ("TSC1", 3, 0xFE),
        ("TSC1", 3, 0xE0),
        ("IITS_COMMAND", 1, 0xFF),
        ("IITS_COMMAND", 2, 0xFF),
        ("IITS_COMMAND", 3, 0xFE),
        ("IITS_COMMAND", 3, 0xFB),
    ],
)
def test_error_codes_and_values_out_of_range_are_rejected(name, byte, value):
    receiver = CommandReceiver()
    assert not receiver.receive(_reworked(name, byte, value))
    assert sum(receiver.rejected.values()) == 1
    assert receiver.command(0.0) == VehicleCommand()


def test_commands_to_other_addresses_are_ignored():
    frame = _frame(COMMAND, 1, "XBR")
    other = Frame(frame.can_id & ~0xFF00 | 0x3300, frame.data)
    receiver = CommandReceiver()
    assert not receiver.receive(other)
    assert not receiver.rejected


@pytest.mark.parametrize(
    "change",
    [
        {"accelerator_pedal": float("nan")},
        {"accelerator_pedal": 1.01},
        {"xbr_demand": 0.5},
        {"xbr_demand": -11.0},
        {"engine_brake": -0.1},
        {"retarder": 1.5},
        {"retarder": float("nan")},
        {"brake_pedal": -0.2},
        {"steering_wheel_angle": float("inf")},
        {"steering_wheel_angle": 40.0},
    ],
)
def test_invalid_command_is_refused_before_it_is_sent(change):
    with pytest.raises(InputError, match=next(iter(change))):
        command_to_frames(dataclasses.replace(COMMAND, **change), 0)
