"""ISO 14791 single sine steer: rearward amplification, off-tracking, and yaw damping after."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from iits_mj.analytic import YawSideslip, rearward_amplification
from iits_mj.truck import Truck
from iits_mj.validation.recorder import Recording, drive

FloatArray = NDArray[np.float64]

FREQUENCY = 0.4
_SETTLE = 4.0
# Peak lateral acceleration wanted at the tractor [m/s2]: 1.5 is the standard's.
_WANTED = 1.5


@dataclass(frozen=True)
class LaneChange:
    """What one lane change showed.

    Attributes:
      amplification: peak lateral acceleration of the trailer's CG over the tractor's CG [1].
      reference: the linear model's amplification [1].
      off_tracking: greatest lateral distance of the trailer group's path from the steer axle's [m].
      damping: damping ratio from the articulation's decay afterwards, 1 when it does not swing [1].
      peak: lateral acceleration of the tractor [m/s2]; recording: of the run.
    """

    amplification: float
    reference: float
    off_tracking: float
    damping: float
    peak: float
    recording: Recording


def lane_change(payload: float, speed: float, timestep: float) -> LaneChange:
    """One sine at 0.4 Hz at the steering wheel at this speed [m/s]."""
    truck = Truck.load(payload, timestep=timestep, visuals=False)
    truck.reset(speed=speed)
    system = YawSideslip.from_parameters(truck.parameters, payload, cruise_speed=speed).at(speed)
    gain = system.frequency_response(np.array([FREQUENCY]))[0]
    per_steer = abs(2j * np.pi * FREQUENCY * gain[0] + speed * gain[1])
    amplitude = _WANTED / per_steer * truck.parameters.steering.ratio

    def steering(time: float, _: float) -> float:
        phase = (time - _SETTLE) * FREQUENCY
        return float(amplitude * np.sin(2.0 * np.pi * phase)) if 0.0 <= phase <= 1.0 else 0.0

    record = drive(truck, steering, speed=speed, duration=_SETTLE + 12.0).after(_SETTLE)
    tractor = np.max(np.abs(record.lateral_acceleration))
    trailer = np.max(np.abs(record.trailer_lateral_acceleration))
    path = np.interp(record.rear_x, record.x, record.y)
    inside = (record.rear_x >= record.x[0]) & (record.rear_x <= record.x[-1])
    return LaneChange(
        amplification=float(trailer / tractor),
        reference=rearward_amplification(system, FREQUENCY),
        off_tracking=float(np.max(np.abs(record.rear_y - path)[inside])),
        damping=damping_ratio(record.articulation[record.time > 1.0 / FREQUENCY]),
        peak=float(tractor),
        recording=record,
    )


def damping_ratio(signal: FloatArray) -> float:
    """Damping ratio by the mean ratio of successive swings; 1 with fewer than two swings (n,)."""
    signal = signal - signal[-1]
    turns = np.flatnonzero(np.diff(np.sign(np.diff(signal))) != 0) + 1
    swings = np.abs(signal[turns])
    swings = swings[swings > 0.02 * np.max(np.abs(signal))]
    if len(swings) < 2 or (np.any(swings[1:] >= swings[:-1]) and len(swings) == 2):
        return 1.0
    decrement = float(np.mean(np.log(swings[:-1] / swings[1:])))
    # Successive swings are half a period apart.
    return float(decrement / np.hypot(np.pi, decrement))
