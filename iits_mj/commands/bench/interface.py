"""Computing time of J1939 frames and of a control cycle over a bus."""

from __future__ import annotations

import math
import time
import uuid
from collections.abc import Callable
from dataclasses import dataclass, field

import can

from iits_mj.commands.bench.clocks import MICROSECONDS, MILLISECONDS, best, no_collection
from iits_mj.core.messages import EgoState, TruckReport, VehicleCommand, XbrMode
from iits_mj.core.results import Findings
from iits_mj.core.timing import CONTROL_PERIOD
from iits_mj.j1939 import (
    Bus,
    CommandReceiver,
    CommandSender,
    Frame,
    StateReceiver,
    StateSender,
    decode,
    encode,
)
from iits_mj.j1939.bus import to_can
from iits_mj.parameters import AnyTruck
from iits_mj.simulation.server import TICK
from iits_mj.truck import Truck

CYCLE_TICKS = round(CONTROL_PERIOD / TICK)
# One second of the bus contains every message, also the slowest.
CYCLES = 50


def interface(rounds: int, truck: AnyTruck | None = None) -> Findings:
    """Returns processor times of a truck's frames and of a control cycle over the virtual bus.

    In a control cycle the controller's commands are sent and obeyed, the truck's reports of that
    instant are sent back, and the controller updates its state. Reports between two cycles are
    measured separately.
    """
    states = _drive(CYCLES * CYCLE_TICKS, truck)
    frames = _second(states)
    groups = [decoded.group for frame in frames if (decoded := decode(frame)) is not None]

    def per_frame(function: Callable[[], object]) -> float:
        return best(function, rounds, time.thread_time) / len(frames) * MICROSECONDS

    decoding = per_frame(lambda: [decode(frame) for frame in frames])
    encoding = per_frame(lambda: [encode(group, saturate=True) for group in groups])
    ticks = _ticks(states, rounds)
    cycle = sum(ticks[::CYCLE_TICKS]) / CYCLES * MILLISECONDS
    between = sum(ticks) / CYCLES * MILLISECONDS - cycle
    found = Findings("J1939")
    found.check("decode a frame", decoding, "us", 15.0, "<= 15")
    found.check("encode a frame", encoding, "us", 15.0, "<= 15")
    found.check("control cycle over the virtual bus", cycle, "ms", 0.3, "<= 0.3")
    found.check("the truck's reports between two cycles", between, "ms")
    found.check("frames in 20 ms", len(frames) / CYCLES, "1")
    alone = _bus_alone(frames, rounds) / len(frames)
    found.check("a frame over python-can's virtual bus alone", alone * MICROSECONDS, "us")
    return found


def _drive(ticks: int, truck: AnyTruck | None) -> list[tuple[EgoState, TruckReport]]:
    """Returns states and reports of a truck every 10 ms, with changing commands."""
    driven = Truck.load(truck=truck, visuals=False)
    driven.reset(speed=15.0)
    found = []
    for tick in range(ticks):
        driven.command(_command(tick))
        driven.step(round(TICK / driven.model.opt.timestep))
        found.append((driven.observe(), driven.report()))
    return found


def _command(tick: int) -> VehicleCommand:
    swing = math.sin(0.02 * tick)
    return VehicleCommand(
        accelerator_pedal=0.5 + 0.2 * swing,
        xbr_demand=min(0.0, swing),
        xbr_mode=XbrMode.MAXIMUM if swing < 0.0 else XbrMode.OFF,
        steering_wheel_angle=0.1 * swing,
    )


def _second(states: list[tuple[EgoState, TruckReport]]) -> list[Frame]:
    """Returns all frames of one second, commands and reports."""
    controller, truck, frames = CommandSender(), StateSender(), []
    for tick, (state, report) in enumerate(states):
        if tick % CYCLE_TICKS == 0:
            frames += controller.frames(_command(tick), tick * TICK)
        frames += truck.frames(state, report)
    return frames


@dataclass(slots=True)
class _Ends:
    """A controller and a truck at the two ends of a bus."""

    controller_bus: Bus
    truck_bus: Bus
    controller: CommandSender = field(default_factory=CommandSender)
    watcher: StateReceiver = field(default_factory=StateReceiver)
    truck: StateSender = field(default_factory=StateSender)
    receiver: CommandReceiver = field(default_factory=CommandReceiver)

    def command(self, command: VehicleCommand, now: float) -> None:
        """Sends, receives and obeys the due commands."""
        for frame in self.controller.frames(command, now):
            self.controller_bus.send(frame)
        for frame in self.truck_bus.receive():
            self.receiver.receive(frame)
        self.receiver.command(now)

    def report(self, state: EgoState, report: TruckReport) -> None:
        """Sends and receives the due reports, and updates the state."""
        for frame in self.truck.frames(state, report):
            self.truck_bus.send(frame)
        for frame in self.controller_bus.receive():
            self.watcher.receive(frame)
        self.watcher.state()


def _ticks(states: list[tuple[EgoState, TruckReport]], rounds: int) -> list[float]:
    """Returns the least time of each 10 ms tick over the bus, without physics [s]."""
    channel = uuid.uuid4().hex
    clock = time.thread_time
    commands = [_command(tick) for tick in range(len(states))]
    least = [math.inf] * len(states)
    with Bus("virtual", channel) as one, Bus("virtual", channel) as other, no_collection():
        for _ in range(rounds):
            ends = _Ends(one, other)
            for tick, (state, report) in enumerate(states):
                start = clock()
                if tick % CYCLE_TICKS == 0:
                    ends.command(commands[tick], tick * TICK)
                ends.report(state, report)
                least[tick] = min(least[tick], clock() - start)
    return least


def _bus_alone(frames: list[Frame], rounds: int) -> float:
    """Returns the time in which python-can alone sends and receives these frames [s]."""
    channel = uuid.uuid4().hex
    messages = [to_can(frame) for frame in frames]
    ends = [can.Bus(interface="virtual", channel=channel) for _ in range(2)]

    def play() -> None:
        for message in messages:
            ends[0].send(message)
        while ends[1].recv(timeout=0.0) is not None:
            pass

    try:
        return best(play, rounds, time.thread_time)
    finally:
        for end in ends:
            end.shutdown()
