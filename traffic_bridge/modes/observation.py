"""Reads SUMO's vehicles after each step as a frame of poses on the road."""

from __future__ import annotations

import math
from collections.abc import KeysView, Sequence

import numpy as np

from iits_mj import kernels
from iits_mj.core.arrays import FloatArray, IndexArray
from iits_mj.core.messages import EgoState
from iits_mj.core.vehicles import COLUMNS, VehicleFrame
from traffic_bridge.config import TrafficConfig
from traffic_bridge.modes.smoothing import Box, LateralSmoother, Shift
from traffic_bridge.network.lane_table import VehicleLanes
from traffic_bridge.network.route_lanes import RouteLanes
from traffic_bridge.session import Session
from traffic_bridge.vehicles.registry import Vehicles

_vehicles_in_view = kernels.function(
    "iits_vehicles_in_view",
    kernels.Integer,
    *(kernels.Integer, kernels.Address, *3 * [kernels.Real], kernels.Address),
)

VIEW_MARGIN = 30.0  # [m]: lanes are selected by their bounding boxes, vehicles by their centers
VIEW_KEPT = 50.0  # [m] of the ego's motion before the lanes in view are selected again
HISTORY = 4  # lanes stored per vehicle: a long vehicle can be on several short lanes
TIGHT_TURN = 2.0  # [m/s]: below it the box does not turn further with the lateral motion
# Rows of a frame's columns.
_SPEED, _ACCELERATION, _LATERAL, _STATION, _OFFSET = (
    COLUMNS.index(name) for name in ("speed", "acceleration", "lateral_speed", "station", "offset")
)
_SIZE = slice(COLUMNS.index("length"), COLUMNS.index("height") + 1)
LANE_COST = 3  # vehicles whose lanes are read in about the time of reading one lane's vehicles


class Observation:
    """Reads the traffic of a running simulation after each step.

    Vehicles within `config.view_range` of the ego are read.
    """

    def __init__(
        self, session: Session, lanes: RouteLanes, vehicles: Vehicles, config: TrafficConfig
    ) -> None:
        self._api = session.api
        self._get_speed = session.function("vehicle", "getSpeed")
        self._get_acceleration = session.function("vehicle", "getAcceleration")
        self._get_position = session.function("vehicle", "getLanePosition")
        self._get_lane = session.function("vehicle", "getLaneID")
        self._get_ids = session.function("lane", "getLastStepVehicleIDs")
        self._lanes = lanes
        self._vehicles = vehicles
        self._range = config.view_range
        self._step = config.step_length
        self._smoother = LateralSmoother(config.lane_change_duration)
        self._last_lane: dict[str, str] = {}
        self._history: dict[str, tuple[str, ...]] = {}
        self._view_place: tuple[float, float] | None = None
        self._view: list[str] = []
        # The lanes in view at the last reading, and the vehicles on each.
        self._lists: list[tuple[str, ...]] = []
        self._listed: list[str] = []
        # Kind, length, width and height of the vehicles.
        self._facts: dict[str, tuple[str, float, float, float]] = {}
        # Vehicles of the last reading; the next one usually has the same vehicles and lanes.
        self._names: list[str] = []
        self._on: list[str] = []
        self._ids: tuple[str, ...] = ()
        self._kinds: tuple[str, ...] = ()
        self._of_lanes: VehicleLanes = lanes.poses.lanes(np.zeros(0, dtype=np.intp))
        # The numbers of the lanes when a vehicle's center was last before its lane, and the lanes.
        self._replaced = b"", self._of_lanes
        self._make_tables(0)

    def _make_tables(self, count: int) -> None:
        """Makes the arrays of the compiled functions for a number of vehicles."""
        self._given = kernels.Table(np.zeros((2, count)))  # speeds and positions
        self._centers = kernels.Table(np.zeros(count))
        self._columns = kernels.Table(np.zeros((len(COLUMNS), count)))
        self._near = kernels.Table(np.zeros(count))
        # The vehicles near the ego at the last reading: as bytes, as numbers, ids and kinds.
        self._chosen = b""
        self._where: IndexArray = np.zeros(0, dtype=np.intp)
        self._ids_near: tuple[str, ...] = ()
        self._kinds_near: tuple[str, ...] = ()

    def forget(self, name: str) -> None:
        """Drops a vehicle that has left the traffic."""
        self._last_lane.pop(name, None)
        self._history.pop(name, None)
        self._facts.pop(name, None)

    def names(self) -> KeysView[str]:
        """Names of the vehicles with stored data, as a set view."""
        return self._last_lane.keys()

    @property
    def held(self) -> dict[str, float]:
        """Speed limits of vehicles during lane changes, see `LateralSmoother` [m/s]."""
        return self._smoother.held

    def read(self, ego: EgoState | None, obstacles: Sequence[Box] = ()) -> VehicleFrame:
        """The present vehicles near the ego, or all vehicles without an ego.

        Args:
          ego: the truck.
          obstacles: further boxes that the vehicles avoid, see `LateralSmoother`.
        """
        same = self._find_vehicles(ego)
        names = self._names
        if not names:
            self._smoother.clear()
            return VehicleFrame.empty()
        given, columns = self._given, self._columns.numbers
        given.numbers[0] = list(map(self._get_speed, names))
        given.numbers[1] = list(map(self._get_position, names))
        if not same:
            # Else it is the change of speed, SUMO's definition, which takes less time.
            columns[_ACCELERATION] = list(map(self._get_acceleration, names))
        lanes = self._follow_lanes(self._step if same else 0.0)
        x, y, _, heading = columns[:4].copy()
        shifts = self._smoother.update(
            names,
            lanes.numbers,
            (x, y, heading),
            given.numbers[0],
            columns[_SIZE],
            (columns[_STATION], columns[_OFFSET], lanes.directions),
            self._step,
            obstacles,
        )
        route_lanes = lanes.route_lanes
        if shifts:
            route_lanes = route_lanes.copy()
            for shift in shifts:
                self._shift(columns, shift, route_lanes, int(lanes.directions[shift.number]))
        return self._frame(ego, route_lanes)

    def _follow_lanes(self, elapsed: float) -> VehicleLanes:
        """Computes the columns on the lanes' centers; returns the lanes under the centers."""
        lanes, poses = self._of_lanes, self._lanes.poses
        tables = self._given, self._centers, self._columns
        if poses.evaluate(lanes, *tables, elapsed=elapsed):
            numbers, centers = lanes.numbers.copy(), self._centers.numbers
            for k in np.flatnonzero(centers < 0.0).tolist():
                lane, centers[k] = self._behind(self._names[k], self._on[k], float(centers[k]))
                (numbers[k],) = poses.numbers([lane])
            replaced = numbers.tobytes()
            if replaced != self._replaced[0]:
                self._replaced = replaced, poses.lanes(numbers)
            lanes = self._replaced[1]
            poses.evaluate(lanes, *tables, placed=True, elapsed=elapsed)
        return lanes

    def _frame(self, ego: EgoState | None, route_lanes: IndexArray) -> VehicleFrame:
        """The vehicles in view, from their columns."""
        columns, near = self._columns, self._near
        x, y, reach = (
            (0.0, 0.0, math.inf) if ego is None else (ego.x, ego.y, self._range * self._range)
        )
        count = _vehicles_in_view(len(self._ids), columns.address, x, y, reach, near.address)
        if count == len(self._ids):
            return VehicleFrame(self._ids, self._kinds, route_lanes, columns.numbers.copy())
        chosen = near.numbers.tobytes()
        if chosen != self._chosen:
            self._chosen, self._where = chosen, np.flatnonzero(near.numbers)
            where = self._where.tolist()
            self._ids_near = tuple(self._ids[k] for k in where)
            self._kinds_near = tuple(self._kinds[k] for k in where)
        return VehicleFrame(
            self._ids_near,
            self._kinds_near,
            route_lanes.take(self._where),
            columns.numbers.take(self._where, axis=1),
        )

    def _shift(
        self, columns: FloatArray, shift: Shift, route_lane: IndexArray, direction: int
    ) -> None:
        """Moves a vehicle off its lane's center, its box pointing in the direction of motion."""
        column = columns[:, shift.number].tolist()
        heading, roll, forward = column[3], column[5], max(column[_SPEED], TIGHT_TURN)
        column[0] -= shift.offset * math.sin(heading)
        column[1] += shift.offset * math.cos(heading)
        column[2] += shift.offset * math.tan(roll)
        column[3] += math.atan2(shift.speed, forward)
        column[6] += shift.acceleration * forward / (forward**2 + shift.speed**2)
        column[_LATERAL] = shift.speed
        column[_OFFSET] += direction * shift.offset
        columns[:, shift.number] = column
        if direction > 0:
            place = column[_STATION], column[_OFFSET]
            route_lane[shift.number] = self._lanes.route.lane_at(*place)

    def _find_vehicles(self, ego: EgoState | None) -> bool:
        """Finds the vehicles and their lanes; returns whether the vehicles are unchanged."""
        view = [] if ego is None else self._lanes_in_view(ego.x, ego.y)
        if view and LANE_COST * len(view) <= len(self._vehicles.names()):
            lists = list(map(self._get_ids, view))
            if view is self._listed and lists == self._lists:
                return True
            self._listed, self._lists = view, lists
            where: dict[str, str] = {}
            for lane, ids in zip(view, lists, strict=True):
                where.update(dict.fromkeys(ids, lane))
        else:
            self._listed = []
            ids = self._api.vehicle.getIDList()
            where = dict(zip(ids, map(self._get_lane, ids), strict=True))
            if ego is not None:
                near = set(view)
                where = {name: lane for name, lane in where.items() if lane in near}
            else:
                where = {name: lane for name, lane in where.items() if lane}
        names = sorted(where.keys() & self._vehicles.names())
        same = names == self._names
        self._note(names, list(map(where.__getitem__, names)))
        return same

    def _lanes_in_view(self, x: float, y: float) -> list[str]:
        if self._view_place is not None:
            dx, dy = x - self._view_place[0], y - self._view_place[1]
            if dx * dx + dy * dy < VIEW_KEPT * VIEW_KEPT:
                return self._view
        names, boxes = self._lanes.boxes
        sumo_x, sumo_y = self._lanes.to_sumo(x, y)
        reach = self._range + VIEW_MARGIN + VIEW_KEPT
        dx = np.maximum(np.maximum(boxes[0] - sumo_x, sumo_x - boxes[2]), 0.0)
        dy = np.maximum(np.maximum(boxes[1] - sumo_y, sumo_y - boxes[3]), 0.0)
        self._view = [names[k] for k in np.flatnonzero(np.hypot(dx, dy) < reach).tolist()]
        self._view_place = (x, y)
        return self._view

    def _note(self, names: list[str], on: list[str]) -> None:
        """Updates sizes, kinds and lanes of the vehicles if they have changed."""
        if names == self._names and on == self._on:
            return
        if names != self._names:
            for name in names:
                if name not in self._facts:
                    kind = self._vehicles.type_of(name)
                    self._facts[name] = kind.kind, kind.length, kind.width, kind.height
            self._ids, self._kinds = tuple(names), ()
            self._make_tables(len(names))
            if names:
                facts = map(self._facts.__getitem__, names)
                self._kinds, *size = zip(*facts, strict=True)
                self._columns.numbers[_SIZE] = size
        before = self._last_lane
        for name, lane in zip(names, on, strict=True):
            last = before.get(name)
            if last != lane:
                before[name] = lane
                if last is not None:
                    history = self._history.get(name, ())
                    self._history[name] = (last, *history)[:HISTORY]
        poses = self._lanes.poses
        self._of_lanes = poses.lanes(poses.numbers(on))
        self._names, self._on = names, on

    def _beside(self, lane: str, came_from: tuple[str, ...]) -> str:
        """The lane by which a vehicle came to a lane's neighbors, "" for none."""
        edge = self._lanes.net.edge.get(lane.rpartition("_")[0])
        for other in () if edge is None else edge.lanes:
            before = self._lanes.before(other.id) if other.id != lane else ()
            for known in came_from:
                if known in before:
                    return known
        return ""

    def _behind(self, name: str, lane: str, position: float) -> tuple[str, float]:
        """The lane, and the position, of a place before the beginning of a vehicle's lane."""
        came_from = self._history.get(name, ())
        while position < 0.0:
            before = self._lanes.before(lane)
            if not before:
                break
            behind = next((known for known in came_from if known in before), "")
            # A vehicle that changed lanes right behind a junction came through it to the old lane.
            lane = behind or self._beside(lane, came_from) or before[0]
            position += self._lanes.table(lane).length
        return lane, position
