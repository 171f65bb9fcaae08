"""Identified values as the TOML that `Truck.load(parameters=...)` takes."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from iits_mj.core.errors import InputError
from iits_mj.identification.brakes import circuit_of_axle
from iits_mj.identification.identify import Identification
from iits_mj.parameters import TruckParameters

# Smallest payload that the overlay of a truck found empty has [kg]: the truck's is above zero.
_PAYLOAD_MIN = 1.0
_RESPONSES = {
    "dead_time": "dead_time",
    "build_up_time_constant": "build_up_time",
}


def overlay(found: Identification) -> dict[str, Any]:
    """The identified values and nothing else, as a tree of the truck's parameters.

    The mass, identified or given, becomes the greatest payload, which a truck loaded by default
    has.
    """
    values, p = found.found(), found.parameters
    tree: dict[str, Any] = {}
    if found.mass is not None:
        tree["payload"] = _payload(p, found.mass)
    if "rolling_resistance" in values:
        tree["tire_common"] = {"rolling_resistance": values["rolling_resistance"]}
    if "drag_area" in values:
        tree["aerodynamics"] = {"drag_area": values["drag_area"]}
    engine = _engine(p, values)
    if engine:
        tree["engine"] = engine
    gearbox = {name: values[name] for name in _GEARBOX if name in values}
    if gearbox:
        tree["gearbox"] = gearbox
    if "steering_ratio" in values:
        tree["steering"] = {"ratio": values["steering_ratio"]}
    tires = {
        kind: {"cornering_coefficient": values[name]}
        for kind in p.tires
        if (name := f"cornering_coefficient_{kind}") in values
    }
    if tires:
        tree["tires"] = tires
    air = _air_brake(p, values)
    if air:
        tree["air_brake"] = air
    return tree


def payload(parameters: TruckParameters, mass: float) -> float:
    """Payload of a truck of this gross mass, above zero [kg]."""
    return max(mass - parameters.gross_mass(0.0), _PAYLOAD_MIN)


def _payload(p: TruckParameters, mass: float) -> dict[str, float]:
    load = payload(p, mass)
    share = load / p.payload.mass_max
    inertias = {name: share * getattr(p.payload, name) for name in _INERTIAS}
    return {"mass_max": load, **inertias}


def _engine(p: TruckParameters, values: dict[str, float]) -> dict[str, Any]:
    """The engine's tables, scaled; what the crankshaft gives may differ from what it reports."""
    engine = p.engine
    tree: dict[str, Any] = {name: values[name] for name in _ENGINE if name in values}
    scale = values.get("torque_map_scale", 1.0) * values.get("engine_torque_scale", 1.0)
    if scale != 1.0:
        pedal_map = engine.pedal_map
        tree["full_load_torque"] = list(scale * engine.full_load_torque)
        tree["pedal_map"] = {
            "rows": list(pedal_map.rows),
            "columns": list(pedal_map.columns),
            "values": [list(row) for row in scale * pedal_map.values],
        }
    drag = values.get("engine_drag_scale", 1.0)
    if drag != 1.0:
        tree["drag_torque"] = [drag * torque for torque in engine.drag_torque]
    return tree


_ENGINE = ("boost_lag", "torque_rise_rate")
_GEARBOX = ("shift_cut_time", "synchronization_time")
_INERTIAS = ("inertia_x", "inertia_y", "inertia_z")


def _air_brake(p: TruckParameters, values: dict[str, float]) -> dict[str, list[float]]:
    circuit, brake = circuit_of_axle(p), p.air_brake
    air: dict[str, list[float]] = {}
    common = values.get("brake_gain", 1.0)
    gains = [values.get(f"brake_gain_{name}", common) for name in circuit]
    if any(gain != 1.0 for gain in gains):
        slopes = zip(gains, brake.torque_per_pressure, strict=True)
        air["torque_per_pressure"] = [gain * slope for gain, slope in slopes]
    for key, suffix in _RESPONSES.items():
        names = [f"{name}_{suffix}" for name in circuit]
        if any(name in values for name in names):
            line = [brake.trailer_line_delay if c == "trailer" else 0.0 for c in circuit]
            own = line if key == "dead_time" else [0.0] * len(line)
            air[key] = [
                max(values.get(name, before + late) - late, 0.0)
                for name, before, late in zip(names, getattr(brake, key), own, strict=True)
            ]
    return air


def write_toml(found: Identification, path: str | Path) -> None:
    """Writes the overlay; every estimate stands in a comment with its interval or reason.

    Raises:
      InputError: nothing was identified, or the file cannot be written.
    """
    tree = overlay(found)
    if not tree:
        raise InputError("the log shows no parameter that the truck has: nothing written")
    lines = ["# Identified from a recorded drive; read by Truck.load(parameters=...)."]
    lines += [f"# {estimate}" for estimate in found.estimates]
    lines += _tables(tree, "")
    try:
        Path(path).write_text("\n".join(lines) + "\n", encoding="utf-8")
    except OSError as error:
        raise InputError(f"{str(path)!r} cannot be written: {error.strerror}") from error


def _tables(tree: Mapping[str, Any], prefix: str) -> list[str]:
    """TOML lines of a tree: each table's own values first, then the tables inside it."""
    lines: list[str] = []
    for name, content in tree.items():
        plain = {k: v for k, v in content.items() if not isinstance(v, Mapping)}
        if plain:
            lines += ["", f"[{prefix}{name}]"]
            lines += [f"{key} = {_number(value)}" for key, value in plain.items()]
        inner = {k: v for k, v in content.items() if isinstance(v, Mapping)}
        lines += _tables(inner, f"{prefix}{name}.")
    return lines


def _number(value: Any) -> str:
    if isinstance(value, (list, np.ndarray)):
        return "[" + ", ".join(_number(item) for item in value) + "]"
    # A point or an exponent makes it TOML's float, which the truck's parameters are.
    text = f"{value:.9g}"
    return text if any(mark in text for mark in ".en") else f"{text}.0"
