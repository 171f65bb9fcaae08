"""The truck's numbers: frozen dataclasses, from `mjcf/truck.toml` and the CSV tables beside it.

Every quantity of the TOML is `{ value, unit, grade, source }`; an overlay (a file of identified
parameters, say) may give plain values. Positions are metres behind the steer axle (tractor) or
behind the kingpin (semitrailer), heights are above the road, masses of a unit include its axles.
"""

from __future__ import annotations

import dataclasses
import math
import typing
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from iits_mj.core.assets import mjcf_dir
from iits_mj.core.errors import InputError
from iits_mj.parameters.brakes import AirBrake
from iits_mj.parameters.files import (
    air_brake_tables,
    build,
    engine_tables,
    gearbox_tables,
    merge,
    plain,
    read_toml,
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
class Tractor:
    """The tractor unit with its axles; mass and inertia include axles and wheels."""

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
class Semitrailer:
    """The empty semitrailer with its axles; positions from the kingpin."""

    mass: float
    cg_position: float
    cg_height: float
    inertia_x: float
    inertia_y: float
    inertia_z: float
    front_overhang: float
    length: float
    width: float
    height: float
    load_equalization: float
    axles: tuple[Axle, ...]


@dataclass(frozen=True)
class Payload:
    """The load at its greatest mass; a smaller load keeps CG and radii of gyration.

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
    """From steering wheel to road wheels."""

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
    """Magic Formula figures that all tires share."""

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
    """Everything that makes the truck this truck. `load` reads it, `replace` varies it."""

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
        """Reads the truck's TOML and CSV tables.

        Args:
          path: a complete truck file; its CSV tables lie beside it. Default: the shipped truck.
          overlay: a TOML file or a nested mapping with the values to change, for instance
            `{"engine": {"boost_lag": 0.5}, "tires": {"steer": {"free_radius": 0.54}}}`.

        Raises:
          InputError: unreadable file, unknown or missing key, wrong type, value not finite.
        """
        file = Path(path) if path is not None else mjcf_dir() / "truck.toml"
        tree = plain(read_toml(file))
        if overlay is not None:
            extra = overlay if isinstance(overlay, Mapping) else read_toml(Path(overlay))
            tree = merge(tree, plain(extra), "")
        folder = file.resolve().parent
        tables = {
            "engine": engine_tables(folder),
            "gearbox": gearbox_tables(folder),
            "air_brake": air_brake_tables(folder),
        }
        for name, content in tables.items():
            scalars = dict(section(tree, name))
            scalars.update({k: v for k, v in content.items() if k not in scalars})
            tree[name] = scalars
        return typing.cast(TruckParameters, build(cls, tree, "truck"))

    @property
    def axles(self) -> tuple[Axle, ...]:
        """All six axles, front to rear."""
        return self.tractor.axles + self.semitrailer.axles

    def gross_mass(self, payload: float) -> float:
        """Mass of the combination [kg] with this payload [kg]."""
        return self.tractor.mass + self.semitrailer.mass + self.check_payload(payload)

    def check_payload(self, payload: float) -> float:
        """The payload as float; InputError outside [0, mass_max]."""
        value = float(payload)
        if not math.isfinite(value) or not 0.0 <= value <= self.payload.mass_max:
            raise InputError(
                f"payload {payload!r} kg is not allowed: use 0 to {self.payload.mass_max:g} kg"
            )
        return value

    def with_payload_height(self, height: float | None) -> TruckParameters:
        """The same truck with the payload's CG at this height above the road [m].

        None changes nothing. The load keeps its inertia about its own CG.

        Raises:
          InputError: the height is not within the payload's bounds.
        """
        if height is None:
            return self
        value, load = float(height), self.payload
        if not load.cg_height_min <= value <= load.cg_height_max:
            raise InputError(
                f"payload_height {height!r} m is not allowed: use {load.cg_height_min:g} to "
                f"{load.cg_height_max:g} m above the road"
            )
        return dataclasses.replace(self, payload=dataclasses.replace(load, cg_height=value))
