"""RepSim against its source, and the lane changes of simulated traffic at the paper's densities."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np

from iits_mj.core.results import Check
from iits_mj.road import RoadMap, Route
from iits_mj.validation.traffic.flow import LEVELS, FlowLog, FlowSamples, wasserstein
from traffic_bridge.config import TrafficConfig
from traffic_bridge.datasets import ImportConfig, Trajectories, import_trajectories
from traffic_bridge.frame import VehicleFrame
from traffic_bridge.modes.repsim import RepSim
from traffic_bridge.modes.sumo_modes import PureSim
from traffic_bridge.recording.recorder import Recorder

# Knoop, Hoogendoorn, Shiomi and Buisson, "Quantifying the number of lane changes in traffic:
# empirical analysis", Transportation Research Record 2278 (2012): about one change in 2 km on two
# plain freeway sites.
PUBLISHED_RATE = 0.5  # [1/km] a vehicle
LEAD_IN = 100.0  # [m] of road before a laid data set


def own_recording(duration: float = 30.0) -> list[Check]:
    """Records PureSim and replays it: the greatest difference of any figure of any vehicle."""
    route = Route.straight(3000.0, lanes=3, speed_limit=20.0)
    config = TrafficConfig(density="dense", lane_change="mobil", fill_ahead=3000.0)
    seen: list[VehicleFrame] = []
    with Recorder(PureSim(route, config, seed=0)) as recorder:
        seen.append(recorder.reset())
        while recorder.time < duration - 1e-9:
            seen.append(recorder.step())
        with tempfile.TemporaryDirectory(prefix="iits_mj_replay_") as folder:
            path = recorder.save(Path(folder) / "recording.npz")
            with RepSim(route, path) as replay:
                found = [replay.reset()]
                found += [replay.step() for _ in seen[1:]]
    distance = max(_difference(a, b) for a, b in zip(seen, found, strict=True))
    ours, theirs = _samples(seen), _samples(found)
    return [
        Check("RepSim of a recorded PureSim, greatest difference", distance, "SI", None, "<= 0"),
        Check(
            "RepSim of a recorded PureSim, Wasserstein of speed",
            wasserstein(ours, theirs),
            "m/s",
            None,
            "<= 0",
        ),
    ]


def laid(data: Trajectories) -> list[Check]:
    """Lays a recorded set on a road and replays it."""
    length = float(data.station.max()) + 2.0 * LEAD_IN
    route = Route.straight(length, lanes=data.lane_count, lane_width=data.lane_width)
    recording = import_trajectories(data, route, ImportConfig(start_station=LEAD_IN))
    with RepSim(route, recording) as replay:
        frames = [replay.reset()]
        frames += [replay.step() for _ in recording.time[1:]]
    distance = max(_difference(a, b) for a, b in zip(recording.frames, frames, strict=True))
    found = _samples(frames)
    source = FlowSamples(
        data.time,
        data.lane,
        data.station,
        data.speed,
        np.full(len(data), np.nan),
        np.ones(len(data)),
    )
    return [
        Check("RepSim of the recorded set, greatest difference", distance, "SI", None, "<= 0"),
        Check(
            "the set laid on a road against its file, Wasserstein of speed",
            wasserstein(found, source),
            "m/s",
            None,
            "<= 0.1",
        ),
    ]


def lane_changes(quick: bool, seed: int = 0) -> list[Check]:
    """Lane changes per vehicle and kilometer at the paper's densities, both models."""
    route = RoadMap.builtin().route()
    checks = []
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
            checks.append(Check(name, log.lane_change_rate, "1/km", PUBLISHED_RATE))
    return checks


def _difference(a: VehicleFrame, b: VehicleFrame) -> float:
    if a.ids != b.ids or a.kinds != b.kinds or not np.array_equal(a.lanes, b.lanes):
        return float("inf")
    return float(np.max(np.abs(a.values - b.values), initial=0.0))


def _samples(frames: list[VehicleFrame]) -> FlowSamples:
    log = FlowLog()
    for i, frame in enumerate(frames):
        log.add(0.1 * i, frame)
    return log.samples
