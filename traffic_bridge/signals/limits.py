"""Variable speed limits on stretches of the route, exact to the station.

SUMO has one limit per lane; its lanes end where the map's roads or lane sections do, and vehicles
brake as hard as they can when it is lowered. So each vehicle gets a maximum speed of its own: on
the stretch the limit, before the stretch the speed from which it reaches the limit at the sign with
a part of its comfortable deceleration, as drivers who see the sign do. A vehicle that is on a
stretch when its limit comes into force slows down with that deceleration. SUMO's own limit is
raised where a stretch allows more than the map.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from iits_mj.core.arrays import FloatArray
from iits_mj.core.checks import is_number, is_whole
from iits_mj.core.errors import InputError
from traffic_bridge.network.route_lanes import LaneTable, RouteLanes, upstream
from traffic_bridge.session import Session
from traffic_bridge.signals.events import LONGEST, SpeedLimit
from traffic_bridge.vehicles.registry import Vehicles

# Part of the comfortable deceleration that drivers use before a sign (judgement).
APPROACH = 0.75
SIGHT = 400.0  # [m] before a sign in which drivers may begin to brake
SEAM = 10.0  # [m] between SUMO's lanes, at most


@dataclass(frozen=True)
class LimitPiece:
    """A stretch of one lane with one limit: stations [m] and limit [m/s]."""

    start: float
    end: float
    limit: float


@dataclass(frozen=True, eq=False)
class _Watch:
    """A SUMO lane whose vehicles are limited by station.

    Attributes:
      table: of the lane; pieces: limits on it and ahead of it.
    """

    table: LaneTable
    pieces: list[LimitPiece]

    @cached_property
    def positions(self) -> FloatArray:
        """Positions of the table's samples along the lane [m]."""
        return np.arange(len(self.table.station), dtype=np.float64) * self.table.spacing


class SpeedLimits:
    """The variable speed limits of a running traffic."""

    def __init__(
        self, session: Session, lanes: RouteLanes, vehicles: Vehicles, step_length: float
    ) -> None:
        self._session = session
        self._api = session.api
        self._lanes = lanes
        self._vehicles = vehicles
        self._step = step_length
        self._rules: dict[int, SpeedLimit] = {}
        self._numbers = itertools.count()
        self._of_map: dict[str, float] = {}
        self._pieces: dict[int, list[LimitPiece]] = {}
        self._watched: list[_Watch] = []
        self._held: set[str] = set()

    def set(
        self, limit: float, start: float = 0.0, end: float = LONGEST, lane: int | None = None
    ) -> int:
        """Sets a limit on a stretch; of overlapping limits the one set last holds.

        Args:
          limit: [m/s].
          start: station [m] at which drivers have reached the limit.
          end: station [m].
          lane: index from the outside; None: all lanes.

        Returns:
          The number for `lift`.

        Raises:
          InputError: a value is not allowed (see `SpeedLimit`), or no lane lies in the interval.
        """
        rule = SpeedLimit(limit=limit, start=start, end=end, lane=lane)
        self.check(rule)
        number = next(self._numbers)
        self._rules[number] = rule
        self._apply()
        return number

    def check(self, rule: SpeedLimit) -> None:
        """Raises InputError if no lane lies between the stations of a limit."""
        if not self._tables(rule):
            which = "no lane" if rule.lane is None else f"no lane {rule.lane}"
            raise InputError(
                f"{which} of the route between stations {rule.start:g} and {rule.end:g}"
            )

    def lift(self, number: int) -> None:
        """Removes a limit; InputError if there is no such limit."""
        if number not in list(self._rules):
            raise InputError(f"speed limit {number!r}: there are {sorted(self._rules)}")
        del self._rules[number]
        self._apply()

    def reset(self) -> None:
        """Removes all limits; every lane has the limit of the map again."""
        self._rules.clear()
        self._apply()

    @property
    def rules(self) -> tuple[SpeedLimit, ...]:
        """The limits in force, in the order in which they were set."""
        return tuple(self._rules.values())

    def at(self, station: float, lane: int = 0) -> float:
        """The limit at a station of a lane [m/s].

        Raises:
          InputError: the lane does not exist there.
        """
        known = is_number(station) and is_whole(lane)
        table = self._lanes.find(lane, station) if known else None
        if table is None:
            raise InputError(f"lane {lane!r} does not exist at station {station!r}")
        with self._session.guard("reading a speed limit"):
            for piece in self._pieces.get(lane, ()):
                if piece.start <= station < piece.end:
                    return piece.limit
            own = self._of_map.get(table.id)
            return float(self._api.lane.getMaxSpeed(table.id)) if own is None else own

    def entering(self, table: LaneTable, position: float, deceleration: float) -> float:
        """Highest speed of a vehicle that is inserted on a SUMO lane [m/s]; infinite: no limit.

        Args:
          table: of the lane.
          position: of the front bumper along the lane [m].
          deceleration: comfortable one of the vehicle [m/s2].
        """
        watch = next((watch for watch in self._watched if watch.table.id == table.id), None)
        if watch is None:
            return math.inf
        station, slowing = np.array([table.at(position)[0]]), APPROACH * deceleration
        return float(_allowed(watch.pieces, station, np.array([slowing]))[0])

    def step(self) -> None:
        """Limits the vehicles on and before the stretches."""
        if not self._watched and not self._held:
            return
        held: set[str] = set()
        for watch in self._watched:
            known = self._api.lane.getLastStepVehicleIDs(watch.table.id)
            names = [name for name in known if name in self._vehicles]
            if not names:
                continue
            for name, allowed in zip(names, self._allowed(names, watch).tolist(), strict=True):
                if allowed < math.inf:
                    self._vehicles.hold_below(name, allowed)
                    held.add(name)
        for name in sorted(self._held - held):
            self._vehicles.hold_below(name, None)
        self._held = held

    def _allowed(self, names: list[str], watch: _Watch) -> FloatArray:
        """Highest speeds at the end of the coming step [m/s], shape (n,); infinite: no limit."""
        vehicle, of = self._api.vehicle, self._vehicles
        position = np.array([vehicle.getLanePosition(name) for name in names])
        speed = np.array([vehicle.getSpeed(name) for name in names])
        slowing = APPROACH * np.array([of.type_of(name).deceleration for name in names])
        station = np.interp(position, watch.positions, watch.table.station) + speed * self._step
        # Vehicles above a limit that has just come into force slow down as before a sign.
        return np.maximum(_allowed(watch.pieces, station, slowing), speed - slowing * self._step)

    def _apply(self) -> None:
        """Sets the limits of the SUMO lanes, and notes the lanes whose vehicles are limited."""
        lane_api = self._api.lane
        with self._session.guard("setting speed limits"):
            for lane_id, limit in self._of_map.items():
                lane_api.setMaxSpeed(lane_id, limit)
            self._pieces.clear()
            watched: dict[str, list[LimitPiece]] = {}
            touched = sorted({t.lane for r in self._rules.values() for t in self._tables(r)})
            for lane in touched:
                pieces = self._cut(lane)
                rest: list[LimitPiece] = []
                for table in self._lanes.within(pieces[0].start, pieces[-1].end, lane):
                    over = [p for p in pieces if _overlaps(p, table)]
                    between = self._raise_lane(table, over)
                    rest += between
                    watched.setdefault(table.id, []).extend(over + between)
                    self._watch_before(table, over + between, watched)
                self._pieces[lane] = sorted(pieces + rest, key=lambda piece: piece.start)
        tables = self._lanes.tables
        self._watched = [_Watch(tables[lane_id], pieces) for lane_id, pieces in watched.items()]

    def _watch_before(
        self, table: LaneTable, pieces: list[LimitPiece], watched: dict[str, list[LimitPiece]]
    ) -> None:
        """Adds the signs of a lane to the lanes before it, as far as the signs are seen."""
        begin = float(table.station[0])
        signs = [piece for piece in pieces if begin - SEAM < piece.start < begin + SIGHT]
        for before in upstream(self._lanes, [table], SIGHT) if signs else ():
            watched.setdefault(before.id, []).extend(signs)

    def _raise_lane(self, table: LaneTable, over: list[LimitPiece]) -> list[LimitPiece]:
        """Raises SUMO's limit of a lane to the highest limit on it.

        Returns:
          The map's limit on the rest of the lane, where it is now below SUMO's.
        """
        own = self._of_map.setdefault(table.id, float(self._api.lane.getMaxSpeed(table.id)))
        ceiling = max((piece.limit for piece in over), default=own)
        # A turn inside a junction keeps the low speed that its bend requires.
        if ceiling <= own or table.id.startswith(":"):
            return []
        self._api.lane.setMaxSpeed(table.id, ceiling)
        free, high = float(table.station[0]), float(table.station[-1])
        between = []
        for start, end in [*((p.start, p.end) for p in over), (high, high)]:
            if start > free:
                between.append(LimitPiece(free, start, own))
            free = max(free, end)
        return between

    def _cut(self, lane: int) -> list[LimitPiece]:
        """The limits of a lane as stretches without overlap, in driving order."""
        rules = [r for r in self._rules.values() if r.lane in (None, lane)]
        ends = sorted({r.start for r in rules} | {r.end for r in rules})
        pieces = []
        for start, end in itertools.pairwise(ends):
            limits = [r.limit for r in rules if r.start <= start and r.end >= end]
            if limits:
                pieces.append(LimitPiece(start, end, limits[-1]))
        return pieces

    def _tables(self, rule: SpeedLimit) -> list[LaneTable]:
        return self._lanes.within(rule.start, rule.end, rule.lane)


def _overlaps(piece: LimitPiece, table: LaneTable) -> bool:
    return piece.start < table.station[-1] and piece.end > table.station[0]


def _allowed(pieces: Sequence[LimitPiece], station: FloatArray, slowing: FloatArray) -> FloatArray:
    """Highest speeds at stations: v^2 = limit^2 + 2 slowing distance before a sign, [m/s]."""
    allowed = np.full(len(station), math.inf)
    for piece in pieces:
        before = piece.start - station
        seen = (piece.end > station) & (before <= SIGHT)
        reached = np.sqrt(piece.limit**2 + 2.0 * slowing * np.maximum(before, 0.0))
        allowed = np.where(seen, np.minimum(allowed, reached), allowed)
    return allowed
