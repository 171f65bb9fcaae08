"""OpenDRIVE maps and the routes through them.

A route gives position, height, grade, lanes and friction along the ego's direction of travel to
every other part of the project.
"""

from __future__ import annotations

import copy
import math
from bisect import bisect_right
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike

from iits_mj.core.arrays import FloatArray
from iits_mj.core.checks import in_range, positive
from iits_mj.core.errors import InputError
from iits_mj.road.chain import LinkError, join
from iits_mj.road.elements import DEFAULT_FRICTION, OpenDriveMap, Road, RoadMark
from iits_mj.road.lanes import (
    FrictionPatch,
    LaneBand,
    RouteLane,
    RouteSegment,
    facing_signals,
    keeps_right,
    lane_bands,
    overtaking_bans,
    structure_spans,
)
from iits_mj.road.map_cache import SIZE_MIN, MapCache
from iits_mj.road.opendrive import parse
from iits_mj.road.polynomials import PiecewiseCubic
from iits_mj.road.reference_line import KNOT_SPACING, ReferenceLine, RoadPoint
from iits_mj.road.road_graph import RoadGraph
from iits_mj.road.route_choice import Choice, choose
from iits_mj.road.seams import ContinuousChain
from iits_mj.road.straight import straight_road
from iits_mj.road.unevenness import SMOOTH, Unevenness
from iits_mj.road.xml_input import content_hash, read_file

Stations = TypeVar("Stations", float, FloatArray)
Terms = tuple[tuple[float, PiecewiseCubic], ...]

MAPS = Path(__file__).resolve().parent / "maps"
# Beyond about 0.12 rad a slow laden truck tips or slides to the inside.
SUPERELEVATION_LIMIT = 0.10
# A lane narrower than this is still opening or closing, and not used.
USABLE_LANE_WIDTH = 2.0
GRADE_WINDOW = 40.0
# Links that a search may find impossible before it ends.
LINKS_CUT_MAX = 50
TABLE_COLUMNS = (*RoadPoint._fields, "friction_left", "friction_right", "friction_split")


# The records of the last map that is not in the cache, by hash and name: a drive reads its map
# several times.
_LAST: dict[tuple[str, str], tuple[OpenDriveMap, RoadGraph]] = {}


class RoadMap:
    """A map: its roads, and chains of them to drive on.

    Attributes:
      path: the file, or a name in words for a road made in memory.
      name: of the map in messages: the path, or the file from which that one was made.
      roads: by id, in the order of the file.
      content_hash: SHA-256 of the file.
      left_hand: whether vehicles drive on the left.
    """

    def __init__(
        self,
        content: OpenDriveMap,
        path: str | Path,
        digest: str | None = None,
        name: str | None = None,
    ) -> None:
        """Takes parsed records; use `from_opendrive` for a file."""
        digest = content_hash(repr(content).encode()) if digest is None else digest
        name = str(Path(path)) if name is None else name
        self._fill(path, digest, name, content, RoadGraph(content, name))

    @classmethod
    def from_opendrive(cls, path: str | Path, name: str | None = None) -> RoadMap:
        """Reads an OpenDRIVE file; a large one that was read before comes from the cache.

        Args:
          path: of the file.
          name: of the map in messages; by default the path.

        Raises:
          MapError: it cannot be used; the message names file, road and reason.
        """
        content = read_file(Path(path))
        digest = content_hash(content)
        name = str(Path(path)) if name is None else name
        cache = MapCache(digest, name) if len(content) >= SIZE_MIN else None
        state = cache.recall("map") if cache else _LAST.get((digest, name))
        if state is None:
            parsed = parse(content, name)
            state = parsed, RoadGraph(parsed, name)
            if cache:
                cache.keep("map", state)
            else:
                _LAST.clear()
                _LAST[digest, name] = state
        made = cls.__new__(cls)
        made._fill(path, digest, name, *state)
        made._cache = cache
        return made

    def _fill(
        self, path: str | Path, digest: str, name: str, content: OpenDriveMap, graph: RoadGraph
    ) -> None:
        self.path, self.name = Path(path), name
        self.content = content
        self.roads: dict[str, Road] = {road.id: road for road in content.roads}
        self.content_hash = digest
        self.left_hand = any(road.left_hand for road in content.roads)
        self._graph = graph
        self._cache: MapCache | None = None

    @classmethod
    def builtin(cls) -> RoadMap:
        """Returns the built-in highway of 15 km; its SUMO net is `highway.net.xml` beside it."""
        return cls.from_opendrive(MAPS / "highway.xodr")

    def route(
        self,
        start: str | None = None,
        superelevation_limit: float = SUPERELEVATION_LIMIT,
        knot_spacing: float = KNOT_SPACING,
        along: str | None = None,
    ) -> Route:
        """Returns a chain of roads as one road.

        Args:
          start: "ID" or "ID:-1" of the first road; by default the longest chain of the map.
          superelevation_limit: a route whose cross slope exceeds it anywhere [rad] has all its
            cross slopes scaled down to it, because a truck would tip over.
          knot_spacing: of the reference line's samples [m].
          along: the route in words, in place of `start`; see `route_choice`.

        Raises:
          InputError: `along` describes no route of this map.
          MapError: no drivable road, or no such start.
        """
        if start is not None and along is not None:
            raise InputError("a route has a start or a description, not both")
        if self._cache is None:
            return self._search(start, along, superelevation_limit, knot_spacing)
        what = f"route {start} {along} {superelevation_limit} {knot_spacing}"
        shared = {"map": self} | {f"road {name}": road for name, road in self.roads.items()}
        found = self._cache.recall(what, shared)
        if found is None:
            route = self._search(start, along, superelevation_limit, knot_spacing)
            self._cache.keep(what, (route, self._graph.notes), shared)
            return route
        made: Route = found[0]
        self._graph.notes = found[1]
        return made

    def _search(
        self, start: str | None, along: str | None, superelevation_limit: float, knot_spacing: float
    ) -> Route:
        for _ in range(LINKS_CUT_MAX):
            try:
                return self._route(start, along, superelevation_limit, knot_spacing)
            except LinkError as error:
                self._graph.cut(error)
        return self._route(start, along, superelevation_limit, knot_spacing)

    def unusable(self) -> frozenset[str]:
        """Returns the ids of the roads that are too tight or too steep for a truck."""
        return frozenset(node[0] for node in self._graph.nodes if self._graph.obstacle(node))

    @property
    def notes(self) -> tuple[str, ...]:
        """Parts of the file that are not used, in words."""
        return (*self.content.notes, *dict.fromkeys(self._graph.notes))

    def _route(
        self, start: str | None, along: str | None, superelevation_limit: float, knot_spacing: float
    ) -> Route:
        source = self.name
        if along is None:
            choice = Choice(self._graph.chain(start), None)
        else:
            choice = choose(self._graph, along)
        pieces = join(self.roads, choice.chain, source)
        steepest = max(piece.steepest() for piece in pieces)
        notes, scale = self.notes, 1.0
        if steepest > superelevation_limit:
            scale = superelevation_limit / steepest
            notes = (
                *notes,
                f"cross slopes up to {math.degrees(steepest):.1f} degrees are scaled down to "
                f"{math.degrees(superelevation_limit):.1f}, at which a truck stays upright",
            )
        route = Route(self, ContinuousChain(pieces, source, scale), knot_spacing, notes)
        if choice.start is not None:
            route.start = float(
                np.clip(route.line.station(pieces[0].p_at(choice.start)), 0.0, route.length)
            )
        return route


class Route:
    """A chain of roads as one continuous road. Stations beyond the ends extend along tangents.

    Attributes:
      road_map: the map it runs through.
      length: [m], horizontal.
      segments: the roads in the order of travel.
      tunnels, bridges: (start, end) stations of each.
      signals: signs and lights that face the route, by station.
      overtaking_bans: (start, end) stations of stretches where signs forbid trucks to overtake.
      cross_slope: fall to the right in addition to that of the map [rad].
      unevenness: of the surface below the truck's tires; heights and grades of the route are those
        of the smooth road.
      notes: unused or changed parts of the map, in words.
      start: station where a drive begins unless it says otherwise; None where no point says so.
    """

    def __init__(
        self,
        road_map: RoadMap,
        chain: ContinuousChain,
        knot_spacing: float = KNOT_SPACING,
        notes: tuple[str, ...] = (),
    ) -> None:
        """Use `RoadMap.route` or `Route.straight`."""
        self.road_map = road_map
        self.line = ReferenceLine(chain, knot_spacing)
        self.length = self.line.length
        self.chain = chain
        self.notes = notes
        self.start: float | None = None
        self.patches: tuple[FrictionPatch, ...] = ()
        self.cross_slope = 0.0
        self.unevenness: Unevenness = SMOOTH
        self._bands = [band for piece in chain.pieces for band in lane_bands(piece)]
        self._starts = [band.p_start for band in self._bands]
        # The last place that was asked for: its station, lanes, parameter and lanes' edges.
        self._last: tuple[float, LaneBand, float] = math.nan, self._bands[0], 0.0
        self._edges: tuple[float, list[tuple[float, float]]] = math.nan, []
        starts = [float(self.line.station(piece.p_start)) for piece in chain.pieces]
        self.segments = tuple(
            RouteSegment(piece.road.id, piece.direction, piece.s_start, piece.s_end, start)
            for piece, start in zip(chain.pieces, starts, strict=True)
        )
        values = {
            value for band in self._bands for lane in band.lanes for value in lane.friction.values
        }
        self._uniform_friction = values.pop() if len(values) == 1 else None
        self.tunnels = structure_spans(chain.pieces, self.line, "tunnel")
        self.bridges = structure_spans(chain.pieces, self.line, "bridge")
        self.signals = facing_signals(chain.pieces, self.line)
        self.overtaking_bans = overtaking_bans(self.signals)

    @classmethod
    def straight(
        cls,
        length: float = 1e5,
        lanes: int = 3,
        lane_width: float = 4.0,
        speed_limit: float = 25.0,
        grade: float = 0.0,
        friction: float = DEFAULT_FRICTION,
    ) -> Route:
        """A straight road along x from the origin, of constant grade; needs no map.

        Raises:
          InputError: a value is out of range.
        """
        content = straight_road(length, lanes, lane_width, speed_limit, grade, friction)
        return RoadMap(content, f"straight road of {length:g} m").route(knot_spacing=100.0)

    @property
    def keep_right(self) -> bool:
        """Whether the map says that vehicles keep right, see `lanes.keeps_right`."""
        return keeps_right(self.chain.pieces)

    def evaluate(self, station: ArrayLike, offset: ArrayLike = 0.0) -> RoadPoint:
        """Points of the road surface; z = z_ref + offset * tan(superelevation)."""
        return self.line.evaluate(station, offset)

    def heading(self, station: FloatArray) -> FloatArray:
        """Headings of travel along the reference line [rad]; see `RoadPoint`."""
        return self.line.heading(station)

    def locate(self, x: float, y: float, near_station: float | None = None) -> tuple[float, float]:
        """(station, offset) of a point of the map; see `ReferenceLine.locate`."""
        return self.line.locate(float(x), float(y), near_station)

    def smoothed_grade(self, station: Stations) -> Stations:
        """Mean grade over 40 m about a station, for planning."""
        if isinstance(station, float):
            return self.line.mean_grade(station, GRADE_WINDOW)
        half = 0.5 * GRADE_WINDOW
        ahead = self.line.evaluate(station + half).z
        return (ahead - self.line.evaluate(station - half).z) / GRADE_WINDOW

    @property
    def bands(self) -> tuple[LaneBand, ...]:
        """The stretches of road with one set of lanes, in the order of travel."""
        return tuple(self._bands)

    def lane_count(self, station: float) -> int:
        """Number of driving lanes of the lane section here, opening and closing ones included."""
        return len(self._band(station)[0].lanes)

    def lane_exists(self, lane: int, station: float) -> bool:
        """Whether a lane exists and is at least 2 m wide."""
        band, p = self._band(station)
        if not 0 <= lane < len(band.lanes):
            return False
        chosen = band.lanes[lane]
        return chosen.left.at(p) - chosen.right.at(p) >= USABLE_LANE_WIDTH

    def lane_offset(self, lane: int, station: Stations) -> Stations:
        """Offset of a lane's center [m]; of the nearest lane where there is no such lane."""

        def center(band: LaneBand) -> Terms:
            chosen = _lane(band, lane)
            return (0.5, chosen.left), (0.5, chosen.right)

        return self._profile(station, center)

    def lane_width(self, lane: int, station: Stations) -> Stations:
        """Width of a lane [m]; of the nearest lane where there is no such lane."""

        def width(band: LaneBand) -> Terms:
            chosen = _lane(band, lane)
            return (1.0, chosen.left), (-1.0, chosen.right)

        return self._profile(station, width)

    def boundary_offset(self, i: int, station: Stations) -> Stations:
        """Offset of the i-th lane boundary from the outside, 0 to `lane_count` [m]."""
        return self._profile(station, lambda band: ((1.0, band.boundary(i)),))

    def boundary_mark(self, i: int, station: float) -> RoadMark:
        """Paint on the i-th boundary from the outside: kind ("none", "solid" ...) and width."""
        band, p = self._band(station)
        return band.marks[min(max(i, 0), len(band.lanes))].at(p)

    def surface_edges(self, station: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Offsets of the paved surface's right and left edge, both directions and shoulders [m]."""
        station = np.asarray(station, dtype=float)
        right = self._profile(station, lambda band: ((1.0, band.right_edge),))
        left = self._profile(station, lambda band: ((1.0, band.left_edge),))
        return np.asarray(right), np.asarray(left)

    def lane_at(self, station: float, offset: float) -> int:
        """Index of the lane that covers an offset; -1 outside every driving lane."""
        known, edges = self._edges
        if known != station:
            band, p = self._band(station)
            edges = [(lane.right.at(p), lane.left.at(p)) for lane in band.lanes]
            self._edges = station, edges
        for index, (right, left) in enumerate(edges):
            if right <= offset < left:
                return index
        return -1

    def speed_limit(self, station: float, lane: int = 0) -> float:
        """Limit of a lane [m/s]: the lane's own, else the road's; infinite where unlimited."""
        band, p = self._band(station)
        return _lane(band, lane).speed.at(p)

    def lane_boundaries_at(self, station: float) -> list[float]:
        """Offsets of all lane boundaries here, from the outside [m]."""
        band, p = self._band(station)
        return [band.boundary(i).at(p) for i in range(len(band.lanes) + 1)]

    def section_starts(self) -> list[float]:
        """Stations where the set of lanes may change, the first being 0."""
        return [float(self.line.station(band.p_start)) for band in self._bands]

    def friction(self, station: float, offset: float) -> float:
        """Coefficient of friction of the road surface."""
        left, right, split = self._friction_row(station)
        return left if offset >= split else right

    def with_friction(
        self,
        left: float,
        right: float | None = None,
        split: float = 0.0,
        start: float = -np.inf,
        end: float = np.inf,
    ) -> Route:
        """Returns the route with another friction over [start, end), possibly split at an offset.

        Raises:
          InputError: a coefficient outside [0, 2].
        """
        right = left if right is None else right
        for value in (left, right):
            in_range("friction", value, 0.0, 2.0)
        other = copy.copy(self)
        other.patches = (*self.patches, FrictionPatch(start, end, left, right, split))
        return other

    def with_unevenness(self, unevenness: Unevenness) -> Route:
        """Returns the route with an uneven surface below the truck's tires."""
        other = copy.copy(self)
        other.unevenness = unevenness
        return other

    def with_cross_slope(self, slope: float) -> Route:
        """Returns the route with a cross slope in addition to that of the map.

        Args:
          slope: fall to the right of travel [rad], about the reference line.

        Raises:
          InputError: the route would be steeper than a truck can bear.
        """
        steepest = float(np.max(np.abs(self.line.superelevations + slope)))
        if not steepest <= SUPERELEVATION_LIMIT + 1e-9:
            raise InputError(
                f"cross slope {slope:g} rad: with that of the map the road leans by up to "
                f"{steepest:.3f} rad; use at most {SUPERELEVATION_LIMIT:g} rad in all"
            )
        other = copy.copy(self)
        other.line = self.line.leaning(slope)
        other.cross_slope = self.cross_slope + slope
        return other

    def table(self, step: float = 1.0) -> FloatArray:
        """Returns the surface for the physics, shape (n, 10), at stations i * step to the end.

        Columns are `TABLE_COLUMNS`: x, y, z, heading (continuous), curvature, grade,
        superelevation, and friction left and right of the offset `friction_split`.

        Raises:
          InputError: step is not positive.
        """
        positive("step of the table", step, "m")
        station = np.arange(int(np.ceil(self.length / step - 1e-9)) + 1) * step
        point = self.line.evaluate(station)
        if self._uniform_friction is None or self.patches:
            friction = np.array([self._friction_row(float(s)) for s in station])
        else:
            value = self._uniform_friction
            friction = np.tile([value, value, 0.0], (station.size, 1))
        return np.column_stack((*point, friction))

    def _band(self, station: float) -> tuple[LaneBand, float]:
        station, (last, band, p) = float(station), self._last
        if last != station:
            inside = min(max(station, 0.0), self.length)
            p = self.line.parameter_at(inside)
            band = self._bands[max(bisect_right(self._starts, p) - 1, 0)]
            self._last = station, band, p
        return band, p

    def _profile(self, station: Stations, terms: Callable[[LaneBand], Terms]) -> Stations:
        """Weighted sum of profiles at one station or at an array of them."""
        if isinstance(station, (float, int)):
            band, p = self._band(station)
            return float(sum(weight * profile.at(p) for weight, profile in terms(band)))
        p_array = self.line.parameter(np.clip(np.asarray(station, dtype=float), 0.0, self.length))
        index = np.maximum(np.searchsorted(self._starts, p_array, side="right") - 1, 0)
        result = np.empty_like(p_array)
        for i in np.unique(index):
            chosen = index == i
            places = p_array[chosen]
            result[chosen] = sum(
                weight * profile.evaluate(places) for weight, profile in terms(self._bands[i])
            )
        return result

    def _friction_row(self, station: float) -> tuple[float, float, float]:
        for patch in reversed(self.patches):
            if patch.start <= station < patch.end:
                return patch.left, patch.right, patch.split
        band, p = self._band(station)
        lanes = band.lanes[::-1] if band.piece.road.left_hand else band.lanes
        right = lanes[0].friction.at(p)
        for lane in lanes[1:]:
            left = lane.friction.at(p)
            if left != right:
                return left, right, lane.right.at(p)
        return right, right, 0.0


def _lane(band: LaneBand, lane: int) -> RouteLane:
    return band.lanes[min(max(lane, 0), len(band.lanes) - 1)]
