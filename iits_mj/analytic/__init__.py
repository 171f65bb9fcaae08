"""Analytic models of any combination of units as pure functions of its parameters.

`Kinematic` is the slip-free model, `YawPlane` the linear lateral model, `YawRoll` the same with
roll, tire lag, side wind and traction; `measures` computes what they predict. They do not use
MuJoCo, and nothing is fitted to the simulation.
"""

from iits_mj.analytic.kinematic import Kinematic
from iits_mj.analytic.measures import (
    Response,
    UnitHistories,
    amplification,
    critical_speed,
    rearward_amplification,
    simulate,
    single_sine,
    steady_off_tracking,
    step_response,
    understeer_gradient,
    understeer_gradient_by_loads,
    unit_track,
    worst_rearward_amplification,
    yaw_rate_gain,
)
from iits_mj.analytic.yaw_plane import LateralSystem, YawPlane
from iits_mj.analytic.yaw_roll import RollSystem, YawRoll
from iits_mj.parameters.mass_state import (
    coupling_loads,
    cruise_axle_loads,
    laden_units,
    static_axle_loads,
)
from iits_mj.parameters.tire_law import axle_cornering_stiffness

__all__ = [
    "Kinematic",
    "LateralSystem",
    "Response",
    "RollSystem",
    "UnitHistories",
    "YawPlane",
    "YawRoll",
    "amplification",
    "axle_cornering_stiffness",
    "coupling_loads",
    "critical_speed",
    "cruise_axle_loads",
    "laden_units",
    "rearward_amplification",
    "simulate",
    "single_sine",
    "static_axle_loads",
    "steady_off_tracking",
    "step_response",
    "understeer_gradient",
    "understeer_gradient_by_loads",
    "unit_track",
    "worst_rearward_amplification",
    "yaw_rate_gain",
]
