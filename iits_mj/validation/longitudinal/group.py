"""`iits-mj validate longitudinal`: powertrain and brakes against the paper, rules and balances."""

from __future__ import annotations

import numpy as np

from iits_mj.core.results import Check, Line, Panel, Results
from iits_mj.core.units import KMH
from iits_mj.parameters import MAX_PAYLOAD
from iits_mj.validation.harness.config import ValidateConfig
from iits_mj.validation.longitudinal import (
    braking,
    descent,
    energy_audit,
    full_stop,
    hill_climb,
    speed_accuracy,
    steady_points,
)
from iits_mj.validation.longitudinal.acceleration import (
    full_pedal,
    part_throttle,
    part_throttle_run,
)
from iits_mj.validation.longitudinal.full_stop import distance
from iits_mj.validation.longitudinal.runs import HILLS_LENGTH

# --- Do the longitudinal figures depend on the time step? A start, XBR braking, and full stops ---
# The step-size study has the lateral figures and the standards at 1, 2 and 5 ms; these are few
# enough to be part of the longitudinal figures. They must agree within 0.5 % of the figure at 1 ms.

STEPS = (0.001, 0.002, 0.005)
AGREEMENT = 0.5
_PAYLOADS = (MAX_PAYLOAD, 0.0)
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


# --- `iits-mj validate longitudinal`: powertrain and brakes against the paper, rules and balances

# XBR is tested at 19, 50 and 55 t: payloads of 0, 31 and 36 t.
_XBR_PAYLOADS = (0.0, 31_000.0, MAX_PAYLOAD)
# The quick form audits the first hill [m].
_QUICK_HILLS = 1000.0


def run(config: ValidateConfig) -> Results:
    """Pedal, climbing, brake and descent tests; energy audit, fuel, accuracy of the speed."""
    results = Results("validate longitudinal")
    step, quick = config.step, config.quick

    def add(name: str, outcome: tuple[list[Check], list[Panel]]) -> None:
        checks, panels = outcome
        results.checks += checks
        results.figures[name] = panels

    drives = speed_accuracy.record(step)
    add("pedal_40_percent", part_throttle(drives.pedal, drives.pedal_without_air))
    add("full_pedal_flat", full_pedal(drives.flat, grade=0.0))
    add("full_pedal_uphill", full_pedal(drives.uphill, grade=speed_accuracy.UPHILL))
    results.checks += hill_climb.compare(step, quick=quick)
    add("steady_climb", steady_points.compare_climb(step, quick=quick))
    payloads = _XBR_PAYLOADS if config.payload is None else (config.payload,)
    for payload in payloads:
        add(f"xbr_{payload / 1e3:g}t", braking.xbr(payload, step))
    for payload in config.payloads():
        place = f"{payload / 1e3:g}t"
        add(f"brake_response_{place}", braking.compare(payload, step))
        for regulation in full_stop.REGULATIONS:
            kph = regulation.speed / KMH
            add(f"full_stop_{place}_{kph:.0f}kph", full_stop.full_stop(payload, regulation, step))
    for kph in (60.0,) if quick else (30.0, 60.0):
        add(f"descent_{kph:g}kph", descent.compare(kph * KMH, step))
    for payload in config.payloads()[:1] if quick else config.payloads():
        length = _QUICK_HILLS if quick else HILLS_LENGTH
        add(f"energy_{payload / 1e3:g}t", energy_audit.compare(payload, step, length))
    add("fuel", steady_points.compare_fuel(step, quick=quick))
    if not quick:
        add("time_step", compare())
    add("speed_accuracy", speed_accuracy.compare(drives))
    results.notes.append(speed_accuracy.NOTE)
    return results
