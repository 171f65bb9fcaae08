"""Reads SUMO's vehicles after each step as a frame of poses on the road."""

from __future__ import annotations

import math
from collections.abc import KeysView, Sequence

import numpy as np
from numpy.typing import NDArray

from iits_mj.core.arrays import FloatArray
from iits_mj.core.messages import EgoState
from iits_mj.core.vehicles import COLUMNS, VehicleFrame
from traffic_bridge.config import TrafficConfig
from traffic_bridge.modes.smoothing import Box, LateralSmoother, Shift, nearest_turn
from traffic_bridge.network.route_lanes import RouteLanes
from traffic_bridge.session import Session
from traffic_bridge.vehicles.registry import Vehicles

IntArray = NDArray[np.intp]

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
        self._get_speed = session.getter("vehicle", "getSpeed")
        self._get_acceleration = session.getter("vehicle", "getAcceleration")
        self._get_position = session.getter("vehicle", "getLanePosition")
        self._get_lane = session.getter("vehicle", "getLaneID")
        self._get_ids = session.getter("lane", "getLastStepVehicleIDs")
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
        # Vehicles of the last reading; the next one usually has the same vehicles.
        self._names: list[str] = []
        self._on: list[str] = []
        self._kinds: list[str] = []
        self._size: FloatArray = np.zeros((3, 0))
        self._lane: IntArray = np.zeros(0, dtype=np.intp)
        self._speed: FloatArray = np.zeros(0)

    def forget(self, name: str) -> None:
        """Drops a vehicle that has left the traffic."""
        self._last_lane.pop(name, None)
        self._history.pop(name, None)

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
        names, on = self._names, self._on
        if not names:
            self._smoother.clear()
            return VehicleFrame.empty()
        columns = np.empty((len(COLUMNS), len(names)))
        columns[_SIZE] = self._size
        speed, acceleration = columns[_SPEED], columns[_ACCELERATION]
        speed[:] = list(map(self._get_speed, names))
        if same:
            # SUMO's definition; reading the value would take as long as reading the speed.
            np.divide(speed - self._speed, self._step, out=acceleration)
        else:
            acceleration[:] = list(map(self._get_acceleration, names))
        self._speed = speed
        middle = np.array(list(map(self._get_position, names)))
        middle -= 0.5 * self._size[0]
        lane = self._lane
        if middle.min() < 0.0:
            lane = lane.copy()
            for k in np.flatnonzero(middle < 0.0).tolist():
                lane[k], middle[k] = self._behind(names[k], on[k], float(middle[k]))
        pose, (route_lane, direction) = self._lanes.poses.evaluate(lane, middle)
        x, y, z, station, offset, heading, pitch, roll, curvature = pose
        columns[0], columns[1], columns[2], columns[3] = x, y, z, heading
        columns[4], columns[5] = pitch, roll
        np.multiply(curvature, speed, out=columns[6])
        columns[_LATERAL] = 0.0
        columns[_STATION], columns[_OFFSET] = station, offset
        shifts = self._smoother.update(
            names,
            lane,
            (x, y, heading),
            speed,
            self._size,
            (station, offset, direction),
            self._step,
            obstacles,
        )
        for shift in shifts:
            self._shift(columns, shift, route_lane, int(direction[shift.number]))
        columns[3] = nearest_turn(columns[3])
        frame = VehicleFrame(names, self._kinds, route_lane, columns)
        return frame if ego is None else frame.near(ego.x, ego.y, self._range)

    def _shift(
        self, columns: FloatArray, shift: Shift, route_lane: IntArray, direction: int
    ) -> None:
        """Moves a vehicle off its lane's center, its box pointing in the direction of motion."""
        k = shift.number
        heading, speed = float(columns[3, k]), float(columns[_SPEED, k])
        forward = max(speed, TIGHT_TURN)
        columns[0, k] -= shift.offset * math.sin(heading)
        columns[1, k] += shift.offset * math.cos(heading)
        columns[2, k] += shift.offset * math.tan(columns[5, k])
        columns[3, k] += math.atan2(shift.speed, forward)
        columns[6, k] += shift.acceleration * forward / (forward**2 + shift.speed**2)
        columns[_LATERAL, k] = shift.speed
        columns[_OFFSET, k] += direction * shift.offset
        if direction > 0:
            station, offset = float(columns[_STATION, k]), float(columns[_OFFSET, k])
            route_lane[k] = self._lanes.route.lane_at(station, offset)

    def _find_vehicles(self, ego: EgoState | None) -> bool:
        """Finds the vehicles and their lanes; returns whether the vehicles are unchanged."""
        count = self._api.vehicle.getIDCount()
        view = [] if ego is None else self._lanes_in_view(ego.x, ego.y)
        if view and LANE_COST * len(view) <= count:
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
            types = [self._vehicles.type_of(name) for name in names]
            self._kinds = [each.kind for each in types]
            self._size = np.array([(each.length, each.width, each.height) for each in types]).T
        before = self._last_lane
        for name, lane in zip(names, on, strict=True):
            last = before.get(name)
            if last != lane:
                before[name] = lane
                if last is not None:
                    history = self._history.get(name, ())
                    self._history[name] = (last, *history)[:HISTORY]
        number = self._lanes.poses.number
        self._lane = np.array([number(lane) for lane in on], dtype=np.intp)
        self._names, self._on = names, on

    def _behind(self, name: str, lane: str, position: float) -> tuple[int, float]:
        """Number of the lane, and position, of a place before the beginning of a vehicle's lane."""
        came_from = self._history.get(name, ())
        while position < 0.0:
            before = self._lanes.before(lane)
            if not before:
                break
            lane = next((known for known in came_from if known in before), before[0])
            position += self._lanes.table(lane).length
        return self._lanes.poses.number(lane), position
