"""Drives the MuJoCo truck with the whole stack over a road without traffic, and keeps what it did.

Planner every 100 ms, tracker every 20 ms, as in `iits-mj drive`: gear shifts, brakes and steering
are the truck's own.
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass
from pathlib import Path
from zipfile import BadZipFile

import numpy as np

from controllers.planning.planner import PlannerConfig
from controllers.planning.speed_plan import SpeedConfig
from controllers.stack import Stack
from controllers.tracking.controller import TrackingConfig
from iits_mj.core.arrays import FloatArray
from iits_mj.core.errors import Error, InputError
from iits_mj.core.messages import EgoState, Scene, SpeedProfile, Trajectory, VehicleCommand, XbrMode
from iits_mj.parameters import TruckParameters
from iits_mj.road import Route
from iits_mj.truck import Truck

# Rates of the stack and of the record [s].
CONTROL_PERIOD, PLAN_PERIOD = 0.02, 0.1
_HOLD = 2.0
_COUNTERS = ("engine_work", "driveline_loss", "retarder_work", "brake_work")
COLUMNS = (
    "time",
    "station",
    "offset",
    "speed",
    "planned",
    "acceleration",
    "gear",
    "shift",
    "engine_speed",
    "engine_torque",
    "fuel_used",
    "pedal",
    "xbr_demand",
    "engine_brake",
    "retarder",
    *_COUNTERS,
)


@dataclass(frozen=True)
class Task:
    """One drive.

    Attributes:
      route: the road; start, end: stations of the steer axle [m]; speed: at the start [m/s], 0 for
        a truck that stands braked.
      cruise_speed: wanted where there is no profile [m/s]; profile: reference speed over station.
      payload: [kg]; lane: that is kept; timestep: of the physics [s]; time_limit: [s].
      curve_acceleration: lateral acceleration that bounds the speed in curves [m/s2].
    """

    route: Route
    start: float
    end: float
    speed: float
    cruise_speed: float
    profile: SpeedProfile | None = None
    payload: float = 36_000.0
    lane: int = 0
    timestep: float = 0.002
    time_limit: float = 3600.0
    curve_acceleration: float = SpeedConfig.curve_acceleration


@dataclass(frozen=True)
class Record:
    """Columns named in `COLUMNS` every 20 ms, each of shape (n,); SI."""

    table: FloatArray

    def __getitem__(self, name: str) -> FloatArray:
        """One column by its name."""
        return np.asarray(self.table[:, COLUMNS.index(name)])

    def at(self, station: float, name: str) -> float:
        """A column where the steer axle passes a station."""
        return float(np.interp(station, self["station"], self[name]))

    def between(self, first: float, last: float) -> Record:
        """The part of the drive between two stations."""
        station = self["station"]
        return Record(self.table[(station >= first) & (station <= last)])

    def save(self, path: Path) -> None:
        """Writes the record; the file appears only when it is complete."""
        partial = path.with_name(f".{path.name}.partial.npz")
        np.savez_compressed(partial, columns=np.array(COLUMNS), table=self.table)
        partial.replace(path)

    @classmethod
    def load(cls, path: Path) -> Record:
        """Reads what `save` wrote.

        Raises:
          InputError: the file is no record of this version.
        """
        try:
            with np.load(path) as content:
                names, table = tuple(content["columns"].tolist()), np.asarray(content["table"])
        except (OSError, ValueError, KeyError, EOFError, BadZipFile, zlib.error) as error:
            raise InputError(
                f"{str(path)!r} is no record of a drive: {error}; remove it to drive again"
            ) from error
        if names != COLUMNS or table.ndim != 2 or table.shape[1] != len(COLUMNS):
            raise InputError(f"{str(path)!r} holds other columns: remove it to drive again")
        if len(table) < 2 or table.dtype.kind != "f" or not np.isfinite(table).all():
            raise InputError(f"{str(path)!r} holds no drive: remove it to drive again")
        return cls(table)


def drive(task: Task, parameters: TruckParameters | None = None) -> Record:
    """Drives from the start to the end station.

    Raises:
      InputError: the truck does not get to the end within the time limit.
      Error: the simulation diverged.
    """
    truck = Truck.load(
        task.payload,
        route=task.route,
        parameters=parameters,
        timestep=task.timestep,
        visuals=False,
    )
    offset = float(task.route.lane_offset(task.lane, task.start))
    truck.reset(station=task.start, offset=offset, speed=task.speed)
    if task.speed == 0.0:
        _hold(truck)
    speed = SpeedConfig(cruise_speed=task.cruise_speed, curve_acceleration=task.curve_acceleration)
    stack = Stack(
        task.route,
        planner=PlannerConfig(lanes=(task.lane,), speed=speed),
        tracking=TrackingConfig(),
        parameters=truck.parameters,
        profile=task.profile,
    )
    steps = round(CONTROL_PERIOD / task.timestep)
    calls = round(PLAN_PERIOD / CONTROL_PERIOD)
    rows = []
    for tick in range(round(task.time_limit / CONTROL_PERIOD)):
        ego = truck.observe()
        if ego.station >= task.end:
            break
        if tick % calls == 0:
            trajectory = stack.plan(Scene(ego.time, ego, (), truck.footprint))
        command = stack.control(ego)
        rows.append(_row(truck, ego, trajectory, command))
        truck.command(command)
        truck.step(steps)
    else:
        raise InputError(
            f"the truck is at {ego.station:.0f} m after {task.time_limit:.0f} s: "
            f"it does not get to {task.end:.0f} m"
        )
    if len(rows) < 2:
        raise Error(f"the drive from {task.start:g} to {task.end:g} m has no length")
    return Record(np.array(rows))


def _hold(truck: Truck) -> None:
    """Lets the brakes of a standing truck build up, as after a stop."""
    truck.command(xbr_demand=-1.0, xbr_mode=XbrMode.MAXIMUM)
    truck.step(round(_HOLD / truck.model.opt.timestep))


def _row(
    truck: Truck, ego: EgoState, trajectory: Trajectory, command: VehicleCommand
) -> list[float]:
    return [
        ego.time,
        ego.station,
        ego.offset,
        ego.speed,
        float(np.interp(ego.time, trajectory.time, trajectory.speed)),
        ego.acceleration,
        float(ego.gear),
        float(ego.shift_in_process),
        ego.engine_speed,
        ego.engine_torque,
        ego.fuel_used,
        command.accelerator_pedal,
        command.xbr_demand,
        command.engine_brake,
        command.retarder,
        *(truck.read(name) for name in _COUNTERS),
    ]
