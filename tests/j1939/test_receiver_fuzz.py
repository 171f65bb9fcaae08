"""Random frames at random times: the command stays valid, and the truck's state finite."""

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from iits_mj.core.messages import VehicleCommand, XbrMode
from iits_mj.j1939 import CommandReceiver, Frame, Reason, TimeOuts, command_to_frames, pgn_of
from iits_mj.j1939.frame import tsc1_checksum, with_byte8, xbr_checksum
from iits_mj.j1939.receiver import STEERING_ANGLE_MAX
from iits_mj.road import Route
from iits_mj.truck import Truck

COMMANDS = ("EEC2", "XBR", "TSC1", "IITS_COMMAND")
PGNS = [pgn_of(name) for name in COMMANDS]
UNITS = ("EEC2", "XBR", "TSC1", "TSC1 to 15", "TSC1 to 16", "IITS_COMMAND")
MOST_REASONS = len(UNITS) * len(Reason)


def valid(command):
    """Whether every field is finite and in its range."""
    shares = (
        command.accelerator_pedal,
        command.engine_brake,
        command.retarder,
        command.brake_pedal,
        command.parking_brake,
    )
    return (
        all(math.isfinite(float(v)) for v in dataclasses.astuple(command))
        and all(0.0 <= share <= 1.0 for share in shares)
        and -10.0 <= command.xbr_demand <= 0.0
        and abs(command.steering_wheel_angle) <= STEERING_ANGLE_MAX
    )


def sealed(frame):
    """The frame with the right checksum, and for TSC1 a counter in its range."""
    if len(frame.data) != 8 or frame.pgn == pgn_of("EEC2"):
        return frame
    counter = frame.data[7] & 0x0F
    if frame.pgn == pgn_of("TSC1"):
        return with_byte8(frame, counter % 8, tsc1_checksum(with_byte8(frame, counter % 8, 0)))
    return with_byte8(frame, counter, xbr_checksum(frame))


@st.composite
def frames(draw):
    """A frame with any time, often a command, often with the right checksum."""
    known = draw(st.booleans())
    can_id = draw(st.integers(0, (1 << 29) - 1))
    if known:
        pgn = draw(st.sampled_from(PGNS))
        address = draw(st.sampled_from([0x0B, 0x0F, 0x10, 0xFF, 0x33])) if pgn < 0xF000 else 0
        source = draw(st.sampled_from([0x00, 0x2A, 0x30, 0xFE]))
        can_id = 3 << 26 | (pgn | address) << 8 | source
    data = draw(st.binary(min_size=8, max_size=8) | st.binary(max_size=8))
    time = draw(st.floats(0.0, 2.0) | st.floats())
    frame = Frame(can_id, data, time)
    return sealed(frame) if draw(st.booleans()) else frame


@settings(max_examples=150, deadline=None)
@given(heard=st.lists(frames(), max_size=40), times=st.lists(st.floats(), max_size=5))
def test_any_sequence_of_frames_and_times_gives_a_valid_command(heard, times):
    receiver = CommandReceiver()
    for frame in heard:
        receiver.receive(frame)
        assert valid(receiver.command(frame.time))
    for time in times:
        assert valid(receiver.command(time))
        receiver.loss(time)
    assert len(receiver.rejected) + len(receiver.ignored) <= MOST_REASONS


STEPS = st.lists(
    st.tuples(
        st.floats(0.0, 0.2),
        st.integers(0, 3),
        st.sampled_from([-0.5, -1.0, -2.0, -4.0]),
        st.sampled_from(["good", "good", "good", "checksum", "length"]),
    ),
    max_size=60,
)


@settings(max_examples=200, deadline=None)
@given(steps=STEPS)
def test_the_brake_demand_in_force_is_the_last_valid_one_that_is_not_repeated(steps):
    receiver = CommandReceiver(TimeOuts(xbr=0.1))
    time, counter = 0.0, 0
    # Expected state: last counter, last demand and its time.
    last_counter, demand, demanded_at = None, 0.0, -math.inf
    for pause, ahead, wanted, kind in steps:
        time += pause
        counter = (counter + ahead) % 16
        command = VehicleCommand(xbr_demand=wanted, xbr_mode=XbrMode.MAXIMUM)
        frame = command_to_frames(command, counter, time)[1]
        if kind == "checksum":
            frame = with_byte8(frame, counter, frame.data[7] >> 4 ^ 3)
        elif kind == "length":
            frame = dataclasses.replace(frame, data=frame.data[:5])
        receiver.receive(frame)
        if kind == "good" and counter != last_counter:
            demand, demanded_at = wanted, time
            last_counter = counter
        for later in (0.0, 0.05, 0.15):
            obeyed = receiver.command(time + later).xbr_demand
            in_force = demand if time + later - demanded_at <= 0.1 + 1e-6 else 0.0
            assert obeyed == pytest.approx(in_force, abs=0.001)


@settings(max_examples=100, deadline=None)
@given(
    demands=st.dictionaries(
        st.integers(0x20, 0x25),
        st.tuples(st.integers(0, 3), st.integers(1, 19).map(lambda n: -0.5 * n), st.floats(0, 0.3)),
    ),
    asked=st.floats(0.3, 0.5),
)
def test_the_first_brake_demand_by_priority_and_strength_is_in_force(demands, asked):
    receiver = CommandReceiver(TimeOuts(xbr=0.2))
    for source, (priority, demand, time) in demands.items():
        command = VehicleCommand(xbr_demand=demand, xbr_mode=XbrMode.MAXIMUM)
        frame = command_to_frames(command, 0, time, source=source)[1]
        data = bytearray(frame.data)
        data[2] = data[2] & ~0x0C | priority << 2
        assert receiver.receive(sealed(dataclasses.replace(frame, data=bytes(data))))
    alive = [(p, d) for p, d, time in demands.values() if asked - time <= 0.2 + 1e-6]
    command = receiver.command(asked)
    if alive:
        assert command.xbr_demand == pytest.approx(min(alive)[1], abs=0.001)
    assert (command.xbr_mode is XbrMode.MAXIMUM) == bool(alive)


def _random_frames(generator, count):
    """Random identifiers and bytes; half under the command identifiers, most of these sealed."""
    ids = generator.integers(0, 1 << 29, count)
    data = generator.integers(0, 256, (count, 8), dtype=np.uint8)
    kinds = generator.integers(0, 4, count)
    which = generator.integers(0, len(PGNS), count)
    addresses = generator.choice([0x0B, 0x0F, 0x10, 0xFF], count)
    # Senders with random and with right counters.
    sources = generator.integers(0, 3, count) + np.where(kinds == 3, 0x2A, 0x40)
    lengths = generator.integers(0, 9, count)
    counters = [0] * 1024
    for i in range(count):
        if kinds[i] < 2:
            size = 8 if kinds[i] == 0 else int(lengths[i])
            yield Frame(int(ids[i]), data[i].tobytes()[:size])
            continue
        pgn, source = PGNS[which[i]], int(sources[i])
        address = int(addresses[i]) if pgn < 0xF000 else 0
        if kinds[i] == 3 and address:
            address = 0x0B if pgn == pgn_of("XBR") else 0x0F + source % 2
        can_id = 3 << 26 | (pgn | address) << 8 | source
        content = bytearray(data[i].tobytes())
        if kinds[i] == 3:
            # In sequence and with plausible modes, so that many frames are obeyed.
            key = int(which[i]) * 256 + source
            counters[key] = (counters[key] + 1) % (8 if pgn == 0 else 16)
            content[7] = counters[key]
            if pgn == pgn_of("IITS_COMMAND"):
                content[1] = 0x54 + content[1] % 0x50
                content[2] = content[2] & 0x20 | 0x01
        yield sealed(Frame(can_id, bytes(content)))


def survive(count, per_step, payload):
    """Feeds random frames to a receiver and its commands to the truck; returns the receiver."""
    generator = np.random.default_rng(1939)
    receiver = CommandReceiver()
    truck = Truck.load(payload=payload, route=Route.straight(length=5000.0), visuals=False)
    truck.reset(station=1000.0, speed=20.0)
    for i, frame in enumerate(_random_frames(generator, count)):
        receiver.receive(dataclasses.replace(frame, time=truck.time))
        if i % per_step == 0:
            command = receiver.command(truck.time)
            assert valid(command)
            truck.command(command)
            truck.step(10)
            data = truck.data
            assert np.isfinite(data.qpos).all()
            assert np.isfinite(data.qvel).all()
            assert np.isfinite(data.sensordata).all()
    assert len(receiver.rejected) + len(receiver.ignored) <= MOST_REASONS
    return receiver


def test_20_000_random_frames_leave_the_truck_finite():
    receiver = survive(20_000, 40, 0.0)
    # Every unit obeyed many frames.
    assert all(receiver.accepted[unit] > 100 for unit in UNITS if unit != "TSC1")


@pytest.mark.slow
@pytest.mark.parametrize("payload", [0.0, 36_000.0])
def test_a_million_random_frames_leave_the_truck_finite(payload):
    receiver = survive(1_000_000, 200, payload)
    assert sum(receiver.accepted.values()) > 20_000
