"""Mirror: shows the nearest vehicles as mocap bodies in the truck's MuJoCo model.

A small pool of bodies is added before the model is compiled. Every 0.1 s the nearest vehicles get a
slot and keep it while they are near; between two traffic steps their motion is extrapolated. Poses
come from the traffic's frames alone, which include the road's height and slopes.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import mujoco

from iits_mj import kernels
from iits_mj.core.checks import is_number, is_whole
from iits_mj.core.errors import InputError
from iits_mj.core.messages import TrackedVehicle
from iits_mj.core.vehicles import VehicleFrame
from traffic_bridge.mirror.bodies import (
    PREFIX,
    ContactFinder,
    add_assets,
    add_unit,
    may_touch,
    unit_name,
)
from traffic_bridge.mirror.looks import LOOKS
from traffic_bridge.mirror.slots import Slot, Slots
from traffic_bridge.mirror.units import VehicleUnits
from traffic_bridge.vehicles.types import VehicleType, default_types, road_user_types

DEFAULT_POOL = {"car": 14, "van": 5, "truck": 4, "articulated": 4}
ROAD_USER_POOL = {"pedestrian": 2, "bicycle": 2, "obstacle": 2}
CROWD = {"pedestrian": 16, "bicycle": 8}  # slots where SUMO simulates them
LARGEST_POOL = 500
PARKING_DEPTH = -500.0  # [m]: unused bodies are here, out of every camera's view
PARKING_SPACING = 25.0  # [m]: stacked bodies would be slow in collision detection
# `may_touch` skips vehicles that are farther away than this relative speed covers, plus `NEARBY`.
SPEED_MAX = 100.0  # [m/s]
NEARBY = 1.0  # [m]


class Mirror:
    """Shows tracked vehicles in a MuJoCo model and detects contact with the truck.

        mirror = Mirror()
        truck = Truck.load(route=route, edit_spec=mirror.add_to)
        mirror.bind(truck.model)
        mirror.update(truck.data, vehicles, (ego.x, ego.y))
        mirror.contacts(truck.data)     # [("car.00012", "trailer")]

    Args:
      pool: number of slots by the name of a vehicle type; vehicles beyond it (the farthest) are not
        shown. Default: 14 cars, 5 vans, 4 trucks, 4 articulated trucks; types of your own share
        the number of their look.
      road_users: adds slots for pedestrians, cyclists and obstacles to the default pool, two of
        each or as many as given by kind; six bodies cost 3 % of a physics step.
      view_range: vehicles farther away than this are not shown [m].
      types: dimensions, looks and colors; default: those of the package.
      step_length: of the traffic [s].
      visuals: adds visible shapes; without them, the bodies only take part in contact detection.

    Raises:
      InputError: an unknown type or impossible number in the pool, or another impossible value.
    """

    def __init__(
        self,
        pool: Mapping[str, int] | None = None,
        *,
        view_range: float = 400.0,
        types: Sequence[VehicleType] | None = None,
        step_length: float = 0.1,
        visuals: bool = True,
        road_users: bool | Mapping[str, int] = True,
    ) -> None:
        types = tuple(types or default_types())
        names = [kind.name for kind in types]
        if len(set(names)) != len(names):
            raise InputError(f"types {', '.join(names)}: each name may occur once")
        others = [kind for kind in road_user_types() if kind.name not in names]
        # `VehicleUnits` needs vehicles of two units last.
        types = sorted((*types, *others), key=lambda kind: kind.look == "articulated")
        shared = pool is None
        if pool is None:
            none = dict.fromkeys(ROAD_USER_POOL, 0)
            extra = road_users if isinstance(road_users, Mapping) else ROAD_USER_POOL
            pool = DEFAULT_POOL | none | (dict(extra) if road_users else none)
        counts = _counts(pool, types, shared=shared)
        for name, value in (("view_range", view_range), ("step_length", step_length)):
            if not is_number(value) or value <= 0.0:
                raise InputError(f"{name} {value!r}: must be positive and finite")
        self.view_range = float(view_range)
        self._types = types
        self._visuals = visuals
        self._looks = [LOOKS[kind.look](kind) for kind in types]
        self._slots = Slots(types, counts, self.view_range)
        self._units = VehicleUnits(types, self._looks, step_length)
        numbers = [k for count in counts for k in range(count)]
        self._bodies = [
            tuple(
                unit_name(f"{PREFIX}_{types[slot.type].name}_{number}", unit)
                for unit in self._looks[slot.type]
            )
            for slot, number in zip(self._slots.all, numbers, strict=True)
        ]
        self._mocap: list[tuple[int, ...]] = []
        # Numbers of the mocap bodies that are shown, in the order of `VehicleUnits`.
        self._index = kernels.Table(())
        self._model: mujoco.MjModel | None = None
        self._finder: ContactFinder | None = None
        self._data: mujoco.MjData | None = None
        # Of its `mocap_pos`, `mocap_quat` and `geom_xpos`.
        self._addresses = 0, 0, 0

    def __getstate__(self) -> dict[str, Any]:
        # A copy takes the addresses of its own data when it is first updated.
        return vars(self) | {"_data": None}

    def add_to(self, spec: mujoco.MjSpec) -> None:
        """Adds the pool's bodies to a specification, at their parking positions."""
        used = {slot.type for slot in self._slots.all}
        if self._visuals:
            add_assets(spec, {self._types[k]: self._looks[k] for k in sorted(used)})
        for slot, names in zip(self._slots.all, self._bodies, strict=True):
            kind = self._types[slot.type]
            for number, unit in enumerate(self._looks[slot.type]):
                place = _parking(slot, number)
                add_unit(spec, names[number], kind, unit, slot.paint, place, self._visuals)

    def bind(self, model: mujoco.MjModel) -> None:
        """Finds the pool's bodies in a compiled model; no vehicle is shown yet.

        Raises:
          InputError: the model was compiled without `add_to`.
        """
        owner = {}
        self._mocap = []
        for slot, names in zip(self._slots.all, self._bodies, strict=True):
            bodies = [mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, name) for name in names]
            for name, body in zip(names, bodies, strict=True):
                if body < 0:
                    raise InputError(
                        f"the model has no body {name!r}: give mirror.add_to to Truck.load as "
                        "edit_spec before it is compiled"
                    )
                owner[name] = slot.place
            self._mocap.append(tuple(int(model.body_mocapid[body]) for body in bodies))
        self._model, self._data = model, None
        self._finder = ContactFinder(model, owner)
        self._slots.clear()
        self._units.clear()
        self._show_taken()

    def update(
        self,
        data: mujoco.MjData,
        vehicles: Iterable[TrackedVehicle] | None,
        ego_xy: tuple[float, float],
        elapsed: float = 0.0,
        now: VehicleFrame | None = None,
    ) -> int:
        """Moves the bodies to the poses of the vehicles.

        Args:
          data: of the bound model; its `mocap_pos` and `mocap_quat` are written.
          vehicles: of the newest traffic step, preferably a `VehicleFrame`; None keeps those of the
            last call and only extrapolates them (cheap, for every physics step or picture).
          ego_xy: of the truck, in the map frame [m]; the nearest vehicles are shown.
          elapsed: time since that traffic step [s]; see `units.moved`. From minus one step to 0 it
            gives the motion before.
          now: vehicles whose poses at this instant are known, for instance from a replay; the
            others are extrapolated.

        Returns:
          The number of vehicles shown.

        Raises:
          InputError: the mirror is not bound, the data are of another model, or a value is not
            finite.
        """
        if data is not self._data:
            self._take_addresses(data)
        if not math.isfinite(elapsed + ego_xy[0] + ego_xy[1]):
            raise InputError(f"ego_xy {ego_xy!r}, elapsed {elapsed!r}: must be finite")
        if vehicles is not None:
            frame = VehicleFrame.of(vehicles)
            changed = self._slots.assign(frame, *ego_xy)
            for slot in changed:
                if slot.vehicle is None:
                    for unit, mocap in enumerate(self._mocap[slot.place]):
                        data.mocap_pos[mocap] = _parking(slot, unit)
                        data.mocap_quat[mocap] = (1.0, 0.0, 0.0, 0.0)
            if changed:
                self._show_taken()
            self._units.take(frame, self._slots.rows)
        if self._units.slots:
            self._units.move(elapsed, now)
            position, quaternion, _ = self._addresses
            self._units.show(self._index, position, quaternion)
        return len(self._slots.taken)

    def _take_addresses(self, data: mujoco.MjData) -> None:
        """Takes the addresses of arrays of data, which last as long as the data."""
        if self._model is None:
            raise InputError("call mirror.bind(model) before update")
        if data.signature != self._model.signature:
            raise InputError("data were made for another model than that of mirror.bind")
        address, self._data = kernels.address, data
        self._addresses = (
            address(data.mocap_pos),
            address(data.mocap_quat),
            address(data.geom_xpos),
        )

    @property
    def shown(self) -> tuple[str, ...]:
        """Ids of the vehicles that are shown, sorted."""
        return tuple(sorted(slot.vehicle for slot in self._slots.taken if slot.vehicle))

    def bodies_of(self, vehicle: str) -> tuple[str, ...]:
        """Names of the bodies that show a vehicle: one, two (tractor, semitrailer) or none."""
        for slot in self._slots.taken:
            if slot.vehicle == vehicle:
                return self._bodies[slot.place]
        return ()

    def _show_taken(self) -> None:
        self._units.set_slots(self._slots.taken)
        self._index = kernels.Table(
            [
                self._mocap[slot.place][unit]
                for slot, unit in zip(self._units.slots, self._units.units, strict=True)
            ]
        )

    def contacts(self, data: mujoco.MjData) -> list[tuple[str, str]]:
        """(vehicle id, truck body) of every pair in contact, sorted; contacts exert no force.

        They belong to the positions last computed: after `mj_step` to the state before it, after
        `mj_forward` to the present state.
        """
        if self._finder is None:
            return []
        slots = self._slots.all
        pairs = {(slots[place].vehicle, body) for place, body in self._finder.pairs(data)}
        return sorted((vehicle, body) for vehicle, body in pairs if vehicle is not None)

    @property
    def finds_all(self) -> bool:
        """Whether no other contacts than those of `contacts` are possible in the bound model."""
        return self._finder is not None and self._finder.complete

    def may_touch(self, data: mujoco.MjData, within: float) -> bool:
        """Whether the truck may touch a shown vehicle within a time, however both move.

        If False, contacts need not be read at every physics step, and with `finds_all` MuJoCo need
        not look for them; see `bodies.may_touch`.

        Args:
          data: of the bound model, its positions and velocities computed (`mj_forward`).
          within: [s].
        """
        finder, units = self._finder, self._units
        if finder is None or not units.slots:
            return False
        if data is not self._data:
            self._take_addresses(data)
        _, _, centers = self._addresses
        near = units.near(finder.hull, finder.radius, centers, SPEED_MAX * within + NEARBY)
        if not near:
            return False
        truck = finder.truck_outlines(data)
        return any(
            may_touch(part, outline, within)
            for outline in map(units.outline, near)
            for part in truck
        )


def _parking(slot: Slot, unit: int) -> tuple[float, float, float]:
    return PARKING_SPACING * slot.place, PARKING_SPACING * unit, PARKING_DEPTH


def _counts(pool: Mapping[str, int], types: Sequence[VehicleType], *, shared: bool) -> list[int]:
    """Number of slots of each type; `shared` divides the pool's among the types of a look."""
    if shared:
        looks = [kind.look for kind in types]
        return [-(-pool[kind.look] // looks.count(kind.look)) for kind in types]
    if not isinstance(pool, Mapping):
        raise InputError(f"pool {pool!r}: give numbers of slots by name of type, {{'car': 14}}")
    known = [kind.name for kind in types]
    for name, count in pool.items():
        if name not in known or not is_whole(count) or not 0 <= count <= LARGEST_POOL:
            raise InputError(
                f"pool {name!r}: {count!r}; types are {', '.join(known)}, "
                f"counts 0 to {LARGEST_POOL}"
            )
    return [pool.get(kind.name, 0) for kind in types]
