"""The 90 degree turn of 12.5 m radius: everything of the truck stays on the road."""

from __future__ import annotations

import math
from typing import ClassVar

import numpy as np
from dm_control.utils import rewards

from iits_mj.suite.physics import BENDING, WITHOUT_GEAR, Observed, Physics, wide
from iits_mj.suite.scene import TURN_ENTRY
from iits_mj.suite.tasks.base import DrivingTask, Observations


class TightTurn(DrivingTask):
    """Through a left turn whose road is as wide as the rules for trucks allow them to sweep.

    The outer steer tire may follow an arc of 12.5 m; the Australian PBS (level 1) then allows a
    frontal swing of 0.7 m and a swept path of 7.4 m, which are the road's edges here. The
    semitrailer cuts the corner by more than the room that is left, unless the tractor goes wide.
    """

    target = 2.5
    steer_max: ClassVar[float] = 5.0 * math.pi
    actions: ClassVar[tuple[str, ...]] = ("drive", "steer")
    # Edges of the road beside its reference line, which the middle of the steer axle may follow.
    right_edge: ClassVar[float] = -1.95
    left_edge: ClassVar[float] = 5.45
    off_road: ClassVar[float] = -1.0
    observed: ClassVar[dict[str, Observed]] = {
        **WITHOUT_GEAR,
        "offset": Observed(1.0, "m", "steer axle left of the line", "body `tractor`, road"),
        "heading_error": Observed(
            0.5, "rad", "tractor's heading less the line's", "body `tractor`, road"
        ),
        "trailer_offset": Observed(
            2.0, "m", "trailer's axles left of the line", "site `trailer_axle_center`, road"
        ),
        **wide(BENDING),
        "clearance": Observed(
            1.0, "m", "least distance of the outline from an edge", "bodies, road"
        ),
        "past_entry": Observed(10.0, "m", "way since the turn began", "body `tractor`, road"),
    }
    terms: ClassVar[dict[str, str]] = {
        "clear": "0.1 m or more from both edges; 0.1 at 0.6 m less",
        "speed": "2 to 3 m/s; linear to 0 at 2 m/s more or less",
        "along": "heading within 0.6 rad of the line's; 0.1 at 0.8 rad more",
    }

    def initialize_episode(self, physics: Physics) -> None:
        """8 to 18 m before the turn, at 2 to 3 m/s, a little off the line."""
        station = TURN_ENTRY - self.random.uniform(8.0, 18.0)
        physics.place(station, self.random.uniform(-0.15, 0.15), self.random.uniform(2.0, 3.0))
        super().initialize_episode(physics)

    def clearance(self, physics: Physics) -> float:
        """Least distance of the truck's outline from an edge of the road [m], negative beyond."""
        offsets = physics.outline_offsets()
        return float(min(np.min(offsets) - self.right_edge, self.left_edge - np.max(offsets)))

    def get_observation(self, physics: Physics) -> Observations:
        """Instruments, place on the road, trailer, steering, clearance and way to the turn."""
        ego = physics.ego()
        found = super().get_observation(physics)
        found["offset"] = np.array([ego.offset])
        found["heading_error"] = np.array([physics.heading_error()])
        found["trailer_offset"] = np.array([ego.trailer_offset])
        found["articulation"] = np.array([physics.articulation()])
        found["yaw_rate"] = np.array([physics.yaw_rate()])
        found["steering_wheel_angle"] = np.array([physics.steering_wheel_angle()])
        found["clearance"] = np.array([self.clearance(physics)])
        found["past_entry"] = np.array([ego.station - TURN_ENTRY])
        return found

    def reward_terms(self, physics: Physics) -> dict[str, float]:
        """`clear`: 0.1 m from the edges; `speed`: 2 to 3 m/s; `along`: on its way, not across."""
        clear = rewards.tolerance(self.clearance(physics), (0.1, math.inf), margin=0.6)
        speed = rewards.tolerance(
            physics.speed(),
            (self.target - 0.5, self.target + 0.5),
            margin=2.0,
            value_at_margin=0.0,
            sigmoid="linear",
        )
        along = rewards.tolerance(physics.heading_error(), (-0.6, 0.6), margin=0.8)
        return {"clear": float(clear), "speed": float(speed), "along": float(along)}

    def get_termination(self, physics: Physics) -> float | None:
        """Ends the episode, with discount 0, when the truck is 1 m off the road."""
        return 0.0 if self.clearance(physics) < self.off_road else None
