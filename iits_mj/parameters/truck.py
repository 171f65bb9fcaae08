"""A truck's parameters as frozen dataclasses, read from its `truck.toml` and CSV tables.

Every quantity of the TOML is `{ value, unit, grade, source }`; an overlay (for instance a file of
identified parameters) may give plain values. `docs/trucks.md` describes the format.
"""

from __future__ import annotations

import copy
import dataclasses
import functools
import hashlib
import json
import typing
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from iits_mj.core.boxes import UnitShape
from iits_mj.core.checks import in_range
from iits_mj.core.errors import InputError
from iits_mj.core.messages import EgoFootprint
from iits_mj.parameters.brakes import AirBrake
from iits_mj.parameters.files import (
    Overlay,
    Stamps,
    build,
    read_truck,
    shipped_state,
    shipped_trucks,
)
from iits_mj.parameters.powertrain import Clutch, Engine, Gearbox, Retarder
from iits_mj.parameters.quantity import (
    Damping,
    Density,
    Inertia,
    Meters,
    NewtonMeters,
    Newtons,
    PerRadian,
    Pure,
    Radians,
    RadiansPerSecond,
    Radius,
    Ratio,
    RollDamping,
    RollStiffness,
    Seconds,
    Speed,
    SpringRate,
    SquareMeters,
    Tires,
)
from iits_mj.parameters.units import Axle, Coupling, Unit

# The body of a tractor with a trailer counts up to here behind its last axle [m]: the rest of the
# frame is under the trailer.
_BEHIND_AXLE = 0.6


@dataclass(frozen=True)
class Steering:
    """Steering from steering wheel to road wheels.

    Attributes:
      ratio: steering-wheel angle over road-wheel angle.
      dead_band, angle_max, rate_max: at the steering wheel.
      stiffness, damping, knuckle_inertia: of each knuckle.
      time_constant: of the steering actuator.
      caster_trail, scrub_radius: distance of the tire's contact behind and beside the point where
        the kingpin's axis meets the road.
      kingpin_inclination: of that axis, inward.
      scrub_friction, scrub_arm: a tire that turns on the spot resists with its load times both.
      friction: of gear and column, at the steering wheel.
      boost_torque, boost_assistance: torque at the steering wheel, and of the power steering at the
        kingpins, both rising from 0; without them the driver steers alone.

    All after `time_constant` shape the sensor of the driver's torque only, not the motion.
    """

    ratio: Ratio
    dead_band: Radians
    angle_max: Radians
    rate_max: RadiansPerSecond
    stiffness: RollStiffness
    damping: RollDamping
    knuckle_inertia: Inertia
    time_constant: Seconds
    caster_trail: Meters = 0.0
    scrub_radius: Meters = 0.0
    kingpin_inclination: Radians = 0.0
    scrub_friction: Pure = 0.0
    scrub_arm: Meters = 0.0
    friction: NewtonMeters = 0.0
    boost_torque: tuple[NewtonMeters, ...] = ()
    boost_assistance: tuple[NewtonMeters, ...] = ()


@dataclass(frozen=True)
class Tire:
    """One kind of tire; stiffnesses are per tire, `count` tires make a wheel end.

    Attributes:
      free_radius: without load; rolling_radius: distance per turn over 2 pi, at the design load.
      vertical_stiffness, vertical_damping: of one tire.
      cornering_coefficient: cornering stiffness over the load, at the load `cornering_load`.
      pneumatic_trail: of the side force behind the contact's middle at small slip.
      rolling_resistance: over the load, at the load `rolling_resistance_load` of one tire.
      rolling_resistance_exponent: of the rolling resistance [N] over the load; 1: in proportion.
    """

    count: Tires
    free_radius: Radius
    rolling_radius: Radius
    vertical_stiffness: SpringRate
    vertical_damping: Damping
    cornering_coefficient: PerRadian
    cornering_load: Newtons
    pneumatic_trail: Meters
    rolling_resistance: Pure
    rolling_resistance_load: Newtons = 30e3
    rolling_resistance_exponent: Pure = 1.0


@dataclass(frozen=True)
class TireCommon:
    """Magic Formula parameters that all tires share."""

    nominal_load: Newtons
    friction_lateral: Pure
    friction_longitudinal: Pure
    friction_load_slope: Pure
    shape_lateral: Pure
    shape_longitudinal: Pure
    curvature_lateral: Pure
    curvature_longitudinal: Pure
    load_saturation: Pure
    slip_stiffness: Pure
    relaxation_lateral: Meters
    relaxation_load_exponent: Pure
    relaxation_longitudinal: Meters


@dataclass(frozen=True)
class Aerodynamics:
    """Air drag and side force of the combination.

    Attributes:
      drag_area, side_area: with their coefficients, of all units together.
      pressure_height: above the road.
      drag_yaw_angle, drag_area_increase: what a yaw angle of the air adds to the drag area: the
        drag is `rho/2 v^2 (drag_area cos(angle) + increase(angle))`.
      mean_wind: speed of a wind from all directions, over which the drag is averaged.
    """

    drag_area: SquareMeters
    side_area: SquareMeters
    pressure_height: Meters
    density: Density
    drag_yaw_angle: tuple[Radians, ...] = ()
    drag_area_increase: tuple[SquareMeters, ...] = ()
    mean_wind: Speed = 0.0

    def mean_drag_area(self, speed: float = 22.0) -> float:
        """Returns the drag area over the vehicle's speed squared [m2] in the mean wind.

        Args:
          speed: of the vehicle [m/s]; the default is a truck's on a highway.
        """
        if not self.mean_wind:
            return self.drag_area
        angle = np.linspace(0.0, 2.0 * np.pi, 360, endpoint=False)
        ahead = speed + self.mean_wind * np.cos(angle)
        air = np.hypot(ahead, self.mean_wind * np.sin(angle))
        yaw = np.arccos(np.clip(ahead / air, -1.0, 1.0))
        increase = np.zeros_like(angle)
        if self.drag_yaw_angle:
            increase = np.interp(yaw, self.drag_yaw_angle, self.drag_area_increase)
        force = air * ahead * self.drag_area + air**2 * increase * np.sign(ahead)
        return float(force.mean() / speed**2)


@dataclass(frozen=True)
class TruckParameters:
    """All parameters of a truck; `load` reads them, `dataclasses.replace` changes them.

    Attributes:
      name: of its folder.
      units: the motor vehicle and what it tows, front to rear.
    """

    name: str
    units: tuple[Unit, ...]
    steering: Steering
    tires: dict[str, Tire]
    tire_common: TireCommon
    aerodynamics: Aerodynamics
    engine: Engine
    retarder: Retarder
    clutch: Clutch
    gearbox: Gearbox
    air_brake: AirBrake
    description: str = ""

    @classmethod
    def load(
        cls,
        truck: AnyTruck | None = None,
        overlay: Overlay | Sequence[Overlay] | None = None,
    ) -> TruckParameters:
        """Reads a truck.

        Args:
          truck: name of a shipped truck, a `truck.toml`, a folder with one, or parameters, which
            are returned unchanged; default: the 6x4 tractor with semitrailer.
          overlay: a TOML file or a nested mapping with the values to change, for instance
            `{"engine": {"boost_lag": 0.5}, "tires": {"steer": {"free_radius": 0.54}}}`; or several,
            of which a later one has the last word.

        Raises:
          InputError: unreadable file, unknown or missing key, wrong type or unit, value that is not
            finite or out of its bounds, no possible truck; parameters with an overlay.
        """
        if isinstance(truck, TruckParameters):
            if overlay is not None:
                raise InputError("an overlay changes a truck's file: name it instead of parameters")
            return truck
        overlays: Sequence[Overlay] = ()
        if isinstance(overlay, (str, Path, Mapping)):
            overlays = (overlay,)
        elif overlay is not None:
            overlays = overlay
        shipped = None if overlays else shipped_state(truck)
        return copy.deepcopy(_shipped(*shipped)) if shipped else _built(truck, overlays)

    def __post_init__(self) -> None:
        """Checks what the parts must have in common."""
        lead, *towed = self.units or (None,)
        if lead is None or lead.coupling is not None:
            raise InputError("a truck needs a motor vehicle (kind tractor or rigid_truck)")
        for unit in towed:
            if unit.coupling is None:
                raise InputError(f"units.{unit.name} is a second motor vehicle; one is allowed")
        for axle in self.axles:
            if axle.tire not in self.tires:
                raise InputError(
                    f"axle {axle.name}: tire {axle.tire!r} is not one of {sorted(self.tires)}"
                )
        if not lead.axles[0].steered or all(axle.steered for axle in lead.axles):
            raise InputError(f"units.{lead.name}: the first axle must be steered, the last one not")
        if not any(axle.driven for axle in lead.axles):
            raise InputError(f"units.{lead.name} has no driven axle")
        for unit in self.units:
            if not all(unit.groups(0.0)):
                raise InputError(
                    f"units.{unit.name}: lifted_below lifts a whole group; one axle must stay"
                )
        if not sum(unit.air_share for unit in self.units) > 0.0:
            raise InputError("the units' air_share have no positive sum")
        for unit in towed:
            for axle in unit.axles:
                if axle.steered or axle.driven:
                    raise InputError(
                        f"axle {axle.name} is steered or driven: only the motor vehicle's are; a "
                        "trailer's axle may have self_steering"
                    )

    @property
    def lead(self) -> Unit:
        """The motor vehicle."""
        return self.units[0]

    @property
    def last(self) -> Unit:
        """The unit at the end; the motor vehicle if it tows nothing."""
        return self.units[-1]

    @property
    def axles(self) -> tuple[Axle, ...]:
        """Axles of all units, front to rear."""
        return tuple(axle for unit in self.units for axle in unit.axles)

    @property
    def driven_axles(self) -> tuple[Axle, ...]:
        """The axles that the propeller shaft drives."""
        return tuple(axle for axle in self.lead.axles if axle.driven)

    @property
    def couplings(self) -> tuple[Coupling, ...]:
        """The couplings of the towed units, front to rear."""
        return tuple(unit.coupling for unit in self.units if unit.coupling)

    @property
    def coupling_names(self) -> tuple[str, ...]:
        """Names of the couplings in the MJCF: the kind of the first one, then `{unit}_{kind}`."""
        kinds = [(unit.name, unit.coupling.kind) for unit in self.units if unit.coupling]
        return tuple(kind if i == 0 else f"{name}_{kind}" for i, (name, kind) in enumerate(kinds))

    @property
    def payload_max(self) -> float:
        """The greatest payload of all units together [kg]."""
        return sum((unit.payload.mass_max for unit in self.units if unit.payload), 0.0)

    @property
    def length(self) -> float:
        """Of the straight combination, bumper to rear [m]."""
        return self.lead.front_overhang + self.rear

    @property
    def rear(self) -> float:
        """Distance of the straight combination's rear behind the first axle [m]."""
        origin = ends = 0.0
        for unit in self.units:
            if unit.coupling:
                origin = origin + unit.coupling.position
            ends = max(ends, origin + unit.length - unit.front_overhang)
        return ends

    @property
    def footprint(self) -> EgoFootprint:
        """Size of the straight combination."""
        return EgoFootprint(
            front_overhang=self.lead.front_overhang,
            length=self.length,
            width=max(unit.width for unit in self.units),
            height=max(unit.height for unit in self.units),
        )

    @property
    def unit_shapes(self) -> tuple[UnitShape, ...]:
        """The units from above, front to rear."""

        def shape(unit: Unit) -> UnitShape:
            hitch, rear = 0.0, unit.length - unit.front_overhang
            if unit.coupling is not None:
                hitch = unit.coupling.position
            elif unit.kind == "tractor" and self.couplings:
                rear = unit.axles[-1].position + _BEHIND_AXLE
            return UnitShape(hitch, unit.front_overhang, rear, unit.width)

        return tuple(shape(unit) for unit in self.units)

    def digest(self) -> str:
        """Returns the SHA-256 of all parameters to their last digit, in hex."""
        text = json.dumps(dataclasses.asdict(self), sort_keys=True, default=_json_value)
        return hashlib.sha256(text.encode()).hexdigest()

    def has_label(self, label: str) -> bool:
        """Returns whether `label_of` may have given this truck the label."""
        name, _, digits = label.partition(":")
        return name == self.name and self.digest().startswith(digits)

    def gross_mass(self, payload: float | None = None) -> float:
        """Returns the mass of the combination [kg] with a payload [kg]; default: the greatest."""
        return sum(unit.mass for unit in self.units) + self.check_payload(payload)

    def check_payload(self, payload: float | None = None) -> float:
        """Returns the payload [kg] as float; default: the greatest.

        Raises:
          InputError: it is outside [0, payload_max].
        """
        if payload is None:
            return self.payload_max
        name = f"truck {self.name!r}: payload"
        return in_range(name, payload, 0.0, self.payload_max, "kg")

    def unit_payloads(self, payload: float | None) -> tuple[float, ...]:
        """Returns the load of each unit [kg]: the payload, in proportion to what each may carry."""
        payload, most = self.check_payload(payload), self.payload_max
        return tuple(
            0.0
            if not unit.payload
            else payload
            if unit.payload.mass_max == most
            else payload * unit.payload.mass_max / most
            for unit in self.units
        )

    def with_payload_height(self, height: float | None) -> TruckParameters:
        """Returns the truck with the CG of every unit's load at this height above the road [m].

        None changes nothing. The loads keep their inertia about their own CG.

        Raises:
          InputError: the height is not within a load's bounds, or the truck carries no load.
        """
        if height is None:
            return self
        if not self.payload_max:
            raise InputError(f"payload_height = {height!r} m: truck {self.name!r} carries no load")

        def raised(unit: Unit) -> Unit:
            load = unit.payload
            if load is None:
                return unit
            value = in_range("payload_height", height, load.cg_height_min, load.cg_height_max, "m")
            return dataclasses.replace(unit, payload=dataclasses.replace(load, cg_height=value))

        return dataclasses.replace(self, units=tuple(raised(unit) for unit in self.units))


def _built(truck: str | Path | None, overlays: Sequence[Overlay] = ()) -> TruckParameters:
    """Reads and checks a truck's files."""
    tree = read_truck(truck, overlays)
    found = typing.cast(TruckParameters, build(TruckParameters, tree, ""))
    engine = found.engine.completed()
    radius = found.tires[found.driven_axles[0].tire].rolling_radius
    gearbox = found.gearbox.completed(engine, radius)
    return dataclasses.replace(found, engine=engine, gearbox=gearbox)


@functools.lru_cache(maxsize=32)
def _shipped(file: Path, _stamps: Stamps) -> TruckParameters:
    return _built(file)


# A truck in Python's interfaces: name of a shipped one, its `truck.toml` or folder, or parameters.
AnyTruck: TypeAlias = str | Path | TruckParameters


def label_of(truck: AnyTruck | None) -> str:
    """Returns a short name that tells trucks apart in tables of results.

    It is the name of a shipped truck, whose figures belong to the version of the package, and name
    and digest of any other one.
    """
    shipped = shipped_trucks()
    if truck is None or (isinstance(truck, str) and truck in shipped):
        return truck or shipped[0]
    parameters = TruckParameters.load(truck)
    return f"{parameters.name}:{parameters.digest()[:12]}"


def _json_value(value: Any) -> Any:
    return value.tolist() if isinstance(value, np.ndarray) else str(value)
