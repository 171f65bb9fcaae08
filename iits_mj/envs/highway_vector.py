"""Many fast highways, stepped by one compiled call.

    environments = gymnasium.make_vec("iits_mj:iits_mj/HighwayFast-v0", num_envs=256)

Each environment gives the bits that it gives alone. Its generator is that of its seed.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from controllers.decision.fast_world.worlds import FastWorlds
from controllers.decision.trip import RewardTerms
from iits_mj.core.arrays import BoolArray
from iits_mj.core.errors import InputError
from iits_mj.envs.highway import FAST_INFO, HighwayFastEnv

_TERMS = [f"reward_{field.name}" for field in dataclasses.fields(RewardTerms)]
_MODES = (AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP)
_Observations = NDArray[np.float32]


class HighwayFastVectorEnv(VectorEnv[_Observations, NDArray[np.int64], NDArray[Any]]):
    """`num_envs` environments `iits_mj/HighwayFast-v0`, each with its own traffic and truck.

    Args:
      num_envs: number of environments.
      autoreset_mode: see Gymnasium, NEXT_STEP or SAME_STEP.
      max_episode_steps: truncates episodes after as many decisions.
      **settings: of each environment, see `HighwayFastEnv`.

    Raises:
      InputError: a number or a setting of the environments is not allowed.
    """

    def __init__(
        self,
        num_envs: int = 1,
        *,
        autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP,
        max_episode_steps: int | None = None,
        **settings: Any,
    ) -> None:
        if num_envs < 1:
            raise InputError(f"num_envs {num_envs}: use 1 or more")
        self._mode = AutoresetMode(autoreset_mode)
        if self._mode not in _MODES:
            raise InputError(f"autoreset_mode {self._mode.value}: use NextStep or SameStep")
        one = HighwayFastEnv(**settings)
        self.num_envs = num_envs
        self.metadata = {**one.metadata, "autoreset_mode": self._mode}
        self.render_mode = None
        self.single_observation_space = one.observation_space
        self.single_action_space = one.action_space
        self.observation_space = batch_space(one.observation_space, num_envs)
        self.action_space = batch_space(one.action_space, num_envs)
        self._scaled = one.scaled
        self._steps_most = max_episode_steps or math.inf
        self._family = one.family
        self._trips = [one.trip_of(number) for number in range(len(one.family.members))]
        self._worlds = FastWorlds(num_envs)
        self._generators: list[np.random.Generator] = []
        self._numbers = np.zeros(num_envs, dtype=np.intp)
        self._steps = np.zeros(num_envs, dtype=np.intp)
        self._over = np.zeros(num_envs, dtype=bool)

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[_Observations, dict[str, Any]]:
        """Starts an episode in each environment.

        Args:
          seed: of the first environment, whose successors take the next numbers, or of each.
          options: not used.

        Raises:
          InputError: the number of seeds is another one.
        """
        del options
        if seed is None or isinstance(seed, int):
            seeds = [None if seed is None else seed + k for k in range(self.num_envs)]
        else:
            seeds = list(seed)
        if len(seeds) != self.num_envs:
            raise InputError(f"{len(seeds)} seeds: use {self.num_envs}")
        if self._generators:
            pairs = zip(self._generators, seeds, strict=True)
            self._generators = [
                generator if one is None else seeding.np_random(one)[0] for generator, one in pairs
            ]
        else:
            self._generators = [seeding.np_random(one)[0] for one in seeds]
        for index in range(self.num_envs):
            self._begin(index)
        self._over[:] = False
        return self._observations, self._info(np.ones(self.num_envs, dtype=bool))

    def step(
        self, actions: Any
    ) -> tuple[_Observations, NDArray[np.float64], BoolArray, BoolArray, dict[str, Any]]:
        """Carries out a decision in each environment, until the next one is due.

        Raises:
          InputError: unknown actions, or no episode has begun.
        """
        chosen = np.asarray(actions)
        if not self._generators:
            raise InputError("no episode has begun: call reset first")
        if chosen.shape != (self.num_envs,) or not np.isin(chosen, (0, 1, 2)).all():
            raise InputError(f"actions are {self.num_envs} of 0, 1 and 2, not {chosen}")
        self._worlds.step(chosen.astype(np.int64) - 1)
        self._steps += 1
        infos: dict[str, Any] = {}
        if self._mode is AutoresetMode.SAME_STEP:
            outcome = self._outcome()
            over = outcome[1] | outcome[2]
            if over.any():
                last = np.full(self.num_envs, None, dtype=object)
                observations = self._observations
                for index in np.flatnonzero(over).tolist():
                    last[index] = observations[index]
                infos = {"final_obs": last, "final_info": self._info(over)}
                infos |= {"_final_obs": over, "_final_info": over}
            self._begin_all(over)
        else:
            self._begin_all(self._over)
            outcome = self._outcome()
            self._over = outcome[1] | outcome[2]
        infos |= self._info(np.ones(self.num_envs, dtype=bool))
        return self._observations, *outcome, infos

    @property
    def _observations(self) -> _Observations:
        return self._scaled(self._worlds.observations)

    def _begin_all(self, over: BoolArray) -> None:
        for index in np.flatnonzero(over).tolist():
            self._begin(index)

    def _begin(self, index: int) -> None:
        """Starts an episode of one environment, as `DecisionEnv.reset` does."""
        generator = self._generators[index]
        self._steps[index] = 0
        number = self._numbers[index] = self._family.draw(generator)
        self._worlds.reset(index, generator, self._trips[number])

    def _outcome(self) -> tuple[NDArray[np.float64], BoolArray, BoolArray]:
        states = self._worlds.states
        late = self._steps >= self._steps_most
        rewards = states["reward"].sum(axis=1)
        return rewards, states["terminated"] != 0, late | (states["truncated"] != 0)

    def _info(self, given: BoolArray) -> dict[str, Any]:
        """The entries of `info` as arrays, and which environments give them."""
        states = self._worlds.states
        found: dict[str, Any] = {name: states[field].copy() for name, field in FAST_INFO.items()}
        found |= dict(zip(_TERMS, states["reward"].T.copy(), strict=True))
        if len(self._trips) > 1:
            names = np.array([truck.name for truck in self._family.members], dtype=object)
            found["truck"] = names[self._numbers]
        return {**found, **{f"_{name}": given.copy() for name in found}}
