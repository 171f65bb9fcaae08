"""`iits-mj validate alks`: the whole stack in automated lane keeping, by UN R157.

Decision (keeps its lane), planner, speed controller and emergency braking drive with the sensors
`front` and their noise, in the regulation's three scenarios (annex 3, guidance on traffic
disturbance critical scenarios): a slower car cuts in, the vehicle ahead cuts out and uncovers a car
that stands, the vehicle ahead brakes. Beside them drives the careful driver of `driver`, with the
truck's brakes and perfect sight. Where this driver avoids an impact the stack must, too, and
elsewhere its impact must not be faster.
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from iits_mj.core.arrays import FloatArray
from iits_mj.core.progress import each
from iits_mj.core.results import Findings, Line, Results
from iits_mj.core.timing import TIMESTEP
from iits_mj.core.units import GRAVITY, KMH
from iits_mj.simulation import DriveConfig
from iits_mj.validation.aeb.drives import BASE, DEVIATION, LANE_WIDTH, at, drive, scenario, straight
from iits_mj.validation.aeb.group import CUT_IN, PASSING, SAME, two_cars
from iits_mj.validation.alks.driver import CAR, Brakes, measure
from iits_mj.validation.alks.lane import lane_keeping
from iits_mj.validation.harness.config import ValidateConfig
from traffic_bridge.scenario.actions import SHAPES
from traffic_bridge.signals.events import Event

# The stack in its lane; the emergency braking guards it.
STACK = dataclasses.replace(BASE, planner="paper")
SPEEDS = (60.0, 80.0)  # [km/h]
DRY, WET, DESCENT = (0.8, 0.0), (0.5, 0.0), (0.8, -0.05)  # friction and grade
# Longest drive [s]; it ends as soon as the truck stands.
DURATION = 18.0


class Case(NamedTuple):
    """A scenario at two values of its grid."""

    speed: float  # [km/h]
    along: float
    across: float


@dataclass(frozen=True)
class Scenario:
    """A scenario of the regulation over a grid.

    Attributes:
      name: in words; x, y: the two quantities with their units.
      along: values of x; across: rising values of y, of which a greater one is easier.
      events: of a case, on a road of a friction.
    """

    name: str
    x: str
    y: str
    along: Sequence[float]
    across: Sequence[float]
    events: Callable[[Case, float], tuple[Event, ...]]

    def thinned(self) -> Scenario:
        """Returns two cases of it."""
        return dataclasses.replace(self, along=self.along[1:2], across=self.across[1::2][:2])


def _cut_in(case: Case, friction: float) -> tuple[Event, ...]:
    del friction
    return scenario("r157_cut_in", gap=case.across, slower=case.along * KMH, duration=CUT_IN)


def _cut_out(case: Case, friction: float) -> tuple[Event, ...]:
    del friction
    times = {"time_gap": case.along, "uncovers": case.across}
    return scenario("r157_cut_out", speed=case.speed * KMH, **times)


def _braking(case: Case, friction: float) -> tuple[Event, ...]:
    possible = case.along * friction * GRAVITY
    own = {"time_gap": case.across, "deceleration": possible}
    return scenario("r157_braking", speed=case.speed * KMH, **own)


SCENARIOS = (
    Scenario(
        "cut-in",
        "speed difference [km/h]",
        "gap [m]",
        (10.0, 20.0, 30.0, 40.0),
        (5.0, 10.0, 15.0, 20.0, 30.0, 45.0),
        _cut_in,
    ),
    Scenario(
        "cut-out",
        "time gap to the leader [s]",
        "time to the car [s]",
        (1.0, 1.5, 2.0),
        (1.6, 2.0, 2.5, 3.5),
        _cut_out,
    ),
    Scenario(
        "braking",
        "deceleration, share of the friction [1]",
        "time gap [s]",
        (0.5, 0.75, 1.0),
        (0.6, 1.0, 1.5, 2.0),
        _braking,
    ),
)
_HEADINGS = (
    *("scenario", "km/h", "cases", "driver hits", "stack hits", "of those the driver avoids"),
    *("mean impact of the driver [km/h]", "of the stack", "greatest excess"),
)


def run(config: ValidateConfig) -> Results:
    """Drives the scenarios for each load on a dry and a wet road and on a descent."""
    results, quick = Results("validate alks"), config.quick
    step = config.timestep or TIMESTEP
    for payload in config.payloads()[:1] if quick else config.payloads():
        for friction, grade in (DRY,) if quick else (DRY, WET, DESCENT):
            setup = dataclasses.replace(STACK, truck=config.truck, payload=payload)
            label = f"{payload / 1e3:g} t load, friction {friction:g}"
            label += f", grade {100.0 * grade:+.0f} %" if grade else ""
            found, rows = against_driver(setup, (friction, grade), label, step, quick)
            results.add(label.replace(" ", "_"), found)
            results.tables[label] = rows
        results.add("", lane_keeping(setup, f"{payload / 1e3:g} t load", step, quick))
    found = false_reactions(dataclasses.replace(STACK, truck=config.truck), step, quick)
    results.add("", found)
    results.notes.append(
        f"The car's driver of UN R157 perceives a risk at a time to collision of {CAR.near:.1f} s, "
        "the truck's as much earlier as the truck's brakes are slower and weaker."
    )
    return results


def against_driver(
    config: DriveConfig, road: tuple[float, float], label: str, step: float, quick: bool = False
) -> tuple[Findings, list[Sequence[str]]]:
    """Drives all scenarios with the stack and with the careful driver.

    Args:
      config: of the stack: truck and load.
      road: friction and grade.
      label: of load and road.
      step: of the physics [s].
      quick: only a part of the grid.

    Returns:
      Checks and boundaries, and a table with a row for each scenario and speed.
    """
    found = Findings(label)
    rows: list[Sequence[str]] = [_HEADINGS]
    brakes = measure(config, SPEEDS[-1], straight(*road), step)
    found.check("deceleration of full braking", brakes.deceleration, "m/s2", CAR.deceleration)
    found.check("lag of the brakes", brakes.lag, "s", CAR.lag)
    found.check(
        "time to collision at which the driver perceives a risk", brakes.near, "s", CAR.near
    )
    for part in map(Scenario.thinned, SCENARIOS) if quick else SCENARIOS:
        hits = excess = 0.0
        for speed in SPEEDS[-1:] if quick or road != DRY else SPEEDS:
            driver, stack = _impacts(config, road, part, speed, brakes, step)
            avoided = np.sum((driver == 0.0) & (stack > 0.0))
            hits, excess = hits + avoided, max(excess, float(np.max(stack - driver)))
            counts = (driver.size, np.sum(driver > 0.0), np.sum(stack > 0.0), avoided)
            means = (np.mean(driver), np.mean(stack), np.max(stack - driver))
            shown = (*map(str, counts), *(f"{value:.1f}" for value in means))
            rows.append((part.name, f"{speed:g}", *shown))
            if not quick:
                _boundary(found, part, speed, driver, stack, brakes)
        found.check(f"{part.name}: impacts that the driver avoids", hits, "1", 0.0, "== 0")
        bound = f"<= {SAME:g}"
        found.check(f"{part.name}: greatest excess of the impact", excess, "km/h", 0.0, bound)
    return found, rows


def _impacts(
    config: DriveConfig,
    road: tuple[float, float],
    part: Scenario,
    speed: float,
    brakes: Brakes,
    step: float,
) -> tuple[FloatArray, FloatArray]:
    """Impact speeds of driver and stack, each of shape (along, across) [km/h]."""
    blind = dataclasses.replace(config, planner=BASE.planner)
    rows = []
    for along, across in each(
        itertools.product(part.along, part.across), f"{part.name} at {speed:g} km/h", str
    ):
        events = part.events(Case(speed, along, across), road[0])
        timed, blind_timed = (at(setup, speed, DURATION) for setup in (config, blind))
        driver = drive(blind_timed, events, straight(*road), guard=brakes.driver(), timestep=step)
        stack = drive(timed, events, straight(*road), timestep=step)
        rows.append((driver.impact / KMH, stack.impact / KMH))
    shape = len(part.along), len(part.across)
    impacts = np.array(rows).T
    return impacts[0].reshape(shape), impacts[1].reshape(shape)


def _boundary(
    found: Findings,
    part: Scenario,
    speed: float,
    driver: FloatArray,
    stack: FloatArray,
    brakes: Brakes,
) -> None:
    """Adds the least values of the grid from which on no case has an impact."""
    along = np.array(part.along)
    lines = [
        Line("careful driver of the truck", along, _least(part, driver), "reference"),
        Line("stack", along, _least(part, stack), "simulation"),
    ]
    if part.name == "cut-in":
        seen = _time_aside(DEVIATION)
        for name, own in (("driver of the truck, closed form", brakes), ("of a car", CAR)):
            gaps = np.array([own.gap_needed(slower * KMH, seen) for slower in along])
            lines.append(Line(name, along, np.where(np.isfinite(gaps), gaps, np.nan)))
    found.panel(f"{part.name} at {speed:g} km/h", part.x, f"least avoided {part.y}", *lines)


def _least(part: Scenario, impacts: FloatArray) -> FloatArray:
    """Least value of the grid from which on nothing is hit, nan if there is none."""
    free = np.cumprod(impacts[:, ::-1] == 0.0, axis=1).sum(axis=1)
    return np.array([part.across[-n] if n else math.nan for n in map(int, free)])


@functools.cache
def _time_aside(offset: float) -> float:
    """Time from the begin of a cut-in until the car has an offset from its lane's middle [s]."""
    times = np.linspace(0.0, 1.0, 501)
    ways = [LANE_WIDTH * SHAPES["sinusoidal"](time) for time in times]
    return float(CUT_IN * np.interp(offset, ways, times))


def false_reactions(config: DriveConfig, step: float, quick: bool = False) -> Findings:
    """Cars that do not come into the lane, moving and standing: the truck must not brake."""
    found = Findings("no reaction")
    setup, seeds = at(config, SPEEDS[-1], DURATION), range(1 if quick else 10)
    passing = [drive(setup, scenario("r157_beside"), timestep=step)]
    between = [
        drive(dataclasses.replace(at(config, PASSING, 8.0), seed=seed), two_cars(), timestep=step)
        for seed in each(seeds, "passing between two cars", str)
    ]
    for name, drives in (("slower cars in both lanes beside", passing), ("two cars", between)):
        lost = max(float(made.speed[0] - made.speed.min()) for made in drives) / KMH
        found.check(f"{name}: speed lost", lost, "km/h", 0.0, "<= 1")
        reacted = sum(made.reacted for made in drives)
        found.check(f"{name}: warnings and brakings", reacted, "1", 0.0, "== 0")
    return found
