"""Pedal tests: 40 % for 40 s as in the paper, and full pedal, laden, against the force balance."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from iits_mj.core.arrays import FloatArray
from iits_mj.core.messages import VehicleCommand
from iits_mj.core.results import Findings, Line
from iits_mj.core.units import KMH
from iits_mj.parameters import TruckParameters
from iits_mj.road import Route
from iits_mj.validation.harness.maneuver import Run, first_time, run
from iits_mj.validation.harness.recorder import placed_truck
from iits_mj.validation.longitudinal.force_balance import ForceBalance
from iits_mj.validation.pbs.limits import STANDARDS
from iits_mj.validation.pbs.maneuvers import FROM_REST

# Above this speed the launch is over [m/s].
_MOVING = 0.5
# Engine torque that counts as none [N m].
_NO_TORQUE = 60.0
# The dip lasts while less than this share of the pull remains.
_LEFT = 0.2
# Time before a change at which the pull is still complete [s].
_BEFORE = 0.2
# Readings of the paper's figure "Drive-line" and of the published reference run without air drag.
PAPER_SPEED_KPH, PAPER_TENTH = 46.9, 31.0


@dataclass(frozen=True)
class Shift:
    """One gear change.

    Attributes:
      start: [s]; gear: the new gear; duration: time with an open driveline [s].
      idle: time with less than 60 N m at the crankshaft [s].
      dip: time with an acceleration near that of coasting: less than a fifth of the way from there
        to the acceleration before the change [s].
    """

    start: float
    gear: int
    duration: float
    idle: float
    dip: float


def shifts(record: Run) -> list[Shift]:
    """The complete gear changes of the moving truck."""
    edges = np.flatnonzero(np.diff(record.shift_in_process) != 0.0) + 1
    edges = edges[record.speed[edges] > _MOVING]
    step = float(record.time[1] - record.time[0])
    found = []
    for a, b in itertools.pairwise(edges):
        if record.shift_in_process[a] < 0.5 or record.shift_in_process[b] > 0.5:
            continue
        duration = float(record.time[b] - record.time[a])
        idle = _span(record.engine_torque < _NO_TORQUE, int(a), int(b)) * step
        dip = _dip(record, int(a), int(b), step)
        found.append(Shift(float(record.time[a]), int(record.gear[b]), duration, idle, dip))
    return found


def hunting(record: Run, within: float = 5.0) -> int:
    """Number of gear changes that are reversed within a time [s]."""
    changes = np.flatnonzero(np.diff(record.gear))
    return sum(
        record.time[b] - record.time[a] < within and record.gear[b + 1] == record.gear[a]
        for a, b in itertools.pairwise(changes)
    )


def _dip(record: Run, start: int, end: int, step: float) -> float:
    """Duration of the dip of the acceleration [s]; nan if it began before the record."""
    rate, before = record.acceleration, start - round(_BEFORE / step)
    if before < 0:
        return float("nan")
    # The driveline oscillates when it opens: the lower quartile is the deceleration of coasting.
    coasting = float(np.quantile(rate[start:end], 0.25))
    return _span(rate < coasting + _LEFT * (rate[before] - coasting), start, end) * step


def _span(low: NDArray[np.bool_], start: int, end: int) -> int:
    """Samples from the first to the last low one in an interval; the last may extend beyond it."""
    places = np.flatnonzero(low[start:end])
    if not len(places):
        return 0
    last = start + int(places[-1])
    while last + 1 < len(low) and low[last + 1]:
        last += 1
    return last + 1 - (start + int(places[0]))


def part_throttle_run(timestep: float, *, air: bool = True) -> Run:
    """40 % pedal for 40 s from standstill at 19 t; the published run has no air drag."""
    parameters = TruckParameters.load(overlay=None if air else {"aerodynamics": {"density": 0.0}})
    truck = placed_truck(parameters, 0.0, timestep)
    return run(truck, lambda *_: VehicleCommand(accelerator_pedal=0.4), 40.0)


def part_throttle(record: Run, without: Run) -> Findings:
    """The paper's test, with a run with air drag and one without."""
    found = Findings("40 % pedal, 19 t")
    moving = record.gear[record.speed > 0.5]
    found.check("first gear used", moving[0], "1", 2.0, "2 .. 2")
    found.check("gear at 40 s", record.gear[-1], "1", 10.0, "9 .. 10")
    found.check("speed at 40 s", record.speed[-1] / KMH, "km/h", PAPER_SPEED_KPH, "40 .. 50")
    speed = without.speed[-1] / KMH
    found.check("speed at 40 s without air drag", speed, "km/h", PAPER_SPEED_KPH, "44.6 .. 49.2")
    tenth = first_time(record.time, record.gear >= 10.0)
    found.check("10th gear engages at", tenth, "s", PAPER_TENTH)
    found.check("gear changes taken back", hunting(record), "1", 0.0, "<= 0")
    changes = shifts(record)
    dips = [change.dip for change in changes if np.isfinite(change.dip)]
    for name, times, must in (
        ("shift", [change.duration for change in changes], "0.6 .. 1.0"),
        ("dip of the acceleration", dips, "0.6 .. 1.0"),
        ("torque below 60 N m", [change.idle for change in changes], "0.6 .. 0.7"),
    ):
        found.check(f"{name}, shortest", min(times, default=float("nan")), "s", None, must)
        if times:
            found.check(f"{name}, longest", max(times), "s", None, must)
    _histories(found, record)
    return found


def full_pedal(parameters: TruckParameters, record: Run, *, grade: float) -> Findings:
    """Full pedal, laden, on a constant grade from standstill, against the force balance."""
    balance = ForceBalance(parameters, parameters.payload_max)
    predicted = coast_along(record, balance)
    found = Findings(f"full pedal, {balance.mass / 1e3:g} t, {100.0 * grade:g} % grade")
    error = 100.0 * float(np.max(np.abs(predicted - record.speed)) / np.max(record.speed))
    found.check("speed against the force balance", error, "%", must="<= 3")
    found.check("gear changes taken back", hunting(record), "1", 0.0, "<= 0")
    found.check("speed at the end", record.speed[-1] / KMH, "km/h")
    if grade == 0.0:
        level_1 = STANDARDS["acceleration"].limits[0]
        hundred = first_time(record.time, record.station - record.station[0] >= FROM_REST)
        found.check("time for 100 m (PBS acceleration capability)", hundred, "s", level_1)
    if record.speed.max() >= 80.0 * KMH:
        measured = first_time(record.time, record.speed >= 80.0 * KMH)
        expected = first_time(record.time, predicted >= 80.0 * KMH)
        allowed = f"{0.97 * expected:.2f} .. {1.03 * expected:.2f}"
        found.check("time to 80 km/h", measured, "s", expected, allowed)
    _histories(found, record, Line("force balance", record.time, predicted / KMH, "reference"))
    return found


def full_pedal_run(
    parameters: TruckParameters, timestep: float, grade: float, duration: float
) -> Run:
    """Full pedal from standstill with the greatest load."""
    route = Route.straight(grade=grade)
    truck = placed_truck(parameters, parameters.payload_max, timestep, route)
    full = VehicleCommand(accelerator_pedal=1.0)
    return run(truck, lambda *_: full, duration, sensors=("clutch_engagement",))


def coast_along(record: Run, balance: ForceBalance) -> FloatArray:
    """Speed of a point mass with the engine torque and gears of the run [m/s], shape (n,).

    The driving torque is the engine torque less the torque that accelerates the engine's inertia,
    also while the clutch slips. The resistances are those at the speed of the point mass. The run
    must have recorded `clutch_engagement`.
    """
    parameters = balance.parameters
    engagement = record.extra["clutch_engagement"]
    gear = engaged_gear(record.gear, engagement)
    inertias = np.concatenate([[0.0], parameters.gearbox.inertias])[gear]
    spin = np.gradient(record.engine_speed, record.time)
    torque = record.engine_torque - (parameters.engine.inertia + inertias) * spin
    force = np.where(engagement > 0.0, balance.pull(torque, gear, record.engine_speed), 0.0)
    mass = balance.mass + balance.wheel_mass
    speed = np.empty_like(record.time)
    speed[0] = record.speed[0]
    step = np.diff(record.time)
    for k, h in enumerate(step):
        push = 0.5 * (force[k] + force[k + 1]) - balance.resistance(speed[k], record.grade[k])
        # Rolling resistance cannot move a standing truck backwards.
        speed[k + 1] = max(0.0, speed[k] + h * float(push) / mass)
    return speed


def engaged_gear(gear: FloatArray, engagement: FloatArray) -> NDArray[np.int64]:
    """The engaged gear, shape (n,); the recorded gear changes before the clutch is open."""
    engaged = np.maximum(np.round(gear), 0.0).astype(int)
    for k in range(1, len(engaged)):
        if engagement[k] > 0.0 and engagement[k - 1] > 0.0:
            engaged[k] = engaged[k - 1]
    return engaged


def _histories(found: Findings, record: Run, *references: Line) -> None:
    """Adds panels of speed (with references), gear, acceleration and engine torque over time."""
    speed = Line("truck", record.time, record.speed / KMH, "simulation")
    found.panel("speed", "time [s]", "speed [km/h]", *references, speed)
    found.history("gear", "gear [1]", record.time, record.gear)
    found.history("acceleration", "acceleration [m/s2]", record.time, record.acceleration)
    found.history("engine torque", "engine torque [N m]", record.time, record.engine_torque)
