"""Measure computing times: physics, threads, J1939 frames, traffic, and a whole drive.

Times depend on the machine; most bounds apply to ratios, which hardly do. Each figure is the best
of several rounds, because other work on the machine can only make a round slower.
"""

from __future__ import annotations

import math
import time
import uuid
from collections.abc import Callable
from dataclasses import dataclass, field

import can
import mujoco
import mujoco.rollout
import numpy as np

from iits_mj.commands.bench_traffic import MICROSECONDS, MILLISECONDS, no_collection, traffic
from iits_mj.commands.output import ResultOptions, finish
from iits_mj.core import options as option_fields
from iits_mj.core.messages import EgoState, TruckReport, VehicleCommand, XbrMode
from iits_mj.core.options import option
from iits_mj.core.results import Findings, Results
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
from iits_mj.model.builder import truck_spec
from iits_mj.model.road_table import add_road_table
from iits_mj.parameters import TruckParameters, payload_option
from iits_mj.road import RoadMap
from iits_mj.simulation import DriveConfig, Simulation
from iits_mj.simulation.server import TICK
from iits_mj.truck import Truck


@dataclass(frozen=True, kw_only=True)
class Options(ResultOptions):
    """Flags of `iits-mj bench`."""

    payload: float = payload_option()
    threads: int = option(2, help="number of threads of the rollout", low=1, high=256)
    traffic: bool = option(True, help="measure SUMO traffic and a whole drive, too")
    seed: int = option(0, help="seed of the traffic", low=0, high=2**31 - 1)
    quick: bool = option(False, help="fewer rounds, within a minute")

    def __post_init__(self) -> None:
        option_fields.check(self)


def run(options: Options) -> int:
    """Measures and prints; returns the exit code."""
    return finish(options, lambda: measure(options))


def measure(options: Options) -> Results:
    """Returns all figures."""
    results = Results("bench", options.seed)
    rounds = 3 if options.quick else 10
    results.add("", _physics(options, rounds))
    results.add("", _interface(5 * rounds))
    if options.traffic:
        results.add("", traffic(2 * rounds))
        results.add("", _whole_drive(options, 10.0 if options.quick else 60.0))
    return results


def best(
    function: Callable[[], object],
    rounds: int,
    clock: Callable[[], float] = time.perf_counter,
) -> float:
    """Returns the least time of a call [s], by default wall time."""
    times = []
    with no_collection():
        for _ in range(rounds):
            start = clock()
            function()
            times.append(clock() - start)
    return min(times)


def bare_model(parameters: TruckParameters, payload: float, timestep: float) -> mujoco.MjModel:
    """Returns the truck's model without plugins: same bodies, but no tire, engine or brake."""
    spec = truck_spec(parameters, payload)
    spec.option.timestep = timestep
    remove_plugins(spec, {plugin.plugin_name for plugin in spec.plugins})
    return spec.compile()


def remove_plugins(spec: mujoco.MjSpec, kinds: set[str]) -> None:
    """Removes all instances of these plugins and their sensors and actuators."""
    names = {plugin.name for plugin in spec.plugins if plugin.plugin_name in kinds}
    for sensor in list(spec.sensors):
        if sensor.type == mujoco.mjtSensor.mjSENS_PLUGIN and sensor.plugin.name in names:
            spec.delete(sensor)
    for actuator in list(spec.actuators):
        if actuator.plugin.active and actuator.plugin.name in names:
            spec.delete(actuator)
    for body in spec.bodies:
        if body.plugin.active and body.plugin.name in names:
            body.plugin.active = False
    for plugin in list(spec.plugins):
        if plugin.name in names:
            spec.delete(plugin)


def _physics(options: Options, rounds: int) -> Findings:
    found, steps = Findings(), 1000
    route = RoadMap.builtin().route()
    truck = Truck.load(options.payload, route=route, visuals=False)
    truck.reset(station=100.0, speed=15.0)
    truck.command(accelerator_pedal=0.4)
    timestep = float(truck.model.opt.timestep)
    start = mujoco.MjData(truck.model)
    mujoco.mj_copyData(start, truck.model, truck.data)

    bare = bare_model(truck.parameters, options.payload, timestep)

    def player(model: mujoco.MjModel, source: mujoco.MjData) -> Callable[[], None]:
        data = mujoco.MjData(model)

        def play() -> None:
            mujoco.mj_copyData(data, model, source)
            mujoco.mj_step(model, data, steps)

        return play

    # In turns, so that other work on the machine affects both; processor time does not count the
    # time spent waiting for a core.
    play_full, play_tree = player(truck.model, start), player(bare, mujoco.MjData(bare))
    turns = [
        (best(play_full, 1, time.thread_time), best(play_tree, 1, time.thread_time))
        for _ in range(rounds)
    ]
    full, tree = (min(column) / steps for column in zip(*turns, strict=True))
    single = best(play_full, rounds) / steps
    aggregate = _rollout(truck.model, start, options.threads, steps, rounds)
    found.check("step of the truck on the highway", full * MICROSECONDS, "us")
    found.check("step of the same tree without plugins", tree * MICROSECONDS, "us")
    found.check("plugins' share, truck over tree", full / tree, "1", 1.3, "<= 1.35")
    costs, longitudinal = _per_plugin(truck, start, rounds)
    for kind, cost in costs.items():
        found.check(f"plugin {kind}, of the step", cost * MICROSECONDS, "us")
    name = "powertrain and brakes, step with them over without"
    found.check(name, longitudinal, "1", 1.1, "<= 1.10")
    found.check("real-time factor of the physics", timestep / full, "1", must=">= 1")
    name = f"rollout, {options.threads} threads, per step in all"
    found.check(name, aggregate * MICROSECONDS, "us")
    found.check("rollout's gain over one thread", single / aggregate, "1")
    return found


def _per_plugin(truck: Truck, start: mujoco.MjData, rounds: int) -> tuple[dict[str, float], float]:
    """Returns the time of each plugin in a step [s], and a ratio.

    The time is the difference to a model without the plugin. The ratio is the time of a step over
    the time without powertrain and brakes. The runs are short and begin with the same motion,
    because the truck falls without its tires.
    """
    steps = 200

    def player(removed: set[str]) -> Callable[[], None]:
        spec = truck_spec(truck.parameters, truck.payload)
        spec.option.timestep = truck.model.opt.timestep
        add_road_table(spec, truck.route)
        remove_plugins(spec, removed)
        model = spec.compile()
        data = mujoco.MjData(model)
        names = [model.actuator(i).name for i in range(model.nactuator)]

        def play() -> None:
            mujoco.mj_resetData(model, data)
            data.qpos[:], data.qvel[:] = start.qpos, start.qvel
            for i, name in enumerate(names):
                data.ctrl[i] = start.actuator(name).ctrl[0]
            mujoco.mj_step(model, data, steps)

        return play

    kinds = sorted({plugin.plugin_name for plugin in truck_spec(truck.parameters, 0.0).plugins})
    both = "powertrain and brakes"
    players = {"": player(set()), both: player({"iits.powertrain", "iits.air_brake"})}
    players |= {kind: player({kind}) for kind in kinds}
    least = dict.fromkeys(players, math.inf)
    for _ in range(10 * rounds):
        for kind, play in players.items():
            least[kind] = min(least[kind], best(play, 1, time.thread_time) / steps)
    return {kind: least[""] - least[kind] for kind in kinds}, least[""] / least[both]


def _rollout(
    model: mujoco.MjModel, start: mujoco.MjData, threads: int, steps: int, rounds: int
) -> float:
    """Returns the wall time per step of `mujoco.rollout` with all threads [s]."""
    runs = 2 * threads
    kind = mujoco.mjtState.mjSTATE_FULLPHYSICS
    state = np.zeros(mujoco.mj_stateSize(model, kind))
    mujoco.mj_getState(model, start, state, kind)
    states = np.tile(state, (runs, 1))
    controls = np.tile(start.ctrl, (runs, steps, 1))
    datas = [mujoco.MjData(model) for _ in range(threads)]
    with mujoco.rollout.Rollout(nthread=threads) as pool:

        def play() -> None:
            pool.rollout(model, datas, states, controls)

        return best(play, rounds) / (runs * steps)


def _whole_drive(options: Options, duration: float) -> Findings:
    config = DriveConfig(
        payload=options.payload, density="dense", duration=duration, seed=options.seed
    )
    with Simulation(config, visuals=False) as simulation:
        factor = simulation.run().real_time_factor
    found = Findings()
    found.check("real-time factor of the whole drive", factor, "1", must=">= 1")
    return found


CYCLE_TICKS = round(CONTROL_PERIOD / TICK)
# One second of the bus contains every message, also the slowest.
CYCLES = 50


def _interface(rounds: int) -> Findings:
    """Returns processor times of frames and of a control cycle over the virtual bus.

    In a control cycle the controller's commands are sent and obeyed, the truck's reports of that
    instant are sent back, and the controller updates its state. Reports between two cycles are
    measured separately.
    """
    states = _drive(CYCLES * CYCLE_TICKS)
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


def _drive(ticks: int) -> list[tuple[EgoState, TruckReport]]:
    """Returns states and reports of the truck every 10 ms, with changing commands."""
    truck = Truck.load(visuals=False)
    truck.reset(speed=15.0)
    found = []
    for tick in range(ticks):
        truck.command(_command(tick))
        truck.step(round(TICK / truck.model.opt.timestep))
        found.append((truck.observe(), truck.report()))
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
