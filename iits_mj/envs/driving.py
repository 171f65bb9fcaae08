"""Gymnasium environments of the suite's driving tasks."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import gymnasium
import numpy as np

from iits_mj import suite
from iits_mj.core.checks import read_action
from iits_mj.core.errors import InputError
from iits_mj.envs.family import Family, Trucks
from iits_mj.envs.picture import RENDER_MODES, Action, Observation, Picture, ScaledObservations
from iits_mj.suite.tasks import DrivingTask
from iits_mj.truck.truck import without_sensors

if TYPE_CHECKING:
    from dm_control.rl import control


class DrivingEnv(gymnasium.Env[Observation, Action]):
    """A task of the suite, with its scaled observations as one vector.

    An action has the task's controls (`drive`, and `steer` where it is used), each in [-1, 1], and
    is held for the task's `period`. Each observation is divided by the task's scale and clipped to
    [-5, 5]; `observation_names` names the vector's elements. The reward is the task's, in [0, 1];
    its factors are in `info` as `reward_<name>`. An episode is terminated when the task fails
    (truck off its lane) and truncated at the task's time limit. All versions are v0.

    Args:
      task: name in `iits_mj.suite.TASKS_BY_DOMAIN["truck"]`.
      truck: see `Truck.load`; of several, each episode drives one, drawn with the environment's
        generator, whose name is in `info` as `truck`.
      payload: of all units together [kg]; default: the greatest of each truck.
      payload_height: of the loads' centers of gravity above the road [m].
      plant: model of the truck's motion; see `iits_mj.Truck.load`. For a planar one, `info` has the
        limits of its validity that the episode has exceeded as `left_range`.
      time_limit: of an episode [s]; default: the task's.
      render_mode: None, "rgb_array" (needs OpenGL) or "human" (needs a display).
      camera: of the pictures: "chase", "side" or "cab".
      like: environment of the same task and settings; the two share the compiled model, and must
        not step in several threads at the same time.

    Attributes:
      family: the trucks.
      task: of the suite; physics: MuJoCo's model and data with named getters, of the episode.
      steps_per_action: time steps of the physics per action.

    Raises:
      InputError: unknown task, truck, camera or render mode, or payload out of range.
    """

    metadata: dict[str, Any] = {"render_modes": RENDER_MODES, "render_fps": 10}  # noqa: RUF012 - Gymnasium's way

    def __init__(
        self,
        task: str,
        *,
        truck: Trucks = None,
        payload: float | None = None,
        payload_height: float | None = None,
        plant: str = "full",
        time_limit: float | None = None,
        render_mode: str | None = None,
        camera: str = "chase",
        like: DrivingEnv | None = None,
    ) -> None:
        self.render_mode = render_mode
        self._picture = Picture(render_mode, camera)
        self.family: Family = (
            Family(truck, payload, payload_height) if like is None else like.family
        )
        self._like = like
        self._settings = {
            "payload": payload,
            "payload_height": payload_height,
            "plant": plant,
            "time_limit": time_limit,
            "visuals": render_mode is not None,
            "random": 0,
        }
        self._name = task
        # Of each truck that has driven.
        self._environments: dict[int, control.Environment] = {}
        self._use(0)
        self.steps_per_action = round(
            self._environment.control_timestep() / self.physics.timestep()
        )
        self.metadata = {**self.metadata, "render_fps": round(1.0 / self.task.period)}
        self._environment.reset()
        self._scaled = ScaledObservations(self.task.observed)
        self.observation_names = self._scaled.names
        self.observation_space = self._scaled.space
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (len(self.task.actions),), np.float32)
        # Steps until the time limit, not always a whole number; 0 outside an episode.
        self._steps_left = 0.0

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Starts an episode; the same seed gives the same episode."""
        super().reset(seed=seed, options=options)
        self._use(self.family.draw(self.np_random))
        self.task.random.seed(int(self.np_random.integers(2**31)))
        self._environment.reset()
        self._steps_left = self._environment._step_limit
        return self._seen(), self._info(self.task.reward_terms(self.physics))

    def step(self, action: Action) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Holds the action for the task's `period`.

        Raises:
          InputError: not one finite number for each of the task's actions, or no episode has begun.
        """
        values = read_action(action, (len(self.task.actions),)).tolist()
        self.begin(values)
        with without_sensors(self.physics.truck.model):
            self.advance()
        self.physics.update_sensors()
        return self.finish()

    def begin(self, values: list[float]) -> None:
        """Starts a step with an action of finite numbers.

        `advance`, `physics.update_sensors` and `finish` complete it.

        Raises:
          InputError: no episode has begun.
        """
        if self._steps_left <= 0.0:
            raise InputError("the episode has not begun: call reset first")
        self.task.act(values, self.physics)

    def advance(self) -> None:
        """Steps the physics by the task's `period`."""
        self.physics.step(self.steps_per_action)

    def finish(self) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Returns what `step` returns."""
        task, physics = self.task, self.physics
        with physics.held():
            task.after_step(physics)
            terms = task.reward_terms(physics)
            observation, info = self._seen(), self._info(terms)
            failed = task.get_termination(physics) is not None
        self._steps_left -= 1.0
        # As in dm_control, an episode that fails in its last step is over by time.
        truncated = self._steps_left <= 0.0
        terminated = failed and not truncated
        if terminated:
            self._steps_left = 0.0
        if self.render_mode is not None:
            self._picture.show(physics.model.ptr, physics.data.ptr)
        return observation, math.prod(terms.values()), terminated, truncated, info

    def environment_of(self, number: int) -> control.Environment:
        """Returns the suite's environment of a truck of the family; the first call compiles it."""
        if number not in self._environments:
            self._environments[number] = (
                suite.load(
                    "truck",
                    self._name,
                    task_kwargs={"truck": self.family.members[number], **self._settings},
                )
                if self._like is None
                else suite.twin(self._like.environment_of(number))
            )
        return self._environments[number]

    def _use(self, number: int) -> None:
        """Makes a truck of the family drive."""
        self._number = number
        self._environment = self.environment_of(number)
        self.task: DrivingTask = self._environment.task
        self.physics: suite.Physics = self._environment.physics

    def _info(self, terms: dict[str, float]) -> dict[str, Any]:
        info = {**self.task.info(self.physics, terms), **self.family.info(self._number)}
        truck = self.physics.truck
        return info if truck.planar is None else {**info, "left_range": "; ".join(truck.left_range)}

    def _seen(self) -> Observation:
        return self._scaled(self.task.values(self.physics))

    def render(self) -> Any:
        """Returns a picture (360, 640, 3) of bytes; None in a window or without a render mode.

        Raises:
          RenderError: OpenGL is missing.
        """
        return self._picture.draw(self.physics.model.ptr, self.physics.data.ptr)

    def close(self) -> None:
        """Ends the episode, the renderer and the window."""
        self._steps_left = 0.0
        self._picture.close()
