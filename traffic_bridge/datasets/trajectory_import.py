"""Lays recorded trajectories on the road of any map, by lane and station.

What is recorded is kept along the road: the station of every vehicle, at every instant, is that of
the data set plus a constant, so that headways and speeds along the reference line stay as they
were. Everything else comes from the map: where the lanes are, headings, heights and slopes. Across
the road a vehicle keeps its place between the lane's borders, in parts of the lane's width.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from iits_mj.core.arrays import FloatArray
from iits_mj.core.errors import InputError
from iits_mj.road import Route
from traffic_bridge.datasets.kinematics import Motion, calm, fit, split_jumps, transitions
from traffic_bridge.datasets.trajectories import Trajectories
from traffic_bridge.vehicles.types import default_types

if TYPE_CHECKING:
    from traffic_bridge.recording.recording import Recording

IntArray = NDArray[np.int64]

LANE_CHANGE = 3.5  # [s], as TrafficConfig.lane_change_duration: for sets that jump between lanes
JUMP = 0.5  # [lanes] between two rows: the set changes lanes at an instant
ACROSS_WIDTH = 0.4  # [s] of the average across the road: a lane change takes ten times that
CREEP = 2.0  # [m/s] below which a vehicle's heading turns from the road's ever less
CHECK_SPACING = 20.0  # [m]: where it is checked that the map has the lane


@dataclass(frozen=True, eq=False)
class Laid:
    """One vehicle on the route; arrays of shape (n,).

    Attributes:
      frame: indices of the instants at which it is there.
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
    """How a data set is laid.

    Attributes:
      start_station: where the data set's station zero comes to lie on the route [m].
      lane_map: lane of the route by lane of the set, both from the right; vehicles are not there
        while in a lane that is not named. None: lane i becomes lane i.
      step: between the frames of the recording [s].
      smoothing: distance of the knots along the road [s], see `fit`; 0 passes through every point.
      lane_change_duration: in which a set's instant lane changes are carried out [s], half of it
        before the instant; a change that the set has in full stays as it is. With 0 instant ones
        are only averaged, as everything across the road.

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
            value = getattr(self, name)
            if not (isinstance(value, (int, float)) and low <= value <= high):
                raise InputError(f"{name} {value!r}: allowed is {low:g} to {high:g}")


def import_trajectories(
    trajectories: Trajectories, route: Route, config: ImportConfig | None = None
) -> Recording:
    """A recording of the trajectories on a route, for `RepSim` and `iits-mj replay`.

    Vehicles are there from the first to the last instant at which they are recorded, while the
    whole of them is on the route. Times begin at zero.

    Args:
      trajectories: of any source.
      route: the road to lay them on.
      config: where and how.

    Raises:
      InputError: the map does not have a lane that is needed, or nobody comes to lie on the route.
    """
    from traffic_bridge.recording.recording import Recording

    config = config or ImportConfig()
    lanes = _lane_map(trajectories, config.lane_map)
    _check_lanes(trajectories, route, config.start_station, lanes)
    begin = float(trajectories.time.min())
    count = int(np.floor(trajectories.duration / config.step + 1e-6)) + 1
    time: FloatArray = np.arange(count, dtype=np.float64) * config.step
    parts: list[Laid] = []
    who: list[int] = []
    for index in range(len(trajectories.ids)):
        for rows in _stretches(trajectories, index, lanes):
            laid = _lay_one(trajectories, rows, route, config, lanes, time + begin)
            if laid is not None:
                parts.append(laid)
                who.append(index)
    if not parts:
        raise InputError(
            f"{trajectories.source}: nobody comes to lie on the route of {route.length:.0f} m, "
            f"begun at station {config.start_station:g} m"
        )
    vehicle = np.repeat(who, [len(part.frame) for part in parts])
    used, vehicle = np.unique(vehicle, return_inverse=True)
    # Data sets have no heights.
    height = {t.kind: t.height for t in default_types()}
    sizes = [
        (trajectories.length[i], trajectories.width[i], height[trajectories.kinds[i]]) for i in used
    ]
    return Recording.of_rows(
        _meta(trajectories, route, config, lanes, len(used)),
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
        raise InputError(f"lane_map {lanes!r}: every lane needs a lane of its own")
    return lanes


def _check_lanes(t: Trajectories, route: Route, start: float, lanes: Mapping[int, int]) -> None:
    """Every lane must be there wherever a vehicle drives in it."""
    middle = t.station - 0.5 * t.length[t.vehicle] + start
    for lane, target in sorted(lanes.items()):
        places = middle[(t.lane == lane) & (middle >= 0.0) & (middle <= route.length)]
        for cell in np.unique(np.round(places / CHECK_SPACING)).tolist():
            station = min(cell * CHECK_SPACING, route.length)
            if not route.lane_exists(target, station):
                raise InputError(
                    f"{t.source}: its lane {lane} is to lie on lane {target}, which the map does "
                    f"not have at station {station:.0f} m ({route.lane_count(station)} lanes "
                    "there): choose lane_map or start_station otherwise"
                )


def _stretches(t: Trajectories, index: int, lanes: Mapping[int, int]) -> list[slice]:
    """Stretches of a vehicle's rows within the lanes that are used, of two rows or more."""
    rows = t.rows(index)
    used = np.isin(t.lane[rows], list(lanes))
    edges = np.flatnonzero(np.diff(np.concatenate(([False], used, [False])).astype(int)))
    pairs = edges.reshape(-1, 2) + rows.start
    return [slice(int(a), int(b)) for a, b in pairs if b - a >= 2]


def _lay_one(
    t: Trajectories,
    rows: slice,
    route: Route,
    config: ImportConfig,
    lanes: Mapping[int, int],
    instants: FloatArray,
) -> Laid | None:
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
    # A standing vehicle does not roll back by the spline's swing.
    along = Motion(np.maximum.accumulate(along.value), np.maximum(along.rate, 0.0), along.bend)
    offset, width = _offsets(route, cross.value, along.value, max(lanes.values()))
    across = cross.rate * width
    taper = _taper(route, cross.value, along.value, max(lanes.values()))
    rate = across + taper * along.rate
    lane = np.clip(np.floor(cross.value + 0.5), 0, max(lanes.values())).astype(np.int64)
    return Laid(frame, lane, along, Motion(offset, rate, cross.bend * width), across)


def _across(time: FloatArray, value: FloatArray, at: FloatArray, duration: float) -> Motion:
    """Motion across the road, in lanes, in which instant lane changes are drawn out."""
    if duration <= 0.0:
        return calm(time, value, at, ACROSS_WIDTH)
    base, steps = split_jumps(time, value, JUMP)
    return calm(time, base, at, ACROSS_WIDTH) + transitions(steps, at, duration)


def _offsets(
    route: Route, cross: FloatArray, station: FloatArray, highest: int
) -> tuple[FloatArray, FloatArray]:
    """Offset on the route at places given in lanes, and what a whole lane is there [m]."""
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
    """By how much a place given in lanes moves to the left per metre along the route."""
    half = 1.0
    ahead, _ = _offsets(route, cross, np.minimum(station + half, route.length), highest)
    behind, _ = _offsets(route, cross, np.maximum(station - half, 0.0), highest)
    way = np.minimum(station + half, route.length) - np.maximum(station - half, 0.0)
    return np.asarray((ahead - behind) / way)


def _columns(laid: Laid, route: Route, step: float) -> FloatArray:
    """The figures of a recording's rows, in the order of its columns."""
    from traffic_bridge.recording.recording import COLUMNS

    station, offset = laid.station.value, laid.offset.value
    point = route.evaluate(station, offset)
    # Who drives inside of a bend goes a shorter way for the same station.
    shrink = 1.0 - point.curvature * offset
    along = laid.station.rate * shrink
    # Nobody turns on the spot: the heading of one who stands does not follow the noise.
    turned = np.arctan(laid.offset.rate * along / np.maximum(along, CREEP) ** 2)
    rise, bank = point.grade, np.tan(point.superelevation)
    heading = point.heading + turned
    rate = np.gradient(heading, step * (laid.frame - laid.frame[0])) if len(heading) > 1 else 0.0
    values: dict[str, Any] = {
        "x": point.x,
        "y": point.y,
        "z": point.z,
        "yaw": np.arctan2(np.sin(heading), np.cos(heading)),
        # Slopes along and across the vehicle, positive up and up to the left (ISO 8855).
        "pitch": -np.arctan(np.cos(turned) * rise + np.sin(turned) * bank),
        "roll": np.arctan(np.cos(turned) * bank - np.sin(turned) * rise),
        "yaw_rate": rate,
        "speed": np.hypot(along, laid.offset.rate),
        "acceleration": np.cos(turned) * laid.station.bend * shrink
        + np.sin(turned) * laid.offset.bend,
        "lateral_speed": laid.across,
        "station": station,
        "offset": offset,
    }
    return np.array([np.broadcast_to(values[name], station.shape) for name in COLUMNS])


def _meta(
    t: Trajectories, route: Route, config: ImportConfig, lanes: Mapping[int, int], laid: int
) -> dict[str, Any]:
    return {
        "mode": "DataSet",
        "source": t.source,
        "notes": [*t.notes, *_left_out(len(t.ids) - laid)],
        "start_station": config.start_station,
        "lane_map": {str(lane): target for lane, target in sorted(lanes.items())},
        "smoothing": config.smoothing,
        "map_hash": route.road_map.content_hash,
        "map_name": route.road_map.path.name,
    }


def _left_out(count: int) -> tuple[str, ...]:
    return (f"{count} vehicles come to lie nowhere on the route",) if count else ()
