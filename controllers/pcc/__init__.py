"""Predictive cruise control: fuel-optimal speed over a hilly road, offline and receding."""

from controllers.pcc.planner import PccConfig, PccSolution, plan
from controllers.pcc.profile import RoadProfile
from controllers.pcc.receding import HorizonPlan, Leader, RecedingConfig, RecedingPlanner

__all__ = [
    "HorizonPlan",
    "Leader",
    "PccConfig",
    "PccSolution",
    "RecedingConfig",
    "RecedingPlanner",
    "RoadProfile",
    "plan",
]
