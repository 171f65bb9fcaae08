"""Parameters of engine, retarder, clutch and gearbox: `mjcf/truck.toml` and its CSV tables.

The TOML gives meaning, unit and source of each number; all are in SI units.
"""

from __future__ import annotations

from dataclasses import dataclass

from iits_mj.core.arrays import FloatArray
from iits_mj.core.checks import one_of
from iits_mj.parameters.files import Table2D

SHIFT_STRATEGIES = ("tables", "adaptive")


@dataclass(frozen=True)
class Engine:
    """The identified engine.

    Attributes:
      full_load_speed, full_load_torque: [rad/s], [N m], shape (n,).
      pedal_map: torque [N m] over engine speed [rad/s] (rows) and pedal 0..1 (columns).
      fuel_map: BSFC [kg/J] over torque [N m] (rows) and engine speed [rad/s] (columns).
    """

    idle_speed: float
    governed_speed: float
    governor_droop: float
    reference_torque: float
    inertia: float
    pedal_up: float
    pedal_fade: float
    pedal_return_time: float
    torque_rise_rate: float
    torque_rise_rate_low: float
    torque_rise_threshold: float
    torque_fall_rate: float
    torque_fall_rate_low: float
    torque_fall_threshold: float
    torque_cut_time: float
    boost_lag: float
    spool_time: float
    idle_gain: float
    idle_integral_gain: float
    idle_band: float
    idle_integral_min: float
    idle_integral_max: float
    idle_forget_time: float
    synchronization_lag: float
    synchronization_torque_share: float
    synchronization_brake_share: float
    drag_speed: tuple[float, ...]
    drag_torque: tuple[float, ...]
    engine_brake_power: float
    engine_brake_speed: float
    engine_brake_exponent: float
    engine_brake_speed_min: float
    engine_brake_fade: float
    engine_brake_lag: float
    engine_brake_release_lag: float
    idle_fuel_rate: float
    full_load_speed: FloatArray
    full_load_torque: FloatArray
    pedal_map: Table2D
    fuel_map: Table2D


@dataclass(frozen=True)
class Retarder:
    """Hydrodynamic retarder on the propeller shaft; `torque_max` 0 is a truck without one."""

    torque_max: float
    full_torque_speed: float
    power_max: float
    power_continuous: float
    heat_time: float
    derate_heat: float
    fill_time: float
    empty_time: float


@dataclass(frozen=True)
class Clutch:
    """Motion of the clutch; its capacity and engagement times are in `Gearbox`."""

    opening_time: float
    launch_range: float
    alike_range: float
    release_share: float
    release_share_coast: float
    stall_share: float
    stall_range: float


@dataclass(frozen=True)
class Shifting:
    """Parameters of the gearbox controller in addition to the shift tables."""

    acceleration_lag: float
    load_lag: float
    pedal_lag: float
    reversal_time: float
    lowest_speed: float
    lowest_speed_pedal: float
    rolling_speed: float
    recovery_horizon: float
    recovery_speed: float
    recovery_time: float
    upshift_speed_margin: float
    downshift_speed_margin: float
    downshift_speed_max: float
    power_speed: float
    overspeed: float
    overspeed_braking: float
    torque_reserve: float
    failed_reserve: float
    failed_load: float
    built_up_torque: float
    stuck_acceleration: float
    first_gear_delay: float
    engage_speed_max: float
    floored_pedal: float
    kick_down_pedal: float
    kick_down_rise: float
    kick_down_speed: float
    skip_up_max: int
    skip_down_max: int
    braking_speed_low: float
    braking_speed_high: float
    braking_deceleration: float
    adaptive_period: float
    adaptive_reserve: float
    adaptive_gain: float
    adaptive_speed_max: float
    adaptive_horizon: float


@dataclass(frozen=True)
class Gearbox:
    """The automated 12-speed gearbox with clutch times and driveline.

    Attributes:
      ratios: of gears 1 to 12, shape (12,).
      inertias: at the gearbox input, per gear [kg m2], shape (12,).
      upshift: vehicle speed [m/s] over from-gear 1..11 (rows) and pedal (columns).
      downshift: vehicle speed [m/s] over from-gear 2..12 (rows) and pedal (columns).
      shifting: parameters of the gearbox controller in addition to the tables.
    """

    final_drive: float
    efficiency: float
    driveline_efficiency: float
    start_gear: int
    reverse_ratio: float
    shift_cut_time: float
    synchronization_time: float
    synchronization_time_max: float
    synchronized_difference: float
    clutch_engagement_time: float
    clutch_close_time: float
    clutch_torque_max: float
    driveline_stiffness: float
    driveline_damping: float
    loss_reversal_speed: float
    downshift_delay: float
    downshift_margin: float
    min_gear_time: float
    shift_strategy: str
    ratios: FloatArray
    inertias: FloatArray
    upshift: Table2D
    downshift: Table2D
    shifting: Shifting

    def __post_init__(self) -> None:
        one_of("parameter gearbox.shift_strategy", self.shift_strategy, SHIFT_STRATEGIES)
