"""Position of SUMO's lanes on the road's surface: on the ego's route, off it and in junctions.

SUMO's shapes are polylines without cross slope. So a lane's position comes from the road that
netconvert made the lane from; the shape only shows which part of that road the lane covers.

A lane inside a junction connects the lanes before and after it without a step: it follows its
connecting road, moved by the differences at both ends (some centimeters). SUMO's own short joints,
which have no road, are cubics from end to end.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from iits_mj.core.arrays import FloatArray
from iits_mj.core.errors import InputError, TrafficError
from iits_mj.road.road_frames import RoadFrame, RoadFrames, SurfacePoint
from traffic_bridge.network.lane_blending import blended, half_step, joint, lane_seams, moved
from traffic_bridge.network.net_file import NetConnection, NetFile, NetLane, distances_along

STEP = 2.0  # [m] between the points that measure the length of a lane's center


class LaneSurface(NamedTuple):
    """Samples of one SUMO lane, arrays of shape (n,).

    Attributes:
      position: along the lane in SUMO's measure [m], evenly spaced from 0 to the lane's length.
      x, y, z: of the lane's center on the road's surface, map frame [m].
      heading: of travel [rad]; continuous along the lane.
      grade: dz over horizontal distance, positive uphill in travel.
      bank: roll angle of the surface in travel [rad], positive where the left side is higher.
    """

    position: FloatArray
    x: FloatArray
    y: FloatArray
    z: FloatArray
    heading: FloatArray
    grade: FloatArray
    bank: FloatArray


@dataclass(frozen=True, eq=False)
class Stretch:
    """The part of a road that a SUMO lane covers: stations `s` at fractions `part` of its length.

    Fractions grow in proportion to the length of the lane's center, averaged over the lanes of an
    edge, so that vehicles at equal positions of neighboring lanes are side by side. `lanes` holds
    the lane's OpenDRIVE id in each lane section.
    """

    frame: RoadFrame
    lanes: dict[int, int]
    part: FloatArray
    s: FloatArray

    @property
    def sense(self) -> float:
        """+1 where stations grow in the direction of travel, -1 where they fall."""
        return 1.0 if self.s[-1] > self.s[0] else -1.0

    def lane_end(self, end: int) -> SurfacePoint:
        """The lane's center at the beginning (0) or end (-1) of the stretch, columns (1,)."""
        return self.frame.evaluate(self.lanes, self.s[[end]])

    def road_end(self, end: int) -> SurfacePoint:
        """The lane's center where its road begins (0) or ends (-1) in travel, columns (1,)."""
        ends = (0.0, self.frame.length) if self.sense > 0 else (self.frame.length, 0.0)
        return self.frame.evaluate(self.lanes, ends[end])

    def s_at(self, part: ArrayLike) -> FloatArray:
        """Stations of the road at fractions of the lane."""
        return np.interp(np.asarray(part, dtype=float), self.part, self.s)

    def part_at(self, s: float) -> float:
        """Fraction of the lane at a station, 0 to 1."""
        order = slice(None, None, int(self.sense))
        return float(np.interp(s, self.s[order], self.part[order]))


class JunctionLane(NamedTuple):
    """A lane inside a junction: part of a connection, from fraction `start` to `end` of it."""

    connection: NetConnection
    start: float
    end: float


class LaneSurfaces:
    """Surfaces of every lane of a net.

    Args:
      net: the file.
      frames: of the map from which the net was made.

    Attributes:
      lanes: by SUMO's id.
      inside: the connection of each lane inside a junction.

    Raises:
      TrafficError: the net names a road or lane that the map does not have.
    """

    def __init__(self, net: NetFile, frames: RoadFrames) -> None:
        self._net = net
        self._frames = frames
        self.lanes: dict[str, NetLane] = net.lanes
        self._stretches: dict[str, Stretch | None] = {}
        self.inside = self._find_inside()
        joints = (name for name in self.inside if self.lanes[name].origin is None)
        self._after, self._before = lane_seams(net, frozenset(joints))
        self._steps: dict[str, tuple[FloatArray | None, FloatArray | None]] = {}
        for lane in self.lanes.values():
            if lane.origin is not None:
                self._check(lane, *lane.origin)

    def surface(self, lane: str, spacing: float = 1.0) -> LaneSurface:
        """Samples of a lane, about `spacing` meters apart and at both ends; at least two.

        Raises:
          InputError: there is no such lane, or the spacing is not positive.
        """
        if not (math.isfinite(spacing) and spacing > 0.0):
            raise InputError(f"spacing {spacing!r} m: must be positive")
        length = self.lane(lane).length
        position = np.linspace(0.0, length, max(math.ceil(length / spacing), 1) + 1)
        point = self.at(lane, position)
        return LaneSurface(position, *point._replace(heading=np.unwrap(point.heading)))

    def lane(self, name: str) -> NetLane:
        """The lane of a SUMO lane id; InputError if there is none."""
        if name not in self.lanes:
            raise InputError(
                f"no lane {name!r} in {self._net.path.name}; there are "
                f"{', '.join(sorted(self.lanes)[:8])} ..."
            )
        return self.lanes[name]

    def at(self, name: str, position: ArrayLike, offset: ArrayLike = 0.0) -> SurfacePoint:
        """Points on a lane; positions beyond its ends count as its ends.

        Args:
          name: SUMO lane id.
          position: along the lane in SUMO's measure [m], shape (n,).
          offset: to the left of its center [m], shape (n,) or a number.

        Raises:
          InputError: there is no such lane.
        """
        lane = self.lane(name)
        part = np.clip(np.atleast_1d(np.asarray(position, dtype=float)) / lane.length, 0.0, 1.0)
        if name in self.inside:
            return self._at_inside(lane, part, np.asarray(offset, dtype=float))
        stretch = self.stretch(name)
        if stretch is None:
            raise InputError(f"lane {name!r} belongs to no road of the map")
        point = stretch.frame.evaluate(stretch.lanes, stretch.s_at(part), offset)
        if name not in self._steps:
            self._steps[name] = (
                self._half_step(stretch, self._before.get(name), 0),
                self._half_step(stretch, self._after.get(name), -1),
            )
        start, end = self._steps[name]
        if start is not None:
            point = blended(point, part * lane.length, lane.length, start, at_end=False)
        if end is not None:
            point = blended(point, part * lane.length, lane.length, end, at_end=True)
        return point

    def stretch(self, name: str) -> Stretch | None:
        """The part of a road that a lane covers; None for SUMO's own joints."""
        if name not in self._stretches:
            lane = self.lane(name)
            # The lanes of an edge share their stations.
            lanes = [lane] if lane.internal else list(self._net.edge[lane.edge].lanes)
            for each, found in zip(lanes, self._measure(lanes), strict=True):
                self._stretches[each.id] = found
        return self._stretches[name]

    def _check(self, lane: NetLane, road: str, number: int) -> None:
        if road not in self._frames.road_map.roads or all(
            section.lane(number) is None for section in self._frames.road_map.roads[road].sections
        ):
            raise TrafficError(
                f"{self._net.path.name}: lane {lane.id!r} was made of lane {number} of road "
                f"{road!r}, which {self._frames.road_map.name} does not have; "
                "was the net made from another map?"
            )

    def _find_inside(self) -> dict[str, JunctionLane]:
        """The lanes inside junctions; one connection may consist of two lanes."""
        found = {}
        for connection in self._net.connections:
            if connection.start.startswith(":") or not connection.via:
                continue
            chain, lane = [], connection.via
            while lane and lane not in chain:
                chain.append(lane)
                lane = self._net.inside.get(lane, "")
            lengths = np.cumsum([0.0, *(self.lanes[name].length for name in chain)])
            for name, start, end in zip(chain, lengths, lengths[1:], strict=False):
                found[name] = JunctionLane(
                    connection, float(start / lengths[-1]), float(end / lengths[-1])
                )
        return found

    def _measure(self, lanes: list[NetLane]) -> list[Stretch | None]:
        """Stretches of the lanes of one edge."""
        if lanes[0].origin is None:
            return [None] * len(lanes)
        frame = self._frames[lanes[0].origin[0]]
        ends = np.mean([self._ends(lane, frame) for lane in lanes], axis=0)
        s = np.linspace(ends[0], ends[1], max(math.ceil(abs(ends[1] - ends[0]) / STEP), 1) + 1)
        along = np.zeros_like(s)
        named = [self._names(lane, frame, s) for lane in lanes]
        for names in named:
            point = frame.evaluate(names, s)
            along[1:] += np.cumsum(np.hypot(np.diff(point.x), np.diff(point.y)))
        part = along / along[-1] if along[-1] > 0.0 else np.linspace(0.0, 1.0, s.size)
        return [Stretch(frame, names, part, s) for names in named]

    def _names(self, lane: NetLane, frame: RoadFrame, s: FloatArray) -> dict[int, int]:
        """OpenDRIVE ids of a SUMO lane in every lane section on its way.

        The id in the net is usually right, also where netconvert draws a tapered lane beside its
        true position; but the sections of one edge may number their lanes differently.
        """
        given = 0 if lane.origin is None else lane.origin[1]
        shape = self._map_shape(lane)
        along = distances_along(shape)
        low, high = sorted((float(s[0]), float(s[-1])))
        names = {}
        for section in range(frame.section(low), frame.section(high - 1e-3) + 1):
            start, end = frame.span(section)
            middle = 0.5 * (max(start, low) + min(end, high))
            place = along[-1] * (middle - s[0]) / (s[-1] - s[0])
            x, y = (float(np.interp(place, along, shape[:, axis])) for axis in (0, 1))
            middle, t = frame.locate(x, y, middle)
            names[section] = frame.nearest_lane(section, middle, t, given)
        return names

    def _ends(self, lane: NetLane, frame: RoadFrame) -> tuple[float, float]:
        """Stations at which SUMO's shape of a lane begins and ends."""
        shape = self._map_shape(lane)
        along = distances_along(shape)
        half = 0.5 * along[-1]
        x, y = (float(np.interp(half, along, shape[:, axis])) for axis in (0, 1))
        sense = -1.0 if lane.origin is None else float(frame.road.travel(lane.origin[1]))
        # From the middle outwards: on a closed loop, begin and end are the same point.
        middle = frame.locate(x, y)[0]
        (x0, y0), (x1, y1) = shape[0].tolist(), shape[-1].tolist()
        first = frame.locate(x0, y0, middle - sense * half)[0]
        last = frame.locate(x1, y1, middle + sense * half)[0]
        if sense * (last - first) <= 0.0:
            last = first + sense * max(float(along[-1]), 1e-3)
        return first, last

    def _map_shape(self, lane: NetLane) -> FloatArray:
        return lane.shape - np.asarray(self._net.offset)

    def _half_step(self, stretch: Stretch, neighbor: str | None, end: int) -> FloatArray | None:
        """Displacement of a lane's end so that it meets its neighbor; None if it does not move."""
        other = None if neighbor is None else self.stretch(neighbor)
        if other is None or other.frame is stretch.frame:
            return None
        # SUMO's lanes end some meters before the roads do; the roads' ends meet.
        return half_step(stretch.road_end(end), other.road_end(-1 - end))

    def _at_inside(self, lane: NetLane, part: FloatArray, offset: FloatArray) -> SurfacePoint:
        connection, low, high = self.inside[lane.id]
        start = self.at(connection.start, self.lanes[connection.start].length)
        end = self.at(connection.end, 0.0)
        u = low + part * (high - low)
        stretch = self.stretch(lane.id)
        if stretch is None:
            point = joint(start, end, u)
        else:
            chain = [name for name, other in self.inside.items() if other.connection is connection]
            point = stretch.frame.evaluate(stretch.lanes, stretch.s_at(part))
            first, last = self.stretch(chain[0]), self.stretch(chain[-1])
            given_start = None if first is None else first.lane_end(0)
            given_end = None if last is None else last.lane_end(-1)
            point = moved(point, u, start, given_start, end, given_end)
        if not np.any(offset):
            return point
        sine, cosine = np.sin(point.heading), np.cos(point.heading)
        return point._replace(
            x=point.x - offset * sine,
            y=point.y + offset * cosine,
            z=point.z + offset * np.tan(point.bank),
        )
