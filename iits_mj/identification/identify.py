"""`identify`: a recorded drive in, identified parameters with their confidence out."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from iits_mj.errors import InputError
from iits_mj.identification.estimate import Estimate, Free, fit
from iits_mj.identification.log import Log
from iits_mj.identification.longitudinal import Inputs, acceleration, prepare
from iits_mj.identification.pressure import CIRCUITS, identify_pressures
from iits_mj.parameters import TruckParameters

FloatArray = NDArray[np.float64]

# Most trusted first: of two that the log cannot tell apart, the later one keeps its prior.
LONGITUDINAL = ("mass", "rolling_resistance", "drag_area", "brake_gain", "engine_torque_scale")
DEFAULT = LONGITUDINAL[:4]


@dataclass(frozen=True)
class Identification:
    """What a log showed.

    Attributes:
      estimates: one for each parameter asked for.
      speed_before, speed_after: the model's speed with prior and fitted values; recorded: the
        log's;
        time [s]; all of shape (m,), the windows of the log one after the other.
      parameters: the truck's parameters before the fit.
      fitted: the longitudinal values of the best fit, trusted or not.
    """

    estimates: tuple[Estimate, ...]
    time: FloatArray
    recorded: FloatArray
    speed_before: FloatArray
    speed_after: FloatArray
    parameters: TruckParameters
    fitted: dict[str, float]

    def __getitem__(self, name: str) -> Estimate:
        for estimate in self.estimates:
            if estimate.name == name:
                return estimate
        raise InputError(f"no estimate {name!r}; there are {[e.name for e in self.estimates]}")

    def payload(self) -> float | None:
        """Payload [kg] that the identified mass means, within the truck's limits; None without."""
        mass = next((e for e in self.estimates if e.name == "mass" and e.identifiable), None)
        if mass is None:
            return None
        tare = self.parameters.tractor.mass + self.parameters.semitrailer.mass
        return float(np.clip(mass.value - tare, 0.0, self.parameters.payload.mass_max))

    def overlay(self) -> dict[str, Any]:
        """What `Truck.load(parameters=...)` takes: the identified values and nothing else.

        Mass is no parameter but the payload's; the torque scale has no parameter of its own.
        """
        found = {e.name: e.value for e in self.estimates if e.identifiable}
        brake = self.parameters.air_brake
        tree: dict[str, Any] = {}
        if "rolling_resistance" in found:
            tree["tire_common"] = {"rolling_resistance": found["rolling_resistance"]}
        if "drag_area" in found:
            tree["aerodynamics"] = {"drag_area": found["drag_area"]}
        air: dict[str, list[float]] = {}
        if "brake_gain" in found:
            air["torque_per_pressure"] = [
                found["brake_gain"] * gain for gain in brake.torque_per_pressure
            ]
        for key, suffix in (
            ("dead_time", "dead_time"),
            ("build_up_time_constant", "build_up_time"),
        ):
            values = _per_axle(found, suffix, getattr(brake, key))
            if values is not None:
                air[key] = values
        if air:
            tree["air_brake"] = air
        return tree

    def write_toml(self, path: str | Path) -> None:
        """Writes the overlay; every estimate stands in a comment with its interval or reason."""
        lines = ["# Identified from a recorded drive; read by Truck.load(parameters=...)."]
        payload = self.payload()
        if payload is not None:
            lines.append(f"# payload by the identified mass: {payload:.0f} kg")
        for e in self.estimates:
            if e.identifiable:
                lines.append(f"# {e.name} = {e.value:.6g} +/- {e.half_width:.2g} {e.unit} (95 %)")
            else:
                lines.append(f"# {e.name}: not identifiable, {e.reason}")
        for section, content in self.overlay().items():
            lines += ["", f"[{section}]"]
            lines += [f"{key} = {_toml(value)}" for key, value in content.items()]
        try:
            Path(path).write_text("\n".join(lines) + "\n", encoding="utf-8")
        except OSError as error:
            raise InputError(f"{str(path)!r} cannot be written: {error.strerror}") from error


def identify(
    log: Log,
    parameters: TruckParameters | None = None,
    *,
    names: Sequence[str] = DEFAULT,
    mass: float | None = None,
) -> Identification:
    """Fits the longitudinal parameters and the brakes' response to a recorded drive.

    Output error with free initial speeds: in each window the model's acceleration is integrated
      from
    the recorded speed, and the window's mean difference is taken out, which eliminates its initial
    speed. Noise on the speed is therefore never differentiated.

    Args:
      log: the drive.
      parameters: prior values, and all that is not fitted; default the shipped truck.
      names: of `LONGITUDINAL`, what to fit.
      mass: gross mass when it is known [kg]; the torque scale can be fitted only then.

    Raises:
      InputError: unknown name, or a log in which the model holds nowhere.
    """
    parameters = parameters or TruckParameters.load()
    unknown = [name for name in names if name not in LONGITUDINAL]
    if unknown:
        raise InputError(f"cannot identify {unknown[0]!r}; there are {list(LONGITUDINAL)}")
    inputs = prepare(log, parameters)
    if not inputs.windows:
        raise InputError(
            "the log has no stretch of 4 s above 3 m/s in one gear: nothing can be identified"
        )
    prior = _prior(parameters, mass)
    chosen = [n for n in LONGITUDINAL if n in names and not (n == "mass" and mass is not None)]
    blind = []
    if "mass" in chosen and "engine_torque_scale" in chosen:
        # Only the rotating inertia, a few per cent of the mass, tells them apart: too weak to
        # trust.
        chosen.remove("engine_torque_scale")
        blind.append(_TORQUE_SCALE_BLIND)
    free = [Free(n, *_LIMITS[n](prior[n])) for n in chosen]

    def residual(values: FloatArray) -> list[FloatArray]:
        trial = {**prior, **dict(zip(chosen, map(float, values), strict=True))}
        return [
            model - inputs.speed[w]
            for w, model in zip(inputs.windows, speeds(inputs, trial), strict=True)
        ]

    estimates, values = fit(free, residual)
    fitted = {**prior, **dict(zip(chosen, map(float, values), strict=True))}
    return Identification(
        estimates=(*estimates, *blind, *identify_pressures(log, parameters)),
        time=np.concatenate([inputs.time[w] for w in inputs.windows]),
        recorded=np.concatenate([inputs.speed[w] for w in inputs.windows]),
        speed_before=np.concatenate(speeds(inputs, prior)),
        speed_after=np.concatenate(speeds(inputs, fitted)),
        parameters=parameters,
        fitted=fitted,
    )


def speeds(inputs: Inputs, values: dict[str, float]) -> list[FloatArray]:
    """The model's speed [m/s] in each window, its mean laid on the recorded one."""
    rate = acceleration(inputs, values)
    found = []
    for window in inputs.windows:
        steps = 0.5 * (rate[window][1:] + rate[window][:-1]) * np.diff(inputs.time[window])
        rise = np.concatenate([[0.0], np.cumsum(steps)])
        found.append(rise + np.mean(inputs.speed[window] - rise))
    return found


_TORQUE_SCALE_BLIND = Estimate(
    "engine_torque_scale",
    1.0,
    "1",
    1.0,
    math.inf,
    False,
    "motion shows it only as a ratio to the mass: give the mass",
)

_LIMITS = {
    "mass": lambda x: ("kg", x, 5e3, 1.2e5),
    "rolling_resistance": lambda x: ("1", x, 1e-4, 0.05),
    "drag_area": lambda x: ("m2", x, 0.1, 30.0),
    "brake_gain": lambda x: ("1", x, 0.05, 5.0),
    "engine_torque_scale": lambda x: ("1", x, 0.2, 3.0),
}


def _prior(parameters: TruckParameters, mass: float | None) -> dict[str, float]:
    middle = parameters.gross_mass(0.5 * parameters.payload.mass_max)
    return {
        "mass": middle if mass is None else float(mass),
        "rolling_resistance": parameters.tire_common.rolling_resistance,
        "drag_area": parameters.aerodynamics.drag_area,
        "brake_gain": 1.0,
        "engine_torque_scale": 1.0,
    }


def _per_axle(found: dict[str, float], suffix: str, prior: tuple[float, ...]) -> list[float] | None:
    names = [f"{circuit}_{suffix}" for circuit in CIRCUITS]
    if not any(name in found for name in names):
        return None
    axles = (0, 1, 1, 2, 2, 2)
    return [found.get(names[c], before) for c, before in zip(axles, prior, strict=True)]


def _toml(value: Any) -> str:
    if isinstance(value, list):
        return "[" + ", ".join(f"{item:.9g}" for item in value) + "]"
    return f"{value:.9g}"
