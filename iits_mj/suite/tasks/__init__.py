"""The tasks of the domain `truck`. A reward is the product of named tolerances in [0, 1]."""

from iits_mj.suite.tasks.base import DrivingTask
from iits_mj.suite.tasks.encounters import CutInTask, EmergencyStop
from iits_mj.suite.tasks.highway import Highway
from iits_mj.suite.tasks.longitudinal import Cruise, HillStart, Stop
from iits_mj.suite.tasks.maneuvers import Dock, TightTurn
from iits_mj.suite.tasks.path import LaneChange, LaneKeep, PathTask, Platoon

# Tasks that control pedal, brakes and steering wheel, for dm_control and Gymnasium.
DRIVING_TASKS: dict[str, type[DrivingTask]] = {
    "cruise": Cruise,
    "stop": Stop,
    "hill_start": HillStart,
    "lane_keep": LaneKeep,
    "lane_change": LaneChange,
    "tight_turn": TightTurn,
    "dock": Dock,
    "cut_in": CutInTask,
    "emergency_stop": EmergencyStop,
}

__all__ = [
    "DRIVING_TASKS",
    "Cruise",
    "CutInTask",
    "Dock",
    "DrivingTask",
    "EmergencyStop",
    "Highway",
    "HillStart",
    "LaneChange",
    "LaneKeep",
    "PathTask",
    "Platoon",
    "Stop",
    "TightTurn",
]
