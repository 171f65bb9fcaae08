"""Recorded trajectories of other people's making: read, checked, and laid on any map."""

from traffic_bridge.datasets.pairs import Pair, pairs
from traffic_bridge.datasets.read import read_trajectories
from traffic_bridge.datasets.trajectories import Trajectories

__all__ = ["Pair", "Trajectories", "pairs", "read_trajectories"]
