"""The road as tables over station, made once for a route, and the paths of its lanes.

Where a lane appears or ends on the right, the indices of all lanes shift, but the truck's lane
continues. `RoadPreview.follow` follows the physical lane.

`lane_shift` is the tractor's offset in its lane with which the last unit stays inside it too. In a
steady turn its axles run beside the path of the steer axle: at walking pace on the inside
by `kappa k` with k half of the sum of the squared lengths; at higher speeds more and more to the
outside, as its tires need slip. The steer axle drives half of that to the other side, so that
tractor and trailer have the same room at all speeds from standstill to that of the bend.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from controllers.planning.following import curve_speed
from controllers.tracking.lateral_model import LateralModel
from iits_mj import kernels
from iits_mj.core.angles import wrap_angles
from iits_mj.core.arrays import FloatArray, IntArray
from iits_mj.core.units import GRAVITY
from iits_mj.kernels import Address, Integer, Real, Table
from iits_mj.parameters import TruckParameters

if TYPE_CHECKING:
    from iits_mj.road import Route

# Spacing of the rows of the tables [m]; coarser on roads beyond 50 km.
_STEP = 5.0
# The truck does not use a narrower lane, unless there is no wider one [m].
_WIDTH_MIN = 2.75
# Between two rows the middle of a lane moves aside by less than this [m].
_SAME_LANE = 1.2
# A seam of a map turns the heading by less than this, about 1 degree a row [rad].
_SEAM_TURN = 0.02
_SEAM_ROWS = 5
# Speeds at which off-tracking is computed [m/s], and lag of the steering there [s].
_SPEEDS = np.array([0.5, 4.0, 8.0, 12.0, 16.0, 20.0, 25.0, 30.0])
STEERING_LAG = 0.1
# Room that the tractor leaves between its side and the lane's edge [m].
_LANE_MARGIN = 0.15
# Spacing of samples of the heading between rows [m], and turn between two of them [rad].
_SWING_SAMPLE, _SWING_SLACK = 0.5, 0.1
# The lane shift begins and ends over about twice this distance, as the trailer follows [m].
_SMOOTHING = 25.0

_interpolate = kernels.function("iits_interpolate", Real, Address, Integer, Integer, Real)
# Rows of the tables for the compiled functions after the stations: of a path, of the road.
_DRIVEN, _OFFSET, _GRADE = 1, 4, 2

Stations = TypeVar("Stations", float, FloatArray)


@dataclass(frozen=True)
class LanePath:
    """The middle of one lane, followed forward and backward from a station.

    Attributes:
      station: of shape (n,), uniform [m].
      offset: of the lane's middle, shape (n,) [m]; held constant beyond the lane's end.
      speed_limit: of the lane, shape (n,) [m/s].
      half_width: of the lane at the start [m].
      end: station at which the lane or the road ends, or infinity beyond the preview.
      lane: index at the start.
      rows: index of the lane at each station, shape (n,); None: `lane` everywhere.
      shift: of the steer axle from the middle, shape (n,) [m]; None: zero.
      road: of the lane; None: vehicles of every level count as in the lane.
    """

    station: FloatArray
    offset: FloatArray
    speed_limit: FloatArray
    half_width: float
    end: float
    lane: int
    rows: IntArray | None = None
    shift: FloatArray | None = None
    road: RoadPreview | None = None

    @functools.cached_property
    def driven(self) -> FloatArray:
        """Offset at which the steer axle drives, shape (n,) [m]."""
        return self.offset if self.shift is None else self.offset + self.shift

    @functools.cached_property
    def table(self) -> Table:
        """Station, driven offset, its slope [1] and second derivative [1/m], middle's offset."""
        step = float(self.station[1] - self.station[0]) if self.road is None else self.road.step
        slope = gradient(self.driven, step)
        return Table([self.station, self.driven, slope, gradient(slope, step), self.offset])

    def offset_at(self, station: Stations) -> Stations:
        """Offset of the lane's middle [m], same shape as station."""
        return self._row_at(_OFFSET, station)

    def driven_at(self, station: Stations) -> Stations:
        """Offset at which the steer axle drives [m], same shape as station."""
        return self._row_at(_DRIVEN, station)

    def _row_at(self, row: int, station: Stations) -> Stations:
        if isinstance(station, float):
            return float(_interpolate(self.table.address, len(self.station), row, station))
        return np.asarray(np.interp(station, self.station, self.table.numbers[row]))


class RoadPreview:
    """Lane offsets, speed limits, curvature and grade of a route, every 5 m (coarser beyond 50 km).

    Args:
      route: the truck's road.

    Attributes:
      station: of shape (n,), `step` apart [m].
      offset, half_width, speed_limit: of the lanes, shape (lanes, n); offset is NaN for no lane.
      curvature, grade, height, superelevation: of the reference line, shape (n,).
      heading: of the reference line at the rows, shape (n,) [rad].
      swing: bound on its difference from the heading nearest to a row, shape (n,) [rad].
      shift: wanted offset of the steer axle from the lane's middle, shape (lanes, n) [m].
      table: rows of station, curvature, grade, height, superelevation, heading and swing, for the
        compiled functions.
    """

    def __init__(self, route: Route) -> None:
        self.route = route
        count = max(2, math.floor(route.length / max(_STEP, route.length / 10_000.0)) + 1)
        self.station = np.linspace(0.0, route.length, count)
        self.step = float(self.station[1])
        counts = np.array([route.lane_count(float(s)) for s in self.station], dtype=int)
        lanes = max(1, int(counts.max()))
        exists = np.arange(lanes)[:, None] < counts
        width = np.array([route.lane_width(lane, self.station) for lane in range(lanes)])
        width[~exists] = 0.0
        usable = exists & (width >= np.minimum(_WIDTH_MIN, width.max(axis=0)))
        offset = np.array([route.lane_offset(lane, self.station) for lane in range(lanes)])
        self.offset = np.where(usable, offset, np.nan)
        self._middles: list[list[float]] = self.offset.T.tolist()
        # Number of places before each row where a lane's middle ends or moves aside.
        jumps = ~(np.abs(np.diff(self.offset, prepend=self.offset[:, :1])) < _SAME_LANE)
        self._jumps: list[list[int]] = np.cumsum(jumps, axis=1).tolist()
        self.half_width = 0.5 * width
        self.shift = np.zeros_like(self.offset)
        self.speed_limit = np.array(
            [[route.speed_limit(float(s), lane) for s in self.station] for lane in range(lanes)]
        )
        point = route.evaluate(self.station, 0.0)
        self.curvature = road_curvature(route, self.station)
        self.heading = np.asarray(point.heading, dtype=float)
        self.swing = heading_swing(route, self.station, self.heading)
        self.height = np.asarray(point.z, dtype=float)
        self.superelevation = np.asarray(point.superelevation, dtype=float)
        self.grade = np.asarray(route.smoothed_grade(self.station), dtype=float)
        surface = self.height, self.superelevation, self.heading, self.swing
        self.table = Table([self.station, self.curvature, self.grade, *surface])

    def index(self, station: float) -> int:
        """Nearest row of the tables."""
        return min(max(round(station / self.step), 0), len(self.station) - 1)

    def nearest_lane(self, station: float, offset: float) -> int:
        """Index of the lane whose middle is nearest to an offset; -1 where there is no lane."""
        best, nearest = -1, math.inf
        for lane, middle in enumerate(self._middles[self.index(station)]):
            distance = abs(middle - offset)
            if distance < nearest:
                best, nearest = lane, distance
        return best

    def lane_exists(self, lane: int, station: float) -> bool:
        """True when the route has this lane here, wide enough for the truck."""
        middles = self._middles[self.index(station)]
        return 0 <= lane < len(middles) and math.isfinite(middles[lane])

    def follow(self, lane: int, station: float, ahead: float, behind: float = 100.0) -> LanePath:
        """The lane's path from `behind` meters back to `ahead` meters ahead."""
        here = self.index(station)
        first = max(0, here - round(behind / self.step))
        last = min(len(self.station) - 1, here + math.ceil(ahead / self.step))
        stretch = slice(first, last + 1)
        row = max(lane, 0)
        offsets, limits = self.offset[row, stretch], self.speed_limit[row, stretch]
        rows, end_forward = np.full(len(offsets), row, dtype=np.int64), len(self.station)
        shift = self.shift[row, stretch]
        if self._jumps[row][first] != self._jumps[row][last]:
            offsets, limits = np.empty(len(offsets)), np.empty(len(offsets))
            parts = (first, offsets, limits, rows)
            end_forward = self._walk(lane, here, range(here, last + 1), *parts)
            self._walk(lane, here, range(here, first - 1, -1), *parts)
            shift = self.shift[rows, np.arange(first, last + 1)]
        end = math.inf
        if end_forward <= last:
            end = float(self.station[end_forward])
        elif last == len(self.station) - 1:
            end = float(self.station[-1])
        return LanePath(
            station=self.station[stretch],
            offset=offsets,
            speed_limit=limits,
            half_width=float(self.half_width[row, here]),
            end=end,
            lane=lane,
            rows=rows,
            shift=shift,
            road=self,
        )

    def grade_at(self, station: float) -> float:
        """Grade at a station."""
        return float(_interpolate(self.table.address, len(self.station), _GRADE, station))

    def felt(self, station: FloatArray, speed: float) -> FloatArray:
        """Lateral acceleration by bends and cross-slope at a speed [m/s2], shape as station.

        `v^2 kappa + g tan(superelevation)`, positive where it acts to the right.
        """
        curvature = np.interp(station, self.station, self.curvature)
        bank = np.interp(station, self.station, self.superelevation)
        return np.asarray(speed**2 * curvature + GRAVITY * np.tan(bank))

    def _walk(
        self,
        lane: int,
        here: int,
        columns: range,
        first: int,
        offsets: FloatArray,
        limits: FloatArray,
        rows: IntArray,
    ) -> int:
        """Fills offsets, limits and rows; returns the first column without the lane."""
        row, value = lane, float(self.offset[lane, here])
        limit = float(self.speed_limit[lane, here])
        ended = len(self.station)
        for column in columns:
            if ended == len(self.station):
                candidate = float(self.offset[row, column])
                if not abs(candidate - value) < _SAME_LANE:
                    distance = np.abs(self.offset[:, column] - value)
                    near = int(np.nanargmin(distance)) if not np.all(np.isnan(distance)) else -1
                    if near >= 0 and distance[near] < _SAME_LANE:
                        row, candidate = near, float(self.offset[near, column])
                    else:
                        ended = column
                if ended != column:
                    value, limit = candidate, float(self.speed_limit[row, column])
            offsets[column - first] = value
            limits[column - first] = limit
            rows[column - first] = max(row, 0)
        return ended


def road_curvature(route: Route, station: FloatArray) -> FloatArray:
    """Curvature of the reference line about each station, shape as station [1/m].

    It is the turn of the heading between two rows over their distance, so that short bends keep
    their radius. Seams of real maps make spikes that no truck drives: where one or two rows differ
    from their neighbors by a turn too small to be a bend, the turn is spread over 25 m.

    Args:
      route: the road.
      station: uniform, shape (n,) [m].
    """
    step = float(station[1] - station[0])
    ends = np.append(station - 0.5 * step, station[-1] + 0.5 * step)
    heading = np.asarray(route.evaluate(ends, 0.0).heading, dtype=float)
    turn = wrap_angles(np.diff(heading))
    half = _SEAM_ROWS // 2
    around = np.lib.stride_tricks.sliding_window_view(np.pad(turn, half, mode="edge"), _SEAM_ROWS)
    # The median of five keeps bends and their beginnings as they are.
    excess = turn - np.median(around, axis=1)
    spike = np.where(np.abs(excess) < _SEAM_TURN, excess, 0.0)
    spread = np.convolve(np.pad(spike, half), np.full(_SEAM_ROWS, 1.0 / _SEAM_ROWS), mode="valid")
    return np.asarray((turn - spike + spread) / step)


def heading_swing(route: Route, station: FloatArray, heading: FloatArray) -> FloatArray:
    """Bound on the difference of headings nearest to each station from the one there [rad].

    Between two samples the heading may turn by `_SWING_SLACK`, more than half a meter of any bend.

    Args:
      route: the road.
      station: uniform, shape (n,) [m].
      heading: at the stations, shape (n,) [rad].
    """
    half = 0.5 * float(station[1] - station[0])
    around = np.linspace(-half, half, 2 * math.ceil(half / _SWING_SAMPLE) + 1)
    places = (station[:, None] + around).ravel()
    beside = route.heading(places).reshape(len(station), -1)
    return np.asarray(np.abs(wrap_angles(beside - heading[:, None])).max(axis=1) + _SWING_SLACK)


def strongest(values: FloatArray) -> FloatArray:
    """Value with the greatest magnitude of a row and its neighbors, with its sign, shape (n,)."""
    found = values
    for beside in (np.append(values[:1], values[:-1]), np.append(values[1:], values[-1:])):
        found = np.where(np.abs(beside) > np.abs(found), beside, found)
    return found


def gradient(values: FloatArray, step: float) -> FloatArray:
    """Slope of values `step` apart, shape (n,); `np.gradient` without its checks."""
    slope = np.empty(len(values))
    slope[1:-1] = (values[2:] - values[:-2]) / (2.0 * step)
    slope[0], slope[-1] = (values[1] - values[0]) / step, (values[-1] - values[-2]) / step
    return slope


def off_tracking(model: LateralModel, speed: float) -> float:
    """Distance of the last unit's axle group from the steer axle's path, over its curvature [m2].

    In a steady turn of the linear model; positive to the inside. The distance [m] is this times the
    curvature [1/m], for radii well above the truck's length.

    Args:
      model: of the loaded truck.
      speed: [m/s], positive.
    """
    a, _, _ = model.matrices(speed)
    # Unit curvature: all yaw rates are v; lateral speed, articulations and steer angle follow.
    turning = a[: model.rates, 1 : model.rates].sum(axis=1) * speed
    w, *articulations, _ = np.linalg.solve(model.held(a), -turning)
    heading = -w / speed
    aside = way = 0.0
    for coupling, articulation in zip(model.plane.couplings, articulations, strict=True):
        aside, way = aside + coupling * heading, way + coupling
        heading = heading - articulation
    group = model.plane.group(model.plane.units - 1)
    return float(-(aside + group * heading) - 0.5 * (way + group) ** 2)


def lane_shift(
    preview: RoadPreview,
    parameters: TruckParameters,
    mass: float,
    curve_acceleration: float,
) -> FloatArray:
    """Wanted offset of the steer axle from the lanes' middles, shape (lanes, n) [m].

    Args:
      preview: of the road.
      parameters: of the truck.
      mass: gross combination mass [kg].
      curve_acceleration: lateral acceleration that bounds the speed in curves [m/s2].
    """
    model = LateralModel.of(parameters, mass, STEERING_LAG)
    gains = np.array([off_tracking(model, float(speed)) for speed in _SPEEDS])
    curvature = preview.curvature
    fastest = np.minimum(
        curve_speed(curvature, curve_acceleration), preview.speed_limit.max(axis=0)
    )
    slow, fast = curvature * gains[0], curvature * np.interp(fastest, _SPEEDS, gains)
    both = np.array([np.zeros_like(slow), slow, fast])
    shift = -0.5 * (both.min(axis=0) + both.max(axis=0))
    count = 2 * round(0.5 * _SMOOTHING / preview.step) + 1
    window = np.full(count, 1.0 / count)
    for _ in range(2):
        shift = np.convolve(np.pad(shift, count // 2, mode="edge"), window, mode="valid")
    width = max(unit.width for unit in parameters.units)
    free = preview.half_width - 0.5 * width - _LANE_MARGIN
    free = np.maximum(free, 0.0)
    return np.asarray(np.clip(shift[None, :], -free, free))
