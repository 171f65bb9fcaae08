"""The telemetry of a drive: one row each 100 ms, written as CSV with units in the header.

Rows go to a file beside the wanted one, which takes its place when the drive ends, however it
ends: an interrupted drive keeps what it has, and an older table is never left half overwritten.
"""

from __future__ import annotations

import csv
import math
import os
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from iits_mj.closing import Closing
from iits_mj.errors import InputError
from iits_mj.simulation.frame import Frame
from iits_mj.units import RPM

if TYPE_CHECKING:
    from iits_mj.simulation.loop import Simulation

Value = float | int | str
_PRESSURES = ("front_left", "front_right", "rear_left", "rear_right", "trailer")

# Column name (with its unit) and where it comes from; SI but for engine speed and brake pressure,
# whose customary units stand in the header like all others.
COLUMNS: dict[str, Callable[[Frame], Value]] = {
    "time [s]": lambda f: f.time,
    "station [m]": lambda f: f.ego.station,
    "offset [m]": lambda f: f.ego.offset,
    "trailer_offset [m]": lambda f: f.ego.trailer_offset,
    "lane [-]": lambda f: f.lane,
    "x [m]": lambda f: f.ego.x,
    "y [m]": lambda f: f.ego.y,
    "z [m]": lambda f: f.ego.z,
    "yaw [rad]": lambda f: f.ego.yaw,
    "pitch [rad]": lambda f: f.ego.pitch,
    "roll [rad]": lambda f: f.ego.roll,
    "speed [m/s]": lambda f: f.ego.speed,
    "lateral_speed [m/s]": lambda f: f.ego.lateral_speed,
    "acceleration [m/s2]": lambda f: f.ego.acceleration,
    "lateral_acceleration [m/s2]": lambda f: f.ego.lateral_acceleration,
    "yaw_rate [rad/s]": lambda f: f.ego.yaw_rate,
    "trailer_yaw_rate [rad/s]": lambda f: f.ego.trailer_yaw_rate,
    "articulation [rad]": lambda f: f.ego.articulation,
    "steering_wheel_angle [rad]": lambda f: f.ego.steering_wheel_angle,
    "road_wheel_angle [rad]": lambda f: f.ego.road_wheel_angle,
    "gear [-]": lambda f: f.ego.gear,
    "shift_in_process [-]": lambda f: int(f.ego.shift_in_process),
    "engine_speed [rpm]": lambda f: f.ego.engine_speed / RPM,
    "engine_torque [N m]": lambda f: f.ego.engine_torque,
    "fuel_rate [kg/s]": lambda f: f.ego.fuel_rate,
    "fuel_used [kg]": lambda f: f.ego.fuel_used,
    **{
        f"brake_pressure_{name} [kPa]": lambda f, i=i: f.ego.brake_pressures[i] / 1e3  # type: ignore[misc]
        for i, name in enumerate(_PRESSURES)
    },
    "command_accelerator_pedal [-]": lambda f: f.command.accelerator_pedal,
    "command_xbr_demand [m/s2]": lambda f: f.command.xbr_demand,
    "command_xbr_mode [-]": lambda f: int(f.command.xbr_mode),
    "command_steering_wheel_angle [rad]": lambda f: f.command.steering_wheel_angle,
    "command_engine_brake [-]": lambda f: f.command.engine_brake,
    "command_retarder [-]": lambda f: f.command.retarder,
    "command_brake_pedal [-]": lambda f: f.command.brake_pedal,
    "command_xbr_ebi_mode [-]": lambda f: int(f.command.xbr_ebi_mode),
    "reference_speed [m/s]": lambda f: f.reference_speed,
    "speed_limit [m/s]": lambda f: f.speed_limit,
    "grade [-]": lambda f: f.grade,
    "curvature [1/m]": lambda f: f.curvature,
    "decision [-]": lambda f: int(f.decision),
    "plan_mode [-]": lambda f: f.trajectory.mode.value,
    "target_lane [-]": lambda f: f.trajectory.target_lane,
    "planned_offset [m]": lambda f: float(
        np.interp(f.time, f.trajectory.time, f.trajectory.offset)
    ),
    "planned_speed [m/s]": lambda f: float(
        np.interp(f.time, f.trajectory.time, f.trajectory.speed)
    ),
    "gap_ahead [m]": lambda f: f.gap_ahead,
    "gap_behind [m]": lambda f: f.gap_behind,
    "box_distance [m]": lambda f: f.box_distance,
    "vehicles [-]": lambda f: len(f.scene.vehicles),
    "lane_changes [-]": lambda f: f.lane_changes,
}


class Telemetry(Closing):
    """Observer that writes the table and keeps its columns for plots.

    Used as a context manager; on leaving it the table appears at `path`. Empty cells mean "no
    such vehicle" (a gap without anybody ahead).

    Raises:
      InputError: the table cannot be written, on construction.
    """

    period = 0.1

    def __init__(self, path: Path | None) -> None:
        self.path = path
        self._rows: list[list[Value]] = []
        self._file = None
        if path is None:
            return
        self._partial = path.with_name(f".{path.name}.partial")
        try:
            self._file = self._partial.open("w", newline="", encoding="utf-8")
        except OSError as error:
            raise InputError(
                f"telemetry {str(path)!r} cannot be written: {error.strerror}"
            ) from error
        self._writer = csv.writer(self._file, lineterminator="\n")
        self._writer.writerow(COLUMNS)

    def observe(self, simulation: Simulation, frame: Frame) -> None:
        """Adds one row."""
        del simulation
        row = [value(frame) for value in COLUMNS.values()]
        self._rows.append(row)
        if self._file is not None:
            self._writer.writerow([_cell(value) for value in row])

    def close(self) -> None:
        """Puts the finished table in its place; a second call does nothing."""
        if self._file is None or self.path is None:
            return
        self._file.close()
        self._file = None
        if self._rows:
            os.replace(self._partial, self.path)
        else:
            self._partial.unlink()

    def __len__(self) -> int:
        return len(self._rows)

    def column(self, name: str) -> NDArray[np.float64]:
        """One numeric column as an array of shape (rows,).

        Raises:
          InputError: there is no such column.
        """
        names = list(COLUMNS)
        if name not in names:
            raise InputError(f"telemetry has no column {name!r}; there are: {', '.join(names)}")
        index = names.index(name)
        return np.array([row[index] for row in self._rows], dtype=float)


def _cell(value: Value) -> str:
    if isinstance(value, float):
        return f"{value:.9g}" if math.isfinite(value) else ""
    return str(value)
