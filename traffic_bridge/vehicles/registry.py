"""Reads and changes the types and parameters of the vehicles in a running simulation."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterable, KeysView
from typing import TYPE_CHECKING, Any

from iits_mj.core.errors import InputError
from traffic_bridge.overrides import Overrides, Undo
from traffic_bridge.vehicles.types import (
    LC2013_ATTRIBUTES,
    MOBIL_FIELDS,
    SUMO_NAMES,
    Color,
    VehicleType,
    changed,
    check_changes,
    check_color,
)

if TYPE_CHECKING:
    from traffic_bridge.session import Session


class Vehicles:
    """The vehicles of a running simulation: `traffic.vehicles` of PureSim and InterSim.

    Args:
      session: the running SUMO.
      types: the vehicle types at SUMO's start.
    """

    def __init__(self, session: Session, types: tuple[VehicleType, ...]) -> None:
        self._session = session
        self._base = {vehicle_type.name: vehicle_type for vehicle_type in types}
        self._types = dict(self._base)
        self._overrides = Overrides()
        self._of_vehicle: dict[str, VehicleType] = {}
        self._individual: dict[str, VehicleType] = {}
        self._drawn: dict[str, float] = {}
        self._desired: dict[str, float] = {}
        self._ceilings: dict[str, dict[str, float]] = {}
        self._scripted: set[str] = set()
        self._to_apply: list[str] = []
        self._listeners: list[Callable[[str], None]] = []

    def add(
        self,
        name: str,
        vehicle_type: str,
        desired_speed: float,
        scripted: bool = False,
        driver: VehicleType | None = None,
    ) -> float:
        """Registers a new vehicle; returns its desired speed with all changes in force [m/s].

        Args:
          name: of the vehicle.
          vehicle_type: name of its type.
          desired_speed: [m/s].
          scripted: an event drives it: it keeps its lane and ignores speed changes of its type.
          driver: the type with this driver's own time headway; None: that of the type.
        """
        kind = self._types[vehicle_type]
        if driver is not None:
            self._individual[name] = driver
            kind = changed(kind, {"time_headway": driver.time_headway})
        self._of_vehicle[name] = kind
        self._drawn[name] = desired_speed
        if scripted:
            self._scripted.add(name)
        self._desired[name] = self._wanted(name, "desired_speed")
        if not LC2013_ATTRIBUTES.keys().isdisjoint(self._overrides.fields(vehicle_type)):
            self._to_apply.append(name)
        return self._desired[name]

    def apply_type_overrides(self) -> None:
        """Applies type overrides to new vehicles that SUMO does not apply by itself."""
        if not self._to_apply:
            return
        names, self._to_apply = self._to_apply, []
        for name in names:
            if name in self._of_vehicle:
                # SUMO does not apply a type's changed LC2013 parameters to later vehicles.
                of_type = self._overrides.fields(self._of_vehicle[name].name)
                fields = [field for field in of_type if field in LC2013_ATTRIBUTES]
                self._refresh_vehicle(name, fields)

    def forget(self, name: str) -> None:
        """Drops a vehicle that has left the traffic, and calls the listeners."""
        for table in (
            *(self._of_vehicle, self._individual),
            *(self._drawn, self._desired, self._ceilings),
        ):
            table.pop(name, None)
        self._scripted.discard(name)
        self._overrides.forget(name)
        for listener in self._listeners:
            listener(name)

    def when_forgotten(self, listener: Callable[[str], None]) -> None:
        """Adds a function that is called with the name of every vehicle that leaves."""
        self._listeners.append(listener)

    def drop_lost(self) -> None:
        """Drops vehicles that SUMO removed because they found no room to depart."""
        with self._session.guard("reading the vehicles"):
            api = self._session.api
            there = {*api.vehicle.getIDList(), *api.simulation.getPendingVehicles()}
        for name in [name for name in self._of_vehicle if name not in there]:
            self.forget(name)

    def unscript(self, name: str) -> None:
        """Makes a scripted vehicle an ordinary one."""
        self._scripted.discard(name)

    def ids(self) -> list[str]:
        """Names of the vehicles, sorted."""
        self.drop_lost()
        return sorted(self._of_vehicle)

    def names(self) -> KeysView[str]:
        """Names of the vehicles, as a set view."""
        return self._of_vehicle.keys()

    def __contains__(self, name: object) -> bool:
        return name in self._of_vehicle

    def type_of(self, name: str) -> VehicleType:
        """The vehicle's type with all changes in force; InputError if there is no such vehicle."""
        try:
            return self._of_vehicle[name]
        except (KeyError, TypeError):
            raise InputError(f"no vehicle {name!r} in the traffic") from None

    def types(self) -> tuple[VehicleType, ...]:
        """The types of future vehicles, with all changes in force."""
        return tuple(self._types.values())

    def is_scripted(self, name: str) -> bool:
        """Whether an event drives the vehicle: it stands or is part of a convoy."""
        return name in self._scripted

    def desired_speed(self, name: str) -> float:
        """Desired speed of a vehicle on a road without speed limits [m/s]."""
        self.type_of(name)
        return self._desired[name]

    def limited(self) -> KeysView[str]:
        """Names of the vehicles that `hold_below` has limited, as a set view."""
        return self._ceilings.keys()

    def present_speed(self, name: str) -> float:
        """Desired speed within the variable limits and zipper merges in force [m/s]."""
        return min(self.desired_speed(name), *self._ceilings.get(name, {}).values(), math.inf)

    def color(self, name: str) -> Color:
        """Color of a vehicle: red, green, blue from 0 to 1; its name selects one of its type's."""
        self.type_of(name)
        color: Color = self._wanted(name, "color")
        return color

    def in_force(self, name: str) -> dict[str, Any]:
        """The present value of every parameter that `change` takes, for one vehicle.

        Parameters that SUMO uses are read back from SUMO; `desired_speed` includes variable speed
        limits.

        Raises:
          InputError: there is no such vehicle.
        """
        self.drop_lost()
        kind = self.type_of(name)
        api = self._session.api.vehicle
        found: dict[str, Any] = {}
        with self._session.guard(f"reading vehicle {name}"):
            for field, sumo_name in SUMO_NAMES.items():
                found[field] = float(getattr(api, f"get{sumo_name}")(name))
            for field, attribute in LC2013_ATTRIBUTES.items():
                found[field] = float(api.getParameter(name, f"laneChangeModel.{attribute}"))
        for field in MOBIL_FIELDS:
            found[field] = getattr(kind, field)
        found["color"] = self.color(name)
        return found

    def change(self, target: str, **values: Any) -> Undo:
        """Changes parameters of one vehicle, or of all present and future vehicles of a type.

        Of several changes of one parameter, of the vehicle or of its type, the newest one that was
        not undone holds. Speeds of types do not apply to vehicles driven by events.

        Args:
          target: name of a vehicle, or of a type ("car", "van", "truck", "articulated", own ones).
          **values: of `time_headway`, `minimum_gap`, `acceleration`, `deceleration`,
            `emergency_deceleration`, `desired_speed` [m/s], `politeness`, `change_threshold`,
            `keep_right_bias`, `safe_braking`, the `lc_...` of `VehicleType`, and `color`
            (red, green, blue from 0 to 1).

        Returns:
          A function that undoes this change, also for newer vehicles. Then the newest other change
          holds, or else the original value.

        Raises:
          InputError: unknown vehicle, unknown parameter or a value that is not allowed.
          TrafficError: the simulation has ended.
        """
        check_changes(target, values)
        if "color" in values:
            values["color"] = check_color(target, values["color"])
        self.drop_lost()
        if target not in self._types:
            self.type_of(target)
        fields = tuple(values)
        undo = self._overrides.add(target, values, lambda: self._refresh(target, fields))
        self._refresh(target, fields)
        return undo

    def hold_below(self, name: str, speed: float | None, why: str = "limit") -> None:
        """Limits a vehicle to a speed [m/s] for a reason; None removes the limit of that reason.

        Of several reasons the lowest speed holds.
        """
        if name not in self._of_vehicle:
            return
        reasons = self._ceilings.setdefault(name, {})
        if speed is None:
            if reasons.pop(why, None) is None:
                return
        elif abs(reasons.get(why, math.inf) - speed) < 1e-9:
            return
        else:
            reasons[why] = speed
        with self._session.guard(f"holding {name}"):
            self._session.api.vehicle.setMaxSpeed(name, max(self.present_speed(name), 0.01))

    def _wanted(self, name: str, field: str) -> Any:
        """The newest override of a vehicle's or its type's field, else the original value."""
        base = self._individual.get(name) or self._base[self._of_vehicle[name].name]
        # Events set the speed of scripted vehicles, types do not.
        own = field == "desired_speed" and name in self._scripted
        value = self._overrides.newest(field, *((name,) if own else (name, base.name)))
        if value is not None:
            return value
        if field == "desired_speed":
            return self._drawn[name]
        return base.color_of(name) if field == "color" else getattr(base, field)

    def _refresh(self, target: str, fields: Iterable[str]) -> None:
        """Applies the present overrides of a vehicle or type."""
        if target not in self._types:
            self._refresh_vehicle(target, fields)
            return
        self._refresh_type(target, fields)
        for name in [name for name, kind in self._of_vehicle.items() if kind.name == target]:
            scripted = name in self._scripted
            mine = [field for field in fields if field != "desired_speed" or not scripted]
            self._refresh_vehicle(name, mine)

    def _refresh_vehicle(self, name: str, fields: Iterable[str]) -> None:
        values = {field: self._wanted(name, field) for field in fields}
        kind = changed(self._of_vehicle[name], values)
        if "color" in values:
            kind = dataclasses.replace(kind, colors=self._types[kind.name].colors)
        self._of_vehicle[name] = kind
        if "desired_speed" in values:
            self._desired[name] = float(values["desired_speed"])
            values["desired_speed"] = self.present_speed(name)
        # A vehicle with a speed of its own has a private copy of its type in SUMO.
        self._apply(self._session.api.vehicle, name, values)

    def _refresh_type(self, target: str, fields: Iterable[str]) -> None:
        base = self._base[target]
        # Each vehicle has its own desired speed; SUMO's type keeps the highest one.
        newest = {f: self._overrides.newest(f, target) for f in fields if f != "desired_speed"}
        color = newest.pop("color", None)
        values = {f: getattr(base, f) if v is None else v for f, v in newest.items()}
        kind = changed(self._types[target], values)
        if "color" in fields:
            colors = base.colors if color is None else (color,)
            kind = dataclasses.replace(kind, colors=colors)
        self._types[target] = kind
        self._apply(self._session.api.vehicletype, target, values)

    def _apply(self, domain: Any, target: str, values: dict[str, Any]) -> None:
        if not values:
            return
        with self._session.guard(f"changing {', '.join(values)} of {target}"):
            for name, value in values.items():
                if name in SUMO_NAMES:
                    getattr(domain, f"set{SUMO_NAMES[name]}")(target, float(value))
                elif name in LC2013_ATTRIBUTES and domain is self._session.api.vehicle:
                    attribute = f"laneChangeModel.{LC2013_ATTRIBUTES[name]}"
                    domain.setParameter(target, attribute, str(value))
