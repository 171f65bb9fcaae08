"""Many driving environments in one process, whose physics `mujoco.batch` steps together.

    environments = gymnasium.make_vec("iits_mj:iits_mj/LaneKeep-v0", num_envs=64, threads=8)

`DrivingVectorEnv` is a `gymnasium.vector.SyncVectorEnv` with its autoreset, infos and seeds. Each
environment drives bit for bit as it does alone; all share the compiled model and the threads.
"""

from __future__ import annotations

import functools
from typing import Any, cast

import mujoco
import numpy as np
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from mujoco.batch import Batch
from numpy.typing import NDArray

from iits_mj.core.checks import read_action
from iits_mj.core.errors import InputError
from iits_mj.envs.driving import Action, DrivingEnv

# Fields of `MjData` from which a step of the physics starts.
_FIELDS = ("time", "qpos", "qvel", "act", "plugin_state", "qacc_warmstart", "mocap_pos", "ctrl")


class DrivingVectorEnv(SyncVectorEnv):
    """`num_envs` environments of one task; one call to `mujoco.batch` steps their physics.

    Args:
      num_envs: number of environments.
      threads: number that steps the physics; 0 uses the caller's thread.
      autoreset_mode: see Gymnasium.
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
        **settings: Any,
    ) -> None:
        if num_envs < 1 or threads < 0:
            raise InputError(f"num_envs {num_envs}, threads {threads}: use 1 or more, 0 or more")
        first = DrivingEnv(**settings)
        make = [lambda: first]
        make += [functools.partial(DrivingEnv, like=first, **settings)] * (num_envs - 1)
        super().__init__(make, autoreset_mode=autoreset_mode)
        self._members = tuple(cast(DrivingEnv, member) for member in self.envs)
        self._batch = Batch(first.physics.model.ptr, nsim=num_envs, nthread=threads)
        self._rows = {name: self._batch.bind(name) for name in _FIELDS}
        for number, member in enumerate(self._members):
            member.physics.stepper = functools.partial(self._load, number)

    def step(
        self, actions: Any
    ) -> tuple[
        NDArray[np.float32],
        NDArray[np.float64],
        NDArray[np.bool_],
        NDArray[np.bool_],
        dict[str, Any],
    ]:
        """Holds each action for 0.1 s.

        Raises:
          InputError: the actions have another shape or are not finite.
        """
        shape = self.num_envs, len(self._members[0].task.actions)
        values = read_action(actions, shape, "actions")
        resetting = self.autoreset_mode == AutoresetMode.NEXT_STEP
        driven = [i for i in range(self.num_envs) if not (resetting and self._autoreset_envs[i])]
        for number in driven:
            self._store(number, values[number])
        if driven:
            self._batch.step(ids=driven, nstep=self._members[0].steps_per_action)
        return super().step(actions)

    def _store(self, number: int, action: Action) -> None:
        """Copies one environment's state and controls into the batch."""
        member = self._members[number]
        member.task.before_step(action, member.physics)
        data = member.physics.data.ptr
        for name, rows in self._rows.items():
            rows[number] = np.reshape(getattr(data, name), rows[number].shape)

    def _load(self, number: int, nstep: int) -> None:
        """Copies one environment's state back, instead of stepping it."""
        del nstep
        member = self._members[number]
        model, data = member.physics.model.ptr, member.physics.data.ptr
        self._batch.get_data(number, data)
        mujoco.mj_forward(model, data)
