"""The plots of a drive, as panels over the station of the steer axle."""

from __future__ import annotations

import dataclasses

import numpy as np

from iits_mj.results import Line, Panel
from iits_mj.simulation.telemetry import Telemetry

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
