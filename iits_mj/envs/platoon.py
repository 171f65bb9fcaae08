"""A platoon of trucks, one agent each, with PettingZoo's parallel interface.

    environment = PlatoonEnv(payloads=(36_000.0, 12_000.0, 36_000.0))
    observations, infos = environment.reset(seed=0)
    while environment.agents:
        actions = {agent: policy(observations[agent]) for agent in environment.agents}
        observations, rewards, terminated, truncated, infos = environment.step(actions)

PettingZoo does not have to be installed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import gymnasium
import mujoco
import numpy as np
from numpy.typing import NDArray

from iits_mj.core.checks import in_range, positive, read_action
from iits_mj.core.context import Closing
from iits_mj.core.errors import InputError
from iits_mj.core.timing import CYCLE_PERIOD, TIMESTEP
from iits_mj.envs.family import Trucks
from iits_mj.envs.picture import RENDER_MODES, Action, Observation, Picture, ScaledObservations
from iits_mj.suite import scene
from iits_mj.suite.physics import Physics, add_cameras
from iits_mj.suite.tasks import Platoon
from iits_mj.truck.fleet import TruckFleet, prefix
from iits_mj.truck.placement import TruckPlacement

SPEEDS = (14.0, 20.0)
# Duration of a set speed [s].
HOLDS = (8.0, 15.0)
TRUCKS = (2, 8)


class PlatoonEnv(Closing):
    """A platoon on a winding road, as a `pettingzoo.ParallelEnv`; agents `truck0`, `truck1`, ...

    The first truck holds a set speed of 14 to 20 m/s, which changes every 8 to 15 s and which no
    other truck observes. Every other truck keeps 5 m plus `time_gap` to the truck ahead. All keep
    the right lane. Actions are `drive` and `steer` in [-1, 1], held for 0.1 s, as in
    `iits_mj.suite`. Observations are those of `iits_mj.suite.tasks.Platoon`, divided by their
    scales and clipped to [-5, 5]; `observation_names` names them. Rewards are in [0, 1], their
    factors in the infos as `reward_<name>`.

    A truck that leaves its lane, rolls over or touches another truck is terminated, which truncates
    the episode for the others; all are truncated at the time limit. Version history: v0, first.

    Args:
      payloads: of the trucks [kg], from the first to the last, 2 to 8; None: the truck's greatest.
      truck: of all, or one for each payload; see `Truck.load`. The trucks share one model, so that
        a platoon of randomly drawn trucks is another environment.
      time_gap: [s], 0.3 to 3.
      time_limit: of an episode [s], up to 120.
      render_mode: None, "rgb_array" (needs OpenGL) or "human" (needs a display).
      camera: of the pictures, on the last truck: "chase", "side" or "cab".

    Attributes:
      fleet: the trucks; tasks: of the agents.

    Raises:
      InputError: an argument is not allowed.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012 - Gymnasium's way
        "render_modes": RENDER_MODES,
        "render_fps": 10,
        "name": "platoon_v0",
    }

    def __init__(
        self,
        payloads: Sequence[float | None] = (None,) * 3,
        *,
        truck: Trucks = None,
        time_gap: float = 1.0,
        time_limit: float = 40.0,
        render_mode: str | None = None,
        camera: str = "chase",
    ) -> None:
        in_range("number of payloads", len(payloads), *TRUCKS)
        in_range("time_gap", time_gap, 0.3, 3.0, "s")
        positive("time_limit", time_limit, "s")
        in_range("time_limit", time_limit, 0.0, 120.0, "s")
        self.render_mode = render_mode
        last = prefix(len(payloads) - 1)
        self._picture = Picture(render_mode, camera, last)
        self._time_limit = time_limit

        def edit_spec(spec: mujoco.MjSpec) -> None:
            for number in range(len(payloads)):
                add_cameras(spec, prefix(number))

        self.fleet = TruckFleet.load(
            payloads,
            route=scene.winding(),
            truck=truck,
            timestep=TIMESTEP,
            visuals=render_mode is not None,
            edit_spec=edit_spec,
        )
        self._physics = Physics.of_fleet(self.fleet)
        ahead = (None, *self._physics[:-1])
        self.tasks = tuple(Platoon(leader, time_gap, random=0) for leader in ahead)
        self.possible_agents = [f"truck{number}" for number in range(len(payloads))]
        self.agents: list[str] = []
        self._scaled = ScaledObservations(Platoon.observed)
        self.observation_names = self._scaled.names
        self.observation_spaces = {
            name: gymnasium.spaces.Box(-5.0, 5.0, self._scaled.space.shape, np.float32)
            for name in self.possible_agents
        }
        self.action_spaces = {
            name: gymnasium.spaces.Box(-1.0, 1.0, (len(Platoon.actions),), np.float32)
            for name in self.possible_agents
        }
        self._random = np.random.default_rng()

    def observation_space(self, agent: str) -> gymnasium.spaces.Box:
        """Returns the observation space of an agent."""
        return self.observation_spaces[self._known(agent)]

    def action_space(self, agent: str) -> gymnasium.spaces.Box:
        """Returns the action space of an agent."""
        return self.action_spaces[self._known(agent)]

    @property
    def num_agents(self) -> int:
        """Number of agents in the running episode."""
        return len(self.agents)

    @property
    def max_num_agents(self) -> int:
        """Number of agents of an episode."""
        return len(self.possible_agents)

    @property
    def unwrapped(self) -> PlatoonEnv:
        """This environment."""
        return self

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Observation], dict[str, dict[str, Any]]]:
        """Starts an episode; the same seed gives the same episode, None continues the generator."""
        del options
        if seed is not None:
            self._random = np.random.default_rng(seed)
        random, route = self._random, self.fleet.route
        station = random.uniform(800.0, 2_400.0)
        common = random.uniform(16.0, 19.0)
        places = []
        for number, truck in enumerate(self.fleet.trucks):
            speed = common + random.uniform(-0.5, 0.5)
            if number:
                gap = self.tasks[number].wanted_gap(speed) + random.uniform(-3.0, 3.0)
                ahead = self.fleet.trucks[number - 1].footprint
                front = truck.footprint.front_overhang - ahead.front_overhang
                station -= ahead.length + front + gap
            offset = float(route.lane_offset(0, station)) + random.uniform(-0.2, 0.2)
            places.append(TruckPlacement(station=station, offset=offset, speed=speed))
        self.fleet.reset(places)
        self.tasks[0].target, self._until = common, 0.0
        self._set_speed()
        self.agents = list(self.possible_agents)
        return self._observations(), self._infos()

    def step(
        self, actions: Mapping[str, Action]
    ) -> tuple[
        dict[str, Observation],
        dict[str, float],
        dict[str, bool],
        dict[str, bool],
        dict[str, dict[str, Any]],
    ]:
        """Holds the actions for 0.1 s.

        Raises:
          InputError: no episode is running, or an agent has no action of finite numbers.
          Error: the physics diverged.
        """
        if not self.agents:
            raise InputError("the episode has not begun or is over: call reset first")
        if set(actions) != set(self.agents):
            raise InputError(f"actions of {sorted(actions)} are incomplete; use {self.agents}")
        for agent, task, physics in zip(self.agents, self.tasks, self._physics, strict=True):
            values = read_action(actions[agent], (len(task.actions),), f"action of {agent}")
            task.before_step(values, physics)
        self.fleet.step(round(CYCLE_PERIOD / TIMESTEP))
        self._set_speed()
        self._picture.show(self.fleet.model, self.fleet.data)
        observations, infos = self._observations(), self._infos()
        rewards = {
            agent: float(np.prod([v for k, v in info.items() if k.startswith("reward_")]))
            for agent, info in infos.items()
        }
        crashed = {number for pair in self.fleet.touching() for number in pair}
        terminated = {
            agent: number in crashed or task.get_termination(physics) is not None
            for number, (agent, task, physics) in enumerate(
                zip(self.agents, self.tasks, self._physics, strict=True)
            )
        }
        over = any(terminated.values()) or self.fleet.time >= self._time_limit - 1e-6
        truncated = {agent: over and not ended for agent, ended in terminated.items()}
        if over:
            self.agents = []
        return observations, rewards, terminated, truncated, infos

    def seen(self, agent: str) -> dict[str, NDArray[np.float64]]:
        """Returns an agent's observations by name, in SI units.

        Raises:
          InputError: unknown agent.
        """
        number = self.possible_agents.index(self._known(agent))
        return dict(self.tasks[number].get_observation(self._physics[number]))

    def state(self) -> Observation:
        """Returns the observations of all agents as one vector."""
        return np.concatenate(list(self._observations().values()))

    def render(self) -> Any:
        """Returns a picture (360, 640, 3) of bytes; None in a window or without a render mode.

        Raises:
          RenderError: OpenGL is missing.
        """
        return self._picture.draw(self.fleet.model, self.fleet.data)

    def close(self) -> None:
        """Closes renderer and window."""
        self._picture.close()

    def _known(self, agent: str) -> str:
        if agent not in self.possible_agents:
            raise InputError(f"agent {agent!r} is unknown; use one of {self.possible_agents}")
        return agent

    def _set_speed(self) -> None:
        """Draws the next set speed of the first truck when the present one has expired."""
        if self.fleet.time >= self._until:
            if self.fleet.time > 0.0:
                self.tasks[0].target = float(self._random.uniform(*SPEEDS))
            self._until = self.fleet.time + float(self._random.uniform(*HOLDS))

    def _observations(self) -> dict[str, Observation]:
        members = zip(self.possible_agents, self.tasks, self._physics, strict=True)
        return {agent: self._scaled(task.values(physics)) for agent, task, physics in members}

    def _infos(self) -> dict[str, dict[str, Any]]:
        members = zip(self.possible_agents, self.tasks, self._physics, strict=True)
        return {
            agent: {
                **task.info(physics, task.reward_terms(physics)),
                "gap": task.gap(physics),
            }
            for agent, task, physics in members
        }
