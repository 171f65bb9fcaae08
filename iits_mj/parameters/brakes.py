"""Parameters of the air brakes: `mjcf/truck.toml` and its pressure table."""

from __future__ import annotations

from dataclasses import dataclass

from iits_mj.core.arrays import FloatArray


@dataclass(frozen=True)
class AirBrake:
    """Air brakes of six axles, front to rear; SI units.

    Attributes:
      dead_time: from supply valve to chamber, per axle; `trailer_line_delay` is added on the
        trailer, whose valve follows a control line.
      build_up_time_constant, release_time_constant: of the chambers, per axle.
      supply_rise_rate, supply_fall_rate, pressure_max: of the supply valves.
      torque_per_pressure: slope through zero, per axle, of one wheel end; with a push-out pressure
        the torque is the same at `anchor_pressure`.
      chamber_volume: of one chamber, per axle.
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
      reservoir_volume: of the front, drive and trailer circuit.
      compressor_displacement: volume of free air per angle of the crankshaft.
      spring_begin_pressure, spring_full_pressure: reservoir pressures below which the spring
        brakes begin to act, and act fully.
      mass_light, mass_heavy: of the two columns of the pressure table.
      demand: demanded deceleration, positive and rising [m/s2], shape (n,).
      pressure_light, pressure_heavy: pressure [Pa] of (front, drive, trailer) circuits at the two
        masses, shape (n, 3).
    """

    dead_time: tuple[float, ...]
    trailer_line_delay: float
    build_up_time_constant: tuple[float, ...]
    release_time_constant: tuple[float, ...]
    supply_rise_rate: float
    supply_fall_rate: float
    torque_per_pressure: tuple[float, ...]
    anchor_pressure: float
    push_out_pressure: float
    hysteresis_pressure: float
    pressure_max: float
    chamber_volume: tuple[float, ...]
    abs_release_slip: float
    abs_reapply_slip: float
    abs_speed_min: float
    abs_time_constant: float
    abs_yaw_rise_rate: float
    abs_slip_lag: float
    abs_slip_lead: float
    abs_speed_low: float
    drive_slip_lag: float
    drive_slip_lead: float
    drag_slip_begin: float
    drag_slip_end: float
    drag_release_time: float
    drag_return_time: float
    asr_slip_begin: float
    asr_slip_end: float
    asr_release_time: float
    asr_return_time: float
    asr_hold_time: float
    asr_slip_range: float
    asr_brake_speed: float
    asr_brake_pressure: float
    stiffness: float
    parking_torque: float
    parking_time_constant: float
    distribution: str
    release_rate: float
    pedal_deceleration: float
    filter_time_constant: float
    trim_gain: float
    trim_max: float
    trim_share: float
    trim_speed_min: float
    hysteresis_time_constant: float
    endurance_speed_off: float
    endurance_speed_on: float
    endurance_rate: float
    hold_speed: float
    hold_deceleration: float
    hold_release_speed: float
    hill_hold_time: float
    hill_hold_min: float
    reservoir_volume: tuple[float, ...]
    compressor_displacement: float
    governor_cut_in: float
    governor_cut_out: float
    spring_begin_pressure: float
    spring_full_pressure: float
    mass_light: float
    mass_heavy: float

    demand: FloatArray
    pressure_light: FloatArray
    pressure_heavy: FloatArray
