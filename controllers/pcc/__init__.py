"""Predictive cruise control: fuel-optimal speed over a hilly road, offline and online."""

from controllers.pcc.leader_constraint import Leader, LeaderConfig
from controllers.pcc.planner import PccComparison, PccConfig, plan
from controllers.pcc.profile import RoadProfile
from controllers.pcc.receding import HorizonPlan, RecedingPlanner
from controllers.pcc.reference import PccReference, PccReport
from controllers.pcc.solver import solve
from controllers.pcc.task import Solution, SpeedTask
from controllers.pcc.trip import Appointment, RecedingConfig

__all__ = [
    "Appointment",
    "HorizonPlan",
    "Leader",
    "LeaderConfig",
    "PccComparison",
    "PccConfig",
    "PccReference",
    "PccReport",
    "RecedingConfig",
    "RecedingPlanner",
    "RoadProfile",
    "Solution",
    "SpeedTask",
    "plan",
    "solve",
]
