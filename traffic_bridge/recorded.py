"""The modes that make and use recordings, by their earlier place."""

from traffic_bridge.recorder import Recorder
from traffic_bridge.repsim import RepSim
from traffic_bridge.resim import ReSim

__all__ = ["ReSim", "Recorder", "RepSim"]
