"""Frequency response of yaw rate and articulation to the road-wheel angle, by a sum of sines."""

from __future__ import annotations

import numpy as np

from iits_mj.analytic import YawSideslip
from iits_mj.parameters import TruckParameters
from iits_mj.results import Check, Line, Panel
from iits_mj.truck import Truck
from iits_mj.validation.metrics import harmonic
from iits_mj.validation.recorder import drive, run_straight
from iits_mj.validation.step_steer import FREE_HITCH, SPEED

# Whole periods in 20 s, so that the lines do not leak into one another [Hz].
FREQUENCIES = np.array([0.1, 0.2, 0.3, 0.5, 0.7, 1.0])
_LIMIT = 0.7
_AMPLITUDE = np.deg2rad(4.0)
_SETTLE = 10.0
_LENGTH = 20.0
_SIGNALS = (("yaw rate", "yaw_rate", 1), ("articulation", "articulation", 3))


def compare(payload: float, timestep: float) -> tuple[list[Check], list[Panel]]:
    """Worst gain and phase errors up to 0.7 Hz, and the curves."""
    truck = Truck.load(payload, parameters=FREE_HITCH, timestep=timestep, visuals=False)
    truck.reset(speed=SPEED)
    # Schroeder's phases keep the sum's peak low.
    phases = -np.pi * np.arange(len(FREQUENCIES)) ** 2 / len(FREQUENCIES)

    def steering(time: float, _: float) -> float:
        angles = 2.0 * np.pi * FREQUENCIES * time + phases
        return float(_AMPLITUDE * np.sum(np.sin(angles))) * min(time / 5.0, 1.0)

    hold = run_straight(truck, SPEED)
    recording = drive(truck, steering, speed=SPEED, duration=_SETTLE + _LENGTH, hold=hold)
    recording = recording.after(_SETTLE)
    speed = float(recording.speed.mean())
    model = YawSideslip.from_parameters(TruckParameters.load(), payload, cruise_speed=speed)
    wanted = model.at(speed).frequency_response(FREQUENCIES)
    steer = harmonic(recording.time, recording.road_wheel, FREQUENCIES)
    checks, panels = [], []
    inside = FREQUENCIES <= _LIMIT
    for title, name, state in _SIGNALS:
        found = harmonic(recording.time, getattr(recording, name), FREQUENCIES) / steer
        ratio = found / wanted[:, state]
        gain = float(np.max(np.abs(np.abs(ratio[inside]) - 1.0)) * 100.0)
        phase = float(np.max(np.abs(np.rad2deg(np.angle(ratio[inside])))))
        label = f"frequency response, {payload / 1e3:g} t: {title}"
        checks.append(Check(f"{label}, gain error", gain, "%", "yaw-sideslip", "<= 5"))
        checks.append(Check(f"{label}, phase error", phase, "deg", "yaw-sideslip", "<= 5"))
        for part, of in (("gain", np.abs), ("phase [deg]", lambda z: np.rad2deg(np.angle(z)))):
            lines = (
                Line("yaw-sideslip model", FREQUENCIES, of(wanted[:, state]), "reference"),
                Line("truck", FREQUENCIES, of(found), "simulation"),
            )
            panels.append(Panel(f"{label}, {part}", "frequency [Hz]", part, lines))
    return checks, panels
