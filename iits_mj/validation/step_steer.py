"""Step steer at 80 km/h against the corrected yaw-sideslip model, as in the paper's figure.

The reference gets the road-wheel angle that the truck's steering really made, and the stiffness of
axle loads at that speed; nothing is fitted. Its hitch turns freely, so the comparison is made with
a frictionless fifth wheel; what the friction of the shipped truck changes is reported beside it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from iits_mj.analytic import YawSideslip, simulate
from iits_mj.parameters import TruckParameters
from iits_mj.results import Check, Line, Panel
from iits_mj.truck import Truck
from iits_mj.units import KMH
from iits_mj.validation.metrics import fit, peak_ratio
from iits_mj.validation.recorder import Recording, drive, run_straight

FloatArray = NDArray[np.float64]

SPEED = 80.0 * KMH
FREE_HITCH = {"fifth_wheel": {"yaw_friction": 0.0}}
_BEFORE = 2.0
_AFTER = 10.0
_SIGNALS = (
    ("yaw rate of the tractor", "yaw_rate", "rad/s"),
    ("yaw rate of the trailer", "trailer_yaw_rate", "rad/s"),
    ("hitch angle", "articulation", "rad"),
    ("lateral position", "y", "m"),
)


def step_steer(
    payload: float, angle: float, timestep: float, *, free_hitch: bool = True
) -> Recording:
    """The truck's answer to a step at the steering wheel [rad] at 80 km/h, from 2 s before it."""
    overlay = FREE_HITCH if free_hitch else None
    truck = Truck.load(payload, parameters=overlay, timestep=timestep, visuals=False)
    truck.reset(speed=SPEED)
    hold = run_straight(truck, SPEED)
    return drive(
        truck,
        lambda time, _: angle if time >= _BEFORE else 0.0,
        speed=SPEED,
        duration=_BEFORE + _AFTER,
        hold=hold,
    )


def reference(recording: Recording, payload: float) -> dict[str, FloatArray]:
    """The corrected yaw-sideslip model's answer to the same road-wheel angle, by signal name."""
    speed = float(recording.speed.mean())
    parameters = TruckParameters.load()
    model = YawSideslip.from_parameters(parameters, payload, cruise_speed=speed)
    answer = simulate(model.at(speed), recording.time, recording.road_wheel)
    return {name: getattr(answer, name) for _, name, _ in _SIGNALS}


def compare(
    payload: float, degrees: float, timestep: float, must: str
) -> tuple[list[Check], list[Panel]]:
    """Checks and panels of one step steer [deg at the steering wheel]."""
    recording = step_steer(payload, np.deg2rad(degrees), timestep)
    answer = reference(recording, payload)
    label = f"step steer {degrees:g} deg, {payload / 1e3:g} t"
    checks, panels = [], []
    for title, name, unit in _SIGNALS:
        simulated = getattr(recording, name) - getattr(recording, name)[0]
        wanted = answer[name]
        checks.append(
            Check(f"{label}: {title}, fit", fit(simulated, wanted), "%", "yaw-sideslip", must)
        )
        checks.append(Check(f"{label}: {title}, peak", peak_ratio(simulated, wanted), "1", 1.0))
        steady = float(simulated[-1] / wanted[-1])
        checks.append(Check(f"{label}: {title}, end value", steady, "1", 1.0))
        lines = (
            Line("yaw-sideslip model", recording.time, wanted, "reference"),
            Line("truck", recording.time, simulated, "simulation"),
        )
        panels.append(Panel(f"{label}: {title}", "time [s]", f"{title} [{unit}]", lines))
    return checks, panels


def friction_effect(payload: float, degrees: float, timestep: float) -> list[Check]:
    """For information: the shipped fifth wheel, whose plate rubs, against the same model."""
    recording = step_steer(payload, np.deg2rad(degrees), timestep, free_hitch=False)
    answer = reference(recording, payload)
    label = f"step steer {degrees:g} deg, {payload / 1e3:g} t, fifth wheel with friction"
    return [
        Check(
            f"{label}: {title}, fit",
            fit(getattr(recording, name), answer[name]),
            "%",
            "yaw-sideslip",
        )
        for title, name, _ in _SIGNALS[:1]
    ]
