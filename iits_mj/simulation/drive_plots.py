"""Plots of a drive over time or station."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from iits_mj.core.arrays import FloatArray
from iits_mj.core.results import Line, Panel
from iits_mj.core.units import KMH
from iits_mj.simulation.drive_table import DriveTable
from iits_mj.simulation.telemetry import STATION

# Longer gaps are not drawn [m].
_GAP_SHOWN = 300.0
# Exactly zero throughout only without a towed unit, where the columns of towed units mean nothing.
_ARTICULATION = "articulation [rad]"
_TOWED = ("articulation", "trailer_offset", "brake_pressure_trailer")
_DEGREES = 180.0 / math.pi
_ACROSS = "Path across the road, positive to the left of the reference line"
# Label, columns of which the line is the mean, factor to the plot's unit, and role of each line.
_Lines = Sequence[tuple[str, tuple[str, ...], float, str]]
# Title, label of the y axis, and lines of each plot, by the name of the figure.
_FIGURES: dict[str, Sequence[tuple[str, str, _Lines]]] = {
    "Longitudinal": (
        (
            "Speed",
            "speed [km/h]",
            (
                ("reference", ("reference_speed [m/s]",), 1.0 / KMH, "reference"),
                ("planned", ("planned_speed [m/s]",), 1.0 / KMH, ""),
                ("truck", ("speed [m/s]",), 1.0 / KMH, "simulation"),
            ),
        ),
        (
            "Acceleration",
            "acceleration [m/s²]",
            (("motor vehicle", ("acceleration [m/s2]",), 1.0, ""),),
        ),
        ("Gear", "gear [-]", (("gear", ("gear [-]",), 1.0, ""),)),
        ("Engine speed", "speed [rpm]", (("engine", ("engine_speed [rpm]",), 1.0, ""),)),
        ("Engine torque", "torque [N m]", (("engine", ("engine_torque [N m]",), 1.0, ""),)),
        (
            "Brake pressure",
            "pressure [kPa]",
            (
                *(
                    (
                        label,
                        tuple(f"brake_pressure_{end}_{side} [kPa]" for side in ("left", "right")),
                        1.0,
                        "",
                    )
                    for label, end in (("steer axle", "front"), ("drive axles", "rear"))
                ),
                ("towed units", ("brake_pressure_trailer [kPa]",), 1.0, ""),
            ),
        ),
        ("Fuel used", "fuel [kg]", (("fuel", ("fuel_used [kg]",), 1.0, ""),)),
        ("Road grade", "grade [%]", (("grade", ("grade [-]",), 100.0, ""),)),
    ),
    "Lateral": (
        (
            _ACROSS,
            "offset [m]",
            (
                ("planned", ("planned_offset [m]",), 1.0, "reference"),
                ("steer axle", ("offset [m]",), 1.0, "simulation"),
                ("axles of the last unit", ("trailer_offset [m]",), 1.0, ""),
            ),
        ),
        (
            "Lateral acceleration",
            "acceleration [m/s²]",
            (("motor vehicle", ("lateral_acceleration [m/s2]",), 1.0, ""),),
        ),
        (
            "Articulation, unit ahead against unit behind",
            "angle [deg]",
            tuple(
                (f"coupling {i}", (f"articulation{'' if i == 1 else i} [rad]",), _DEGREES, "")
                for i in range(1, 6)
            ),
        ),
        (
            "Steering wheel",
            "angle [deg]",
            (
                ("command", ("command_steering_wheel_angle [rad]",), _DEGREES, "reference"),
                ("actual", ("steering_wheel_angle [rad]",), _DEGREES, "simulation"),
            ),
        ),
    ),
    "Traffic": (
        (
            "Lane, 0 being the right one",
            "lane [-]",
            (
                ("target", ("target_lane [-]",), 1.0, "reference"),
                ("truck", ("lane [-]",), 1.0, "simulation"),
            ),
        ),
        (
            "Distance to the traffic",
            "distance [m]",
            (
                ("bumper to bumper ahead", ("gap_ahead [m]",), 1.0, ""),
                ("nearest vehicle, box to box", ("box_distance [m]",), 1.0, ""),
            ),
        ),
    ),
}


def drive_figures(drive: DriveTable, axis: str = STATION) -> dict[str, list[Panel]]:
    """Returns the plots by figure: "Longitudinal", "Lateral" and "Traffic".

    A line without values, such as the plan in a drive by a log, and a plot without lines are left
    out; so are the lines of towed units without any. Gaps to missing or distant vehicles are not
    drawn.

    Args:
      drive: its columns.
      axis: name of the column of the x axis.
    """
    x = drive.column(axis)
    figures = {}
    for name, plots in _FIGURES.items():
        panels = [
            Panel(
                title,
                axis,
                y_label,
                tuple(
                    Line(label, x, y, role)
                    for label, columns, scale, role in lines
                    if np.isfinite(y := _values(drive, columns, scale)).any()
                ),
            )
            for title, y_label, lines in plots
        ]
        figures[name] = [panel for panel in panels if panel.lines]
    return {name: panels for name, panels in figures.items() if panels}


def _values(drive: DriveTable, columns: Sequence[str], scale: float) -> FloatArray:
    """The mean of the columns; NaN where there is nothing to draw."""
    if any(name not in drive for name in columns):
        return np.full(len(drive), np.nan)
    if columns[0].startswith(_TOWED) and not drive.column(_ARTICULATION).any():
        return np.full(len(drive), np.nan)
    values = np.asarray(scale * np.mean([drive.column(name) for name in columns], axis=0))
    if columns == ("target_lane [-]",):
        return np.where(values >= 0.0, values, np.nan)
    if columns in (("gap_ahead [m]",), ("box_distance [m]",)):
        return np.where(values < _GAP_SHOWN, values, np.nan)
    return values
