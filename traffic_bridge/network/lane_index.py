"""Which of SUMO's lanes lies at a place of a road."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Iterator
from functools import cached_property

import numpy as np

from traffic_bridge.network.lane_stretch import Row, Stretch
from traffic_bridge.network.lane_surface import LaneSurfaces
from traffic_bridge.network.net_file import NetLane

NEAR = 5.0  # [m] beyond a lane's end at which a place of its road still counts to it


class LaneIndex:
    """SUMO's lanes by road, OpenDRIVE lane and station."""

    def __init__(self, surfaces: LaneSurfaces) -> None:
        self._surfaces = surfaces

    def lane_of(self, road: str, lane: int, s: float) -> tuple[str, float]:
        """SUMO lane and position of a place of the road; ("", nan) where SUMO has no lane."""
        starts, rows = self._index.get((road, lane), ([], []))
        k = bisect_right(starts, s)
        best: Row | None = None
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
    def _index(self) -> dict[tuple[str, int], tuple[list[float], list[Row]]]:
        rows: dict[tuple[str, int], list[Row]] = {}
        for lane in self._surfaces.lanes.values():
            stretch = self._surfaces.stretch(lane.id)
            if stretch is not None:
                low, high = sorted((float(stretch.s[0]), float(stretch.s[-1])))
                first, last = min(stretch.lanes), max(stretch.lanes)
                for section, number in stretch.lanes.items():
                    start, end = stretch.frame.span(section)
                    start, end = (
                        low if section == first else start,
                        high if section == last else end,
                    )
                    key = (stretch.frame.road.id, number)
                    rows.setdefault(key, []).append(Row(start, end, lane.id))
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
    ) -> Iterator[tuple[tuple[str, int], Row]]:
        """What a lane inside a junction covers of the roads before and after it.

        SUMO's junctions reach some metres into the roads that meet there.
        """
        connection, low, high = self._surfaces.inside[lane.id]
        before, after = (
            self._surfaces.stretch(connection.start),
            self._surfaces.stretch(connection.end),
        )
        if before is None or after is None:
            return
        if stretch is None:
            if before.frame is after.frame:
                # Where a road closes to a loop the joint covers nothing of it.
                covered = before.sense * (float(after.s[0]) - float(before.s[-1]))
                if covered > 1e-6:
                    yield before.beyond(True, covered, lane.id, (0.0, 1.0))
            return
        begins, ends = float(stretch.s[0]), float(stretch.s[-1])
        road = (0.0, stretch.frame.length) if stretch.sense > 0 else (stretch.frame.length, 0.0)
        early, late = stretch.sense * (road[0] - begins), stretch.sense * (ends - road[1])
        if low == 0.0 and early > 1e-6:
            yield before.beyond(True, early, lane.id, (0.0, stretch.part_at(road[0])))
        if high == 1.0 and late > 1e-6:
            yield after.beyond(False, late, lane.id, (stretch.part_at(road[1]), 1.0))
