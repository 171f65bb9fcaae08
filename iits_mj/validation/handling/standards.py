"""`iits-mj validate standards`: figures that road authorities ask of a truck, by named procedures.

PBS: the Australian Performance Based Standards, level 1 limits.
"""

from __future__ import annotations

import numpy as np

from iits_mj.core.results import Check, Panel, Results
from iits_mj.parameters import TruckParameters
from iits_mj.validation.handling import (
    circle,
    path_change,
    rollover,
    single_lane_change,
    split_friction,
    swept_path,
    tightening_turn,
    wheel_lock,
    yaw_damping,
)
from iits_mj.validation.harness.config import ValidateConfig

# Heights of the payload's centre of gravity within its bounds, for the tilt table.
_HEIGHTS = 5


def run(config: ValidateConfig) -> Results:
    """Tilt table, lane changes, pulse steer, turns, split friction, locked wheels."""
    results = Results("validate standards")
    step = config.step
    payloads = config.payloads()
    for payload in payloads:
        checks, panels, threshold = rollover.compare(payload, step)
        _add(results, f"tilt_table_{payload / 1e3:g}t", checks, panels)
        _lane_changes(results, payload, threshold, config)
        if not config.quick:
            checks, panels, notes = tightening_turn.compare(payload, threshold, step)
            _add(results, f"tightening_turn_{payload / 1e3:g}t", checks, panels)
            results.notes += notes
    if not config.quick and payloads[0] > 0.0:
        load = TruckParameters.load().payload
        heights = np.linspace(load.cg_height_min, load.cg_height_max, _HEIGHTS)
        checks, panel = rollover.by_height(payloads[0], heights, step)
        _add(results, "tilt_table_by_height", checks, [panel])
    for payload in () if config.quick else payloads:
        checks, panels, end = circle.compare(payload, step)
        _add(results, f"steady_circle_{payload / 1e3:g}t", checks, panels)
        results.notes.append(end)
    for payload in payloads[:1] if config.quick else payloads:
        place = f"{payload / 1e3:g}t"
        _add(results, f"low_speed_turn_{place}", *swept_path.compare(payload, step))
        _add(results, f"split_friction_{place}", *split_friction.compare(payload, step))
        _add(results, f"wheel_lock_{place}", *wheel_lock.compare(payload, step))
    return results


def _lane_changes(
    results: Results, payload: float, threshold: float, config: ValidateConfig
) -> None:
    step = config.step
    for kph in (88.0,) if config.quick else (80.0, 88.0, 100.0):
        place = f"{payload / 1e3:g}t_{kph:g}kph"
        _add(
            results,
            f"single_sine_{place}",
            *single_lane_change.compare(payload, kph, threshold, step),
        )
        _add(results, f"pulse_steer_{place}", *yaw_damping.compare(payload, kph, step))
        _add(results, f"lane_change_{place}", *path_change.compare(payload, kph, threshold, step))


def _add(results: Results, name: str, checks: list[Check], panels: list[Panel]) -> None:
    results.checks += checks
    results.figures[name] = panels
