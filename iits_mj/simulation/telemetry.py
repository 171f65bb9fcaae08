"""The telemetry of a drive: one row each 100 ms, written as CSV with units in the header.

Rows go to a file beside the wanted one, which takes its place when the drive ends, however it
ends: an interrupted drive keeps what it has, and an older table is never left half overwritten.
"""

from __future__ import annotations

import csv
import dataclasses
import math
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from controllers.planning.speed_reference import CruiseReference
from controllers.stack import Stack
from iits_mj.core.context import Closing
from iits_mj.core.errors import InputError
from iits_mj.core.results import Line, Panel
from iits_mj.core.units import RPM
from iits_mj.simulation.frame import Frame
from iits_mj.simulation.lock_step import Driver, LockStep, Observer
from iits_mj.simulation.summary import counts_text

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


class Telemetry(Closing, Observer):
    """Observer that writes the table and keeps its columns for plots.

    Used as a context manager; on leaving it the table appears at `path`. Empty cells mean "no
    such vehicle" (a gap without anybody ahead).

    Raises:
      InputError: the table cannot be written, on construction.
    """

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

    def observe(self, simulation: LockStep, frame: Frame) -> None:
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


# --- The plots of a drive, as panels over the station of the steer axle ---

KMH = 3.6
STATION = "station [m]"


def drive_figures(telemetry: Telemetry) -> dict[str, list[Panel]]:
    """Figures by name: "longitudinal", "lateral" and "traffic".

    A quantity that the drive did not have, as the plan of a drive by a log, is not drawn.
    """
    figures = {
        "longitudinal": longitudinal(telemetry),
        "lateral": lateral(telemetry),
        "traffic": traffic(telemetry),
    }
    return {name: _known(panels) for name, panels in figures.items()}


def _known(panels: list[Panel]) -> list[Panel]:
    """The panels with those lines that have a value, without those that have none."""
    found = []
    for panel in panels:
        lines = tuple(line for line in panel.lines if np.isfinite(line.y).any())
        if lines:
            found.append(dataclasses.replace(panel, lines=lines))
    return found


def longitudinal(telemetry: Telemetry) -> list[Panel]:
    """Speed, gear, brake pressure and grade over station."""
    column = telemetry.column
    station = column(STATION)

    def line(label: str, name: str, scale: float = 1.0, role: str = "") -> Line:
        return Line(label, station, scale * column(name), role)

    front = 0.5 * (
        column("brake_pressure_front_left [kPa]") + column("brake_pressure_front_right [kPa]")
    )
    drive = 0.5 * (
        column("brake_pressure_rear_left [kPa]") + column("brake_pressure_rear_right [kPa]")
    )
    return [
        Panel(
            "Speed",
            STATION,
            "speed [km/h]",
            (
                line("reference", "reference_speed [m/s]", KMH, "reference"),
                line("planned", "planned_speed [m/s]", KMH),
                line("truck", "speed [m/s]", KMH, "simulation"),
            ),
        ),
        Panel("Gear", STATION, "gear [-]", (line("gear", "gear [-]"),)),
        Panel(
            "Brake pressure",
            STATION,
            "pressure [kPa]",
            (
                Line("steer axle", station, front),
                Line("drive axles", station, drive),
                line("trailer", "brake_pressure_trailer [kPa]"),
            ),
        ),
        Panel("Road grade", STATION, "grade [%]", (line("grade", "grade [-]", 100.0),)),
    ]


def lateral(telemetry: Telemetry) -> list[Panel]:
    """Path across the road, lateral acceleration, articulation and steering over station."""
    column = telemetry.column
    station = column(STATION)
    degrees = 180.0 / np.pi
    return [
        Panel(
            "Path across the road, positive to the left of the reference line",
            STATION,
            "offset [m]",
            (
                Line("planned", station, column("planned_offset [m]"), "reference"),
                Line("steer axle", station, column("offset [m]"), "simulation"),
                Line("trailer axles", station, column("trailer_offset [m]")),
            ),
        ),
        Panel(
            "Lateral acceleration of the tractor",
            STATION,
            "acceleration [m/s²]",
            (Line("tractor", station, column("lateral_acceleration [m/s2]")),),
        ),
        Panel(
            "Articulation, tractor against semitrailer",
            STATION,
            "angle [deg]",
            (Line("articulation", station, degrees * column("articulation [rad]")),),
        ),
        Panel(
            "Steering wheel",
            STATION,
            "angle [deg]",
            (
                Line(
                    "command",
                    station,
                    degrees * column("command_steering_wheel_angle [rad]"),
                    "reference",
                ),
                Line(
                    "actual", station, degrees * column("steering_wheel_angle [rad]"), "simulation"
                ),
            ),
        ),
    ]


def traffic(telemetry: Telemetry) -> list[Panel]:
    """Lane and gaps over station; a gap is drawn only where there is a vehicle."""
    column = telemetry.column
    station = column(STATION)
    gap = column("gap_ahead [m]")
    box = column("box_distance [m]")
    target = column("target_lane [-]")
    return [
        Panel(
            "Lane, 0 being the right one",
            STATION,
            "lane [-]",
            (
                Line("target", station, np.where(target >= 0.0, target, np.nan), "reference"),
                Line("truck", station, column("lane [-]"), "simulation"),
            ),
        ),
        Panel(
            "Distance to the traffic",
            STATION,
            "distance [m]",
            (
                Line("bumper to bumper ahead", station, np.where(gap < 300.0, gap, np.nan)),
                Line("nearest vehicle, box to box", station, np.where(box < 300.0, box, np.nan)),
            ),
        ),
    ]


# --- What the speed planner did in a drive, for its summary ---


def speed_rows(driver: Driver) -> list[tuple[str, str]]:
    """Names and values for tables that people read; empty where no speed was planned."""
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
    """The same for JSON, {"speed_planner": {...}}; empty where none was to be planned."""
    if isinstance(driver, Stack) and isinstance(driver.reference, CruiseReference):
        # A cruise that was asked for needs no reason; one that PCC fell back to does.
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
    """The report of PCC, None where somebody else says how fast to go."""
    report = getattr(driver.reference, "report", None) if isinstance(driver, Stack) else None
    return None if report is None else report()
