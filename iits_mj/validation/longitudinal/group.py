"""`iits-mj validate longitudinal`: powertrain and brakes against the paper, rules and balances.

The paper's experiments, the fuel map and the VECTO cycle are those of the default truck.
"""

from __future__ import annotations

import numpy as np

from iits_mj.core.results import Findings, Results
from iits_mj.core.units import KMH
from iits_mj.parameters import TruckParameters
from iits_mj.validation.handling.group import name_of
from iits_mj.validation.handling.step_size import AGREEMENT, STEPS, change_panel, step_title
from iits_mj.validation.harness.config import ValidateConfig, laden
from iits_mj.validation.longitudinal import (
    braking,
    descent,
    energy_audit,
    fuel_map,
    hill_climb,
    long_haul,
    speed_accuracy,
    uneven_road,
)
from iits_mj.validation.longitudinal.acceleration import (
    full_pedal,
    full_pedal_run,
    part_throttle,
    part_throttle_run,
)
from iits_mj.validation.longitudinal.hills import HILLS_LENGTH

# XBR is tested at 19, 50 and 55 t.
_XBR_PAYLOADS = (0.0, 31_000.0, 36_000.0)
# Physics step of the mission, 5 300 s long [s].
_LONG_STEP = 0.005
_DEFAULT_ONLY = (
    "The paper's pedal test and its accuracy of the speed, the fuel map, the long haul and the "
    "comparison of time steps are those of the default truck: left out here."
)
# The quick form audits the first hill [m].
_QUICK_HILLS = 1000.0


def run(config: ValidateConfig) -> Results:
    """Pedal, climbing, brake and descent tests; energy audit, fuel, accuracy of the speed."""
    results = Results(name_of("longitudinal", config))
    add, step, quick, truck = results.add, config.step, config.quick, config.parameters
    drives = speed_accuracy.record(step) if config.default_truck else None
    if drives is not None:
        add("pedal_40_percent", part_throttle(drives.pedal, drives.pedal_without_air))
        flat, uphill = drives.flat, drives.uphill
    else:
        flat, uphill = (
            full_pedal_run(truck, step, grade, duration)
            for grade, duration in (
                (0.0, speed_accuracy.FLAT_TIME),
                (speed_accuracy.UPHILL, speed_accuracy.UPHILL_TIME),
            )
        )
    add("full_pedal_flat", full_pedal(truck, flat, grade=0.0))
    add("full_pedal_uphill", full_pedal(truck, uphill, grade=speed_accuracy.UPHILL))
    add("", hill_climb.compare_limits(truck, step, quick=quick))
    add("steady_climb", hill_climb.compare_speeds(truck, step, quick=quick))
    papers = drives is not None and config.payload is None
    for payload in _XBR_PAYLOADS if papers else config.payloads():
        add(f"xbr_{payload / 1e3:g}t", braking.compare_xbr(truck, payload, step))
    for payload in config.payloads():
        load = f"{payload / 1e3:g}t"
        add(f"brake_response_{load}", braking.compare_response(truck, payload, step))
        for regulation in braking.REGULATIONS:
            name = f"full_stop_{load}_{regulation.speed / KMH:.0f}kph"
            add(name, braking.compare_stop(truck, payload, regulation, step))
    for payload in config.payloads()[:1] if quick else config.payloads():
        name = f"uneven_road_{payload / 1e3:g}t"
        add(name, uneven_road.compare(truck, payload, step, quick=quick))
    for kph in (60.0,) if quick else (30.0, 60.0):
        add(f"descent_{kph:g}kph", descent.compare(truck, kph * KMH, step))
    for payload in config.payloads()[:1] if quick else config.payloads():
        length = _QUICK_HILLS if quick else HILLS_LENGTH
        add(f"energy_{payload / 1e3:g}t", energy_audit.compare(truck, payload, step, length))
    if drives is None:
        results.notes.append(_DEFAULT_ONLY)
        return results
    add("fuel", fuel_map.compare(step, quick=quick))
    add("long_haul", long_haul.compare(_LONG_STEP, quick=quick))
    if not quick:
        add("time_step", compare_steps())
    add("speed_accuracy", speed_accuracy.compare(drives))
    return results


def figures(timestep: float) -> dict[str, float]:
    """Returns figures of a start, XBR braking and full stops at a time step [s], by name."""
    start = part_throttle_run(timestep)
    parameters = TruckParameters.load()
    braked = braking.xbr_run(parameters, laden(), timestep)
    speed = float(np.interp(30.0, start.time, start.speed)) / KMH
    released = float(np.interp(braking.RELEASE, braked.time, braked.speed)) / KMH
    found = {
        "40 % pedal, 19 t: speed at 30 s": speed,
        "40 % pedal, 19 t: fuel used in 40 s": 1e3 * float(start.fuel_used[-1]),
        "XBR -1.5 m/s2, 55 t: speed at the release": released,
    }
    for payload in (laden(), 0.0):
        for regulation in braking.REGULATIONS:
            name = f"full stop from {regulation.name}, {payload / 1e3:g} t load: distance"
            stopped = braking.stop_run(parameters, payload, regulation.speed, timestep)
            found[name] = braking.distance(stopped)
    return found


def compare_steps() -> Findings:
    """Compares these figures at 1 ms with 2 and 5 ms; each change must be below 0.5 %."""
    fine, *coarse = (figures(step) for step in STEPS)
    found, changes = Findings(), {}
    for step, values in zip(STEPS[1:], coarse, strict=True):
        changes[step] = [100.0 * abs(values[name] / fine[name] - 1.0) for name in fine]
        for (name, reference), change in zip(fine.items(), changes[step], strict=True):
            title = step_title(step, STEPS[0], name)
            found.check(title, change, "%", reference, f"<= {AGREEMENT:g}")
    change_panel(found, changes, STEPS[0])
    return found
