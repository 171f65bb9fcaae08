import dataclasses
import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from iits_mj.core.messages import VehicleCommand, XbrEbiMode, XbrMode
from iits_mj.j1939 import (
    CommandReceiver,
    Frame,
    Status,
    command_to_frames,
    decode,
    encode,
    make_group,
    make_id,
    message_names,
    pack,
    pgn_of,
    unpack,
)
from iits_mj.j1939.groups import layouts

EIGHT_BYTES = st.binary(min_size=8, max_size=8)
# The others take several frames.
SHORT = [name for name in message_names() if layouts().get_message_by_name(name).length == 8]


@settings(max_examples=400, deadline=None)
@given(name=st.sampled_from(SHORT), data=EIGHT_BYTES)
def test_any_eight_bytes_decode_to_finite_numbers_or_a_status(name, data):
    decoded = decode(Frame(make_id(6, pgn_of(name), 0), data))
    assert decoded.name == name
    for _, value in decoded.group.items():
        assert isinstance(value, Status) or math.isfinite(value)


@settings(max_examples=400, deadline=None)
@given(name=st.sampled_from(SHORT), data=EIGHT_BYTES)
def test_encode_inverts_decode_on_the_grid(name, data):
    first = decode(Frame(make_id(6, pgn_of(name), 0), data))
    known = {k: v for k, v in first.group.items() if v is not Status.OUT_OF_RANGE}
    again = decode(encode(make_group(name, known)))
    for signal, value in known.items():
        assert getattr(again.group, signal) == value


@settings(max_examples=400, deadline=None)
@given(name=st.sampled_from(message_names()), data=st.data())
def test_numbers_and_bytes_agree_with_cantools(name, data):
    layout = layouts().get_message_by_name(name)
    sent = data.draw(st.binary(min_size=layout.length, max_size=layout.length))
    theirs = layout.decode(sent, decode_choices=False)
    ours = dict(unpack(pgn_of(name), sent).items())
    assert ours.keys() == theirs.keys()
    known = {signal: value for signal, value in ours.items() if not isinstance(value, Status)}
    for signal, value in known.items():
        assert value == pytest.approx(theirs[signal], rel=1e-12, abs=1e-12)
    # Unavailable signals are all ones.
    ones = {s.name: (1 << s.length) - 1 for s in layout.signals}
    raw = layout.decode(sent, decode_choices=False, scaling=False)
    raw = {signal: raw[signal] if signal in known else ones[signal] for signal in ones}
    written = layout.encode(raw, scaling=False, padding=True, strict=False)
    assert pack(make_group(name, known)) == written


@settings(max_examples=300, deadline=None)
@given(
    ids=st.integers(0, (1 << 29) - 1),
    data=st.binary(max_size=8),
    name=st.sampled_from(["EEC2", "XBR", "TSC1", "IITS_COMMAND"]),
    known=st.booleans(),
)
def test_random_frames_never_command_anything_out_of_range(ids, data, name, known):
    receiver = CommandReceiver()
    can_id = make_id(3, pgn_of(name), 0) if known else ids
    receiver.receive(Frame(can_id, data))
    command = receiver.command(0.0)
    assert 0.0 <= command.accelerator_pedal <= 1.0
    assert -10.0 <= command.xbr_demand <= 0.0
    for share in (command.engine_brake, command.retarder, command.brake_pedal):
        assert 0.0 <= share <= 1.0
    assert all(math.isfinite(float(v)) for v in dataclasses.astuple(command))


@settings(max_examples=200, deadline=None)
@given(
    pedal=st.floats(0.0, 1.0),
    demand=st.floats(-10.0, 0.0),
    mode=st.sampled_from(XbrMode),
    angle=st.floats(-15.7, 15.7),
    counter=st.integers(0, 1000),
    shares=st.tuples(*[st.floats(0.0, 1.0)] * 3),
    ebi_mode=st.sampled_from(XbrEbiMode),
)
def test_every_valid_command_crosses_the_bus(pedal, demand, mode, angle, counter, shares, ebi_mode):
    command = VehicleCommand(
        pedal,
        demand,
        mode,
        angle,
        engine_brake=shares[0],
        retarder=shares[1],
        brake_pedal=shares[2],
        xbr_ebi_mode=ebi_mode,
    )
    receiver = CommandReceiver()
    assert all(receiver.receive(frame) for frame in command_to_frames(command, counter))
    received = receiver.command(0.0)
    assert received.accelerator_pedal == pytest.approx(pedal, abs=0.0021)
    assert received.steering_wheel_angle == pytest.approx(angle, abs=0.0005)
    if mode is not XbrMode.OFF:
        assert received.xbr_demand == pytest.approx(demand, abs=0.00025)
        assert received.xbr_ebi_mode is ebi_mode
    assert received.engine_brake == pytest.approx(shares[0], abs=0.0051)
    assert received.retarder == pytest.approx(shares[1], abs=0.0051)
    assert received.brake_pedal == pytest.approx(shares[2], abs=0.0021)
