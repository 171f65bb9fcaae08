"""`iits-mj validate longitudinal`: powertrain and brakes against the paper, rules and balances."""

from __future__ import annotations

from iits_mj.results import Check, Panel, Results
from iits_mj.units import KMH
from iits_mj.validation import (
    brake_response,
    braking,
    descent,
    energy_audit,
    full_stop,
    hill_climb,
    longitudinal_steps,
    speed_accuracy,
    steady_climb,
    steady_fuel,
)
from iits_mj.validation.acceleration import full_pedal, part_throttle
from iits_mj.validation.config import ValidateConfig
from iits_mj.validation.slopes import HILLS_LENGTH

# XBR is tested at 19, 50 and 55 t: payloads of 0, 31 and 36 t.
_XBR_PAYLOADS = (0.0, 31_000.0, 36_000.0)
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
    add("steady_climb", steady_climb.compare(step, quick=quick))
    payloads = _XBR_PAYLOADS if config.payload is None else (config.payload,)
    for payload in payloads:
        add(f"xbr_{payload / 1e3:g}t", braking.xbr(payload, step))
    for payload in config.payloads():
        place = f"{payload / 1e3:g}t"
        add(f"brake_response_{place}", brake_response.compare(payload, step))
        for regulation in full_stop.REGULATIONS:
            kph = regulation.speed / KMH
            add(f"full_stop_{place}_{kph:.0f}kph", full_stop.full_stop(payload, regulation, step))
    for kph in (60.0,) if quick else (30.0, 60.0):
        add(f"descent_{kph:g}kph", descent.compare(kph * KMH, step))
    for payload in config.payloads()[:1] if quick else config.payloads():
        length = _QUICK_HILLS if quick else HILLS_LENGTH
        add(f"energy_{payload / 1e3:g}t", energy_audit.compare(payload, step, length))
    add("fuel", steady_fuel.compare(step, quick=quick))
    if not quick:
        add("time_step", longitudinal_steps.compare())
    add("speed_accuracy", speed_accuracy.compare(drives))
    results.notes.append(speed_accuracy.NOTE)
    return results
