"""Draws the figures of docs/analytic.md; imports the independent multibody model."""

from __future__ import annotations

import sys
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from printed_model import CORRECTED, PRINTED
from yaw_sideslip import STEP, V80, system

from iits_mj.analytic import YawPlane, simulate
from iits_mj.parameters import TruckParameters

# The independent multibody model is part of the tests.
sys.path.append(str(Path(__file__).resolve().parents[2] / "tests" / "analytic"))
from planar_multibody import PlanarTruck, agreement_table, ramp_step

__all__ = ["agreement_table", "write"]

_RIGHT, _WRONG, _PEER = "#1f5fa8", "#c23b22", "#222222"
_SIGNALS = (
    ("yaw_rate", "yaw rate of the tractor [deg/s]", True),
    ("trailer_yaw_rate", "yaw rate of the trailer [deg/s]", True),
    ("articulation", "hitch angle [deg]", True),
    ("y", "lateral position [m]", False),
)


def write(folder: Path, parameters: TruckParameters) -> None:
    """Writes `analytic_eigenvalues.png` and `analytic_step.png` into the folder."""
    matplotlib.use("Agg")
    folder.mkdir(parents=True, exist_ok=True)
    model = YawPlane.from_parameters(parameters, parameters.payload_max, pneumatic_trail=False)
    with plt.rc_context({"font.size": 9, "axes.grid": True, "grid.alpha": 0.3}):
        _eigenvalues(folder / "analytic_eigenvalues.png", model)
        _step(folder / "analytic_step.png", model, STEP / parameters.steering.ratio)


def _eigenvalues(path: Path, model: YawPlane) -> None:
    figure, axes = plt.subplots(figsize=(6.4, 4.0), layout="constrained")
    speeds = np.arange(40.0, 121.0, 2.0)
    for reading, color, label in ((CORRECTED, _RIGHT, "corrected"), (PRINTED, _WRONG, "printed")):
        values = np.array([system(reading, model, float(v) / 3.6).eigenvalues() for v in speeds])
        points = axes.scatter(
            values.real, values.imag, c=np.repeat(speeds, 4), s=9, cmap="Greys", vmin=0, vmax=140
        )
        points.set_edgecolor(color)
        at_80 = system(reading, model, V80).eigenvalues()
        axes.plot(at_80.real, at_80.imag, "o", color=color, ms=7, label=f"{label}, 80 km/h")
    axes.axvline(0.0, color="k", lw=1.0)
    axes.axvspan(0.0, 1.0, color=_WRONG, alpha=0.08)
    axes.set(
        xlim=(-6.0, 1.0),
        xlabel="real part [1/s] (shaded: unstable)",
        ylabel="imaginary part [rad/s]",
        title="Eigenvalues of the laden truck, 40 to 120 km/h (small dots, darker: faster)",
    )
    axes.legend(loc="upper left")
    figure.savefig(path, dpi=110)
    plt.close(figure)


def _step(path: Path, model: YawPlane, steer: float) -> None:
    time = np.linspace(0.0, 10.0, 1001)
    step = ramp_step(steer)
    samples = np.array([step(now) for now in time])
    right = simulate(system(CORRECTED, model, V80), time, samples)
    wrong = simulate(system(PRINTED, model, V80), time, samples)
    peer = PlanarTruck(model).drive(V80, step, time)
    figure, grid = plt.subplots(2, 2, figsize=(8.0, 5.2), layout="constrained", sharex=True)
    axes: Axes
    for axes, (name, label, angle) in zip(grid.flat, _SIGNALS, strict=True):
        scale = np.rad2deg(1.0) if angle else 1.0
        reference = scale * getattr(peer, name)
        low, high = (-2.0, 4.0) if angle else (-0.1, 2.3)
        axes.plot(time, scale * getattr(wrong, name), color=_WRONG, lw=1.2, label="as printed")
        axes.plot(time, scale * getattr(right, name), color=_RIGHT, lw=2.4, label="corrected")
        axes.plot(time, reference, "--", color=_PEER, lw=1.2, label="nonlinear multibody")
        axes.set(ylabel=label, ylim=(low * reference.max(), high * reference.max()))
    for axes in grid[1]:
        axes.set_xlabel("time [s]")
    grid[0, 0].legend(loc="lower left", framealpha=1.0)
    figure.suptitle("Laden truck, 80 km/h, step of 15 deg at the steering wheel")
    figure.savefig(path, dpi=110)
    plt.close(figure)
