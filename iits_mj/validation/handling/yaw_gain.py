"""Steady yaw gain at 80 km/h: what the plain yaw-sideslip model lacks, one effect after another.

The plain model has axle loads at rest, forces at the axles' centers, and neither drag nor rolling
resistance. Its gain is that of the front and rear cornering coefficients alone. Overlays switch off
one effect more at each step of the ladder, until the truck has none that the model lacks:

1. friction of the couplings;
2. play of the steering gear and compliance of the linkage, by which the road wheels turn less than
   the steering wheel over the ratio;
3. drive forces: rolling resistance and drag take load off the steer axle, pull the truck straight
   through the outer wheels, and the towed units' share bends the line of pull;
4. pneumatic trail, whose moments turn the motor vehicle out of the bend;
5. relaxation of the tires, whose carcass deflects and takes the axle load along;
6. side force of the air in sideslip, which turns the motor vehicle into the bend;
7. roll and load transfer: all centers of gravity and couplings lie at the height of the axles.

The understeer gradient of a gain G is `K = (v / G - L') / v^2`, with the length L' of the plain
model (`understeer_gradient`).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from iits_mj.analytic import YawPlane, understeer_gradient, yaw_rate_gain
from iits_mj.core.results import Findings
from iits_mj.core.units import GRAVITY
from iits_mj.parameters import AnyTruck, TruckParameters
from iits_mj.validation.handling.step_steer import SPEED, compare_step, step_steers

# Step at the steering wheel [deg] of the ladder, and the required fits of the yaw-sideslip model
# with all effects switched off by step [%].
STEP = 15.0
_FITS = {15.0: ">= 97", 3.0: ">= 99"}
# The end of the step steer in which the yaw rate is steady [s].
_STEADY = 2.0
# Height of the axles [m].
_LOW = 0.5
_SCALE = float(np.rad2deg(GRAVITY))  # from rad s2/m to deg/g

Overlay = Mapping[str, Any]


def overlays(parameters: TruckParameters) -> Iterator[tuple[str, Overlay]]:
    """Yields the effects in the order of the ladder, and the overlay that switches each off."""
    towed = {unit.name: {"coupling": {"yaw_friction": 0.0}} for unit in parameters.units[1:]}
    if towed:
        yield "friction of the couplings", {"units": towed}
    # A linkage ten times as stiff diverges at 5 ms.
    yield (
        "play and compliance of the steering",
        {"steering": {"dead_band": 0.0, "stiffness": 1e7}},
    )
    yield (
        "drive forces",
        {"tires": {"*": {"rolling_resistance": 0.0}}, "aerodynamics": {"drag_area": 0.0}},
    )
    yield "pneumatic trail", {"tires": {"*": {"pneumatic_trail": 0.0}}}
    yield "relaxation of the tires", {"tire_common": {"relaxation_lateral": 0.05}}
    yield "side air", {"aerodynamics": {"side_area": 0.0}}
    units: dict[str, dict[str, Any]] = {}
    for unit in parameters.units:
        units[unit.name] = {"cg_height": _LOW}
        if unit.coupling is not None:
            units[unit.name]["coupling"] = {"height": _LOW}
        if unit.payload is not None:
            units[unit.name]["payload"] = {"cg_height": _LOW, "cg_height_min": _LOW}
    yield "roll and load transfer", {"units": units}


def compare(truck: AnyTruck | None, payload: float, timestep: float) -> Findings:
    """Steady gain with the effects switched off one at a time, and the fits without any.

    Args:
      truck: name or file of the truck; None: the default one.
      payload: [kg].
      timestep: of the physics [s].

    Raises:
      InputError: parameters instead of a file, which an overlay cannot change.
    """
    parameters = TruckParameters.load(truck)
    ratio = parameters.steering.ratio
    plain = YawPlane.from_parameters(parameters, payload, pneumatic_trail=False)
    linear = YawPlane.from_parameters(parameters, payload, cruise_speed=SPEED)
    plain_gain, plain_gradient = yaw_rate_gain(plain.at(SPEED)), understeer_gradient(plain)
    length = SPEED / plain_gain - plain_gradient * SPEED**2

    def measured(truck: TruckParameters) -> tuple[float, float]:
        """Gains over the steering wheel's angle by the ratio, and over the road wheels' [1/s]."""
        (record,) = step_steers(truck, payload, (np.deg2rad(STEP),), timestep)
        steady = record.after(record.time[-1] - _STEADY)
        rate = float(steady.yaw_rate.mean())
        wheel = float(steady.steering_wheel.mean())
        return rate * ratio / wheel, rate / float(steady.road_wheel.mean())

    def gradient(gain: float) -> float:
        return (SPEED / gain - length) / SPEED**2 * _SCALE

    found = Findings(f"steady yaw gain at 80 km/h, {payload / 1e3:g} t")
    driven, road = measured(parameters)
    scale = 100.0 / plain_gain
    found.check("as driven, by the steering wheel", driven, "1/s", plain_gain)
    found.check("as driven, by the road wheels", road, "1/s", yaw_rate_gain(linear.at(SPEED)))
    gradients = {
        "plain yaw-sideslip model": plain_gradient * _SCALE,
        "yaw-sideslip model with trail and the axle loads of driving": understeer_gradient(linear)
        * _SCALE,
        "as driven, by the road wheels": gradient(road),
        "as driven, by the steering wheel": gradient(driven),
    }
    for name, value in gradients.items():
        found.check(f"understeer gradient, {name}", value, "deg/g")
    found.check("share of the plain model's gain, as driven", driven * scale, "%")
    applied: list[Overlay] = []
    changed = parameters
    before, steps = driven, list(overlays(parameters))
    for index, (effect, overlay) in enumerate(steps):
        applied.append(overlay)
        changed = TruckParameters.load(truck, applied)
        gain = measured(changed)[0]
        # The last two steps are the plain model's truck with and without roll.
        must = "99 .. 101" if index >= len(steps) - 2 else ""
        name = f"share of the plain model's gain, without {effect} either"
        if index == 0:
            name = name.removesuffix(" either")
        found.check(name, gain * scale, "%", f"{(gain - before) * scale:+.1f}", must)
        before = gain
    records = step_steers(changed, payload, tuple(np.deg2rad(list(_FITS))), timestep)
    for (degrees, must), record in zip(_FITS.items(), records, strict=True):
        fits = compare_step(changed, payload, degrees, "", record, must)
        for check in fits.checks:
            if check.must:
                name = check.name.rsplit(": ", 1)[1]
                label = f"without these effects, step steer {degrees:g} deg"
                found.check(f"{label}: {name}", check.value, "%", "yaw-sideslip", must)
    return found
