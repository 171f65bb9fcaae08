"""Measure computing times: physics, threads, J1939 frames, traffic, whole drives, environments.

Times depend on the machine; most bounds apply to ratios, which hardly do. Each figure is the best
of several rounds, because other work on the machine can only make a round slower.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from iits_mj.commands.bench import drive, environments, film, interface, physics, traffic
from iits_mj.commands.output import ResultOptions, finish
from iits_mj.core import options as option_fields
from iits_mj.core.options import option
from iits_mj.core.progress import each
from iits_mj.core.results import Findings, Results
from iits_mj.parameters import AnyTruck, check_truck, payload_option, truck_option

# Time of the parts [s], for the time left.
_SECONDS = {
    "physics": 6.0,
    "interface": 1.0,
    "traffic": 2.0,
    "drives": 20.0,
    "film": 40.0,
    "environments": 3.0,
    "import": 15.0,
}


@dataclass(frozen=True, kw_only=True)
class Options(ResultOptions):
    """Flags of `iits-mj bench`."""

    truck: AnyTruck | None = truck_option("truck of the physics and the bus")
    payload: float | None = payload_option()
    threads: int = option(2, help="number of threads of the rollout", low=1, high=256, group="run")
    traffic: bool = option(True, help="measure SUMO traffic and whole drives, too", group="run")
    film: bool = option(True, help="measure the film of a drive, too; needs OpenGL", group="run")
    seed: int = option(0, help="seed of the traffic", low=0, high=2**31 - 1, group="run")
    quick: bool = option(False, help="fewer rounds, within a minute", group="run")

    def __post_init__(self) -> None:
        option_fields.check(self)
        check_truck(self)


def run(options: Options) -> int:
    """Measures and prints; returns the exit code."""
    return finish(options, lambda: measure(options))


def measure(options: Options) -> Results:
    """Returns all figures."""
    results = Results("bench", options.seed)
    rounds = 3 if options.quick else 10
    truck = physics.highway_truck(options.payload, options.truck)
    parts: dict[str, Callable[[], Findings]] = {
        "physics": lambda: physics.physics(truck, options.threads, rounds),
        "interface": lambda: interface.interface(2 * rounds, options.truck),
    }
    if options.traffic:
        parts["traffic"] = lambda: traffic.traffic(2 * rounds)
        parts["drives"] = lambda: drive.drives(options.quick)
    if options.film:
        parts["film"] = lambda: film.film(rounds)
    parts["environments"] = lambda: environments.environments(2 * rounds)
    parts["import"] = lambda: environments.import_time(rounds)
    for name in each(parts, "measuring", str, _SECONDS.__getitem__):
        results.add("", parts[name]())
    return results
