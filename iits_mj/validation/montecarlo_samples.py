"""One truck out of many that our figures allow: drawn, driven, measured."""

from __future__ import annotations

import functools
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from iits_mj import spread as spreads
from iits_mj.spread import Drawn, Spread
from iits_mj.truck import Truck
from iits_mj.units import DIESEL_DENSITY, KMH
from iits_mj.validation import full_stop, rollover, single_lane_change
from iits_mj.validation.brake_measures import distance, fully_developed
from iits_mj.validation.kept_runs import drive_digest
from iits_mj.validation.metrics import fit
from iits_mj.validation.recorder import run_straight

# Speed of the lane change and of the fuel figure [m/s].
SPEED = 80.0 * KMH
_FUEL_TIME = 20.0  # [s]
NOMINAL = -1


@dataclass(frozen=True)
class SampleTask:
    """A truck that is to be measured.

    Attributes:
      seed: decides the truck; `NOMINAL` is the one of the shipped figures.
      payload: [kg].
      timestep: of the physics [s].
      spread: digest of what is drawn from.
    """

    seed: int
    payload: float
    timestep: float
    spread: str


@dataclass(frozen=True)
class Sample(SampleTask):
    """Figures of one truck.

    Attributes:
      rollover_threshold: static, on a tilt table [g].
      rearward_amplification: single sine of 0.4 Hz at 80 km/h [1].
      yaw_fit: of the yaw-sideslip model with the same figures to the tractor's yaw rate there [%].
      stop_distance: full stop from 60 km/h [m]; deceleration: mean fully developed [m/s2].
      fuel: at a steady 80 km/h on a level road [l/100 km].
      wall_time: [s]; code: digest of what drove it.
    """

    rollover_threshold: float
    rearward_amplification: float
    yaw_fit: float
    stop_distance: float
    deceleration: float
    fuel: float
    wall_time: float
    code: str

    @property
    def task(self) -> SampleTask:
        """What was measured."""
        return SampleTask(self.seed, self.payload, self.timestep, self.spread)


@functools.cache
def sample_code() -> str:
    """Digest of the code that drives samples."""
    return drive_digest(full_stop, rollover, single_lane_change, spreads, sys.modules[__name__])


def drawn_truck(spread: Spread, seed: int) -> Drawn:
    """The truck of a seed."""
    return spread.nominal() if seed == NOMINAL else spread.draw(np.random.default_rng(seed))


def measure(task: SampleTask, spread_file: Path | None = None) -> Sample:
    """Drives one truck through all manoeuvres.

    Args:
      task: which truck.
      spread_file: what it is drawn from; default: the shipped spread.

    Raises:
      InputError: the truck cannot be built, or holds no 80 km/h.
      Error: the physics diverged.
    """
    began = time.perf_counter()
    drawn = drawn_truck(Spread.load(spread_file), task.seed)
    payload, timestep, overlay = task.payload, task.timestep, drawn.overlay
    tilt = rollover.tilt_table(payload, timestep, parameters=overlay)
    sine = single_lane_change.sine_steer(payload, SPEED, timestep, parameters=overlay)
    stop = full_stop.stop_run(payload, full_stop.UN_R13.speed, timestep, parameters=overlay)
    return Sample(
        **vars(task),
        rollover_threshold=tilt.threshold,
        rearward_amplification=sine.truck(),
        yaw_fit=fit(sine.recording.yaw_rate, sine.model.yaw_rate),
        stop_distance=distance(stop),
        deceleration=fully_developed(stop),
        fuel=_steady_fuel(payload, timestep, drawn),
        wall_time=round(time.perf_counter() - began, 3),
        code=sample_code(),
    )


def _steady_fuel(payload: float, timestep: float, drawn: Drawn) -> float:
    """Fuel at a steady speed on a level road [l/100 km]."""
    truck = Truck.load(payload, parameters=drawn.overlay, timestep=timestep, visuals=False)
    truck.reset(speed=SPEED)
    hold = run_straight(truck, SPEED)
    before = truck.observe()
    for _ in range(round(_FUEL_TIME / 0.01)):
        truck.command(hold.command(SPEED - truck.observe().speed, 0.0))
        truck.step(round(0.01 / timestep))
    after = truck.observe()
    way = after.x - before.x
    return (after.fuel_used - before.fuel_used) / DIESEL_DENSITY / way * 1e5
