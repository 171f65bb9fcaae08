"""Gymnasium environments of the suite's driving tasks."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from iits_mj import suite
from iits_mj.core.checks import read_action
from iits_mj.envs.picture import RENDER_MODES, Picture, ScaledObservations
from iits_mj.suite.tasks import DrivingTask

if TYPE_CHECKING:
    from dm_control.rl import control

Observation = NDArray[np.float32]
Action = NDArray[np.float32]


class DrivingEnv(gymnasium.Env[Observation, Action]):
    """A task of the suite, with its scaled observations as one vector.

    The controls are those of the task (`drive`, and `steer` where it is used), each in [-1, 1],
    held for 0.1 s. Each observation is divided by the task's scale and clipped to [-5, 5]; the
    names of the vector's numbers are in `observation_names`. The reward is the task's, in [0, 1];
    its factors are in `info` as `reward_<name>`. An episode is terminated when the task fails
    (truck off its lane) and truncated at the task's time limit. All versions are v0.

    Args:
      task: name in `iits_mj.suite.TASKS_BY_DOMAIN["truck"]`.
      payload: on the semitrailer [kg].
      payload_height: of the load's centre of gravity above the road [m], 1.3 to 3.
      time_limit: of an episode [s]; default: the task's.
      render_mode: None, "rgb_array" (needs OpenGL) or "human" (needs a display).
      camera: of the pictures: "chase", "side" or "cab".
      like: another environment of the same task and settings, whose compiled model is shared.

    Raises:
      InputError: unknown task, camera or render mode, payload out of range.
    """

    metadata: dict[str, Any] = {"render_modes": RENDER_MODES, "render_fps": 10}  # noqa: RUF012 - Gymnasium's way

    def __init__(
        self,
        task: str,
        *,
        payload: float = 36_000.0,
        payload_height: float | None = None,
        time_limit: float | None = None,
        render_mode: str | None = None,
        camera: str = "chase",
        like: DrivingEnv | None = None,
    ) -> None:
        self.render_mode = render_mode
        self._picture = Picture(render_mode, camera)
        self._environment: control.Environment = (
            suite.load(
                "truck",
                task,
                task_kwargs={
                    "payload": payload,
                    "payload_height": payload_height,
                    "time_limit": time_limit,
                    "visuals": render_mode is not None,
                    "random": 0,
                },
            )
            if like is None
            else suite.twin(like._environment)
        )
        self._task: DrivingTask = self._environment.task
        self._physics: suite.Physics = self._environment.physics
        first = self._environment.reset().observation
        self._scaled = ScaledObservations(first, self._task.scales)
        self.observation_names = self._scaled.names
        self.observation_space = self._scaled.space
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (len(self._task.actions),), np.float32)

    @property
    def physics(self) -> suite.Physics:
        """MuJoCo's model and data with named getters."""
        return self._physics

    @property
    def steps_per_action(self) -> int:
        """Time steps of the physics that an action is held for."""
        return round(self._environment.control_timestep() / self._physics.timestep())

    @property
    def task(self) -> DrivingTask:
        """The suite's task."""
        return self._task

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Starts an episode; the same seed gives the same episode."""
        super().reset(seed=seed, options=options)
        self._task.random.seed(int(self.np_random.integers(2**31)))
        step = self._environment.reset()
        return self._scaled(step.observation), self._task.info(self._physics)

    def step(self, action: Action) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Holds the action for 0.1 s.

        Raises:
          InputError: not one finite number for each of the task's actions.
        """
        step = self._environment.step(read_action(action, (len(self._task.actions),)))
        # In dm_env a failure has discount 0, the end of the time discount 1.
        terminated = bool(step.last() and step.discount == 0.0)
        truncated = bool(step.last() and not terminated)
        reward = float(step.reward)
        self._picture.show(self._physics.model.ptr, self._physics.data.ptr)
        return (
            self._scaled(step.observation),
            reward,
            terminated,
            truncated,
            self._task.info(self._physics),
        )

    def render(self) -> Any:
        """A picture (360, 640, 3) of bytes; None in a window or without a render mode.

        Raises:
          RenderError: there is no OpenGL here.
        """
        return self._picture.draw(self._physics.model.ptr, self._physics.data.ptr)

    def close(self) -> None:
        """Closes renderer and window."""
        self._picture.close()
