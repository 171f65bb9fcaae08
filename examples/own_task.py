"""A task with a reward of its own: lane keeping with a straight combination."""

from iits_mj import suite
from iits_mj.suite.tasks import LaneKeep
from iits_mj.suite.tasks.base import tolerance


class StraightLaneKeep(LaneKeep):
    def reward_terms(self, physics):
        bent = abs(physics.ego().articulation)
        return super().reward_terms(physics) | {"straight": tolerance(bent, 0.0, 0.02, 0.1)}


suite.register("straight_lane_keep", StraightLaneKeep)
