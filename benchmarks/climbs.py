"""Climbs at full pedal with both shift strategies: speed, rolling back, gear changes, fuel, time.

    python benchmarks/climbs.py                       # 98 ramps of the 6x4, with each strategy
    python benchmarks/climbs.py --plant full --grades 12,15 --loads 55
    python benchmarks/climbs.py --walking             # from walking pace on the grade itself

The truck drives on 2 % and floors the pedal 60 m before a ramp of 30 m to the grade. `held` is the
mean speed of the last 10 s; the balance is that of forces in the best gear. `lowest` is the lowest
speed, negative if the truck rolls back. Fuel and time are those of the way up to the shorter of the
two strategies' ways.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass

import numpy as np

from iits_mj.core.arrays import FloatArray
from iits_mj.core.timing import PLANTS
from iits_mj.core.units import KMH
from iits_mj.parameters import TruckParameters
from iits_mj.road import Route
from iits_mj.truck import Truck
from iits_mj.validation.longitudinal.force_balance import ForceBalance
from iits_mj.validation.longitudinal.hills import sloping

STRATEGIES = ("tables", "adaptive")
GRADES = (6.0, 8.0, 10.0, 12.0, 15.0, 18.0, 22.0)  # [%]
SPEEDS = (5.0, 20.0, 30.0, 40.0, 50.0, 60.0, 80.0)  # [km/h]
LOADS = (40.0, 55.0)  # gross [t]
GENTLE, RUN_UP, RAMP = 0.02, 60.0, 30.0
STATION, PERIOD, TIMESTEP = 100.0, 0.1, 0.005
ROLLED_AWAY = 20.0  # [m]
HUNTING = 5.0  # [s]
SETTLED = 10.0  # [s]


@dataclass(frozen=True)
class Climb:
    """One climb.

    Attributes:
      time, way, speed, gear, fuel: [s], [m], [m/s], 1, [kg]; shape (n,).
    """

    time: FloatArray
    way: FloatArray
    speed: FloatArray
    gear: FloatArray
    fuel: FloatArray

    @property
    def held(self) -> float:
        """Mean speed at the end [m/s]."""
        return float(self.speed[-round(SETTLED / PERIOD) :].mean())

    @property
    def changes(self) -> list[tuple[float, int, int]]:
        """Time [s], gear before, gear after."""
        at = np.flatnonzero(np.diff(self.gear))
        return [(float(self.time[i]), int(self.gear[i]), int(self.gear[i + 1])) for i in at]

    @property
    def reversals(self) -> int:
        """Changes in the opposite direction of the last one within `HUNTING`."""
        pairs = zip(self.changes, self.changes[1:], strict=False)
        return sum((a[2] - a[1]) * (b[2] - b[1]) < 0 and b[0] - a[0] < HUNTING for a, b in pairs)

    def at(self, way: float) -> tuple[float, float]:
        """Time [s] and fuel [kg] at a way [m]."""
        ahead = np.maximum.accumulate(self.way)
        return float(np.interp(way, ahead, self.time)), float(np.interp(way, ahead, self.fuel))


def road(grade: float, seconds: float, *, ramp: bool) -> Route:
    """The road: the grade throughout, or a ramp to it."""
    length = STATION + RUN_UP + 30.0 * seconds
    if not ramp:
        return Route.straight(length=length, grade=grade)
    return sloping(length, GENTLE, ((STATION + RUN_UP + 0.5 * RAMP, grade, RAMP),))


def climb(
    parameters: TruckParameters,
    payload: float,
    route: Route,
    speed: float,
    seconds: float,
    plant: str,
) -> Climb:
    """Drives at full pedal."""
    truck = Truck.load(
        payload, parameters=parameters, route=route, timestep=TIMESTEP, plant=plant, visuals=False
    )
    state = truck.reset(station=STATION, speed=speed)
    truck.command(accelerator_pedal=1.0)
    rows = []
    while state.time < seconds and state.station > STATION - ROLLED_AWAY:
        truck.step(round(PERIOD / TIMESTEP))
        state = truck.observe()
        way = state.station - STATION
        rows.append((state.time, way, state.speed, float(state.gear), state.fuel_used))
    return Climb(*np.array(rows).T)


def numbers(text: str) -> tuple[float, ...]:
    """Numbers between commas."""
    return tuple(float(part) for part in text.split(","))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--truck", help="name or file; default: the 6x4")
    parser.add_argument("--plant", default="yaw-sideslip", choices=PLANTS)
    parser.add_argument("--grades", type=numbers, default=GRADES, help="[%%], with commas")
    parser.add_argument("--speeds", type=numbers, default=SPEEDS, help="at the start [km/h]")
    parser.add_argument("--loads", type=numbers, default=LOADS, help="gross mass [t]")
    parser.add_argument("--seconds", type=float, default=120.0, help="of a climb")
    parser.add_argument("--walking", action="store_true", help="at 5 km/h on the grade itself")
    parser.add_argument("--strategies", nargs="+", default=STRATEGIES, choices=STRATEGIES)
    parser.add_argument("--changes", action="store_true", help="prints the gear changes")
    arguments = parser.parse_args()
    speeds = (5.0,) if arguments.walking else arguments.speeds
    trucks = {
        name: TruckParameters.load(arguments.truck, {"gearbox": {"shift_strategy": name}})
        for name in arguments.strategies
    }
    print(
        "load grade from balance | held, lowest [km/h], changes, reversals of each | fuel, time [%]"
    )
    for load in arguments.loads:
        for grade in arguments.grades:
            parameters = trucks[arguments.strategies[0]]
            payload = 1e3 * load - parameters.gross_mass(0.0)
            best = ForceBalance(parameters, payload).best_speed(0.01 * grade)
            route = road(0.01 * grade, arguments.seconds, ramp=not arguments.walking)
            for speed in speeds:
                runs = [
                    climb(p, payload, route, speed * KMH, arguments.seconds, arguments.plant)
                    for p in trucks.values()
                ]
                cells = [
                    f"{run.held / KMH:5.1f} {run.speed.min() / KMH:6.1f} {len(run.changes):2d}"
                    f" {run.reversals}"
                    for run in runs
                ]
                compared = ""
                if len(runs) == 2:
                    way = min(run.way.max() for run in runs)
                    (t0, f0), (t1, f1) = (run.at(way) for run in runs)
                    compared = f"{100 * (f1 / f0 - 1):+5.1f} {100 * (t1 / t0 - 1):+5.1f}"
                print(
                    f"{load:3g} {grade:3g} {speed:3g} {best / KMH:5.1f} | "
                    + " | ".join([*cells, compared]),
                    flush=True,
                )
                if arguments.changes:
                    for run in runs:
                        print(
                            "      ",
                            " ".join(
                                f"{t:.1f}s@{np.interp(t, run.time, run.speed) / KMH:.0f}:{a}>{b}"
                                for t, a, b in run.changes
                            ),
                        )


if __name__ == "__main__":
    main()
