"""Rearward amplification by ISO 14791: one full sine of 0.4 Hz at the steering wheel, open loop.

The standard compares the last unit's centre of gravity with the first unit's steer axle. The bound
of 5.7 times the roll-over threshold is that of the Australian PBS, which asks it of its own lane
change (`path_change`), known to us without the text of its Rules at hand.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from iits_mj.analytic import LateralSystem, Response, YawSideslip, simulate, single_sine
from iits_mj.core.arrays import FloatArray
from iits_mj.core.results import Check, Line, Panel
from iits_mj.core.units import KMH
from iits_mj.truck import Truck
from iits_mj.validation.harness.recorder import Recording, drive, run_straight

FREQUENCY = 0.4
# Peak lateral acceleration of the steer axle [m/s2].
PEAK = 1.5
# Allowed error of the held speed [km/h], our choice.
SPEED_TOLERANCE = 1.0
# PBS: rearward amplification at most this many times the roll-over threshold in g.
PBS_FACTOR = 5.7
_LEAD = 0.5
_LENGTH = 10.0


@dataclass(frozen=True)
class Amplification:
    """A lane change's recording and the linear model's answer to the same road-wheel angle."""

    recording: Recording
    model: Response
    system: LateralSystem

    def truck(self) -> float:
        """Rearward amplification of the truck [1]."""
        rear = np.max(np.abs(self.recording.trailer_lateral_acceleration))
        return float(rear / np.max(np.abs(steer_axle_acceleration(self.recording))))

    def linear(self) -> float:
        """The linear model's [1]."""
        rear = np.max(np.abs(self.model.trailer_lateral_acceleration))
        return float(rear / np.max(np.abs(self.model.steer_axle_acceleration)))

    def peak(self) -> float:
        """Greatest lateral acceleration of the steer axle [m/s2]."""
        return float(np.max(np.abs(steer_axle_acceleration(self.recording))))

    def speed_error(self) -> float:
        """Greatest departure from the wanted speed [km/h]."""
        return float(np.max(np.abs(self.recording.speed - self.system.speed)) / KMH)


def steer_axle_acceleration(record: Recording) -> FloatArray:
    """Lateral acceleration of the steer axle's centre on the ground [m/s2], shape (n,)."""
    return np.asarray(
        np.gradient(record.lateral_velocity, record.time) + record.speed * record.yaw_rate
    )


def linear_system(truck: Truck, speed: float) -> LateralSystem:
    """The linear model of this truck at this speed [m/s], tires loaded as at cruise."""
    model = YawSideslip.from_parameters(truck.parameters, truck.payload, cruise_speed=speed)
    return model.at(speed)


def sine_steer(
    payload: float, speed: float, timestep: float, parameters: Mapping[str, Any] | None = None
) -> Amplification:
    """One sine at this speed [m/s], sized by the linear model to `PEAK` at the steer axle."""
    truck = Truck.load(payload, parameters=parameters, timestep=timestep, visuals=False)
    truck.reset(speed=speed)
    system = linear_system(truck, speed)
    time, unit = single_sine(1.0 / FREQUENCY, 1.0 / FREQUENCY + 4.0)
    answer = simulate(system, time, 1e-3 * unit)
    per_steer = float(np.max(np.abs(answer.steer_axle_acceleration))) / 1e-3
    height = PEAK / per_steer * truck.parameters.steering.ratio

    def steering(time: float, _: float) -> float:
        phase = (time - _LEAD) * FREQUENCY
        return float(height * np.sin(2.0 * np.pi * phase)) if 0.0 <= phase <= 1.0 else 0.0

    hold = run_straight(truck, speed)
    record = drive(truck, steering, speed=speed, duration=_LEAD + _LENGTH, hold=hold)
    return Amplification(record, simulate(system, record.time, record.road_wheel), system)


def compare(
    payload: float, kph: float, threshold: float, timestep: float
) -> tuple[list[Check], list[Panel]]:
    """Checks and panels at one speed [km/h]; threshold: static roll-over threshold [g]."""
    done = sine_steer(payload, kph * KMH, timestep)
    label = f"ISO 14791 single sine, {payload / 1e3:g} t, {kph:g} km/h"
    checks = [
        Check(
            f"{label}: rearward amplification",
            done.truck(),
            "1",
            done.linear(),
            f"<= {PBS_FACTOR * threshold:.2f}",
        ),
        Check(f"{label}: peak at the steer axle", done.peak(), "m/s2", PEAK),
        Check(f"{label}: speed error", done.speed_error(), "km/h", None, f"<= {SPEED_TOLERANCE:g}"),
    ]
    record, time = done.recording, done.recording.time - _LEAD
    unit = "lateral acceleration [m/s2]"
    first = (
        Line(
            "yaw-sideslip model, steer axle",
            time,
            done.model.steer_axle_acceleration,
            "reference",
        ),
        Line("truck, steer axle", time, steer_axle_acceleration(record), "simulation"),
    )
    last = (
        Line(
            "yaw-sideslip model, trailer",
            time,
            done.model.trailer_lateral_acceleration,
            "reference",
        ),
        Line("truck, trailer", time, record.trailer_lateral_acceleration, "simulation"),
    )
    return checks, [
        Panel(f"{label}: steer axle", "time [s]", unit, first),
        Panel(f"{label}: trailer", "time [s]", unit, last),
    ]
