"""Parameters of the air brakes that all axles share: a truck's TOML and its pressure table."""

from __future__ import annotations

from dataclasses import dataclass, field

from iits_mj.core.arrays import FloatArray
from iits_mj.parameters.quantity import (
    Acceleration,
    CubicMeters,
    CubicMetersPerRadian,
    Jerk,
    Kilograms,
    NewtonMeters,
    Pascals,
    PascalsPerSecond,
    PerSecond,
    Pure,
    RollStiffness,
    Seconds,
    Speed,
)
from iits_mj.parameters.tables import no_numbers


@dataclass(frozen=True)
class AirBrake:
    """Air brakes; `Axle.brake` has what differs from axle to axle.

    Attributes:
      trailer_line_delay: of the control line to a towed unit, whose valves follow the unit ahead.
      supply_rise_rate, supply_fall_rate, pressure_max: of the supply valves.
      anchor_pressure: at which `torque_per_pressure` of an axle gives its torque.
      drive_slip_lag, drive_slip_lead: of the rate of the driven wheels' slip.
      drag_slip_begin, drag_slip_end, drag_release_time, drag_return_time: slips at which
        drag-torque control begins and ends, and times in which the drag torque goes and returns.
      asr_slip_begin, asr_slip_end, asr_release_time, asr_return_time: the same for traction control
        (ASR) and the accelerator.
      asr_hold_time, asr_slip_range: of the control that holds the slip while the truck starts.
      asr_brake_speed, asr_brake_pressure: greatest speed and pressure of a braked spinning wheel.
      distribution: "axle_loads": every axle uses the same friction; "table": shares follow the
        pressure table.
      release_rate: at which the XBR demand falls when it ends.
      pedal_deceleration: demanded by the fully pressed pedal.
      filter_time_constant, trim_gain, trim_max, trim_share, trim_speed_min,
        hysteresis_time_constant: of the deceleration control.
      endurance_speed_off, endurance_speed_on: speeds between which engine brake and retarder hand
        over to friction; `endurance_rate`: at which their torque demand rises.
      hold_speed, hold_deceleration, hold_release_speed, hill_hold_time, hill_hold_min: of holding
        at standstill.
      reservoir_volume: of the front, drive and trailer circuit; the last serves all towed units.
      compressor_displacement: volume of free air per angle of the crankshaft.
      spring_begin_pressure, spring_full_pressure: reservoir pressures below which the spring
        brakes begin to act, and act fully.
      mass_light, mass_heavy: of the two columns of the pressure table.
      demand: demanded deceleration, positive and rising [m/s2], shape (n,).
      pressure_light, pressure_heavy: pressure [Pa] of (front, drive, trailer) circuits at the two
        masses, shape (n, 3).
    """

    trailer_line_delay: Seconds
    supply_rise_rate: PascalsPerSecond
    supply_fall_rate: PascalsPerSecond
    anchor_pressure: Pascals
    push_out_pressure: Pascals
    hysteresis_pressure: Pascals
    pressure_max: Pascals
    abs_release_slip: Pure
    abs_reapply_slip: Pure
    abs_speed_min: Speed
    abs_time_constant: Seconds
    abs_yaw_share: Pure
    abs_yaw_rise_rate: PascalsPerSecond
    abs_pressure_lag: Seconds
    abs_refill_share: Pure
    abs_rise_time: Seconds
    abs_slip_lag: Seconds
    abs_slip_lead: Seconds
    abs_speed_low: Speed
    drive_slip_lag: Seconds
    drive_slip_lead: Seconds
    drag_slip_begin: Pure
    drag_slip_end: Pure
    drag_release_time: Seconds
    drag_return_time: Seconds
    asr_slip_begin: Pure
    asr_slip_end: Pure
    asr_release_time: Seconds
    asr_return_time: Seconds
    asr_hold_time: Seconds
    asr_slip_range: Pure
    asr_brake_speed: Speed
    asr_brake_pressure: Pascals
    stiffness: RollStiffness
    parking_torque: NewtonMeters
    parking_time_constant: Seconds
    distribution: str
    release_rate: Jerk
    pedal_deceleration: Acceleration
    filter_time_constant: Seconds
    trim_gain: PerSecond
    trim_max: Acceleration
    trim_share: Pure
    trim_speed_min: Speed
    hysteresis_time_constant: Seconds
    endurance_speed_off: Speed
    endurance_speed_on: Speed
    endurance_rate: Jerk
    hold_speed: Speed
    hold_deceleration: Acceleration
    hold_release_speed: Speed
    hill_hold_time: Seconds
    hill_hold_min: Acceleration
    reservoir_volume: tuple[CubicMeters, ...]
    compressor_displacement: CubicMetersPerRadian
    governor_cut_in: Pascals
    governor_cut_out: Pascals
    spring_begin_pressure: Pascals
    spring_full_pressure: Pascals
    mass_light: Kilograms = 0.0
    mass_heavy: Kilograms = 0.0
    demand: FloatArray = field(default_factory=no_numbers)
    pressure_light: FloatArray = field(default_factory=no_numbers)
    pressure_heavy: FloatArray = field(default_factory=no_numbers)
