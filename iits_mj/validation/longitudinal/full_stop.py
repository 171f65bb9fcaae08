"""Full stops with the service brake: UN R13 type 0 from 60 km/h, and FMVSS 121 from 60 mph.

Dry road, pedal down at once, driveline open. UN R13, annex 4, 2.1, vehicles of category N: the way
is at most 0.15 v + v^2 / 130 (m, km/h), the mean fully developed deceleration at least 5 m/s2.
FMVSS 121 (49 CFR 571.121), table II, tractors of three axles: 250 ft loaded, 235 ft lightly loaded;
the regulation tests the tractor with an unbraked control trailer of light axle load, here the whole
combination stops within it, hence "style". No wheel may stay locked for longer than 1 s above
15 km/h.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from iits_mj.core.arrays import FloatArray
from iits_mj.core.messages import TransmissionMode, VehicleCommand
from iits_mj.core.results import Check, Line, Panel
from iits_mj.core.units import KMH
from iits_mj.truck import Truck
from iits_mj.validation.harness.recorder import PERIOD
from iits_mj.validation.longitudinal.runs import Run, run

# --- What brake tests measure in a recorded drive: pressures, jerk, locked wheels, distance ---

# A chamber's pressure has begun to rise [Pa].
_RISEN = 2e3
_LOCKED = 0.8


def mean_pressure(record: Run) -> FloatArray:
    """Pressure averaged over all chambers [Pa], shape (n,)."""
    return np.asarray(record.wheel_pressures.mean(axis=1))


def rise_time(time: FloatArray, pressure: FloatArray, share: float, final: float) -> float:
    """Time [s] after which a pressure (n,) has reached this share of its final level [Pa]."""
    reached = np.flatnonzero((time >= 0.0) & (pressure >= share * final))
    return float(time[reached[0]]) if len(reached) else float("nan")


def first_rise(time: FloatArray, pressure: FloatArray) -> float:
    """Time [s] after which a pressure (n,) has risen by 2 kPa."""
    before = float(pressure[time <= 0.0][-1])
    risen = np.flatnonzero((time >= 0.0) & (pressure > before + _RISEN))
    return float(time[risen[0]]) if len(risen) else float("nan")


def lock_time(record: Run, above: float = 15.0 * KMH) -> float:
    """Longest time [s] for which one and the same wheel slips by 80 % or more above a speed."""
    locked = (np.abs(record.wheel_slips) > _LOCKED) & (record.speed > above)[:, None]
    longest, current = 0, np.zeros(locked.shape[1], dtype=int)
    for now in locked:
        current = np.where(now, current + 1, 0)
        longest = max(longest, int(current.max()))
    return longest * PERIOD


def distance(record: Run) -> float:
    """Way from the first sample to the last [m]."""
    return float(record.station[-1] - record.station[0])


def fully_developed(record: Run) -> float:
    """Mean fully developed deceleration [m/s2]: over the way from 80 to 10 % of the speed.

    UN R13, annex 4, 1.1.2. Nan when the truck did not get that slow.
    """
    fast, slow = (record.speed <= share * record.speed[0] for share in (0.8, 0.1))
    if not slow.any():
        return float("nan")
    a, b = int(np.argmax(fast)), int(np.argmax(slow))
    way = record.station[b] - record.station[a]
    return float((record.speed[a] ** 2 - record.speed[b] ** 2) / (2.0 * way))


def mean_jerk(record: Run, window: float) -> FloatArray:
    """Change of the acceleration over a window [s], per time [m/s3], shape (n - k,).

    The acceleration is that of the speed, as the chassis pitches in front of an accelerometer.
    """
    rate = smooth_rate(record)
    k = round(window / PERIOD)
    return np.asarray((rate[k:] - rate[:-k]) / (k * PERIOD))


def smooth_rate(record: Run, window: float = 0.1) -> FloatArray:
    """Slope of the speed over a window [m/s2], shape (n,)."""
    k = max(1, round(0.5 * window / PERIOD))
    padded = np.pad(record.speed, k, mode="edge")
    rate = (padded[2 * k :] - padded[: -2 * k]) / (2 * k * PERIOD)
    # At both ends only half of the window is there.
    rate[:k], rate[-k:] = rate[k], rate[-k - 1]
    return np.asarray(rate)


def panel(title: str, y_label: str, record: Run, values: FloatArray) -> Panel:
    """A time history of the truck."""
    return Panel(title, "time [s]", y_label, (Line("truck", record.time, values, "simulation"),))


# --- Full stops with the service brake: UN R13 type 0 from 60 km/h, and FMVSS 121 from 60 mph ---

_FOOT = 0.3048
_MPH = 1.609344 * KMH
_DURATION = 20.0
_STANDS = 0.05
_DECELERATION = 5.0


# Everything that the service brake has, driveline open.
FULL = VehicleCommand(brake_pedal=1.0, transmission_mode=TransmissionMode.NEUTRAL)


@dataclass(frozen=True)
class Regulation:
    """A stop that a regulation asks for: name, speed [m/s], greatest distance laden and empty."""

    name: str
    speed: float
    laden: float
    empty: float


UN_R13 = Regulation(
    "60 km/h (UN R13 type 0)",
    60.0 * KMH,
    0.15 * 60.0 + 60.0**2 / 130.0,
    0.15 * 60.0 + 60.0**2 / 130.0,
)
FMVSS_121 = Regulation("60 mph (FMVSS 121 style)", 60.0 * _MPH, 250.0 * _FOOT, 235.0 * _FOOT)
REGULATIONS = (UN_R13, FMVSS_121)


def stop_run(
    payload: float, speed: float, timestep: float, parameters: Mapping[str, Any] | None = None
) -> Run:
    """Pedal down in full from a speed [m/s] until the truck stands."""
    truck = Truck.load(payload, parameters=parameters, timestep=timestep, visuals=False)
    truck.reset(speed=speed)
    return run(truck, lambda *_: FULL, _DURATION, stop=lambda state: state.speed < _STANDS)


def full_stop(
    payload: float, regulation: Regulation, timestep: float
) -> tuple[list[Check], list[Panel]]:
    """One regulation's stop at one payload [kg]."""
    record = stop_run(payload, regulation.speed, timestep)
    parameters = Truck.load(payload, timestep=timestep, visuals=False).parameters
    label = f"full stop from {regulation.name}, {parameters.gross_mass(payload) / 1e3:g} t"
    allowed = regulation.laden if payload > 0.0 else regulation.empty
    checks = [
        Check(f"{label}: distance", distance(record), "m", allowed, f"<= {allowed:.1f}"),
        Check(f"{label}: longest lock-up above 15 km/h", lock_time(record), "s", None, "<= 1"),
        Check(f"{label}: speed at the end", abs(float(record.speed[-1])), "m/s", 0.0, "<= 0.1"),
    ]
    developed = f"{label}: mean fully developed deceleration"
    must = f">= {_DECELERATION:g}" if regulation is UN_R13 else ""
    checks.append(Check(developed, fully_developed(record), "m/s2", None, must))
    return checks, [
        panel(f"{label}: speed", "speed [km/h]", record, record.speed / KMH),
        panel(f"{label}: greatest slip", "slip [1]", record, record.slip),
    ]
