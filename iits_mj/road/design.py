"""A road designer's table: alignment, grades, lanes, limits and structures."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from iits_mj.core.errors import InputError
from iits_mj.road.elements import Lane, LaneSection, RoadMark
from iits_mj.road.polynomials import Cubic, PiecewiseCubic

# --- Lane sections of a designed road: further lanes that open and close, limits, paint, links ---

# A section is judged a micrometre after its start.
_JUST_AFTER = 1e-6


def ramp(start: float, length: float, low: float, high: float) -> Cubic:
    """A cubic from `low` to `high` that begins and ends level."""
    rise = high - low
    return Cubic(start, low, 0.0, 3.0 * rise / length**2, -2.0 * rise / length**3)


def limit_at(design: Design, station: float) -> float:
    """Speed limit at a station [m/s]."""
    slower = [speed for start, end, speed in design.limits if start <= station < end]
    return min([design.speed_limit, *slower])


def lane_sections(design: Design, tapered: bool) -> list[LaneSection]:
    """Lane sections over the whole length, with lane links; s is the station."""
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
        _link(section, bare[i - 1] if i else None, bare[i + 1] if i + 1 < len(bare) else None)
        for i, section in enumerate(bare)
    ]


def _section(design: Design, start: float) -> LaneSection:
    middle = start + _JUST_AFTER
    width = design.lane_width
    extra = next((e for e in design.extra_lanes if e.start <= middle < e.end), None)
    count = design.lanes + (extra is not None)
    speeds = ((0.0, limit_at(design, middle)),)
    right = []
    for i in range(1, count + 1):
        shape = Cubic(0.0, width)
        if extra is not None and i == 1:
            if middle < extra.start + extra.taper:
                shape = ramp(extra.start - start, extra.taper, 0.0, width)
            elif middle >= extra.end - extra.taper:
                shape = ramp(extra.end - extra.taper - start, extra.taper, width, 0.0)
        if abs(shape.start) > _JUST_AFTER:
            # A section that begins inside a taper takes the taper's remaining cubic.
            shape = PiecewiseCubic([shape]).expanded_at(0.0)
        mark = RoadMark(0.0, "broken", 0.15) if i < count else RoadMark(0.0, "solid", 0.3)
        right.append(Lane(-i, "driving", (shape,), marks=(mark,), speeds=speeds))
    return _with_shoulders(design, start, right)


def _level_section(design: Design, start: float) -> LaneSection:
    """Lanes of one width only; the innermost is closed unless a further lane is fully open."""
    middle = start + _JUST_AFTER
    is_open = any(e.start + e.taper <= middle < e.end - e.taper for e in design.extra_lanes)
    speeds = ((0.0, limit_at(design, middle)),)
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


def _link(
    section: LaneSection, before: LaneSection | None, after: LaneSection | None
) -> LaneSection:
    """Right lanes are matched from the outside, because lanes open and close on the inside."""
    count = len(section.side(1))

    def partner(lane: Lane, other: LaneSection | None) -> int | None:
        if other is None or lane.id == 0:
            return None
        if lane.id > 0:
            return lane.id
        shifted = lane.id - (len(other.side(1)) - count)
        return shifted if shifted < 0 else None

    return replace(
        section,
        lanes=tuple(
            replace(lane, predecessor=partner(lane, before), successor=partner(lane, after))
            for lane in section.lanes
        ),
    )


# --- A road designer's table: alignment, grades, lanes, limits, structures; see `highway.toml` ---


@dataclass(frozen=True)
class ExtraLane:
    """A further left lane over [start, end], opening and closing over `taper` at both ends [m]."""

    start: float
    end: float
    taper: float


@dataclass(frozen=True)
class Design:
    """A one-way road; see `tools/highway.toml` for the table it is read from. SI units.

    Attributes:
      alignment: (length, curvature at start, at end, cross slope at start, at end) of each element.
      grades: (station, grade after it, length of the parabola centred there).
      limits: (start, end, speed).
      structures: (kind, name, start, end).
    """

    name: str
    start: tuple[float, float, float, float]
    lane_width: float
    lanes: int
    left_shoulder: float
    right_shoulder: float
    speed_limit: float
    initial_grade: float
    road_ends: tuple[float, ...]
    alignment: tuple[tuple[float, float, float, float, float], ...]
    grades: tuple[tuple[float, float, float], ...]
    extra_lanes: tuple[ExtraLane, ...]
    limits: tuple[tuple[float, float, float], ...]
    structures: tuple[tuple[str, str, float, float], ...]

    @property
    def length(self) -> float:
        """Length of the whole alignment [m]."""
        return math.fsum(element[0] for element in self.alignment)

    @classmethod
    def load(cls, path: str | Path) -> Design:
        """Reads a design table (TOML).

        Raises:
          InputError: the file cannot be read or an entry is missing or wrong.
        """
        try:
            table = tomllib.loads(Path(path).read_text(encoding="utf-8"))
            return cls._from_table(table)
        except (OSError, tomllib.TOMLDecodeError) as error:
            raise InputError(f"{path}: is not a readable design table: {error}") from error
        except KeyError as error:
            raise InputError(f"{path}: the entry {error} is missing in the design table") from error

    @classmethod
    def _from_table(cls, table: dict[str, Any]) -> Design:
        grade = initial = table["initial_grade"] / 100.0
        grades = []
        for entry in table["grades"]:
            change = abs(entry["grade"] / 100.0 - grade)
            grade = entry["grade"] / 100.0
            grades.append((entry["station"], grade, entry["K"] * 100.0 * change))
        origin = table["start"]
        return cls(
            name=table["name"],
            start=(origin["x"], origin["y"], origin["z"], origin["heading"]),
            lane_width=table["lane_width"],
            lanes=table["lanes"],
            left_shoulder=table["left_shoulder"],
            right_shoulder=table["right_shoulder"],
            speed_limit=table["speed_limit"],
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
    # The road leans into the bend: in a left bend its left side is low.
    roll = -math.copysign(math.atan(entry["cross_slope"] / 100.0), bend)
    yield entry["clothoid"], 0.0, bend, 0.0, roll
    yield entry["arc"], bend, bend, roll, roll
    yield entry["clothoid"], bend, 0.0, roll, 0.0
