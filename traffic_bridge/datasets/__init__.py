"""Reads and checks recorded trajectories of any source, and places them on the road of any map.

from traffic_bridge.datasets import ImportConfig, import_trajectories, read_trajectories

trajectories = read_trajectories("tracks.csv")
recording = import_trajectories(trajectories, route, ImportConfig(start_station=2900.0))
recording.save("imported.npz")
"""

from traffic_bridge.datasets.kinematics import without_noise
from traffic_bridge.datasets.read import read_trajectories
from traffic_bridge.datasets.recordings import of_recording, write_fcd
from traffic_bridge.datasets.trajectories import Pair, Trajectories, pairs
from traffic_bridge.datasets.trajectory_import import ImportConfig, import_trajectories

__all__ = [
    "ImportConfig",
    "Pair",
    "Trajectories",
    "import_trajectories",
    "of_recording",
    "pairs",
    "read_trajectories",
    "without_noise",
    "write_fcd",
]
