"""The whole drive beside highway-env, a traffic simulator for decisions, in the same run.

    pip install highway-env==1.12.1
    python benchmarks/peers.py > peers.md

Both simulate one ego and 20 or 60 vehicles near it on one core. highway-env moves points with a
bicycle model 15 times a second and makes no physics, no SUMO and no J1939 messages; a drive of
`iits_mj` makes 500 physics steps of the articulated truck, 50 commands and 10 plans a second, or
200 steps at 5 ms. `HighwayFast-v0` is the environment of like detail. The table gives simulated
time per processor time: the median and the range of rounds that alternate.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Callable
from functools import partial
from typing import Any

import gymnasium
import highway_env  # noqa: F401

import iits_mj.envs  # noqa: F401
from iits_mj.commands.bench.drive import drive_with

SECONDS = 20.0  # of simulated time


def rate(environment: gymnasium.Env[Any, Any], action: int) -> float:
    """Simulated time per processor time of an environment with one decision a second."""
    environment.reset(seed=1)
    start = time.process_time()
    for _ in range(round(SECONDS)):
        if environment.step(action)[2]:
            environment.reset(seed=1)
    return SECONDS / (time.process_time() - start)


def peer(vehicles: int) -> float:
    config = {
        "vehicles_count": vehicles,
        "lanes_count": 3,
        "duration": 1000,
        "simulation_frequency": 15,
        "policy_frequency": 1,
    }
    with gymnasium.make("highway-v0", config=config) as environment:
        idle = environment.unwrapped.action_type.actions_indexes["IDLE"]
        return rate(environment, idle)


def fast() -> float:
    with gymnasium.make("iits_mj/HighwayFast-v0", density="dense", duration=1000.0) as environment:
        return rate(environment, 1)


def drive(timestep: float, vehicles: int) -> float:
    with drive_with(timestep, crowd=vehicles) as simulation:
        start = time.process_time()
        for _ in range(round(10 * SECONDS)):
            simulation.cycle()
        return SECONDS / (time.process_time() - start)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=5)
    rounds = parser.parse_args().rounds
    players: dict[str, Callable[[], float]] = {"HighwayFast-v0, dense": fast}
    for count in (20, 60):
        players[f"highway-env, {count} vehicles"] = partial(peer, count)
        for step in (0.002, 0.005):
            players[f"whole drive, {count} vehicles, {1e3 * step:g} ms"] = partial(
                drive, step, count
            )
    found = [[play() for play in players.values()] for _ in range(rounds)]
    print("| | simulated seconds per processor second | range |\n|---|---:|---:|")
    for name, values in zip(players, zip(*found, strict=True), strict=True):
        print(
            f"| {name} | {statistics.median(values):.1f} | {min(values):.1f} to {max(values):.1f} |"
        )


if __name__ == "__main__":
    main()
