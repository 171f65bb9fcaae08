"""`iits-mj validate traffic`: simulated traffic against recorded traffic, and against its theory.

The paper's figure is the distribution of speeds of recorded and simulated traffic for three
densities. Here are speed, spacing and time headway, with their distances, before and after the
car-following model is calibrated to the recorded pairs.
"""

from __future__ import annotations

from iits_mj.core.results import Check, Results
from iits_mj.validation.harness.config import ValidateConfig
from iits_mj.validation.traffic import replay, theory
from iits_mj.validation.traffic.compare import RecordedFlow, compare_flows
from iits_mj.validation.traffic.fit import calibrated, calibration_checks, each_checks, error_panel
from iits_mj.validation.traffic.flow import lane_change_rate
from traffic_bridge.vehicles.calibration import calibrate_each

MISSING = (
    "recorded traffic was not compared: give --data FILE, trajectories that the data-set readers "
    "know, for instance the reconstructed NGSIM pairs"
)
QUICK_EACH = 12


def run(config: ValidateConfig) -> Results:
    """Theory and replay always; the recorded set where there is one.

    Raises:
      InputError: the recorded set cannot be read, or has no pairs to calibrate to.
    """
    results = Results("validate traffic")
    # What cannot be used is told before anything is measured.
    recorded = None if config.data is None else RecordedFlow.read(config.data)
    checks, diagram, stability = theory.compare(config.quick)
    results.checks += checks
    results.figures["fundamental_diagram"] = diagram
    results.figures["string_stability"] = stability
    results.checks += replay.own_recording()
    results.checks += replay.lane_changes(config.quick)
    if recorded is None:
        results.notes.append(MISSING)
        return results
    results.notes += [f"data: {note}" for note in recorded.data.notes]
    _compare(results, recorded, config.quick)
    return results


def _compare(results: Results, recorded: RecordedFlow, quick: bool) -> None:
    data, found = recorded.data, recorded.found
    changes, driven = lane_change_rate(data)
    rate = changes / driven if driven > 0.0 else 0.0
    results.checks.append(Check("lane changes per vehicle and km, recorded", rate, "1/km"))
    if changes == 0:
        results.notes.append("nobody changes lanes in this set: its rate says nothing")
    results.checks += replay.laid(data)
    fit = calibrated(found)
    results.checks += calibration_checks(fit)
    results.figures["calibration"] = [error_panel(fit)]
    each = calibrate_each(
        fit.fitted[:: max(1, len(fit.fitted) // QUICK_EACH)] if quick else found,
        begin=fit.common.parameters,
    )
    results.checks += each_checks(each)
    compare_flows(results, recorded, fit, quick)
