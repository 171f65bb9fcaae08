"""The page that compares two drives, and the same as text."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from iits_mj.core.arrays import FloatArray
from iits_mj.core.results import Line, Panel, aligned
from iits_mj.render.drive_page import ROWS, clock_of, drive_map, lane_changes
from iits_mj.render.interactive import Plot, shown
from iits_mj.render.pages import Film, Page, Section, Stage
from iits_mj.simulation.compare import (
    Figure,
    Parting,
    Run,
    common_times,
    differing,
    figures,
    partings,
    resample,
)
from iits_mj.simulation.drive_plots import drive_figures
from iits_mj.simulation.drive_table import DriveTable
from iits_mj.simulation.telemetry import STATION, TIME

_STEP = 1.0  # between two stations of a difference [m]
_SHOWN = 8  # columns in the text that begin to differ


@dataclass(frozen=True)
class Comparison:
    """Two drives, A and B.

    Raises:
      InputError: they have no time in common.
    """

    a: Run
    b: Run

    @cached_property
    def partings(self) -> list[Parting]:
        """Where the columns begin to differ, the earliest first."""
        return partings(self.a, self.b)

    @cached_property
    def figures(self) -> list[Figure]:
        """The figures of both."""
        return figures(self.a, self.b)

    @cached_property
    def verdict(self) -> str:
        """Where the drives part first, in words."""
        rows = len(common_times(self.a, self.b))
        lengths = {len(self.a.drive), len(self.b.drive)}
        if not self.partings:
            longer = "" if lengths == {rows} else "; one drive is longer"
            exact = "equal" if self.a.rounded == self.b.rounded else "equal but for rounding"
            return f"All columns that both have are {exact} in {rows} rows{longer}."
        first = self.partings[0]
        others = sum(p.time == first.time for p in self.partings) - 1
        more = f" and {others} more columns" if others > 1 else " and one more" if others else ""
        return (
            f"They diverge at {first.time:.1f} s, station {first.station:.1f} m, in "
            f"{first.name}{more}; {len(self.partings)} columns differ."
        )

    def configuration(self) -> list[tuple[str, str, str]]:
        """Settings, versions and truck that differ: name and both values."""
        if not (self.a.settings or self.a.origin) or not (self.b.settings or self.b.origin):
            return []
        rows = differing(self.a.settings, self.b.settings)
        if self.a.rounded == self.b.rounded:
            known = dict.fromkeys(self.a.settings)
            rows += [r for r in differing(self.a.origin, self.b.origin) if r[0] not in known]
        return rows

    def unknown(self) -> list[str]:
        """Says which drive does not tell its configuration."""
        return [
            f"{label} has no stored settings, so the configurations are not compared."
            for label, run in (("A", self.a), ("B", self.b))
            if not (run.settings or run.origin)
        ]

    def to_text(self) -> str:
        """Verdict, figures, configuration and the first differences as plain text."""
        blocks = [f"A: {self.a.name}\nB: {self.b.name}\n{self.verdict}"]
        blocks += self.unknown()
        blocks.append(aligned([("", "A", "B", "B less A"), *(f.cells() for f in self.figures)]))
        if rows := self.configuration():
            blocks.append(aligned([("differs", "A", "B"), *rows]))
        if self.partings:
            table = [_PARTING_HEADER, *map(_parting_cells, self.partings[:_SHOWN])]
            rest = len(self.partings) - _SHOWN
            blocks.append(aligned(table) + (f"\nand {rest} more columns" if rest > 0 else ""))
        return "\n\n".join(blocks)

    def as_dict(self) -> dict[str, Any]:
        """The comparison for JSON; a value that is not known is null."""

        def number(value: float) -> float | None:
            return value if math.isfinite(value) else None

        return {
            "a": self.a.name,
            "b": self.b.name,
            "equal": not self.partings,
            "configuration": {
                name: [first, second] for name, first, second in self.configuration()
            },
            "figures": {
                f"{f.name} [{f.unit or '-'}]": [number(f.first), number(f.second)]
                for f in self.figures
            },
            "partings": [
                {
                    "column": p.name,
                    "time_s": p.time,
                    "station_m": p.station,
                    "a": number(p.first),
                    "b": number(p.second),
                    "visible_from_s": number(p.visible),
                    "greatest_difference": number(p.greatest),
                    "at_s": number(p.at),
                }
                for p in self.partings
            ],
        }

    def page(self, version: str) -> Page:
        """The page with curves and differences over time and station."""
        a, b = self.a.drive.thinned(ROWS), self.b.drive.thinned(ROWS)
        films = [Film(f"Film of {n}", r.film) for n, r in (("A", self.a), ("B", self.b)) if r.film]
        stage = Stage(
            drive_map({"A": a, "B": b}),
            [clock_of(a), clock_of(b)],
            films if len(films) == 2 else [],
        )
        header = ("", "A", "B", "B less A")
        sections = [
            Section(notes=[self.verdict, *self.unknown()]),
            Section("Figures", header=header, rows=[figure.cells() for figure in self.figures]),
            Section("What differs in how they were made", (), (), header[:3], self.configuration()),
            Section("Lane changes", header=("", "A", "B"), rows=self._lane_changes()),
            Section("Time over the way", plots=self._delay()),
            *self._curves(a, b),
            Section(
                "Where they part",
                sentences=[
                    "The first row in which a column differs, by how much it does at most, and "
                    "when the difference exceeds 1 % of the range of A."
                ],
                header=_PARTING_HEADER,
                rows=[_parting_cells(parting) for parting in self.partings],
            )
            if self.partings
            else Section(),
            Section("How they were made", (), (), header[:3], self._origins()),
        ]
        lead = f"A: `{self.a.name}`, B: `{self.b.name}`; iits-mj {version}"
        return Page("Two drives compared", lead, sections, stage=stage)

    def _origins(self) -> list[tuple[str, str, str]]:
        """Everything stored about how the drives were made: name and both values."""
        names = dict.fromkeys((*self.a.origin, *self.b.origin))
        return [
            (name, self.a.origin.get(name, "not stored"), self.b.origin.get(name, "not stored"))
            for name in names
        ]

    def _lane_changes(self) -> list[tuple[str, str, str]]:
        def places(run: Run) -> list[str]:
            time, station = run.drive.column(TIME), run.drive.column(STATION)
            return [f"{time[i]:.1f} s, {station[i]:.0f} m" for i in lane_changes(run.drive)]

        a, b = places(self.a), places(self.b)
        count = max(len(a), len(b))
        pad = [["none"] * (count - len(each)) for each in (a, b)]
        pairs = zip(a + pad[0], b + pad[1], strict=True)
        return [(f"lane change {i}", *pair) for i, pair in enumerate(pairs, 1)]

    def _stations(self) -> FloatArray:
        """Stations that both drives pass, shape (n,) [m]; empty without any."""
        ways = (self.a.way(), self.b.way())
        low, high = max(way[0] for way in ways), min(way[-1] for way in ways)
        return np.arange(math.ceil(low), high, _STEP)

    def _delay(self) -> list[Plot]:
        at = self._stations()
        if len(at) < 3:
            return []
        first, second = (_over_way(run, run.drive.column(TIME), at) for run in (self.a, self.b))
        delay = DriveTable({TIME: at, STATION: at, "delay": second - first}).thinned(ROWS)
        line = Line("B later than A", delay.column(STATION), delay.column("delay"), "difference")
        return [Plot((Panel("Time at the same station", STATION, "time [s]", (line,)),))]

    def _curves(self, a: DriveTable, b: DriveTable) -> list[Section]:
        """Both drives, and below it their difference, for every line that differs."""
        time = self._differences(common_times(self.a, self.b), TIME)
        station = self._differences(self._stations(), STATION)
        drawn = [
            {axis: drive_figures(_along(drive), axis) for axis in (TIME, STATION)}
            for drive in (a, b)
        ]
        sections, equal = [], []
        for name in drawn[0][TIME]:
            plots: list[Plot] = []
            for title, label in _pairs(drawn, name):
                key = f"{title}: {label}"
                if key not in time or key not in station:
                    continue
                values = time[key].column(key), station[key].column(key)
                if not any((np.abs(each) > 0.0).any() for each in values):
                    equal.append(key)
                    continue
                plots += _both(drawn, name, title, label, (time[key], station[key]))
            sections.append(Section(name, plots=plots))
        if equal:
            sections.append(Section("Equal in both", sentences=["; ".join(equal) + "."]))
        return sections

    def _differences(self, at: FloatArray, axis: str) -> dict[str, DriveTable]:
        """B less A of every line at times or stations, by title and label of the line."""
        if len(at) < 3:
            return {}
        lines: list[dict[str, FloatArray]] = []
        for run in (self.a, self.b):
            found = {}
            for panels in drive_figures(run.drive, axis).values():
                for panel in panels:
                    for line in panel.lines:
                        y = np.asarray(line.y, dtype=float)
                        found[f"{panel.title}: {line.label}"] = (
                            resample(run.drive.column(TIME), y, at)
                            if axis == TIME
                            else _over_way(run, y, at)
                        )
            lines.append(found)
        keys = [key for key in lines[0] if key in lines[1]]
        made = {key: {TIME: at, STATION: at, key: lines[1][key] - lines[0][key]} for key in keys}
        return {key: DriveTable(columns).thinned(ROWS) for key, columns in made.items()}


_PARTING_HEADER = (
    *("column", "from [s]", "station [m]", "A", "B"),
    *("over 1 % from [s]", "greatest B less A", "at [s]"),
)


def _parting_cells(parting: Parting) -> tuple[str, ...]:
    def seconds(value: float) -> str:
        return f"{value:.1f}" if math.isfinite(value) else "never"

    def value(number: float) -> str:
        return f"{number:.7g}" if math.isfinite(number) else "none"

    return (
        parting.name,
        seconds(parting.time),
        f"{parting.station:.1f}",
        value(parting.first),
        value(parting.second),
        seconds(parting.visible),
        shown(parting.greatest) if math.isfinite(parting.greatest) else "none",
        seconds(parting.at),
    )


def _along(drive: DriveTable) -> DriveTable:
    """The drive with a station that never decreases."""
    return DriveTable({**drive.columns, STATION: clock_of(drive)["station"]})


def _over_way(run: Run, y: FloatArray, at: FloatArray) -> FloatArray:
    """Values at stations; where the truck stood, the last ones there."""
    way = run.way()
    last = np.append(np.diff(way) > 0.0, True)
    return resample(way[last], y[last], at)


def _pairs(drawn: Sequence[dict[str, dict[str, list[Panel]]]], name: str) -> list[tuple[str, str]]:
    """Title and label of each line that both drives have; references are left out."""
    labels = [
        [
            (panel.title, line.label)
            for panel in each[TIME].get(name, [])
            for line in panel.lines
            if line.role != "reference"
        ]
        for each in drawn
    ]
    return [pair for pair in labels[0] if pair in labels[1]]


def _both(
    drawn: Sequence[dict[str, dict[str, list[Panel]]]],
    name: str,
    title: str,
    label: str,
    differences: Sequence[DriveTable],
) -> list[Plot]:
    """A plot with a line of both drives, and one with the difference, over time and station."""
    curves, below = [], []
    heading = title if label in ("gear", "engine", "fuel", "grade") else f"{title}: {label}"
    for axis, difference in zip((TIME, STATION), differences, strict=True):
        lines = []
        for letter, each, role in zip("AB", drawn, ("simulation", "second"), strict=True):
            panel = next(p for p in each[axis][name] if p.title == title)
            line = next(line for line in panel.lines if line.label == label)
            lines.append(Line(letter, line.x, line.y, role))
        curves.append(Panel(heading, axis, panel.y_label, tuple(lines)))
        line = Line(
            "B less A",
            difference.column(axis),
            difference.column(f"{title}: {label}"),
            "difference",
        )
        below.append(Panel(f"{heading}, difference", axis, panel.y_label, (line,)))
    return [Plot(tuple(curves)), Plot(tuple(below))]
