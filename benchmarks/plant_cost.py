"""Cost of a step of each plant, and its ratio to `mujoco.mj_step`, in one run.

    python benchmarks/plant_cost.py --rounds 20

The plants take turns, each round from the same state on the built-in highway, so that the load of
the machine affects all alike. The time is processor time; the least of all rounds counts.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable

import mujoco

from iits_mj.core.timing import PLANTS
from iits_mj.road import RoadMap
from iits_mj.truck import Truck
from iits_mj.truck.placement import TruckPlacement
from iits_mj.truck.rollouts import Scenario, roll_out

TIMESTEP = 0.005
STEPS = 2000
DRIVES, DURATION = 32, 20.0


def stepper(truck: Truck) -> Callable[[], None]:
    """Returns a function that makes `STEPS` steps from the same state."""

    def play() -> None:
        if truck.planar is None:
            mujoco.mj_step(truck.model, truck.data, STEPS)
        else:
            truck.planar.step(truck.model, (truck.data,), STEPS)

    return play


def least(rounds: int) -> dict[str, float]:
    """Least processor time of a step of each plant [s]."""
    route = RoadMap.builtin().route()
    trucks = [Truck.load(route=route, timestep=TIMESTEP, plant=p, visuals=False) for p in PLANTS]
    for truck in trucks:
        # Only the last step of a call computes the sensors of a planar plant.
        truck.model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_SENSOR)
    found = dict.fromkeys(PLANTS, float("inf"))
    for _ in range(rounds):
        for truck in trucks:
            truck.reset(station=60.0, speed=20.0)
            truck.command(accelerator_pedal=0.5)
            began = time.process_time()
            stepper(truck)()
            found[truck.plant] = min(found[truck.plant], (time.process_time() - began) / STEPS)
    return found


def batch(plant: str, threads: int) -> float:
    """Simulated time over wall time of roll-outs that record every 0.1 s."""
    route = RoadMap.builtin().route()
    scenarios = [
        Scenario(route=route, place=TruckPlacement(station=100.0 + 20.0 * k, speed=15.0))
        for k in range(DRIVES)
    ]
    controls = {"accelerator_pedal": 0.5}
    settings = {"threads": threads, "timestep": TIMESTEP, "plant": plant}
    roll_out(scenarios[:1], controls, duration=0.1, **settings)
    began = time.perf_counter()
    roll_out(scenarios, controls, duration=DURATION, **settings)
    return DRIVES * DURATION / (time.perf_counter() - began)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=20)
    parser.add_argument("--threads", type=int, default=2)
    arguments = parser.parse_args()
    costs = least(arguments.rounds)
    print("| plant | us a step of 5 ms | steps/s | x real time | mj_step / plant | roll-outs x |")
    print("|---|---|---|---|---|---|")
    for plant, cost in costs.items():
        factor = batch(plant, arguments.threads)
        print(
            f"| {plant} | {1e6 * cost:.2f} | {1 / cost:,.0f} | {TIMESTEP / cost:,.0f} "
            f"| {costs['full'] / cost:.1f} | {factor:,.0f} |"
        )


if __name__ == "__main__":
    main()
