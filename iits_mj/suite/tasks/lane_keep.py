"""Keep the lane of a winding road."""

from __future__ import annotations

from typing import ClassVar

from dm_control.utils import rewards

from iits_mj.suite.physics import Observed, Physics
from iits_mj.suite.tasks.base import Observations, PathTask

PREVIEW = (0.0, 25.0, 50.0, 100.0)


class LaneKeep(PathTask):
    """Keep truck and trailer in the right lane of a winding road at 20 m/s.

    Half the lane less half the truck leaves 0.73 m; 2 m off its middle the truck is off its lane.
    """

    target = 20.0
    observed: ClassVar[dict[str, Observed]] = {
        **PathTask.observed,
        "curvature_ahead": Observed(
            0.002, "1/m", "here and 25, 50, 100 m ahead, left positive", "road", 4
        ),
    }
    terms: ClassVar[dict[str, str]] = {
        "lane": "steer axle within 0.15 m of the path; 0.1 at 1 m more",
        "trailer": "trailer's axles within 0.4 m of it; 0.1 at 1.5 m more",
        "speed": "within 1 m/s of 20 m/s; 0.1 at 8 m/s more",
        "comfort": "lateral acceleration within 1.5 m/s2; 0.1 at 2 m/s2 more",
    }

    def wanted(self, physics: Physics, station: float) -> float:
        """Middle of the right lane."""
        return float(physics.route.lane_offset(0, station))

    def initialize_episode(self, physics: Physics) -> None:
        """Somewhere on the road, within 0.3 m of the lane's middle, at 17 to 21 m/s."""
        station = self.random.uniform(30.0, 2_500.0)
        offset = self.wanted(physics, station) + self.random.uniform(-0.3, 0.3)
        physics.place(station, offset, self.random.uniform(17.0, 21.0))
        super().initialize_episode(physics)

    def get_observation(self, physics: Physics) -> Observations:
        """What every path has, and the curvature now and ahead."""
        found = super().get_observation(physics)
        found["curvature_ahead"] = physics.curvature_ahead(PREVIEW)
        return found

    def reward_terms(self, physics: Physics) -> dict[str, float]:
        """`lane` and `trailer`: in the middle; `speed`: near 20 m/s; `comfort`: lateral."""
        sideways = abs(physics.lateral_acceleration())
        return {
            **self.path_terms(physics, 0.15),
            "comfort": float(rewards.tolerance(sideways, (0.0, 1.5), margin=2.0)),
        }
