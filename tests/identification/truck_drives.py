"""Drives of a truck with hidden parameters over long gentle hills."""

from __future__ import annotations

import numpy as np

from iits_mj.core.messages import VehicleCommand, XbrMode
from iits_mj.identification.replay import graded_road
from iits_mj.truck import Truck


def hill_drive(seed=0):
    """Pedal and brake in turn, in steps at irregular times: accelerate, cruise, coast, brake."""
    rng = np.random.default_rng(seed)
    plan = []
    start = 0.0
    while start < 2000.0:
        accelerate, ease, coast = rng.uniform(8, 18), rng.uniform(0, 6), rng.uniform(3, 9)
        if len(plan) % 5 == 2:  # air drag shows at high speed
            accelerate, coast = rng.uniform(40, 50), rng.uniform(18, 25)
        brake, rest = rng.uniform(1.7, 3.5), rng.uniform(2, 3)
        demand, pedal = -rng.uniform(0.8, 2.2), rng.uniform(0.5, 0.8)
        plan.append((start, accelerate, ease, coast, brake, demand, pedal))
        start += accelerate + ease + coast + brake + rest
    starts = np.array([phase[0] for phase in plan])

    def command(time, state):
        begin, accelerate, ease, coast, brake, demand, pedal = plan[
            int(np.searchsorted(starts, time, side="right")) - 1
        ]
        since = time - begin
        given = 0.0
        if since < accelerate + ease:
            given = 1.0 if since < accelerate else pedal
        since -= accelerate + ease + coast
        braking = 0.0 <= since < brake and state.speed > 9.0
        return VehicleCommand(
            accelerator_pedal=given if state.speed < 25.0 else 0.0,
            xbr_demand=demand if braking else 0.0,
            xbr_mode=XbrMode.MAXIMUM if braking else XbrMode.OFF,
        )

    return command


def hills():
    """Station [m] and grade [1] of a road over long gentle hills, and the road itself."""
    station = np.arange(0.0, 9000.0, 12.5)
    grade = 0.016 * np.sin(station / 210.0) + 0.008 * np.sin(station / 77.0)
    return station, grade, graded_road(station, grade, 9000.0)


def hidden_truck(payload, overlay, route, *, station=50.0, speed=10.0):
    truck = Truck.load(payload, parameters=overlay, route=route, visuals=False, timestep=0.005)
    truck.reset(station=station, speed=speed)
    return truck
