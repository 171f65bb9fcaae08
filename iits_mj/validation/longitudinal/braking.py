"""Brake tests: XBR, response of the service brake, and full stops.

**XBR** -1.5 m/s2 at 60 km/h as in the paper: build-up, mean, overshoot, pressure and release.

**Response** on the standing truck (UN R13, annex 6): the pedal goes down at once and in full. The
least favorable chamber must have 75 % of its final pressure within 0.6 s. The pressure begins to
rise after the dead time of the lines; the trailer's control line adds its own.

**Full stops** on a dry road, pedal down at once, driveline open. UN R13 type 0 from 60 km/h (annex
4, 2.1, vehicles of category N): the distance is at most 0.15 v + v^2 / 130 (m, km/h), the mean
fully developed deceleration at least 5 m/s2. FMVSS 121 (49 CFR 571.121), table II, tractors with
three axles, from 60 mph: 250 ft loaded, 235 ft lightly loaded. That regulation tests the tractor
with an unbraked control trailer of light axle load; here the whole combination stops within the
distance, hence "style". No wheel may stay locked for longer than 1 s above 15 km/h.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from iits_mj.core.arrays import FloatArray
from iits_mj.core.messages import TransmissionMode, VehicleCommand, XbrEbiMode, XbrMode
from iits_mj.core.results import Findings, Line
from iits_mj.core.units import KMH
from iits_mj.parameters import TruckParameters
from iits_mj.road import Route
from iits_mj.validation.harness.maneuver import Run, first_time, run
from iits_mj.validation.harness.recorder import PERIOD, placed_truck

# Full service brake with an open driveline.
FULL = VehicleCommand(brake_pedal=1.0, transmission_mode=TransmissionMode.NEUTRAL)
# Least rise of a chamber's pressure that is detected [Pa].
_RISEN = 2e3
_LOCKED = 0.8

# The paper's XBR test: speed [m/s], demand [m/s2], and times of demand, release and end [s].
SPEED = 60.0 * KMH
DEMAND = 1.5
START, RELEASE, END = 1.0, 8.0, 13.0
# Time after which the deceleration has built up [s].
_BUILD_UP = 2.0
# Gross mass at which the paper gives the pressure [t].
_ANCHOR_MASS = 50.0
# Jerk that ISO 15622 allows at low speed, over a time in which a sudden release exceeds it.
_JERK, _JERK_WINDOW = 5.0, 0.2
# Time after the release in which the deceleration must end [s].
_GONE = 1.5
# Pedal on the standing truck [s].
_PEDAL_DOWN, _PEDAL_UP, _PEDAL_END = 1.0, 4.0, 7.0
# Delay of a detected rise: it must reach 2 kPa, and is sampled every 10 ms [s].
_DETECTED = 0.03
# Full stops: greatest duration [s], and speed at standstill [m/s].
_LONGEST, _STANDS = 20.0, 0.05


def mean_pressure(record: Run) -> FloatArray:
    """Mean pressure of all chambers [Pa], shape (n,)."""
    return np.asarray(record.wheel_pressures.mean(axis=1))


def rise_time(time: FloatArray, pressure: FloatArray, share: float, final: float) -> float:
    """Time [s] after which a pressure (n,) reaches this share of its final value [Pa]."""
    return first_time(time, (time >= 0.0) & (pressure >= share * final))


def first_rise(time: FloatArray, pressure: FloatArray) -> float:
    """Time [s] after which a pressure (n,) has risen by 2 kPa."""
    before = float(pressure[time <= 0.0][-1])
    return first_time(time, (time >= 0.0) & (pressure > before + _RISEN))


def lock_time(record: Run, above: float = 15.0 * KMH) -> float:
    """Longest time [s] in which one wheel slips by 80 % or more above a speed [m/s]."""
    locked = (np.abs(record.wheel_slips) > _LOCKED) & (record.speed > above)[:, None]
    longest, current = 0, np.zeros(locked.shape[1], dtype=int)
    for now in locked:
        current = np.where(now, current + 1, 0)
        longest = max(longest, int(current.max()))
    return longest * PERIOD


class Stop(Protocol):
    """Station [m] and speed [m/s] of a stop, shape (n,)."""

    @property
    def station(self) -> FloatArray:
        """[m]."""

    @property
    def speed(self) -> FloatArray:
        """[m/s]."""


def distance(record: Stop) -> float:
    """Distance along the road from the first sample to the last [m]."""
    return float(record.station[-1] - record.station[0])


def fully_developed(record: Stop) -> float:
    """Mean fully developed deceleration [m/s2], from 80 to 10 % of the initial speed.

    UN R13, annex 4, 1.1.2. NaN if the truck does not become that slow.
    """
    fast, slow = (record.speed <= share * record.speed[0] for share in (0.8, 0.1))
    if not slow.any():
        return float("nan")
    a, b = int(np.argmax(fast)), int(np.argmax(slow))
    way = record.station[b] - record.station[a]
    return float((record.speed[a] ** 2 - record.speed[b] ** 2) / (2.0 * way))


def smooth_rate(record: Run, window: float = 0.1) -> FloatArray:
    """Slope of the speed over a window [m/s2], shape (n,)."""
    k = max(1, round(0.5 * window / PERIOD))
    padded = np.pad(record.speed, k, mode="edge")
    rate = (padded[2 * k :] - padded[: -2 * k]) / (2 * k * PERIOD)
    # At both ends only half of the window lies in the record.
    rate[:k], rate[-k:] = rate[k], rate[-k - 1]
    return np.asarray(rate)


def mean_jerk(record: Run, window: float) -> FloatArray:
    """Mean jerk over a window [m/s3], shape (n - k,).

    It comes from the speed, because the pitch of the chassis would disturb an accelerometer.
    """
    rate = smooth_rate(record)
    k = round(window / PERIOD)
    return np.asarray((rate[k:] - rate[:-k]) / (k * PERIOD))


def dead_times(parameters: TruckParameters) -> list[float]:
    """Dead time of the pressure at each axle [s]; at the trailer's axles with the control line."""
    line = parameters.air_brake.trailer_line_delay
    return [
        axle.brake.dead_time + place * line
        for place, unit in enumerate(parameters.units)
        for axle in unit.axles
    ]


def _tons(parameters: TruckParameters, payload: float) -> float:
    return parameters.gross_mass(payload) / 1e3


def xbr_run(
    parameters: TruckParameters,
    payload: float,
    timestep: float,
    ebi: XbrEbiMode = XbrEbiMode.FRICTION_ONLY,
) -> Run:
    """60 km/h, pedal up; XBR -1.5 m/s2 from 1 to 8 s, then nothing until 13 s."""
    truck = placed_truck(parameters, payload, timestep, speed=SPEED)
    braking = VehicleCommand(xbr_demand=-DEMAND, xbr_mode=XbrMode.MAXIMUM, xbr_ebi_mode=ebi)
    rolling = VehicleCommand()
    return run(truck, lambda time, _: braking if START <= time < RELEASE else rolling, END)


def compare_xbr(parameters: TruckParameters, payload: float, timestep: float) -> Findings:
    """The paper's brake test at one payload [kg]; friction alone, then with endurance brakes."""
    record, tons = xbr_run(parameters, payload, timestep), _tons(parameters, payload)
    found = Findings(f"XBR -1.5 m/s2 at 60 km/h, {tons:g} t")
    pressure = mean_pressure(record)
    built = (record.time > START + _BUILD_UP) & (record.time < RELEASE)
    _check_deceleration(found, record)
    _check_release(found, record)
    _check_response(found, record)
    if abs(tons - _ANCHOR_MASS) < 0.5:
        found.check("mean pressure", pressure[built].mean() / 1e3, "kPa", 150.0, "120 .. 180")
    found.history("speed", "speed [km/h]", record.time, record.speed / KMH)
    found.history("acceleration", "acceleration [m/s2]", record.time, smooth_rate(record))
    found.history("mean brake pressure", "pressure [kPa]", record.time, pressure / 1e3)
    blended = xbr_run(parameters, payload, timestep, XbrEbiMode.INTEGRATION)
    found.label += ", endurance brakes integrated"
    _check_deceleration(found, blended)
    _check_release(found, blended)
    saved = 1.0 - mean_pressure(blended)[built].mean() / pressure[built].mean()
    found.check("brake pressure saved", 100.0 * float(saved), "%", must=">= 10")
    found.history("acceleration", "acceleration [m/s2]", blended.time, smooth_rate(blended))
    found.history("mean pressure", "pressure [kPa]", blended.time, mean_pressure(blended) / 1e3)
    return found


def _check_deceleration(found: Findings, record: Run) -> None:
    built = np.flatnonzero((record.time > START + _BUILD_UP) & (record.time < RELEASE))
    lost = record.speed[built[0]] - record.speed[built[-1]]
    mean = lost / (record.time[built[-1]] - record.time[built[0]])
    greatest = -float(smooth_rate(record)[record.time < RELEASE].min())
    found.check("mean deceleration", mean, "m/s2", DEMAND, "1.455 .. 1.545")
    found.check("overshoot", 100.0 * (greatest / DEMAND - 1.0), "%", must="<= 10")


def _check_release(found: Findings, record: Run) -> None:
    """A smooth release: no jerk, no kick beyond coasting, and over within a second and a half."""
    rate = smooth_rate(record)
    after = record.time >= RELEASE
    coasting = float(rate[record.time > END - 1.0].mean())
    jerk = mean_jerk(record, _JERK_WINDOW)
    greatest = np.max(np.abs(jerk[record.time[: len(jerk)] >= RELEASE - _JERK_WINDOW]))
    name = f"jerk of the release, mean over {_JERK_WINDOW:g} s"
    found.check(name, greatest, "m/s3", must=f"<= {_JERK:g}")
    kick = 100.0 * max(0.0, float(rate[after].max()) - coasting) / DEMAND
    found.check("kick beyond coasting after the release", kick, "%", must="<= 10")
    left = 100.0 * float(np.max(coasting - rate[record.time > RELEASE + _GONE])) / DEMAND
    found.check(f"braking left {_GONE:g} s after the release", left, "%", must="<= 10")


def _check_response(found: Findings, record: Run) -> None:
    """75 % of the pressure at the least favorable chamber; first rise at the first and last."""
    time = record.time - START
    held = (time > _BUILD_UP) & (record.time < RELEASE)
    slowest, first, last = 0.0, np.inf, 0.0
    for pressure in record.wheel_pressures.T:
        final = float(pressure[held].mean())
        slowest = np.fmax(slowest, rise_time(time, pressure, 0.75, final))
        begun = first_rise(time, pressure)
        first, last = np.fmin(first, begun), np.fmax(last, begun)
    found.check("75 % of the pressure after", slowest, "s", must="<= 0.6")
    found.check("first chamber's pressure rises after", first, "s")
    found.check("last chamber's pressure rises after", last, "s")


def compare_response(parameters: TruckParameters, payload: float, timestep: float) -> Findings:
    """Full brake pedal for 3 s on the standing truck with a payload [kg]."""
    truck = placed_truck(parameters, payload, timestep)
    up = VehicleCommand()
    record = run(truck, lambda time, _: FULL if _PEDAL_DOWN <= time < _PEDAL_UP else up, _PEDAL_END)
    time, down = record.time - _PEDAL_DOWN, record.time < _PEDAL_UP
    label = f"brake pedal down at standstill, {_tons(parameters, payload):g} t"
    found, lines = Findings(), []
    for axle, dead_time in enumerate(dead_times(truck.parameters)):
        pressure = record.wheel_pressures[:, 2 * axle : 2 * axle + 2].min(axis=1)
        found.label = f"{label}, axle {axle + 1}"
        must = f"{dead_time - PERIOD:.2f} .. {dead_time + _DETECTED:.2f}"
        found.check("first rise after", first_rise(time, pressure), "s", dead_time, must)
        rise = rise_time(time, pressure, 0.75, float(pressure[down][-1]))
        found.check("75 % of the pressure after (UN R13)", rise, "s", must="<= 0.6")
        lines.append(Line(f"axle {axle + 1}", record.time, pressure / 1e3))
    found.label = label
    final = float(record.wheel_pressures[down][-1].min())
    found.check("least final pressure", final / 1e3, "kPa")
    left = record.wheel_pressures.max(axis=1)
    gone = (record.time > _PEDAL_UP) & (left < 0.1 * final)
    released = first_time(record.time, gone) - _PEDAL_UP
    found.check("down to 10 % after the release", released, "s", must="<= 2")
    found.panel("pressures", "time [s]", "pressure [kPa]", *lines)
    return found


@dataclass(frozen=True)
class Regulation:
    """A stop by a regulation: speed [m/s], and greatest distance laden and empty [m]."""

    name: str
    speed: float
    laden: float
    empty: float


_FOOT = 0.3048
_MPH = 1.609344 * KMH
_R13_DISTANCE = 0.15 * 60.0 + 60.0**2 / 130.0
UN_R13 = Regulation("60 km/h (UN R13 type 0)", 60.0 * KMH, _R13_DISTANCE, _R13_DISTANCE)
FMVSS_121 = Regulation("60 mph (FMVSS 121 style)", 60.0 * _MPH, 250.0 * _FOOT, 235.0 * _FOOT)
REGULATIONS = (UN_R13, FMVSS_121)
# UN R13: least mean fully developed deceleration [m/s2].
R13_DECELERATION = 5.0


def stop_run(
    parameters: TruckParameters,
    payload: float,
    speed: float,
    timestep: float,
    route: Route | None = None,
) -> Run:
    """Full pedal from a speed [m/s] to standstill, on a flat plane or a route."""
    truck = placed_truck(parameters, payload, timestep, route, speed=speed)
    return run(truck, lambda *_: FULL, _LONGEST, stop=lambda state: state.speed < _STANDS)


def compare_stop(
    parameters: TruckParameters, payload: float, regulation: Regulation, timestep: float
) -> Findings:
    """The stop of one regulation at one payload [kg]."""
    record = stop_run(parameters, payload, regulation.speed, timestep)
    found = Findings(f"full stop from {regulation.name}, {_tons(parameters, payload):g} t")
    allowed = regulation.laden if payload > 0.0 else regulation.empty
    found.check("distance", distance(record), "m", allowed, f"<= {allowed:.1f}")
    found.check("longest lock-up above 15 km/h", lock_time(record), "s", must="<= 1")
    found.check("speed at the end", abs(float(record.speed[-1])), "m/s", 0.0, "<= 0.1")
    must = f">= {R13_DECELERATION:g}" if regulation is UN_R13 else ""
    developed = fully_developed(record)
    found.check("mean fully developed deceleration", developed, "m/s2", must=must)
    found.history("speed", "speed [km/h]", record.time, record.speed / KMH)
    found.history("greatest slip", "slip [1]", record.time, record.slip)
    return found
