"""Drives of a truck with hidden parameters, and the frames of its bus."""

from __future__ import annotations

import dataclasses

import numpy as np

from iits_mj.core.messages import VehicleCommand, XbrMode
from iits_mj.core.timing import CONTROL_PERIOD
from iits_mj.identification.replay import graded_road
from iits_mj.j1939 import command_to_frames, encode, make_group, pgn_of
from iits_mj.j1939.mapping import reports
from iits_mj.j1939.quantities import ReferenceTorques, quantities
from iits_mj.truck import Truck


def drive(truck, command, duration):
    """Rows (state, report, command) of each control period for a `command(time, state)`."""
    steps = round(CONTROL_PERIOD / truck.model.opt.timestep)
    rows = []
    for tick in range(round(duration / CONTROL_PERIOD)):
        state = truck.observe()
        given = command(tick * CONTROL_PERIOD, state)
        truck.command(given)
        rows.append((state, truck.report(), given))
        truck.step(steps)
    return rows


# Messages for the identification of a drive along a road and of a steered drive: periods [s].
LONGITUDINAL = {"EEC1": 0.02, "EEC3": 0.25, "ETC1": 0.02, "ETC2": 0.1, "EBC3": 0.1}
LONGITUDINAL |= {"IITS_MOTION": 0.02, "IITS_TRAILER": 0.1, "IITS_ROUTE": 0.1}
LATERAL = {"VDC2": 0.02, "IITS_TRAILER": 0.02, "IITS_MOTION": 0.02}


def frames(rows, parameters, messages, *, noise=0.01, seed=0, commands=True):
    """Frames of a drive: speeds with white noise, other signals with the resolution of the bus.

    Args:
      rows: of `drive`.
      parameters: with the reference torque.
      messages: names of the truck's messages and their periods [s]; commands come every 20 ms.
      noise: standard deviation of the speeds' noise, share of the speed.
      seed: of the noise.
      commands: sends the pedal and the brake demand as well.
    """
    known_quantities = quantities()
    heard = {pgn_of("EEC2"), pgn_of("XBR")}
    references = ReferenceTorques.of(parameters)
    rng = np.random.default_rng(seed)
    signals = {name: [row for row in reports() if row.message == name] for name in messages}
    found = []
    for tick, (state, report, command) in enumerate(rows):
        if commands:
            found += [f for f in command_to_frames(command, tick, state.time) if f.pgn in heard]
        factor = 1.0 + noise * rng.standard_normal()
        noisy = dataclasses.replace(state, speed=state.speed * factor)
        values = {name: q(noisy, report, references) for name, q in known_quantities.items()}
        for name, period in messages.items():
            if tick % round(period / CONTROL_PERIOD) == 0:
                known = {
                    r.signal: values[r.quantity] / r.scale
                    for r in signals[name]
                    if values[r.quantity] is not None
                }
                found.append(encode(make_group(name, known), time=state.time, saturate=True))
    return found


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
