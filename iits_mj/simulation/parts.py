"""Makes the parts of a simulation from its configuration: the traffic and the stack."""

from __future__ import annotations

from controllers import decision
from controllers.stack import Stack
from iits_mj.messages import EgoFootprint
from iits_mj.road import Route
from iits_mj.simulation.config import DriveConfig
from traffic_bridge import InterSim, TrafficConfig


def make_traffic(config: DriveConfig, route: Route, footprint: EgoFootprint) -> InterSim | None:
    """SUMO's traffic on the route, None for an empty road."""
    if config.traffic_mode == "none":
        return None
    traffic = TrafficConfig(
        density=config.density, speed_limit=config.traffic_speed, footprint=footprint
    )
    return InterSim(route, traffic, seed=config.seed)


def make_stack(config: DriveConfig, route: Route) -> Stack:
    """The pipeline from scene to command."""
    return Stack(route, decision.make(config.decision), reference_speed=config.speed)
