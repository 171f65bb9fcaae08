"""Rolls out thousands of open-loop drives on all cores, with any loads, roads and parameters.

    scenarios = [
        Scenario(route=road, payload=load, place=TruckPlacement(station=50.0, speed=20.0))
        for load in (0.0, 12_000.0, 36_000.0)
    ]
    drives = roll_out(scenarios, {"steering_wheel_angle": angles}, duration=8.0, threads=8)
    drives["tractor_gyro"]          # (3 scenarios, 80 instants, 3 components)
    drives.units["tractor_gyro"]    # "rad/s"

The physics is `mujoco.batch`, or a planar plant; every drive equals the one of `Truck.step` bit for
bit.
"""

from __future__ import annotations

import copy
import json
import os
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Any

import mujoco
import numpy as np
from mujoco.batch import Batch
from numpy.typing import ArrayLike, NDArray

from iits_mj.core.arrays import FloatArray
from iits_mj.core.errors import InputError
from iits_mj.core.timing import TIMESTEP
from iits_mj.model.sensor_table import sensor_unit
from iits_mj.parameters import AnyTruck, TruckParameters
from iits_mj.road import Route
from iits_mj.truck.placement import TruckPlacement
from iits_mj.truck.truck import COMMAND_FIELDS, Truck

SIGNALS = (
    "tractor_position",
    "tractor_velocity",
    "tractor_acceleration",
    "tractor_gyro",
    "trailer_gyro",
    "articulation_yaw",
    "engine_speed",
    "gear",
    "fuel_used",
)
# State at the start of a physics step.
_STATE = ("time", "qpos", "qvel", "act", "plugin_state", "qacc_warmstart")


@dataclass(frozen=True, kw_only=True)
class Scenario:
    """Initial conditions of a drive.

    Attributes:
      route: the road, with its friction.
      place: of the truck on it.
      payload: [kg]; default: the truck's greatest.
      truck: see `Truck.load`; the drives may be of different ones.
      parameters: overlay of the truck's parameters; see `TruckParameters.load`.
    """

    route: Route
    place: TruckPlacement = field(default_factory=TruckPlacement)
    payload: float | None = None
    truck: AnyTruck | None = None
    parameters: Mapping[str, Any] | None = None


@dataclass(frozen=True)
class Rollouts:
    """Results; arrays have shape (scenarios, instants) or (scenarios, instants, numbers).

    Attributes:
      time: of the instants [s], shape (instants,).
      values: of each sensor, by its name in the model.
      units: of each sensor.
      diverged: whether the physics of a drive diverged, shape (scenarios,); its last values are
        then repeated.
      left_range: of each scenario, the limits of the plant's validity that it exceeded; see
        `Truck.left_range`.
    """

    time: FloatArray
    values: dict[str, FloatArray]
    units: dict[str, str]
    diverged: NDArray[np.bool_]
    left_range: list[tuple[str, ...]]

    def __getitem__(self, signal: str) -> FloatArray:
        """Returns the values of a sensor.

        Raises:
          InputError: it was not recorded.
        """
        if signal not in self.values:
            raise InputError(f"signal {signal!r} was not recorded; there are {list(self.values)}")
        return self.values[signal]


def roll_out(
    scenarios: Sequence[Scenario],
    controls: Mapping[str, ArrayLike],
    *,
    duration: float,
    period: float = 0.1,
    signals: Sequence[str] | None = None,
    threads: int = 0,
    timestep: float = TIMESTEP,
    plant: str = "full",
) -> Rollouts:
    """Drives all scenarios with open-loop commands.

    Args:
      scenarios: one per drive; those of equal road, truck, load and parameters share a model.
      controls: command names to values that broadcast to (scenarios, instants); each is held from
        one instant to the next. Commands that are not given are 0.
      duration: of a drive [s], whole periods.
      period: between two instants [s], whole time steps.
      signals: names of sensors that every truck has; default: those of `SIGNALS`.
      threads: 0 uses all cores.
      timestep: of the physics [s], 0.0005 to 0.005.
      plant: model of the truck's motion; see `Truck.load`.

    Raises:
      InputError: no scenario, an unknown truck, command or sensor, a sensor of different size on
        two trucks, a value that is not finite or outside the command's range, a shape that does not
        fit, or times that are not whole multiples.
    """
    if not scenarios:
        raise InputError("roll_out: at least one scenario is needed")
    steps = _whole(period, timestep, "period", "time steps")
    instants = _whole(duration, period, "duration", "periods")
    groups = _groups(scenarios, timestep, plant)
    commands = _commands(groups, controls, (len(scenarios), instants))
    columns = _columns(groups, signals)
    values = {
        name: np.zeros((len(scenarios), instants, stop - start))
        for name, (start, stop) in columns[0].items()
    }
    diverged = np.zeros(len(scenarios), dtype=bool)
    left_range: list[tuple[str, ...]] = [()] * len(scenarios)
    cores = threads or os.cpu_count() or 1
    # Either the drives of a group are shared among the threads, or the groups are.
    spread = len(groups) >= cores

    def drive(group: _Group, places: Mapping[str, tuple[int, int]]) -> None:
        chosen = group.numbers
        found, alive, left = (_drive if group.truck.planar is None else _drive_planar)(
            group, [scenarios[k].place for k in chosen], commands[chosen], places, steps,
            threads=1 if spread else cores,
        )  # fmt: skip
        diverged[chosen] = ~alive
        for number, limits in zip(chosen, left, strict=True):
            left_range[number] = limits
        for name in places:
            values[name][chosen] = found[name]

    with ThreadPoolExecutor(cores if spread else 1) as pool:
        list(pool.map(drive, groups, columns))
    return Rollouts(
        time=np.arange(1, instants + 1, dtype=float) * period,
        values={n: v[:, :, 0] if v.shape[2] == 1 else v for n, v in values.items()},
        units={name: sensor_unit(name).unit for name in values},
        diverged=diverged,
        left_range=left_range,
    )


@dataclass(frozen=True)
class _Group:
    """Scenarios of one road, truck, load and set of parameters.

    Each has its own batch: MuJoCo reads the plugin's constants when it makes data for a model, so
    that data of one model would keep its tires in another model.
    """

    truck: Truck
    numbers: list[int]


def _drive(
    group: _Group,
    places: Sequence[TruckPlacement],
    commands: FloatArray,
    columns: Mapping[str, tuple[int, int]],
    steps: int,
    threads: int,
) -> tuple[dict[str, FloatArray], NDArray[np.bool_], list[tuple[str, ...]]]:
    """Sensors of one group's drives, (drives, instants, numbers), which lived, and limits left."""
    model, data = group.truck.model, group.truck.data
    # Sensors are needed at the instants only: one batch drives without them, one reads them.
    blind = copy.copy(model)
    blind.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_SENSOR)
    batch, reader = (Batch(m, nsim=len(places), nthread=threads) for m in (blind, model))
    rows, shown = ({name: b.bind(name) for name in (*_STATE, "ctrl")} for b in (batch, reader))
    sensors = reader.bind("sensordata")
    for number, place in enumerate(places):
        mujoco.mj_resetData(model, data)
        group.truck.place(place)
        mujoco.mj_forward(model, data)
        for name in _STATE:
            row = rows[name]
            row[number] = np.reshape(getattr(data, name), row[number].shape)
    count, instants = commands.shape[:2]
    found = {n: np.zeros((count, instants, stop - start)) for n, (start, stop) in columns.items()}
    alive = np.ones(count, dtype=bool)
    for instant in range(instants):
        rows["ctrl"][:] = commands[:, instant]
        if alive.any():
            batch.step(ids=np.flatnonzero(alive), nstep=steps)
            for name, row in rows.items():
                shown[name][alive] = row[alive]
            reader.forward(ids=np.flatnonzero(alive))
        time = (instant + 1) * steps * model.opt.timestep
        alive &= np.isfinite(rows["qpos"]).all(axis=1) & np.isfinite(sensors).all(axis=1)
        # MuJoCo resets a simulation that diverged.
        alive &= np.abs(rows["time"].ravel() - time) < 0.5 * model.opt.timestep
        for name, (start, stop) in columns.items():
            found[name][alive, instant] = sensors[alive, start:stop]
            if instant:
                found[name][~alive, instant] = found[name][~alive, instant - 1]
    return found, alive, [()] * count


def _drive_planar(
    group: _Group,
    places: Sequence[TruckPlacement],
    commands: FloatArray,
    columns: Mapping[str, tuple[int, int]],
    steps: int,
    threads: int,
) -> tuple[dict[str, FloatArray], NDArray[np.bool_], list[tuple[str, ...]]]:
    """As `_drive`, with the planar plant."""
    truck, model, plant = group.truck, group.truck.model, group.truck.planar
    assert plant is not None
    # Nothing can touch the truck on its road.
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    data = [mujoco.MjData(model) for _ in places]
    for one, place in zip(data, places, strict=True):
        mujoco.mj_resetData(model, truck.data)
        truck.place(place)
        one.qpos[:], one.qvel[:] = truck.data.qpos, truck.data.qvel
    plant.step(model, (), 0)  # so that the threads share what it reads from the model
    controls, sensors = [one.ctrl for one in data], [one.sensordata for one in data]
    # All signals of an instant are read at once.
    places_of = {name: np.arange(start, stop) for name, (start, stop) in columns.items()}
    read = np.concatenate(list(places_of.values())) if places_of else np.zeros(0, dtype=int)
    count, instants = commands.shape[:2]
    table = np.zeros((count, instants, len(read)))
    alive = np.ones(count, dtype=bool)

    def drive(numbers: NDArray[np.int64]) -> None:
        for instant in range(instants):
            driven = numbers[alive[numbers]]
            for number in driven:
                controls[number][:] = commands[number, instant]
            alive[driven] = plant.step(model, [data[n] for n in driven], steps, observe=True)
            for number in numbers:
                if alive[number]:
                    table[number, instant] = sensors[number][read]
                elif instant:
                    table[number, instant] = table[number, instant - 1]

    with ThreadPoolExecutor(threads) as pool:
        list(pool.map(drive, np.array_split(np.arange(count), min(threads, count))))
    cuts = np.cumsum([len(places) for places in places_of.values()])[:-1]
    parts = np.split(table, cuts, axis=2) if places_of else []
    left = [plant.left_range(one) for one in data]
    return dict(zip(places_of, parts, strict=True)), alive, left


def _groups(scenarios: Sequence[Scenario], timestep: float, plant: str) -> list[_Group]:
    made: dict[tuple[Any, ...], _Group] = {}
    for number, scenario in enumerate(scenarios):
        overlay, truck = scenario.parameters or {}, scenario.truck
        named = id(truck) if isinstance(truck, TruckParameters) else truck
        changes = json.dumps(overlay, sort_keys=True)
        key = (id(scenario.route), named, scenario.payload, changes)
        if key not in made:
            loaded = Truck.load(
                scenario.payload,
                truck=truck,
                parameters=overlay or None,
                route=scenario.route,
                timestep=timestep,
                plant=plant,
                visuals=False,
            )
            made[key] = _Group(loaded, [])
        made[key].numbers.append(number)
    return list(made.values())


def _commands(
    groups: Sequence[_Group], controls: Mapping[str, ArrayLike], shape: tuple[int, int]
) -> FloatArray:
    """Commands (scenarios, instants, 10), each within its range on its truck."""
    found = np.zeros((*shape, len(COMMAND_FIELDS)))
    for name, given in controls.items():
        if name not in COMMAND_FIELDS:
            raise InputError(f"unknown command {name!r}; there are {COMMAND_FIELDS}")
        values = np.asarray(given, dtype=float)
        try:
            values = np.broadcast_to(values, shape)
        except ValueError:
            raise InputError(
                f"command {name} of shape {values.shape} does not fit (scenarios, instants) {shape}"
            ) from None
        for group in groups:
            low, high = group.truck.model.actuator(name).ctrlrange
            own = values[group.numbers]
            wrong = ~((own >= low) & (own <= high))
            if wrong.any():
                raise InputError(
                    f"command {name} = {own[wrong][0]!r} is outside [{low:g}, {high:g}]"
                )
        found[:, :, COMMAND_FIELDS.index(name)] = values
    return found


def _columns(
    groups: Sequence[_Group], signals: Sequence[str] | None
) -> list[dict[str, tuple[int, int]]]:
    """Places of each sensor in each group's `sensordata`."""
    places = []
    for group in groups:
        model = group.truck.model
        sensors = [model.sensor(i) for i in range(model.nsensor)]
        places.append({s.name: (int(s.adr[0]), int(s.adr[0] + s.dim[0])) for s in sensors})
    if signals is None:
        signals = [name for name in SIGNALS if all(name in known for known in places)]
    for name in signals:
        sizes = set()
        for group, known in zip(groups, places, strict=True):
            if name not in known:
                raise InputError(
                    f"sensor {name!r} is unknown on truck {group.truck.parameters.name!r}; there "
                    f"are {', '.join(known)}"
                )
            sizes.add(known[name][1] - known[name][0])
        if len(sizes) > 1:
            raise InputError(
                f"sensor {name!r} has {sorted(sizes)} numbers on these trucks: roll them out apart"
            )
    return [{name: known[name] for name in signals} for known in places]


def _whole(length: float, part: float, name: str, parts: str) -> int:
    count = round(length / part) if part > 0.0 and np.isfinite(length) else 0
    if count < 1 or abs(count * part - length) > 1e-9 * max(1.0, length):
        raise InputError(f"{name} {length!r} s: a whole number of {parts} of {part!r} s is needed")
    return count
