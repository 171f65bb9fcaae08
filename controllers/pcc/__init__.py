"""Predictive cruise control: fuel-optimal speed over a hilly road, offline and receding."""

from controllers.pcc.planner import PccConfig, PccSolution, plan
from controllers.pcc.profile import RoadProfile

__all__ = ["PccConfig", "PccSolution", "RoadProfile", "plan"]
