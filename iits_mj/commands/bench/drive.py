"""Computing time of whole drives, as a ratio to the MuJoCo and SUMO calls in them."""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import libsumo
import mujoco
import numpy as np

from controllers import decision
from iits_mj.commands.bench.clocks import no_collection
from iits_mj.core.messages import EgoFootprint
from iits_mj.core.results import Findings
from iits_mj.core.timing import TIMESTEP
from iits_mj.evaluation.drives import full_chain
from iits_mj.evaluation.trials import Task
from iits_mj.road import Route
from iits_mj.simulation import DriveConfig, Simulation
from iits_mj.simulation.truck_world import FAST_TIMESTEP
from traffic_bridge import InterSim, Traffic, TrafficConfig

_MUJOCO_CALLS = ("mj_step", "mj_forward", "mj_fwdPosition")
# SUMO's functions by the domain that their names begin with.
_SUMO_DOMAINS = ("edge", "junction", "lane", "route", "simulation", "trafficlight", "vehicle")
# A dense drive with five to six vehicles in view.
_SEED = 2
_WARM_UP = 20  # cycles, before which caches and SUMO's net are filled
# Slow, dense traffic fills the view where the truck starts.
_CROWD_START = 3_300.0  # [m]
_CROWD_SPEED = 8.0  # [m/s] of traffic and truck
_CROWD_DENSITY = 0.5  # probability of a vehicle a second and lane
_CROWD_ROOM = 12.7  # [m] of view for each vehicle, ahead and behind together, on two lanes
_CROWD = 60  # vehicles


@dataclass(frozen=True, slots=True)
class DriveCost:
    """Processor time of a drive per simulated second [s].

    Attributes:
      whole: of everything; base: of the MuJoCo and SUMO calls in it.
      vehicles: mean number in view.
    """

    whole: float
    base: float
    vehicles: float

    @property
    def ratio(self) -> float:
        """Time of everything over the time of the MuJoCo and SUMO calls."""
        return self.whole / self.base


class _Stopwatch:
    """Adds up the processor time inside functions, without that of the clock."""

    def __init__(self) -> None:
        self.inside = 0.0
        # Between two readings of the clock.
        self.own = min(-time.thread_time() + time.thread_time() for _ in range(1000))

    def wrap(self, function: Callable[..., Any]) -> Callable[..., Any]:
        def timed(*arguments: Any, **named: Any) -> Any:
            start = time.thread_time()
            try:
                return function(*arguments, **named)
            finally:
                self.inside += time.thread_time() - start - self.own

        return timed


@contextlib.contextmanager
def _timed_calls(watch: _Stopwatch) -> Iterator[None]:
    """Times all calls of MuJoCo and SUMO that a drive makes."""
    sumo = libsumo.libsumo._libsumo
    names = [name for name in dir(sumo) if name.split("_")[0] in _SUMO_DOMAINS]
    functions = [(sumo, name) for name in names if type(getattr(sumo, name)) is type(len)]
    functions += [(mujoco, name) for name in _MUJOCO_CALLS]
    plain = [(module, name, getattr(module, name)) for module, name in functions]
    try:
        for module, name, function in plain:
            setattr(module, name, watch.wrap(function))
        yield
    finally:
        for module, name, function in plain:
            setattr(module, name, function)


def cost_of(simulation: Simulation, cycles: int, rounds: int) -> DriveCost:
    """Returns the least cost of the same stretch of a drive, driven twice in each round.

    The drive is repeated from its start. The time inside the calls is measured in every second
    repetition only, because the clocks themselves take time.

    Args:
      simulation: of the drive, which must not end within the stretch.
      cycles: length of the stretch, after a warm-up.
      rounds: number of repetitions.
    """
    whole = base = math.inf
    counts: list[int] = []
    for _ in range(rounds):
        for timed in (False, True):
            watch = _Stopwatch()
            with _timed_calls(watch) if timed else contextlib.nullcontext(), no_collection():
                # Traffic takes SUMO's functions when it starts.
                simulation.reset()
                for _ in range(_WARM_UP):
                    simulation.cycle()
                watch.inside = 0.0
                start = time.thread_time()
                for _ in range(cycles):
                    simulation.cycle()
                    counts.append(len(simulation.vehicles))
                taken = time.thread_time() - start
            if timed:
                base = min(base, watch.inside)
            else:
                whole = min(whole, taken)
    seconds = 0.1 * cycles
    return DriveCost(whole / seconds, base / seconds, float(np.mean(counts)))


def drive_with(timestep: float, *, crowd: int = 0) -> Simulation:
    """Returns a dense drive with five to six vehicles in view, or one in a crowd.

    Args:
      timestep: of the physics [s].
      crowd: about this number of vehicles is in view; 0: the dense drive.
    """
    if not crowd:
        config = DriveConfig(density="dense", duration=600.0, seed=_SEED)
        return Simulation(config, visuals=False, timestep=timestep)
    config = DriveConfig(
        start_station=_CROWD_START, start_speed=_CROWD_SPEED, duration=600.0, seed=_SEED
    )
    reach = 0.5 * crowd * _CROWD_ROOM

    def traffic(route: Route, footprint: EgoFootprint) -> Traffic:
        settings = TrafficConfig(
            density=_CROWD_DENSITY,
            speed_limit=_CROWD_SPEED,
            view_range=reach,
            fill_ahead=reach,
            fill_behind=reach,
            footprint=footprint,
        )
        return InterSim(route, settings, seed=_SEED)

    return Simulation(config, visuals=False, timestep=timestep, traffic=traffic)


def decision_trip() -> Simulation:
    """Returns a trip of `iits-mj evaluate` in the full chain, in dense traffic."""
    task = Task(
        world="full",
        density="dense",
        traffic_speed=12.5,
        method="lookahead",
        weights="",
        truck="",
        payload=36_000.0,
        timestep=FAST_TIMESTEP,
        length_limit=15_000.0,
        duration_limit=1_800.0,
        seed=_SEED,
    )
    return full_chain(task, decision.make(task.method))


def drives(quick: bool) -> Findings:
    """Returns the ratios of whole drives to the calls of MuJoCo and SUMO in them, on one core."""
    cycles, rounds = (40, 2) if quick else (300, 5)
    found = Findings()
    cases: list[tuple[str, Callable[[], Simulation], str]] = [
        ("whole drive, 2 ms", lambda: drive_with(TIMESTEP), "<= 1.5"),
        ("whole drive in a crowd, 2 ms", lambda: drive_with(TIMESTEP, crowd=_CROWD), "<= 1.6"),
        ("whole drive, 5 ms", lambda: drive_with(FAST_TIMESTEP), "<= 1.8"),
        ("decision trip of evaluate, 5 ms", decision_trip, "<= 1.8"),
    ]
    for name, make, must in cases:
        with make() as simulation:
            cost = cost_of(simulation, cycles, rounds)
        found.check(f"{name}: time over its MuJoCo and SUMO calls", cost.ratio, "1", must=must)
        found.check(f"{name}: vehicles in view", cost.vehicles, "1")
        found.check(f"{name}: real-time factor", 1.0 / cost.whole, "1", must=">= 1")
    return found
