"""Tasks of the suite and Gymnasium environments in the browser: scripted, random or by hand."""

from __future__ import annotations

import functools
import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from iits_mj.core.checks import one_of
from iits_mj.core.context import Closing
from iits_mj.core.errors import Error, InputError
from iits_mj.core.messages import EgoState
from iits_mj.core.timing import CONTROL_PERIOD
from iits_mj.parameters import AnyTruck
from iits_mj.simulation import DriveFrame, Observer, Simulation
from iits_mj.simulation.lock_step import LockStep
from iits_mj.truck import Truck
from iits_mj.web import instruments
from iits_mj.web.manual import Hands
from iits_mj.web.server import WebServer
from iits_mj.web.stage import Stage

_PICTURES = 50.0  # per second of wall time
_STEER_RATE = 2.0  # of a manual action [1/s]
_DOMAIN = "truck"
# Pause between two episodes in wall time [s].
_BETWEEN = 1.5


@dataclass(frozen=True)
class Step:
    """Result of a step: the reward, and how the episode ended, "" while it goes on."""

    reward: float
    ended: str = ""


@dataclass(frozen=True)
class World:
    """One environment, of the suite or of Gymnasium.

    Attributes:
      name: of it; period: of a step [s].
      reset: starts an episode with a seed; step: takes an action.
      truck: of the episode, which may be another one after a reset.
      drive: that steps inside the environment, None without one.
      random: returns a random action; scripted: that of its baseline; manual: that of a person.
      close: ends it.
    """

    name: str
    period: float
    reset: Callable[[int], None]
    step: Callable[[Any], Step]
    truck: Callable[[], Truck]
    drive: Callable[[], Simulation | None]
    random: Callable[[np.random.Generator], Any]
    scripted: Callable[[], Any]
    manual: Callable[[Hands], Any]
    close: Callable[[], None]


def names() -> tuple[str, ...]:
    """Returns the names that `open_world` knows."""
    from iits_mj import suite
    from iits_mj.envs import ENVIRONMENTS

    return (*suite.TASKS_BY_DOMAIN[_DOMAIN], *ENVIRONMENTS)


def check_name(name: str) -> None:
    """Refuses a name that `open_world` does not know; raises InputError."""
    one_of("--env", name, names())


def open_world(
    name: str,
    *,
    truck: AnyTruck | None = None,
    payload: float | None = None,
    plant: str = "full",
    seed: int = 0,
) -> World:
    """Returns an environment with visible surroundings.

    Args:
      name: of a task of the suite ("dock") or a Gymnasium id ("iits_mj/Dock-v0").
      truck: that drives.
      payload: of the truck [kg].
      plant: model of its motion.
      seed: of the environment.

    Raises:
      InputError: the name is unknown, or the environment has no model to show.
    """
    check_name(name)
    if name in ("iits_mj/HighwayFast-v0", "iits_mj/Hoel2020-v0"):
        raise InputError(f"{name} has no MuJoCo model to show: use iits_mj/Highway-v0")
    settings = {"truck": truck, "payload": payload, "plant": plant}
    return _gymnasium(name, settings) if "/" in name else _suite(name, settings, seed)


def _suite(name: str, settings: dict[str, Any], seed: int) -> World:
    from iits_mj import suite

    environment = suite.load(_DOMAIN, name, {"random": seed, "visuals": True, **settings})
    spec = environment.action_spec()
    last: list[Any] = [None]

    def reset(number: int) -> None:
        environment.task.random.seed(number)
        last[0] = environment.reset()

    def step(action: Any) -> Step:
        last[0] = found = environment.step(action)
        ended = ""
        if found.last():
            ended = "the episode is over by time" if found.discount else "the task has failed"
        return Step(float(found.reward or 0.0), ended)

    def scripted() -> Any:
        driver = suite.DRIVERS.get(name)
        if driver is None:
            raise InputError(f"{name} has no scripted driver: use --policy random or manual")
        return driver(last[0].observation)

    return World(
        name,
        float(environment.control_timestep()),
        reset,
        step,
        lambda: environment.physics.truck,
        lambda: getattr(environment.physics, "simulation", None),
        lambda generator: generator.uniform(spec.minimum, spec.maximum, spec.shape),
        scripted,
        lambda hands: _numbers(hands, spec.shape[0], name == "highway"),
        environment.close,
    )


def _gymnasium(name: str, settings: dict[str, Any]) -> World:
    import gymnasium

    from iits_mj import suite
    from iits_mj.envs import ENVIRONMENTS

    kwargs = {key: value for key, value in settings.items() if value not in (None, "full")}
    try:
        environment: Any = gymnasium.make(name, render_mode="rgb_array", **kwargs).unwrapped
    except TypeError as error:
        raise InputError(f"{name}: an option has no effect here ({error})") from error
    task = ENVIRONMENTS[name].get("kwargs", {}).get("task")
    discrete = isinstance(environment.action_space, gymnasium.spaces.Discrete)
    last: list[Any] = [None]

    def reset(number: int) -> None:
        last[0] = environment.reset(seed=number)[0]

    def step(action: Any) -> Step:
        last[0], reward, terminated, truncated, _ = environment.step(action)
        ended = "the episode is over by time" if truncated else ""
        return Step(float(reward), "the task has ended" if terminated else ended)

    def scripted() -> Any:
        if task is not None:
            return suite.DRIVERS[task](environment.task.get_observation(environment.physics))
        if discrete:
            from controllers.decision.policy import ACTIONS, load_policy

            return ACTIONS.index(load_policy().network.greedy(last[0]))
        return np.zeros(environment.action_space.shape, np.float32)

    def random(generator: np.random.Generator) -> Any:
        space = environment.action_space
        if discrete:
            return int(generator.integers(space.n))
        return generator.uniform(space.low, space.high).astype(np.float32)

    def manual(hands: Hands) -> Any:
        if discrete:
            return 1 - round(hands.steer)
        return _numbers(hands, environment.action_space.shape[0], False)

    return World(
        name,
        environment.task.period if task is not None else 0.1,
        reset,
        step,
        lambda: environment.physics.truck if task is not None else environment.simulation.truck,
        lambda: None if task is not None else environment.simulation,
        random,
        scripted,
        manual,
        environment.close,
    )


def _numbers(hands: Hands, count: int, decides: bool) -> Any:
    drive = hands.steer if decides else hands.pedal - hands.brake
    return np.array([drive, hands.steer][:count], dtype=np.float32)


class EnvironmentShow(Stage, Observer, Closing):
    """Runs episodes of an environment and shows them; a context manager.

    Args:
      server: of the pages.
      name: of the environment, see `open_world`.
      policy: "scripted", "random" or "manual"; a viewer at the wheel replaces it.
      pace: simulated time over wall time.
      seed: of the first episode; each further one has the next.
      truck, payload, plant: see `open_world`.

    Attributes:
      world: the environment; episodes: number that have begun; returned: sum of the rewards.
    """

    def __init__(
        self,
        server: WebServer,
        name: str,
        *,
        policy: str = "scripted",
        pace: float = 1.0,
        seed: int = 0,
        truck: AnyTruck | None = None,
        payload: float | None = None,
        plant: str = "full",
    ) -> None:
        self.world = open_world(name, truck=truck, payload=payload, plant=plant, seed=seed)
        self._policy, self._seed = policy, seed
        self._random = np.random.default_rng(seed)
        self._time = self._steer = 0.0
        self._reset_wanted = False
        self.episodes, self.returned, self._reward = 0, 0.0, 0.0
        self._finished: list[float] = []
        self._built: Any = None
        self._offset = 0.0
        self._station: float | None = None
        super().__init__(server, pace)
        # A person's inputs are used as soon as a page has the wheel.
        self._handlers |= {"reset": self._reset, "take": _nothing, "release": _nothing}
        gui = server.viser.gui
        self.on_click(gui.add_button("Reset the episode"), self.requests, "reset")
        self.add_overlays({"show_forces": "Tire loads and forces"})

    @property
    def now(self) -> float:
        """Time within all episodes [s]."""
        return self._time

    def play(self) -> None:
        """Runs episodes until Ctrl-C."""
        while True:
            for _ in self._episode():
                self.between_cycles()
            end = time.perf_counter() + _BETWEEN
            while time.perf_counter() < end and not self._reset_wanted:
                self.wait()

    def _episode(self) -> Iterator[None]:
        """Runs an episode; yields before every step."""
        world = self.world
        self._reset_wanted = False
        try:
            world.reset(self._seed + self.episodes)
        except Error as error:
            raise InputError(f"{world.name}: {error}") from error
        self.episodes += 1
        self.returned = self._reward = 0.0
        self.say(f"Episode {self.episodes}")
        self._show_model()
        drive = world.drive()
        if drive is not None:
            # Environments step their drive without observers.
            watched = functools.partial(type(drive).cycle, drive, (self,))
            drive.cycle = watched  # type: ignore[method-assign]
        self._offset = self._time
        before = self._poses()
        ended = ""
        while not ended:
            yield
            if self._reset_wanted:
                return
            step = world.step(self._action())
            self.returned, self._reward = self.returned + step.reward, step.reward
            ended = step.ended
            if drive is not None:
                continue  # `observe` has shown the step
            after = self._poses()
            count = max(1, round(world.period / self.pace * _PICTURES))
            start = self._time
            for number in range(1, count + 1):
                self._time = start + world.period * number / count
                self._shown = before.toward(after, number / count)
                if self.due() or self.paused:
                    self.redraw()
                self.hold()
            before = after
        self._finished.append(self.returned)
        self.say(f"Episode {self.episodes}: {ended}, return {self.returned:.1f}.")

    period = CONTROL_PERIOD

    def observe(self, simulation: LockStep, frame: DriveFrame) -> None:
        """Draws the drive inside an environment and waits for the wall clock."""
        self._time = self._offset + simulation.time
        self._station = frame.ego.station
        self._shown = self._poses()
        if self.due() or self.paused:
            self.redraw()
        self.hold()

    def _action(self) -> Any:
        if self.holder or self._policy == "manual":
            step = _STEER_RATE * self.world.period
            hands = self.given[0] if self.holder else Hands()
            self._steer += max(-step, min(step, hands.steer - self._steer))
            smooth = Hands(hands.pedal, hands.brake, self._steer)
            return self.world.manual(smooth)
        if self._policy == "random":
            return self.world.random(self._random)
        return self.world.scripted()

    def _poses(self) -> Any:
        from iits_mj.web.scene import Poses

        return Poses.of(self.world.truck().data)

    def redraw(self) -> None:
        """Draws the present instant."""
        if self.scene is not None:
            truck = self.world.truck()
            self.scene.show(self._shown, self._station, self._time)
            self.scene.show_tires(truck.data)

    def _show_model(self) -> None:
        from iits_mj.web.scene import TruckScene

        truck = self.world.truck()
        if self._built is not truck.model:
            before = self.scene
            if before is not None:
                before.remove()
            self._built = truck.model
            self.scene = TruckScene(self.server.viser, truck.model, truck.parameters)
            self.scene.keep_views(before)
            self.scene.initial_camera(self._poses())
        self._shown = self._poses()
        self.redraw()

    def state(self) -> dict[str, Any]:
        """Returns the instruments."""
        truck = self.world.truck()
        ego: EgoState = truck.state()
        rows = [
            ("reward", f"{self._reward:.3f}"),
            ("return", f"{self.returned:.2f}"),
            ("episode", f"{self.episodes}"),
            ("time", f"{ego.time:.1f} s"),
            ("policy", "a viewer" if self.holder else self._policy),
        ]
        return {
            **instruments.truck_state(ego, truck.last_command(), truck.report()),
            "rows": instruments.truck_rows(ego) + rows,
        }

    def summary(self) -> str:
        """Returns the figures of the finished episodes."""
        if not self._finished:
            return f"{self.world.name}: no episode was finished"
        mean = math.fsum(self._finished) / len(self._finished)
        return f"{self.world.name}: {len(self._finished)} episodes, mean return {mean:.2f}"

    def close(self) -> None:
        """Ends the environment."""
        self.world.close()

    def _reset(self, value: Any) -> None:
        del value
        self._reset_wanted = True


def _nothing(value: Any) -> None:
    del value
