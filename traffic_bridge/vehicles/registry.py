"""The vehicles of a running simulation: what each one is, and how to change it."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, KeysView
from typing import TYPE_CHECKING, Any

from iits_mj.errors import InputError
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
        self._types = {vehicle_type.name: vehicle_type for vehicle_type in types}
        self._of_vehicle: dict[str, VehicleType] = {}
        self._drawn: dict[str, float] = {}
        self._desired: dict[str, float] = {}
        self._ceilings: dict[str, dict[str, float]] = {}
        self._class_speed: dict[str, float] = {}
        self._colors: dict[str, Color] = {}
        self._scripted: set[str] = set()
        # LC2013's figures of a class, which SUMO does not hand on to vehicles that come later.
        self._class_motives: dict[str, dict[str, Any]] = {}
        self._undressed: list[str] = []

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
        self._desired[name] = desired_speed
        if scripted:
            self._scripted.add(name)
        else:
            self._desired[name] = self._class_speed.get(vehicle_type, desired_speed)
        if vehicle_type in self._class_motives:
            self._undressed.append(name)
        return self._desired[name]

    def dress(self) -> None:
        """Gives vehicles that were added since what SUMO does not take from their class."""
        if not self._undressed:
            return
        names, self._undressed = self._undressed, []
        for name in names:
            if name in self._of_vehicle:
                self._apply(
                    self._session.api.vehicle,
                    name,
                    self._class_motives.get(self._of_vehicle[name].name, {}),
                )

    def forget(self, name: str) -> None:
        """Drops a vehicle that has left."""
        for table in (self._of_vehicle, self._drawn, self._desired, self._ceilings, self._colors):
            table.pop(name, None)
        self._scripted.discard(name)

    def unscript(self, name: str) -> None:
        """Notes that a vehicle drives as others do from now on."""
        self._scripted.discard(name)

    # Reading -----------------------------------------------------------------------------------

    def ids(self) -> list[str]:
        """Names of the vehicles, sorted."""
        self._drop_lost()
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
        except KeyError:
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
        vehicle_type = self.type_of(name)
        return self._colors.get(name) or vehicle_type.color_of(name)

    def in_force(self, name: str) -> dict[str, Any]:
        """What holds for a vehicle now, each parameter that `change` takes.

        What SUMO acts on is read back from SUMO; `desired_speed` is what SUMO holds, with a limit
        by station in it.

        Raises:
          InputError: no such vehicle.
        """
        self._drop_lost()
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

    def change(self, target: str, **values: Any) -> Callable[[], None]:
        """Changes parameters of one vehicle, or of every present and future one of a type.

        Args:
          target: a vehicle's name, or a type's ("car", "van", "truck", "articulated", own ones).
          **values: of `time_headway`, `minimum_gap`, `acceleration`, `deceleration`,
            `emergency_deceleration`, `desired_speed` [m/s], `politeness`, `change_threshold`,
            `keep_right_bias`, `safe_braking`, the `lc_...` of `VehicleType`, and `color`
            (red, green, blue from 0 to 1).

        Returns:
          A function that puts these parameters back as they were, of vehicles that came since too.

        Raises:
          InputError: unknown vehicle, unknown parameter or a value that is not allowed.
        """
        check_changes(target, values)
        if "color" in values:
            values["color"] = check_color(target, values["color"])
        self._drop_lost()
        if target not in self._types:
            before = self._values_of(target, values)
            self._set(target, values)
            return lambda: self._set(target, before) if target in self.ids() else None
        members = [name for name, kind in self._of_vehicle.items() if kind.name == target]
        befores = {name: self._values_of(name, values) for name in members}
        class_before = (
            self._types[target],
            self._class_speed.get(target),
            dict(self._class_motives.get(target, {})),
        )
        self._set_class(target, values)
        for name in members:
            self._set(name, self._meant_for(name, values))

        def undo() -> None:
            self._restore_class(target, values, class_before)
            for name in self.ids():
                if self._of_vehicle[name].name == target:
                    former = befores.get(name) or self._class_values(name, values)
                    self._set(name, self._meant_for(name, former))

        return undo

    def hold_below(self, name: str, speed: float | None, why: str = "limit") -> None:
        """Keeps a vehicle at or below a speed [m/s], whatever it desires; None lets it go.

        Of several reasons the lowest speed holds; each is let go by itself.
        """
        reasons = self._ceilings.setdefault(name, {})
        if speed is None:
            if reasons.pop(why, None) is None or name not in self._of_vehicle:
                return
        elif abs(reasons.get(why, math.inf) - speed) < 1e-9:
            return
        else:
            reasons[why] = speed
        self._session.api.vehicle.setMaxSpeed(name, max(self.present_speed(name), 0.01))

    # Inside ------------------------------------------------------------------------------------

    def _drop_lost(self) -> None:
        """Forgets vehicles that SUMO gave up: for some seconds there was no room to depart."""
        api = self._session.api
        there = {*api.vehicle.getIDList(), *api.simulation.getPendingVehicles()}
        for name in [name for name in self._of_vehicle if name not in there]:
            self.forget(name)

    def _meant_for(self, name: str, values: dict[str, Any]) -> dict[str, Any]:
        """What of a class's change holds for a vehicle: events set the speed of scripted ones."""
        if name not in self._scripted:
            return values
        return {field: value for field, value in values.items() if field != "desired_speed"}

    def _values_of(self, name: str, wanted: dict[str, Any]) -> dict[str, Any]:
        kind = self.type_of(name)
        own: dict[str, Any] = {"desired_speed": self._desired[name], "color": self.color(name)}
        return {field: own[field] if field in own else getattr(kind, field) for field in wanted}

    def _class_values(self, name: str, wanted: dict[str, Any]) -> dict[str, Any]:
        """What a vehicle would have been given, had its class not been changed."""
        kind = self._types[self._of_vehicle[name].name]
        speed = self._class_speed.get(kind.name, self._drawn[name])
        own: dict[str, Any] = {"desired_speed": speed, "color": kind.color_of(name)}
        return {field: own[field] if field in own else getattr(kind, field) for field in wanted}

    def _set(self, name: str, values: dict[str, Any]) -> None:
        self._of_vehicle[name] = changed(self._of_vehicle[name], values)
        if "color" in values:
            self._colors[name] = values["color"]
        if "desired_speed" in values:
            self._desired[name] = float(values["desired_speed"])
            values = {**values, "desired_speed": self.present_speed(name)}
        # A vehicle with a speed of its own has a private copy of its type in SUMO.
        self._apply(self._session.api.vehicle, name, values)

    def _set_class(self, target: str, values: dict[str, Any]) -> None:
        self._types[target] = changed(self._types[target], values)
        if "color" in values:
            color = (values["color"],)
            self._types[target] = dataclasses.replace(self._types[target], colors=color)
        if "desired_speed" in values:
            self._class_speed[target] = float(values["desired_speed"])
        motives = {n: v for n, v in values.items() if n in LC2013_ATTRIBUTES}
        if motives:
            self._class_motives.setdefault(target, {}).update(motives)
        # Each vehicle is given its desired speed when it comes; SUMO's class keeps its highest.
        rest = {name: value for name, value in values.items() if name != "desired_speed"}
        self._apply(self._session.api.vehicletype, target, rest)

    def _restore_class(
        self,
        target: str,
        values: dict[str, Any],
        before: tuple[VehicleType, float | None, dict[str, Any]],
    ) -> None:
        kind, speed, motives = before
        fields: dict[str, Any] = {
            n: getattr(kind, n) for n in values if n not in ("color", "desired_speed")
        }
        self._set_class(target, fields)
        if "color" in values:
            self._types[target] = dataclasses.replace(self._types[target], colors=kind.colors)
        if "desired_speed" in values:
            self._class_speed.pop(target, None)
            if speed is not None:
                self._class_speed[target] = speed
        if self._class_motives.get(target) and not motives:
            self._class_motives.pop(target)

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
