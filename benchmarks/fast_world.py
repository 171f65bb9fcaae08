"""The compiled fast world beside its NumPy form: agreement, time of a trip, decisions per second.

    python benchmarks/fast_world.py --trips 200 > fast_world.md

Run it from the folder of the repository: the NumPy form is that of the tests. Both worlds drive
the same seeds in the same run by the same rule, in turns; times are processor times. A trip ends
with 15 km. The seeds are those of validation trips.
"""

from __future__ import annotations

import argparse
import statistics
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import iits_mj.envs  # noqa: F401
from controllers.decision import make
from controllers.decision.base import DecisionMaker
from controllers.decision.fast_world.env import HighwayEnv
from controllers.decision.fast_world.worlds import FastWorlds
from controllers.decision.policy import load_policy
from controllers.decision.rules import LookAhead, compiled
from controllers.decision.trip import CELLS, VALIDATION_SEEDS, TripConfig, cell_trip
from tests.controllers.decision import numpy_world

MODES: dict[str, dict[str, Any]] = {
    "two lanes": {},
    "keep right": {"keeps_right": True},
    "three lanes, limit of trucks": {"lanes": 3, "truck_speed_limit": 11.0},
    "ramps": {"ramp_probability": 0.1},
    "keep right, three lanes, ramps": {"keeps_right": True, "lanes": 3, "ramp_probability": 0.1},
}
RULES = ("aggressive", "mobil", "lookahead")


def timed(call: Callable[[], object]) -> float:
    """Processor time of a call [s]."""
    start = time.process_time()
    call()
    return time.process_time() - start


def agreement(trips: int) -> None:
    """Prints how far the two worlds are apart, for trips of all cells and modes."""
    print("| traffic | trips | decisions, all equal | apart after 25 s [m] | at the end [m] |")
    print("|---|---:|---:|---:|---:|")
    share = -(-trips // (len(MODES) * len(CELLS)))
    for mode, settings in MODES.items():
        decisions, apart, last = 0, 0.0, 0.0
        for number, cell in enumerate(CELLS * share):
            maker = make(RULES[number % len(RULES)])
            trip = replace(cell_trip(*cell), **settings)
            found = compare(maker, trip, VALIDATION_SEEDS + number)
            decisions += found[0]
            apart, last = max(apart, found[1]), max(last, found[2])
        print(f"| {mode} | {share * len(CELLS)} | {decisions} | {apart:.1e} | {last:.1e} |")


def compare(maker: DecisionMaker, trip: TripConfig, seed: int) -> tuple[int, float, float]:
    """Drives a trip in both; returns decisions, and the greatest distance after 25 s and later."""
    reference, world = numpy_world.HighwayEnv(), HighwayEnv()
    for one in (reference, world):
        one.reset(np.random.default_rng(seed), trip)
    decisions, early, over = 0, 0.0, False
    while not over:
        decision = maker.decide(reference.context())
        assert decision is maker.decide(world.context()), (trip, seed, decisions)
        step = reference.step(decision)
        world.step(decision)
        over = step.terminated or step.truncated
        decisions += 1
        order = np.argsort(reference.traffic.serial)
        traffic, ours = reference.traffic, np.argsort(world.traffic.serial)
        assert np.array_equal(traffic.serial[order], world.traffic.serial[ours])
        assert np.array_equal(traffic.lane[order], world.traffic.lane[ours])
        gap = float(np.abs(traffic.front[order] - world.traffic.front[ours]).max(initial=0.0))
        if reference.time < 36.0:  # the decision at 25 s may begin a change
            early = max(early, gap)
    return decisions, early, gap


def trip_times(rounds: int) -> None:
    """Prints the time of a dense trip by each rule."""
    print("\n| dense trip, 12.5 m/s | NumPy [ms] | compiled [ms] | ratio |\n|---|---:|---:|---:|")
    makers = {name: make(name) for name in ("keep", *RULES)}
    makers["lookahead, 30 s"] = LookAhead(horizon=30.0, change_cost=25.0)
    trip = cell_trip("dense", 12.5)
    worlds = numpy_world.HighwayEnv(), HighwayEnv()
    worlds[1].reset(np.random.default_rng(0), trip)  # reads the truck's parameters
    for name, maker in makers.items():
        times: list[list[float]] = [[], []]
        for seed in range(VALIDATION_SEEDS, VALIDATION_SEEDS + rounds):
            for world, spent in zip(worlds, times, strict=True):
                spent.append(timed(lambda w=world, s=seed, m=maker: drive(w, m, trip, s)))
        slow, fast = (1e3 * statistics.median(spent) for spent in times)
        print(f"| {name} | {slow:.0f} | {fast:.1f} | {slow / fast:.0f} |")


def drive(world: Any, maker: DecisionMaker, trip: TripConfig, seed: int) -> None:
    """Drives a trip, in the compiled world without Python."""
    world.reset(np.random.default_rng(seed), trip)
    if isinstance(world, HighwayEnv):
        world.drive(maker)
        return
    over = False
    while not over:
        step = world.step(maker.decide(world.context()))
        over = step.terminated or step.truncated


def rates(count: int) -> None:
    """Prints decisions per second of one core, and the cost of a copy."""
    print(f"\n| one core, {count} worlds, dense, 12.5 m/s | per second |\n|---|---:|")
    policy, rule = load_policy().network, compiled(make("mobil"))
    assert rule is not None
    steps = 150

    def report(name: str, call: Callable[[FastWorlds], object]) -> None:
        worlds = FastWorlds(count)
        for index in range(count):
            trip = cell_trip("dense", 12.5)
            worlds.reset(index, np.random.default_rng(VALIDATION_SEEDS + index), trip)
        worlds.drive(rule, 30.0)
        before = int(worlds.states["decisions"].sum())
        spent = timed(lambda: [call(worlds) for _ in range(steps)])
        print(f"| {name} | {(worlds.states['decisions'].sum() - before) / spent:,.0f} |")

    keep = np.zeros(count, dtype=int)
    report("decisions, steps and observations", lambda w: (w.step(keep), w.observations))
    report("decisions by MOBIL", lambda w: (w.step(w.decide(rule)), w.observations))
    report(
        "decisions by the shipped network in NumPy",
        lambda w: w.step(policy.values(w.observations).argmax(axis=1) - 1),
    )
    settings = {"density": "dense", "traffic_speed": 12.5}
    environments = gymnasium.make_vec("iits_mj/HighwayFast-v0", num_envs=count, **settings)
    environments.reset(seed=0)
    actions = np.ones(count, dtype=int)
    spent = timed(lambda: [environments.step(actions) for _ in range(steps)])
    print(f"| `gymnasium.make_vec`, `HighwayFast-v0` | {steps * count / spent:,.0f} |")
    worlds = FastWorlds(1)
    worlds.reset(0, np.random.default_rng(0), cell_trip("dense", 12.5))
    places = np.zeros(1000, dtype=int)
    spent = timed(lambda: [worlds.copy(places) for _ in range(50)])
    print(f"| copies of a world | {50_000 / spent:,.0f} |")


def main() -> None:
    """Prints the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--trips", type=int, default=30, help="for the agreement")
    parser.add_argument("--rounds", type=int, default=5, help="dense trips of each rule")
    parser.add_argument("--worlds", type=int, default=256)
    options = parser.parse_args()
    agreement(options.trips)
    trip_times(options.rounds)
    rates(options.worlds)


if __name__ == "__main__":
    main()
