"""Predictive cruise control: fuel-optimal speed over a hilly road, offline and receding."""

from controllers.pcc.leader_constraint import FenceConfig, Leader
from controllers.pcc.planner import PccConfig, PccSolution, plan
from controllers.pcc.profile import RoadProfile
from controllers.pcc.receding import HorizonPlan, RecedingPlanner
from controllers.pcc.reference import PccReference, PccReport
from controllers.pcc.trip import Appointment, RecedingConfig

__all__ = [
    "Appointment",
    "FenceConfig",
    "HorizonPlan",
    "Leader",
    "PccConfig",
    "PccReference",
    "PccReport",
    "PccSolution",
    "RecedingConfig",
    "RecedingPlanner",
    "RoadProfile",
    "plan",
]
