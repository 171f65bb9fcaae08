"""The telemetry of a drive, and the figures of its speed planner.

The telemetry is a CSV table with units in the header and one row every 100 ms. Rows go to a
temporary file that replaces the target when the drive ends: an interrupted drive keeps its rows,
and an older table is never half overwritten. The numbers for the plots go to an unnamed temporary
file after the first minutes, so that the memory does not grow with the drive.
"""

from __future__ import annotations

import contextlib
import csv
import io
import math
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from controllers.planning.speed_reference import CruiseReference
from controllers.stack import Stack
from iits_mj.core.context import Closing
from iits_mj.core.errors import InputError
from iits_mj.core.output_files import OutputFile
from iits_mj.core.units import RPM
from iits_mj.simulation.frame import DriveFrame
from iits_mj.simulation.lock_step import Driver, LockStep, Observer
from iits_mj.simulation.summary import counts_text

Value = float | int | str
TIME, STATION = "time [s]", "station [m]"
# Numbers are kept in memory up to this size, and in a file beyond it [bytes].
_IN_MEMORY = 2**20
_ROWS_READ = 4096
_PRESSURES = ("front_left", "front_right", "rear_left", "rear_right", "trailer")

# Column name with its unit, and its source. SI units, except the usual ones of engine speed and
# brake pressure.
COLUMNS: dict[str, Callable[[DriveFrame], Value]] = {
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
    "steering_wheel_torque [N m]": lambda f: f.steering_wheel_torque,
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

# Columns of a drive with emergency braking.
AEB_COLUMNS: dict[str, Callable[[DriveFrame], Value]] = {
    "aeb_state [-]": lambda f: f.emergency.state.value if f.emergency else "",
    "aeb_target [-]": lambda f: f.emergency.target if f.emergency else "",
    "aeb_time_to_collision [s]": lambda f: _of(f, "time_to_collision"),
    "aeb_required_deceleration [m/s2]": lambda f: _of(f, "required"),
    "aeb_demand [m/s2]": lambda f: _of(f, "demand"),
}


def _of(frame: DriveFrame, name: str) -> float:
    return math.nan if frame.emergency is None else float(getattr(frame.emergency, name))


class Telemetry(Closing, Observer):
    """Observer that writes the table and keeps its columns for plots; a context manager.

    The table appears at `path` when the context ends; with None there is no file. A cell without a
    finite value, such as the gap to a missing vehicle, is empty. Each coupling behind the first one
    adds a column: "articulation2 [rad]" and so on. A drive with emergency braking adds
    `AEB_COLUMNS`.

    Raises:
      InputError: the table cannot be written.
    """

    def __init__(self, path: Path | None) -> None:
        self.path = path
        self._columns = COLUMNS
        self._count = 0
        # Rows of float64 in full precision; text is nan.
        self._numbers = tempfile.SpooledTemporaryFile(max_size=_IN_MEMORY)  # noqa: SIM115
        self._file = None
        if path is None:
            return
        self._output = OutputFile(path, "telemetry")
        with self._output.errors():
            self._file = self._output.partial.open("w", newline="", encoding="utf-8")
        self._writer = csv.writer(self._file, lineterminator="\n")

    def observe(self, simulation: LockStep, frame: DriveFrame) -> None:
        """Adds one row."""
        del simulation
        if not self._count:
            self._begin(frame)
        row = [value(frame) for value in self._columns.values()]
        numbers = [math.nan if isinstance(value, str) else value for value in row]
        try:
            self._numbers.write(np.array(numbers, dtype=float).tobytes())
        except OSError as error:
            folder = tempfile.gettempdir()
            raise InputError(
                f"telemetry: the temporary file in {folder} cannot be written: {error.strerror}"
            ) from error
        self._count += 1
        if self._file is not None:
            with self._whole():
                self._writer.writerow([_cell(value) for value in row])

    def _begin(self, frame: DriveFrame) -> None:
        """Adds the columns of this truck, and writes the header."""
        self._columns = COLUMNS | {
            f"articulation{i + 2} [rad]": lambda f, i=i: f.ego.rear_articulations[i]
            for i in range(len(frame.ego.rear_articulations))
        }
        if frame.emergency is not None:
            self._columns |= AEB_COLUMNS
        if self._file is not None:
            with self._whole():
                self._writer.writerow(self._columns)

    @property
    def names(self) -> list[str]:
        """Names of the columns, with their units."""
        return list(self._columns)

    def close(self) -> None:
        """Moves the finished table to its path; a second call does nothing."""
        if self._file is None:
            return
        with self._whole():
            self._file.close()
        self._file = None
        if self._count:
            self._output.finish()
        else:
            self._output.abandon()

    @contextlib.contextmanager
    def _whole(self) -> Iterator[None]:
        """Removes the table if writing fails: it would not be complete."""
        try:
            with self._output.errors():
                yield
        except InputError:
            assert self._file is not None
            with contextlib.suppress(OSError):
                self._file.close()
            self._file = None
            self._output.abandon()
            raise

    def __len__(self) -> int:
        return self._count

    def column(self, name: str) -> NDArray[np.float64]:
        """Returns one column as an array of shape (rows,); text is nan.

        Raises:
          InputError: the column is unknown.
        """
        names = self.names
        if name not in names:
            raise InputError(f"telemetry has no column {name!r}; use one of: {', '.join(names)}")
        index, width = names.index(name), len(names)
        found = np.empty(self._count)
        self._numbers.seek(0)
        for first in range(0, self._count, _ROWS_READ):
            block = np.frombuffer(self._numbers.read(8 * width * _ROWS_READ))
            found[first : first + _ROWS_READ] = block.reshape(-1, width)[:, index]
        self._numbers.seek(0, io.SEEK_END)
        return found


def _cell(value: Value) -> str:
    if isinstance(value, float):
        return f"{value:.9g}" if math.isfinite(value) else ""
    return str(value)


def speed_rows(driver: Driver) -> list[tuple[str, str]]:
    """Returns names and values of the speed planner's figures; empty without a planner."""
    if not isinstance(driver, Stack):
        return []
    reference = driver.reference
    if isinstance(reference, CruiseReference):
        return [("speed planner", reference.reason)] if reference.reason else []
    report = _report(driver)
    if report is None:
        return []
    rows = [("speed plans", counts_text(report.plans))]
    if report.reasons:
        rows.append(("plans without optimum", counts_text(report.reasons)))
    if report.solve_time:
        p50, p95 = np.quantile(report.solve_time, [0.5, 0.95])
        rows.append(("time of a plan", f"{1e3 * p50:.1f} ms, 95 % within {1e3 * p95:.1f} ms"))
    if math.isfinite(report.lag):
        place = "behind" if report.lag >= 0.0 else "ahead of"
        rows.append(
            (
                "schedule",
                f"{abs(report.lag):.1f} s {place} it, made {report.schedules} x; a second is worth "
                f"{1e3 * report.price:.2f} g of fuel",
            )
        )
    return rows


def speed_object(driver: Driver) -> dict[str, Any]:
    """Returns the speed planner's figures for JSON, {"speed_planner": {...}}, or {}."""
    if isinstance(driver, Stack) and isinstance(driver.reference, CruiseReference):
        # A requested cruise has no reason; a cruise that replaces PCC has one.
        reason = driver.reference.reason
        return {"speed_planner": {"fallback": "cruise", "reason": reason}} if reason else {}
    report = _report(driver)
    if report is None:
        return {}
    solves = np.array(report.solve_time)
    p50, p95 = np.quantile(solves, [0.5, 0.95]) if solves.size else (math.nan, math.nan)
    figures = {
        "solve_p50_s": float(p50),
        "solve_p95_s": float(p95),
        "lag_s": report.lag,
        "price_kgps": report.price,
    }
    return {
        "speed_planner": {
            "plans": report.plans,
            "reasons": report.reasons,
            "schedules": report.schedules,
            **{n: v if math.isfinite(v) else None for n, v in figures.items()},
        }
    }


def _report(driver: Driver) -> Any:
    """Returns the report of PCC, None without PCC."""
    report = getattr(driver.reference, "report", None) if isinstance(driver, Stack) else None
    return None if report is None else report()
