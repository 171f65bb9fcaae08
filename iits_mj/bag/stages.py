"""Repeats one module of a recorded drive on its recorded inputs and compares the outputs.

With the same code and settings, the outputs are bit-identical. With another decision maker, planner
or truck, the comparison shows the differences in the same situations.
"""

from __future__ import annotations

import contextlib
import dataclasses
import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from controllers.decision.base import DecisionContext, speed_max_of
from controllers.protocols import DecisionMaker
from controllers.stack import Stack
from iits_mj.bag.mcap_file import Bag
from iits_mj.core.errors import Error, InputError
from iits_mj.core.messages import Decision, EgoState, Scene, VehicleCommand
from iits_mj.core.timing import CONTROL_PERIOD, CYCLE_PERIOD
from iits_mj.parameters import TruckParameters
from iits_mj.simulation.config import PARTS, DriveConfig
from iits_mj.simulation.driver import CommandPlayer
from iits_mj.simulation.loop import Simulation
from iits_mj.simulation.parts import load_route, make_stack, make_traffic
from traffic_bridge import VehicleFrame

# Types whose values are equal or different, without a distance.
_WORDS = (str, type(None), dict)
STAGES = ("traffic", "decision", "planning", "control", "vehicle")
# Options of the parts that each stage runs.
_USED = {
    "traffic": ("traffic_mode",),
    "decision": ("decision", "planner", "speed_planner"),
    "planning": ("planner", "speed_planner"),
    "control": ("lateral", "longitudinal"),
    "vehicle": (),
}


@dataclass
class Comparison:
    """Differences between the outputs of a stage and the recorded ones.

    Attributes:
      stage: its name; count: number of outputs; differing: of those that are not bit-identical.
      first: time of the first difference [s]; None without one.
      largest: greatest difference of each quantity by name; inf if not comparable.
    """

    stage: str
    count: int = 0
    differing: int = 0
    first: float | None = None
    largest: dict[str, float] = field(default_factory=dict)

    def add(self, time: float, then: Any, now: Any) -> None:
        """Adds the comparison of an output, a dataclass, with the recorded one."""
        self.count += 1
        same = True
        for name, one, other in _parts(then, now, ""):
            apart = _distance(one, other)
            if apart != 0.0:
                same = False
                self.largest[name] = max(self.largest.get(name, 0.0), apart)
        if not same:
            self.differing += 1
            self.first = time if self.first is None else self.first


def run_stage(bag: Bag, stage: str, map_path: Path | None = None, **changes: Any) -> Comparison:
    """Repeats a stage on a bag's inputs.

    Args:
      bag: of a drive.
      stage: one of `STAGES`.
      map_path: map of the drive; None: the built-in one.
      **changes: options of the drive that replace the recorded ones.

    Raises:
      InputError: unknown stage, or the drive's options cannot be used.
      TrafficError: SUMO failed.
    """
    stages: dict[str, Callable[[Bag, DriveConfig], Comparison]] = {
        "traffic": _traffic,
        "decision": _decision,
        "planning": _planning,
        "control": _control,
        "vehicle": _vehicle,
    }
    if stage not in stages:
        raise InputError(f"stage {stage!r} is unknown; allowed are: {', '.join(STAGES)}")
    used = _USED[stage]
    changes = {name: v for name, v in changes.items() if name not in PARTS or name in used}
    return stages[stage](bag, bag.config(map_path, used, **changes))


class _RecordedDecisions:
    """Decision maker that returns the recorded decisions; compares them with another one's."""

    def __init__(self, bag: Bag, other: DecisionMaker | None, result: Comparison) -> None:
        self._decided = bag.decided
        self._other, self._result = other, result
        self.reset()

    def reset(self) -> None:
        self._next, self.speed_max = 0, math.inf
        if self._other is not None:
            self._other.reset()

    def decide(self, context: DecisionContext) -> Decision:
        if self._next >= len(self._decided):
            raise Error(f"the bag has no decision of t = {context.scene.time:.2f} s")
        then = self._decided[self._next]
        self._next += 1
        if self._other is not None:
            decision = self._other.decide(context)
            now = dataclasses.replace(then, decision=decision, speed_max=speed_max_of(self._other))
            self._result.add(then.time, then, now)
        self.speed_max = then.speed_max
        return then.decision


def _stack(config: DriveConfig) -> Stack:
    return make_stack(config, load_route(config), TruckParameters.load(config.truck))


def _decision(bag: Bag, config: DriveConfig) -> Comparison:
    result = Comparison("decision")
    stack = _stack(config)
    stack.decision_maker = _RecordedDecisions(bag, stack.decision_maker, result)
    stack.reset()
    for scene in bag.scenes:
        stack.plan(_framed(scene))
    return result


def _planning(bag: Bag, config: DriveConfig) -> Comparison:
    result = Comparison("planning")
    stack = _stack(config)
    stack.decision_maker = _RecordedDecisions(bag, None, result)
    stack.reset()
    for scene, then in zip(bag.scenes, bag.trajectories, strict=True):
        result.add(scene.time, then, stack.plan(_framed(scene)))
    return result


def _control(bag: Bag, config: DriveConfig) -> Comparison:
    result = Comparison("control")
    tracker = _stack(config).tracker
    tracker.reset()
    plans = iter(zip(bag.scenes, bag.trajectories, strict=True))
    plan, due = None, next(plans, None)
    for ego, then in zip(bag.states, bag.wanted, strict=True):
        # The truck follows a plan from the time of its scene on.
        while due is not None and due[0].time <= ego.time + 1e-9:
            plan, due = due[1], next(plans, None)
        if plan is None:
            raise InputError(f"the bag has no plan for t = {ego.time:.2f} s")
        result.add(ego.time, then, tracker.command(ego, plan))
    return result


def _vehicle(bag: Bag, config: DriveConfig) -> Comparison:
    """Repeats the truck on an empty road, without vehicles that it may have collided with."""
    result = Comparison("vehicle")

    def recorded(number: int, ego: EgoState) -> VehicleCommand:
        if number >= len(bag.obeyed):
            raise Error(f"the bag has no command of t = {ego.time:.2f} s")
        result.add(ego.time, bag.states[number], ego)
        return bag.obeyed[number]

    alone = dataclasses.replace(
        config, traffic_mode="none", recording=None, events=None, commands="direct"
    )
    with Simulation(
        alone, driver=lambda *_: CommandPlayer(recorded), visuals=False, timestep=bag.timestep
    ) as simulation:
        duration = bag.states[-1].time - bag.states[0].time
        cycles = math.ceil((duration + CONTROL_PERIOD) / CYCLE_PERIOD - 1e-6)
        for _ in range(cycles):
            if not simulation.ended:
                simulation.cycle()
    return result


def _traffic(bag: Bag, config: DriveConfig) -> Comparison:
    result = Comparison("traffic")
    route = load_route(config)
    traffic = make_traffic(config, route, bag.scenes[0].footprint)
    if traffic is None:
        raise InputError("the bag's drive had no traffic")
    with contextlib.closing(traffic):
        for number, then in enumerate(bag.scenes):
            step = traffic.step if number else traffic.reset
            vehicles = tuple(VehicleFrame.of(step(then.ego)))
            result.add(then.time, then, dataclasses.replace(then, vehicles=vehicles))
    return result


def _framed(scene: Scene) -> Scene:
    """Returns the scene with its vehicles in a `VehicleFrame`, as in the simulation."""
    return dataclasses.replace(scene, vehicles=VehicleFrame.of(scene.vehicles))


def _parts(then: Any, now: Any, name: str) -> Iterable[tuple[str, Any, Any]]:
    """Yields name and both values of every field of two messages."""
    if dataclasses.is_dataclass(then) and type(then) is type(now):
        for part in dataclasses.fields(then):
            inside = f"{name}.{part.name}" if name else part.name
            yield from _parts(getattr(then, part.name), getattr(now, part.name), inside)
    elif _messages(then) and _messages(now) and len(then) == len(now):
        for one, other in zip(then, now, strict=True):
            yield from _parts(one, other, name)
    else:
        yield name, then, now


def _messages(value: Any) -> bool:
    return isinstance(value, (tuple, list)) and bool(value) and dataclasses.is_dataclass(value[0])


def _distance(one: Any, other: Any) -> float:
    """Returns the difference: 0 for identical bits, inf where values cannot be subtracted."""
    if isinstance(one, _WORDS) or isinstance(other, _WORDS):
        return 0.0 if one == other else math.inf
    try:
        first, second = (np.atleast_1d(np.asarray(v, dtype=float)) for v in (one, other))
    except (TypeError, ValueError):
        return 0.0 if one == other else math.inf
    if first.shape != second.shape:
        return math.inf
    if first.size == 0 or first.tobytes() == second.tobytes():
        return 0.0
    apart = np.abs(first - second)
    apart[first == second] = 0.0
    worst = float(np.max(apart))
    return math.inf if math.isnan(worst) else max(worst, math.ulp(0.0))
