"""Traffic of a whole map: trips that turn at random, and their number by density.

A vehicle draws its turn at each junction by the shares of `TrafficConfig.turning_shares` until it
reaches an exit of the map. A map without entrances and exits, such as a town, keeps its vehicles.
Each second the number of vehicles is compared with the density that was asked: missing ones begin
out of sight of the truck, on lanes with few vehicles and where there is room; surplus ones end out
of sight. So do vehicles that stand too long, which dissolves deadlocks.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np

from traffic_bridge.config import TrafficConfig
from traffic_bridge.network.lane_graph import LaneGraph, MapPaths
from traffic_bridge.network.net_file import NetFile, NetLane, distances_along
from traffic_bridge.network.stop_lines import turn_radius
from traffic_bridge.vehicles.types import VehicleType

PERIOD = 1.0  # [s] between two checks of the number of vehicles
HORIZON = 400.0  # [m] ahead of a vehicle for which its turns are drawn
CHANGE_ROOM = 50.0  # [m] of road that a vehicle needs to change to the next lane (judgement)
SHORTEST = 25.0  # [m] of a lane on which vehicles begin inside the map
# Number of vehicles over the asked one, at which vehicles begin or end out of sight.
LOWEST, HIGHEST = 0.97, 1.03
TRIES = 8  # places drawn for each missing vehicle
MOST = 4  # vehicles that begin or end in one check
SMOOTHING = 8.0  # [s] over which the number of vehicles is averaged
# Free road kept before and behind a new vehicle: standing gap [m], and time [s] at a speed.
FREE_GAP, FREE_TIME = 4.0, 1.5
JUNCTION_GAP = 8.0  # [m] before the end of a lane without new vehicles
LONGEST_WAIT = 150.0  # [s] that a vehicle may stand; two cycles of most lights are shorter
TURNS = {"r": 0, "R": 0, "s": 1, "l": 2, "L": 2}  # SUMO's directions: index of their share


@dataclass(slots=True)
class Trip:
    """The drawn part of a vehicle's way.

    Attributes:
      edges: in driving order.
      lanes: those of the last edge from which the vehicle can go on.
      turning_radius: of the vehicle, see `VehicleType` [m].
      ended: the last edge is an exit of the map.
    """

    edges: list[str]
    lanes: frozenset[str]
    turning_radius: float = 0.0
    ended: bool = False


@dataclass(frozen=True, slots=True)
class Sight:
    """The truck's place: vehicles neither begin nor end near it.

    Attributes:
      x, y: in SUMO's coordinates [m].
      clear: distance within which nothing appears or disappears [m].
    """

    x: float
    y: float
    clear: float

    def distance(self, x: float, y: float) -> float:
        """Distance to a point in SUMO's coordinates [m]."""
        return math.hypot(x - self.x, y - self.y)


@dataclass(slots=True)
class Occupied:
    """Vehicles on a lane: front [m], rear [m] and speed [m/s] of each."""

    places: list[tuple[float, float, float]] = field(default_factory=list)

    def has_room(self, front: float, length: float, speed: float) -> bool:
        """Whether a vehicle fits: it is as fast as the traffic's usual speed, or brakes."""
        rear = front - length
        for other_front, other_rear, other_speed in self.places:
            if other_front >= front:
                if other_rear - front < FREE_GAP + FREE_TIME * min(speed, other_speed + 3.0):
                    return False
            elif rear - other_front < FREE_GAP + FREE_TIME * other_speed:
                return False
        return True


class MapDemand:
    """Trips on a map, and the number of its vehicles.

    Args:
      net: of the map.
      graph: its lanes.
      config: settings.
      rng: generator of places and turns.

    Attributes:
      lanes: with traffic.
    """

    def __init__(
        self, net: NetFile, graph: LaneGraph, config: TrafficConfig, rng: np.random.Generator
    ) -> None:
        self._graph, self._config, self._rng = graph, config, rng
        self._paths = MapPaths(net)
        self._edges = {edge.id: edge for edge in net.edges}
        self._net = net
        self._links = {(link.start, link.end): link for link in net.connections}
        self._radius: dict[tuple[str, str], float] = {}
        self.lanes = tuple(
            lane
            for name in self._paths.ids
            for lane in self._edges[name].lanes
            if lane.is_driving and (name in self._paths.exits or graph.leads_to(lane.id))
        )
        self._wanted = np.array([lane.length * self._density(lane) for lane in self.lanes])
        self._pace = math.inf if config.steady is None else config.steady.speed
        self._mean = math.nan  # number of vehicles, of the last `SMOOTHING` seconds
        self._trips: dict[str, Trip] = {}
        self._along = {lane.id: distances_along(lane.shape) for lane in self.lanes}

    @property
    def target(self) -> float:
        """Number of vehicles that the asked density gives, without those inside junctions."""
        return float(self._wanted.sum())

    @property
    def entrances(self) -> tuple[NetLane, ...]:
        """Lanes at the map's entrances."""
        return tuple(lane for lane in self.lanes if lane.edge in self._paths.entrances)

    def is_entrance(self, edge: str) -> bool:
        """Whether no other edge leads to an edge."""
        return edge in self._paths.entrances

    def _density(self, lane: NetLane) -> float:
        """Vehicles per meter of a lane; flow over the mean speed where a flow is given."""
        steady = self._config.steady
        if steady is not None:
            return steady.density
        return self._config.probability / (0.92 * min(self._config.speed_limit, lane.speed))

    def start(self, lane: str, turning_radius: float = 0.0) -> Trip:
        """Draws the beginning of a trip from a lane, at least `HORIZON` long."""
        trip = Trip([self._graph.lanes[lane].edge], frozenset({lane}), turning_radius)
        self._extend(trip, 0.0)
        return trip

    def add(self, vehicle: str, trip: Trip) -> None:
        """Registers the trip of a new vehicle."""
        self._trips[vehicle] = trip

    def has(self, vehicle: str) -> bool:
        """Whether a vehicle has a trip of this demand."""
        return vehicle in self._trips

    def forget(self, vehicle: str) -> None:
        """Drops a vehicle that has left the map."""
        self._trips.pop(vehicle, None)

    def prolong(self, api: object) -> None:
        """Draws further turns for vehicles that approach the end of the drawn part."""
        domain = api.vehicle  # type: ignore[attr-defined]
        there = set(domain.getIDList())
        for name, trip in self._trips.items():
            if trip.ended or name not in there:
                continue
            k = domain.getRouteIndex(name)
            road = domain.getRoadID(name)
            if k < 0 or road.startswith(":"):
                continue
            left = sum(self._edges[edge].length for edge in trip.edges[k + 1 :])
            if left < HORIZON:
                self._extend(trip, left)
                # SUMO keeps the edges that lie behind the vehicle, and counts on.
                domain.setRoute(name, trip.edges[k:])

    def _extend(self, trip: Trip, length: float) -> None:
        """Draws turns until the way is `HORIZON` long or ends."""
        while length < HORIZON:
            ways = self._onward(trip)
            if not ways:
                trip.ended = True
                return
            names = sorted(ways)
            shares = np.cumsum([ways[name][0] for name in names])
            chosen = names[int(np.searchsorted(shares, self._rng.random() * shares[-1], "right"))]
            trip.edges.append(chosen)
            trip.lanes = frozenset(ways[chosen][1])
            length += self._edges[chosen].length

    def _onward(self, trip: Trip) -> dict[str, tuple[float, set[str]]]:
        """Share and first lanes of each edge to which a vehicle can go on.

        The share of a turn counts once for each lane that makes it. Turns that are too tight for
        the vehicle are taken only if there is no other way.
        """
        edge, lanes, radius = trip.edges[-1], trip.lanes, trip.turning_radius
        driving = [lane for lane in self._edges[edge].lanes if lane.is_driving]
        shifts = int(self._edges[edge].length / CHANGE_ROOM)
        entered = [lane.index for lane in driving if lane.id in lanes]
        near = [lane for lane in driving if any(abs(lane.index - k) <= shifts for k in entered)]
        # Where no near lane leads on, SUMO's drivers must change farther.
        for least in (radius, 0.0) if radius > 0.0 else (0.0,):
            ways = self._ways(near, least) or self._ways(driving, least)
            if ways:
                break
        return ways

    def _ways(self, lanes: list[NetLane], radius: float) -> dict[str, tuple[float, set[str]]]:
        """The ways from some lanes whose bends have a radius, see `_onward`."""
        ways: dict[str, tuple[float, set[str]]] = {}
        for lane in lanes:
            for end in self._graph.leads_to(lane.id):
                if radius > 0.0 and self._radius_of(lane.id, end) < radius:
                    continue
                link = self._links.get((lane.id, end))
                turn = TURNS.get("s" if link is None else link.turn)
                share = 0.0 if turn is None else self._config.turning_shares[turn]
                name = self._graph.lanes[end].edge
                before, ends = ways.get(name, (0.0, set()))
                ways[name] = (before + max(share, 1e-6), ends | {end})
        return ways

    def _radius_of(self, start: str, end: str) -> float:
        """Radius of the tightest bend between two lanes [m]."""
        key = start, end
        if key not in self._radius:
            link = self._links.get(key)
            self._radius[key] = math.inf if link is None else turn_radius(self._net, link)
        return self._radius[key]

    def place_of(self, lane: NetLane, position: float) -> tuple[float, float]:
        """Point of a lane in SUMO's coordinates [m]."""
        along = self._along[lane.id]
        at = position / lane.length * along[-1]
        return (
            float(np.interp(at, along, lane.shape[:, 0])),
            float(np.interp(at, along, lane.shape[:, 1])),
        )

    def occupied(self, api: object) -> dict[str, Occupied]:
        """The vehicles on every lane with traffic."""
        lanes, vehicles = api.lane, api.vehicle  # type: ignore[attr-defined]
        found = {}
        for lane in self.lanes:
            found[lane.id] = here = Occupied()
            for name in lanes.getLastStepVehicleIDs(lane.id):
                front = vehicles.getLanePosition(name)
                speed = vehicles.getSpeed(name)
                here.places.append((front, front - vehicles.getLength(name), speed))
        return found

    def missing(self, occupied: dict[str, Occupied]) -> int:
        """Vehicles by which the lanes have fewer than asked; negative: more."""
        return round(self.target - _count(occupied))

    def correction(self, occupied: dict[str, Occupied]) -> int:
        """Vehicles to add in this check; negative: to take off.

        It follows the mean number, because vehicles inside junctions are missing for a while only.
        """
        count, target = _count(occupied), self.target
        if math.isnan(self._mean):
            self._mean = float(count)
        self._mean += (count - self._mean) * PERIOD / SMOOTHING
        if LOWEST * target <= self._mean <= HIGHEST * target:
            return 0
        change = max(-MOST, min(MOST, round(target - self._mean)))
        self._mean += change
        return change

    def is_full(self, occupied: dict[str, Occupied]) -> bool:
        """Whether the map has as many vehicles as asked, so that none may enter."""
        return _count(occupied) >= self.target or self._mean >= HIGHEST * self.target

    def free_places(
        self,
        occupied: dict[str, Occupied],
        sight: Sight | None,
        draw: Callable[[NetLane], tuple[VehicleType, float]],
        number: int,
    ) -> Iterator[tuple[NetLane, float, VehicleType, float]]:
        """Draws places for new vehicles out of sight, with their types and desired speeds.

        Args:
          occupied: the vehicles on the lanes, to which the caller adds the new ones.
          sight: the truck; None: none.
          draw: a vehicle for a lane.
          number: of vehicles.

        Yields:
          Lane, position of the front bumper [m], type, desired speed [m/s].
        """
        for _ in range(number):
            have = np.array([len(occupied[lane.id].places) for lane in self.lanes])
            long = np.array([lane.length >= SHORTEST for lane in self.lanes])
            lack = np.cumsum(np.where(long, np.maximum(self._wanted - have, 0.0), 0.0))
            if lack[-1] <= 0.0:
                return
            best: tuple[float, NetLane, float, VehicleType, float] | None = None
            for chance, part in self._rng.random((TRIES, 2)).tolist():
                lane = self.lanes[int(np.searchsorted(lack, chance * lack[-1], "right"))]
                kind, desired = draw(lane)
                low, high = kind.length + 1.0, lane.length - max(JUNCTION_GAP, lane.stop_offset)
                position = low + part * (high - low)
                speed = min(desired, lane.speed, self._pace)
                if high <= low or not occupied[lane.id].has_room(position, kind.length, speed):
                    continue
                far = math.inf
                if sight is not None:
                    far = sight.distance(*self.place_of(lane, position))
                    if far < sight.clear:
                        continue
                if best is None or far > best[0]:
                    best = far, lane, position, kind, desired
            if best is not None:
                yield best[1:]

    def surplus(self, api: object) -> list[str]:
        """Draws the vehicles over the asked number."""
        number = -self.missing(self.occupied(api))
        names = list(self._trips)
        return [names[k] for k in self._rng.permutation(len(names))[: max(number, 0)].tolist()]

    def leaving(self, api: object, sight: Sight | None, surplus: int) -> list[str]:
        """Vehicles to take off the road out of sight: surplus ones, and those that stand too long.

        Args:
          api: libsumo.
          sight: the truck; None: no vehicle is taken off.
          surplus: number of vehicles too many.
        """
        if sight is None:
            return []
        vehicles = api.vehicle  # type: ignore[attr-defined]
        far = []
        there = set(vehicles.getIDList())
        for name in self._trips:
            if name in there:
                distance = sight.distance(*vehicles.getPosition(name))
                if distance >= sight.clear + vehicles.getLength(name):
                    far.append((distance, name))
        chosen = [name for _, name in far if vehicles.getWaitingTime(name) > LONGEST_WAIT]
        far.sort(reverse=True)
        return list(dict.fromkeys([*chosen, *(name for _, name in far[: max(surplus, 0)])]))


def _count(occupied: dict[str, Occupied]) -> int:
    return sum(len(here.places) for here in occupied.values())
