"""The bus receiver with its fallback, under any order of good, late, lost and damaged messages.

The machine knows of every frame whether it is good: in time, whole, with the right checksum and the
next counter, from an address that may command. Only these may move the truck, and only until their
time-outs.
"""

from __future__ import annotations

import dataclasses
import math
from collections import defaultdict

import pytest
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, precondition, rule

from controllers.safe_stop.fallback import Fallback
from controllers.safe_stop.stop import SafeStop
from iits_mj.core.messages import EgoState, TransmissionMode, VehicleCommand, XbrEbiMode, XbrMode
from iits_mj.j1939 import CommandReceiver, Frame, Heard
from iits_mj.j1939.frame import with_byte8
from iits_mj.parameters import TruckParameters
from iits_mj.road import Route
from tests.j1939.test_fail_safe import LOSS, UNITS, frame_of
from tests.j1939.test_receiver_fuzz import valid
from tests.stateful import SLOW, explore

CONTROLLER, ASSISTANT, STRANGER = 0x2A, 0x30, 0x55
PERIOD = 0.02
ROUNDING = 2e-6
# One for all runs: the gains of its steering take a second.
STOP = SafeStop(Route.straight(length=5000.0), TruckParameters.load())
shares = st.integers(0, 20).map(lambda n: 0.05 * n)
commands = st.builds(
    VehicleCommand,
    accelerator_pedal=shares,
    xbr_demand=st.integers(0, 20).map(lambda n: -0.5 * n),
    xbr_mode=st.sampled_from(XbrMode),
    steering_wheel_angle=st.integers(-20, 20).map(lambda n: 0.25 * n),
    parking_brake=st.sampled_from([0.0, 0.0, 1.0]),
    engine_brake=shares,
    transmission_mode=st.sampled_from(TransmissionMode),
    retarder=shares,
    brake_pedal=shares,
    xbr_ebi_mode=st.sampled_from(XbrEbiMode),
)
units = st.sampled_from(UNITS)
sources = st.sampled_from([CONTROLLER, CONTROLLER, CONTROLLER, ASSISTANT])
pauses = st.sampled_from([0.001, 0.01, 0.02, 0.05, 0.09, 0.11, 0.24, 0.26])


@dataclasses.dataclass(frozen=True)
class Sent:
    """A good frame: its unit, sender, command and time of arrival."""

    unit: str
    source: int
    command: VehicleCommand
    time: float
    frame: Frame


class Bus(RuleBasedStateMachine):
    """A truck's receiver and the frames that it hears."""

    @initialize(listens=st.sampled_from([(CONTROLLER,), (CONTROLLER, ASSISTANT)]))
    def start(self, listens):
        self.time = 1.0
        self.listens = listens
        self.receiver = CommandReceiver(sources=listens)
        self.fallback = Fallback(STOP)
        self.counters: dict[tuple[str, int], int] = defaultdict(int)
        self.followed: dict[tuple[str, int], int] = {}  # counters of the last whole frames
        self.good: list[Sent] = []
        self.tick()

    # --- what happens on the bus

    def frame(self, unit, source, command, advance=1):
        """The sender's next frame; never with the counter of the last whole one."""
        self.counters[unit, source] += advance
        last, values = self.followed.get((unit, source)), 8 if unit.startswith("TSC1") else 16
        if last is not None and (self.counters[unit, source] - last) % values == 0:
            self.counters[unit, source] += 1
        return frame_of(unit, command, self.counters[unit, source], self.time, source=source)

    def hear(self, unit, source, command, frame, good):
        obeyed = self.receiver.receive(frame)
        if good:
            self.followed[unit, source] = self.counters[unit, source]
        if obeyed:
            assert good
            self.good.append(Sent(unit, source, command, frame.time, frame))
        self.tick()
        return obeyed

    @rule(unit=units, source=sources, command=commands)
    def send(self, unit, source, command):
        frame = self.frame(unit, source, command)
        obeyed = self.hear(unit, source, command, frame, good=source in self.listens)
        if self.listens == (CONTROLLER,):
            # Without another sender a good frame is obeyed.
            assert obeyed == (source == CONTROLLER)

    @rule(command=commands)
    def send_all(self, command):
        for unit in UNITS:
            frame = self.frame(unit, CONTROLLER, command)
            self.hear(unit, CONTROLLER, command, frame, good=True)

    @rule(command=commands, cycles=st.integers(2, 30))
    def send_for_a_while(self, command, cycles):
        for _ in range(cycles):
            self.time += PERIOD
            self.send_all(command)
        if self.listens == (CONTROLLER,):
            held = self.receiver.command(self.time)
            assert held.accelerator_pedal == pytest.approx(command.accelerator_pedal, abs=0.005)
            assert held.steering_wheel_angle == pytest.approx(
                command.steering_wheel_angle, abs=1e-3
            )
            assert not self.receiver.loss(self.time).driver

    @rule(pause=pauses)
    def wait(self, pause):
        end = self.time + pause
        while self.time + PERIOD < end:
            self.time += PERIOD
            self.tick()
        self.time = end
        self.tick()

    @rule(unit=units, source=sources, command=commands, lost=st.integers(1, 20))
    def lose_frames(self, unit, source, command, lost):
        frame = self.frame(unit, source, command, advance=1 + lost)
        self.hear(unit, source, command, frame, good=source in self.listens)

    @rule(unit=st.sampled_from(UNITS[1:]), command=commands, pause=pauses)
    def repeat_the_counter(self, unit, command, pause):
        """A stuck sender does not regain control by waiting."""
        last = self.followed.get((unit, CONTROLLER))
        if last is not None:
            self.time += pause
            frame = frame_of(unit, command, last, self.time, source=CONTROLLER)
            self.hear(unit, CONTROLLER, command, frame, good=False)

    @precondition(lambda self: self.good)
    @rule(data=st.data())
    def hear_an_earlier_frame_again(self, data):
        """Late, with the time of its first arrival: the last frame of its sender is newer."""
        sent = data.draw(st.sampled_from(self.good))
        newest = max(s.time for s in self.good if (s.unit, s.source) == (sent.unit, sent.source))
        late = newest - sent.time > ROUNDING
        time_out = getattr(self.receiver.time_outs, LOSS[sent.unit])
        if late and newest - sent.time < time_out:
            assert not self.receiver.receive(sent.frame)
        self.tick()

    @rule(unit=st.sampled_from(UNITS[1:]), command=commands, bit=st.integers(0, 63))
    def damage_a_bit(self, unit, command, bit):
        frame = self.frame(unit, CONTROLLER, command)
        word = int.from_bytes(frame.data, "little") ^ 1 << bit
        damaged = Frame(frame.can_id, word.to_bytes(8, "little"), frame.time)
        self.hear(unit, CONTROLLER, command, damaged, good=False)

    @rule(unit=st.sampled_from(UNITS[1:]), command=commands, change=st.integers(1, 7))
    def send_a_wrong_checksum(self, unit, command, change):
        frame = self.frame(unit, CONTROLLER, command)
        wrong = with_byte8(frame, frame.data[7] & 0x0F, frame.data[7] >> 4 ^ change)
        self.hear(unit, CONTROLLER, command, wrong, good=False)

    @rule(unit=units, command=commands, length=st.integers(0, 7))
    def send_a_short_frame(self, unit, command, length):
        frame = self.frame(unit, CONTROLLER, command)
        short = Frame(frame.can_id, frame.data[:length], frame.time)
        self.hear(unit, CONTROLLER, command, short, good=False)

    @rule(unit=units, command=commands, time=st.sampled_from([math.nan, math.inf, -math.inf]))
    def send_without_a_time(self, unit, command, time):
        frame = dataclasses.replace(self.frame(unit, CONTROLLER, command), time=time)
        self.hear(unit, CONTROLLER, command, frame, good=False)

    @rule(unit=units, command=commands, source=st.sampled_from([STRANGER, 0xFE, 0xFF, 0x0B]))
    def hear_a_stranger(self, unit, command, source):
        frame = frame_of(unit, command, self.counters[unit, source], self.time, source=source)
        self.counters[unit, source] += 1
        self.hear(unit, source, command, frame, good=False)

    @rule(can_id=st.integers(0, (1 << 29) - 1), data=st.binary(max_size=8))
    def hear_noise(self, can_id, data):
        frame = Frame(can_id & ~0xFF | STRANGER, data, self.time)
        assert not self.receiver.receive(frame)
        self.tick()

    # --- what must always hold

    def tick(self):
        """A control cycle of the truck at the present time."""
        received, loss = self.receiver.command(self.time), self.receiver.loss(self.time)
        assert valid(received)
        self.check_freshness(received)
        self.check_loss(loss)
        ego = EgoState(
            time=self.time, station=500.0, x=500.0, speed=15.0, gear=10, engine_speed=130.0,
            steering_wheel_angle=received.steering_wheel_angle,
        )  # fmt: skip
        obeyed = self.fallback.command(ego, received, loss.driver)
        assert valid(obeyed)
        self.obeyed = obeyed
        self.check_stop(obeyed, received, loss)

    def recent(self, unit, time_out):
        """Good frames of a unit that are not older than its time-out."""
        return [
            s for s in self.good if s.unit == unit and self.time - s.time <= time_out + ROUNDING
        ]

    def check_freshness(self, received):
        """Each value is that of a good frame that is not older than its time-out."""
        outs = self.receiver.time_outs
        if received.accelerator_pedal > 0.0:
            pedals = [s.command.accelerator_pedal for s in self.recent("EEC2", outs.pedal)]
            assert any(abs(received.accelerator_pedal - p) < 0.005 for p in pedals)
            assert self.recent("IITS_COMMAND", outs.body)
        if received.xbr_mode is not XbrMode.OFF:
            asked = [s.command for s in self.recent("XBR", outs.xbr)]
            assert any(
                received.xbr_mode is c.xbr_mode
                and abs(received.xbr_demand - c.xbr_demand) < 0.001
                and received.xbr_ebi_mode is c.xbr_ebi_mode
                for c in asked
            )
        for unit, name in (("TSC1 to 15", "engine_brake"), ("TSC1 to 16", "retarder")):
            if getattr(received, name) > 0.0:
                asked = [s.command for s in self.recent(unit, getattr(outs, LOSS[unit]))]
                assert any(abs(getattr(received, name) - getattr(c, name)) < 0.01 for c in asked)
        # The positions that stay are those of the last good frame.
        bodies = [s.command for s in self.good if s.unit == "IITS_COMMAND"]
        last = bodies[-1] if bodies else VehicleCommand()
        assert received.steering_wheel_angle == pytest.approx(last.steering_wheel_angle, abs=1e-3)
        assert received.parking_brake == last.parking_brake
        assert received.transmission_mode is last.transmission_mode
        assert received.brake_pedal == pytest.approx(last.brake_pedal, abs=0.005)

    def check_loss(self, loss):
        for unit in UNITS:
            state, out = getattr(loss, LOSS[unit]), getattr(self.receiver.time_outs, LOSS[unit])
            heard = any(s.unit == unit for s in self.good)
            assert (state is Heard.NEVER) == (not heard)
            assert (state is Heard.ALIVE) == bool(self.recent(unit, out))

    def check_stop(self, obeyed, received, loss):
        """Without a driver the truck brakes in its lane at once, whoever spoke before."""
        if not loss.driver:
            return
        assert obeyed.accelerator_pedal == 0.0
        assert obeyed.xbr_mode is not XbrMode.OFF
        assert obeyed.xbr_demand <= 0.0
        assert obeyed.brake_pedal >= received.brake_pedal
        if received.xbr_mode is not XbrMode.OFF:
            assert obeyed.xbr_demand <= received.xbr_demand

    @rule()
    def fall_silent(self):
        """A second after the time-outs the truck brakes, with limited jerk, for its stop."""
        end = self.time + 1.3
        while self.time < end:
            self.time += PERIOD
            self.tick()
        loss = self.receiver.loss(self.time)
        assert loss.driver
        held = self.receiver.command(self.time)
        assert held.accelerator_pedal == 0.0
        assert held.xbr_mode is XbrMode.OFF
        assert held.engine_brake == held.retarder == 0.0
        assert self.obeyed.xbr_demand <= -0.8


def test_only_good_and_recent_messages_of_the_right_senders_move_the_truck():
    explore(Bus, runs=30, rules=20)


@pytest.mark.slow
def test_only_good_and_recent_messages_move_the_truck_in_many_orders():
    explore(Bus, runs=30, rules=50, factor=SLOW)
