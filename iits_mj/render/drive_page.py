"""The page of a drive: film, map, plots over time or station, figures, and how it was made."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from iits_mj.core.arrays import FloatArray
from iits_mj.core.results import Line, Panel
from iits_mj.render.interactive import MAP, Plot
from iits_mj.render.pages import Film, Page, Section, Stage
from iits_mj.road import Route
from iits_mj.simulation.conflicts import CONFLICT_HEADER, EVENT_HEADER, MEASURES, ConflictLog
from iits_mj.simulation.drive_plots import drive_figures
from iits_mj.simulation.drive_table import DriveTable
from iits_mj.simulation.telemetry import STATION, TIME

# A longer drive shows the least and greatest values of spans of equal length: 20 min in full.
ROWS = 12_000
_AROUND = 150.0  # of the road that the map shows before and behind the drive [m]
_STEP = 5.0  # between two points of an edge of the map [m]
_CHANGES = "lane_changes [-]"
Rows = Sequence[tuple[str, str]]


@dataclass(frozen=True, slots=True)
class DriveReport:
    """What the page of a drive shows.

    Attributes:
      title, lead: of the page; notes: remarks on the drive.
      drive: its columns; route: the road; lights: stations of the stop lines of lights [m].
      figures, origin, settings: names and values for tables.
      film: of the drive; replay: a page with the drive in 3-D; both lie beside the page.
      conflicts: with the vehicles of scripted events, None without events.
    """

    title: str
    lead: str
    notes: Sequence[str]
    drive: DriveTable
    route: Route
    lights: Sequence[float]
    figures: Rows
    origin: Rows
    settings: Rows
    film: Film | None = None
    replay: Path | None = None
    conflicts: ConflictLog | None = None

    def page(self) -> Page:
        """The page; a drive that ended before its second row has no plots."""
        sections = [
            Section(notes=self.notes),
            Section("Summary", header=("figure", "value"), rows=self.figures),
        ]
        stage = None
        if len(self.drive) > 1:
            drive = self.drive.thinned(ROWS)
            sections[1:1] = _plot_sections(self.drive, drive)
            road = road_lines(self.route, *_span(drive), self.lights)
            stage = Stage(
                drive_map({"truck": drive}, road),
                [clock_of(drive)],
                [self.film] if self.film else [],
                self.replay,
            )
            sections.append(_events(self.drive, self.lights))
            if self.conflicts is not None:
                sections[2:2] = _conflict_sections(self.conflicts)
        sections += [
            Section("How this drive was made", rows=self.origin),
            Section("Settings", header=("setting", "value"), rows=self.settings),
        ]
        return Page(self.title, self.lead, sections, stage=stage)


def _conflict_sections(log: ConflictLog) -> list[Section]:
    """The scripted events and how close the truck came to their road users."""
    events, conflicts = log.tables()
    plots = [Plot((panel,)) for panel in log.panels(TIME)]
    return [
        Section("Scripted events", header=EVENT_HEADER, rows=events, plots=plots),
        Section("Conflicts", sentences=[MEASURES], header=CONFLICT_HEADER, rows=conflicts),
    ]


def clock_of(drive: DriveTable) -> dict[str, FloatArray]:
    """The columns of a `Stage`'s clock; the station never decreases."""
    return {
        "time": drive.column(TIME),
        "station": np.maximum.accumulate(drive.column(STATION)),
        "x": drive.column("x [m]"),
        "y": drive.column("y [m]"),
        "yaw": drive.column("yaw [rad]"),
    }


def plots_of(time: Sequence[Panel], station: Sequence[Panel]) -> list[Plot]:
    """Plots over time, with the same lines over station as the second choice.

    Over station, a line stays where it is while the truck rolls back.
    """
    return [Plot(both) for both in zip(time, station, strict=True)]


def lane_changes(drive: DriveTable) -> list[int]:
    """Rows in which a lane change was complete; none without their number."""
    if _CHANGES not in drive:
        return []
    return [int(i) + 1 for i in np.flatnonzero(np.diff(drive.column(_CHANGES)) > 0.0)]


def drive_map(drives: dict[str, DriveTable], road: Sequence[Line] = ()) -> Plot:
    """A plan view of the paths of drives by their labels, with their lane changes."""
    lines = list(road)
    for number, (label, drive) in enumerate(drives.items()):
        x, y = drive.column("x [m]"), drive.column("y [m]")
        lines.append(Line(label, x, y, "second" if number else "simulation"))
    for label, drive in drives.items():
        rows = lane_changes(drive)
        if rows:
            name = "lane change" if len(drives) == 1 else f"lane change of {label}"
            lines.append(
                Line(name, drive.column("x [m]")[rows], drive.column("y [m]")[rows], "point")
            )
    return Plot((Panel("Map", *MAP, tuple(lines)),))


def road_lines(route: Route, low: float, high: float, lights: Sequence[float]) -> list[Line]:
    """Edges and lane marks of a road between two stations, and its lights, in a plan view."""
    station = np.arange(low, high + _STEP, _STEP)
    right, left = route.surface_edges(station)
    lines = [_joined(route, "edge of the road", station, [right, left], "edge")]
    most = max(route.lane_count(float(s)) for s in station[:: max(len(station) // 200, 1)])
    marks = []
    for i in range(1, most):
        kept = np.array([i < route.lane_count(float(s)) for s in station])
        marks.append(np.where(kept, route.boundary_offset(i, station), np.nan))
    if marks:
        lines.append(_joined(route, "lane mark", station, marks, "mark"))
    shown = np.array([s for s in lights if low <= s <= high])
    if len(shown):
        point = route.evaluate(shown, np.array([route.lane_offset(0, float(s)) for s in shown]))
        lines.append(Line("traffic light", np.asarray(point.x), np.asarray(point.y), "point"))
    return lines


def _joined(
    route: Route, label: str, station: FloatArray, offsets: Sequence[FloatArray], role: str
) -> Line:
    """Lines along a road as one line, with NaN between them."""
    gap = np.array([np.nan])
    points = [route.evaluate(station, offset) for offset in offsets]
    x = np.concatenate([part for p in points for part in (np.asarray(p.x), gap)])
    y = np.concatenate([part for p in points for part in (np.asarray(p.y), gap)])
    return Line(label, x, np.where(np.isnan(x), np.nan, y), role)


def _span(drive: DriveTable) -> tuple[float, float]:
    station = drive.column(STATION)
    return float(station.min()) - _AROUND, float(station.max()) + _AROUND


def _plot_sections(whole: DriveTable, drive: DriveTable) -> list[Section]:
    """The plots; the first section says how a long drive is shown."""
    along = DriveTable({**drive.columns, STATION: clock_of(drive)["station"]})
    time, station = drive_figures(drive, TIME), drive_figures(along, STATION)
    sections = [Section(name, plots=plots_of(time[name], station[name])) for name in time]
    if drive is not whole and sections:
        span = (whole.column(TIME)[-1] - whole.column(TIME)[0]) / (0.5 * len(drive))
        note = (
            f"The drive has {len(whole)} rows. The plots show the least and the greatest value of "
            f"every {span:.1f} s; telemetry.csv has all."
        )
        sections.insert(0, Section(notes=[note]))
    return sections


def _events(drive: DriveTable, lights: Sequence[float]) -> Section:
    """The places that the map marks, in words."""
    rows = []
    for row in lane_changes(drive):
        time, station = drive.column(TIME)[row], drive.column(STATION)[row]
        lane = int(drive.column("lane [-]")[row])
        rows.append((f"lane change, now in lane {lane}", f"{time:.1f} s", f"{station:.0f} m"))
    station = drive.column(STATION)
    for light in lights:
        if station.min() <= light <= station.max():
            when = float(np.interp(light, np.maximum.accumulate(station), drive.column(TIME)))
            rows.append(("traffic light", f"{when:.1f} s", f"{light:.0f} m"))
    rows.sort(key=lambda row: float(row[1].split()[0]))
    return Section("Places on the map", header=("event", "time", "station"), rows=rows)
