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

from iits_mj.messages import TransmissionMode, VehicleCommand
from iits_mj.results import Check, Panel
from iits_mj.truck import Truck
from iits_mj.units import KMH
from iits_mj.validation.brake_measures import distance, fully_developed, lock_time, panel
from iits_mj.validation.longitudinal_run import Run, run

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
