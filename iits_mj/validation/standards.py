"""`iits-mj validate standards`: figures that road authorities ask of a truck, by named procedures.

PBS: the Australian Performance Based Standards, level 1 limits.
"""

from __future__ import annotations

import numpy as np

from iits_mj.parameters import TruckParameters
from iits_mj.results import Results
from iits_mj.validation import (
    path_change,
    rollover,
    single_lane_change,
    swept_path,
    yaw_damping,
)
from iits_mj.validation.config import ValidateConfig

# Heights of the payload's centre of gravity within its bounds, for the tilt table.
_HEIGHTS = 5


def run(config: ValidateConfig) -> Results:
    """Tilt table, lane changes, pulse steer and the low-speed turn."""
    results = Results("validate standards")
    step = config.timestep
    for payload in config.payloads():
        load = f"{payload / 1e3:g}t"
        checks, panels, threshold = rollover.compare(payload, max(step, 0.002))
        results.checks += checks
        results.figures[f"tilt_table_{load}"] = panels
        _lane_changes(results, payload, threshold, config)
    payload = config.payloads()[0]
    if not config.quick and payload > 0.0:
        _tilt_by_height(results, payload, step)
    checks, panels = swept_path.compare(payload, step)
    results.checks += checks
    results.figures["swept_path"] = panels
    return results


def _lane_changes(
    results: Results, payload: float, threshold: float, config: ValidateConfig
) -> None:
    step = config.timestep
    for kph in (88.0,) if config.quick else (80.0, 88.0, 100.0):
        for name, (checks, panels) in {
            "single_sine": single_lane_change.compare(payload, kph, threshold, step),
            "pulse_steer": yaw_damping.compare(payload, kph, step),
            "lane_change": path_change.compare(payload, kph, threshold, step),
        }.items():
            results.checks += checks
            results.figures[f"{name}_{payload / 1e3:g}t_{kph:g}kph"] = panels


def _tilt_by_height(results: Results, payload: float, step: float) -> None:
    load = TruckParameters.load().payload
    heights = np.linspace(load.cg_height_min, load.cg_height_max, _HEIGHTS)
    checks, panel = rollover.by_height(payload, heights, max(step, 0.002))
    results.checks += checks
    results.figures["tilt_table_by_height"] = [panel]
