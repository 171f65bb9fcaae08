"""The vehicles of a running simulation: what each one is, and how to change it."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterable, KeysView
from typing import TYPE_CHECKING, Any

from iits_mj.core.errors import InputError
from traffic_bridge.overrides import Overrides, Undo
from traffic_bridge.vehicles.changes import MOBIL_FIELDS, SUMO_NAMES, changed, check_changes
from traffic_bridge.vehicles.types import (
    HEAVY,
    KINDS,
    LC2013_ATTRIBUTES,
    Color,
    VehicleType,
    check_color,
    default_types,
    read_types,
)

if TYPE_CHECKING:
    from traffic_bridge.session import Session

__all__ = ["HEAVY", "KINDS", "Color", "VehicleType", "Vehicles", "default_types", "read_types"]


class Vehicles:
    """The vehicles of a running simulation; PureSim and InterSim offer it as `traffic.vehicles`.

    Args:
      session: the running SUMO.
      types: the vehicle types that SUMO was started with.
    """

    def __init__(self, session: Session, types: tuple[VehicleType, ...]) -> None:
        self._session = session
        self._base = {vehicle_type.name: vehicle_type for vehicle_type in types}
        self._types = dict(self._base)
        self._overrides = Overrides()
        self._of_vehicle: dict[str, VehicleType] = {}
        self._drawn: dict[str, float] = {}
        self._desired: dict[str, float] = {}
        self._ceilings: dict[str, dict[str, float]] = {}
        self._scripted: set[str] = set()
        self._undressed: list[str] = []
        self._told: list[Callable[[str], None]] = []

    # Coming and going, called by who puts vehicles on the road ---------------------------------

    def add(
        self, name: str, vehicle_type: str, desired_speed: float, scripted: bool = False
    ) -> float:
        """Notes a vehicle that is being put on the road; returns the desired speed to use.

        Args:
          name: of the vehicle.
          vehicle_type: name of its type.
          desired_speed: [m/s].
          scripted: it is driven by an event: no lane change of its own, no speed of its class.
        """
        self._of_vehicle[name] = self._types[vehicle_type]
        self._drawn[name] = desired_speed
        if scripted:
            self._scripted.add(name)
        self._desired[name] = self._wanted(name, "desired_speed")
        if not LC2013_ATTRIBUTES.keys().isdisjoint(self._overrides.fields(vehicle_type)):
            self._undressed.append(name)
        return self._desired[name]

    def dress(self) -> None:
        """Gives vehicles that were added since what SUMO does not take from their class."""
        if not self._undressed:
            return
        names, self._undressed = self._undressed, []
        for name in names:
            if name in self._of_vehicle:
                # LC2013's figures of a class: SUMO does not hand them on to who comes later.
                of_class = self._overrides.fields(self._of_vehicle[name].name)
                motives = [field for field in of_class if field in LC2013_ATTRIBUTES]
                self._refresh_vehicle(name, motives)

    def forget(self, name: str) -> None:
        """Drops a vehicle that has left, and tells who asked for it."""
        for table in (self._of_vehicle, self._drawn, self._desired, self._ceilings):
            table.pop(name, None)
        self._scripted.discard(name)
        self._overrides.forget(name)
        for tell in self._told:
            tell(name)

    def when_forgotten(self, tell: Callable[[str], None]) -> None:
        """Has a function called with the name of every vehicle that has left."""
        self._told.append(tell)

    def drop_lost(self) -> None:
        """Forgets vehicles that SUMO gave up: for some seconds there was no room to depart."""
        with self._session.guard("reading the vehicles"):
            api = self._session.api
            there = {*api.vehicle.getIDList(), *api.simulation.getPendingVehicles()}
        for name in [name for name in self._of_vehicle if name not in there]:
            self.forget(name)

    def unscript(self, name: str) -> None:
        """Notes that a vehicle drives as others do from now on."""
        self._scripted.discard(name)

    # Reading -----------------------------------------------------------------------------------

    def ids(self) -> list[str]:
        """Names of the vehicles, sorted."""
        self.drop_lost()
        return sorted(self._of_vehicle)

    def names(self) -> KeysView[str]:
        """Names of the vehicles, as a set that is always up to date."""
        return self._of_vehicle.keys()

    def __contains__(self, name: object) -> bool:
        return name in self._of_vehicle

    def type_of(self, name: str) -> VehicleType:
        """The vehicle's present type, with the changes made to it."""
        try:
            return self._of_vehicle[name]
        except (KeyError, TypeError):
            raise InputError(f"no vehicle {name!r} in the traffic") from None

    def types(self) -> tuple[VehicleType, ...]:
        """The types of vehicles to come, with the changes made to their classes."""
        return tuple(self._types.values())

    def is_scripted(self, name: str) -> bool:
        """Whether an event drives it: a standing or convoy vehicle, which keeps its lane."""
        return name in self._scripted

    def desired_speed(self, name: str) -> float:
        """Desired speed of a vehicle on a road without limits [m/s]."""
        self.type_of(name)
        return self._desired[name]

    def present_speed(self, name: str) -> float:
        """Desired speed where it is: at most what limits by station and courtesy allow [m/s]."""
        return min(self.desired_speed(name), *self._ceilings.get(name, {}).values(), math.inf)

    def color(self, name: str) -> Color:
        """Paint of a vehicle, red, green, blue from 0 to 1: by its name from its type's colors."""
        self.type_of(name)
        color: Color = self._wanted(name, "color")
        return color

    def in_force(self, name: str) -> dict[str, Any]:
        """What holds for a vehicle now, each parameter that `change` takes.

        What SUMO acts on is read back from SUMO; `desired_speed` is what SUMO holds, with a limit
        by station in it.

        Raises:
          InputError: no such vehicle.
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

    # Changing ----------------------------------------------------------------------------------

    def change(self, target: str, **values: Any) -> Undo:
        """Changes parameters of one vehicle, or of every present and future one of a type.

        Of several changes of one parameter the newest that was not put back holds, those of a
        vehicle and of its type alike; speeds of types do not hold for vehicles driven by events.

        Args:
          target: a vehicle's name, or a type's ("car", "van", "truck", "articulated", own ones).
          **values: of `time_headway`, `minimum_gap`, `acceleration`, `deceleration`,
            `emergency_deceleration`, `desired_speed` [m/s], `politeness`, `change_threshold`,
            `keep_right_bias`, `safe_braking`, the `lc_...` of `VehicleType`, and `color`
            (red, green, blue from 0 to 1).

        Returns:
          A function that takes this change back, of vehicles that came since too: what was changed
          before or in the meantime holds then, else what the type and the vehicle began with.

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
        """Keeps a vehicle at or below a speed [m/s], whatever it desires; None lets it go.

        Of several reasons the lowest speed holds; each is let go by itself.
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

    # Inside ------------------------------------------------------------------------------------

    def _wanted(self, name: str, field: str) -> Any:
        """What is to hold for a vehicle: its or its class's newest order, else what it had."""
        base = self._base[self._of_vehicle[name].name]
        # Events set the speed of scripted vehicles, classes do not.
        own = field == "desired_speed" and name in self._scripted
        value = self._overrides.newest(field, *((name,) if own else (name, base.name)))
        if value is not None:
            return value
        if field == "desired_speed":
            return self._drawn[name]
        return base.color_of(name) if field == "color" else getattr(base, field)

    def _refresh(self, target: str, fields: Iterable[str]) -> None:
        """Puts into force what is ordered of a vehicle or class now."""
        if target not in self._types:
            self._refresh_vehicle(target, fields)
            return
        self._refresh_class(target, fields)
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

    def _refresh_class(self, target: str, fields: Iterable[str]) -> None:
        base = self._base[target]
        # Each vehicle is given its desired speed when it comes; SUMO's class keeps its highest.
        ordered = {f: self._overrides.newest(f, target) for f in fields if f != "desired_speed"}
        color = ordered.pop("color", None)
        values = {f: getattr(base, f) if v is None else v for f, v in ordered.items()}
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
