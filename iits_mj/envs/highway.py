"""The paper's decision task for Gymnasium: the whole truck in SUMO traffic, three actions."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from controllers.decision.base import DecisionContext
from controllers.decision.observation import OBSERVATION_SIZE
from controllers.decision.reward import RewardConfig, RewardTerms, decision_charge
from iits_mj.errors import InputError, RenderError
from iits_mj.messages import Decision

if TYPE_CHECKING:
    import mujoco

    from iits_mj.simulation import Simulation

Observation = NDArray[np.float32]

ACTIONS = (Decision.LEFT, Decision.KEEP, Decision.RIGHT)
RENDER_SIZE = (360, 640)
_CYCLE = 0.1
_PERIOD = 1.0


class _Asked:
    """A decision maker that answers what the learner chose; keeps the lane when not told."""

    name = "asked"

    def __init__(self) -> None:
        self.pending: Decision | None = None

    def reset(self) -> None:
        """Forgets the pending answer."""
        self.pending = None

    def decide(self, context: DecisionContext) -> Decision:
        """Gives the pending answer, once."""
        del context
        answer, self.pending = self.pending, None
        return Decision.KEEP if answer is None else answer


class HighwayEnv(gymnasium.Env[Observation, np.int64]):
    """Decide on lane changes of the laden truck among SUMO vehicles on the built-in highway.

    Action: 0 change to the left, 1 keep, 2 change to the right. It takes effect within 0.1 s; the
    planner refuses a change that is not possible or not safe. A step lasts 1 s, or until a lane
    change that was begun is over.

    Observation (216, float32 in [-1, 1]): see `controllers.decision.observation`.

    Reward, the paper's with its signs repaired, in `info` as `reward_<name>`:

    | term      | value                                                                       |
    |-----------|-----------------------------------------------------------------------------|
    | change    | -10 for action 0 or 2, refused or not                                       |
    | danger    | -20 more when a vehicle was the reason of the refusal                       |
    | speed     | minus the distance of the speed from the reference, per m/s and second      |
    | collision | -300                                                                        |

    Terminated by a collision or a roll-over; truncated at the end of the time or of the road.
    Version history: v0, first.

    Args:
      density: of the traffic, "dense", "medium", "sparse" or "empty".
      traffic_speed: speed limit of the traffic [m/s].
      speed: reference speed of the truck [m/s].
      duration: of an episode [s].
      payload: on the semitrailer [kg].
      payload_height: of the load's centre of gravity above the road [m], 1.3 to 3.
      render_mode: None or "rgb_array" (needs OpenGL).
      camera: of the pictures: "chase", "side" or "cab".

    Raises:
      InputError: an argument is not allowed. TrafficError: SUMO is not usable.
    """

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 1}  # noqa: RUF012 - Gymnasium's way

    def __init__(
        self,
        *,
        density: str = "medium",
        traffic_speed: float = 15.0,
        speed: float = 60.0 / 3.6,
        duration: float = 120.0,
        payload: float = 36_000.0,
        payload_height: float | None = None,
        render_mode: str | None = None,
        camera: str = "chase",
    ) -> None:
        # SUMO is loaded only by those who make this environment.
        from iits_mj.simulation import DriveConfig

        if render_mode not in (None, *self.metadata["render_modes"]):
            raise InputError(f"render_mode {render_mode!r} is not known; use 'rgb_array' or None")
        self.render_mode = render_mode
        self.camera = camera
        self.reward_config = RewardConfig()
        self.config = DriveConfig(
            density=density,
            traffic_speed=traffic_speed,
            speed=speed,
            duration=duration,
            payload=payload,
            payload_height=payload_height,
            decision="keep",
            # Its observations and rewards are those of a constant reference speed.
            speed_planner="cruise",
        )
        self.observation_space = gymnasium.spaces.Box(-1.0, 1.0, (OBSERVATION_SIZE,), np.float32)
        self.action_space = gymnasium.spaces.Discrete(len(ACTIONS))
        self._asked = _Asked()
        self._simulation: Simulation | None = None
        self._renderer: mujoco.Renderer | None = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Starts an episode; the same seed gives the same traffic."""
        super().reset(seed=seed, options=options)
        traffic_seed = int(self.np_random.integers(2**31 - 1))
        simulation = self._open()
        if simulation.traffic is not None:
            simulation.traffic.seed = traffic_seed  # type: ignore[attr-defined]
        simulation.reset()
        return self._observation(), self._info(RewardTerms())

    def step(self, action: np.int64) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Carries out a decision until the next one is due."""
        simulation = self._simulation
        if simulation is None or simulation.ended:
            raise InputError("the episode has not begun or is over: call reset first")
        if not self.action_space.contains(action):
            raise InputError(f"action {action!r} is not known; use 0, 1 or 2")
        decision = ACTIONS[int(action)]
        stack, settings = simulation.stack, self.reward_config
        unsafe = stack.unsafe
        self._asked.pending = decision
        terms = RewardTerms()
        elapsed, since_asked = 0.0, 0.0
        # Until it was asked, and then until it is about to be asked again.
        while not simulation.ended:
            frame = simulation.cycle()
            distance = abs(frame.ego.speed - self.config.speed)
            rate = settings.speed * settings.discount**elapsed
            terms += RewardTerms(speed=-rate * distance * _CYCLE)
            elapsed += _CYCLE
            if self._asked.pending is None:
                since_asked += _CYCLE
                if since_asked > _PERIOD - 0.5 * _CYCLE and not stack.planner.changing:
                    break
        terms += decision_charge(decision is not Decision.KEEP, stack.unsafe > unsafe, settings)
        if simulation.collision:
            terms += RewardTerms(collision=-settings.collision * settings.discount**elapsed)
        terminated = simulation.failed
        truncated = bool(simulation.ended) and not terminated
        return self._observation(), float(terms.total), terminated, truncated, self._info(terms)

    def render(self) -> Any:
        """A picture (360, 640, 3) of bytes, or None without a render mode.

        Raises:
          RenderError: there is no OpenGL here.
        """
        if self.render_mode is None:
            return None
        import mujoco

        truck = self._open().truck
        try:
            if self._renderer is None:
                self._renderer = mujoco.Renderer(truck.model, *RENDER_SIZE)
            self._renderer.update_scene(truck.data, camera=self.camera)
            return self._renderer.render()
        except (RuntimeError, AttributeError, ImportError) as error:
            raise RenderError(
                f"no OpenGL for pictures ({error}): install libegl1 libgl1-mesa-dri libopengl0 and "
                "set MUJOCO_GL=egl"
            ) from error

    def close(self) -> None:
        """Ends SUMO and the renderer."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None
        if self._simulation is not None:
            self._simulation.close()
            self._simulation = None

    def _open(self) -> Simulation:
        """The simulation, made at the first reset."""
        if self._simulation is None:
            from iits_mj.simulation import Simulation
            from iits_mj.suite.physics import add_cameras

            self._simulation = Simulation(
                self.config, edit_spec=add_cameras, visuals=self.render_mode is not None
            )
            self._simulation.stack.decision_maker = self._asked
        return self._simulation

    def _observation(self) -> Observation:
        return self._open().stack.history.observation()

    def _info(self, terms: RewardTerms) -> dict[str, Any]:
        simulation = self._open()
        frame = simulation.frame
        return {
            "time": frame.time,
            "speed": frame.ego.speed,
            "station": frame.ego.station,
            "lane": frame.lane,
            "lane_changes": frame.lane_changes,
            "refused": frame.refused,
            "ended": simulation.ended,
            "reward_change": terms.change,
            "reward_danger": terms.danger,
            "reward_speed": terms.speed,
            "reward_collision": terms.collision,
        }
