"""The tasks of the domain `truck`. A reward is the product of named tolerances in [0, 1]."""

from iits_mj.suite.tasks.base import DrivingTask, PathTask
from iits_mj.suite.tasks.dock import Dock
from iits_mj.suite.tasks.highway import Highway
from iits_mj.suite.tasks.lane_change import LaneChange
from iits_mj.suite.tasks.lane_keep import LaneKeep
from iits_mj.suite.tasks.longitudinal import Cruise, HillStart, Stop
from iits_mj.suite.tasks.platoon import Platoon
from iits_mj.suite.tasks.tight_turn import TightTurn

__all__ = [
    "Cruise",
    "Dock",
    "DrivingTask",
    "Highway",
    "HillStart",
    "LaneChange",
    "LaneKeep",
    "PathTask",
    "Platoon",
    "Stop",
    "TightTurn",
]
