"""Size of each effect that the yaw-sideslip model omits, in a step steer at 80 km/h.

`python docs/estimates/lateral_effects.py` prints the tables of docs/analytic.md: the fit of the
simulated truck (`iits_mj.validation.handling.step_steer`) with the yaw-sideslip model, with the
yaw-roll model, and with the yaw-roll model without one effect.
"""

from __future__ import annotations

import numpy as np

from iits_mj.analytic import YawPlane, YawRoll, simulate
from iits_mj.parameters import TruckParameters
from iits_mj.validation.handling.step_steer import free_couplings, step_steers
from iits_mj.validation.harness.recorder import SteeringRecord, fit

EFFECTS = {
    "roll": "roll",
    "drag, rolling resistance and drive": "traction",
    "side force of the air": "side_air",
    "tire lag": "relaxation",
    "spinning wheels": "wheels",
}
SIGNALS = ("yaw_rate", "trailer_yaw_rate", "articulation", "y")
TIMESTEP = 0.001


def row(name: str, recording: SteeringRecord, model: YawPlane | YawRoll) -> str:
    """One line of the table: the fits with one model."""
    answer = simulate(model.at(float(recording.speed.mean())), recording.time, recording.road_wheel)
    fits = [
        fit(getattr(recording, signal) - getattr(recording, signal)[0], getattr(answer, signal))
        for signal in SIGNALS
    ]
    return f"| {name} | " + " | ".join(f"{value:.2f}" for value in fits) + " |"


def main() -> None:
    """Prints a table for each payload and steering-wheel angle."""
    parameters = free_couplings(TruckParameters.load())
    for payload in (36_000.0, 0.0):
        angles = (3.0, 15.0)
        recordings = step_steers(parameters, payload, tuple(np.deg2rad(angles)), TIMESTEP)
        for degrees, recording in zip(angles, recordings, strict=True):
            speed = float(recording.speed.mean())
            print(
                f"\n| fit [%], {degrees:g} deg, {payload / 1e3:g} t | yaw rate | trailer's yaw "
                "rate | hitch angle | lateral position |\n|---|---|---|---|---|"
            )
            plane = YawPlane.from_parameters(parameters, payload, cruise_speed=speed)
            print(row("yaw-sideslip model", recording, plane))
            full = YawRoll.from_parameters(parameters, payload, cruise_speed=speed)
            print(row("yaw-roll model", recording, full))
            for name, keyword in EFFECTS.items():
                less = YawRoll.from_parameters(
                    parameters, payload, cruise_speed=speed, **{keyword: False}
                )
                print(row(f"... without {name}", recording, less))


if __name__ == "__main__":
    main()
