"""Measure what a step costs: physics, threads, J1939 frames, traffic, the whole drive.

Times depend on the machine; the bounds are on ratios, which hardly do. Each figure is the best of
several rounds, since other work on the machine can only make a round slower.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass

import mujoco
import mujoco.rollout
import numpy as np

from iits_mj.commands import bench_rows
from iits_mj.commands.bench_rows import best
from iits_mj.commands.output import ResultOptions, finish
from iits_mj.core import options as option_fields
from iits_mj.core.options import option
from iits_mj.core.results import Check, Results
from iits_mj.model.builder import truck_spec
from iits_mj.model.road_table import add_road_table
from iits_mj.parameters import TruckParameters, payload_option
from iits_mj.road import RoadMap
from iits_mj.simulation import DriveConfig, Simulation
from iits_mj.truck import Truck

MICROSECONDS = 1e6


@dataclass(frozen=True, kw_only=True)
class Options(ResultOptions):
    """Flags of `iits-mj bench`."""

    payload: float = payload_option()
    threads: int = option(2, help="threads of the rollout", low=1, high=256)
    traffic: bool = option(True, help="measure SUMO and a whole drive, too")
    seed: int = option(0, help="seed of the traffic", low=0, high=2**31 - 1)
    quick: bool = option(False, help="fewer rounds; ends within a minute")

    def __post_init__(self) -> None:
        option_fields.check(self)


def run(options: Options) -> int:
    """Measures and prints."""
    return finish(options, lambda: measure(options))


def measure(options: Options) -> Results:
    """All figures."""
    results = Results("bench", options.seed)
    rounds = 3 if options.quick else 10
    _physics(results, options, rounds)
    bench_rows.measure_bus(results, 5 * rounds)
    if options.traffic:
        bench_rows.measure_traffic(results, 2 * rounds)
        _drive(results, options, 10.0 if options.quick else 60.0)
    return results


def bare_model(parameters: TruckParameters, payload: float, timestep: float) -> mujoco.MjModel:
    """The truck's tree without any plugin: the same bodies and joints, no tire, engine or brake."""
    spec = truck_spec(parameters, payload)
    spec.option.timestep = timestep
    remove_plugins(spec, {plugin.plugin_name for plugin in spec.plugins})
    return spec.compile()


def remove_plugins(spec: mujoco.MjSpec, kinds: set[str]) -> None:
    """Takes every instance of these plugins out of the specification, with all that hangs on it."""
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


def _physics(results: Results, options: Options, rounds: int) -> None:
    steps = 1000
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

    # In turns, so that what else the machine does falls on both; by processor time, so that
    # waiting for a core does not count.
    play_full, play_tree = player(truck.model, start), player(bare, mujoco.MjData(bare))
    turns = [
        (best(play_full, 1, time.thread_time), best(play_tree, 1, time.thread_time))
        for _ in range(rounds)
    ]
    full, tree = (min(column) / steps for column in zip(*turns, strict=True))
    single = best(play_full, rounds) / steps
    aggregate = _rollout(truck.model, start, options.threads, steps, rounds)
    add = results.checks.append
    add(Check("step of the truck on the highway", full * MICROSECONDS, "us"))
    add(Check("step of the same tree without plugins", tree * MICROSECONDS, "us"))
    add(Check("plugins' share, truck over tree", full / tree, "1", 1.3, "<= 1.35"))
    costs, longitudinal = _per_plugin(truck, start, rounds)
    for kind, cost in costs.items():
        add(Check(f"plugin {kind}, of the step", cost * MICROSECONDS, "us"))
    name = "powertrain and brakes, step with them over without"
    add(Check(name, longitudinal, "1", 1.1, "<= 1.10"))
    add(Check("real-time factor of the physics", timestep / full, "1", None, ">= 1"))
    name = f"rollout, {options.threads} threads, per step in all"
    add(Check(name, aggregate * MICROSECONDS, "us"))
    add(Check("rollout's gain over one thread", single / aggregate, "1"))


def _per_plugin(truck: Truck, start: mujoco.MjData, rounds: int) -> tuple[dict[str, float], float]:
    """What a step gets cheaper by when all instances of one plugin are taken out [s].

    Short runs from the same motion, since without its tires the truck falls. The second result is
    the time of a step over that of one without powertrain and brakes.
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
    """Wall time per step of `mujoco.rollout`, all threads together [s]."""
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


def _drive(results: Results, options: Options, duration: float) -> None:
    config = DriveConfig(
        payload=options.payload, density="dense", duration=duration, seed=options.seed
    )
    add = results.checks.append
    with Simulation(config, visuals=False) as simulation:
        factor = simulation.run().real_time_factor
    add(Check("real-time factor of the whole drive", factor, "1", None, ">= 1"))
