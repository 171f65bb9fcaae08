"""The road of the speed planner: a uniform grid of stations with height and speed limit."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from iits_mj.core.arrays import FloatArray
from iits_mj.core.errors import InputError
from iits_mj.core.tables import read_columns

if TYPE_CHECKING:
    from iits_mj.road import Route

_GRADE_MAX = 0.25
_UNEVEN = 1e-6  # relative difference of steps
_HEIGHT_COLUMNS = (("s_m", "s", "station_m", "station"), ("z_m", "z", "height_m", "height"))


@dataclass(frozen=True)
class RoadProfile:
    """A road on a uniform grid of n intervals.

    Attributes:
      station: of the nodes, shape (n + 1,) [m].
      height: of the nodes, shape (n + 1,) [m].
      v_limit: greatest legal and curve-safe speed at the nodes, shape (n + 1,) [m/s]; may be inf.
      name: for reports.
    """

    station: FloatArray
    height: FloatArray
    v_limit: FloatArray
    name: str = ""

    def __post_init__(self) -> None:
        n = self.station.size
        if n < 5 or self.height.shape != (n,) or self.v_limit.shape != (n,):
            raise InputError(f"road profile {self.name!r} has {n} nodes: at least 5 are needed")
        if not (np.isfinite(self.station).all() and np.isfinite(self.height).all()):
            raise InputError(f"road profile {self.name!r} holds numbers that are not finite")
        steps = np.diff(self.station)
        if not (steps[0] > 0.0 and np.abs(steps - steps[0]).max() <= _UNEVEN * steps[0]):
            raise InputError(f"road profile {self.name!r}: stations must rise evenly")
        steep = np.abs(self.grade)
        if steep.max() > _GRADE_MAX:
            where = self.station[int(steep.argmax())]
            raise InputError(
                f"road profile {self.name!r}: grade {100 * steep.max():.1f} % at {where:.0f} m; "
                f"at most {100 * _GRADE_MAX:g} % is allowed"
            )
        if not self.v_limit.min() > 0.0:
            raise InputError(f"road profile {self.name!r}: speed limits must be above 0")

    @cached_property
    def step(self) -> float:
        """Length of an interval [m]."""
        return float(self.station[1] - self.station[0])

    @property
    def length(self) -> float:
        """Distance from the first to the last node [m]."""
        return float(self.station[-1] - self.station[0])

    @property
    def intervals(self) -> int:
        """Number of intervals."""
        return self.station.size - 1

    @cached_property
    def grade(self) -> FloatArray:
        """Mean grade dz/ds of the intervals, shape (n,)."""
        return np.diff(self.height) / np.diff(self.station)

    def part(self, first: int, intervals: int) -> RoadProfile:
        """Returns the road of some intervals from a node on."""
        nodes = slice(first, first + intervals + 1)
        return self._with(
            station=self.station[nodes],
            height=self.height[nodes],
            v_limit=self.v_limit[nodes],
            grade=self.grade[first : first + intervals],
        )

    def below(self, top: float | FloatArray) -> RoadProfile:
        """Returns the road with the lower of its limits and others above 0 [m/s]."""
        return self._with(v_limit=np.minimum(self.v_limit, top))

    def resampled(
        self, station: FloatArray, height: FloatArray, v_limit: FloatArray
    ) -> RoadProfile:
        """Returns the road at the nodes of another grid, which are not checked again."""
        grade = np.diff(height) / np.diff(station)
        step = float(station[1] - station[0])
        return self._with(station=station, height=height, v_limit=v_limit, grade=grade, step=step)

    def _with(self, **attributes: FloatArray | float) -> RoadProfile:
        """Returns a copy with other attributes, which are known to be valid."""
        road = object.__new__(RoadProfile)
        road.__dict__.update(self.__dict__, **attributes)
        return road

    @classmethod
    def from_heights(
        cls,
        station: FloatArray,
        height: FloatArray,
        step: float = 50.0,
        length: float | None = None,
        name: str = "",
        start: float | None = None,
    ) -> RoadProfile:
        """Returns a profile from rising stations and heights, (n,) [m], without speed limits.

        Args:
          station: horizontal, as on a map; along a road of 5 % they would be 0.1 % longer.
          height: at the stations.
          step: of the grid.
          length: of the profile; default: to the last station.
          name: for reports.
          start: of the profile; default: the first station.

        Raises:
          InputError: stations do not rise, numbers are not finite, or the road is too short.
        """
        s, z = np.asarray(station, dtype=float), np.asarray(height, dtype=float)
        if s.ndim != 1 or s.shape != z.shape or s.size < 2:
            raise InputError(f"road profile {name!r}: two columns of equal length are needed")
        if not (np.isfinite(s).all() and np.isfinite(z).all()):
            raise InputError(f"road profile {name!r} holds numbers that are not finite")
        if (np.diff(s) <= 0.0).any():
            raise InputError(f"road profile {name!r}: stations must rise")
        first = float(s[0]) if start is None else start
        if first < s[0]:
            raise InputError(f"start {first:g} m is before {name!r}, which begins at {s[0]:g} m")
        grid = _grid(first, float(s[-1]), step, length, name)
        return cls(grid, np.interp(grid, s, z), np.full(grid.size, np.inf), name)

    @classmethod
    def from_csv(
        cls,
        path: str | Path,
        step: float = 50.0,
        length: float | None = None,
        start: float | None = None,
    ) -> RoadProfile:
        """Returns a profile from a CSV file with columns station (s_m) and height (z_m).

        Raises:
          InputError: the file cannot be read, lacks columns, or has fewer than 5 intervals.
        """
        file = Path(path)
        station, height = read_columns(file, "road profile", _HEIGHT_COLUMNS)
        return cls.from_heights(station, height, step, length, file.name, start)

    @classmethod
    def from_route(
        cls,
        route: Route,
        start: float = 0.0,
        length: float | None = None,
        step: float = 50.0,
        lateral_acceleration: float = 1.5,
    ) -> RoadProfile:
        """Returns a profile along a route, with the limits of the right lane and curve speeds.

        Args:
          route: the road.
          start: of the profile [m].
          length: of the profile [m]; default: to the end of the route.
          step: of the grid [m].
          lateral_acceleration: greatest in curves [m/s2].
        """
        name = route.road_map.path.name if route.road_map.path else "route"
        if not start >= 0.0:
            raise InputError(f"start {start:g} m is not on the road {name!r}: it begins at 0 m")
        grid = _grid(start, float(route.length), step, length, name)
        # The smoothed grade bridges the seams of the map; the raw heights do not.
        fine = np.linspace(grid[0], grid[-1], 5 * (grid.size - 1) + 1)
        grade = np.asarray(route.smoothed_grade(fine), dtype=float)
        rise = 0.5 * (grade[1:] + grade[:-1]) * np.diff(fine)
        height = np.concatenate([[0.0], np.cumsum(rise)])[::5]
        curvature = np.abs(np.asarray(route.evaluate(fine, np.zeros(fine.size)).curvature))
        padded = np.pad(curvature, 5, mode="edge")
        widest = np.lib.stride_tricks.sliding_window_view(padded, 11).max(axis=1)[::5]
        curve = np.sqrt(lateral_acceleration / np.maximum(widest, 1e-6))
        lawful = np.array([route.speed_limit(float(s)) for s in grid])
        # A limit applies from the node before the sign, because it holds at the sign.
        lawful = np.minimum(lawful, np.append(lawful[1:], lawful[-1]))
        return cls(grid, height, np.minimum(lawful, curve), name)


def _grid(first: float, last: float, step: float, length: float | None, name: str) -> FloatArray:
    if not math.isfinite(step) or step <= 0.0:
        raise InputError(f"grid step {step!r} m is not allowed: use a number above 0")
    if length is not None and not (math.isfinite(length) and length > 0.0):
        raise InputError(f"length {length!r} m is not allowed: use a number above 0")
    if not first < last:
        raise InputError(f"start {first:g} m is not on the road {name!r}: it ends at {last:g} m")
    end = last if length is None else min(last, first + length)
    count = math.floor((end - first) / step + 1e-9)
    if count < 4:
        raise InputError(
            f"road profile {name!r}: {end - first:g} m is too short: a grid of {step:g} m needs "
            f"{4.0 * step:g} m or more"
        )
    return np.asarray(first + step * np.arange(count + 1), dtype=float)
