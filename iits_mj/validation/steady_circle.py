"""ISO 14792, steady circle of 100 m from walking pace to its end, laden and empty."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import PchipInterpolator

from iits_mj.parameters import TruckParameters
from iits_mj.results import Check, Line, Panel
from iits_mj.units import GRAVITY
from iits_mj.validation.circle import LINEAR, RADIUS, Circle, limit
from iits_mj.validation.roll_plane import RollPlane

# How near the statics with the tires' whole law must come to the truck, up to `LINEAR` [%].
_ERROR = 10.0
# The slope near the end must exceed that of the beginning by this factor for the tires to saturate.
_SATURATED = 1.5
# Near the end: between these shares of the roll-over threshold by statics, the same at any step.
_LATE = (0.6, 0.8)


def compare(payload: float, timestep: float) -> tuple[list[Check], list[Panel], str]:
    """Checks, panels, and a sentence on what ended the circle."""
    found, end = limit(payload, timestep)
    parameters = TruckParameters.load()
    label = f"ISO 14792 circle of {RADIUS:g} m, {payload / 1e3:g} t"
    scale = float(np.rad2deg(GRAVITY))
    error = 100.0 * abs(found.gradient / found.saturating_gradient - 1.0)
    linear = 100.0 * abs(found.gradient / found.reference - 1.0)
    last = _late_slope(found, GRAVITY * RollPlane.from_parameters(parameters, payload).threshold())
    checks = [
        Check(
            f"{label}: understeer to {LINEAR:g} m/s2",
            found.gradient * scale,
            "deg/g",
            found.saturating_gradient * scale,
        ),
        Check(f"{label}: understeer error to the statics", error, "%", None, f"<= {_ERROR:g}"),
        Check(
            f"{label}: understeer error to the linear model", linear, "%", found.reference * scale
        ),
        Check(f"{label}: greatest lateral acceleration", found.lateral[-1] / GRAVITY, "g"),
        Check(
            f"{label}: slope near the end over slope at the beginning",
            last / found.gradient,
            "1",
            None,
            f">= {_SATURATED:g}",
        ),
    ]
    steer = [np.rad2deg(y) for y in (found.linear, found.saturating, found.steer)]
    lines = (
        Line("statics with the tires' whole law", found.lateral, steer[1], "reference"),
        Line("truck", found.lateral, steer[2], "simulation"),
        Line("yaw-sideslip model", found.lateral, steer[0]),
    )
    panel = Panel(label, "lateral acceleration [m/s2]", "steer beyond Ackermann [deg]", lines)
    return checks, [panel], f"{label} ends at {found.lateral[-1]:.2f} m/s2: {end}."


def _late_slope(found: Circle, threshold: float) -> float:
    """Slope of steer over lateral acceleration [rad s2/m]; NaN when the truck does not get there.

    Args:
      found: steady states.
      threshold: of roll-over [m/s2].
    """
    # At the limit a faster circle may be a wider one: only states that went further count.
    before = np.maximum.accumulate(np.concatenate([[-np.inf], found.lateral[:-1]]))
    further = found.lateral > before
    steer = PchipInterpolator(found.lateral[further], found.steer[further], extrapolate=False)
    low, high = (share * threshold for share in _LATE)
    return float((steer(high) - steer(low)) / (high - low))
