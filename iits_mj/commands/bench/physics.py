"""Measures the computing time of the physics: a step and its parts, roll-outs, batches, growth.

Things that are compared run in turns, so that other work on the machine affects all of them, and
the best of several short rounds counts, because other work can only make a round slower. Processor
time does not count the time spent waiting for a core; speeds of several threads and processes need
wall time, and idle cores.
"""

from __future__ import annotations

import contextlib
import functools
import time
from collections.abc import Collection
from typing import Any

import mujoco
import mujoco.rollout
import numpy as np

from iits_mj.analytic.tire import Motion, Surface, Tires
from iits_mj.commands.bench.clocks import MICROSECONDS, Play, best, in_turns
from iits_mj.core.arrays import FloatArray
from iits_mj.core.results import Findings
from iits_mj.core.timing import CONTROL_PERIOD
from iits_mj.model.builder import truck_spec
from iits_mj.model.road_table import add_road_table
from iits_mj.parameters import AnyTruck, TruckParameters
from iits_mj.road import RoadMap
from iits_mj.truck import Truck

STATION, SPEED, PEDAL = 100.0, 15.0, 0.4  # of the truck on the highway [m], [m/s], 1
# Numbers of a wheel in the state of the tire plugin, and the place of the lost share of pressure.
_WHEEL_STATE, _PUNCTURE = 17, 16
_FLAT_FRICTION = 0.8


def physics(truck: Truck, threads: int = 2, rounds: int = 10) -> Findings:
    """Returns the figures of a step of the truck on the highway, and of roll-outs.

    Args:
      truck: of `highway_truck`.
      threads: of the roll-outs.
      rounds: of each measurement.
    """
    found = Findings()
    timestep = float(truck.model.opt.timestep)
    shipped = truck_model(truck, visuals=True)
    shipped_tree = bare_model(truck.parameters, truck.payload, timestep, visuals=True)
    tree = bare_model(truck.parameters, truck.payload, timestep)
    frame = bare_model(truck.parameters, truck.payload, timestep, sensors=False)
    runs = {
        "shipped": player(shipped, truck.data),
        "shipped tree": player(shipped_tree),
        "truck": player(truck.model, truck.data),
        "tree": player(tree),
        "frame": player(frame),
        "truck in cycles": _in_cycles(
            truck.model, truck.data, functools.partial(truck.step, _CYCLE)
        ),
        "tree in cycles": _in_cycles(tree, None, None),
        "frame in cycles": _in_cycles(frame, None, None),
    }
    least = in_turns(runs, 4 * rounds)
    cost = {name: value / _STEPS * MICROSECONDS for name, value in least.items()}

    def ratio(name: str, one: str, other: str, must: str = "") -> None:
        found.check(name, cost[one] / cost[other], "1", must=must)

    found.check("step of the truck with visual geoms", cost["shipped"], "us")
    found.check("step of the same tree without plugins", cost["shipped tree"], "us")
    ratio("plugins' share, truck over tree", "shipped", "shipped tree", "<= 1.35")
    found.check("step of the truck without visual geoms", cost["truck"], "us")
    ratio("plugins' share without visual geoms", "truck", "tree")
    ratio("tree over the same without visual geoms, sensors, sites", "shipped tree", "frame")
    found.check("step of the truck in control cycles of Truck.step", cost["truck in cycles"], "us")
    ratio("plugins' share in control cycles", "truck in cycles", "tree in cycles")
    name = "tree over the same without sensors, sites, in control cycles"
    ratio(name, "tree in cycles", "frame in cycles", "<= 1.05")
    costs, longitudinal = per_plugin(truck, rounds)
    for kind, seconds in costs.items():
        found.check(f"plugin {kind}, of the step", seconds * MICROSECONDS, "us")
    name = "powertrain and brakes, step with them over without"
    found.check(name, longitudinal, "1", 1.1, "<= 1.10")
    numpy_time = numpy_tires(rounds)
    name = "tires in numpy over tires in the plugin"
    found.check("tires of a step in numpy", numpy_time * MICROSECONDS, "us")
    found.check(name, numpy_time / costs["iits.tire"], "1", must=">= 20")
    factor = timestep * _STEPS / least["truck"]
    found.check("real-time factor of the physics", factor, "1", must=">= 1")
    found.checks += rollout_gain(truck, threads, 3 * rounds).checks
    return found


_STEPS = 500  # of a round
_CYCLE = round(CONTROL_PERIOD / 0.002)


def highway_truck(payload: float | None = None, truck: AnyTruck | None = None) -> Truck:
    """Returns a truck that drives on the built-in highway, loaded as headless drives do."""
    made = Truck.load(payload, truck=truck, route=RoadMap.builtin().route(), visuals=False)
    made.reset(station=STATION, speed=SPEED)
    made.command(accelerator_pedal=PEDAL)
    return made


def player(model: mujoco.MjModel, source: mujoco.MjData | None = None, steps: int = _STEPS) -> Play:
    """Returns a function that makes these steps of plain MuJoCo, always from the same state."""
    start, data = mujoco.MjData(model), mujoco.MjData(model)
    if source is not None:
        # The model may differ from that of `source` in what is only seen.
        for name in ("qpos", "qvel", "ctrl", "plugin_state"):
            getattr(start, name)[:] = getattr(source, name)

    def play() -> None:
        mujoco.mj_copyData(data, model, start)
        mujoco.mj_step(model, data, steps)

    return play


def truck_model(truck: Truck, *, visuals: bool, without: Collection[str] = ()) -> mujoco.MjModel:
    """Returns the truck's model on its road, with or without visual geoms and some plugins."""
    spec = truck_spec(truck.parameters, truck.payload, visuals=visuals)
    spec.option.timestep = truck.model.opt.timestep
    add_road_table(spec, truck.route)
    remove_plugins(spec, without)
    return spec.compile()


def bare_model(
    parameters: TruckParameters,
    payload: float,
    timestep: float,
    *,
    visuals: bool = False,
    sensors: bool = True,
) -> mujoco.MjModel:
    """Returns the truck's model without plugins: same bodies, but no tire, engine or brake.

    Args:
      parameters: of the truck.
      payload: [kg].
      timestep: of the physics [s].
      visuals: keeps the visual geoms.
      sensors: keeps MuJoCo's own sensors and the sites.
    """
    spec = truck_spec(parameters, payload, visuals=visuals)
    spec.option.timestep = timestep
    remove_plugins(spec, {plugin.plugin_name for plugin in spec.plugins})
    if not sensors:
        for element in [*spec.sensors, *spec.sites]:
            spec.delete(element)
    return spec.compile()


def remove_plugins(spec: mujoco.MjSpec, kinds: Collection[str]) -> None:
    """Removes all instances of these plugins and their sensors and actuators."""
    names = {plugin.name for plugin in spec.plugins if plugin.plugin_name in kinds}
    # The steering computes this one from the tires' forces.
    of_tires = {"steering_wheel_torque"} if "iits.tire" in kinds else set()
    for sensor in list(spec.sensors):
        if sensor.type == mujoco.mjtSensor.mjSENS_PLUGIN and (
            sensor.plugin.name in names or sensor.name in of_tires
        ):
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


def _in_cycles(
    model: mujoco.MjModel, source: mujoco.MjData | None = None, step: Play | None = None
) -> Play:
    """Returns a function that steps through control cycles, sensors at the end of each.

    Args:
      model: to step.
      source: initial state, which is also the state that `step` advances; default: that of a reset.
      step: advances one cycle; default: as `Truck.step` does.
    """
    start = mujoco.MjData(model)
    data = mujoco.MjData(model) if source is None else source
    if source is not None:
        mujoco.mj_copyData(start, model, source)
    without = int(mujoco.mjtDisableBit.mjDSBL_SENSOR)

    def cycle() -> None:
        model.opt.disableflags |= without
        mujoco.mj_step(model, data, _CYCLE - 1)
        model.opt.disableflags &= ~without
        mujoco.mj_step(model, data, 1)

    advance = step or cycle

    def play() -> None:
        mujoco.mj_copyData(data, model, start)
        for _ in range(_STEPS // _CYCLE):
            advance()

    return play


def per_plugin(truck: Truck, rounds: int) -> tuple[dict[str, float], float]:
    """Returns the time of each plugin in a step [s], and a ratio.

    The time is the difference to a model without the plugin. The ratio is the time of a step over
    the time without powertrain and brakes. The runs are short and begin with the same motion,
    because the truck falls without its tires. The models have visual geoms.
    """
    steps, start = 200, truck.data

    def without(removed: set[str]) -> Play:
        model = truck_model(truck, visuals=True, without=removed)
        data = mujoco.MjData(model)
        data.qpos[:], data.qvel[:] = start.qpos, start.qvel
        for i in range(model.nactuator):
            data.ctrl[i] = start.actuator(model.actuator(i).name).ctrl[0]
        return player(model, data, steps)

    spec = truck_spec(truck.parameters, 0.0, visuals=False)
    kinds = sorted({plugin.plugin_name for plugin in spec.plugins})
    both = "powertrain and brakes"
    players = {"": without(set()), both: without({"iits.powertrain", "iits.air_brake"})}
    players |= {kind: without({kind}) for kind in kinds}
    least = {name: value / steps for name, value in in_turns(players, 10 * rounds).items()}
    return {kind: least[""] - least[kind] for kind in kinds}, least[""] / least[both]


def numpy_tires(rounds: int = 10) -> float:
    """Returns the time of the tires' law of a step in numpy [s], without the road's look-up."""
    truck = Truck.load(visuals=False)
    truck.reset(speed=SPEED)
    inputs, tires = tire_inputs(truck), Tires.of(truck.parameters)
    return best(lambda: tires.step(*inputs), 100 * rounds, time.thread_time)


def tire_inputs(truck: Truck) -> tuple[Motion, Surface, FloatArray, float, FloatArray]:
    """Returns the arguments of `Tires.step` for a truck on the plane, at its last `mj_forward`."""
    model, data = truck.model, truck.data
    wheels = _wheels(truck)
    hubs = model.body_parentid[wheels]
    dofs = model.body_dofadr[wheels]
    center = data.xpos[wheels].T
    motion = Motion(
        height=center[2],
        arm=center - data.subtree_com[model.body_rootid[wheels]].T,
        axle=data.xmat[hubs].reshape(-1, 3, 3)[:, :, 1].T,
        velocity=data.cvel[hubs, 3:].T,
        angular=data.cvel[hubs, :3].T,
        spin=data.qvel[dofs],
        inertia=model.dof_M0[dofs],
    )
    up = np.repeat([[0.0], [0.0], [1.0]], len(wheels), axis=1)
    friction = np.full(len(wheels), _FLAT_FRICTION)
    surface = Surface(np.zeros(len(wheels)), up, friction)
    states = tire_states(truck)
    return motion, surface, states[:3], float(model.opt.timestep), states[_PUNCTURE]


def tire_states(truck: Truck) -> FloatArray:
    """Returns the numbers of the tire plugin's state, (17, wheels): bristles first."""
    model, rows = truck.model, []
    # An instance has its wheels in the order of the bodies, and so have the instances.
    for instance in dict.fromkeys(model.body_plugin[_wheels(truck)].tolist()):
        first = model.plugin_stateadr[instance]
        rows.append(truck.data.plugin_state[first : first + model.plugin_statenum[instance]])
    return np.concatenate(rows).reshape(-1, _WHEEL_STATE).T


def _wheels(truck: Truck) -> np.ndarray[Any, np.dtype[np.intp]]:
    names = [f"{a.name}_{side}_wheel" for a in truck.parameters.axles for side in ("left", "right")]
    return np.array([truck.model.body(name).id for name in names])


def rollout_gain(truck: Truck, threads: int, rounds: int = 30) -> Findings:
    """Returns the speeds of `mujoco.rollout` with one thread and with several.

    Results go into arrays that exist already. Processor time shows what the threads cost each
    other, wall time also how evenly they share the work, if the cores are idle.
    """
    runs, steps = 8 * threads, 100
    model, kind = truck.model, mujoco.mjtState.mjSTATE_FULLPHYSICS
    state = np.zeros(mujoco.mj_stateSize(model, kind))
    mujoco.mj_getState(model, truck.data, state, kind)
    states, controls = np.tile(state, (runs, 1)), np.tile(truck.data.ctrl, (runs, steps, 1))
    kept = np.zeros((runs, steps, len(state)))
    sensors = np.zeros((runs, steps, model.nsensordata))
    with contextlib.ExitStack() as pools:
        plays = {}
        for count in (1, threads):
            pool = pools.enter_context(mujoco.rollout.Rollout(nthread=count))
            datas = [mujoco.MjData(model) for _ in range(count)]
            plays[str(count)] = functools.partial(
                pool.rollout, model, datas, states, controls, state=kept, sensordata=sensors
            )
        wall = in_turns(plays, rounds, time.perf_counter)
        processor = in_turns(plays, rounds, time.process_time)
    per_step = {name: value / (runs * steps) * MICROSECONDS for name, value in wall.items()}
    one, many, found = "1", str(threads), Findings()
    found.check(f"rollout, {many} threads, per step in all", per_step[many], "us")
    found.check("rollout's gain over one thread", wall[one] / wall[many], "1", float(threads))
    name = f"processor time of a rollout, {many} threads over 1"
    # With two threads on idle cores, this bound means a gain of 1.93.
    found.check(name, processor[many] / processor[one], "1", 1.0, "<= 1.036")
    return found
