"""The paper's decision task: lane changes of the whole driving stack in SUMO traffic."""

from __future__ import annotations

import collections
import math
from typing import Any, ClassVar

import mujoco
import numpy as np
from dm_control.mujoco import wrapper
from dm_control.rl import control
from dm_control.suite import base
from dm_control.utils import rewards
from dm_env import specs

from controllers.decision.observation import RANGE_AHEAD, RANGE_BEHIND, ROWS
from controllers.decision.trip import TripConfig
from iits_mj.core.arrays import FloatArray
from iits_mj.core.checks import read_action
from iits_mj.core.errors import Error, InputError
from iits_mj.core.messages import Decision
from iits_mj.core.timing import CYCLE_PERIOD
from iits_mj.simulation.loop import Simulation
from iits_mj.simulation.truck_world import TruckWorld
from iits_mj.suite.physics import INSTRUMENTS, Observed, Physics
from iits_mj.suite.tasks.base import Observations

_AHEAD = sum(row.startswith("ahead") for row in ROWS)
_BEHIND = sum(row.startswith("behind") for row in ROWS)


class HighwayPhysics(Physics):
    """The truck, its stack and SUMO's traffic behind the interface of a `Physics`.

    `step` advances all of them in whole cycles of 100 ms. Truck and payload stay the same; the
    traffic changes with every episode. `from_world` makes an instance.
    """

    world: TruckWorld
    trip: TripConfig

    @classmethod
    def from_world(cls, world: TruckWorld, trip: TripConfig) -> HighwayPhysics:
        """Returns the physics of a world, after the start of its first episode."""
        world.reset(np.random.default_rng(0), trip)
        model = wrapper.MjModel(world.running.truck.model)
        physics: HighwayPhysics = cls.from_model(model)
        physics.world, physics.trip = world, trip
        physics._take_over()
        return physics

    @property
    def simulation(self) -> Simulation:
        """Truck, stack and traffic of the episode."""
        return self.world.running

    def begin(self, generator: np.random.Generator) -> None:
        """Starts an episode: new traffic, the truck back at its start."""
        self.world.reset(generator, self.trip)
        self._reload_from_model(wrapper.MjModel(self.simulation.truck.model))
        self._take_over()

    def step(self, nstep: int = 1) -> None:
        """Advances by whole cycles of 100 ms; does nothing at the end of the trip.

        Raises:
          InputError: `nstep` is not a whole number of cycles.
        """
        cycles = nstep * self.timestep() / CYCLE_PERIOD
        if abs(cycles - round(cycles)) > 1e-6:
            raise InputError(
                f"{nstep} steps are {nstep * self.timestep():g} s: use whole cycles of 0.1 s"
            )
        for _ in range(round(cycles)):
            if not self.over:
                self.simulation.cycle()

    @property
    def over(self) -> bool:
        """Whether road or time are at their end, or the truck has failed."""
        return bool(self.simulation.ended)

    def decide(self, decision: Decision) -> None:
        """Sets the next decision."""
        self.world.tell(decision)

    def copy(self, share_model: bool = False) -> Any:
        """Refuses to copy.

        Raises:
          Error: always, because SUMO's state cannot be copied.
        """
        del share_model
        raise Error("the highway's physics cannot be copied: its traffic runs in SUMO")

    def free(self) -> None:
        """Ends SUMO as well."""
        self.world.close()
        super().free()

    def _take_over(self) -> None:
        """Makes the simulation's truck use the data of this physics."""
        truck = self.simulation.truck
        mujoco.mj_copyData(self.data.ptr, self.model.ptr, truck.data)
        self._bind(truck)


class HighwayEnvironment(control.Environment):
    """An environment whose `close` ends SUMO; dm_control's own does nothing."""

    def close(self) -> None:
        """Ends SUMO; the environment cannot be used after that."""
        self.physics.free()


class Highway(base.Task):
    """Choose lanes on the built-in highway; planner and tracking drive.

    | action     | range   | meaning                                                           |
    |------------|---------|-------------------------------------------------------------------|
    | `decision` | -1 .. 1 | above 1/3: change to the left; below -1/3: to the right; else keep  |

    The planner refuses a change without a lane or room. The observation has the vehicles of the
    paper: six ahead within 250 m and two behind. Missing vehicles are at the end of sight with the
    truck's speed.
    """

    actions: ClassVar[tuple[str, ...]] = ("decision",)
    observed: ClassVar[dict[str, Observed]] = {
        "speed": INSTRUMENTS["speed"],
        "offset": Observed(4.0, "m", "left of the rightmost lane's middle", "body `tractor`, road"),
        "ahead": Observed(
            40.0, "m, m, m/s", "six nearest ahead: distance, offset, relative speed", "traffic", 18
        ),
        "behind": Observed(20.0, "m, m, m/s", "two nearest behind, in the same way", "traffic", 6),
    }
    terms: ClassVar[dict[str, str]] = {
        "speed": "the reference speed, 60 km/h; linear to 0 at 0.6 of it",
        "safe": "no refusal because of a vehicle, no collision; else 0",
        "calm": "no requested change; else 0.5",
    }

    @property
    def scales(self) -> dict[str, float]:
        """Scale of each observation for a learner."""
        return {name: entry.scale for name, entry in self.observed.items()}

    def __init__(self, random: Any = None) -> None:
        super().__init__(random)
        self._changes = self._unsafe = 0
        self._asked = False

    def action_spec(self, physics: HighwayPhysics) -> specs.BoundedArray:
        """Returns the specification: one number in [-1, 1]."""
        del physics
        full = np.ones(1)
        return specs.BoundedArray(full.shape, np.float64, -full, full, name="decision")

    def initialize_episode(self, physics: HighwayPhysics) -> None:
        """New traffic; the truck at the start of the road, at the traffic's speed."""
        physics.begin(np.random.default_rng(self.random.randint(2**31)))
        self._asked = False
        self._unsafe = physics.simulation.stack.unsafe
        super().initialize_episode(physics)

    def before_step(self, action: Any, physics: HighwayPhysics) -> None:
        """Sets the next decision.

        Raises:
          InputError: not one finite number.
        """
        value = float(read_action(action, (len(self.actions),))[0])
        decision = Decision.KEEP
        if abs(value) > 1.0 / 3.0:
            decision = Decision.LEFT if value > 0.0 else Decision.RIGHT
        self._asked = decision is not Decision.KEEP
        self._unsafe = physics.simulation.stack.unsafe
        physics.decide(decision)

    def get_observation(self, physics: HighwayPhysics) -> Observations:
        """Returns speed and offset; distances, offsets and relative speeds of other vehicles."""
        scene = physics.simulation.scene
        ego, neighbors = scene.ego, scene.neighbors
        ahead, behind = neighbors.nearest_by_front(RANGE_AHEAD, RANGE_BEHIND)
        reach = RANGE_BEHIND + scene.footprint.length
        columns = neighbors.front_distance, neighbors.offset - ego.offset
        rows = np.column_stack((*columns, neighbors.speed - ego.speed))
        return collections.OrderedDict(
            speed=np.array([ego.speed]),
            offset=np.array([ego.offset - float(physics.route.lane_offset(0, ego.station))]),
            ahead=_padded(rows[ahead[:_AHEAD]], _AHEAD, RANGE_AHEAD),
            behind=_padded(rows[behind[:_BEHIND]], _BEHIND, -reach),
        )

    def reward_terms(self, physics: HighwayPhysics) -> dict[str, float]:
        """Returns `speed`: near the reference; `safe`: no danger; `calm`: no lane change."""
        simulation = physics.simulation
        reference = physics.trip.reference_speed
        fast = rewards.tolerance(
            simulation.frame.ego.speed,
            (reference - 0.2, math.inf),
            margin=0.4 * reference,
            value_at_margin=0.0,
            sigmoid="linear",
        )
        unsafe = simulation.failed or simulation.stack.unsafe > self._unsafe
        return {
            "speed": float(fast),
            "safe": 0.0 if unsafe else 1.0,
            "calm": 0.5 if self._asked else 1.0,
        }

    def get_reward(self, physics: HighwayPhysics) -> float:
        """Returns the product of the terms."""
        return float(np.prod(list(self.reward_terms(physics).values())))

    def get_termination(self, physics: HighwayPhysics) -> float | None:
        """Ends with discount 0 after a collision or a roll-over, 1 at the end of the road."""
        if not physics.over:
            return None
        return 0.0 if physics.simulation.failed else 1.0


def _padded(rows: FloatArray, count: int, absent: float) -> FloatArray:
    """Returns rows of vehicles as one array; missing vehicles get the distance `absent`."""
    result = np.tile((absent, 0.0, 0.0), (count, 1))
    result[: len(rows)] = rows
    return result.ravel()
