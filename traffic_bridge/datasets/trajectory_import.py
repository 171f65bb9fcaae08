"""Places recorded trajectories on the road of any map, by lane and station.

Along the road a vehicle's station is that of the data set plus a constant, so headways and speeds
along the reference line do not change. Everything else comes from the map: lanes, headings, heights
and slopes. Across the road a vehicle keeps its position relative to the lane's width.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from iits_mj.core.arrays import FloatArray, IntArray
from iits_mj.core.checks import in_range
from iits_mj.core.errors import InputError
from iits_mj.road import Route
from traffic_bridge.datasets.kinematics import Motion, fit, smooth, split_jumps, transitions
from traffic_bridge.datasets.trajectories import Trajectories
from traffic_bridge.recording.recording import Recording
from traffic_bridge.recording.rows import COLUMNS
from traffic_bridge.vehicles.types import default_types

LANE_CHANGE = 3.5  # [s], as TrafficConfig.lane_change_duration: for instantaneous lane changes
JUMP = 0.5  # [lanes] between two rows: an instantaneous lane change
ACROSS_WIDTH = 0.4  # [s] of the average across the road: a tenth of a lane change
CREEP = 2.0  # [m/s] below which a vehicle's heading follows its lateral motion less
CHECK_SPACING = 20.0  # [m] between the stations where the map must have the lane


@dataclass(frozen=True, eq=False)
class _Placed:
    """One vehicle on the route; arrays of shape (n,).

    Attributes:
      frame: indices of its instants.
      lane: nearest lane.
      station, offset: of its middle [m], with their derivatives.
      across: speed across the lane [m/s].
    """

    frame: IntArray
    lane: IntArray
    station: Motion
    offset: Motion
    across: FloatArray


@dataclass(frozen=True)
class ImportConfig:
    """Settings of `import_trajectories`.

    Attributes:
      start_station: station of the route at the data set's station zero [m].
      lane_map: lane of the route by lane of the set, both from the right; vehicles are omitted
        while they are in another lane. None: lane i becomes lane i.
      step: between the frames of the recording [s].
      smoothing: distance of the spline's knots along the road [s], see `fit`.
      lane_change_duration: of a set's instantaneous lane changes [s], half of it before the
        instant; fully recorded changes stay unchanged. With 0 they are only averaged, as all motion
        across the road.

    Raises:
      InputError: a value is out of its range.
    """

    start_station: float = 0.0
    lane_map: Mapping[int, int] | None = None
    step: float = 0.1
    smoothing: float = 0.5
    lane_change_duration: float = LANE_CHANGE

    def __post_init__(self) -> None:
        """Checks every value."""
        for name, low, high in (
            ("start_station", -1e6, 1e6),
            ("step", 0.01, 1.0),
            ("smoothing", 0.0, 5.0),
            ("lane_change_duration", 0.0, 20.0),
        ):
            in_range(name, getattr(self, name), low, high)


def import_trajectories(
    trajectories: Trajectories, route: Route, config: ImportConfig | None = None
) -> Recording:
    """A recording that places the trajectories on a route, for `RepSim` and `iits-mj replay`.

    A vehicle is present from its first to its last recorded instant, while all of it is on the
    route. Times begin at zero.

    Args:
      trajectories: of any source.
      route: the road to place them on.
      config: where and how.

    Raises:
      InputError: the map does not have a lane that is needed, or no vehicle is on the route.
    """
    config = config or ImportConfig()
    lanes = _lane_map(trajectories, config.lane_map)
    _check_lanes(trajectories, route, config.start_station, lanes)
    begin = float(trajectories.time.min())
    count = int(np.floor(trajectories.duration / config.step + 1e-6)) + 1
    time: FloatArray = np.arange(count, dtype=np.float64) * config.step
    parts: list[_Placed] = []
    vehicles: list[int] = []
    for index in range(len(trajectories.ids)):
        for rows in _stretches(trajectories, index, lanes):
            placed = _place(trajectories, rows, route, config, lanes, time + begin)
            if placed is not None:
                parts.append(placed)
                vehicles.append(index)
    if not parts:
        raise InputError(
            f"{trajectories.source}: no vehicle is on the route of {route.length:.0f} m with "
            f"start_station {config.start_station:g} m"
        )
    vehicle = np.repeat(vehicles, [len(part.frame) for part in parts])
    used, vehicle = np.unique(vehicle, return_inverse=True)
    # Data sets have no heights.
    height = {t.kind: t.height for t in default_types()}
    sizes = [
        (trajectories.length[i], trajectories.width[i], height[trajectories.kinds[i]]) for i in used
    ]
    return Recording.of_rows(
        _meta(trajectories, route, config, lanes, len(trajectories.ids) - len(used)),
        time,
        [trajectories.ids[i] for i in used],
        [trajectories.kinds[i] for i in used],
        np.array(sizes),
        np.concatenate([part.frame for part in parts]),
        vehicle,
        np.concatenate([part.lane for part in parts]),
        np.concatenate([_columns(part, route, config.step) for part in parts], axis=1),
    )


def _lane_map(t: Trajectories, given: Mapping[int, int] | None) -> dict[int, int]:
    lanes = dict(given) if given is not None else {i: i for i in range(t.lane_count)}
    for lane, target in lanes.items():
        if not (0 <= lane < t.lane_count and 0 <= target < 50):
            raise InputError(
                f"lane_map {lanes!r}: the set has lanes 0 to {t.lane_count - 1}, the right one 0"
            )
    if len(set(lanes.values())) != len(lanes) or not lanes:
        raise InputError(f"lane_map {lanes!r}: each lane needs its own target lane")
    return lanes


def _check_lanes(t: Trajectories, route: Route, start: float, lanes: Mapping[int, int]) -> None:
    """Checks that the map has every lane wherever a vehicle drives in it."""
    middle = t.station - 0.5 * t.length[t.vehicle] + start
    for lane, target in sorted(lanes.items()):
        places = middle[(t.lane == lane) & (middle >= 0.0) & (middle <= route.length)]
        for cell in np.unique(np.round(places / CHECK_SPACING)).tolist():
            station = min(cell * CHECK_SPACING, route.length)
            if not route.lane_exists(target, station):
                raise InputError(
                    f"{t.source}: its lane {lane} becomes lane {target}, which the map does "
                    f"not have at station {station:.0f} m ({route.lane_count(station)} lanes "
                    "there): choose another lane_map or start_station"
                )


def _stretches(t: Trajectories, index: int, lanes: Mapping[int, int]) -> list[slice]:
    """Stretches of two or more of a vehicle's rows in the lanes of the map."""
    rows = t.rows(index)
    used = np.isin(t.lane[rows], list(lanes))
    edges = np.flatnonzero(np.diff(np.concatenate(([False], used, [False])).astype(int)))
    pairs = edges.reshape(-1, 2) + rows.start
    return [slice(int(a), int(b)) for a, b in pairs if b - a >= 2]


def _place(
    t: Trajectories,
    rows: slice,
    route: Route,
    config: ImportConfig,
    lanes: Mapping[int, int],
    instants: FloatArray,
) -> _Placed | None:
    time = t.time[rows]
    first = int(np.searchsorted(instants, time[0] - 1e-6))
    last = int(np.searchsorted(instants, time[-1] + 1e-6))
    frame = np.arange(first, last, dtype=np.int64)
    if not frame.size:
        return None
    at = np.clip(instants[frame], time[0], time[-1])
    half = 0.5 * float(t.length[t.vehicle[rows.start]])
    along = fit(time, t.station[rows] + (config.start_station - half), at, config.smoothing)
    target = np.array([lanes[lane] for lane in t.lane[rows].tolist()], dtype=float)
    in_lanes = target + t.offset[rows] / t.lane_width
    cross = _across(time, in_lanes, at, config.lane_change_duration)
    there = (along.value >= half) & (along.value <= route.length - half)
    if not there.any():
        return None
    frame, along, cross = frame[there], along.pick(there), cross.pick(there)
    # The spline may overshoot, but a standing vehicle must not roll back.
    along = Motion(np.maximum.accumulate(along.value), np.maximum(along.rate, 0.0), along.bend)
    offset, width = _offsets(route, cross.value, along.value, max(lanes.values()))
    across = cross.rate * width
    taper = _taper(route, cross.value, along.value, max(lanes.values()))
    rate = across + taper * along.rate
    lane = np.clip(np.floor(cross.value + 0.5), 0, max(lanes.values())).astype(np.int64)
    return _Placed(frame, lane, along, Motion(offset, rate, cross.bend * width), across)


def _across(time: FloatArray, value: FloatArray, at: FloatArray, duration: float) -> Motion:
    """Motion across the road, in lanes, with instantaneous lane changes spread over time."""
    if duration <= 0.0:
        return smooth(time, value, at, ACROSS_WIDTH)
    base, steps = split_jumps(time, value, JUMP)
    return smooth(time, base, at, ACROSS_WIDTH) + transitions(steps, at, duration)


def _offsets(
    route: Route, cross: FloatArray, station: FloatArray, highest: int
) -> tuple[FloatArray, FloatArray]:
    """Offset on the route of positions given in lanes, and the width of a lane there [m]."""
    low = np.clip(np.floor(cross), 0, max(highest - 1, 0)).astype(int)
    offset, width = np.empty_like(station), np.empty_like(station)
    for lane in np.unique(low).tolist():
        rows = low == lane
        begin = route.lane_offset(lane, station[rows])
        if highest > 0:
            width[rows] = route.lane_offset(lane + 1, station[rows]) - begin
        else:
            width[rows] = route.lane_width(lane, station[rows])
        offset[rows] = begin + (cross[rows] - lane) * width[rows]
    return offset, width


def _taper(route: Route, cross: FloatArray, station: FloatArray, highest: int) -> FloatArray:
    """Lateral shift to the left per meter of station of a position given in lanes."""
    half = 1.0
    ahead, _ = _offsets(route, cross, np.minimum(station + half, route.length), highest)
    behind, _ = _offsets(route, cross, np.maximum(station - half, 0.0), highest)
    way = np.minimum(station + half, route.length) - np.maximum(station - half, 0.0)
    return np.asarray((ahead - behind) / way)


def _columns(placed: _Placed, route: Route, step: float) -> FloatArray:
    """The values of a vehicle's rows in the order of `COLUMNS`, shape (len(COLUMNS), n)."""
    station, offset = placed.station.value, placed.offset.value
    point = route.evaluate(station, offset)
    # On the inside of a bend the distance is shorter for the same station.
    shrink = 1.0 - point.curvature * offset
    along = placed.station.rate * shrink
    # The heading of a standing vehicle does not follow the noise.
    turned = np.arctan(placed.offset.rate * along / np.maximum(along, CREEP) ** 2)
    rise, bank = point.grade, np.tan(point.superelevation)
    heading = point.heading + turned
    rate = (
        np.gradient(heading, step * (placed.frame - placed.frame[0])) if len(heading) > 1 else 0.0
    )
    values: dict[str, Any] = {
        "x": point.x,
        "y": point.y,
        "z": point.z,
        "yaw": np.arctan2(np.sin(heading), np.cos(heading)),
        # Slopes along and across the vehicle, positive up and up to the left (ISO 8855).
        "pitch": -np.arctan(np.cos(turned) * rise + np.sin(turned) * bank),
        "roll": np.arctan(np.cos(turned) * bank - np.sin(turned) * rise),
        "yaw_rate": rate,
        "speed": np.hypot(along, placed.offset.rate),
        "acceleration": np.cos(turned) * placed.station.bend * shrink
        + np.sin(turned) * placed.offset.bend,
        "lateral_speed": placed.across,
        "station": station,
        "offset": offset,
    }
    return np.array([np.broadcast_to(values[name], station.shape) for name in COLUMNS])


def _meta(
    t: Trajectories, route: Route, config: ImportConfig, lanes: Mapping[int, int], omitted: int
) -> dict[str, Any]:
    return {
        "mode": "DataSet",
        "source": t.source,
        "notes": [*t.notes, *([f"{omitted} vehicles are nowhere on the route"] if omitted else [])],
        "start_station": config.start_station,
        "lane_map": {str(lane): target for lane, target in sorted(lanes.items())},
        "smoothing": config.smoothing,
        "map_hash": route.road_map.content_hash,
        "map_name": route.road_map.path.name,
    }
