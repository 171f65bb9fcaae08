"""A short recorded drive of a scripted truck through dense traffic."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from iits_mj.core.messages import VehicleCommand
from iits_mj.road import Route
from tests.traffic_bridge.scripted_truck import ego_at
from traffic_bridge import InterSim, Recorder, TrafficConfig, VehicleFrame

STEPS = 120


def config(lane_change: str = "lc2013") -> TrafficConfig:
    return TrafficConfig(density=0.2, fill_ahead=600.0, fill_behind=600.0, lane_change=lane_change)


def record(
    route: Route, path: Path, lane_change: str = "lc2013", steps: int = STEPS
) -> tuple[Path, list[VehicleFrame]]:
    """Drives 12 s and writes the file; returns its path and the frames."""
    with Recorder(InterSim(route, config(lane_change), seed=9)) as recorder:
        frames = [recorder.reset(ego_at(route, 0.0, 1000.0, 9.0, 4.0))]
        for k in range(1, steps + 1):
            recorder.note_command(0.1 * k, VehicleCommand(accelerator_pedal=0.5 / k))
            frames.append(recorder.step(ego_at(route, 0.1 * k, 1000.0 + 0.9 * k, 9.0, 4.0)))
        return recorder.save(path), frames


def changed(path: Path, target: Path, **meta: object) -> Path:
    """A copy of a file with changed entries in its meta data."""
    with np.load(path) as file:
        arrays = dict(file)
    stored = json.loads(str(arrays["meta"])) | meta
    np.savez(target, **{**arrays, "meta": np.array(json.dumps(stored))})
    return target
