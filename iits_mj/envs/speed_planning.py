"""Environment for predictive cruise control: the agent sets the speed over hills."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np

from iits_mj.core.checks import in_range, read_action
from iits_mj.core.errors import InputError
from iits_mj.core.messages import Scene, SpeedProfile
from iits_mj.core.neighbors import Neighbor
from iits_mj.core.timing import TIMESTEP
from iits_mj.envs.family import Family, Trucks
from iits_mj.envs.picture import RENDER_MODES, Action, Observation, Picture
from iits_mj.simulation import DriveConfig, Simulation
from iits_mj.simulation.parts import load_map
from iits_mj.suite.physics import add_cameras

PERIOD = 5.0  # [s] between two decisions
PREVIEW = tuple(np.arange(0.0, 2_001.0, 200.0).tolist())
SLOWEST, FASTEST = 0.8, 1.1  # of the reference speed
# Cost of time in fuel [kg/s]: small, so that fuel decides. At a driver's wage, about 6e-3, the
# highest speed is optimal everywhere.
TIME_VALUE = 1.5e-3
# Fuel equivalent of kinetic energy [kg/J]: diesel of 42.7 MJ/kg at an efficiency of 0.42.
KINETIC_VALUE = 1.0 / (0.42 * 42.7e6)
# No episode reaches this last part of the road [m].
_END = 1_000.0


class SetSpeed:
    """A reference speed that the environment sets.

    Attributes:
      speed: [m/s].
    """

    def __init__(self, speed: float) -> None:
        self.speed = speed

    def reset(self) -> None:
        """Does nothing: a set speed has no state."""

    def update(self, scene: Scene, find_leader: Callable[[], Neighbor | None]) -> SpeedProfile:
        """Returns the set speed at every station."""
        del scene, find_leader
        return SpeedProfile(np.zeros(1), np.full(1, self.speed))

    def at(self, station: float) -> float:
        """Returns the set speed [m/s]."""
        del station
        return self.speed

    free = at


class SpeedPlanningEnv(gymnasium.Env[Observation, Action]):
    """Set the speed of the laden truck over the built-in highway's hills, without traffic.

    Action (1), in [-1, 1]: set speed for the next 5 s, from 0.8 to 1.1 of the reference speed; 1/3
    is the reference speed itself. The speed tracking of a drive follows the set speed.

    | observation              | divided by        | unit  |
    |--------------------------|-------------------|-------|
    | speed                    | reference speed   | m/s   |
    | set speed                | reference speed   | m/s   |
    | gear                     | 12                | 1     |
    | engine speed             | 220               | rad/s |
    | time lost on a drive at the reference speed | 60 | s |
    | grade here and every 200 m to 2 000 m ahead | 0.05 | 1 |

    Reward in kg of fuel, in `info` as `reward_<name>`:

    | term | value                                                                       |
    |------|-----------------------------------------------------------------------------|
    | fuel | minus the fuel burnt                                                        |
    | time | minus the time lost against the reference speed, at 1.5 g of fuel a second  |
    | kinetic | fuel equivalent of the kinetic energy gained: braking at the end gains nothing |

    Truncated after `length`, never terminated. Version history: v0, first.

    Args:
      speed: reference speed [m/s].
      length: of an episode [m].
      truck: see `Truck.load`; of several, each episode drives one, drawn with the environment's
        generator, whose name is in `info` as `truck`.
      payload: of all units together [kg]; default: the greatest of each truck.
      plant: model of the truck's motion; see `iits_mj.Truck.load`.
      render_mode: None, "rgb_array" (needs OpenGL) or "human" (needs a display).
      camera: of the pictures: "chase", "side" or "cab".
      timestep: of the physics [s].

    Raises:
      InputError: an argument is not allowed.
    """

    metadata: dict[str, Any] = {"render_modes": RENDER_MODES, "render_fps": 1}  # noqa: RUF012 - Gymnasium's way

    def __init__(
        self,
        *,
        speed: float = 60.0 / 3.6,
        length: float = 5_000.0,
        truck: Trucks = None,
        payload: float | None = None,
        plant: str = "full",
        render_mode: str | None = None,
        camera: str = "chase",
        timestep: float = TIMESTEP,
    ) -> None:
        in_range("length", length, 100.0, 12_000.0, "m")
        self.render_mode = render_mode
        self._picture = Picture(render_mode, camera)
        self._speed, self._length = speed, length
        self._payload, self._plant, self._timestep = payload, plant, timestep
        self.family, self._number = Family(truck, payload), 0
        self._simulation: Simulation | None = None
        self._reference = SetSpeed(speed)
        size = 5 + len(PREVIEW)
        self.observation_space = gymnasium.spaces.Box(-5.0, 5.0, (size,), np.float32)
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (1,), np.float32)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Starts at a random station, at 0.9 to 1.05 of the reference speed."""
        super().reset(seed=seed, options=options)
        self.close()
        self._number = self.family.draw(self.np_random)
        last = load_map(None).route().length - _END - self._length
        config = DriveConfig(
            speed=self._speed * FASTEST,
            duration=3_600.0,
            truck=self.family.members[self._number],
            payload=self._payload,
            plant=self._plant,
            start_station=float(self.np_random.uniform(60.0, last)),
            start_speed=self._speed * float(self.np_random.uniform(0.9, 1.05)),
            traffic_mode="none",
            decision="keep",
            speed_planner="cruise",
        )
        self._simulation = Simulation(
            config,
            edit_spec=add_cameras,
            visuals=self.render_mode is not None,
            timestep=self._timestep,
        )
        self._reference.speed = self._speed
        self._simulation.stack.reference = self._reference
        self._time = 0.0
        return self._observation(), self._info(0.0, 0.0, 0.0)

    def step(self, action: Action) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Drives for 5 s at the set speed.

        Raises:
          InputError: the action is not one finite number, or no episode has begun.
        """
        values = read_action(action, (1,))
        simulation = self._running()
        share = 0.5 * (1.0 + float(np.clip(values[0], -1.0, 1.0)))
        self._reference.speed = self._speed * (SLOWEST + share * (FASTEST - SLOWEST))
        begin = (simulation.frame.ego.fuel_used, simulation.frame.distance, simulation.time)
        energy = self._energy()
        end = simulation.time + PERIOD
        while simulation.time < end - 1e-6 and not simulation.ended:
            simulation.cycle()
        frame = simulation.frame
        fuel = frame.ego.fuel_used - begin[0]
        lost = simulation.time - begin[2] - (frame.distance - begin[1]) / self._speed
        self._time += lost
        self._picture.show(simulation.truck.model, simulation.truck.data)
        truncated = bool(simulation.ended) or frame.distance >= self._length
        gained = KINETIC_VALUE * (self._energy() - energy)
        info = self._info(-fuel, -TIME_VALUE * lost, gained)
        reward = info["reward_fuel"] + info["reward_time"] + info["reward_kinetic"]
        return self._observation(), reward, False, truncated, info

    def render(self) -> Any:
        """Returns a picture (360, 640, 3) of bytes; None in a window or without a render mode.

        Raises:
          RenderError: OpenGL is missing.
        """
        truck = self._running().truck
        return self._picture.draw(truck.model, truck.data)

    def close(self) -> None:
        """Ends the drive, the renderer and the window."""
        self._picture.close()
        if self._simulation is not None:
            self._simulation.close()
            self._simulation = None

    @property
    def simulation(self) -> Simulation:
        """The drive of the episode."""
        return self._running()

    def _running(self) -> Simulation:
        if self._simulation is None:
            raise InputError("the episode has not begun: call reset first")
        return self._simulation

    def _observation(self) -> Observation:
        simulation = self._running()
        ego = simulation.frame.ego
        grades = simulation.route.evaluate(ego.station + np.array(PREVIEW)).grade
        values = [
            ego.speed / self._speed,
            self._reference.speed / self._speed,
            ego.gear / 12.0,
            ego.engine_speed / 220.0,
            self._time / 60.0,
            *(np.asarray(grades) / 0.05).tolist(),
        ]
        return np.clip(np.array(values), -5.0, 5.0).astype(np.float32)

    def _energy(self) -> float:
        ego = self._running().frame.ego
        return 0.5 * ego.mass * ego.speed**2

    def _info(self, fuel: float, time: float, kinetic: float) -> dict[str, Any]:
        frame = self._running().frame
        return {
            "time": frame.time,
            "speed": frame.ego.speed,
            "station": frame.ego.station,
            "fuel_used": frame.ego.fuel_used,
            "time_lost": self._time,
            "reward_fuel": fuel,
            "reward_time": time,
            "reward_kinetic": kinetic,
            **self.family.info(self._number),
        }
