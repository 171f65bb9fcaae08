"""The lock-step of truck, traffic and stack: one clock, three rates, deterministic.

from iits_mj.simulation import DriveConfig, Simulation

with Simulation(DriveConfig(duration=30.0)) as simulation:
    summary = simulation.run()
print(summary.to_text())
"""

from iits_mj.simulation.config import DriveConfig, ServeConfig
from iits_mj.simulation.frame import DriveFrame
from iits_mj.simulation.lock_step import LockStep, Observer
from iits_mj.simulation.loop import Simulation
from iits_mj.simulation.server import Server
from iits_mj.simulation.summary import DriveSummary, ServeSummary
from iits_mj.simulation.telemetry import Telemetry

__all__ = [
    "DriveConfig",
    "DriveFrame",
    "DriveSummary",
    "LockStep",
    "Observer",
    "ServeConfig",
    "ServeSummary",
    "Server",
    "Simulation",
    "Telemetry",
]
