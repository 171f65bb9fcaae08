"""`iits-mj validate credibility`: what uncertain parameters make of the truck's handling.

After ISO 19585 (steady-state circular driving) and ISO 21233 (closing curve), which compare
simulated with measured heavy vehicles. No measurement of this truck exists, so the reference is
theory, and the envelope is that of trucks drawn from the uncertainty of the parameters,
`mjcf/spread.toml`: a measured truck of this kind should lie in it. Time series are rated by
ISO/TS 18571 as a diagnosis; there are no bounds. The truck has no stability control, which
ISO 21233 is about; the closing curve is that of `tightening_turn`.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from iits_mj.core.arrays import FloatArray
from iits_mj.core.progress import each
from iits_mj.core.results import Findings, Line, Results
from iits_mj.core.units import GRAVITY
from iits_mj.parameters import TruckParameters
from iits_mj.parameters.randomization import Spread
from iits_mj.validation.handling import circle, step_steer, tightening_turn
from iits_mj.validation.harness.config import ValidateConfig
from iits_mj.validation.harness.rating import rate

# Drawn trucks, in full and in the quick form.
TRUCKS, TRUCKS_QUICK = 16, 4
_STEP_ANGLE = 15.0  # [deg] at the steering wheel
_SPEEDS = (6.0, 8.0, 10.0, 12.0, 14.0)  # [m/s] on the circle of 100 m
_FRICTION = 0.8
_DEGREES = float(np.rad2deg(1.0))

NOTES = (
    "Verification, not validation: theory, standards and drawn trucks are what the truck is "
    "compared with. `iits-mj validate measured --measured FILE` compares it with a measurement.",
    "Ratings after ISO/TS 18571: more than 0.94 is excellent, 0.8 good, 0.58 fair. The model that "
    "is rated against is linear.",
)


def run(config: ValidateConfig) -> Results:
    """Step steer, steady circle and closing curve of the truck and of drawn trucks."""
    results = Results("validate credibility")
    spread = Spread.load(None, config.truck)
    count = TRUCKS_QUICK if config.quick else TRUCKS
    drawn = [
        TruckParameters.load(config.truck, spread.draw(np.random.default_rng(seed)).overlay)
        for seed in range(count)
    ]
    for payload in config.payloads():
        trucks = [config.parameters, *drawn]
        for name, compare in (
            ("step_steer", _step),
            ("circle", _circle),
            ("closing_curve", _closing_curve),
        ):
            found = compare(trucks, payload, config.step)
            results.add(f"{name}_{payload / 1e3:g}t", found)
    results.notes += (*NOTES, f"{count} trucks were drawn.")
    return results


def _step(trucks: Sequence[TruckParameters], payload: float, timestep: float) -> Findings:
    """Step steer at 80 km/h against the yaw-roll model, with the envelope."""
    angles = (np.deg2rad(_STEP_ANGLE),)
    records = [
        step_steer.step_steers(truck, payload, angles, timestep)[0]
        for truck in each(trucks, "step steers of drawn trucks")
    ]
    _, model = step_steer.references(trucks[0], payload, records[0])
    found = Findings(f"step steer of {_STEP_ANGLE:g} deg at 80 km/h, {payload / 1e3:g} t")
    time = records[0].time
    columns = [list(step_steer.signals(trucks[0], record)) for record in records]
    for k, (title, unit, wanted) in enumerate(step_steer.signals(trucks[0], model)):
        curves = [column[k][2] - column[k][2][0] for column in columns]
        size = min(len(time), *(len(curve) for curve in curves))
        own, reference = curves[0][:size], np.asarray(wanted)[:size]
        band = _band(time[:size], [curve[:size] for curve in curves[1:]])
        rating = rate(own, reference)
        found.check(f"{title}: rating by ISO/TS 18571", rating.overall, "1", rating.grade)
        _ends(found, f"{title}: end value", unit, [float(c[size - 1]) for c in curves], wanted[-1])
        found.panel(
            title,
            "time [s]",
            f"{title} [{unit}]",
            Line("yaw-roll model", time[:size], reference, "reference"),
            Line("truck", time[:size], own, "simulation"),
            *band,
        )
    return found


def _circle(trucks: Sequence[TruckParameters], payload: float, timestep: float) -> Findings:
    """The circle of 100 m against the statics with the full law of the tires."""
    found = Findings(f"steady circle of 100 m, {payload / 1e3:g} t")
    driven = [
        circle.circle(truck, payload, timestep, _SPEEDS)
        for truck in each(trucks, "circles of drawn trucks")
    ]
    nominal = driven[0]
    grid = np.linspace(
        max(float(each_one.lateral.min()) for each_one in driven),
        min(float(each_one.lateral.max()) for each_one in driven),
        40,
    )
    curves = [np.interp(grid, one.lateral, one.steer) * _DEGREES for one in driven]
    reference = np.interp(grid, nominal.lateral, nominal.saturating) * _DEGREES
    low, high = _band(grid, curves[1:])
    scale = float(np.rad2deg(GRAVITY))
    gradients = [one.gradient * scale for one in driven]
    _ends(found, "understeer gradient", "deg/g", gradients, nominal.saturating_gradient * scale)
    inside = 100.0 * float(np.mean((reference >= low.y) & (reference <= high.y)))
    found.check("statics with the full law of the tires inside the envelope", inside, "% of a_y")
    found.panel(
        "steering over lateral acceleration",
        "lateral acceleration [m/s2]",
        "steer angle less L/R [deg]",
        Line("statics", grid, reference, "reference"),
        Line("truck", grid, curves[0], "simulation"),
        low,
        high,
    )
    return found


def _closing_curve(trucks: Sequence[TruckParameters], payload: float, timestep: float) -> Findings:
    """The closing curve: the lateral acceleration at its end, and the trailer's roll on the way."""
    found = Findings(f"closing curve on dry road at 60 km/h, {payload / 1e3:g} t")
    turns = [
        tightening_turn.tighten(truck, payload, _FRICTION, timestep)
        for truck in each(trucks, "closing curves of drawn trucks")
    ]
    limits = [turn.greatest() for turn in turns]
    _ends(found, "greatest lateral acceleration", "g", limits, None)
    over = 100.0 * float(np.mean([turn.rolled_over() for turn in turns[1:]]))
    found.check("drawn trucks that roll over rather than slide", over, "%", turns[0].ending())
    grid = np.linspace(0.02, 0.95 * min(limits), 40)

    def roll(turn: tightening_turn.Turn) -> FloatArray:
        end = int(np.argmax(turn.lateral[: turn.end() + 1])) + 1
        rising = np.maximum.accumulate(turn.lateral[:end]) / GRAVITY
        angle = np.abs(turn.recording.trailer_roll[:end]) * _DEGREES
        return np.asarray(np.interp(grid, rising, angle))

    curves = [roll(turn) for turn in turns]
    found.panel(
        "roll of the last unit",
        "lateral acceleration [g]",
        "roll [deg]",
        Line("truck", grid, curves[0], "simulation"),
        *_band(grid, curves[1:]),
    )
    return found


def _band(x: FloatArray, curves: Sequence[FloatArray]) -> tuple[Line, Line]:
    """Least and greatest of the drawn trucks' curves, each of the shape of x (n,)."""
    least = Line(f"lowest of {len(curves)} drawn trucks", x, np.min(curves, axis=0))
    return least, Line("highest", x, np.max(curves, axis=0))


def _ends(
    found: Findings, name: str, unit: str, values: Sequence[float], reference: float | None
) -> None:
    """A figure of the truck, and the range of the drawn trucks."""
    found.check(name, values[0], unit, None if reference is None else float(reference))
    found.check(f"{name}: least of the drawn trucks", min(values[1:]), unit)
    found.check(f"{name}: greatest of the drawn trucks", max(values[1:]), unit)
