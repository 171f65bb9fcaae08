"""The map about a route: its other roads, sidewalks and junction areas.

Roads within `REACH` of the route are drawn with all their lanes. Where roads of a junction overlap
they get no paint, and the area between them is filled with asphalt.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from iits_mj.core.arrays import FloatArray
from iits_mj.model.scenery.corridor import Corridor, inner_stations, run_outs
from iits_mj.model.scenery.junction import Area, junction_areas
from iits_mj.model.scenery.materials import ASPHALT_TILE, GRASS_TILE
from iits_mj.model.scenery.paint import Hidden, markings
from iits_mj.model.scenery.streets import BARE, Footprints, Rows, Street, rows_across
from iits_mj.model.visuals.shapes import Shape, surface
from iits_mj.road import Route
from iits_mj.road.elements import PAVED_TYPES, Road

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

Parts = Iterator[tuple[str, Shape]]
Spans = list[tuple[float, float]]

REACH = 700.0  # [m] from the route up to which other roads and objects are drawn
ROUTE = ""  # name of the route among the streets
STEP_JUNCTION = 2.0  # [m] between the drawing stations of a road in a junction
SECTION_GAP = 0.02  # [m] from a change of lanes to the drawing stations about it
# The light of the sun is added to each surface: two in the same plane would be twice as bright. The
# route is on top; roads of a junction lie below it in layers.
ASPHALT_DROP = 0.02
STRIP_LIFT = 0.01  # [m] of lanes that vehicles do not use, above the pavement of the route
LAYER, LAYERS = 0.003, 20
CURB_HEIGHT = 0.05  # [m]; the shadow of a higher one is coarser than itself
BORDER_WIDTH = 3.0  # [m]; maps without terrain have wider ones, which are meadows
CLEARANCE = 3.0  # [m] of height over another road, from which a road is a bridge
BRIDGE_END = 25.0  # [m] that such a bridge is longer than the road below is wide
STUB = 25.0  # [m] of run-out below the trailer where there is no room for a long one
# Lanes without delineators and guard rails: those beside a sidewalk, or slower than this [m/s].
RIM = 0.5  # [m] beyond the edge of a street, where the ground is asked for
RURAL_SPEED = 19.0
# Material, and height above the road [m], by lane type; vehicles' lanes are asphalt.
_SURFACES = {
    "sidewalk": ("road_sidewalk", CURB_HEIGHT),
    "walking": ("road_sidewalk", CURB_HEIGHT),
    "curb": ("road_border", CURB_HEIGHT),
    "border": ("road_border", 0.0),
    "biking": ("road_cycle_lane", 0.0),
    "rail": ("road_gravel", 0.0),
    "tram": ("road_gravel", 0.0),
    "none": ("road_grass", 0.0),
    "median": ("road_grass", 0.0),
}
_TILES = {"road_asphalt": ASPHALT_TILE, "road_grass": GRASS_TILE}


@dataclass(frozen=True)
class Network:
    """The roads about a route.

    Attributes:
      route: the route of the truck.
      corridors: drawing stations by name of the street: the route's, and by road id.
      paved, full: places that are covered by vehicles' lanes, and by anything.
      bridges: stations over other roads, by name of the street.
      areas: of the junctions.
    """

    route: Route
    corridors: dict[str, Corridor]
    paved: Footprints
    full: Footprints
    bridges: dict[str, Spans]
    areas: list[Area]

    @property
    def others(self) -> dict[str, Corridor]:
        """Drawing stations of the roads off the route."""
        return {name: one for name, one in self.corridors.items() if name != ROUTE}

    def street(self, name: str) -> Street:
        """Returns a street by its name."""
        street = self.corridors[name].route
        assert isinstance(street, Street)
        return street

    def on_ground(self, name: str) -> Iterator[tuple[float, float]]:
        """Yields the intervals of a street's stations that are no bridge."""
        station = self.corridors[name].station
        cuts = [value for span in self.bridges[name] for value in span]
        edges = [float(station[0]), *cuts, float(station[-1])]
        for a, b in zip(edges[::2], edges[1::2], strict=True):
            if b - a > 1.0:
                yield a, b

    def ground_rows(self) -> Iterator[tuple[bool, float, Rows]]:
        """Yields the rows that shape the ground: whether they are the route's, first station."""
        for name in self.corridors:
            for a, b in self.on_ground(name):
                yield name == ROUTE, a, rows_across(self.street(name), a, b, paved=False)

    def covered(
        self, name: str, station: FloatArray, points: FloatArray, margin: float = 0.3
    ) -> NDArray[np.bool_]:
        """Whether vehicles' lanes of another road cover points (n, 3) of a street, (n,)."""
        return self._covered(self.paved, name, station, points, margin)

    def _covered(
        self,
        prints: Footprints,
        name: str,
        station: FloatArray,
        points: FloatArray,
        margin: float,
    ) -> NDArray[np.bool_]:
        if name != ROUTE:
            return prints.covered(name, points, margin)
        # A route may pass the same place twice, on other roads.
        segments = self.route.segments
        starts = np.array([segment.station_start for segment in segments])
        index = np.maximum(np.searchsorted(starts, station, side="right") - 1, 0)
        found = np.zeros(len(points), dtype=bool)
        for i in np.unique(index):
            chosen = index == i
            found[chosen] = prints.covered(segments[i].road_id, points[chosen], margin)
        return found

    def open_rim(self, name: str, part: Corridor, side: float) -> NDArray[np.bool_]:
        """Whether the ground beside the edge of a street is free of other surfaces, (n,)."""
        points = part.across(part.edge(side, RIM))
        covered = self._covered(self.full, name, part.station, points, 0.0)
        for area in self.areas:
            covered |= area.inside(points[:, :2])
        return ~covered

    def hides(self, name: str) -> Hidden:
        """Returns which places of a street get no paint, because another road crosses there."""
        return lambda station, points: self.covered(name, station, points)

    def is_free(self, points: FloatArray) -> NDArray[np.bool_]:
        """Whether a pier may stand at points of a bridge (n, 3): no road is below, (n,)."""
        return ~self.full.covered("no street", points, -1.5, CLEARANCE)

    def rural_parts(self, part: Corridor) -> Iterator[Corridor]:
        """Yields the stretches of the route that have delineators and guard rails."""
        street = self.street(ROUTE)
        start, end = float(part.station[0]), float(part.station[-1])
        for _, a, b in street.between(start, end):
            if b - a > 1.0 and self.is_rural(one := part.between(a, b - 1e-3)):
                yield one

    def is_rural(self, part: Corridor) -> bool:
        """Whether a stretch of the route has delineators and guard rails."""
        middle = 0.5 * float(part.station[0] + part.station[-1])
        street = self.street(ROUTE)
        for span, _, _ in street.between(middle - 1.0, middle + 1.0):
            beside = {lane.kind for lane in span.section.lanes} & {"sidewalk", "walking"}
            if beside or span.in_junction or span.piece.road.objects:
                return False
        if self.route.speed_limit(middle) < RURAL_SPEED:
            return False
        return all(self.open_rim(ROUTE, part, side).all() for side in (1.0, -1.0))


def network(route: Route) -> Network | None:
    """Returns the roads about a route; None where it is the only road, with nothing beside it."""
    from scipy.spatial import cKDTree

    roads = route.road_map.roads
    point = route.evaluate(np.arange(0.0, route.length + 20.0, 20.0))
    line = cKDTree(np.stack([point.x, point.y], axis=-1))
    used = {segment.road_id for segment in route.segments}
    near = {
        road.id: span
        for road in roads.values()
        if road.id not in used and (span := _near(line, road)) is not None
    }
    kinds = {lane.kind for one in used for section in roads[one].sections for lane in section.lanes}
    if not near and not kinds & (set(_SURFACES) - BARE):
        return None
    streets = {ROUTE: Street.of_route(route)}
    streets |= {identity: Street.of_road(roads[identity]) for identity in near}
    reaches = {ROUTE: (0.0, route.length), **near}

    def footprints(*, paved: bool) -> Footprints:
        rows = {name: rows_across(streets[name], *span, paved=paved) for name, span in near.items()}
        for i, segment in enumerate(route.segments):
            end = [*(one.station_start for one in route.segments[1:]), route.length][i]
            across = rows_across(streets[ROUTE], segment.station_start, end, paved=paved)
            rows[segment.road_id] = across
        return Footprints({name: row for name, row in rows.items() if row.half.max() > 0.1})

    paved, full = footprints(paved=True), footprints(paved=False)
    stations = {name: _stations(street, *reaches[name]) for name, street in streets.items()}
    behind, ahead = (np.arange(STUB, out + 1.0, STUB) for out in _run_outs(route, full))
    stations[ROUTE] = np.concatenate([-behind[::-1], stations[ROUTE], route.length + ahead])
    corridors = {name: Corridor.sample(streets[name], stations[name]) for name in streets}
    bridges = {name: _bridges(name, corridor, full) for name, corridor in corridors.items()}
    junctions = {one.id: one for one in route.road_map.content.junctions}
    drawn = {name: roads[name] for name in (*used, *near)}
    areas = junction_areas(junctions, drawn, paved)
    return Network(route, corridors, paved, full, bridges, areas)


def _near(line: cKDTree, road: Road) -> tuple[float, float] | None:
    """The interval of a road's s within `REACH` of points of the route, or None."""
    s = np.linspace(0.0, road.length, max(int(road.length / 20.0), 1) + 1)
    place = road.plan.evaluate(s)
    distance, _ = line.query(np.stack([place.x, place.y], axis=-1))
    inside = s[distance < REACH]
    if not inside.size:
        return None
    return max(float(inside[0]) - 20.0, 0.0), min(float(inside[-1]) + 20.0, road.length)


def _stations(street: Street, start: float, end: float) -> FloatArray:
    """Drawing stations in an interval; dense in junctions."""
    found = [inner_stations(street), np.array([start, end])]
    for span in street.spans:
        # Widths may step where the lanes change.
        found.append(np.array([span.start - SECTION_GAP, span.start + SECTION_GAP]))
        if span.in_junction:
            found.append(np.arange(span.start, span.end, STEP_JUNCTION))
    station = np.unique(np.concatenate(found))
    station = station[(station >= start) & (station <= end)]
    return station[np.concatenate([[True], np.diff(station) > 1e-3])]


def _run_outs(route: Route, full: Footprints) -> tuple[float, float]:
    """Lengths of the straight run-outs at both ends; short where they would meet other roads."""
    first, last = route.chain.pieces[0], route.chain.pieces[-1]
    links = (first.road.link(-first.direction), last.road.link(last.direction))
    starts, lengths = ((0.0, -1.0), (route.length, 1.0)), run_outs(route)
    found = []
    for (start, step), length, link, own in zip(
        starts, lengths, links, (first.road.id, last.road.id), strict=True
    ):
        tail = route.evaluate(start + step * np.arange(5.0, max(length, 10.0), 5.0))
        points = np.stack([tail.x, tail.y, tail.z], axis=-1)
        if link is not None and (link.element == "junction" or link.id in full.rows):
            found.append(0.0)
        else:
            found.append(STUB if full.covered(own, points, -12.0).any() else length)
    return found[0], found[1]


def _bridges(name: str, corridor: Corridor, full: Footprints) -> Spans:
    """Intervals over lower roads, with their ends."""
    first, last = float(corridor.station[0]), float(corridor.station[-1])
    row = Corridor.sample(corridor.route, np.arange(first, last, 2.0))
    over = np.zeros(row.station.shape, dtype=bool)
    for offset in (row.right, 0.5 * (row.right + row.left), row.left):
        over |= full.covered(name, row.across(offset), -1.0, CLEARANCE)
    spans: Spans = []
    for station in row.station[over].tolist():
        a, b = max(station - BRIDGE_END, first), min(station + BRIDGE_END, last)
        if spans and a <= spans[-1][1]:
            spans[-1] = (spans[-1][0], b)
        else:
            spans.append((a, b))
    return spans


def other_roads(found: Network) -> Iterator[tuple[FloatArray, str, Shape]]:
    """Yields (place, material, shape) of the roads off the route and of the junctions."""
    for number, (name, corridor) in enumerate(found.others.items()):
        middle = len(corridor.station) // 2
        place = corridor.across(0.5 * (corridor.left + corridor.right))[middle]
        layer = number % LAYERS if found.street(name).spans[0].in_junction else 0
        drop = ASPHALT_DROP + LAYER * layer
        for material, shape in (*lanes(found, name, drop), *_paint(found, name)):
            yield place, material, shape
    for area in found.areas:
        yield area.center, "road_asphalt", area.surface()


def _paint(found: Network, name: str) -> Parts:
    corridor = found.corridors[name]
    start, end = float(corridor.station[0]), float(corridor.station[-1])

    yield from markings(found.street(name), corridor, start, end, found.hides(name)).items()


def lanes(found: Network, name: str, drop: float = 0.0) -> Parts:
    """Surfaces of the lanes of a street, lowered by `drop` [m].

    Of the route only the lanes beside its pavement: sidewalks, and a carriageway beyond a median.
    """
    street, corridor = found.street(name), found.corridors[name]
    for span, a, b in street.between(float(corridor.station[0]), float(corridor.station[-1])):
        part = corridor.between(a, b - 1e-3)
        ids = [lane.id for lane in span.section.lanes if lane.kind not in BARE]
        for lane in span.section.lanes:
            if lane.id == 0 or not min(ids) <= lane.id <= max(ids):
                continue
            borders = [street.offset(span, i, part.station) for i in (lane.id, span.inner(lane))]
            part = replace(part, right=np.minimum(*borders), left=np.maximum(*borders))
            middle = 0.5 * (part.right + part.left)
            material, lift = _SURFACES.get(lane.kind, ("road_asphalt", 0.0))
            if lane.kind == "border" and np.median(part.left - part.right) > BORDER_WIDTH:
                material = "road_grass"
            kept = part.left - part.right > 0.05
            if lane.kind not in PAVED_TYPES:
                kept &= ~found.covered(name, part.station, part.across(middle), 0.0)
                lift = max(lift, STRIP_LIFT)
            elif name == ROUTE:
                right, left = found.route.surface_edges(part.station)
                kept &= (middle < right) | (middle > left)
            for row in part.runs(kept):
                yield from _lane(row, material, lift - drop)


def _lane(part: Corridor, material: str, lift: float) -> Parts:
    """The surface of one lane between the edges of a corridor; raised lanes have sides."""
    points = part.across(np.stack([part.left, part.right], axis=1), lift)
    tile = _TILES.get(material)
    texture = None if tile is None else points[..., :2] / tile
    yield material, surface(points, texture, part.up(2))
    if lift > STRIP_LIFT:
        for side, edge in ((1.0, part.left), (-1.0, part.right)):
            wall = np.stack([part.across(edge, z) for z in (-0.1, lift)])
            yield "road_curb", surface(wall[:, ::-1] if side > 0 else wall)
