"""`iits-mj validate traffic`: simulated traffic against recorded traffic, and against its theory.

The paper compares the distributions of speeds of recorded and simulated traffic for three
densities. Here speed, spacing and time headway are compared, with distances of the distributions,
before and after the car-following model is calibrated to the recorded pairs. RepSim is compared
with the recording that it replays.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from iits_mj.core.output_files import TemporaryFolder
from iits_mj.core.results import Findings, Results
from iits_mj.core.timing import CYCLE_PERIOD
from iits_mj.core.vehicles import VehicleFrame
from iits_mj.road import RoadMap, Route
from iits_mj.validation.harness.config import ValidateConfig
from iits_mj.validation.traffic import fit, levels, theory
from iits_mj.validation.traffic.compare import RecordedFlow, compare_flows
from iits_mj.validation.traffic.flow import (
    LEVELS,
    FlowLog,
    FlowSamples,
    lane_change_rate,
    wasserstein,
)
from traffic_bridge.config import TrafficConfig
from traffic_bridge.datasets import ImportConfig, Trajectories, import_trajectories
from traffic_bridge.modes.repsim import RepSim
from traffic_bridge.modes.sumo_modes import PureSim
from traffic_bridge.recording.recorder import Recorder
from traffic_bridge.vehicles.calibration import calibrate_each

MISSING = (
    "recorded traffic was not compared: give --data FILE, trajectories that the data-set readers "
    "know, for instance the reconstructed NGSIM pairs"
)
QUICK_EACH = 12

# Knoop, Hoogendoorn, Shiomi and Buisson, "Quantifying the number of lane changes in traffic:
# empirical analysis", Transportation Research Record 2278 (2012): about one change in 2 km on two
# plain freeway sites.
PUBLISHED_RATE = 0.5  # [1/km] a vehicle
LEAD_IN = 100.0  # [m] of road before an imported data set


def run(config: ValidateConfig) -> Results:
    """Compares the traffic with theory, with its own replay, and with recorded data if given.

    Raises:
      InputError: the recorded set cannot be read, or has no pairs for the calibration.
    """
    results, quick = Results("validate traffic"), config.quick
    # Refuse unusable data before anything is measured.
    recorded = None if config.data is None else RecordedFlow.read(config.data)
    results.add("fundamental_diagram", theory.compare_equilibrium(quick))
    results.add("string_stability", theory.compare_stability(quick))
    results.add("", own_recording())
    results.add("", lane_changes(quick))
    results.add("", levels.compare_levels(quick))
    if not quick:
        results.add("", levels.compare_paper())
    if recorded is None:
        results.notes.append(MISSING)
        return results
    data, pairs = recorded.data, recorded.found
    results.notes += [f"data: {note}" for note in data.notes]
    results.add("", _recorded_changes(data))
    results.add("", laid(data))
    calibrated = fit.calibrated(pairs)
    results.add("calibration", fit.compare(calibrated))
    chosen = calibrated.fitted[:: max(1, len(calibrated.fitted) // QUICK_EACH)] if quick else pairs
    each = calibrate_each(chosen, begin=calibrated.common.parameters)
    results.add("", fit.compare_each(each))
    compare_flows(results, recorded, calibrated, quick)
    return results


def own_recording(duration: float = 30.0) -> Findings:
    """Records PureSim and replays it: greatest difference of any value of any vehicle."""
    route = Route.straight(3000.0, lanes=3, speed_limit=20.0)
    config = TrafficConfig(density="dense", lane_change="mobil", fill_ahead=3000.0)
    seen: list[VehicleFrame] = []
    with Recorder(PureSim(route, config, seed=0)) as recorder:
        seen.append(recorder.reset())
        while recorder.time < duration - 1e-9:
            seen.append(recorder.step())
        with TemporaryFolder("replay") as folder:
            path = recorder.save(Path(folder) / "recording.npz")
            with RepSim(route, path) as replay:
                replayed = [replay.reset()]
                replayed += [replay.step() for _ in seen[1:]]
    found, name = Findings(), "RepSim of a recorded PureSim"
    found.check(f"{name}, greatest difference", _difference(seen, replayed), "SI", must="<= 0")
    speed = wasserstein(_samples(seen), _samples(replayed))
    found.check(f"{name}, Wasserstein of speed", speed, "m/s", must="<= 0")
    return found


def laid(data: Trajectories) -> Findings:
    """Imports a recorded set on a road and replays it."""
    length = float(data.station.max()) + 2.0 * LEAD_IN
    route = Route.straight(length, lanes=data.lane_count, lane_width=data.lane_width)
    recording = import_trajectories(data, route, ImportConfig(start_station=LEAD_IN))
    with RepSim(route, recording) as replay:
        frames = [replay.reset()]
        frames += [replay.step() for _ in recording.time[1:]]
    unknown, weight = np.full(len(data), np.nan), np.ones(len(data))
    source = FlowSamples(data.time, data.lane, data.station, data.speed, unknown, weight)
    found, distance = Findings(), _difference(recording.frames, frames)
    found.check("RepSim of the recorded set, greatest difference", distance, "SI", must="<= 0")
    name = "the set laid on a road against its file, Wasserstein of speed"
    found.check(name, wasserstein(_samples(frames), source), "m/s", must="<= 0.1")
    return found


def _recorded_changes(data: Trajectories) -> Findings:
    """Lane changes in a recorded set."""
    found = Findings()
    changes, driven = lane_change_rate(data)
    rate = changes / driven if driven > 0.0 else 0.0
    found.check("lane changes per vehicle and km, recorded", rate, "1/km")
    if changes == 0:
        found.notes.append("this set has no lane changes: its rate has no meaning")
    return found


def lane_changes(quick: bool, seed: int = 0) -> Findings:
    """Lane changes per vehicle and kilometer at the paper's densities with both models."""
    route, found = RoadMap.builtin().route(), Findings()
    for model in ("mobil", "lc2013"):
        for density in LEVELS[:1] if quick else LEVELS:
            config = TrafficConfig(
                density=density, lane_change=model, fill_ahead=6_000.0, fill_behind=0.0
            )
            log = FlowLog()
            with PureSim(route, config, seed) as traffic:
                frame = traffic.reset()
                for step in range(600 if quick else 1_800):
                    if step % 10 == 0:
                        log.add(traffic.time, frame)
                    frame = traffic.step()
            name = f"lane changes per vehicle and km, {density}, {model}"
            found.check(name, log.lane_change_rate, "1/km", PUBLISHED_RATE)
    return found


def _difference(ours: Iterable[VehicleFrame], theirs: Iterable[VehicleFrame]) -> float:
    """Greatest difference of any value; inf if the vehicles or their lanes differ."""
    greatest = 0.0
    for a, b in zip(ours, theirs, strict=True):
        if a.ids != b.ids or a.kinds != b.kinds or not np.array_equal(a.lanes, b.lanes):
            return float("inf")
        greatest = max(greatest, float(np.max(np.abs(a.values - b.values), initial=0.0)))
    return greatest


def _samples(frames: list[VehicleFrame]) -> FlowSamples:
    """Samples of frames, one each cycle."""
    log = FlowLog()
    for i, frame in enumerate(frames):
        log.add(CYCLE_PERIOD * i, frame)
    return log.samples
