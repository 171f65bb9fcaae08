"""Parameters with their uncertainty from a recorded drive, and the overlay of a truck."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from iits_mj.core.errors import InputError
from iits_mj.core.output_files import write_whole
from iits_mj.core.progress import each, task
from iits_mj.identification.brakes import circuit_of_axle, identify_brake_response
from iits_mj.identification.engine import identify_engine
from iits_mj.identification.estimate import Estimate
from iits_mj.identification.lateral import identify_cornering, identify_ratio
from iits_mj.identification.log import Log
from iits_mj.identification.longitudinal import Motion, identify_motion
from iits_mj.identification.shifts import identify_shifts
from iits_mj.parameters import TruckParameters

# Groups of parameters, each with its own fit; the mass from "motion" serves all others.
GROUPS = ("motion", "engine", "shifts", "brakes", "steering")
# Payload in the overlay of an empty truck [kg]: the truck's is above zero.
_PAYLOAD_MIN = 1.0
# Estimates that are parameters of the same name, by section of the truck's parameters.
_PLAIN = {
    "aerodynamics": ("drag_area",),
    "engine": ("boost_lag", "torque_rise_rate"),
    "gearbox": ("shift_cut_time", "synchronization_time"),
}
_INERTIAS = ("inertia_x", "inertia_y", "inertia_z")
_RESPONSES = {"dead_time": "dead_time", "build_up_time_constant": "build_up_time"}


@dataclass(frozen=True)
class Identification:
    """The result of an identification.

    Attributes:
      estimates: one for each parameter of the chosen groups.
      motion: speeds of the point mass before and after.
      mass: gross mass, identified or given [kg]; None if unknown.
      parameters: the truck's parameters before the fit.
    """

    estimates: tuple[Estimate, ...]
    motion: Motion
    mass: float | None
    parameters: TruckParameters

    def __getitem__(self, name: str) -> Estimate:
        for estimate in self.estimates:
            if estimate.name == name:
                return estimate
        raise InputError(f"no estimate {name!r}; there are {[e.name for e in self.estimates]}")

    def prior(self, name: str) -> float:
        """Value of a parameter before the fit."""
        return self[name].prior

    def found(self) -> dict[str, float]:
        """Value of each identified parameter by its name."""
        return {e.name: e.value for e in self.estimates if e.identifiable}


def identify(
    log: Log,
    parameters: TruckParameters | None = None,
    *,
    mass: float | None = None,
    groups: Sequence[str] = GROUPS,
) -> Identification:
    """Fits the truck's parameters to a recorded drive.

    Args:
      log: of the drive; the reasons of the estimates name missing signals.
      parameters: prior values, and all parameters that are not fitted; default: the shipped truck.
      mass: known gross mass [kg]; only with it the scale of the engine torque can be fitted.
      groups: to fit, of `GROUPS`.

    Raises:
      InputError: unknown group.
    """
    parameters = parameters or TruckParameters.load()
    unknown = [name for name in groups if name not in GROUPS]
    if unknown:
        raise InputError(f"cannot identify {unknown[0]!r}; there are {list(GROUPS)}")
    with task("identifying the motion"):
        motion = identify_motion(log, parameters, mass)
    shown = any(e.name == "mass" and e.identifiable for e in motion.estimates)
    known = motion.mass if shown or mass is not None else None
    fits: dict[str, Callable[[], Sequence[Estimate]]] = {
        "motion": lambda: motion.estimates,
        "engine": lambda: identify_engine(log, parameters),
        "shifts": lambda: identify_shifts(log, parameters),
        "brakes": lambda: identify_brake_response(log, parameters),
        "steering": lambda: _steering(log, parameters, known, motion),
    }
    names = each([name for name in GROUPS if name in groups], "identifying", str)
    estimates = [estimate for name in names for estimate in fits[name]()]
    return Identification(tuple(estimates), motion, known, parameters)


def _steering(
    log: Log, parameters: TruckParameters, mass: float | None, motion: Motion
) -> list[Estimate]:
    """Ratio, if the log has both angles, and cornering coefficients with the error of the mass."""
    ratio = identify_ratio(log, parameters)
    value = ratio.value if ratio is not None and ratio.identifiable else None
    cornering = identify_cornering(log, parameters, mass, value)
    shares = [e.half_width / e.value for e in motion.estimates if e.name == "mass"]
    if shares and mass is not None:
        # Forces are in proportion to the mass.
        cornering = [
            e.widened(shares[0]) if e.name.startswith("cornering") else e for e in cornering
        ]
    return cornering if ratio is None else [ratio, *cornering]


def overlay(found: Identification) -> dict[str, Any]:
    """The identified values only, as a tree of the truck's parameters.

    The mass, identified or given, becomes the greatest payload, the default load of a truck.
    """
    values, p = found.found(), found.parameters
    tree: dict[str, Any] = {"units": _units(found)}
    for section, names in _PLAIN.items():
        tree[section] = {name: values[name] for name in names if name in values}
    tree["engine"] |= _engine_tables(p, values)
    if "steering_ratio" in values:
        tree["steering"] = {"ratio": values["steering_ratio"]}
    tree["tires"] = {
        kind: {"cornering_coefficient": values[name]}
        for kind in p.tires
        if (name := f"cornering_coefficient_{kind}") in values
    }
    if "rolling_resistance" in values:
        # In proportion on all tires: the log shows their sum only.
        scale = values["rolling_resistance"] / found.prior("rolling_resistance")
        for kind, tire in p.tires.items():
            changed = tree["tires"].setdefault(kind, {})
            changed["rolling_resistance"] = scale * tire.rolling_resistance
    return {section: content for section, content in tree.items() if content}


def _engine_tables(p: TruckParameters, values: dict[str, float]) -> dict[str, Any]:
    """The engine's tables, scaled; the crankshaft's torque may differ from the reported one."""
    engine = p.engine
    tree: dict[str, Any] = {}
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


def _units(found: Identification) -> dict[str, Any]:
    """Greatest payloads and brakes that differ from the truck's."""
    p = found.parameters
    share = 1.0
    if found.mass is not None and p.payload_max:
        share = max(found.mass - p.gross_mass(0.0), _PAYLOAD_MIN) / p.payload_max
    brakes = _brakes(p, found.found())
    tree: dict[str, Any] = {}
    for unit in p.units:
        part: dict[str, Any] = {}
        if unit.payload and share != 1.0:
            names = ("mass_max", *_INERTIAS)
            part["payload"] = {name: share * getattr(unit.payload, name) for name in names}
        axles = {
            axle.name.removeprefix(f"{unit.name}_"): {"brake": brakes[axle.name]}
            for axle in unit.axles
            if brakes[axle.name]
        }
        if axles:
            part["axles"] = axles
        if part:
            tree[unit.name] = part
    return tree


def _brakes(p: TruckParameters, values: dict[str, float]) -> dict[str, dict[str, float]]:
    """Identified figures of each axle's brake, by the axle's name."""
    found: dict[str, dict[str, float]] = {}
    common, line = values.get("brake_gain", 1.0), p.air_brake.trailer_line_delay
    for axle, circuit in zip(p.axles, circuit_of_axle(p), strict=True):
        own: dict[str, float] = {}
        gain = values.get(f"brake_gain_{circuit}", common)
        if gain != 1.0:
            own["torque_per_pressure"] = gain * axle.brake.torque_per_pressure
        for key, suffix in _RESPONSES.items():
            if (value := values.get(f"{circuit}_{suffix}")) is not None:
                late = line if key == "dead_time" and circuit == "trailer" else 0.0
                own[key] = max(value - late, 0.0)
        found[axle.name] = own
    return found


def write_toml(found: Identification, path: str | Path) -> None:
    """Writes the overlay, with a comment on the interval of every estimate.

    Raises:
      InputError: no parameter was identified, or the file cannot be written.
    """
    tree = overlay(found)
    if not tree:
        raise InputError("the log shows no parameter that the truck has: nothing written")
    lines = ["# Identified from a recorded drive; read by Truck.load(parameters=...)."]
    lines += [f"# {estimate}" for estimate in found.estimates]
    lines += _tables(tree, "")
    write_whole(path, ("\n".join(lines) + "\n").encode(), "overlay")


def _tables(tree: Mapping[str, Any], prefix: str) -> list[str]:
    """TOML lines of a tree: the values of each table, then the tables inside it."""
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
