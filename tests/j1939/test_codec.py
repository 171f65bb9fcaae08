"""A part of a message's signals is packed and read as the whole message is."""

import dataclasses
import math

import pytest

from iits_mj.core.errors import BusError
from iits_mj.j1939 import Frame, Status, make_group, message_names
from iits_mj.j1939.database import codec_of, group_type, identifier, name_of, pack, pgn_of, unpack


@pytest.mark.parametrize("name", message_names())
def test_each_signal_alone_has_the_place_that_it_has_in_the_message(name):
    for field in dataclasses.fields(group_type(name)):
        alone = codec_of(name).part({field.name: 1.0})
        data = alone.pack([1.0], saturate=True)
        assert data == pack(make_group(name, {field.name: 1.0}), saturate=True)
        (value,) = alone.unpack(data)
        group = unpack(pgn_of(name), data)
        assert group is not None
        assert value == getattr(group, field.name)


def test_values_are_in_the_caller_s_unit_both_ways():
    engine = codec_of("EEC1").part({"engine_speed_rpm": math.pi / 30.0})
    data = engine.pack([100.0])
    assert data == pack(make_group("EEC1", {"engine_speed_rpm": 100.0 / (math.pi / 30.0)}))
    (speed,) = engine.unpack(data)
    assert speed == pytest.approx(100.0, abs=0.5 * 0.125 * math.pi / 30.0)


def test_what_is_refused_is_told_in_the_caller_s_unit():
    pedal = codec_of("EEC2").part({"accelerator_pedal_position_percent": 0.01})
    with pytest.raises(BusError, match=r"= 1\.5: allowed is 0 to 1$"):
        pedal.pack([1.5])
    retarder = codec_of("TSC1").part({"requested_torque_percent": -0.01})
    with pytest.raises(BusError, match=r"= 2\.0: allowed is -1\.25 to 1\.25$"):
        retarder.pack([2.0])


@pytest.mark.parametrize("value", [None, Status.NOT_AVAILABLE])
def test_what_nobody_knows_is_all_ones(value):
    speed = codec_of("EEC1").part({"engine_speed_rpm": 1.0})
    assert speed.pack([value]) == b"\xff" * 8
    assert speed.unpack(b"\xff" * 8) == [Status.NOT_AVAILABLE]


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 10**400])
def test_no_number_gets_into_a_message_that_is_none(value):
    with pytest.raises(BusError, match="a finite number is wanted"):
        codec_of("EEC1").part({"engine_speed_rpm": 2.0}).pack([value], saturate=True)


def test_a_part_of_a_message_has_the_message_s_length():
    with pytest.raises(BusError, match="EEC1 has 7 bytes: 8 are wanted"):
        codec_of("EEC1").part({}).unpack(bytes(7))


def test_the_identifier_is_the_sender_s_and_receiver_s():
    frame = Frame(identifier("TSC1", 0x2A, 0x10), b"")
    assert (frame.source, frame.destination, name_of(frame.pgn)) == (0x2A, 0x10, "TSC1")
    assert name_of(0xFFFF) is None
    with pytest.raises(BusError, match="source 300"):
        identifier("TSC1", 300)


def test_a_frame_never_changes():
    frame = Frame(1, b"\x00", 0.5)
    for name in ("can_id", "data", "time"):
        with pytest.raises(dataclasses.FrozenInstanceError):
            setattr(frame, name, getattr(frame, name))
    assert dataclasses.replace(frame, time=1.0) == Frame(1, b"\x00", 1.0) != frame
