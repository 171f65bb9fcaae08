"""Drives of the MuJoCo truck with the stack on a road without traffic, and their records."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from controllers.pcc.rolling import RollingReference
from controllers.planning.planner import PlannerConfig
from controllers.planning.speed_plan import SpeedConfig
from controllers.stack import Stack
from iits_mj.core.arrays import FloatArray
from iits_mj.core.errors import Error, InputError
from iits_mj.core.input_files import read_npz
from iits_mj.core.messages import EgoState, Scene, SpeedProfile, VehicleCommand, XbrMode
from iits_mj.core.output_files import OutputFile
from iits_mj.core.timing import TIMESTEP
from iits_mj.parameters import TruckParameters
from iits_mj.road import Route
from iits_mj.simulation.lock_step import DrivenTruck, Driver, LockStep, Observer
from iits_mj.truck import Truck
from iits_mj.validation.harness.config import laden

# Time in which the brakes of a standing truck build up before it starts [s].
_BUILD_UP = 2.0
_COUNTERS = ("engine_work", "driveline_loss", "retarder_work", "brake_work")
_SIZE_MAX = 2**28  # bytes of a record
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
class Record:
    """Time histories of a drive: named columns every 20 ms, SI; `table` has shape (n, k)."""

    table: FloatArray
    columns: tuple[str, ...] = COLUMNS

    def __getitem__(self, name: str) -> FloatArray:
        """Returns one column, shape (n,)."""
        return np.asarray(self.table[:, self.columns.index(name)])

    def at(self, station: float, name: str) -> float:
        """Returns a column's value where the steer axle passes a station."""
        return float(np.interp(station, self["station"], self[name]))

    def between(self, first: float, last: float) -> Record:
        """Returns the part of the drive between two stations."""
        station = self["station"]
        return Record(self.table[(station >= first) & (station <= last)], self.columns)

    def after(self, start: float) -> Record:
        """Returns the drive from a time after its start [s] on."""
        time = self["time"]
        return Record(self.table[time >= time[0] + start], self.columns)

    @property
    def length(self) -> float:
        """Distance between the first and the last station [m]."""
        station = self["station"]
        return float(station[-1] - station[0])

    def save(self, path: Path) -> None:
        """Writes the record; the file appears only when it is complete."""
        with OutputFile(path, "record of a drive") as partial:
            np.savez_compressed(partial, columns=np.array(self.columns), table=self.table)

    @classmethod
    def load(cls, path: Path) -> Record:
        """Reads what `save` wrote, with the columns `COLUMNS`.

        Raises:
          InputError: the file is not a record of this version.
        """
        content = read_npz(path, "record of a drive", _SIZE_MAX, ("columns", "table"))
        names, table = tuple(content["columns"].tolist()), content["table"]
        if names != COLUMNS or table.ndim != 2 or table.shape[1] != len(COLUMNS):
            raise InputError(f"{str(path)!r} holds other columns: remove it to drive again")
        if len(table) < 2 or table.dtype.kind != "f" or not np.isfinite(table).all():
            raise InputError(f"{str(path)!r} holds no drive: remove it to drive again")
        return cls(table)


class Recorder(Observer):
    """Keeps a row of figures for every command.

    Args:
      columns: names of the figures.
      row: gives the figures of a state and its command.
    """

    def __init__(
        self,
        columns: tuple[str, ...],
        row: Callable[[EgoState, VehicleCommand], Sequence[float]],
    ) -> None:
        self._columns = columns
        self._row = row
        self._rows: list[Sequence[float]] = []

    def commanded(self, ego: EgoState, wanted: VehicleCommand, obeyed: VehicleCommand) -> None:
        """Adds a row."""
        del wanted
        self._rows.append(self._row(ego, obeyed))

    def record(self) -> Record:
        """Returns the rows so far."""
        return Record(np.array(self._rows), self._columns)


def run_recorded(
    truck: DrivenTruck,
    driver: Driver,
    recorder: Recorder,
    scenes: Callable[[EgoState], Scene],
    *,
    timestep: float,
    duration: float,
    until: Callable[[EgoState], bool] = lambda _: False,
) -> tuple[Record, bool]:
    """Drives a truck and records it.

    Args:
      truck: at its start.
      driver: plans and controls.
      recorder: of this drive.
      scenes: gives the scene that the driver sees in a state.
      timestep: of the truck's physics [s].
      duration: at most [s].
      until: whether a state is the last one.

    Returns:
      The record, the last state included, and whether `until` ended the drive.
    """
    lock_step = LockStep(truck, driver, scenes, [recorder], timestep=timestep)
    ended = lock_step.advance(duration, until)
    return recorder.record(), ended


@dataclass(frozen=True)
class DriveTask:
    """A drive from one station to another.

    Attributes:
      route: the road; start, end: stations of the steer axle [m]; speed: at the start [m/s], 0 for
        a standing truck with its brakes applied.
      cruise_speed: reference without a profile [m/s]; profile: reference speed over station.
      top: speed up to which a cruise rolls downhill [m/s]; None: it brakes at `cruise_speed`.
      payload: [kg]; timestep: of the physics [s]; plant: see `Truck.load`; time_limit: [s].
    """

    route: Route
    start: float
    end: float
    speed: float
    cruise_speed: float
    profile: SpeedProfile | None = None
    top: float | None = None
    payload: float = field(default_factory=laden)
    timestep: float = TIMESTEP
    plant: str = "full"
    time_limit: float = 3600.0


def drive(task: DriveTask, parameters: TruckParameters | None = None) -> Record:
    """Drives a task in the rightmost lane and records `COLUMNS` up to the end station.

    Raises:
      InputError: the truck does not reach the end within the time limit.
      Error: the simulation diverged.
    """
    truck = Truck.load(
        task.payload,
        route=task.route,
        parameters=parameters,
        timestep=task.timestep,
        plant=task.plant,
        visuals=False,
    )
    offset = float(task.route.lane_offset(0, task.start))
    truck.reset(station=task.start, offset=offset, speed=task.speed)
    if task.speed == 0.0:
        truck.command(xbr_demand=-1.0, xbr_mode=XbrMode.MAXIMUM)
        truck.step(round(_BUILD_UP / task.timestep))
    rolling = None
    if task.top is not None and task.profile is None:
        rolling = RollingReference(task.route, task.cruise_speed, task.top, truck.parameters)
    speed = SpeedConfig(cruise_speed=task.cruise_speed)
    stack = Stack(
        task.route,
        planner=PlannerConfig(lanes=(0,), speed=speed),
        parameters=truck.parameters,
        profile=task.profile,
        reference=rolling,
    )

    def row(ego: EgoState, command: VehicleCommand) -> list[float]:
        plan = stack.last_trajectory
        assert plan is not None
        return [
            ego.time,
            ego.station,
            ego.offset,
            ego.speed,
            float(np.interp(ego.time, plan.time, plan.speed)),
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

    record, arrived = run_recorded(
        truck,
        stack,
        Recorder(COLUMNS, row),
        lambda ego: Scene(ego.time, ego, (), truck.footprint),
        timestep=task.timestep,
        duration=task.time_limit,
        until=lambda ego: ego.station >= task.end,
    )
    if not arrived:
        raise InputError(
            f"the truck is at {record['station'][-1]:.0f} m after {task.time_limit:.0f} s: "
            f"it does not reach {task.end:.0f} m"
        )
    # The last state lies beyond the end.
    record = Record(record.table[:-1])
    if len(record.table) < 2:
        raise Error(f"the drive from {task.start:g} to {task.end:g} m has no length")
    return record
