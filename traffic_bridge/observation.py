"""What SUMO has on its lanes, as a frame of vehicles on the road: read and computed by columns."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from iits_mj.messages import EgoState
from iits_mj.road import Route
from traffic_bridge.frame import VehicleFrame
from traffic_bridge.lanes import RouteLanes
from traffic_bridge.session import Session
from traffic_bridge.smoothing import LateralSmoother
from traffic_bridge.vehicles import Vehicles

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.intp]

VIEW_MARGIN = 30.0  # [m]: lanes are chosen by their ends and bends, vehicles by their centres
VIEW_KEPT = 50.0  # [m] the ego moves before the lanes in view are chosen again
HISTORY = 4  # lanes a vehicle remembers: a long one can stand on several short ones
TIGHT_TURN = 2.0  # [m/s] below which a sideways motion turns the box no further
# Reading a lane's list of vehicles costs about as much as reading the lane of three vehicles.
LANE_COST = 3


@dataclass(frozen=True)
class _Body:
    """What does not change of a vehicle: its kind and length, width, height [m]."""

    kind: str
    size: tuple[float, float, float]


class Observation:
    """Reads the traffic of a running simulation after each step.

    Args:
      session: the running SUMO.
      lanes: of the route.
      vehicles: what each vehicle is.
      route: the ego's road.
      view_range: vehicles within this distance of the ego are read [m].
      step_length: time between two readings [s].
      lane_change_duration: see `LateralSmoother` [s].
    """

    def __init__(
        self,
        session: Session,
        lanes: RouteLanes,
        vehicles: Vehicles,
        route: Route,
        view_range: float,
        step_length: float,
        lane_change_duration: float,
    ) -> None:
        self._api = session.api
        self._lanes = lanes
        self._vehicles = vehicles
        self._route = route
        self._range = view_range
        self._step = step_length
        self._smoother = LateralSmoother(lane_change_duration)
        self._bodies: dict[str, _Body] = {}
        self._on: dict[str, str] = {}
        self._history: dict[str, tuple[str, ...]] = {}
        self._view_place: tuple[float, float] | None = None
        self._view: list[str] = []

    def forget(self, name: str) -> None:
        """Drops a vehicle that has left."""
        self._bodies.pop(name, None)
        self._on.pop(name, None)
        self._history.pop(name, None)

    def read(self, ego: EgoState | None) -> VehicleFrame:
        """The vehicles now, near the ego; all of them without one."""
        on = self._on_lanes(ego)
        names = sorted(name for name in on if name in self._vehicles)
        if not names:
            self._smoother.clear()
            return VehicleFrame.empty()
        self._note_lanes(names, on)
        vehicle = self._api.vehicle
        position = np.array([vehicle.getLanePosition(name) for name in names])
        speed = np.array([vehicle.getSpeed(name) for name in names])
        acceleration = np.array([vehicle.getAcceleration(name) for name in names])
        bodies = [self._body(name) for name in names]
        size = np.array([body.size for body in bodies]).T
        number = self._lanes.poses.number
        lane = np.array([number(on[name]) for name in names], dtype=np.intp)
        middle = position - 0.5 * size[0]
        for k in np.flatnonzero(middle < 0.0).tolist():
            lane[k], middle[k] = self._behind(names[k], on[names[k]], float(middle[k]))
        x, y, z, station, offset, heading, pitch, roll, curvature = self._lanes.poses.evaluate(
            lane, middle
        )
        direction = self._lanes.poses.direction.take(lane)
        route_lane = self._lanes.poses.route_lane.take(lane)
        yaw, yaw_rate = heading, curvature * speed
        lateral = np.zeros_like(speed)
        shift = self._smoother.update(
            names,
            np.stack((x, y, heading)),
            speed,
            size,
            np.stack((station, offset, direction)),
            self._step,
        )
        if shift is not None:
            residual, lateral, bend = shift
            # The box points where it moves.
            forward = np.maximum(speed, TIGHT_TURN)
            yaw = yaw + np.arctan2(lateral, forward)
            yaw_rate = yaw_rate + bend * forward / (forward * forward + lateral * lateral)
            x, y = x - residual * np.sin(heading), y + residual * np.cos(heading)
            z = z + residual * np.tan(roll)
            offset = offset + direction * residual
            for k in np.flatnonzero(residual).tolist():
                if direction[k] > 0:
                    route_lane[k] = self._route.lane_at(float(station[k]), float(offset[k]))
        yaw = np.remainder(yaw + np.pi, 2.0 * np.pi) - np.pi
        columns = np.stack(
            (
                x,
                y,
                z,
                yaw,
                pitch,
                roll,
                yaw_rate,
                speed,
                acceleration,
                lateral,
                station,
                offset,
                *size,
            )
        )
        frame = VehicleFrame(names, [body.kind for body in bodies], route_lane, columns)
        return frame if ego is None else frame.near(ego.x, ego.y, self._range)

    # Which vehicles ----------------------------------------------------------------------------

    def _on_lanes(self, ego: EgoState | None) -> dict[str, str]:
        """Lane of every vehicle that may be in view."""
        api = self._api
        if ego is not None:
            view = self._lanes_in_view(ego.x, ego.y)
            if LANE_COST * len(view) <= api.vehicle.getIDCount():
                ids = api.lane.getLastStepVehicleIDs
                return {name: lane for lane in view for name in ids(lane)}
            near = set(view)
            where = api.vehicle.getLaneID
            return {name: lane for name in api.vehicle.getIDList() if (lane := where(name)) in near}
        where = api.vehicle.getLaneID
        return {name: lane for name in api.vehicle.getIDList() if (lane := where(name))}

    def _lanes_in_view(self, x: float, y: float) -> list[str]:
        if self._view_place is not None:
            dx, dy = x - self._view_place[0], y - self._view_place[1]
            if dx * dx + dy * dy < VIEW_KEPT * VIEW_KEPT:
                return self._view
        names, boxes = self._lanes.boxes()
        sumo_x, sumo_y = self._lanes.to_sumo(x, y)
        reach = self._range + VIEW_MARGIN + VIEW_KEPT
        dx = np.maximum(np.maximum(boxes[0] - sumo_x, sumo_x - boxes[2]), 0.0)
        dy = np.maximum(np.maximum(boxes[1] - sumo_y, sumo_y - boxes[3]), 0.0)
        self._view = [names[k] for k in np.flatnonzero(np.hypot(dx, dy) < reach).tolist()]
        self._view_place = (x, y)
        return self._view

    def _note_lanes(self, names: list[str], on: dict[str, str]) -> None:
        """Remembers where the vehicles came from."""
        before = self._on
        for name in names:
            lane = on[name]
            last = before.get(name)
            if last != lane:
                before[name] = lane
                if last is not None:
                    history = self._history.get(name, ())
                    self._history[name] = (last, *history)[:HISTORY]

    def _behind(self, name: str, lane: str, position: float) -> tuple[int, float]:
        """Lane and position of a place before the beginning of a vehicle's lane."""
        came_from = self._history.get(name, ())
        while position < 0.0:
            before = self._lanes.before(lane)
            if not before:
                break
            lane = next((known for known in came_from if known in before), before[0])
            position += self._lanes.table(lane).length
        return self._lanes.poses.number(lane), position

    def _body(self, name: str) -> _Body:
        found = self._bodies.get(name)
        if found is None:
            kind = self._vehicles.type_of(name)
            found = _Body(kind.kind, (kind.length, kind.width, kind.height))
            self._bodies[name] = found
        return found
