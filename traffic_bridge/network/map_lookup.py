"""Converts map points to road, lane, station and offset and to SUMO's lanes, and back."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from iits_mj.core.angles import wrap_angle
from iits_mj.core.errors import InputError
from iits_mj.road.elements import DRIVING_TYPES
from iits_mj.road.road_frames import RoadFrame, RoadFrames
from traffic_bridge.network.lane_surface import LaneSurfaces, Stretch
from traffic_bridge.network.net_file import NetLane

NEAR = 5.0  # [m] beyond a lane's end within which a point of its road belongs to the lane
SAMPLE_SPACING = 5.0  # [m] between the reference lines' points in the spatial index
END_TOLERANCE = 0.5  # [m] by which a point may lie beyond its road's end: roads leave small gaps
HEADING_WEIGHT = 5.0  # [m/rad]: penalty of a wrong heading in the choice of a lane


@dataclass(frozen=True)
class Place:
    """A place on a map.

    Attributes:
      road: OpenDRIVE's road id; lane: OpenDRIVE's lane id, negative on the right.
      station: along the road's reference line, OpenDRIVE's s [m].
      offset: to the left of the lane's center, in the lane's direction of travel [m].
      junction: OpenDRIVE's junction id where the road lies in one, else "".
      edge, sumo_lane: SUMO's; "" where SUMO has no lane, as on a shoulder.
      position: along SUMO's lane [m]; NaN where there is none.
    """

    road: str
    lane: int
    station: float
    offset: float = 0.0
    junction: str = ""
    edge: str = ""
    sumo_lane: str = ""
    position: float = math.nan


class MapPoint(NamedTuple):
    """A point of the road's surface: x, y, z [m], heading of travel [rad], grade, bank [rad]."""

    x: float
    y: float
    z: float
    heading: float
    grade: float
    bank: float


class MapLookup:
    """Finds the places of a map by points, and points by places.

    Attributes:
      frames: of the map's roads; surfaces: of SUMO's lanes.
    """

    def __init__(self, frames: RoadFrames, surfaces: LaneSurfaces) -> None:
        self.frames = frames
        self.surfaces = surfaces
        self._lane_index = LaneIndex(surfaces)

    def locate(
        self, x: float, y: float, heading: float | None = None, z: float | None = None
    ) -> Place | None:
        """The place of a point, or None if it lies on no road.

        Where roads overlap (in junctions, at bridges), height and heading decide if they are given,
        then the nearest lane center.

        Args:
          x: map frame [m].
          y: map frame [m].
          heading: of travel [rad].
          z: map frame [m].

        Raises:
          InputError: a number is not finite.
        """
        for value in (x, y, heading or 0.0, z or 0.0):
            if not math.isfinite(value):
                raise InputError(f"a point to locate must be finite, not {value!r}")
        best: tuple[tuple[float, ...], Place] | None = None
        for order, road, near in self._near(x, y):
            frame = self.frames[road]
            s, t = frame.locate(x, y, near)
            beyond = max(-s, s - frame.length, 0.0)
            if beyond > END_TOLERANCE:
                continue
            s = min(max(s, 0.0), frame.length)
            for lane, low, high in frame.lanes(s):
                if not low <= t <= high:
                    continue
                rank, offset = self._rank(frame, lane, s, t, heading, z)
                key = (*rank[:2], beyond > 1e-3, *rank[2:], order, lane)
                if best is None or key < best[0]:
                    best = key, Place(road, lane, s, offset)
        return None if best is None else self._complete(best[1])

    def place(self, road: str, lane: int, station: float, offset: float = 0.0) -> Place:
        """The place at a station of a road's lane.

        Raises:
          InputError: there is no such road or lane, or the station is not on the road.
        """
        return self._complete(Place(road, lane, self._check(road, lane, station, offset), offset))

    def place_on(self, sumo_lane: str, position: float, offset: float = 0.0) -> Place:
        """The place at a position of a SUMO lane.

        Raises:
          InputError: there is no such lane, or the position is not on it.
        """
        lane = self.surfaces.lane(sumo_lane)
        if not (math.isfinite(position) and 0.0 <= position <= lane.length):
            raise InputError(
                f"position {position!r} m on lane {sumo_lane!r}: allowed is 0 to {lane.length:g}"
            )
        stretch = self.surfaces.stretch(sumo_lane)
        s = math.nan if stretch is None else float(stretch.s_at(position / lane.length))
        if stretch is None or not 0.0 <= s <= stretch.frame.length:
            # SUMO's own joint, or a junction that extends into the adjacent roads.
            point = self.surfaces.at(sumo_lane, position, offset)
            x, y, z, heading = (float(value[0]) for value in point[:4])
            found = self.locate(x, y, heading, z)
            if found is None:
                raise InputError(f"lane {sumo_lane!r} at {position:g} m lies beside every road")
            return replace(found, edge=lane.edge, sumo_lane=sumo_lane, position=position)
        frame = stretch.frame
        section = min(max(frame.section(s), min(stretch.lanes)), max(stretch.lanes))
        return Place(
            road=frame.road.id,
            lane=stretch.lanes[section],
            station=s,
            offset=offset,
            junction=frame.road.junction or "",
            edge=lane.edge,
            sumo_lane=sumo_lane,
            position=position,
        )

    def point(self, place: Place) -> MapPoint:
        """The point of the road's surface at a place; the inverse of `locate`.

        Raises:
          InputError: there is no such road or lane, or the station is not on the road.
        """
        s = self._check(place.road, place.lane, place.station, place.offset)
        frame = self.frames[place.road]
        point = frame.evaluate({frame.section(s): place.lane}, s, place.offset)
        return MapPoint(*(float(column[0]) for column in point))

    def _rank(
        self,
        frame: RoadFrame,
        lane: int,
        s: float,
        t: float,
        heading: float | None,
        z: float | None,
    ) -> tuple[tuple[float, ...], float]:
        """Rank of a place by height, kind of lane and distance (0 is best); offset in the lane."""
        sense = float(frame.road.travel(lane))
        offset = sense * (t - frame.center_at(lane, s))
        turned, height = 0.0, 0.0
        if heading is not None or z is not None:
            point = frame.line.evaluate(float(frame.line.station(s)), t)
            if heading is not None:
                against = 0.0 if sense > 0.0 else math.pi
                turned = abs(wrap_angle(heading - float(point.heading) - against))
            if z is not None:
                # Decks of a bridge are meters apart; below 1 m it is the same surface.
                height = float(math.floor(abs(z - float(point.z))))
        other = 0.0 if frame.kind(s, lane) in DRIVING_TYPES else 1.0
        return (height, other, abs(offset) + HEADING_WEIGHT * turned), offset

    def _complete(self, place: Place) -> Place:
        """The place with SUMO's edge, lane and position."""
        name, position = self._lane_index.lane_of(place.road, place.lane, place.station)
        road = self.frames[place.road].road
        edge = self.surfaces.lanes[name].edge if name else ""
        return replace(
            place, junction=road.junction or "", edge=edge, sumo_lane=name, position=position
        )

    def _check(self, road: str, lane: int, station: float, offset: float) -> float:
        roads = self.frames.road_map.roads
        if road not in roads:
            raise InputError(f"no road {road!r} on the map; there are {', '.join(list(roads)[:8])}")
        frame = self.frames[road]
        if not (math.isfinite(station) and 0.0 <= station <= frame.length):
            raise InputError(
                f"station {station!r} m of road {road!r}: allowed is 0 to {frame.length:g}"
            )
        if not math.isfinite(offset):
            raise InputError(f"offset {offset!r} m: must be finite")
        lanes = [number for number, _, _ in frame.lanes(station)]
        if lane not in lanes:
            raise InputError(
                f"no lane {lane!r} of road {road!r} at station {station:g}; there are {lanes}"
            )
        return float(station)

    def _near(self, x: float, y: float) -> list[tuple[int, str, float]]:
        """(order, road, station near the point) of every stretch of road that may cover a point.

        A closed road, or one that crosses itself, has several stretches near a point.
        """
        tree, roads, stations, reach = self._index
        names = list(self.frames.road_map.roads)
        found: list[tuple[int, str, float]] = []
        last, nearest = (-1, -math.inf), math.inf
        # The samples are in the order of the roads and their stations.
        for k in sorted(tree.query_ball_point((x, y), reach)):
            away = math.hypot(*(tree.data[k] - (x, y)))
            road, station = int(roads[k]), float(stations[k])
            if road != last[0] or station - last[1] > 2.0 * SAMPLE_SPACING:
                found.append((road, names[road], station))
                nearest = away
            elif away < nearest:
                found[-1] = (road, names[road], station)
                nearest = away
            last = road, station
        return found

    @cached_property
    def _index(self) -> tuple[Any, np.ndarray, np.ndarray, float]:
        """Tree of reference-line points, their roads and stations, and the reach of a road [m]."""
        from scipy.spatial import cKDTree

        points, roads, stations, widest = [], [], [], 0.0
        for order, name in enumerate(self.frames.road_map.roads):
            frame = self.frames[name]
            s = np.linspace(0.0, frame.length, max(math.ceil(frame.length / SAMPLE_SPACING), 1) + 1)
            line = frame.surface(s, np.zeros_like(s))
            points.append(np.column_stack((line.x, line.y)))
            roads.append(np.full(s.size, order))
            stations.append(s)
            for place in s:
                borders = [t for _, low, high in frame.lanes(float(place)) for t in (low, high)]
                widest = max([widest, *map(abs, borders)])
        reach = widest + SAMPLE_SPACING + END_TOLERANCE
        return (
            cKDTree(np.concatenate(points)),
            np.concatenate(roads),
            np.concatenate(stations),
            reach,
        )


class _Covered(NamedTuple):
    """Stations of a road covered by a SUMO lane; `parts` of the lane if it has no stretch."""

    low: float
    high: float
    lane: str
    parts: tuple[float, float] | None = None


class LaneIndex:
    """SUMO's lanes by road, OpenDRIVE lane and station."""

    def __init__(self, surfaces: LaneSurfaces) -> None:
        self._surfaces = surfaces

    def lane_of(self, road: str, lane: int, s: float) -> tuple[str, float]:
        """SUMO lane and position at a station of a road's lane; ("", nan) without a SUMO lane."""
        starts, rows = self._index.get((road, lane), ([], []))
        k = bisect_right(starts, s)
        best: _Covered | None = None
        distance = NEAR
        for row in rows[max(k - 2, 0) : k + 1]:
            away = max(row.low - s, s - row.high, 0.0)
            if away < distance:
                best, distance = row, away
        if best is None:
            return "", math.nan
        inside = min(max(s, best.low), best.high)
        if best.parts is None:
            stretch = self._surfaces.stretch(best.lane)
            part = 0.0 if stretch is None else stretch.part_at(inside)
        else:
            part = float(np.interp(inside, (best.low, best.high), best.parts))
        return best.lane, part * self._surfaces.lanes[best.lane].length

    @cached_property
    def _index(self) -> dict[tuple[str, int], tuple[list[float], list[_Covered]]]:
        rows: dict[tuple[str, int], list[_Covered]] = {}
        for lane in self._surfaces.lanes.values():
            stretch = self._surfaces.stretch(lane.id)
            if stretch is not None:
                low, high = sorted((float(stretch.s[0]), float(stretch.s[-1])))
                first, last = min(stretch.lanes), max(stretch.lanes)
                for section, number in stretch.lanes.items():
                    start, end = stretch.frame.span(section)
                    start = low if section == first else start
                    end = high if section == last else end
                    key = (stretch.frame.road.id, number)
                    rows.setdefault(key, []).append(_Covered(start, end, lane.id))
            if lane.id in self._surfaces.inside:
                for key, row in self._overhangs(lane, stretch):
                    rows.setdefault(key, []).append(row)
        index = {}
        for key, found in rows.items():
            found.sort(key=lambda row: (row.low, row.high, row.lane))
            index[key] = ([row.low for row in found], found)
        return index

    def _overhangs(
        self, lane: NetLane, stretch: Stretch | None
    ) -> Iterator[tuple[tuple[str, int], _Covered]]:
        """The parts of the adjacent roads that a lane inside a junction covers.

        SUMO's junctions extend some meters into the adjacent roads.
        """
        connection, low, high = self._surfaces.inside[lane.id]
        before = self._surfaces.stretch(connection.start)
        after = self._surfaces.stretch(connection.end)
        if before is None or after is None:
            return
        if stretch is None:
            if before.frame is after.frame:
                # Where a road closes to a loop, the joint covers no part of it.
                covered = before.sense * (float(after.s[0]) - float(before.s[-1]))
                if covered > 1e-6:
                    yield _beyond(before, True, covered, lane.id, (0.0, 1.0))
            return
        begins, ends = float(stretch.s[0]), float(stretch.s[-1])
        road = (0.0, stretch.frame.length) if stretch.sense > 0 else (stretch.frame.length, 0.0)
        early, late = stretch.sense * (road[0] - begins), stretch.sense * (ends - road[1])
        if low == 0.0 and early > 1e-6:
            yield _beyond(before, True, early, lane.id, (0.0, stretch.part_at(road[0])))
        if high == 1.0 and late > 1e-6:
            yield _beyond(after, False, late, lane.id, (stretch.part_at(road[1]), 1.0))


def _beyond(
    stretch: Stretch, end: bool, covered: float, lane: str, parts: tuple[float, float]
) -> tuple[tuple[str, int], _Covered]:
    """The part of a stretch's road beyond the stretch that another lane covers.

    Args:
      stretch: of the road's own lane.
      end: True for the part beyond its end, False for the part before its beginning.
      covered: length of road [m].
      lane: the other lane.
      parts: fractions of the other lane, in the direction of travel.
    """
    near = float(stretch.s[-1] if end else stretch.s[0])
    far = near + stretch.sense * (covered if end else -covered)
    rising = stretch.sense > 0
    section = (max if rising == end else min)(stretch.lanes)
    row = _Covered(min(near, far), max(near, far), lane, parts if rising else parts[::-1])
    return (stretch.frame.road.id, stretch.lanes[section]), row
