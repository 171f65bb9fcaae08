"""Designs of roads: alignment, grades, lanes, limits and structures, built as map records.

A design is read from a table such as `tools/highway.toml` or made in code. `build` turns it into
the records of an OpenDRIVE map.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from iits_mj.core.errors import InputError
from iits_mj.core.input_files import read_toml
from iits_mj.road.elements import (
    Lane,
    LaneSection,
    Link,
    OpenDriveMap,
    Road,
    RoadMark,
    RoadType,
    Signal,
    Structure,
)
from iits_mj.road.geometry import Arc, Geometry, Line, Spiral
from iits_mj.road.polynomials import Cubic, PiecewiseCubic, constant
from iits_mj.road.route import RoadMap, Route
from iits_mj.road.straight import linked

# Coordinates are rounded to a nanometer, so that every machine writes the same file.
_DIGITS = 9
# A section is evaluated a micrometer after its start.
_JUST_AFTER = 1e-6


@dataclass(frozen=True)
class ExtraLane:
    """An additional left lane over [start, end] that tapers over `taper` at both ends [m]."""

    start: float
    end: float
    taper: float


@dataclass(frozen=True)
class Design:
    """A one-way road in SI units; `tools/highway.toml` is an example of its table.

    Attributes:
      alignment: (length, curvature at start, at end, cross slope at start, at end) of each element.
      lanes: number of lanes of `lane_width` [m], between shoulders [m]; speed_limit: [m/s].
      start: x, y, z [m] and heading [rad] of the first point.
      grades: (station, grade after it, length of the parabola centered there).
      limits: (start, end, speed).
      structures: (kind, name, start, end).
    """

    name: str
    alignment: tuple[tuple[float, float, float, float, float], ...]
    lane_width: float = 4.0
    lanes: int = 1
    left_shoulder: float = 1.0
    right_shoulder: float = 2.5
    speed_limit: float = 25.0
    start: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    initial_grade: float = 0.0
    grades: tuple[tuple[float, float, float], ...] = ()
    road_ends: tuple[float, ...] = ()
    extra_lanes: tuple[ExtraLane, ...] = ()
    limits: tuple[tuple[float, float, float], ...] = ()
    structures: tuple[tuple[str, str, float, float], ...] = ()

    @property
    def length(self) -> float:
        """Length of the alignment [m]."""
        return math.fsum(element[0] for element in self.alignment)

    def limit_at(self, station: float) -> float:
        """Returns the speed limit at a station [m/s]."""
        slower = [speed for start, end, speed in self.limits if start <= station < end]
        return min([self.speed_limit, *slower])

    def route(self) -> Route:
        """Returns the road as a route.

        Raises:
          InputError: two changes of grade overlap.
        """
        return RoadMap(build(self), self.name).route()

    @classmethod
    def load(cls, path: str | Path) -> Design:
        """Reads a design table (TOML).

        Raises:
          InputError: the file cannot be read or an entry is missing or wrong.
        """
        table = read_toml(path, "design table")
        try:
            return cls._from_table(table)
        except KeyError as error:
            raise InputError(f"{path}: the entry {error} is missing in the design table") from error
        except (TypeError, AttributeError, ArithmeticError) as error:
            raise InputError(f"{path}: an entry of the design table is wrong: {error}") from error

    @classmethod
    def _from_table(cls, table: dict[str, Any]) -> Design:
        grade = initial = table["initial_grade"] / 100.0
        grades = []
        for entry in table["grades"]:
            change = abs(entry["grade"] / 100.0 - grade)
            grade = entry["grade"] / 100.0
            grades.append((entry["station"], grade, entry["K"] * 100.0 * change))
        origin = table["start"]
        same = ("name", "lane_width", "lanes", "left_shoulder", "right_shoulder", "speed_limit")
        return cls(
            **{key: table[key] for key in same},
            start=(origin["x"], origin["y"], origin["z"], origin["heading"]),
            initial_grade=initial,
            road_ends=tuple(table["road_ends"]),
            alignment=tuple(row for entry in table["alignment"] for row in _elements(entry)),
            grades=tuple(grades),
            extra_lanes=tuple(ExtraLane(**entry) for entry in table["extra_lanes"]),
            limits=tuple((e["start"], e["end"], e["speed"]) for e in table["limits"]),
            structures=tuple(
                (e["kind"], e["name"], e["start"], e["end"]) for e in table["structures"]
            ),
        )


def _elements(entry: dict[str, float]) -> Iterator[tuple[float, float, float, float, float]]:
    if "straight" in entry:
        yield entry["straight"], 0.0, 0.0, 0.0, 0.0
        return
    bend = 1.0 / entry["radius"]
    # The road leans into the bend: in a left bend its left side is lower.
    roll = -math.copysign(math.atan(entry["cross_slope"] / 100.0), bend)
    yield entry["clothoid"], 0.0, bend, 0.0, roll
    yield entry["arc"], bend, bend, roll, roll
    yield entry["clothoid"], bend, 0.0, roll, 0.0


def build(design: Design, tapered: bool = True) -> OpenDriveMap:
    """Returns the map records of a design: roads in a row, linked lane by lane.

    SUMO's lanes have constant widths, and netconvert displaces the neighbors of a tapered lane by
    up to 2 m. Without `tapered` the innermost lane always has its full width, and is open to
    traffic only where the extra lane is fully open: netconvert then displaces nothing.
    """
    ends = [*design.road_ends, design.length]
    starts = [0.0, *design.road_ends]
    plan = _plan(design)
    elevation = _elevation(design)
    roll = _superelevation(design)
    offset = _lane_offset(design) if tapered else constant(design.lane_width * (design.lanes + 0.5))
    sections = _lane_sections(design, tapered)
    roads = []
    for i, (start, end) in enumerate(zip(starts, ends, strict=True)):
        inside = [section for section in sections if start <= section.s < end]
        roads.append(
            Road(
                id=str(i + 1),
                name=design.name,
                length=_round(end - start),
                predecessor=Link("road", str(i), "end") if i else None,
                successor=Link("road", str(i + 2), "start") if i + 1 < len(ends) else None,
                types=(RoadType(0.0, "motorway", design.speed_limit),),
                geometries=tuple(_cut(plan, start, end)),
                elevations=_records(elevation, start, end),
                superelevations=_records(roll, start, end),
                lane_offsets=_records(offset, start, end),
                sections=tuple(replace(item, s=_round(item.s - start)) for item in inside),
                structures=tuple(_structures(design, start, end)),
                signals=tuple(_signs(design, start, end)),
            )
        )
    return OpenDriveMap(roads=tuple(roads), name=design.name)


def _round(value: float) -> float:
    return round(value, _DIGITS) + 0.0


def _records(profile: PiecewiseCubic, start: float, end: float) -> tuple[Cubic, ...]:
    # Coefficients keep 12 significant digits: 1 nm over the longest record.
    return tuple(
        Cubic(_round(r.start), *(float(f"{value:.12g}") for value in r[1:]))
        for r in profile.along(start, end, 1, 0.0).records
    )


def _plan(design: Design) -> list[Geometry]:
    x, y, _, heading = design.start
    s = 0.0
    records: list[Geometry] = []
    for length, bend, bend_end, _, _ in design.alignment:
        place = (s, x, y, heading, length)
        if bend != bend_end:
            records.append(Spiral(*place, bend, bend_end))
        else:
            records.append(Arc(*place, bend) if bend else Line(*place))
        end = records[-1].evaluate(length)
        x, y, heading = (_round(float(v)) for v in (end.x, end.y, end.heading))
        s = _round(s + length)
    return records


def _cut(records: list[Geometry], start: float, end: float) -> Iterator[Geometry]:
    for record in records:
        low, high = max(record.s, start), min(record.s + record.length, end)
        if high - low < 1e-6:
            continue
        ds, length = low - record.s, _round(high - low)
        at = record.evaluate(ds)
        x, y, heading = (_round(float(v)) for v in (at.x, at.y, at.heading))
        place = (_round(low - start), x, y, heading, length)
        if isinstance(record, Spiral):
            rate = (record.curvature_end - record.curvature_start) / record.length
            bend = record.curvature_start + rate * ds
            yield Spiral(*place, bend, bend + rate * length)
        else:
            yield Arc(*place, record.curvature) if isinstance(record, Arc) else Line(*place)


def _elevation(design: Design) -> PiecewiseCubic:
    """Tangents joined by parabolas: z'' = (g2 - g1)/L over a curve of length L."""
    height, grade, station = design.start[2], design.initial_grade, 0.0
    records = [Cubic(0.0, height, grade)]
    for center, following, length in design.grades:
        begin, end = center - 0.5 * length, center + 0.5 * length
        if begin < station:
            raise InputError(f"the vertical curves about {center:g} m overlap; lower its K")
        height += grade * (begin - station)
        records.append(Cubic(begin, height, grade, 0.5 * (following - grade) / length))
        height += 0.5 * (grade + following) * length
        grade, station = following, end
        records.append(Cubic(end, height, grade))
    return PiecewiseCubic(records)


def _superelevation(design: Design) -> PiecewiseCubic:
    records, s = [], 0.0
    for length, _, _, roll, roll_end in design.alignment:
        records.append(_ramp(s, length, roll, roll_end))
        s += length
    return PiecewiseCubic(records)


def _lane_offset(design: Design) -> PiecewiseCubic:
    """Offset 0 is the center of the rightmost lane; extra lanes open on the left."""
    width = design.lane_width
    base = (design.lanes - 0.5) * width
    records = [Cubic(0.0, base)]
    for extra in design.extra_lanes:
        records.append(_ramp(extra.start, extra.taper, base, base + width))
        records.append(Cubic(extra.start + extra.taper, base + width))
        records.append(_ramp(extra.end - extra.taper, extra.taper, base + width, base))
        records.append(Cubic(extra.end, base))
    return PiecewiseCubic(records)


def _structures(design: Design, start: float, end: float) -> Iterator[Structure]:
    for i, (kind, name, begin, finish) in enumerate(design.structures):
        low, high = max(begin, start), min(finish, end)
        if high > low:
            length = _round(high - low)
            yield Structure(kind, str(i + 1), _round(low - start), length, name)


def _signs(design: Design, start: float, end: float) -> Iterator[Signal]:
    """A speed sign (274 of the German catalogue) beside the right shoulder at every change."""
    places = sorted({0.0, *(p for low, high, _ in design.limits for p in (low, high))})
    t = -(0.5 * design.lane_width + design.right_shoulder + 0.75)
    for number, station in enumerate(places, 1):
        if start <= station < end:
            limit = float(round(design.limit_at(station) * 3.6))
            yield Signal(
                id=str(number), s=_round(station - start), t=t, kind="274", country="DE",
                name=f"limit {limit:.0f} km/h", orientation="+", value=limit, unit="km/h",
                z_offset=2.2, height=0.9, width=0.9,
            )  # fmt: skip


def _ramp(start: float, length: float, low: float, high: float) -> Cubic:
    """Returns a cubic from `low` to `high` that begins and ends level."""
    rise = high - low
    return Cubic(start, low, 0.0, 3.0 * rise / length**2, -2.0 * rise / length**3)


def _lane_sections(design: Design, tapered: bool) -> list[LaneSection]:
    """Returns the lane sections of the whole length, with lane links; s is the station."""
    places = {0.0, *design.road_ends}
    for start, end, _ in design.limits:
        places |= {start, end}
    for extra in design.extra_lanes:
        places |= {extra.start + extra.taper, extra.end - extra.taper}
        places |= {extra.start, extra.end} if tapered else set()
    ordered = sorted(places)
    make = _section if tapered else _level_section
    bare = [make(design, start) for start in ordered]
    return [
        linked(section, bare[i - 1] if i else None, bare[i + 1] if i + 1 < len(bare) else None)
        for i, section in enumerate(bare)
    ]


def _section(design: Design, start: float) -> LaneSection:
    middle = start + _JUST_AFTER
    width = design.lane_width
    extra = next((e for e in design.extra_lanes if e.start <= middle < e.end), None)
    count = design.lanes + (extra is not None)
    speeds = ((0.0, design.limit_at(middle)),)
    right = []
    for i in range(1, count + 1):
        shape = Cubic(0.0, width)
        if extra is not None and i == 1:
            if middle < extra.start + extra.taper:
                shape = _ramp(extra.start - start, extra.taper, 0.0, width)
            elif middle >= extra.end - extra.taper:
                shape = _ramp(extra.end - extra.taper - start, extra.taper, width, 0.0)
        if abs(shape.start) > _JUST_AFTER:
            # A section that begins inside a taper takes the taper's remaining cubic.
            shape = PiecewiseCubic([shape]).expanded_at(0.0)
        mark = RoadMark(0.0, "broken", 0.15) if i < count else RoadMark(0.0, "solid", 0.3)
        right.append(Lane(-i, "driving", (shape,), marks=(mark,), speeds=speeds))
    return _with_shoulders(design, start, right)


def _level_section(design: Design, start: float) -> LaneSection:
    """Lanes of constant width; the innermost is closed unless an extra lane is fully open."""
    middle = start + _JUST_AFTER
    is_open = any(e.start + e.taper <= middle < e.end - e.taper for e in design.extra_lanes)
    speeds = ((0.0, design.limit_at(middle)),)
    width = (Cubic(0.0, design.lane_width),)
    inner = Lane(-1, "driving" if is_open else "none", width, speeds=speeds)
    right = [Lane(-i, "driving", width, speeds=speeds) for i in range(2, design.lanes + 2)]
    return _with_shoulders(design, start, [inner, *right])


def _with_shoulders(design: Design, start: float, right: list[Lane]) -> LaneSection:
    return LaneSection(
        start,
        (
            Lane(1, "shoulder", (Cubic(0.0, design.left_shoulder),)),
            Lane(0, "none", marks=(RoadMark(0.0, "solid", 0.3),)),
            *right,
            Lane(-len(right) - 1, "shoulder", (Cubic(0.0, design.right_shoulder),)),
        ),
    )
