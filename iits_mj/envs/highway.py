"""The paper's decision task for Gymnasium: three actions, the whole truck in SUMO traffic.

`HighwayFastEnv` is the same task without MuJoCo and SUMO, for the first million decisions. A world
of `controllers.decision.trip` defines the actions, the reward and the end of both.
"""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Any

import gymnasium
import numpy as np

from controllers.decision.base import DecisionContext
from controllers.decision.fast_world.env import HighwayEnv as FastWorld
from controllers.decision.observation import OBSERVATION_SIZE, usual_and_spread
from controllers.decision.trip import (
    ACTIONS,
    SPAWN_PROBABILITY,
    RewardConfig,
    RewardTerms,
    TripConfig,
    World,
    start_anywhere,
    usual_payload,
)
from iits_mj.core.checks import one_of
from iits_mj.core.errors import InputError
from iits_mj.core.timing import TIMESTEP
from iits_mj.envs.family import Family, Trucks
from iits_mj.envs.picture import RENDER_MODES, Observation, Picture, top_view

if TYPE_CHECKING:
    from iits_mj.simulation import Simulation
    from iits_mj.simulation.truck_world import TruckWorld

DENSITIES = {**SPAWN_PROBABILITY, "empty": 0.0}
# The paper's charges of a change are ten times as high, relative to that of the speed.
REWARD = RewardConfig(change=0.1, danger=0.2, speed=0.1, collision=30.0)
STANDARDIZED_MAX = 20.0
_USUAL, _SPREAD = usual_and_spread()


# Entries of a fast world's `info`, and the fields of its state.
FAST_INFO = {
    "time": "time",
    "speed": "speed",
    "station": "front",
    "lane": "lane",
    "lane_changes": "changes",
    "refused": "refused",
    "unsafe": "dangerous",
}


class DecisionEnv(gymnasium.Env[Observation, np.int64]):
    """The decision task in a world; its arguments are those of the environments."""

    def __init__(
        self,
        *,
        density: str = "medium",
        traffic_speed: float = 15.0,
        keeps_right: bool = False,
        speed: float = 60.0 / 3.6,
        duration: float = 120.0,
        truck: Trucks = None,
        payload: float | None = None,
        payload_height: float | None = None,
        reward: RewardConfig = REWARD,
        standardized: bool = True,
        render_mode: str | None = None,
    ) -> None:
        one_of("density", density, DENSITIES)
        modes = (None, *self.metadata["render_modes"])
        if render_mode not in modes:
            allowed = ", ".join(map(str, modes))
            raise InputError(f"render_mode {render_mode!r} is not known; use one of: {allowed}")
        self.render_mode = render_mode
        self.family, self.payload = Family(truck, payload, payload_height), payload
        self.trip = TripConfig(
            spawn_probability=DENSITIES[density],
            traffic_speed=traffic_speed,
            keeps_right=keeps_right,
            duration=duration,
            reference_speed=speed,
            reward=reward,
        )
        self.standardized = standardized
        most = STANDARDIZED_MAX if standardized else 1.0
        self.observation_space = gymnasium.spaces.Box(-most, most, (OBSERVATION_SIZE,), np.float32)
        self.action_space = gymnasium.spaces.Discrete(len(ACTIONS))

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Starts an episode; the same seed gives the same traffic."""
        super().reset(seed=seed, options=options)
        self._number = self.family.draw(self.np_random)
        trip = self._placed(self.trip_of(self._number))
        observation = self._open().reset(self.np_random, trip)
        return self.scaled(observation), self._info(RewardTerms())

    def step(self, action: np.int64) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Carries out a decision until the next one is due.

        Raises:
          InputError: unknown action, or no episode has begun.
        """
        if not self.action_space.contains(action):
            raise InputError(f"action {action!r} is unknown; use 0, 1 or 2")
        step = self._open().step(ACTIONS[int(action)])
        info = self._info(step.reward)
        observation, reward = self.scaled(step.observation), float(step.reward.total)
        return observation, reward, step.terminated, step.truncated, info

    def scaled(self, observation: Observation) -> Observation:
        """Returns observations of a world as the agent gets them, shape (..., 216)."""
        if not self.standardized:
            return observation
        return np.clip((observation - _USUAL) / _SPREAD, -STANDARDIZED_MAX, STANDARDIZED_MAX)

    def context(self) -> DecisionContext:
        """Returns what the decision makers of `controllers.decision` decide by, at this instant.

        Raises:
          InputError: no episode has begun.
        """
        return self._open().context()

    def trip_of(self, number: int) -> TripConfig:
        """Returns the trip of a truck of the family."""
        truck = self.family.members[number]
        payload = usual_payload(truck) if self.payload is None else self.payload
        return dataclasses.replace(self.trip, truck=truck, payload=payload)

    def _placed(self, trip: TripConfig) -> TripConfig:
        """Returns the trip with its place on the road."""
        return trip

    def _open(self) -> World:
        """Returns the world, which the first call makes."""
        raise NotImplementedError

    def _state(self) -> dict[str, Any]:
        """Returns the entries of `info` about the truck."""
        raise NotImplementedError

    def _info(self, terms: RewardTerms) -> dict[str, Any]:
        rewards = {f"reward_{k}": v for k, v in dataclasses.asdict(terms).items()}
        return {**self._state(), **rewards, **self.family.info(self._number)}


class HighwayEnv(DecisionEnv):
    """Decide on lane changes of the laden truck among SUMO vehicles on the built-in highway.

    Action: 0 change to the left, 1 keep, 2 change to the right. It takes effect within 0.1 s; the
    planner refuses a change that is not possible or not safe. A step lasts 1 s, or to the end of
    the lane change that it starts.

    Observation (216, float32): that of `controllers.decision.observation`, less its usual values
    and divided by its usual spread, in [-20, 20]. Without this, a difference of speed is 0.05, and
    a learner does not see it.

    Reward in `info` as `reward_<name>`:

    | term      | value                                                                       |
    |-----------|-----------------------------------------------------------------------------|
    | change    | -0.1 for action 0 or 2, refused or not                                      |
    | danger    | -0.2 more when a vehicle is the reason of the refusal                       |
    | speed     | -0.1 per second and m/s of difference from the reference speed              |
    | collision | -30                                                                         |

    The terms are the paper's with corrected signs. Relative to the speed, the paper's charges of a
    change are ten times as high; PPO with its defaults then learned never to change lanes, because
    a change costs at once and gains speed 10 to 60 s later. `reward=RewardConfig()` and
    `standardized=False` give the paper's reward and the observation in [-1, 1].

    An episode begins at a random place of the road, from which its duration fits the road.
    Terminated by a collision or a roll-over; truncated at the end of the time or of the road.
    Version history: v0, first.

    Args:
      density: of the traffic, "dense", "medium", "sparse" or "empty".
      traffic_speed: speed limit of the traffic [m/s].
      keeps_right: whether the traffic keeps right instead of filling both lanes.
      speed: reference speed of the truck [m/s].
      duration: of an episode [s].
      truck: see `Truck.load`; of several, each episode drives one, drawn with the environment's
        generator, whose name is in `info` as `truck`.
      payload: of all units together [kg]; default: 12 t, or a truck's greatest where that is less.
      payload_height: of the loads' centers of gravity above the road [m].
      reward: weights of the terms, see `controllers.decision.trip.RewardConfig`.
      standardized: whether the observation is standardized.
      plant: model of the truck's motion; see `iits_mj.Truck.load`. For a planar one, `info` has the
        limits of its validity that the episode has exceeded as `left_range`.
      aeb: whether emergency braking guards the truck; its stage is in `info` as `aeb`.
      sensors: what the truck knows of the traffic, see `DriveConfig`.
      render_mode: None, "rgb_array" (needs OpenGL) or "human" (needs a display).
      camera: of the pictures: "chase", "side" or "cab".
      timestep: of the physics [s]; a drive has 0.002, and 0.005 trains as well in less time.

    Raises:
      InputError: an argument is not allowed. TrafficError: SUMO is not usable.
    """

    metadata: dict[str, Any] = {"render_modes": RENDER_MODES, "render_fps": 1}  # noqa: RUF012 - Gymnasium's way

    def __init__(
        self,
        *,
        density: str = "medium",
        traffic_speed: float = 15.0,
        keeps_right: bool = False,
        speed: float = 60.0 / 3.6,
        duration: float = 120.0,
        truck: Trucks = None,
        payload: float | None = None,
        payload_height: float | None = None,
        reward: RewardConfig = REWARD,
        standardized: bool = True,
        plant: str = "full",
        aeb: bool = False,
        sensors: str = "perfect",
        render_mode: str | None = None,
        camera: str = "chase",
        timestep: float = TIMESTEP,
    ) -> None:
        if not isinstance(aeb, bool):
            raise InputError(f"aeb {aeb!r}: allowed is True or False")
        # Load SUMO only for this environment.
        from iits_mj.simulation.sensors import CHOICES

        one_of("sensors", sensors, CHOICES)
        self._picture = Picture(render_mode, camera)
        super().__init__(
            density=density,
            traffic_speed=traffic_speed,
            keeps_right=keeps_right,
            speed=speed,
            duration=duration,
            truck=truck,
            payload=payload,
            payload_height=payload_height,
            reward=reward,
            standardized=standardized,
            render_mode=render_mode,
        )
        self.payload_height = payload_height
        self.plant = plant
        self.aeb, self.sensors = aeb, sensors
        self.timestep = timestep
        self._world: TruckWorld | None = None

    def step(self, action: np.int64) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Carries out a decision until the next one is due.

        Raises:
          InputError: unknown action, or no episode has begun.
        """
        outcome = super().step(action)
        self._picture.show(self.simulation.truck.model, self.simulation.truck.data)
        return outcome

    def render(self) -> Any:
        """Returns a picture (360, 640, 3) of bytes; None in a window or without a render mode.

        Raises:
          RenderError: OpenGL is missing.
        """
        truck = self.simulation.truck
        return self._picture.draw(truck.model, truck.data)

    def close(self) -> None:
        """Ends SUMO, the renderer and the window."""
        self._picture.close()
        if self._world is not None:
            self._world.close()
            self._world = None

    def _placed(self, trip: TripConfig) -> TripConfig:
        return start_anywhere(trip, self.np_random)

    def _open(self) -> TruckWorld:
        if self._world is None:
            # Load SUMO only for this environment.
            from iits_mj.simulation.truck_world import TruckWorld
            from iits_mj.suite.physics import add_cameras

            self._world = TruckWorld(
                self.timestep,
                payload_height=self.payload_height,
                plant=self.plant,
                aeb=self.aeb,
                sensors=self.sensors,
                visuals=self.render_mode is not None,
                edit_spec=add_cameras,
            )
        return self._world

    @property
    def simulation(self) -> Simulation:
        """The drive of the episode."""
        return self._open().running

    def _state(self) -> dict[str, Any]:
        simulation = self.simulation
        frame, truck = simulation.frame, simulation.truck
        limits = {} if truck.planar is None else {"left_range": "; ".join(truck.left_range)}
        return {
            "time": frame.time,
            "speed": frame.ego.speed,
            "station": frame.ego.station,
            "lane": frame.lane,
            "lane_changes": frame.lane_changes,
            "refused": frame.refused,
            "unsafe": simulation.stack.unsafe,
            "ended": simulation.ended,
            **limits,
            **({} if frame.emergency is None else {"aeb": frame.emergency.state.value}),
        }


class HighwayFastEnv(DecisionEnv):
    """`iits_mj/Highway-v0` without MuJoCo and SUMO, hundreds of times as fast.

    Actions, observation, reward and traffic parameters are those of `HighwayEnv`. The truck is a
    point mass with the same power limits, the highway has random hills, and the other vehicles
    follow the same car-following and lane-change laws, in C++. The shipped policy was trained here,
    see `docs/training.md`. `gymnasium.make_vec` steps many environments in one call.

    Terminated by a collision; truncated at the end of the time or of the road. Version history: v0,
    first.

    Args:
      density: of the traffic, "dense", "medium", "sparse" or "empty".
      traffic_speed: speed limit of the traffic [m/s].
      keeps_right: whether the traffic keeps right instead of filling both lanes.
      speed: reference speed of the truck [m/s].
      duration: of an episode [s].
      truck: see `Truck.load`; of several, each episode drives one, drawn with the environment's
        generator, whose name is in `info` as `truck`.
      payload: of all units together [kg]; default: 12 t, or a truck's greatest where that is less.
      lanes: of the highway, 2 or 3.
      truck_speed_limit: of the other trucks [m/s]; default: the traffic's.
      ramp_probability: of a vehicle per second on each on-ramp, every 2 km; 0 without ramps.
      reward: weights of the terms, see `controllers.decision.trip.RewardConfig`.
      standardized: whether the observation is standardized.
      render_mode: None, or "rgb_array": the road from above.

    Raises:
      InputError: an argument is not allowed.
    """

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 1}  # noqa: RUF012 - Gymnasium's way

    def __init__(
        self,
        *,
        density: str = "medium",
        traffic_speed: float = 15.0,
        keeps_right: bool = False,
        speed: float = 60.0 / 3.6,
        duration: float = 120.0,
        truck: Trucks = None,
        payload: float | None = None,
        lanes: int = 2,
        truck_speed_limit: float | None = None,
        ramp_probability: float = 0.0,
        reward: RewardConfig = REWARD,
        standardized: bool = True,
        render_mode: str | None = None,
    ) -> None:
        super().__init__(
            density=density,
            traffic_speed=traffic_speed,
            keeps_right=keeps_right,
            speed=speed,
            duration=duration,
            truck=truck,
            payload=payload,
            reward=reward,
            standardized=standardized,
            render_mode=render_mode,
        )
        self.trip = dataclasses.replace(
            self.trip,
            lanes=lanes,
            truck_speed_limit=truck_speed_limit,
            ramp_probability=ramp_probability,
        )
        self._world = FastWorld()

    def render(self) -> Any:
        """Returns a picture (360, 640, 3) of bytes; None without a render mode."""
        if self.render_mode is None:
            return None
        scene = self.context().scene
        others = scene.neighbors
        columns = others.front_distance, others.offset, others.length
        truck = (0.0, scene.ego.offset, scene.footprint.length)
        return top_view([truck, *zip(*(c.tolist() for c in columns), strict=True)], self.trip.lanes)

    def close(self) -> None:
        """Ends the episode."""
        self._world.close()

    def _open(self) -> FastWorld:
        return self._world

    def _state(self) -> dict[str, Any]:
        state = self._world.state
        return {name: state[field].item() for name, field in FAST_INFO.items()}
