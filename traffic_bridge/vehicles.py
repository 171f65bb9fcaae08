"""Vehicle meta-information: kinds, dimensions, behaviour; changed for one or a class in the run."""

from __future__ import annotations

import dataclasses
import math
import tomllib
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any
from xml.sax.saxutils import quoteattr

import numpy as np

from iits_mj.errors import InputError

if TYPE_CHECKING:
    from traffic_bridge.session import Session

KINDS = ("car", "van", "truck", "articulated")

# What `Vehicles.change` can change, and the SUMO setter of each (vehicle and vehicle type alike).
_SETTERS = {
    "time_headway": "setTau",
    "minimum_gap": "setMinGap",
    "acceleration": "setAccel",
    "deceleration": "setDecel",
    "emergency_deceleration": "setEmergencyDecel",
    "desired_speed": "setMaxSpeed",
}
# Read by our own MOBIL only.
_MOBIL_FIELDS = ("politeness", "change_threshold", "keep_right_bias", "safe_braking")


@dataclass(frozen=True)
class VehicleType:
    """One kind of vehicle; defaults with their sources are in `vehicle_types.toml`.

    Attributes:
      kind: "car", "van", "truck" (rigid) or "articulated".
      length, width, height: [m].
      minimum_gap: IDM standstill gap s0 [m]; time_headway: IDM T [s].
      acceleration, deceleration: IDM a and b, both positive [m/s2].
      emergency_deceleration: the hardest braking possible [m/s2].
      desired_speed_mean, desired_speed_deviation, desired_speed_low: of the normal distribution of
        the desired speed as a fraction of the traffic's maximum speed, cut to [low, 1].
      politeness: MOBIL p; change_threshold: MOBIL a_th [m/s2]; keep_right_bias: MOBIL a_bias
        [m/s2]; safe_braking: MOBIL b_safe [m/s2].
    """

    kind: str
    length: float
    width: float
    height: float
    minimum_gap: float
    time_headway: float
    acceleration: float
    deceleration: float
    emergency_deceleration: float
    desired_speed_mean: float
    desired_speed_deviation: float
    desired_speed_low: float
    politeness: float
    change_threshold: float
    keep_right_bias: float
    safe_braking: float

    def __post_init__(self) -> None:
        """Checks that every figure is finite and not negative."""
        if self.kind not in KINDS:
            raise InputError(f"vehicle kind {self.kind!r}: allowed are {', '.join(KINDS)}")
        for entry in dataclasses.fields(self)[1:]:
            value = getattr(self, entry.name)
            if not (isinstance(value, (int, float)) and math.isfinite(value) and value >= 0.0):
                raise InputError(f"{self.kind}.{entry.name} = {value!r}: must be zero or positive")
        for name in ("length", "width", "height", "acceleration", "deceleration", "time_headway"):
            if getattr(self, name) <= 0.0:
                raise InputError(f"{self.kind}.{name} = {getattr(self, name)!r}: must be positive")

    def sample_desired_speed(self, maximum: float, rng: np.random.Generator) -> float:
        """Desired speed of one vehicle [m/s], for a traffic maximum speed [m/s]."""
        factor = rng.normal(self.desired_speed_mean, self.desired_speed_deviation)
        return float(maximum * min(max(factor, self.desired_speed_low), 1.0))

    def to_sumo_xml(self, maximum_speed: float) -> str:
        """The `vType` element: IDM, LC2013, no random term, every vehicle at its own speed.

        Args:
          maximum_speed: of the type before a vehicle gets its own [m/s].
        """
        attributes = {
            "id": self.kind,
            "length": self.length,
            "width": self.width,
            "height": self.height,
            "minGap": self.minimum_gap,
            "maxSpeed": maximum_speed,
            "carFollowModel": "IDM",
            "tau": self.time_headway,
            "accel": self.acceleration,
            "decel": self.deceleration,
            "emergencyDecel": max(self.emergency_deceleration, self.deceleration),
            "speedFactor": 1,
            "speedDev": 0,
            "laneChangeModel": "LC2013",
        }
        text = " ".join(f"{key}={quoteattr(str(value))}" for key, value in attributes.items())
        return f"<vType {text}/>"


@cache
def default_types() -> tuple[VehicleType, ...]:
    """The four kinds as `vehicle_types.toml` has them."""
    path = Path(__file__).with_name("vehicle_types.toml")
    with path.open("rb") as file:
        table = tomllib.load(file)
    return tuple(VehicleType(kind=kind, **table[kind]) for kind in KINDS)


class Vehicles:
    """The vehicles of a running simulation: what each one is, and how to change it.

    Made by PureSim and InterSim as `traffic.vehicles`.
    """

    def __init__(self, session: Session, types: tuple[VehicleType, ...]) -> None:
        self._session = session
        self._types = {vehicle_type.kind: vehicle_type for vehicle_type in types}
        self._of_vehicle: dict[str, VehicleType] = {}
        self._desired: dict[str, float] = {}
        self._class_speed: dict[str, float] = {}

    def add(self, name: str, kind: str, desired_speed: float) -> float:
        """Notes a vehicle that is being put on the road; returns the desired speed to use."""
        self._of_vehicle[name] = self._types[kind]
        self._desired[name] = self._class_speed.get(kind, desired_speed)
        return self._desired[name]

    def forget(self, name: str) -> None:
        """Drops a vehicle that has left."""
        self._of_vehicle.pop(name, None)
        self._desired.pop(name, None)

    def ids(self) -> list[str]:
        """Names of the vehicles, sorted."""
        return sorted(self._of_vehicle)

    def __contains__(self, name: object) -> bool:
        return name in self._of_vehicle

    def type_of(self, name: str) -> VehicleType:
        """The vehicle's present type, with the changes made to it."""
        try:
            return self._of_vehicle[name]
        except KeyError:
            raise InputError(f"no vehicle {name!r} in the traffic") from None

    def desired_speed(self, name: str) -> float:
        """Desired speed of a vehicle [m/s]."""
        self.type_of(name)
        return self._desired[name]

    def change(self, target: str, **values: float) -> None:
        """Changes parameters of one vehicle, or of every present and future one of a kind.

        Args:
          target: a vehicle's name, or one of "car", "van", "truck", "articulated".
          **values: of `time_headway`, `minimum_gap`, `acceleration`, `deceleration`,
            `emergency_deceleration`, `desired_speed` [m/s], `politeness`, `change_threshold`,
            `keep_right_bias`, `safe_braking`.

        Raises:
          InputError: unknown vehicle, unknown parameter or a value that is not finite and >= 0.
        """
        allowed = (*_SETTERS, *_MOBIL_FIELDS)
        for name, value in values.items():
            if name not in allowed:
                raise InputError(f"parameter {name!r}: allowed are {', '.join(allowed)}")
            if not (isinstance(value, (int, float)) and math.isfinite(value) and value >= 0.0):
                raise InputError(f"{target}.{name} = {value!r}: must be finite and not negative")
        fields: dict[str, Any] = {n: v for n, v in values.items() if n != "desired_speed"}
        if target in self._types:
            changed = dataclasses.replace(self._types[target], **fields)
            members = [n for n in self.ids() if self._of_vehicle[n].kind == target]
            self._types[target] = changed
            if "desired_speed" in values:
                self._class_speed[target] = values["desired_speed"]
            self._apply(self._session.api.vehicletype, target, values)
        else:
            self.type_of(target)
            members = [target]
        # A vehicle with a speed of its own has a private copy of its type in SUMO.
        for name in members:
            self._of_vehicle[name] = dataclasses.replace(self._of_vehicle[name], **fields)
            if "desired_speed" in values:
                self._desired[name] = values["desired_speed"]
            self._apply(self._session.api.vehicle, name, values)

    def _apply(self, domain: Any, target: str, values: dict[str, float]) -> None:
        for name, value in values.items():
            if name in _SETTERS:
                setter: Callable[[str, float], None] = getattr(domain, _SETTERS[name])
                with self._session.guard(f"changing {name} of {target}"):
                    setter(target, float(value))
