"""The paper's decision task: lane changes in SUMO traffic, by the whole stack."""

from __future__ import annotations

import collections
import math
from typing import Any, ClassVar

import numpy as np
from dm_control.suite import base
from dm_control.utils import rewards
from dm_env import specs

from controllers.decision.observation import RANGE_AHEAD, RANGE_BEHIND, ROWS
from iits_mj.actions import read_action
from iits_mj.messages import Decision
from iits_mj.suite.highway import HighwayPhysics
from iits_mj.suite.observed import INSTRUMENTS, Observed
from iits_mj.suite.tasks.base import Observations

_AHEAD = sum(row.startswith("ahead") for row in ROWS)
_BEHIND = sum(row.startswith("behind") for row in ROWS)


class Highway(base.Task):
    """Choose lanes on the built-in highway; planner and tracking drive.

    | action     | range   | meaning                                                           |
    |------------|---------|-------------------------------------------------------------------|
    | `decision` | -1 .. 1 | above 1/3: change to the left; below -1/3: to the right; else keep  |

    The planner refuses a change for which there is no lane or no room. What is seen are the
    vehicles of the paper's observation, six ahead within 250 m and two behind; those that are not
    there are shown at the end of sight with the truck's speed.
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
        "calm": "no change was asked for; else 0.5",
    }

    @property
    def scales(self) -> dict[str, float]:
        """Size by which each observation is divided for a learner."""
        return {name: told.scale for name, told in self.observed.items()}

    def __init__(self, random: Any = None) -> None:
        super().__init__(random)
        self._changes = self._unsafe = 0
        self._asked = False

    def action_spec(self, physics: HighwayPhysics) -> specs.BoundedArray:
        """One number in [-1, 1]."""
        del physics
        full = np.ones(1)
        return specs.BoundedArray(full.shape, np.float64, -full, full, name="decision")

    def initialize_episode(self, physics: HighwayPhysics) -> None:
        """Another traffic; the truck at the beginning of the road, in its speed."""
        physics.begin(np.random.default_rng(self.random.randint(2**31)))
        self._asked = False
        self._unsafe = physics.simulation.stack.unsafe
        super().initialize_episode(physics)

    def before_step(self, action: Any, physics: HighwayPhysics) -> None:
        """Tells the stack what to do when it next asks.

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
        """Own speed [m/s] and offset [m]; of the others distance, offset [m], relative speed."""
        simulation = physics.simulation
        ego, footprint = simulation.frame.ego, simulation.truck.footprint
        front = ego.station + footprint.front_overhang
        seen = [
            (v.station + 0.5 * v.length - front, v.offset - ego.offset, v.speed - ego.speed)
            for v in simulation.vehicles
            if v.lane >= 0
        ]
        ahead = sorted(row for row in seen if 0.0 < row[0] <= RANGE_AHEAD)
        reach = RANGE_BEHIND + footprint.length
        behind = sorted((row for row in seen if -reach <= row[0] <= 0.0), reverse=True)
        return collections.OrderedDict(
            speed=np.array([ego.speed]),
            offset=np.array([ego.offset - float(physics.route.lane_offset(0, ego.station))]),
            ahead=_rows(ahead, _AHEAD, RANGE_AHEAD),
            behind=_rows(behind, _BEHIND, -reach),
        )

    def reward_terms(self, physics: HighwayPhysics) -> dict[str, float]:
        """`speed`: the reference's, 0 at 0.6 of it; `safe`: no danger; `calm`: the lane is kept."""
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
        """Product of the terms."""
        return float(np.prod(list(self.reward_terms(physics).values())))

    def get_termination(self, physics: HighwayPhysics) -> float | None:
        """With discount 0 after a collision or a roll-over, with 1 at the end of the road."""
        if not physics.over:
            return None
        return 0.0 if physics.simulation.failed else 1.0


def _rows(found: list[tuple[float, float, float]], count: int, absent: float) -> np.ndarray:
    rows = (found + [(absent, 0.0, 0.0)] * count)[:count]
    return np.array(rows).ravel()
