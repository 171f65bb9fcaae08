"""Situations seen from above: lanes, vehicles, and the truck with its trailer over time."""

from __future__ import annotations

import numpy as np

from controllers.swept_path import swept_path
from iits_mj.core.arrays import FloatArray
from iits_mj.messages import Trajectory
from iits_mj.parameters import TruckParameters
from iits_mj.results import Line, Panel
from iits_mj.road import Route
from iits_mj.validation.ideal_drive import IdealDrive


def seen_from_above(
    title: str,
    drive: IdealDrive,
    moments: tuple[float, ...],
    plan: Trajectory,
    reach: tuple[float, float],
) -> Panel:
    """A drive on a straight road in road coordinates: x is the station, y the offset.

    Args:
      title: of the panel.
      drive: what was driven.
      moments: times at which the bodies are drawn [s].
      plan: whose path is drawn as a line.
      reach: stations shown [m].
    """
    lines = _lanes(drive.route, reach)
    lines.append(Line("planned path", plan.station, plan.offset, "reference"))
    parameters = TruckParameters.load()
    path = np.array([[state.station, state.offset] for state in drive.states])
    swept = swept_path(parameters, path, 0.0)
    times = np.array([state.time for state in drive.states])
    for number, moment in enumerate(moments):
        row = int(np.argmin(np.abs(times - moment)))
        for vehicle in drive.scenes[row].vehicles:
            half, side = 0.5 * vehicle.length, 0.5 * vehicle.width
            center = np.array([vehicle.station, vehicle.offset])
            box = center + np.array([[half, side], [half, -side], [-half, -side], [-half, side]])
            lines.append(_closed(box, "", "vehicle"))
        last = number == len(moments) - 1
        trailer, tractor = swept.trailer_corners[row], swept.tractor_corners[row]
        lines.append(_closed(trailer, "trailer" if last else "", "trailer"))
        lines.append(_closed(tractor, "tractor" if last else "", "tractor"))
    when = ", ".join(f"{moment:g}" for moment in moments)
    title = f"{title}; at {when} s" if len(moments) > 1 else title
    inside = tuple(line for line in lines if _within(line, reach))
    return Panel(title, "station [m]", "offset [m]", inside)


def _lanes(route: Route, reach: tuple[float, float]) -> list[Line]:
    """Boundaries of the lanes."""
    station = np.linspace(*reach, 2)
    middle = 0.5 * (reach[0] + reach[1])
    boundaries = sorted(route.lane_boundaries_at(middle))
    outer = (boundaries[0], boundaries[-1])
    return [
        Line("", station, np.full(2, offset), "edge" if offset in outer else "mark")
        for offset in boundaries
    ]


def _closed(corners: FloatArray, label: str, role: str) -> Line:
    ring = np.vstack([corners, corners[:1]])
    return Line(label, ring[:, 0], ring[:, 1], role)


def _within(line: Line, reach: tuple[float, float]) -> bool:
    return bool(line.x.max() >= reach[0] and line.x.min() <= reach[1])
