"""The published truck scenario of Hoel et al. (2020) for Gymnasium."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import gymnasium
import numpy as np

from iits_mj.core.checks import one_of
from iits_mj.core.errors import InputError
from iits_mj.envs.picture import Observation, top_view
from traffic_bridge.hoel2020 import ACTIONS, LANE_WIDTH, LANES, OBSERVATION_SIZE, HoelHighway

_OBSERVATION_MAX = 5.0


class Hoel2020Env(gymnasium.Env[Observation, np.int64]):
    """Choose speed and lane of a truck among 24 cars on three lanes, as published in 2020.

    The scenario of Hoel, Wolff and Laine, "Tactical Decision-Making in Autonomous Driving by
    Reinforcement Learning with Uncertainty Estimation" (arXiv 2004.10439), with the figures of
    their program: a truck of 16 m at up to 25 m/s, slower cars ahead, faster ones behind, all in
    SUMO, without MuJoCo. A step lasts 1 s and a lane change 4 s. Nothing guards the truck.

    Action: 0 to 3 keep the lane with 0, 1, -1 and -4 m/s2; 4 to 6 change to the left with 0, 1 and
    -1 m/s2; 7 to 9 change to the right likewise.

    Observation (104, float32): lateral place, speed, direction of a lane change, 0; then for each
    car within 200 m distance, lateral distance, relative speed and relative lateral speed, all
    scaled; -1, 0, 0, 0 where there is no car.

    Reward: speed over 25 m/s, less 1 for a lane change, 10 for a collision or leaving the road, 10
    for a gap below 2.5 m, and 10 when a car close behind brakes harder than 4.5 m/s2.

    Terminated by a collision or beside the road; truncated after 100 steps. `iits-mj evaluate
    --scenario hoel2020` compares decision makers in it. Version history: v0, first.

    Args:
      render_mode: None, or "rgb_array": the road from above.

    Raises:
      InputError: an argument is not allowed. TrafficError: SUMO is not usable.
    """

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 1}  # noqa: RUF012 - Gymnasium's way

    def __init__(self, *, render_mode: str | None = None) -> None:
        if render_mode is not None:
            one_of("render_mode", render_mode, self.metadata["render_modes"])
        self.render_mode = render_mode
        self.observation_space = gymnasium.spaces.Box(
            -_OBSERVATION_MAX, _OBSERVATION_MAX, (OBSERVATION_SIZE,), np.float32
        )
        self.action_space = gymnasium.spaces.Discrete(len(ACTIONS))
        self._world: HoelHighway | None = None

    @property
    def world(self) -> HoelHighway:
        """The vehicles."""
        if self._world is None:
            self._world = HoelHighway()
        return self._world

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Starts an episode; the same seed gives the same traffic."""
        super().reset(seed=seed, options=options)
        return self._seen(self.world.reset(self.np_random)), self._info()

    def step(self, action: np.int64) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Carries out an action for one second.

        Raises:
          InputError: unknown action, or no episode has begun.
        """
        if not self.action_space.contains(action):
            raise InputError(f"action {action!r} is unknown; use 0 to {len(ACTIONS) - 1}")
        step = self.world.step(int(action))
        info = self._info() | asdict(step)
        return self._seen(self.world.observation()), step.reward, step.terminated, False, info

    def render(self) -> Any:
        """Returns a picture (360, 640, 3) of bytes; None without a render mode."""
        if self.render_mode is None:
            return None
        scene, world = self.world.scene(), self.world
        others = [(v.station + 0.5 * v.length, v.offset, v.length) for v in scene.vehicles]
        truck = (float(world.front[0]), scene.ego.offset, scene.footprint.length)
        return top_view(
            [(front - truck[0], offset, length) for front, offset, length in (truck, *others)],
            LANES,
            LANE_WIDTH,
        )

    def close(self) -> None:
        """Ends SUMO."""
        if self._world is not None:
            self._world.close()
            self._world = None

    def _seen(self, observation: Observation) -> Observation:
        return np.clip(observation, -_OBSERVATION_MAX, _OBSERVATION_MAX)

    def _info(self) -> dict[str, Any]:
        world = self.world
        return {"speed": float(world.speed[0]), "lane": world.lane, "time": world.step_number}
