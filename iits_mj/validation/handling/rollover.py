"""Static roll-over threshold on a tilt table (SAE J2180): gravity tilts until the truck falls.

Near the fall the table rises at 0.25 deg/s, as the standard requires. It rises further during a
fall of some seconds, so the angle of a visible fall does not count. The table returns to earlier
angles and stops there, to find the greatest angle at which the truck stays upright. The truck falls
with the first of its units that falls. The Australian PBS requires a threshold of 0.35 g of every
truck.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from iits_mj.analytic import laden_units
from iits_mj.core.arrays import FloatArray
from iits_mj.core.results import Findings, Line
from iits_mj.core.timing import TIMESTEP
from iits_mj.core.units import GRAVITY
from iits_mj.parameters import TruckParameters
from iits_mj.truck import Truck
from iits_mj.validation.handling.roll_plane import RollPlane
from iits_mj.validation.harness.maneuver import restore_state, save_state
from iits_mj.validation.harness.recorder import unit_roll
from iits_mj.validation.pbs.limits import STANDARDS

# Rates of the table [rad/s] below and above an angle near the fall, a share of T / 2h.
_FAST, _SLOW = math.radians(1.0), math.radians(0.25)
_NEAR = 0.7
_LIMIT = math.radians(60.0)
# Roll of a fallen trailer against the table [rad].
_FALLEN = math.radians(15.0)
# Duration of a hold [s], and allowed difference of the mean roll of its halves [rad], as an upright
# truck may sway.
_HOLD = 8.0
_CREEP = math.radians(0.2)
_BLOCK = 0.1
_PBS = STANDARDS["rollover"]
# Checkpoints before the fall, one in each block.
_KEPT = 200


@dataclass(frozen=True)
class Tilt:
    """One tilt-table test.

    Attributes:
      threshold: the smaller of `held` and `lifted` [g]: roll instability as PBS defines it.
      held: tangent of the greatest angle at which the truck stays upright [g].
      lifted: tangent of the angle at which the last upper wheel but those of the steer axles leaves
        the table [g], of the combination or of units that no coupling holds in roll; infinite if
        a wheel stays on it.
      table, roll: angle of the table and greatest roll of a unit against it [rad], shape (n,).
    """

    threshold: float
    held: float
    lifted: float
    table: FloatArray
    roll: FloatArray


def tilt_table(
    parameters: TruckParameters,
    payload: float,
    timestep: float = TIMESTEP,
    height: float | None = None,
) -> Tilt:
    """Tilts the standing truck to the right until it falls.

    The height [m] is that of the payload's CG; default: the parameters'.
    """
    truck = Truck.load(
        payload, payload_height=height, parameters=parameters, timestep=timestep, visuals=False
    )
    near = _NEAR * math.atan(rigid_threshold(truck.parameters, payload))
    truck.reset()
    truck.command(parking_brake=1.0)
    truck.step(round(3.0 / timestep))
    table, roll = [0.0], [_roll(truck)]
    kept: list[tuple[float, NDArray[np.float64]]] = []
    lifted = math.inf
    upper = _upper_wheels(truck)
    while table[-1] < _LIMIT and abs(roll[-1]) < _FALLEN:
        kept = [*kept[-_KEPT:], (table[-1], save_state(truck))]
        rate = _SLOW if table[-1] > near else _FAST
        _tilt(truck, table[-1], rate, _BLOCK)
        table.append(table[-1] + rate * _BLOCK)
        roll.append(_roll(truck))
        if math.isinf(lifted) and any(
            all(truck.data.sensor(name).data[2] <= 0.0 for name in group) for group in upper
        ):
            lifted = math.tan(table[-1])
    held = math.tan(_last_held(truck, kept))
    return Tilt(min(held, lifted), held, lifted, np.array(table), np.array(roll))


def _roll(truck: Truck) -> float:
    """Roll of the unit that rolls most [rad]."""
    rolls = [unit_roll(truck, unit) for unit in range(len(truck.parameters.units))]
    return max(rolls, key=abs)


def _upper_wheels(truck: Truck) -> list[list[str]]:
    """Force sensors of the upper wheels but those of steer axles, by units coupled in roll."""
    groups: list[list[str]] = [[]]
    for unit in truck.parameters.units:
        if unit.coupling and unit.coupling.roll_stiffness == 0.0:
            groups.append([])
        axles = [axle for group in unit.groups(truck.payload) for axle in group]
        steered = 0 if unit.coupling else len(unit.groups(truck.payload)[0])
        groups[-1] += [f"{axle.name}_left_tire_force" for axle in axles[steered:]]
    return groups


def _tilt(truck: Truck, angle: float, rate: float, duration: float) -> None:
    """Tilts to the right (gravity towards -y) from an angle [rad] at a rate [rad/s]."""
    step = truck.model.opt.timestep
    for i in range(round(duration / step)):
        now = angle + rate * (i + 1) * step
        truck.model.opt.gravity[:] = (0.0, -GRAVITY * math.sin(now), -GRAVITY * math.cos(now))
        truck.step(1)


def _last_held(truck: Truck, kept: list[tuple[float, NDArray[np.float64]]]) -> float:
    """Greatest angle [rad] of the checkpoints at which the truck stays upright, by bisection."""
    low, high = 0, len(kept)
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (middle, high) if _stays_upright(truck, *kept[middle]) else (low, middle)
    return kept[low][0]


def _stays_upright(truck: Truck, angle: float, state: NDArray[np.float64]) -> bool:
    """Returns whether the truck stays upright on the table at this angle [rad]."""
    restore_state(truck, state)
    lean = np.zeros((2, round(0.5 * _HOLD / _BLOCK)))
    for index in np.ndindex(*lean.shape):
        _tilt(truck, angle, 0.0, _BLOCK)
        lean[index] = abs(_roll(truck))
        if lean[index] > _FALLEN:
            return False
    first, second = lean.mean(axis=1)
    return bool(second - first < _CREEP)


def rigid_threshold(parameters: TruckParameters, payload: float) -> float:
    """Upper bound `T / (2 h)` [g]: threshold of a rigid truck on rigid tires."""
    units = laden_units(parameters, payload)
    height = sum(unit.mass * unit.cg_height for unit in units) / sum(unit.mass for unit in units)
    track = float(np.mean([axle.track for axle in parameters.axles[1:]]))
    return track / (2.0 * height)


def compare(parameters: TruckParameters, payload: float, timestep: float) -> tuple[Findings, float]:
    """One tilt test; also returns the threshold [g]."""
    tilt = tilt_table(parameters, payload, timestep)
    found = Findings(f"SAE J2180 tilt table, {payload / 1e3:g} t")
    compliant = RollPlane.from_parameters(parameters, payload).threshold()
    found.check("static roll-over threshold", tilt.threshold, "g", compliant, _PBS.must(1))
    error = 100.0 * abs(tilt.threshold / compliant - 1.0)
    found.check("error to statics", error, "%", "roll plane", "<= 5")
    share = tilt.threshold / rigid_threshold(parameters, payload)
    found.check("share of the rigid bound T/2h", share, "1", 1.0, "<= 1")
    roll = np.rad2deg(np.abs(tilt.roll))
    mark = np.rad2deg(math.atan(compliant)) * np.ones(2)
    statics = Line("threshold by statics", mark, np.array([0.0, roll.max()]), "reference")
    truck = Line("truck", np.rad2deg(tilt.table), roll, "simulation")
    found.panel("", "table angle [deg]", "roll on the table [deg]", statics, truck)
    return found, tilt.threshold


def by_height(
    parameters: TruckParameters, payload: float, heights: FloatArray, timestep: float
) -> Findings:
    """Thresholds over the height of the payload's center of gravity [m], shape (n,)."""
    label = f"SAE J2180 tilt table, {payload / 1e3:g} t"
    measured, compliant, rigid, found = [], [], [], Findings()
    for height in heights:
        raised = parameters.with_payload_height(float(height))
        measured.append(tilt_table(parameters, payload, timestep, float(height)).threshold)
        compliant.append(RollPlane.from_parameters(raised, payload).threshold())
        rigid.append(rigid_threshold(raised, payload))
        name = f"{label} with its CG at {height:.2f} m: threshold"
        found.check(name, measured[-1], "g", compliant[-1])
    error = 100.0 * np.max(np.abs(np.array(measured) / np.array(compliant) - 1.0))
    label += " by height"
    found.check(f"{label}: greatest error to statics", error, "%", "roll plane", "<= 5")
    statics = Line("statics of the roll plane", heights, np.array(compliant), "reference")
    truck = Line("truck", heights, np.array(measured), "simulation")
    bound = Line("rigid bound T/2h", heights, np.array(rigid))
    found.panel(label, "height of the payload's CG [m]", "threshold [g]", statics, truck, bound)
    return found
