"""Trips of the truck through fast worlds, many of them in one call.

The truck is a point mass: it follows its leader as the planner does, within the engine's power
after driveline, rolling resistance, air drag and grade. It has no gears and no brake lag. A lane
change takes 6 to 9 s, whole seconds, as in the full chain.
"""

from __future__ import annotations

import copy
import math
from dataclasses import fields

import numpy as np
from numpy.typing import ArrayLike, NDArray

from controllers.decision.fast_world.config import WAVES, HighwayConfig, HighwayRoad
from controllers.decision.fast_world.state import (
    batch_function,
    capacity_of,
    copied,
    new_states,
    set_traffic,
)
from controllers.decision.observation import OBSERVATION_SIZE
from controllers.decision.quality import Quality
from controllers.decision.trip import ACTIONS, RewardTerms, TrafficDemand, TripConfig, TripSummary
from iits_mj import kernels
from iits_mj.core.arrays import BoolArray, FloatArray, IntArray
from iits_mj.core.errors import InputError
from iits_mj.core.messages import PROFILE_SPEED_MIN
from iits_mj.kernels import Address, Table
from iits_mj.parameters import AnyTruck, TruckParameters
from iits_mj.parameters.mass_state import rolling_resistance

_start = batch_function("iits_worlds_start")
_step = batch_function("iits_worlds_step", Address)
_decide = batch_function("iits_worlds_decide", Address, Address)
_drive = batch_function("iits_worlds_drive", Address, Address)
_allowed = batch_function("iits_worlds_allowed", Address)
_braking = batch_function("iits_worlds_braking", Address)
# Fields of `TripSummary` in the state.
_TOTALS = (
    *("distance", "decisions", "changes", "refused", "dangerous", "collisions"),
    *("time_gap_min", "loss_integral"),
)


class FastWorlds:
    """Trips in n worlds, each independent of the others.

    The same generator and trip give the same bits, whatever the number of worlds.

    Args:
      count: number of worlds, n.
      grade_max: greatest grade of the hills; 0 for flat roads.

    Attributes:
      states: the worlds, shape (n,); their fields are those of `World` in
        iits_mj/kernels/fast_world.h, e.g. `states["speed"]` of shape (n,).
    """

    def __init__(self, count: int, grade_max: float = 0.045) -> None:
        self.states = new_states(count, 1)
        self._grade_max = grade_max
        self._trucks: dict[tuple[int, float | None], tuple[AnyTruck | None, dict[str, float]]] = {}

    def __len__(self) -> int:
        return len(self.states)

    def reset(self, index: int, generator: np.random.Generator, trip: TripConfig) -> None:
        """Starts a trip of one world at the traffic's speed in the right lane.

        The trip takes the generator's next 2^64 random numbers.

        Raises:
          InputError: the generator is not one of `numpy.random.default_rng`.
        """
        truck, reward = self._truck(trip), trip.reward
        config = HighwayConfig(**{f.name: getattr(trip, f.name) for f in fields(TrafficDemand)})
        self._reserve(capacity_of(config))
        state = self.states[index]
        values = {
            **truck,
            "front": trip.start_station + truck["front_overhang"],
            "speed": min(trip.traffic_speed, trip.reference_speed),
            "truck_keeps_right": trip.truck_keeps_right,
            "reference_speed": trip.reference_speed,
            "end": trip.start_station + trip.length,
            "duration": trip.duration,
            "grade_amplitude": self._grade_max * WAVES,
            "grade_phase": generator.uniform(0.0, 2.0 * math.pi, len(WAVES)),
            "charge_change": reward.change,
            "charge_danger": reward.danger,
            "charge_speed": reward.speed,
            "charge_collision": reward.collision,
            "discount": reward.discount,
        }
        for name, value in values.items():
            state[name] = value
        set_traffic(state, config, generator)
        _start(self.states[index : index + 1])

    def step(self, decisions: ArrayLike, speed_max: ArrayLike = math.inf) -> None:
        """Carries out or refuses a decision in each world, until the next one is due.

        A world whose trip is over, `states["terminated"]` or `states["truncated"]`, stays as it is.
        The other results are in `states`: "reward", shape (n, 4), see `RewardTerms`, and "seconds".

        Args:
          decisions: values of `Decision`, shape (n,).
          speed_max: highest speed that the truck aims at until then [m/s], of all or of each.

        Raises:
          InputError: wrong shape, or a value that is not allowed.
        """
        chosen = np.ascontiguousarray(decisions, dtype=np.int64)
        if chosen.shape != (len(self),) or np.abs(chosen).max(initial=0) > 1:
            raise InputError(
                f"decisions of shape {chosen.shape}: use {len(self)} of -1 (left), 0 and 1 (right)"
            )
        limit = np.asarray(speed_max, dtype=float)
        if limit.shape not in ((), chosen.shape) or not (limit >= PROFILE_SPEED_MIN).all():
            raise InputError(
                f"speed_max {speed_max!r}: use one number or {len(self)}, each "
                f"{PROFILE_SPEED_MIN:g} m/s or more"
            )
        self.states["speed_max"] = limit
        _step(self.states, kernels.address(chosen))

    @property
    def observations(self) -> NDArray[np.float32]:
        """What each truck sees, shape (n, 216); a copy."""
        return self.states["frames"].reshape(len(self), OBSERVATION_SIZE).copy()

    def allowed(self) -> BoolArray:
        """Which decisions would be carried out now: the planner's gaps, its pause and the lanes.

        Shape (n, 3), in the order of `ACTIONS`.
        """
        allowed = np.empty((len(self), len(ACTIONS)), dtype=bool)
        _allowed(self.states, kernels.address(allowed))
        return allowed

    def imposed_braking(self) -> FloatArray:
        """Braking that each decision asks of the new follower now [m/s2], shape (n, 3).

        It is infinite where the decision would be refused; see `rules.imposed_braking`.
        """
        braking = np.empty((len(self), len(ACTIONS)))
        _braking(self.states, kernels.address(braking))
        return braking

    def decide(self, rule: Table) -> IntArray:
        """Returns the decisions of a rule, shape (n,).

        Args:
          rule: of `controllers.decision.rules.compiled`.
        """
        decisions = np.empty(len(self), dtype=np.int64)
        _decide(self.states, rule.address, kernels.address(decisions))
        return decisions

    def drive(self, rule: Table, seconds: ArrayLike = math.inf) -> None:
        """Drives by a rule until the trips are over, or for some seconds; a change is completed.

        Args:
          rule: see `decide`.
          seconds: of all worlds, or of each, shape (n,).
        """
        spans = np.full(len(self), seconds, dtype=float)
        _drive(self.states, rule.address, kernels.address(spans))

    def copy(self, indices: ArrayLike) -> FastWorlds:
        """Returns copies of worlds, in any order and number, which drive on independently."""
        chosen = np.ascontiguousarray(indices, dtype=np.int64)
        if chosen.ndim != 1 or not ((chosen >= 0) & (chosen < len(self))).all():
            raise InputError(f"indices of {len(self)} worlds are 0 to {len(self) - 1}")
        copies = copy.copy(self)
        copies.states = copied(self.states, chosen, self._capacity)
        return copies

    def roll_out(self, decisions: ArrayLike, rule: Table, seconds: float) -> FastWorlds:
        """Returns copies of each world after a first decision and a drive by a rule.

        Copies of a world have the same future traffic, so that their decisions are compared by the
        same chance. Differences of their `states` are what a decision gains.

        Args:
          decisions: m of each world, shape (n, m); see `step`.
          rule: that continues, see `decide`.
          seconds: of the decision and the drive together.

        Returns:
          n m worlds; number i m + j has the decision j of world i.
        """
        chosen = np.asarray(decisions)
        if chosen.ndim != 2 or len(chosen) != len(self):
            raise InputError(f"decisions of shape {chosen.shape}: use ({len(self)}, m)")
        copies = self.copy(np.repeat(np.arange(len(self)), chosen.shape[1]))
        until = copies.states["time"] + seconds
        copies.step(chosen.ravel())
        copies.drive(rule, until - copies.states["time"])
        return copies

    def summary(self, index: int) -> TripSummary:
        """Returns the totals of a world's trip so far."""
        state = self.states[index]
        numbers = {name: state[name].item() for name in _TOTALS}
        reward = RewardTerms(*state["total"].tolist())
        quality = Quality(**{field.name: state[field.name].item() for field in fields(Quality)})
        time = state["driven_time"].item()
        return TripSummary(time=time, reward=reward, quality=quality, **numbers)

    def road(self, index: int) -> HighwayRoad:
        """Returns the road of a world."""
        state = self.states[index]
        waves = state["grade_amplitude"].tolist(), state["grade_phase"].tolist()
        return HighwayRoad(float(state["end"]), int(state["lanes"]), *waves)

    @property
    def _capacity(self) -> int:
        return int(self.states["vehicles"].shape[1])

    def _reserve(self, capacity: int) -> None:
        """Makes places for a number of vehicles in each world."""
        if capacity > self._capacity:
            self.states = copied(self.states, np.arange(len(self)), capacity)

    def _truck(self, trip: TripConfig) -> dict[str, float]:
        """The truck's constants, by their names in the state."""
        key = id(trip.truck), trip.payload
        if key not in self._trucks:
            # Holding the truck keeps its id.
            self._trucks[key] = trip.truck, _truck_numbers(trip)
        return self._trucks[key][1]


def _truck_numbers(trip: TripConfig) -> dict[str, float]:
    parameters = TruckParameters.load(trip.truck)
    engine, gearbox, air = parameters.engine, parameters.gearbox, parameters.aerodynamics
    efficiency = gearbox.efficiency * gearbox.driveline_efficiency
    return {
        "mass": parameters.gross_mass(trip.payload),
        "power": float((engine.full_load_speed * engine.full_load_torque).max()) * efficiency,
        "drag": 0.5 * air.density * air.mean_drag_area(),
        "rolling": rolling_resistance(parameters, parameters.check_payload(trip.payload)),
        "truck_length": parameters.footprint.length,
        "front_overhang": parameters.footprint.front_overhang,
    }
