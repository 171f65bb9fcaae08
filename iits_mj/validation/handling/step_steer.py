"""Steering response at 80 km/h against linear models: step steer, and frequency response.

The step steer follows the figure of the paper. The references get the road-wheel angle of the truck
and cornering stiffnesses of the axle loads at that speed; nothing is fitted. Their couplings turn
freely, so the comparison uses couplings without friction; the effect of the truck's own friction is
reported in addition. The yaw-sideslip model has no roll, tire lag, side air or rolling resistance;
the yaw-roll model has them. A remaining difference from the latter is nonlinear, or an error.

The frequency response of yaw rate and articulation to the road-wheel angle comes from a sum of
sines at the steering wheel.
"""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Iterator

import numpy as np

from iits_mj.analytic import LateralSystem, Response, UnitHistories, YawPlane, YawRoll, simulate
from iits_mj.core.arrays import FloatArray
from iits_mj.core.results import Findings, Line
from iits_mj.core.units import KMH
from iits_mj.parameters import TruckParameters
from iits_mj.validation.harness.maneuver import restore_state, save_state, steady_truck
from iits_mj.validation.harness.recorder import SteeringRecord, drive, fit, harmonic, peak_ratio

SPEED = 80.0 * KMH
_BEFORE, _AFTER = 2.0, 10.0
# Whole periods in 20 s, so that the spectral lines stay separate [Hz].
FREQUENCIES = np.array([0.1, 0.2, 0.3, 0.5, 0.7, 1.0])
_LIMIT = 0.7
_AMPLITUDE = np.deg2rad(4.0)
_SETTLE, _LENGTH = 10.0, 20.0


def free_couplings(parameters: TruckParameters) -> TruckParameters:
    """Returns the truck with couplings that turn without friction."""
    units = tuple(
        dataclasses.replace(unit, coupling=dataclasses.replace(unit.coupling, yaw_friction=0.0))
        if unit.coupling
        else unit
        for unit in parameters.units
    )
    return dataclasses.replace(parameters, units=units)


def unit_titles(parameters: TruckParameters) -> list[str]:
    """Returns the units' names in words; that of a lone motor vehicle is "truck"."""
    return [unit.name.replace("_", " ") for unit in parameters.units]


def signals(
    parameters: TruckParameters, source: UnitHistories
) -> Iterator[tuple[str, str, FloatArray]]:
    """Yields title, unit of measure and values of the yaw rates, hitch angles and lateral position.

    Args:
      parameters: of the truck.
      source: a recording, or a model's answer.
    """
    titles = unit_titles(parameters)
    for unit, title in enumerate(titles):
        yield f"yaw rate of the {title}", "rad/s", source.yaw_rates[:, unit]
    for coupling, title in enumerate(titles[1:]):
        name = "hitch angle" if len(titles) == 2 else f"hitch angle of the {title}"
        yield name, "rad", source.articulations[:, coupling]
    yield "lateral position", "m", source.y


def step_steers(
    parameters: TruckParameters, payload: float, angles: tuple[float, ...], timestep: float
) -> list[SteeringRecord]:
    """Records of steps at the steering wheel [rad] at 80 km/h, from 2 s before each step."""
    truck, hold = steady_truck(payload, SPEED, timestep, parameters=parameters)
    steady = save_state(truck)
    recordings = []
    for angle in angles:
        restore_state(truck, steady)

        def steering(time: float, _: float, angle: float = angle) -> float:
            return angle if time >= _BEFORE else 0.0

        duration = _BEFORE + _AFTER
        recordings.append(
            drive(truck, steering, speed=SPEED, duration=duration, hold=copy.copy(hold))
        )
    return recordings


def references(
    parameters: TruckParameters, payload: float, recording: SteeringRecord
) -> tuple[Response, Response]:
    """Answers of yaw-sideslip and yaw-roll model to the recorded road-wheel angle."""
    speed = float(recording.speed.mean())

    def answer(system: LateralSystem) -> Response:
        return simulate(system, recording.time, recording.road_wheel)

    plane = YawPlane.from_parameters(parameters, payload, cruise_speed=speed)
    roll = YawRoll.from_parameters(parameters, payload, cruise_speed=speed)
    return answer(plane.at(speed)), answer(roll.at(speed))


def compare_step(
    parameters: TruckParameters,
    payload: float,
    degrees: float,
    must: str,
    recording: SteeringRecord,
    plane_must: str = "",
) -> Findings:
    """One step steer [deg at the steering wheel] against both linear models.

    Args:
      parameters: of the truck.
      payload: [kg].
      degrees: at the steering wheel.
      must: bound of the fits with the yaw-roll model.
      recording: of the truck.
      plane_must: bound of the fits with the yaw-sideslip model.
    """
    plane, roll = references(parameters, payload, recording)
    found = Findings(f"step steer {degrees:g} deg, {payload / 1e3:g} t")
    for (title, unit, values), (_, _, wanted), (_, _, extended) in zip(
        *(signals(parameters, source) for source in (recording, plane, roll)), strict=True
    ):
        simulated = values - values[0]
        found.check(f"{title}, fit", fit(simulated, wanted), "%", "yaw-sideslip", plane_must)
        found.check(f"{title}, peak", peak_ratio(simulated, wanted), "1", 1.0)
        found.check(f"{title}, end value", simulated[-1] / wanted[-1], "1", 1.0)
        explained = fit(simulated, extended)
        found.check(f"{title}, fit of the yaw-roll model", explained, "%", "yaw-roll", must)
        linear = Line("yaw-sideslip model", recording.time, wanted, "reference")
        rolling = Line("yaw-roll model", recording.time, extended)
        truck = Line("truck", recording.time, simulated, "simulation")
        found.panel(title, "time [s]", f"{title} [{unit}]", linear, rolling, truck)
    return found


def friction_effect(
    parameters: TruckParameters, payload: float, degrees: float, timestep: float
) -> Findings:
    """The truck's own couplings, with their friction, against the same model; for information."""
    recording = step_steers(parameters, payload, (np.deg2rad(degrees),), timestep)[0]
    answer, _ = references(parameters, payload, recording)
    found = Findings(f"step steer {degrees:g} deg, {payload / 1e3:g} t, fifth wheel with friction")
    title, _, values = next(signals(parameters, recording))
    found.check(f"{title}, fit", fit(values, answer.yaw_rate), "%", "yaw-sideslip")
    return found


def compare_frequency(parameters: TruckParameters, payload: float, timestep: float) -> Findings:
    """Greatest gain and phase errors up to 0.7 Hz, and the curves."""
    truck, hold = steady_truck(payload, SPEED, timestep, parameters=parameters)
    # Schroeder's phases keep the peak of the sum low.
    phases = -np.pi * np.arange(len(FREQUENCIES)) ** 2 / len(FREQUENCIES)

    def steering(time: float, _: float) -> float:
        angles = 2.0 * np.pi * FREQUENCIES * time + phases
        return float(_AMPLITUDE * np.sum(np.sin(angles))) * min(time / 5.0, 1.0)

    recording = drive(truck, steering, speed=SPEED, duration=_SETTLE + _LENGTH, hold=hold)
    recording = recording.after(_SETTLE)
    speed = float(recording.speed.mean())
    plane = YawPlane.from_parameters(parameters, payload, cruise_speed=speed)
    wanted = plane.at(speed).frequency_response(FREQUENCIES)
    steer = harmonic(recording.time, recording.road_wheel, FREQUENCIES)
    found, inside = Findings(), FREQUENCIES <= _LIMIT
    # Title, harmonics, and index in the state of the linear model. The yaw rate is that of the yaw
    # angle: velocities are half a step older than angles.
    rate = 2j * np.pi * FREQUENCIES * harmonic(recording.time, recording.yaw, FREQUENCIES)
    responses = [("yaw rate", rate, 1)]
    if plane.units > 1:
        bent = harmonic(recording.time, recording.articulation, FREQUENCIES)
        responses.append(("articulation", bent, 1 + plane.units))
    for title, answer, state in responses:
        response = answer / steer
        ratio = response / wanted[:, state]
        gain = np.max(np.abs(np.abs(ratio[inside]) - 1.0)) * 100.0
        phase = np.max(np.abs(np.rad2deg(np.angle(ratio[inside]))))
        label = f"frequency response, {payload / 1e3:g} t: {title}"
        found.check(f"{label}, gain error", gain, "%", "yaw-sideslip", "<= 5")
        found.check(f"{label}, phase error", phase, "deg", "yaw-sideslip", "<= 5")
        for part, of in (("gain", np.abs), ("phase [deg]", lambda z: np.rad2deg(np.angle(z)))):
            model = Line("yaw-sideslip model", FREQUENCIES, of(wanted[:, state]), "reference")
            driven = Line("truck", FREQUENCIES, of(response), "simulation")
            found.panel(f"{label}, {part}", "frequency [Hz]", part, model, driven)
    return found
