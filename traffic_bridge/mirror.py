"""Mirror: the nearest vehicles as mocap bodies in the truck's MuJoCo model.

A small pool of bodies per kind is added before the model is compiled. Every 0.1 s the nearest
vehicles get a slot and keep it while they are near; between two traffic steps they move on along
the road. Heights, grades and cross slopes come from the Route.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from iits_mj.errors import InputError
from iits_mj.messages import TrackedVehicle
from iits_mj.road import RoadPoint, Route
from traffic_bridge.bodies import PREFIX, add_assets, add_vehicle
from traffic_bridge.vehicles import KINDS, VehicleType, default_types

FloatArray = NDArray[np.float64]

DEFAULT_POOL = {"car": 14, "van": 5, "truck": 4, "articulated": 4}
PARKING_DEPTH = -500.0  # [m]: unused slots wait here, out of every camera's reach
PARKING_SPACING = 25.0  # [m]: stacked bodies would be slow in collision detection
# A vehicle with a slot counts as this much nearer, so that two at the edge do not take turns.
LOYALTY = 0.85
STANDING = 0.5  # [m/s] below which a box is not turned by its sideways speed


@dataclass
class _Slot:
    """A mocap body and who is shown by it."""

    name: str
    kind: str
    parking: tuple[float, float, float]
    mocap: int = -1
    vehicle: str | None = None


class Mirror:
    """Shows tracked vehicles in a MuJoCo model and detects contact with the truck.

        mirror = Mirror(route)
        truck = Truck.load(route=route, edit_spec=mirror.add_to)
        mirror.bind(truck.model)
        mirror.update(truck.data, vehicles, (ego.x, ego.y))
        mirror.contacts(truck.data)     # [("car.00012", "trailer")]

    Args:
      route: for slopes and curves; None for a flat plane.
      pool: number of bodies per kind; vehicles beyond it (the farthest) are not shown.
      view_range: vehicles farther away than this are not shown [m].
      types: dimensions by kind; default: the shipped ones.

    Raises:
      InputError: an unknown kind or a negative number in the pool.
    """

    def __init__(
        self,
        route: Route | None = None,
        pool: Mapping[str, int] | None = None,
        view_range: float = 400.0,
        types: Sequence[VehicleType] | None = None,
    ) -> None:
        pool = DEFAULT_POOL if pool is None else pool
        for kind, count in pool.items():
            if kind not in KINDS or isinstance(count, bool) or not 0 <= count <= 500:
                raise InputError(
                    f"pool {kind!r}: {count!r}; kinds are {', '.join(KINDS)}, counts 0 to 500"
                )
        if not view_range > 0.0:
            raise InputError(f"view_range {view_range!r}: must be positive")
        self.route = route
        self.view_range = view_range
        self._types = {t.kind: t for t in (types or default_types())}
        self._slots: list[_Slot] = []
        for kind, count in pool.items():
            for index in range(int(count)):
                place = (PARKING_SPACING * len(self._slots), 0.0, PARKING_DEPTH)
                self._slots.append(_Slot(f"{PREFIX}_{kind}_{index}", kind, place))
        self._shown: list[tuple[_Slot, TrackedVehicle]] = []
        self._here: RoadPoint | None = None
        self._geom_slot: dict[int, _Slot] = {}
        self._body_name: list[str] = []
        self._truck_geom: NDArray[np.bool_] = np.zeros(0, dtype=bool)
        self._traffic_geom: NDArray[np.bool_] = np.zeros(0, dtype=bool)

    # Building ----------------------------------------------------------------------------------

    def add_to(self, spec: mujoco.MjSpec) -> None:
        """Adds the pool to a specification, parked."""
        kinds = {slot.kind for slot in self._slots}
        add_assets(spec, [kind for name, kind in self._types.items() if name in kinds])
        for number, slot in enumerate(self._slots):
            body = spec.worldbody.add_body(name=slot.name, mocap=True, pos=list(slot.parking))
            add_vehicle(body, slot.name, self._types[slot.kind], number)

    def bind(self, model: mujoco.MjModel) -> None:
        """Finds the pool in a compiled model.

        Raises:
          InputError: the model was compiled without `add_to`.
        """
        self._geom_slot.clear()
        self._truck_geom = np.zeros(model.ngeom, dtype=bool)
        self._traffic_geom = np.zeros(model.ngeom, dtype=bool)
        self._body_name = [model.body(model.geom_bodyid[g]).name for g in range(model.ngeom)]
        by_body = {slot.name: slot for slot in self._slots}
        for slot in self._slots:
            body = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, slot.name)
            if body < 0:
                raise InputError(
                    f"the model has no body {slot.name!r}: give mirror.add_to to Truck.load as "
                    "edit_spec before it is compiled"
                )
            slot.mocap = int(model.body_mocapid[body])
            slot.vehicle = None
        for geom, name in enumerate(self._body_name):
            if name in by_body:
                self._geom_slot[geom] = by_body[name]
                self._traffic_geom[geom] = True
            else:
                self._truck_geom[geom] = model.body_weldid[model.geom_bodyid[geom]] != 0
        self._shown = []

    # Showing -----------------------------------------------------------------------------------

    def update(
        self,
        data: mujoco.MjData,
        vehicles: Sequence[TrackedVehicle] | None,
        ego_xy: tuple[float, float],
        elapsed: float = 0.0,
    ) -> int:
        """Puts the bodies where the vehicles are.

        Args:
          data: of the bound model; its `mocap_pos` and `mocap_quat` are written.
          vehicles: of the newest traffic step; None leaves those of the last call and only moves
            them on (cheap, for every physics step or picture).
          ego_xy: of the truck, in the map frame [m]; the nearest vehicles are shown.
          elapsed: time since that traffic step [s]. Vehicles move on along the road with their
            speed and acceleration; minus 0.1 to 0 gives what was before.

        Returns:
          The number of vehicles shown.
        """
        if not self._body_name:
            raise InputError("call mirror.bind(model) before update")
        if vehicles is not None:
            self._assign(data, vehicles, ego_xy)
        if self._shown:
            position, quaternion = self._poses(elapsed)
            data.mocap_pos[self._index] = position
            data.mocap_quat[self._index] = quaternion
        return len(self._shown)

    def slot_of(self, vehicle: str) -> str | None:
        """Name of the body that shows a vehicle, None if it is not shown."""
        return next((slot.name for slot, seen in self._shown if seen.id == vehicle), None)

    def _assign(
        self,
        data: mujoco.MjData,
        vehicles: Sequence[TrackedVehicle],
        ego_xy: tuple[float, float],
    ) -> None:
        holders = {slot.vehicle: slot for slot in self._slots if slot.vehicle is not None}
        ranked: dict[str, list[tuple[float, str, TrackedVehicle]]] = {}
        for vehicle in vehicles:
            distance = math.hypot(vehicle.x - ego_xy[0], vehicle.y - ego_xy[1])
            if distance <= self.view_range:
                key = distance * (LOYALTY if vehicle.id in holders else 1.0)
                ranked.setdefault(vehicle.kind, []).append((key, vehicle.id, vehicle))
        self._shown = []
        for kind in self._types:
            slots = [slot for slot in self._slots if slot.kind == kind]
            ranking = sorted(ranked.get(kind, ()), key=lambda entry: entry[:2])
            chosen = {name: vehicle for _, name, vehicle in ranking[: len(slots)]}
            for slot in slots:
                if slot.vehicle is not None and slot.vehicle not in chosen:
                    slot.vehicle = None
                    data.mocap_pos[slot.mocap] = slot.parking
                    data.mocap_quat[slot.mocap] = (1.0, 0.0, 0.0, 0.0)
            free = iter([slot for slot in slots if slot.vehicle is None])
            for name, vehicle in chosen.items():
                slot = holders.get(name) or next(free)
                slot.vehicle = name
                self._shown.append((slot, vehicle))
        self._take()

    def _take(self) -> None:
        """Reads the shown vehicles into arrays and finds how they lie on the road."""
        fields = ("x", "y", "z", "yaw", "speed", "acceleration", "lateral_speed")
        rows = [vehicle for _, vehicle in self._shown]
        self._index = np.array([slot.mocap for slot, _ in self._shown], dtype=np.intp)
        self._columns = np.array([[getattr(v, name) for v in rows] for name in fields])
        self._station = np.array([v.station for v in rows])
        self._offset = np.array([v.offset for v in rows])
        self._here = None
        if self.route is not None and rows:
            self._here = here = self.route.evaluate(self._station, self._offset)
            # The vehicle's own heading against the road's: a lane change, or oncoming.
            self._turn = self._columns[3] - here.heading
            self._forward = np.where(np.cos(self._turn) >= 0.0, 1.0, -1.0)
            self._stretch = np.maximum(1.0 - here.curvature * self._offset, 0.2)

    def _poses(self, elapsed: float) -> tuple[FloatArray, FloatArray]:
        """Positions (n, 3) and quaternions (n, 4) of the shown vehicles."""
        x, y, z, yaw, speed, acceleration, lateral = self._columns
        # Braking ends at standstill: nobody rolls backwards because of the last step.
        slowest = 0.0 if elapsed > 0.0 else -np.inf
        way = elapsed * np.maximum(speed + 0.5 * elapsed * acceleration, slowest)
        side = np.where(speed > STANDING, elapsed * lateral, 0.0)
        if self.route is None or self._here is None:
            cosine, sine = np.cos(yaw), np.sin(yaw)
            flat = np.zeros_like(yaw)
            position = np.column_stack(
                (x + way * cosine - side * sine, y + way * sine + side * cosine, z)
            )
            return position, _quaternions(yaw, flat, flat)
        point, forward = self._here, self._forward
        if elapsed != 0.0:
            point = self.route.evaluate(
                self._station + forward * way / self._stretch, self._offset + forward * side
            )
        position = np.column_stack((point.x, point.y, point.z))
        slope, bank = np.arctan(point.grade), point.superelevation
        # Pitch is positive nose down (ISO 8855); both turn over with the direction of travel.
        return position, _quaternions(point.heading + self._turn, -forward * slope, forward * bank)

    # Contact -----------------------------------------------------------------------------------

    def contacts(self, data: mujoco.MjData) -> list[tuple[str, str]]:
        """(vehicle id, truck body) of every pair in contact, sorted; no force comes from it."""
        count = data.ncon
        if count == 0:
            return []
        pairs = data.contact.geom[:count]
        first, second = pairs[:, 0], pairs[:, 1]
        hits = (self._traffic_geom[first] & self._truck_geom[second]) | (
            self._traffic_geom[second] & self._truck_geom[first]
        )
        found = set()
        for k in np.flatnonzero(hits & (data.contact.dist[:count] <= 0.0)):
            a, b = int(first[k]), int(second[k])
            vehicle, truck = (a, b) if self._traffic_geom[a] else (b, a)
            name = self._geom_slot[vehicle].vehicle
            if name is not None:
                found.add((name, self._body_name[truck]))
        return sorted(found)


def _quaternions(yaw: FloatArray, pitch: FloatArray, roll: FloatArray) -> FloatArray:
    """Quaternions (n, 4), w first, of intrinsic z-y-x rotations."""
    cy, sy = np.cos(0.5 * yaw), np.sin(0.5 * yaw)
    cp, sp = np.cos(0.5 * pitch), np.sin(0.5 * pitch)
    cr, sr = np.cos(0.5 * roll), np.sin(0.5 * roll)
    return np.column_stack(
        (
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        )
    )
