"""`iits-mj validate longitudinal`: powertrain and brakes against the paper, rules and balances."""

from __future__ import annotations

from iits_mj.results import Check, Panel, Results
from iits_mj.validation.acceleration import full_pedal, part_throttle
from iits_mj.validation.braking import full_stop, xbr
from iits_mj.validation.config import ValidateConfig

# XBR is tested at 19, 50 and 55 t: payloads of 0, 31 and 36 t.
_XBR_PAYLOADS = (0.0, 31_000.0, 36_000.0)


def run(config: ValidateConfig) -> Results:
    """Pedal tests, force balance and brake tests."""
    results = Results("validate longitudinal")
    step = config.step

    def add(name: str, outcome: tuple[list[Check], list[Panel]]) -> None:
        checks, panels = outcome
        results.checks += checks
        results.figures[name] = panels

    add("pedal_40_percent", part_throttle(step))
    add("full_pedal_flat", full_pedal(step, grade=0.0, duration=60.0 if config.quick else 120.0))
    if not config.quick:
        add("full_pedal_uphill", full_pedal(step, grade=0.03, duration=90.0))
    payloads = _XBR_PAYLOADS if config.payload is None else (config.payload,)
    for payload in payloads:
        add(f"xbr_{payload / 1e3:g}t", xbr(payload, step))
    for payload in config.payloads():
        add(f"full_stop_{payload / 1e3:g}t", full_stop(payload, step))
    return results
