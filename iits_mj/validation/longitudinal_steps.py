"""Do the longitudinal figures depend on the time step? A start, XBR braking, and full stops.

The step-size study has the lateral figures and the standards at 1, 2 and 5 ms; these are few enough
to be part of the longitudinal figures. They must agree within 0.5 % of the figure at 1 ms.
"""

from __future__ import annotations

import numpy as np

from iits_mj.results import Check, Line, Panel
from iits_mj.units import KMH
from iits_mj.validation import braking, full_stop
from iits_mj.validation.acceleration import part_throttle_run
from iits_mj.validation.brake_measures import distance

STEPS = (0.001, 0.002, 0.005)
AGREEMENT = 0.5
_PAYLOADS = (36_000.0, 0.0)
_TIME = 30.0


def figures(timestep: float) -> dict[str, tuple[float, str]]:
    """The figures at one step [s]: value and unit by name."""
    start = part_throttle_run(timestep)
    braked = braking.xbr_run(_PAYLOADS[0], timestep)
    found = {
        "40 % pedal, 19 t: speed at 30 s": (
            float(np.interp(_TIME, start.time, start.speed)) / KMH,
            "km/h",
        ),
        "40 % pedal, 19 t: fuel used in 40 s": (1e3 * float(start.fuel_used[-1]), "g"),
        "XBR -1.5 m/s2, 55 t: speed at the release": (
            float(np.interp(braking.RELEASE, braked.time, braked.speed)) / KMH,
            "km/h",
        ),
    }
    for payload in _PAYLOADS:
        for regulation in full_stop.REGULATIONS:
            stopped = full_stop.stop_run(payload, regulation.speed, timestep)
            name = f"full stop from {regulation.name}, {payload / 1e3:g} t load: distance"
            found[name] = (distance(stopped), "m")
    return found


def compare() -> tuple[list[Check], list[Panel]]:
    """Change of every figure from 1 ms to 2 and 5 ms."""
    fine, *coarse = (figures(step) for step in STEPS)
    checks, lines = [], []
    count = np.arange(1.0, len(fine) + 1.0)
    for step, found in zip(STEPS[1:], coarse, strict=True):
        changes = []
        for name, (reference, _) in fine.items():
            change = 100.0 * abs(found[name][0] / reference - 1.0)
            changes.append(change)
            title = f"{step * 1e3:g} ms against {STEPS[0] * 1e3:g} ms: {name}"
            checks.append(Check(title, change, "%", reference, f"<= {AGREEMENT:g}"))
        lines.append(Line(f"{step * 1e3:g} ms", count, np.sort(np.array(changes))))
    limit = Line("allowed", count[[0, -1]], np.full(2, AGREEMENT), "reference")
    title = f"Change of every figure against {STEPS[0] * 1e3:g} ms, in order"
    return checks, [Panel(title, "figures", "change [%]", (limit, *lines))]
