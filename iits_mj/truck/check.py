"""Checks of a truck file: masses and loads, usual limits, contradictions, and the truck at rest."""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from iits_mj.analytic.wheel_force import overall_ratio
from iits_mj.core.arrays import FloatArray
from iits_mj.core.errors import InputError
from iits_mj.core.units import GRAVITY, KMH, RPM
from iits_mj.parameters import TruckParameters
from iits_mj.parameters.files import provenance, read_truck, truck_file, ungraded
from iits_mj.parameters.mass_state import coupling_loads, static_axle_loads
from iits_mj.parameters.units import Axle, Unit
from iits_mj.truck.truck import Truck

REST_TIME = 2.0  # [s]
REST_TOLERANCE = 0.01  # of an axle's load
# Council Directive 96/53/EC, annex I 3: greatest loads [t] of axle groups up to an axle spacing
# [m]; of a motor vehicle's single axle, driven or not, and of its tandem, of trailers' groups.
SINGLE, SINGLE_DRIVEN = 10.0, 11.5
TANDEM = ((1.0, 11.5), (1.3, 16.0), (1.8, 19.0))
TRAILER_TANDEM = ((1.0, 11.0), (1.3, 16.0), (1.8, 18.0), (math.inf, 20.0))
TRIDEM = ((1.3, 21.0), (math.inf, 24.0))
SPACING_TOLERANCE = 1e-6  # [m], of rounding
STEER_SHARE_MIN = 0.20  # of the motor vehicle's load, UN R79 5.1 and Regulation (EU) 1230/2012
DRAWBAR_MAX = 1.0  # [t] on the eye of a center-axle trailer, Regulation (EU) 1230/2012
KINGPIN_MAX = 20.0  # [t], the usual rating of a 2 inch fifth wheel (UN R55, class G50)
TOP_SPEED = (80.0, 200.0)  # [km/h] at governed speed in the highest gear
_NAMED = 4  # names in a warning


@dataclass(frozen=True, slots=True)
class Inspection:
    """What `inspect_truck` found.

    Attributes:
      name: of the truck.
      summary: quantities and their values as text.
      warnings: in sentences; an empty list is a truck without remarks.
    """

    name: str
    summary: list[tuple[str, str]]
    warnings: list[str] = field(default_factory=list)

    def to_text(self) -> str:
        """Returns summary and warnings as lines."""
        width = max(len(key) for key, _ in self.summary)
        lines = [f"{key.ljust(width)}  {value}" for key, value in self.summary]
        return "\n".join([*lines, *(f"warning: {text}" for text in self.warnings)])


def inspect_truck(truck: str | Path) -> Inspection:
    """Reads a truck, computes its loads, builds its model and lets it rest on a level road.

    Raises:
      InputError: the truck cannot be read or built; names the file, the parameter and what is
        allowed.
    """
    file = truck_file(truck)
    try:
        p = TruckParameters.load(truck)
        warnings = [
            *_provenance_warnings(file),
            *_derived(file, p),
            *_tire_warnings(p),
            *_engine_warnings(p),
            *load_warnings(p),
            *_rest_warnings(p),
        ]
    except InputError as error:
        raise InputError(f"{file}: {error}") from error
    return Inspection(p.name, summary(p, file), warnings)


def summary(p: TruckParameters, file: str | Path) -> list[tuple[str, str]]:
    """Returns the truck's main quantities as pairs of text."""
    grades = Counter(grade or "none" for *_, grade, _ in provenance(file))
    unsourced = sum(not source for *_, source in provenance(file))
    units = ", ".join(f"{u.name} ({u.kind}, {len(u.axles)})" for u in p.units)
    top = p.engine.governed_speed / overall_ratio(p, len(p.gearbox.ratios))
    cruise = 85.0 * KMH * overall_ratio(p, len(p.gearbox.ratios)) / RPM
    gears = f"{len(p.gearbox.ratios)} gears {p.gearbox.ratios[0]:g} to {p.gearbox.ratios[-1]:g}"
    rows = [
        ("truck", p.description or p.name),
        ("units (axles)", units),
        ("mass empty", f"{p.gross_mass(0.0) / 1e3:.2f} t"),
        ("mass laden", f"{p.gross_mass(p.payload_max) / 1e3:.2f} t"),
        ("payload", f"{p.payload_max / 1e3:.2f} t"),
        ("length", f"{p.length:.2f} m"),
        (
            "engine",
            f"{p.engine.full_load_power / 1e3:.0f} kW, {max(p.engine.full_load_torque):.0f} N m",
        ),
        ("gearbox", f"{gears}, final drive {p.gearbox.final_drive:g}"),
        ("at 85 km/h", f"{cruise:.0f} rpm in the highest gear; governed at {top / KMH:.0f} km/h"),
    ]
    for state, payload in (("empty", 0.0), ("laden", p.payload_max)):
        loads = iter(static_axle_loads(p, payload) / 1e3)
        parts = (" ".join(f"{next(loads):.1f}" for _ in unit.axles) for unit in p.units)
        rows.append((f"axle loads {state} [kN]", " | ".join(parts)))
        couplings = " ".join(f"{load / 1e3:.1f}" for load in coupling_loads(p, payload))
        rows += [(f"coupling loads {state} [kN]", couplings)] if couplings else []
    counts = ", ".join(f"{grade} {count}" for grade, count in sorted(grades.items()))
    return [*rows, ("provenance", f"grades {counts}; {unsourced} without source")]


def load_warnings(p: TruckParameters) -> list[str]:
    """Returns what is unusual in the axle and coupling loads, empty and laden."""
    found: dict[str, None] = {}  # a payload of zero gives every sentence twice
    for state, payload in (("empty", 0.0), ("laden", p.payload_max)):
        loads = dict(zip((a.name for a in p.axles), static_axle_loads(p, payload), strict=True))
        for unit in p.units:
            for axles in unit.groups(payload):
                text = _group_warning(unit, axles, sum(loads[a.name] for a in axles))
                found |= {f"{state}: {text}": None} if text else {}
        front, rear = p.lead.groups(payload)
        steer = sum(loads[axle.name] for axle in front)
        share = steer / (steer + sum(loads[axle.name] for axle in rear))
        if share < STEER_SHARE_MIN:
            found[
                f"{state}: the steered axles carry {100.0 * share:.1f} % of the motor vehicle's "
                f"load; {100.0 * STEER_SHARE_MIN:.0f} % are needed to steer"
            ] = None
        for unit, load in zip(p.units[1:], coupling_loads(p, payload), strict=True):
            most = DRAWBAR_MAX if unit.kind == "center_axle_trailer" else KINGPIN_MAX
            if not 0.0 <= load / GRAVITY / 1e3 <= most and unit.kind != "dolly":
                found[
                    f"{state}: units.{unit.name} loads its coupling with {load / GRAVITY / 1e3:.2f}"
                    f" t; usual are 0 to {most:g} t"
                ] = None
        for axle in p.axles:
            if axle.lifted(payload):
                found[
                    f"{state}: {axle.name} is lifted, up to a payload of {axle.lifted_below:g} kg"
                ] = None
    return list(found)


def legal_load(unit: Unit, axles: tuple[Axle, ...]) -> float:
    """Returns the load that 96/53/EC allows an axle group [t]; infinite if it says nothing."""
    spacing = min((b.position - a.position for a, b in itertools.pairwise(axles)), default=0.0)
    if len(axles) == 1:
        return SINGLE_DRIVEN if axles[0].driven else SINGLE
    if axles[0].steered:
        return SINGLE * len(axles)
    tables = {2: TANDEM} if unit.coupling is None else {2: TRAILER_TANDEM, 3: TRIDEM}
    table: tuple[tuple[float, float], ...] = tables.get(len(axles), ())
    return next((load for limit, load in table if spacing <= limit + SPACING_TOLERANCE), math.inf)


def _group_warning(unit: Unit, axles: tuple[Axle, ...], load: float) -> str:
    tons, most = load / GRAVITY / 1e3, legal_load(unit, axles)
    names = "+".join(axle.name for axle in axles)
    if tons <= 0.0:
        return f"{names} carries {tons:.2f} t: the center of gravity is outside the wheelbase"
    if tons > most * 1.005:
        return f"{names} carries {tons:.1f} t; 96/53/EC allows {most:g} t"
    return ""


def _provenance_warnings(file: Path) -> Iterator[str]:
    names = list(ungraded(file))
    if names:
        more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
        yield f"without unit or grade: {', '.join(names[:_NAMED])}{more}"


def _derived(file: Path, p: TruckParameters) -> Iterator[str]:
    """Tables that the file lacks and the package made."""
    tree = read_truck(file)
    for section, key, source in (
        ("engine", "pedal_map", "the pedal's share of the rated power"),
        ("gearbox", "upshift", "the full-load curve"),
        ("gearbox", "downshift", "the full-load curve"),
    ):
        unused = section == "gearbox" and p.gearbox.shift_strategy == "adaptive"
        if key not in tree[section] and not unused:
            yield f"{section}.{key} is not given: made from {source}"


def _tire_warnings(p: TruckParameters) -> Iterator[str]:
    used = {axle.tire for axle in p.axles}
    for kind in sorted(used):
        tire = p.tires[kind]
        if tire.rolling_radius > tire.free_radius:
            yield (
                f"tires.{kind}.rolling_radius = {tire.rolling_radius:g} m is greater than "
                f"free_radius = {tire.free_radius:g} m"
            )
        loads = [
            load / (2 * tire.count)
            for payload in (0.0, p.payload_max)
            for axle, load in zip(p.axles, static_axle_loads(p, payload), strict=True)
            if axle.tire == kind
        ]
        squeezed = max(loads) / tire.vertical_stiffness
        if squeezed > 0.15 * tire.free_radius:
            yield (
                f"tires.{kind} is compressed by {1e3 * squeezed:.0f} mm: check vertical_stiffness "
                f"= {tire.vertical_stiffness:g} N/m"
            )
    for kind in sorted(set(p.tires) - used):
        yield f"tires.{kind} is on no axle"


def _engine_warnings(p: TruckParameters) -> Iterator[str]:
    engine, gearbox = p.engine, p.gearbox
    if engine.fuel_map.values.size:
        key, torque, speed = "fuel_map", engine.fuel_map.rows, engine.fuel_map.columns
    else:
        key, torque, speed = (
            "fuel_rate_map",
            engine.fuel_rate_map.columns,
            engine.fuel_rate_map.rows,
        )
    for what, unit, factor, given, needed in (
        ("torque", "N m", 1.0, torque, engine.full_load_torque),
        ("engine speed", "rpm", RPM, speed, engine.full_load_speed),
    ):
        if max(given) < 0.99 * max(needed):
            yield (
                f"engine.{key} ends at {max(given) / factor:.0f} {unit}, the full load at "
                f"{what} {max(needed) / factor:.0f} {unit}: its last values are continued"
            )
    top = engine.governed_speed / overall_ratio(p, len(gearbox.ratios)) / KMH
    if not TOP_SPEED[0] <= top <= TOP_SPEED[1]:
        yield (
            f"governed at {top:.0f} km/h in the highest gear: check gearbox.final_drive = "
            f"{gearbox.final_drive:g}, the ratios and the driven tires' rolling_radius"
        )
    for name in ("efficiency", "driveline_efficiency"):
        if not 0.85 <= getattr(gearbox, name) <= 1.0:
            yield f"gearbox.{name} = {getattr(gearbox, name):g}: usual is 0.9 to 1"


def _rest_warnings(p: TruckParameters) -> Iterator[str]:
    """Builds the model, empty and laden, and compares its axle loads at rest with the statics."""
    for state, payload in {"empty": 0.0, "laden": p.payload_max}.items():
        loads, speed = resting_loads(p, payload)
        statics = static_axle_loads(p, payload)
        for axle, found, expected in zip(p.axles, loads, statics, strict=True):
            if not abs(found - expected) <= REST_TOLERANCE * max(abs(expected), 1e3):
                yield (
                    f"{state}: at rest {axle.name} carries {found / 1e3:.2f} kN in the simulation, "
                    f"{expected / 1e3:.2f} kN by statics"
                )
        if not abs(speed) < 0.01:
            yield f"{state}: the truck does not stand still: {speed:.3f} m/s after {REST_TIME:g} s"


def resting_loads(p: TruckParameters, payload: float) -> tuple[FloatArray, float]:
    """Returns the axle loads [N], (axles,), and the speed [m/s] after `REST_TIME` at rest."""
    truck = Truck.load(payload, parameters=p, visuals=False)
    truck.command(parking_brake=1.0)
    truck.step(round(REST_TIME / truck.model.opt.timestep))
    loads = [
        sum(truck.read(f"{axle.name}_{side}_tire_force", 2) for side in ("left", "right"))
        for axle in p.axles
    ]
    return np.array(loads), truck.observe().speed
