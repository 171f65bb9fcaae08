"""`iits-mj validate --measured`: the truck on a measured maneuver.

The truck gets the measured steering-wheel angle and holds the measured speed, on a level road. Its
yaw rate, lateral acceleration and articulation are drawn over the measured ones and rated by
ISO/TS 18571 (`harness.rating`), as a diagnosis without a bound. The envelope is that of trucks
drawn from the uncertainty of the parameters, `mjcf/spread.toml`.

The steering-wheel angle is the actual one. The command is ahead of it by the actuator's lag, which
the simulated steering has and a measured angle has already behind it.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from iits_mj.core.arrays import FloatArray
from iits_mj.core.errors import InputError
from iits_mj.core.progress import each
from iits_mj.core.results import Findings, Line, Results
from iits_mj.identification import Log, read_table
from iits_mj.parameters import TruckParameters
from iits_mj.parameters.randomization import Spread
from iits_mj.validation.harness import recorder
from iits_mj.validation.harness.config import ValidateConfig
from iits_mj.validation.harness.maneuver import steady_truck
from iits_mj.validation.harness.rating import rate

NEEDED = ("steering_wheel_angle", "speed")
# Compared signals: label and unit.
OUTPUTS = {
    "yaw_rate": ("yaw rate", "rad/s"),
    "lateral_acceleration": ("lateral acceleration", "m/s2"),
    "articulation": ("articulation", "rad"),
}
# Trucks of the envelope, in full and in the quick form.
_TRUCKS, _TRUCKS_QUICK = 20, 8
# Times before the maneuver: the truck takes the first angle, then settles [s].
_TURN_IN, _SETTLE = 2.0, 4.0
# Longest maneuver [s], and speeds for which the model is meant [m/s].
_LONGEST, _SPEEDS = 600.0, (3.0, 40.0)


def read_maneuver(path: Path) -> Log:
    """Reads a measured maneuver: a table with titles `name [unit]`.

    Raises:
      InputError: the table lacks a column, or has a wrong unit, a gap, times that do not increase,
        or values that the model is not meant for.
    """
    log = read_table(path)
    if lacks := log.lacks(*NEEDED):
        raise InputError(f"{str(path)!r}: {lacks.replace('log', 'table')}")
    if not any(name in log for name in OUTPUTS):
        raise InputError(f"{str(path)!r}: the table has none of {', '.join(OUTPUTS)} to compare")
    time, speed = log.series("speed").time, log["speed"]
    if time[-1] - time[0] > _LONGEST:
        raise InputError(f"{str(path)!r} lasts {time[-1] - time[0]:g} s, at most {_LONGEST:g}")
    low, high = _SPEEDS
    if speed.min() < low or speed.max() > high:
        raise InputError(
            f"{str(path)!r}: speeds of {speed.min():g} to {speed.max():g} m/s are not allowed; use "
            f"{low:g} to {high:g} m/s"
        )
    return log


def simulate(
    log: Log, parameters: TruckParameters, payload: float, timestep: float
) -> dict[str, FloatArray]:
    """The truck's outputs at the times of a measured maneuver, each of shape (n,).

    Args:
      log: of `read_maneuver`.
      parameters: of the truck.
      payload: [kg].
      timestep: of the physics [s].
    """
    measured = log.series("steering_wheel_angle")
    time = measured.time - measured.time[0]
    angle, speed = measured.value, log["speed"]
    ahead = angle + parameters.steering.time_constant * np.gradient(angle, time)
    before = _TURN_IN + _SETTLE

    def steering(now: float, yaw: float) -> float:
        del yaw
        if now < before:
            return float(angle[0]) * min(now / _TURN_IN, 1.0)
        return float(np.interp(now - before, time, ahead))

    truck, hold = steady_truck(payload, float(speed[0]), timestep, parameters=parameters)
    record = recorder.drive(
        truck,
        steering,
        speed=lambda now: float(np.interp(now - before, time, speed)),
        duration=before + float(time[-1]) + recorder.PERIOD,
        hold=hold,
    )
    found = {
        "yaw_rate": record.yaw_rate,
        "lateral_acceleration": record.lateral_acceleration,
        "articulation": record.articulation if len(parameters.units) > 1 else None,
    }
    return {
        name: np.asarray(np.interp(time, record.time - before, values))
        for name, values in found.items()
        if name in log and values is not None
    }


def run(config: ValidateConfig) -> Results:
    """Drives the measured maneuver with the truck and with trucks of the envelope.

    Raises:
      InputError: no file is given, or it cannot be used.
    """
    if config.measured is None:
        raise InputError("validate measured needs a table of a maneuver: --measured FILE.csv")
    log, report = read_maneuver(config.measured), Results("validate measured")
    payload = config.payloads()[0]
    truck = simulate(log, config.parameters, payload, config.step)
    spread = Spread.load(None, config.truck)
    count = _TRUCKS_QUICK if config.quick else _TRUCKS
    others = []
    for seed in each(range(count), "driving the measured maneuver"):
        drawn = spread.draw(np.random.default_rng(seed))
        parameters = TruckParameters.load(config.truck, drawn.overlay)
        others.append(simulate(log, parameters, payload, config.step))
    time = log.series("speed").time
    found = Findings(config.measured.stem)
    for name in truck:
        label, unit = OUTPUTS[name]
        measured, simulated = log[name], truck[name]
        drawn_ones = np.array([other[name] for other in others])
        low, high = drawn_ones.min(axis=0), drawn_ones.max(axis=0)
        rating = rate(simulated, measured)
        found.check(f"{label}: rating by ISO/TS 18571", rating.overall, "1", rating.grade)
        for part in ("corridor", "phase", "magnitude", "slope"):
            found.check(f"{label}: {part}", getattr(rating, part), "1")
        delay = rating.shift * float(np.median(np.diff(time)))
        found.check(f"{label}: truck behind the measurement", delay, "s")
        inside = 100.0 * np.mean((measured >= low) & (measured <= high))
        found.check(f"{label}: measurement inside the envelope", inside, "% of time")
        found.panel(
            label,
            "time [s]",
            f"{label} [{unit}]",
            Line("measured", time, measured, "reference"),
            Line("truck", time, simulated, "simulation"),
            Line(f"lowest of {count} drawn trucks", time, low),
            Line("highest", time, high),
        )
    found.notes.append(
        "Ratings are a diagnosis without a bound: above 0.94 is excellent, 0.8 good, 0.58 fair. "
        f"The envelope is that of {count} trucks drawn from mjcf/spread.toml."
    )
    report.add("measured", found)
    return report
