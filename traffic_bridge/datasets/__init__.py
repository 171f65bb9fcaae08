"""Recorded trajectories of other people's making: read, checked, and laid on any map.

from traffic_bridge.datasets import Lay, lay, read_trajectories

trajectories = read_trajectories("tracks.csv")
recording = lay(trajectories, route, Lay(start_station=2900.0))
recording.save("laid.npz")
"""

from traffic_bridge.datasets.kinematics import without_noise
from traffic_bridge.datasets.own import of_recording, write_fcd
from traffic_bridge.datasets.pairs import Pair, pairs
from traffic_bridge.datasets.placement import Lay, lay
from traffic_bridge.datasets.read import read_trajectories
from traffic_bridge.datasets.trajectories import Trajectories

__all__ = [
    "Lay",
    "Pair",
    "Trajectories",
    "lay",
    "of_recording",
    "pairs",
    "read_trajectories",
    "without_noise",
    "write_fcd",
]
