"""Low-level driving environments for Gymnasium, on the tasks of `iits_mj.suite`."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from dm_control.rl import control
from numpy.typing import NDArray

from iits_mj import suite
from iits_mj.errors import InputError, RenderError
from iits_mj.suite.tasks import DrivingTask

Observation = NDArray[np.float32]
Action = NDArray[np.float32]

OBSERVATION_MAX = 5.0
RENDER_SIZE = (360, 640)


class DrivingEnv(gymnasium.Env[Observation, Action]):
    """A task of the suite, its observations scaled and laid side by side.

    The controls are those of the task (`drive`, and `steer` where it is used), each in [-1, 1],
    held for 0.1 s. Each observation is divided by the task's scale and clipped to [-5, 5]; their
    names and places are in `observation_names`. The reward is the task's, in [0, 1]; its factors
    are in `info` as `reward_<name>`. An episode is terminated when the task fails (truck off its
    lane) and truncated at the task's time limit.

    Args:
      task: name in `iits_mj.suite.TASKS_BY_DOMAIN["truck"]`.
      payload: on the semitrailer [kg].
      payload_height: of the load's centre of gravity above the road [m], 1.3 to 3.
      time_limit: of an episode [s]; default the task's.
      render_mode: None or "rgb_array" (needs OpenGL).
      camera: of the pictures: "chase", "side" or "cab".

    Raises:
      InputError: unknown task, camera or render mode, payload out of range.
    """

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 10}  # noqa: RUF012 - Gymnasium's way

    def __init__(
        self,
        task: str,
        *,
        payload: float = 36_000.0,
        payload_height: float | None = None,
        time_limit: float | None = None,
        render_mode: str | None = None,
        camera: str = "chase",
    ) -> None:
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise InputError(f"render_mode {render_mode!r} is not known; use 'rgb_array' or None")
        self.render_mode = render_mode
        self.camera = camera
        self._environment: control.Environment = suite.load(
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
        self._task: DrivingTask = self._environment.task
        self._physics: suite.Physics = self._environment.physics
        first = self._environment.reset().observation
        self.observation_names = tuple(
            name if len(values) == 1 else f"{name}[{i}]"
            for name, values in first.items()
            for i in range(len(values))
        )
        size = len(self.observation_names)
        self.observation_space = gymnasium.spaces.Box(
            -OBSERVATION_MAX, OBSERVATION_MAX, (size,), np.float32
        )
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (len(self._task.actions),), np.float32)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Starts an episode; the same seed gives the same episode."""
        super().reset(seed=seed, options=options)
        self._task.random.seed(int(self.np_random.integers(2**31)))
        step = self._environment.reset()
        return self._observation(step.observation), self._info()

    def step(self, action: Action) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Holds the action for 0.1 s."""
        values = np.asarray(action, dtype=float)
        if values.shape != self.action_space.shape or not np.isfinite(values).all():
            raise InputError(f"action {action!r}: {self.action_space.shape} finite numbers wanted")
        step = self._environment.step(values)
        # dm_env tells a failure (discount 0) from the end of the time (discount 1).
        terminated = bool(step.last() and step.discount == 0.0)
        truncated = bool(step.last() and not terminated)
        reward = float(step.reward)
        return self._observation(step.observation), reward, terminated, truncated, self._info()

    def render(self) -> Any:
        """A picture (360, 640, 3) of bytes, or None without a render mode.

        Raises:
          RenderError: there is no OpenGL here.
        """
        if self.render_mode is None:
            return None
        height, width = RENDER_SIZE
        try:
            return self._physics.render(height, width, camera_id=self.camera)
        except (RuntimeError, AttributeError, ImportError) as error:
            raise RenderError(
                f"no OpenGL for pictures ({error}): install libegl1 libgl1-mesa-dri libopengl0 and "
                "set MUJOCO_GL=egl"
            ) from error

    def close(self) -> None:
        """Frees the physics."""
        self._environment.close()

    def _observation(self, values: dict[str, NDArray[np.float64]]) -> Observation:
        scales = self._task.scales
        parts = [values[name] / scales[name] for name in values]
        flat = np.clip(np.concatenate(parts), -OBSERVATION_MAX, OBSERVATION_MAX)
        return flat.astype(np.float32)

    def _info(self) -> dict[str, Any]:
        ego = self._physics.ego()
        terms = self._task.reward_terms(self._physics)
        return {
            "time": ego.time,
            "speed": ego.speed,
            "station": ego.station,
            "fuel_used": ego.fuel_used,
            **{f"reward_{name}": value for name, value in terms.items()},
        }


class CruiseEnv(DrivingEnv):
    """Hold 20 m/s over hills.

    Action (1): `drive`, above 0 the pedal, below the brakes to 4 m/s2.

    | observation            | divided by | unit  |
    |------------------------|------------|-------|
    | speed                  | 25         | m/s   |
    | acceleration           | 2          | m/s2  |
    | gear                   | 12         |       |
    | engine_speed           | 220        | rad/s |
    | engine_torque          | 2700       | N m   |
    | brake_pressure         | 8e5        | Pa    |
    | speed_error            | 5          | m/s   |
    | grade_ahead[0] .. [5]  | 0.05       |       |

    `grade_ahead`: here and 25, 50, 100, 200, 400 m ahead. Reward: `speed` x `comfort`. Truncated
    after 60 s. Version history: v0, first.
    """

    def __init__(self, **settings: Any) -> None:
        super().__init__("cruise", **settings)


class LaneKeepEnv(DrivingEnv):
    """Keep truck and trailer in the lane of a winding road at 20 m/s.

    Actions (2): `drive` as in `CruiseEnv`; `steer`, steering wheel to +/-90 degrees.

    | observation               | divided by | unit  |
    |---------------------------|------------|-------|
    | the six instruments       | as above   |       |
    | speed_error               | 5          | m/s   |
    | lane_error, trailer_error | 1          | m     |
    | heading_error             | 0.1        | rad   |
    | articulation              | 0.1        | rad   |
    | yaw_rate                  | 0.1        | rad/s |
    | steering_wheel_angle      | 1          | rad   |
    | curvature_ahead[0] .. [3] | 0.002      | 1/m   |

    `curvature_ahead`: here and 25, 50, 100 m ahead. Reward: `lane` x `trailer` x `speed` x
    `comfort`. Terminated when truck or trailer is 2 m from the lane's middle, truncated after 60 s.
    Version
    history: v0, first.
    """

    def __init__(self, **settings: Any) -> None:
        super().__init__("lane_keep", **settings)
