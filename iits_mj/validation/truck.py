"""`iits-mj validate truck`: the main figures of any truck against models and rules, on one page.

Axle loads at rest, fit of the yaw-roll model, understeer, tilt table, low-speed turn, full stop,
full pedal, steady climb and energy audit; each with the greatest load and, where it matters, empty.
The other groups have more tests of the same kinds. The pictures are those with the greatest load.
"""

from __future__ import annotations

import numpy as np

from iits_mj.core.results import Findings, Results
from iits_mj.core.timing import TIMESTEP
from iits_mj.parameters import TruckParameters
from iits_mj.parameters.mass_state import static_axle_loads
from iits_mj.truck.check import resting_loads
from iits_mj.validation.handling import circle, low_speed_turn, rollover, step_steer
from iits_mj.validation.handling.group import NO_TRAILER, name_of
from iits_mj.validation.harness.config import ValidateConfig
from iits_mj.validation.longitudinal import braking, energy_audit, hill_climb
from iits_mj.validation.longitudinal.acceleration import full_pedal, full_pedal_run
from iits_mj.validation.longitudinal.force_balance import ForceBalance

# Step at the steering wheel [deg], and the required fit of the yaw-roll model [%].
_STEP, _FIT = 3.0, ">= 99"
# Speeds on the circle [m/s].
_SPEEDS = (6.0, 10.0, 14.1)
# Duration of full pedal on the flat [s], grade of the climb, and hills of the energy audit [m].
_DURATION, _GRADE, _HILLS = 60.0, 0.03, 1000.0
_NOTES = (
    "The couplings turn without friction where the truck is compared with linear models and "
    "statics of a turn, which have none.",
    "The yaw-sideslip model has no roll, tire lag, side air or rolling resistance: its fits are "
    "for information.",
)


def run(config: ValidateConfig) -> Results:
    """Measures the truck of the settings, by default with the time step of drives."""
    results, truck = Results(name_of("truck", config)), config.parameters
    step = TIMESTEP if config.timestep is None else config.timestep
    free = step_steer.free_couplings(truck)
    first = config.payloads()[0]

    def add(name: str, found: Findings) -> None:
        if payload != first:
            found.panels.clear()
        results.add(f"{name}_{payload / 1e3:g}t", found)

    for payload in config.payloads():
        results.add("", axle_loads(truck, payload))
        (recording,) = step_steer.step_steers(free, payload, (np.deg2rad(_STEP),), step)
        found = step_steer.compare_step(free, payload, _STEP, _FIT, recording)
        add("step_steer", found)
        found = circle.compare(truck, payload, step, _SPEEDS, linear_must="")
        add("steady_circle", found)
        add("tilt_table", rollover.compare(truck, payload, step)[0])
        add("full_stop", braking.compare_stop(truck, payload, braking.UN_R13, step))
    found = low_speed_turn.compare_swept_path(truck, first, step, limits=False)
    results.add("low_speed_turn", found)
    flat = full_pedal_run(truck, step, 0.0, _DURATION)
    results.add("full_pedal", full_pedal(truck, flat, grade=0.0))
    climb = Findings()
    hill_climb.check_climb(climb, ForceBalance(truck, truck.payload_max), _GRADE, step)
    results.add("", climb)
    results.add("energy_audit", energy_audit.compare(truck, first, step, _HILLS))
    results.notes += _NOTES
    if len(truck.units) == 1:
        results.notes.append(NO_TRAILER)
    return results


def axle_loads(parameters: TruckParameters, payload: float) -> Findings:
    """Axle loads of the simulated truck at rest against statics of the chain of units."""
    found = Findings(f"at rest, {payload / 1e3:g} t")
    loads, _ = resting_loads(parameters, payload)
    statics = static_axle_loads(parameters, payload)
    for axle, load, expected in zip(parameters.axles, loads, statics, strict=True):
        name, near = f"load of {axle.name.replace('_', ' ')}", 0.02 * expected + 50.0
        must = f"{(expected - near) / 1e3:.2f} .. {(expected + near) / 1e3:.2f}"
        found.check(name, load / 1e3, "kN", float(expected) / 1e3, must)
    return found
