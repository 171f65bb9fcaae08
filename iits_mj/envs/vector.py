"""Many driving environments in one process, whose physics runs on a pool of threads.

    environments = gymnasium.make_vec("iits_mj:iits_mj/LaneKeep-v0", num_envs=64, threads=8)

`DrivingVectorEnv` is a `gymnasium.vector.SyncVectorEnv` with its autoreset, infos and seeds. Each
environment drives bit for bit as it does alone; all share the compiled model and the threads.
"""

from __future__ import annotations

import contextlib
import functools
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, cast

import numpy as np
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from numpy.typing import NDArray

from iits_mj.core.checks import read_action
from iits_mj.core.errors import InputError
from iits_mj.envs.driving import Action, DrivingEnv, Observation
from iits_mj.truck.truck import without_sensors


class _Member(DrivingEnv):
    """An environment whose steps `DrivingVectorEnv` begins and advances."""

    def step(self, action: Action) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Completes the step that has begun."""
        del action
        return self.finish()


class DrivingVectorEnv(SyncVectorEnv):
    """`num_envs` environments of one task, each with its own draws from a family of trucks.

    MuJoCo's steps release Python's lock, so that threads step the physics at the same time.

    Args:
      num_envs: number of environments.
      threads: number that steps the physics; 0 uses the caller's thread.
      autoreset_mode, max_episode_steps: see Gymnasium.
      **settings: of each environment, see `DrivingEnv`.

    Raises:
      InputError: a number or a setting of the environments is not allowed.
    """

    def __init__(
        self,
        num_envs: int = 1,
        *,
        threads: int = 0,
        autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP,
        max_episode_steps: int | None = None,
        **settings: Any,
    ) -> None:
        if num_envs < 1 or threads < 0:
            raise InputError(f"num_envs {num_envs}, threads {threads}: use 1 or more, 0 or more")
        first = _Member(**settings)
        if max_episode_steps is not None:
            # Gymnasium wraps single environments in its `TimeLimit` for this.
            limit = max_episode_steps / round(1.0 / first.task.period)
            if limit < (settings.get("time_limit") or first.task.time_limit):
                first = _Member(**(settings := {**settings, "time_limit": limit}))
        make = [lambda: first]
        make += [functools.partial(_Member, like=first, **settings)] * (num_envs - 1)
        super().__init__(make, autoreset_mode=autoreset_mode)
        self._members = tuple(cast(_Member, member) for member in self.envs)
        self._threads = max(min(threads, num_envs), 1)
        self._pool = ThreadPoolExecutor(self._threads) if self._threads > 1 else None

    def step(
        self, actions: Any
    ) -> tuple[
        NDArray[np.float32],
        NDArray[np.float64],
        NDArray[np.bool_],
        NDArray[np.bool_],
        dict[str, Any],
    ]:
        """Holds each action for the task's `period`.

        Raises:
          InputError: the actions have another shape or are not finite.
        """
        shape = self.num_envs, len(self._members[0].task.actions)
        values = read_action(actions, shape, "actions").tolist()
        resetting = self.autoreset_mode == AutoresetMode.NEXT_STEP
        driven = []
        for member, action, over in zip(self._members, values, self._autoreset_envs, strict=True):
            if not (resetting and over):
                member.begin(action)
                driven.append(member)
        # The flag belongs to the model, which equal trucks share: no thread may compute sensors
        # meanwhile.
        models = {id(model): model for model in (m.physics.truck.model for m in driven)}
        with contextlib.ExitStack() as stack:
            for model in models.values():
                stack.enter_context(without_sensors(model))
            self._each(_Member.advance, driven)
        self._each(lambda member: member.physics.update_sensors(), driven)
        return super().step(actions)

    def _each(self, call: Callable[[_Member], None], members: list[_Member]) -> None:
        """Calls a function for each member on the threads."""

        def share(number: int) -> None:
            for member in members[number :: self._threads]:
                call(member)

        if self._pool is None:
            share(0)
        else:
            list(self._pool.map(share, range(self._threads)))

    def close_extras(self, **kwargs: Any) -> None:
        """Ends the environments and the threads."""
        super().close_extras(**kwargs)
        if self._pool is not None:
            self._pool.shutdown()

    def _add_info(
        self, vector_infos: dict[str, Any], env_info: dict[str, Any], env_num: int
    ) -> dict[str, Any]:
        """Adds the numbers of an environment's info to their columns; faster than Gymnasium's."""
        for key, value in env_info.items():
            if type(value) is not float:
                super()._add_info(vector_infos, {key: value}, env_num)
                continue
            if key not in vector_infos:
                vector_infos[key] = np.zeros(self.num_envs)
                vector_infos[f"_{key}"] = np.zeros(self.num_envs, dtype=np.bool_)
            vector_infos[key][env_num] = value
            vector_infos[f"_{key}"][env_num] = True
        return vector_infos
