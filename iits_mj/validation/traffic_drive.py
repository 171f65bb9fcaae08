"""Runs PureSim under recorded conditions, lane by lane."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from iits_mj.road import Route
from iits_mj.validation.traffic_conditions import (
    CLOSE,
    TYPE,
    WARM_UP,
    Conditions,
    Drivers,
)
from iits_mj.validation.traffic_flow import FlowLog, FlowSamples
from traffic_bridge.config import TrafficConfig
from traffic_bridge.modes.sumo_modes import PureSim
from traffic_bridge.vehicles.types import VehicleType, default_types

RUN_OUT = 100.0  # [m] beyond the stretch
SAMPLE_PERIOD = 0.5  # [s] between samples of the simulated flow
SPEED_CAP = 40.0  # [m/s]: limit of the simulated road, above every desired speed
RESOLUTION = 0.05  # [m/s] of the speeds that are told
# Who drives at a recorded speed keeps close, so that the others' distances do not slow it down.
DRIVEN = {"time_headway": CLOSE, "acceleration": 2.0}
LANE_WIDTH = 3.66  # [m]


def entering_type(length: float) -> VehicleType:
    """Of a vehicle until it is on the road, where it gets a driver."""
    return dataclasses.replace(
        default_types()[0],
        length=length,
        minimum_gap=0.5,
        time_headway=CLOSE,
        acceleration=1.5,
        deceleration=2.0,
    )


def drive(
    conditions: Conditions, drivers: Drivers, window: tuple[float, float], seed: int = 0
) -> FlowSamples:
    """Runs PureSim under recorded conditions, lane by lane.

    Args:
      conditions: see the module.
      drivers: who drives.
      window: beginning and end of what is simulated, in the recording's time [s].
      seed: of the traffic and of the drivers.

    Returns:
      The simulated flow at the recording's times, lanes and stations.
    """
    rng = np.random.default_rng(seed)
    parts = [
        _drive_lane(conditions, drivers, window, lane, rng) for lane in range(conditions.lanes)
    ]
    return FlowSamples.joined(parts)


def _drive_lane(
    conditions: Conditions,
    drivers: Drivers,
    window: tuple[float, float],
    lane: int,
    rng: np.random.Generator,
) -> FlowSamples:
    begin, end = window
    total = WARM_UP + end - begin
    before = conditions.lead_in(lane, begin, end)
    route = Route.straight(
        before + conditions.length + RUN_OUT, 1, lane_width=LANE_WIDTH, speed_limit=SPEED_CAP
    )
    departures, found = conditions.column(lane, begin, end, drivers, rng)
    config = TrafficConfig(
        density="empty",
        speed_limit=SPEED_CAP,
        lane_change_duration=0.0,
        types=(entering_type(conditions.vehicle_length),),
        mix=((TYPE, 1.0),),
        departures=departures,
    )
    log = FlowLog()
    told: dict[str, float] = {}
    with PureSim(route, config) as traffic:
        frame = traffic.reset()
        stride = round(SAMPLE_PERIOD / config.step_length)
        for step in range(round(total / config.step_length) + 1):
            if step % stride == 0:
                time = traffic.time - WARM_UP + begin
                speed = conditions.speed_at(lane, time)
                station = frame.column("station") + 0.5 * frame.column("length") - before
                free = station < conditions.head_at(lane, time)
                for i, name in enumerate(frame.ids):
                    if free[i]:
                        if told.get(name) != math.inf:
                            told[name] = math.inf
                            # Vehicles of the list are named by their place in it.
                            driver = found[int(name.rpartition(".d")[2])]
                            traffic.vehicles.change(name, **dataclasses.asdict(driver))
                    elif abs(told.get(name, math.inf) - speed) > RESOLUTION:
                        told[name] = speed
                        traffic.vehicles.change(name, desired_speed=speed, **DRIVEN)
                if time >= begin:
                    log.add(time, frame, before)
            frame = traffic.step()
    samples = log.samples
    return dataclasses.replace(
        samples,
        station=samples.station - before,
        lane=np.full(len(samples), lane, dtype=np.int64),
    )
