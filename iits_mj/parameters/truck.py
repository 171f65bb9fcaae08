"""The truck's parameters as frozen dataclasses, read from `mjcf/truck.toml` and its CSV tables.

Every quantity of the TOML is `{ value, unit, grade, source }`; an overlay (for instance a file of
identified parameters) may give plain values. Positions are meters behind the steer axle (tractor)
or behind the kingpin (semitrailer), heights are above the road, masses of a unit include its axles.
"""

from __future__ import annotations

import dataclasses
import typing
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from iits_mj.core.assets import mjcf_dir
from iits_mj.core.checks import in_range
from iits_mj.core.input_files import read_toml
from iits_mj.parameters.brakes import AirBrake
from iits_mj.parameters.files import (
    build,
    csv_tables,
    merge,
    plain,
    section,
)
from iits_mj.parameters.powertrain import Clutch, Engine, Gearbox, Retarder


@dataclass(frozen=True)
class Axle:
    """One axle: position, springs, dampers and wheel ends. Rates are per side."""

    name: str
    tire: str
    position: float
    track: float
    unsprung_mass: float
    wheel_mass: float
    wheel_inertia_spin: float
    spring_rate: float
    spring_spacing: float
    damping: float
    auxiliary_roll_stiffness: float
    roll_center_height: float


@dataclass(frozen=True)
class Unit:
    """A tractor or semitrailer with its axles; mass and inertia include axles and wheels."""

    mass: float
    cg_position: float
    cg_height: float
    inertia_x: float
    inertia_y: float
    inertia_z: float
    front_overhang: float
    width: float
    height: float
    load_equalization: float
    axles: tuple[Axle, ...]


@dataclass(frozen=True)
class Tractor(Unit):
    """The tractor unit; positions from the steer axle."""


@dataclass(frozen=True)
class Semitrailer(Unit):
    """The empty semitrailer; positions from the kingpin."""

    length: float


@dataclass(frozen=True)
class Payload:
    """The payload at its greatest mass; a smaller one keeps CG and radii of gyration.

    `cg_height` may lie between `cg_height_min` and `cg_height_max`, see `with_payload_height`.
    """

    mass_max: float
    cg_position: float
    cg_height: float
    cg_height_min: float
    cg_height_max: float
    inertia_x: float
    inertia_y: float
    inertia_z: float


@dataclass(frozen=True)
class FifthWheel:
    """Coupling between tractor and semitrailer."""

    position: float
    height: float
    yaw_limit: float
    pitch_min: float
    pitch_max: float
    roll_stiffness: float
    roll_damping: float
    roll_lash: float
    plate_width: float
    yaw_friction: float


@dataclass(frozen=True)
class Steering:
    """Steering from steering wheel to road wheels."""

    ratio: float
    dead_band: float
    angle_max: float
    rate_max: float
    stiffness: float
    damping: float
    knuckle_inertia: float
    time_constant: float


@dataclass(frozen=True)
class Tire:
    """One kind of tire; stiffnesses are per tire, `count` tires make a wheel end."""

    count: int
    free_radius: float
    rolling_radius: float
    vertical_stiffness: float
    vertical_damping: float
    cornering_coefficient: float
    cornering_load: float
    pneumatic_trail: float


@dataclass(frozen=True)
class TireCommon:
    """Magic Formula parameters that all tires share."""

    nominal_load: float
    friction_lateral: float
    friction_longitudinal: float
    friction_load_slope: float
    shape_lateral: float
    shape_longitudinal: float
    curvature_lateral: float
    curvature_longitudinal: float
    load_saturation: float
    slip_stiffness: float
    relaxation_lateral: float
    relaxation_load_exponent: float
    relaxation_longitudinal: float
    rolling_resistance: float


@dataclass(frozen=True)
class Aerodynamics:
    """Air drag and side force of the combination."""

    tractor_share: float
    drag_area: float
    side_area: float
    pressure_height: float
    density: float


@dataclass(frozen=True)
class TruckParameters:
    """All parameters of a truck; `load` reads them, `dataclasses.replace` changes them."""

    tractor: Tractor
    semitrailer: Semitrailer
    payload: Payload
    fifth_wheel: FifthWheel
    steering: Steering
    tires: dict[str, Tire]
    tire_common: TireCommon
    aerodynamics: Aerodynamics
    engine: Engine
    retarder: Retarder
    clutch: Clutch
    gearbox: Gearbox
    air_brake: AirBrake

    @classmethod
    def load(
        cls,
        path: str | Path | None = None,
        overlay: str | Path | Mapping[str, Any] | None = None,
    ) -> TruckParameters:
        """Reads the TOML and CSV tables of a truck.

        Args:
          path: a complete truck file, with its CSV tables in the same folder; default: the shipped
            truck.
          overlay: a TOML file or a nested mapping with the values to change, for instance
            `{"engine": {"boost_lag": 0.5}, "tires": {"steer": {"free_radius": 0.54}}}`.

        Raises:
          InputError: unreadable file, unknown or missing key, wrong type, value not finite.
        """
        file = Path(path) if path is not None else mjcf_dir() / "truck.toml"
        tree = plain(read_toml(file, "parameter file"))
        if overlay is not None:
            if not isinstance(overlay, Mapping):
                overlay = read_toml(overlay, "parameter file")
            tree = merge(tree, plain(overlay), "")
        for name, tables in csv_tables(file.resolve().parent).items():
            tree[name] = tables | dict(section(tree, name))
        return typing.cast(TruckParameters, build(cls, tree, "truck"))

    @property
    def axles(self) -> tuple[Axle, ...]:
        """Axles of both units, front to rear."""
        return self.tractor.axles + self.semitrailer.axles

    def gross_mass(self, payload: float) -> float:
        """Returns the mass of the combination [kg] with a payload [kg]."""
        return self.tractor.mass + self.semitrailer.mass + self.check_payload(payload)

    def check_payload(self, payload: float) -> float:
        """Returns the payload [kg] as float; raises InputError outside [0, mass_max]."""
        return in_range("payload", payload, 0.0, self.payload.mass_max, "kg")

    def with_payload_height(self, height: float | None) -> TruckParameters:
        """Returns the truck with the payload's CG at this height above the road [m].

        None changes nothing. The load keeps its inertia about its own CG.

        Raises:
          InputError: the height is not within the payload's bounds.
        """
        if height is None:
            return self
        load = self.payload
        value = in_range("payload_height", height, load.cg_height_min, load.cg_height_max, "m")
        return dataclasses.replace(self, payload=dataclasses.replace(load, cg_height=value))
