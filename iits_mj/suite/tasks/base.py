"""Base class of the tasks: actions, observations by name, tolerances of the reward."""

from __future__ import annotations

import abc
import collections
import math
import operator
from collections.abc import Callable, Mapping
from typing import Any, ClassVar

import mujoco
import numpy as np
from dm_control.suite import base
from dm_control.utils import rewards
from dm_env import specs

from iits_mj.core.arrays import FloatArray
from iits_mj.core.checks import read_action
from iits_mj.core.messages import EgoState, TransmissionMode, VehicleCommand, XbrMode
from iits_mj.core.timing import CYCLE_PERIOD
from iits_mj.road import Route
from iits_mj.suite.physics import Observed, Physics

Observations = collections.OrderedDict[str, FloatArray]

# Scale of the Gaussian that is 0.1 at a distance of 1.
_GAUSS = float(np.sqrt(-2.0 * np.log(0.1)))
# Settings of a tolerance that falls linearly to 0 at its margin.
LINEAR = {"value_at_margin": 0.0, "sigmoid": "linear"}


class DrivingTask(base.Task, abc.ABC):
    """Base class of the tasks that control pedal, brakes and steering.

    | action  | range   | meaning                                                          |
    |---------|---------|------------------------------------------------------------------|
    | `drive` | -1 .. 1 | above 0: accelerator pedal; below: XBR demand down to -`brake_max` |
    | `steer` | -1 .. 1 | steering-wheel angle up to `steer_max`, left positive (where used) |

    The method with the name of an observation, of the task or else of the physics, returns it.

    Attributes:
      time_limit: of an episode [s]; tags: in the suite, in addition to "benchmarking".
      target: speed to hold or to reach [m/s].
      actions: names of the actions.
      period: for which an action is held [s].
      brake_max: deceleration that a full negative `drive` demands [m/s2].
      steer_max: steering-wheel angle of a full `steer` [rad].
      gear_mode: of the transmission.
      observed: the observations, in their order.
      terms: meaning of each factor of the reward.
    """

    time_limit: ClassVar[float]
    tags: ClassVar[tuple[str, ...]] = ()
    target: float = 0.0
    actions: ClassVar[tuple[str, ...]] = ("drive",)
    period: ClassVar[float] = CYCLE_PERIOD
    brake_max: ClassVar[float] = 4.0
    steer_max: ClassVar[float] = 0.5 * math.pi
    gear_mode: ClassVar[TransmissionMode] = TransmissionMode.DRIVE
    observed: ClassVar[dict[str, Observed]]
    terms: ClassVar[dict[str, str]]

    def __init__(self, random: Any = None) -> None:
        super().__init__(random=random)
        self._readers = [self._reader(name, entry) for name, entry in self.observed.items()]

    @staticmethod
    @abc.abstractmethod
    def road() -> Route:
        """Returns the road of the task."""

    @classmethod
    def edit_spec(cls, spec: mujoco.MjSpec) -> None:
        """Adds markers that show the task and have no contacts."""

    @property
    def scales(self) -> dict[str, float]:
        """Scale of each observation for a learner."""
        return {name: entry.scale for name, entry in self.observed.items()}

    def action_spec(self, physics: Physics) -> specs.BoundedArray:
        """Returns the specification: one number in [-1, 1] for each of `actions`."""
        del physics
        full = np.ones(len(self.actions))
        names = "\t".join(self.actions)
        return specs.BoundedArray(full.shape, np.float64, -full, full, name=names)

    def before_step(self, action: Any, physics: Physics) -> None:
        """Sends the action to the truck as a command; clips values outside [-1, 1].

        Raises:
          InputError: not one finite number for each of `actions`.
        """
        self.act(read_action(action, (len(self.actions),)).tolist(), physics)

    def act(self, values: list[float], physics: Physics) -> None:
        """Sends an action of finite numbers to the truck as a command; clips it to [-1, 1]."""
        drive, *others = [min(max(value, -1.0), 1.0) for value in values]
        steer = others[0] if others else 0.0
        physics.command(
            VehicleCommand(
                accelerator_pedal=max(drive, 0.0),
                xbr_demand=self.brake_max * min(drive, 0.0),
                xbr_mode=XbrMode.MAXIMUM if drive < 0.0 else XbrMode.OFF,
                steering_wheel_angle=self.steer_max * steer,
                transmission_mode=self.gear_mode,
            )
        )

    def get_observation(self, physics: Physics) -> Observations:
        """Returns the observations in SI units, each of shape (size,)."""
        values, found, start = np.array(self.values(physics), dtype=float), Observations(), 0
        for name, entry in self.observed.items():
            found[name] = values[start : start + entry.size]
            start += entry.size
        return found

    def values(self, physics: Physics) -> list[float]:
        """Returns the numbers of all observations in SI units, in the order of `observed`."""
        ego, found = physics.ego(), []
        for several, of_ego, read in self._readers:
            value = read(ego if of_ego else physics)
            if several:
                found += value
            else:
                found.append(value)
        return found

    def _reader(self, name: str, entry: Observed) -> tuple[bool, bool, Callable[[Any], Any]]:
        """Returns how to read an observation: several numbers? from an `EgoState`? by what?"""
        own = getattr(self, name, None)
        of_ego = own is None and name in EgoState.__dataclass_fields__
        if of_ego:
            own = operator.attrgetter(name)
        return entry.size > 1, of_ego, own or operator.methodcaller(name)

    def speed_error(self, physics: Physics) -> float:
        """Returns the speed minus the target [m/s]."""
        return physics.speed() - self.target

    @abc.abstractmethod
    def reward_terms(self, physics: Physics) -> dict[str, float]:
        """Returns the named factors of the reward, each in [0, 1]."""

    def get_reward(self, physics: Physics) -> float:
        """Returns the product of the terms."""
        return math.prod(self.reward_terms(physics).values())

    @staticmethod
    def info(physics: Physics, terms: Mapping[str, float]) -> dict[str, float]:
        """Returns state and factors of the reward, `reward_<name>`, for Gymnasium's `info`."""
        ego = physics.ego()
        found = {
            "time": ego.time,
            "speed": ego.speed,
            "station": ego.station,
            "fuel_used": ego.fuel_used,
        }
        for name, value in terms.items():
            found[f"reward_{name}"] = value
        return found


def tolerance(value: float, low: float, high: float, margin: float, **form: Any) -> float:
    """Returns 1 from `low` to `high`, falling to 0.1 at a distance of `margin` outside.

    It is dm_control's `rewards.tolerance`, without arrays for the default form.
    """
    if low <= value <= high:
        return 1.0
    if form:
        return float(rewards.tolerance(value, (low, high), margin, **form))
    distance = (low - value if value < low else value - high) / margin
    # NumPy's `exp`, whose last bit differs from that of `math`.
    return float(np.exp(-0.5 * (distance * _GAUSS) ** 2))
