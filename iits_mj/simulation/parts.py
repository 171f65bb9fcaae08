"""Makes the parts of a simulation from its configuration: map, traffic and stack."""

from __future__ import annotations

import dataclasses
from pathlib import Path

from controllers import decision
from controllers.planner import PlannerConfig
from controllers.stack import Stack
from iits_mj.errors import InputError
from iits_mj.messages import EgoFootprint
from iits_mj.parameters import TruckParameters
from iits_mj.road import RoadMap, Route
from iits_mj.simulation.config import DriveConfig
from traffic_bridge import (
    InterSim,
    MixedSim,
    PureSim,
    Recorder,
    RepSim,
    Traffic,
    TrafficConfig,
    read_events,
)


def load_map(path: Path | None) -> RoadMap:
    """The map of a file, or the built-in highway.

    Raises:
      MapError: the file cannot be used.
    """
    return RoadMap.builtin() if path is None else RoadMap.from_opendrive(path)


def make_traffic(
    config: DriveConfig, route: Route, footprint: EgoFootprint, *, record: bool = False
) -> Traffic | None:
    """The traffic on the route, None for an empty road.

    Raises:
      InputError: the recording or the events cannot be used, or there is no SUMO traffic to record
        or for the events.
    """
    if config.reactive and config.recording is None:
        raise InputError("reactive traffic is around a recording; name one, or leave it out")
    if config.reactive and config.traffic_mode != "inter":
        raise InputError("reactive traffic is SUMO's and sees the truck; use traffic-mode inter")
    replayed = config.recording is not None and not config.reactive
    without_sumo = replayed or config.traffic_mode == "none"
    if config.events is not None and without_sumo:
        raise InputError("events happen in SUMO traffic only; use traffic-mode inter or pure")
    if record and (without_sumo or config.recording is not None):
        raise InputError("only SUMO traffic can be recorded; use traffic-mode inter or pure")
    if config.recording is not None and without_sumo:
        return RepSim(route, config.recording)
    if without_sumo:
        return None
    settings = TrafficConfig(
        density=config.density,
        speed_limit=config.traffic_speed,
        lane_change=config.lane_change,
        scope=config.traffic_scope,
        footprint=footprint,
        events=() if config.events is None else read_events(config.events),
    )
    if config.recording is not None:
        return MixedSim(route, config.recording, settings, seed=config.seed)
    mode = InterSim if config.traffic_mode == "inter" else PureSim
    traffic = mode(route, settings, seed=config.seed)
    return Recorder(traffic) if record else traffic


def make_stack(config: DriveConfig, route: Route, parameters: TruckParameters) -> Stack:
    """The pipeline from scene to command, at the reference speed asked for."""
    planner = PlannerConfig()
    speed = dataclasses.replace(planner.speed, cruise_speed=config.speed)
    return Stack(
        route,
        decision.make(config.decision),
        planner=dataclasses.replace(planner, speed=speed),
        parameters=parameters,
    )
