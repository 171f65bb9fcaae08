"""A road designer's table: alignment, grades, lanes, limits and structures."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from iits_mj.errors import InputError


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
