"""Known answers: bytes worked out by hand from the public bit layouts."""

import copy
import dataclasses
import math
import pickle

import pytest
from j1939_manual import PAGE, fill, tables

from iits_mj.core.errors import BusError
from iits_mj.j1939 import (
    NOT_AVAILABLE,
    Frame,
    Status,
    decode,
    encode,
    group_type,
    groups,
    make_group,
    make_id,
    message_names,
    pack,
    pgn_of,
    unpack,
)
from iits_mj.j1939.database import codec_of, identifier, name_of
from iits_mj.j1939.groups import (
    CCVS1,
    EEC1,
    EEC2,
    ERC1,
    ETC1,
    ETC2,
    LFE1,
    TSC1,
    VDC2,
    VW,
    XBR,
    IitsTrailer,
    layouts,
)
from iits_mj.j1939.mapping import commands, reports

PGNS = {
    "XBR": 1024,
    "TSC1": 0,
    "EEC2": 61443,
    "EEC1": 61444,
    "EEC3": 65247,
    "ERC1": 61440,
    "ETC1": 61442,
    "ETC2": 61445,
    "CCVS1": 65265,
    "EBC1": 61441,
    "EBC2": 65215,
    "EBC5": 64964,
    "VDC2": 61449,
    "LFE1": 65266,
    "AIR1": 65198,
    "VW": 65258,
}


@pytest.mark.parametrize(("name", "pgn"), PGNS.items())
def test_parameter_group_numbers_are_the_standard_ones(name, pgn):
    assert pgn_of(name) == pgn


def test_own_messages_are_proprietary_b():
    own = [name for name in message_names() if name.startswith("IITS_")]
    assert own
    assert all(0xFF00 <= pgn_of(name) <= 0xFFFF for name in own)


def test_xbr_goes_to_the_brakes_with_priority_3():
    frame = encode(XBR(external_acceleration_demand=-1.5))
    assert (frame.priority, frame.pgn, frame.destination) == (3, 1024, 0x0B)
    assert frame.can_id == 0x0C040B2A


def test_xbr_demand_is_16_bit_little_endian_of_1_2048_with_offset():
    # (-1.5 + 15.687) * 2048 = 29054.98 -> 29055 = 0x717F
    frame = encode(XBR(external_acceleration_demand=-1.5))
    assert frame.data[:2] == bytes([0x7F, 0x71])


def test_xbr_control_mode_is_bits_5_and_6_of_byte_3():
    values = {"xbr_ebi_mode": 0, "xbr_priority": 0, "xbr_control_mode": 2}
    assert encode(XBR(**values)).data[2] & 0x3F == 0b10_00_00


def test_engine_speed_is_an_eighth_rpm_in_bytes_4_and_5():
    frame = encode(EEC1(engine_speed_rpm=1200.0))
    assert frame.data[3:5] == (9600).to_bytes(2, "little")


def test_pedal_is_byte_2_of_eec2_in_steps_of_0_4_percent():
    assert encode(EEC2(accelerator_pedal_position_percent=40.0)).data[1] == 100


def test_shift_in_process_is_bits_5_and_6_of_byte_1_of_etc1():
    assert encode(ETC1(shift_in_process=1.0)).data[0] == 0b11_01_11_11


def test_gear_has_an_offset_of_125_and_reverse_is_negative():
    assert encode(ETC2(current_gear=-1.0)).data[3] == 124
    assert encode(ETC2(current_gear=10.0)).data[3] == 135


def test_wheel_speed_and_steering_angle_known_answers():
    assert encode(CCVS1(wheel_based_speed_kph=80.0)).data[1:3] == bytes([0x00, 0x50])
    # (0 + 31.374) * 1024 = 32126.98 -> 32127 = 0x7D7F
    assert encode(VDC2(steering_wheel_angle=0.0)).data[:2] == bytes([0x7F, 0x7D])


def test_fuel_rate_and_axle_weight_known_answers():
    assert encode(LFE1(engine_fuel_rate_l_per_h=30.0)).data[:2] == bytes([0x58, 0x02])
    assert encode(VW(axle_weight_kg=9677.5)).data[1:3] == (19355).to_bytes(2, "little")


def test_missing_signals_are_not_available():
    frame = encode(EEC1())
    assert frame.data == b"\xff" * 8
    assert decode(frame).group.engine_speed_rpm is Status.NOT_AVAILABLE


@pytest.mark.parametrize(
    ("data", "status"),
    [
        (b"\xff\xff\xff\x00\xfe\xff\xff\xff", Status.ERROR),
        (b"\xff\xff\xff\x00\xff\xff\xff\xff", Status.NOT_AVAILABLE),
        (b"\xff\xff\xff\x00\xfb\xff\xff\xff", Status.OUT_OF_RANGE),
    ],
)
def test_codes_of_a_16_bit_signal_are_distinguished(data, status):
    decoded = decode(Frame(make_id(3, 61444, 0), data))
    assert decoded.group.engine_speed_rpm is status
    with pytest.raises(BusError, match=status.value):
        decoded.group.number("engine_speed_rpm")


def test_error_code_can_be_sent():
    frame = encode(EEC2(accelerator_pedal_position_percent=Status.ERROR))
    assert frame.data[1] == 0xFE


def test_groups_are_decoded_from_any_source_and_unknown_groups_are_none():
    frame = encode(EEC1(engine_speed_rpm=700.0), source=0x31)
    assert decode(frame).group.number("engine_speed_rpm") == 700.0
    assert decode(frame).source == 0x31
    assert decode(Frame(make_id(6, 65260, 0), b"\x00" * 8)) is None


def test_invalid_values_are_refused_with_their_names():
    with pytest.raises(BusError, match="engine_speed_rpm"):
        encode(EEC1(engine_speed_rpm=float("nan")))
    with pytest.raises(BusError, match="engine_speed_rpm"):
        encode(EEC1(engine_speed_rpm=9000.0))
    with pytest.raises(BusError, match="no signal"):
        make_group("EEC1", {"speed": 1.0})
    with pytest.raises(BusError, match="not in the DBC"):
        make_group("EEC99", {})
    with pytest.raises(BusError, match="bytes"):
        decode(Frame(make_id(3, 61444, 0), b"\x00" * 3))
    with pytest.raises(BusError, match="29 bits"):
        Frame(1 << 29, b"")


def test_saturation_keeps_a_sensor_inside_its_range():
    frame = encode(EEC1(engine_speed_rpm=9000.0), saturate=True)
    assert decode(frame).group.number("engine_speed_rpm") == pytest.approx(8031.875)


def test_endurance_brake_integration_is_bits_1_and_2_of_byte_3_of_xbr():
    values = {"xbr_ebi_mode": 2, "xbr_priority": 1, "xbr_control_mode": 2}
    assert encode(XBR(**values)).data[2] & 0x3F == 0b10_01_10


def test_retarder_torque_is_byte_2_of_erc1_in_percent_above_minus_125():
    frame = encode(ERC1(actual_retarder_torque_percent=-40.0), source=0x10)
    assert frame.can_id == 0x18F00010
    assert frame.data[1] == 85


def test_identifier_of_torque_control_to_the_driveline_retarder():
    frame = encode(TSC1(override_control_mode=2), destination=0x10)
    assert frame.can_id == 0x0C00102A


def test_manual_page_is_up_to_date_with_dbc_and_table_of_signals():
    page = PAGE.read_text(encoding="utf-8")
    assert fill(page) == page, "run `python tools/j1939_manual.py`"
    for name in tables():
        assert f"<!-- begin {name} -->" in page


def test_every_row_of_the_table_is_a_unique_signal_of_the_dbc():
    for rows in (commands(), reports()):
        keys = [(row.message, row.signal, row.address) for row in rows]
        assert len(set(keys)) == len(keys)
        for row in rows:
            assert hasattr(make_group(row.message, {}), row.signal)
    back = [row.quantity for row in reports() if row.back]
    assert len(set(back)) == len(back)


def test_typed_messages_are_made_from_the_dbc():
    for layout in layouts().messages:
        kind = group_type(layout.name)
        assert getattr(groups, kind.__name__) is kind
        assert layout.name == kind.MESSAGE
        assert [f.name for f in dataclasses.fields(kind)] == [s.name for s in layout.signals]
        assert f"PGN {pgn_of(layout.name)} " in kind.__doc__
        for signal in layout.signals:
            unit = f" [{signal.unit}]" if signal.unit else ""
            assert f"  {signal.name}:{unit} " in kind.__doc__
    assert "  engine_speed_rpm: [rpm] SPN 190.\n" in EEC1.__doc__
    with pytest.raises(ImportError, match="EEC99"):
        from iits_mj.j1939.groups import EEC99  # noqa: F401


def test_a_typed_message_is_an_immutable_value_that_can_be_copied_and_pickled():
    group = EEC1(engine_speed_rpm=1200.0)
    assert group == EEC1(engine_speed_rpm=1200.0) != EEC1()
    assert hash(group) == hash(EEC1(engine_speed_rpm=1200.0))
    assert repr(group).startswith("EEC1(engine_torque_mode=<Status.NOT_AVAILABLE")
    with pytest.raises(dataclasses.FrozenInstanceError):
        group.engine_speed_rpm = 0.0
    for same in (copy.copy(group), copy.deepcopy(group), pickle.loads(pickle.dumps(group))):
        assert same == group
        assert same.engine_torque_mode is NOT_AVAILABLE
    assert IitsTrailer(articulation=0.5).MESSAGE == "IITS_TRAILER"


def test_fields_of_a_typed_message_default_to_not_available():
    assert {value for _, value in EEC1().items()} == {NOT_AVAILABLE}


def test_a_status_without_a_code_is_refused():
    with pytest.raises(BusError, match="no code"):
        encode(XBR(xbr_control_mode=Status.ERROR))
    with pytest.raises(BusError, match="no code"):
        encode(EEC1(engine_speed_rpm=Status.OUT_OF_RANGE))


@pytest.mark.parametrize("name", message_names())
def test_each_field_agrees_with_cantools(name):
    # Against cantools' own physical values, signal by signal.
    layout = layouts().get_message_by_name(name)
    for signal in layout.signals:
        value = signal.scale + signal.offset
        data = pack(make_group(name, {signal.name: value}))
        assert len(data) == layout.length
        raw = layout.decode(data, decode_choices=False)
        assert raw[signal.name] == pytest.approx(value)
        assert getattr(unpack(pgn_of(name), data), signal.name) == pytest.approx(value)


@pytest.mark.parametrize("name", message_names())
def test_a_partial_codec_places_each_signal_as_the_whole_message(name):
    for field in dataclasses.fields(group_type(name)):
        alone = codec_of(name).part({field.name: 1.0})
        data = alone.pack([1.0], saturate=True)
        assert data == pack(make_group(name, {field.name: 1.0}), saturate=True)
        (value,) = alone.unpack(data)
        group = unpack(pgn_of(name), data)
        assert group is not None
        assert value == getattr(group, field.name)


def test_values_are_converted_to_and_from_the_callers_unit():
    engine = codec_of("EEC1").part({"engine_speed_rpm": math.pi / 30.0})
    data = engine.pack([100.0])
    assert data == pack(make_group("EEC1", {"engine_speed_rpm": 100.0 / (math.pi / 30.0)}))
    (speed,) = engine.unpack(data)
    assert speed == pytest.approx(100.0, abs=0.5 * 0.125 * math.pi / 30.0)


def test_range_errors_are_in_the_callers_unit():
    pedal = codec_of("EEC2").part({"accelerator_pedal_position_percent": 0.01})
    with pytest.raises(BusError, match=r"= 1\.5: allowed is 0 to 1$"):
        pedal.pack([1.5])
    retarder = codec_of("TSC1").part({"requested_torque_percent": -0.01})
    with pytest.raises(BusError, match=r"= 2\.0: allowed is -1\.25 to 1\.25$"):
        retarder.pack([2.0])


@pytest.mark.parametrize("value", [None, Status.NOT_AVAILABLE])
def test_unknown_values_are_all_ones(value):
    speed = codec_of("EEC1").part({"engine_speed_rpm": 1.0})
    assert speed.pack([value]) == b"\xff" * 8
    assert speed.unpack(b"\xff" * 8) == [Status.NOT_AVAILABLE]


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 10**400])
def test_numbers_that_are_not_finite_are_refused(value):
    with pytest.raises(BusError, match="a finite number is needed"):
        codec_of("EEC1").part({"engine_speed_rpm": 2.0}).pack([value], saturate=True)


def test_a_partial_codec_has_the_length_of_the_message():
    with pytest.raises(BusError, match="EEC1 has 7 bytes: 8 are needed"):
        codec_of("EEC1").part({}).unpack(bytes(7))


def test_the_identifier_contains_sender_and_receiver():
    frame = Frame(identifier("TSC1", 0x2A, 0x10), b"")
    assert (frame.source, frame.destination, name_of(frame.pgn)) == (0x2A, 0x10, "TSC1")
    assert name_of(0xFFFF) is None
    with pytest.raises(BusError, match="source 300"):
        identifier("TSC1", 300)


def test_a_frame_is_immutable():
    frame = Frame(1, b"\x00", 0.5)
    for name in ("can_id", "data", "time"):
        with pytest.raises(dataclasses.FrozenInstanceError):
            setattr(frame, name, getattr(frame, name))
    assert dataclasses.replace(frame, time=1.0) == Frame(1, b"\x00", 1.0) != frame
