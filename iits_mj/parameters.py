"""The truck's numbers: frozen dataclasses, from `mjcf/truck.toml` and the CSV tables beside it.

Every quantity of the TOML is `{ value, unit, grade, source }`; an overlay (a file of identified
parameters, say) may give plain values. Positions are metres behind the steer axle (tractor) or
behind the kingpin (semitrailer), heights are above the road, masses of a unit include its axles.
"""

from __future__ import annotations

import csv
import dataclasses
import math
import tomllib
import types
import typing
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from iits_mj.assets import mjcf_dir
from iits_mj.errors import InputError

FloatArray = NDArray[np.float64]
GRAVITY = 9.81
RPM = 2.0 * math.pi / 60.0
KMH = 1.0 / 3.6


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
    """The load at its greatest mass; a smaller load keeps CG and radii of gyration."""

    mass_max: float
    cg_position: float
    cg_height: float
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
    """Air drag of the combination."""

    tractor_share: float
    drag_area: float
    side_area: float
    pressure_height: float
    density: float


@dataclass(frozen=True)
class EngineScalars:
    """Scalar figures of the engine; the maps are in `Engine`."""

    idle_speed: float
    governed_speed: float
    reference_torque: float
    inertia: float
    torque_rise_rate: float
    torque_rise_rate_low: float
    torque_rise_threshold: float
    torque_fall_rate: float
    torque_fall_rate_low: float
    torque_fall_threshold: float
    boost_lag: float
    drag_speed: tuple[float, ...]
    drag_torque: tuple[float, ...]
    engine_brake_power: float
    engine_brake_speed: float
    idle_fuel_rate: float


@dataclass(frozen=True)
class Table2D:
    """A map: `rows` (n,), `columns` (m,), `values` (n, m), in SI units."""

    rows: FloatArray
    columns: FloatArray
    values: FloatArray


@dataclass(frozen=True)
class Engine(EngineScalars):
    """The identified engine.

    Attributes:
      full_load_speed, full_load_torque: [rad/s], [N m], shape (n,).
      pedal_map: torque [N m] over engine speed [rad/s] (rows) and pedal 0..1 (columns).
      fuel_map: BSFC [kg/J] over torque [N m] (rows) and engine speed [rad/s] (columns).
    """

    full_load_speed: FloatArray
    full_load_torque: FloatArray
    pedal_map: Table2D
    fuel_map: Table2D


@dataclass(frozen=True)
class GearboxScalars:
    """Scalar figures of gearbox, clutch and driveline."""

    final_drive: float
    efficiency: float
    driveline_efficiency: float
    start_gear: int
    reverse_ratio: float
    shift_cut_time: float
    synchronization_time: float
    clutch_engagement_time: float
    clutch_close_time: float
    clutch_torque_max: float
    driveline_stiffness: float
    driveline_damping: float
    downshift_delay: float
    downshift_margin: float
    min_gear_time: float


@dataclass(frozen=True)
class Gearbox(GearboxScalars):
    """The 12-speed automated gearbox.

    Attributes:
      ratios: of gears 1 to 12, shape (12,).
      inertias: at the gearbox input, per gear [kg m2], shape (12,).
      upshift: vehicle speed [m/s] over from-gear 1..11 (rows) and pedal (columns).
      downshift: vehicle speed [m/s] over from-gear 2..12 (rows) and pedal (columns).
    """

    ratios: FloatArray
    inertias: FloatArray
    upshift: Table2D
    downshift: Table2D


@dataclass(frozen=True)
class AirBrakeScalars:
    """Scalar and per-axle figures of the air brakes (six axles, front to rear)."""

    dead_time: tuple[float, ...]
    build_up_time_constant: tuple[float, ...]
    release_time_constant: tuple[float, ...]
    supply_rise_rate: float
    supply_fall_rate: float
    torque_per_pressure: tuple[float, ...]
    push_out_pressure: float
    hysteresis_pressure: float
    pressure_max: float
    abs_release_slip: float
    abs_reapply_slip: float
    abs_speed_min: float
    stiffness: float
    parking_torque: float
    mass_light: float
    mass_heavy: float


@dataclass(frozen=True)
class AirBrake(AirBrakeScalars):
    """Air brakes with the pressure table.

    Attributes:
      demand: demanded deceleration, positive and increasing [m/s2], shape (n,).
      pressure_light, pressure_heavy: pressure [Pa] of (front, drive, trailer) circuits at the two
        masses, shape (n, 3).
    """

    demand: FloatArray
    pressure_light: FloatArray
    pressure_heavy: FloatArray


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
        tree = _plain(_read_toml(file))
        if overlay is not None:
            extra = overlay if isinstance(overlay, Mapping) else _read_toml(Path(overlay))
            tree = _merge(tree, _plain(extra), "")
        folder = file.resolve().parent
        tables = {
            "engine": _engine_tables(folder),
            "gearbox": _gearbox_tables(folder),
            "air_brake": _air_brake_tables(folder),
        }
        for section, content in tables.items():
            scalars = dict(_section(tree, section))
            scalars.update({k: v for k, v in content.items() if k not in scalars})
            tree[section] = scalars
        return typing.cast(TruckParameters, _build(cls, tree, "truck"))

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


def provenance(path: str | Path | None = None) -> list[tuple[str, str, str, str, str]]:
    """Rows (name, value, unit, grade, source) of every quantity in the truck's TOML."""
    file = Path(path) if path is not None else mjcf_dir() / "truck.toml"
    return list(_provenance_rows(_read_toml(file), ""))


def _provenance_rows(node: Any, prefix: str) -> Iterator[tuple[str, str, str, str, str]]:
    if isinstance(node, Mapping) and "value" in node:
        yield (prefix, str(node["value"]), node["unit"], node["grade"], node["source"])
    elif isinstance(node, Mapping):
        for key, child in node.items():
            yield from _provenance_rows(child, f"{prefix}.{key}" if prefix else key)
    elif isinstance(node, list):
        for child in node:
            yield from _provenance_rows(child, f"{prefix}[{child['name']}]")


def _read_toml(path: Path) -> dict[str, Any]:
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise InputError(f"parameter file {str(path)!r} cannot be read: {error}") from error


def _plain(node: Any) -> Any:
    if isinstance(node, Mapping):
        if "value" in node:
            return node["value"]
        return {key: _plain(child) for key, child in node.items()}
    if isinstance(node, list):
        return [_plain(child) for child in node]
    return node


def _merge(base: Any, extra: Mapping[str, Any], where: str) -> dict[str, Any]:
    merged = dict(base)
    for key, value in extra.items():
        name = f"{where}{key}"
        if isinstance(value, Mapping) and isinstance(base.get(key), Mapping):
            merged[key] = _merge(base[key], value, f"{name}.")
        elif isinstance(value, list) and value and isinstance(value[0], Mapping):
            merged[key] = _merge_named(base.get(key, []), value, name)
        else:
            merged[key] = value
    return merged


def _merge_named(base: list[Any], extra: list[Any], where: str) -> list[Any]:
    """Merges a list of tables by their `name`: an overlay may change one axle of three."""
    rows = {row["name"]: row for row in base}
    for row in extra:
        name = row.get("name")
        if name not in rows:
            raise InputError(f"parameter {where}: no entry named {name!r}; there are {list(rows)}")
        rows[name] = _merge(rows[name], row, f"{where}[{name}].")
    return list(rows.values())


def _section(tree: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    section = tree.get(name)
    if not isinstance(section, Mapping):
        raise InputError(f"the truck's parameters lack the section [{name}]")
    return section


def _build(kind: Any, node: Any, where: str) -> Any:
    origin = typing.get_origin(kind)
    if dataclasses.is_dataclass(kind):
        return _build_dataclass(kind, node, where)
    if origin is tuple:
        item = typing.get_args(kind)[0]
        if not isinstance(node, (list, tuple)):
            raise InputError(f"parameter {where} = {node!r}: a list is wanted")
        return tuple(_build(item, child, f"{where}[{i}]") for i, child in enumerate(node))
    if origin is dict:
        item = typing.get_args(kind)[1]
        return {key: _build(item, child, f"{where}.{key}") for key, child in node.items()}
    if kind is str or origin is types.UnionType:
        return node
    if kind in (int, float):
        return _number(kind, node, where)
    return node


def _build_dataclass(kind: Any, node: Any, where: str) -> Any:
    if dataclasses.is_dataclass(node):
        return node
    if not isinstance(node, Mapping):
        raise InputError(f"parameter {where} = {node!r}: a table is wanted")
    hints = typing.get_type_hints(kind)
    names = [f.name for f in dataclasses.fields(kind)]
    unknown = sorted(set(node) - set(names))
    if unknown:
        raise InputError(f"parameter {where}.{unknown[0]} is unknown; allowed are: {names}")
    missing = [name for name in names if name not in node]
    if missing:
        raise InputError(f"parameter {where}.{missing[0]} is missing")
    return kind(**{name: _build(hints[name], node[name], f"{where}.{name}") for name in names})


def _number(kind: type, node: Any, where: str) -> int | float:
    if isinstance(node, bool) or not isinstance(node, (int, float)):
        raise InputError(f"parameter {where} = {node!r}: a number is wanted")
    if not math.isfinite(node):
        raise InputError(f"parameter {where} = {node!r}: a finite number is wanted")
    if kind is int and node != int(node):
        raise InputError(f"parameter {where} = {node!r}: a whole number is wanted")
    return kind(node)


def _read_csv(path: Path) -> tuple[list[str], FloatArray]:
    """Header and numbers of a CSV table whose first lines may be `#` comments."""
    try:
        lines = [row for row in path.read_text(encoding="utf-8").splitlines() if row[:1] != "#"]
        rows = list(csv.reader(lines))
        values = np.array([[float(cell) for cell in row] for row in rows[1:]])
    except (OSError, ValueError) as error:
        raise InputError(f"table {str(path)!r} cannot be read: {error}") from error
    if values.ndim != 2 or values.shape[1] != len(rows[0]) or not np.isfinite(values).all():
        raise InputError(f"table {str(path)!r}: every row must have {len(rows[0])} finite numbers")
    return rows[0], values


def _table(path: Path, row_unit: float, column_unit: float, value_unit: float) -> Table2D:
    header, values = _read_csv(path)
    columns = np.array([float(cell) for cell in header[1:]]) * column_unit
    return Table2D(values[:, 0] * row_unit, columns, values[:, 1:] * value_unit)


def _engine_tables(folder: Path) -> dict[str, Any]:
    _, full = _read_csv(folder / "engine_full_load.csv")
    return {
        "full_load_speed": full[:, 0] * RPM,
        "full_load_torque": full[:, 1],
        "pedal_map": _table(folder / "engine_pedal_map.csv", RPM, 0.01, 1.0),
        "fuel_map": _table(folder / "engine_fuel_map.csv", 1.0, RPM, 1e-3 / 3.6e6),
    }


def _gearbox_tables(folder: Path) -> dict[str, Any]:
    _, gears = _read_csv(folder / "gearbox.csv")
    forward = gears[gears[:, 0] >= 1]
    return {
        "ratios": forward[:, 1],
        "inertias": forward[:, 2],
        "upshift": _table(folder / "gearbox_upshift.csv", 1.0, 1.0, KMH),
        "downshift": _table(folder / "gearbox_downshift.csv", 1.0, 1.0, KMH),
    }


def _air_brake_tables(folder: Path) -> dict[str, Any]:
    header, rows = _read_csv(folder / "air_brake_pressure_demand.csv")
    rows = rows[::-1]
    column = {name: i for i, name in enumerate(header)}
    kpa = 1e3

    def circuits(mass: str) -> FloatArray:
        front = rows[:, column[f"front_wheel_cmd_{mass}(x0.3)"]]
        rear = rows[:, column[f"rear_wheel_cmd_{mass}(x0.7)"]]
        trailer = rows[:, column[f"trailer_cmd_{mass}(rear x1.1)"]]
        return np.column_stack([front, rear, trailer]) * kpa

    return {
        "demand": -rows[:, 0],
        "pressure_light": circuits("18t"),
        "pressure_heavy": circuits("50t"),
    }
