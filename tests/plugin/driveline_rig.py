"""A powertrain on one slide joint and one driven wheel, for many long runs at once.

One constant force is grade and rolling resistance; a linear damper has the air drag at 20 m/s. The
rig has no brakes: a run that starts at rest on a climb needs a pressed pedal.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import mujoco.rollout
import numpy as np

import iits_mj  # registers the plugin
from iits_mj.core.arrays import FloatArray
from iits_mj.core.units import GRAVITY
from iits_mj.model import powertrain
from iits_mj.parameters import TruckParameters

assert iits_mj.__version__
PARAMETERS = TruckParameters.load()
RADIUS = PARAMETERS.tires["drive"].rolling_radius
CONTROLS = ("accelerator_pedal", "engine_brake", "transmission_mode")
SPEED_OF_DRAG = 20.0
SIGNALS = (
    "gear",
    "shift_in_process",
    "engine_speed",
    "engine_torque",
    "propeller_shaft_torque",
    "propeller_shaft_speed",
)
PART = 12  # runs at once


@dataclass(frozen=True)
class Case:
    """One run: mass [kg], grade (rise over run) and start speed [m/s]."""

    mass: float
    grade: float
    speed: float


@dataclass(frozen=True)
class Traces:
    """Signals of all runs, each of shape (cases, steps); time [s] of shape (steps,)."""

    time: FloatArray
    speed: FloatArray
    signals: dict[str, FloatArray]

    def __getitem__(self, name: str) -> FloatArray:
        return self.speed if name == "speed" else self.signals[name]


def rig_xml(case: Case, timestep: float, changes: dict[str, str]) -> str:
    """Returns the MJCF of one case; `changes` replaces attributes of the powertrain."""
    p = PARAMETERS
    config = {**powertrain.config(p), **changes}
    keys = "".join(f'<config key="{k}" value="{v}"/>' for k, v in config.items())
    air = p.aerodynamics
    drag = 0.5 * air.density * air.drag_area * SPEED_OF_DRAG
    angle = math.atan(case.grade)
    force = case.mass * GRAVITY * (math.sin(angle) + p.tires["steer"].rolling_resistance)
    spin = 12 * 30.0
    actuators = "".join(
        f'<plugin name="{name}" plugin="iits.powertrain" instance="powertrain" tendon="shaft"/>'
        for name in CONTROLS
    )
    sensors = "".join(
        f'<plugin name="{name}" plugin="iits.powertrain" instance="powertrain"/>'
        for name in powertrain.SIGNALS
    )
    return f"""
    <mujoco>
      <option timestep="{timestep}" integrator="implicitfast" gravity="{-force / case.mass} 0 0">
        <flag constraint="disable"/>
      </option>
      <extension><plugin plugin="iits.powertrain">
        <instance name="powertrain">{keys}</instance></plugin></extension>
      <worldbody><body name="sled">
        <joint name="slide" type="slide" axis="1 0 0" damping="{drag}"/>
        <inertial pos="0 0 0" mass="{case.mass - 1}" diaginertia="1 1 1"/>
        <body name="wheel"><joint name="spin" axis="0 1 0"/>
          <inertial pos="0 0 0" mass="1" diaginertia="{spin} {spin} {spin}"/></body>
      </body></worldbody>
      <tendon>
        <fixed name="shaft"><joint joint="spin" coef="{p.gearbox.final_drive}"/></fixed>
        <fixed name="tire" stiffness="8e6" damping="2e5"><joint joint="slide" coef="1"/>
          <joint joint="spin" coef="{-RADIUS}"/></fixed>
      </tendon>
      <actuator>{actuators}</actuator>
      <sensor>{sensors}</sensor>
    </mujoco>"""


def drive(
    cases: Sequence[Case],
    controls: FloatArray,
    *,
    timestep: float = 0.005,
    changes: dict[str, str] | None = None,
) -> Traces:
    """Returns the traces of all cases.

    Args:
      cases: n runs.
      controls: values of `CONTROLS` at each step, shape (n, steps, 3).
      timestep: of the physics [s].
      changes: attributes of the powertrain to replace.
    """
    models = [
        mujoco.MjModel.from_xml_string(rig_xml(case, timestep, changes or {})) for case in cases
    ]
    kind = mujoco.mjtState.mjSTATE_FULLPHYSICS
    initial = []
    for model, case in zip(models, cases, strict=True):
        data = mujoco.MjData(model)
        data.qvel[:] = case.speed, case.speed / RADIUS
        state = np.zeros(mujoco.mj_stateSize(model, kind))
        mujoco.mj_getState(model, data, state, kind)
        initial.append(state)
    data = mujoco.MjData(models[0])
    steps = controls.shape[1]
    speed = np.empty((len(cases), steps))
    signals = {name: np.empty((len(cases), steps)) for name in SIGNALS}
    # The full state of all runs would fill the memory.
    for begin in range(0, len(cases), PART):
        part = slice(begin, begin + PART)
        state, sensors = mujoco.rollout.rollout(
            models[part], data, np.array(initial[part]), controls[part]
        )
        speed[part] = state[:, :, 1 + models[0].nq]
        for name, values in signals.items():
            values[part] = sensors[:, :, powertrain.SIGNALS.index(name)]
    return Traces(timestep * np.arange(1, steps + 1), speed, signals)


def constant(count: int, seconds: float, pedal: FloatArray, *, timestep: float = 0.005):
    """Returns controls that hold the pedal of each run, shape (count,), in drive."""
    controls = np.zeros((count, round(seconds / timestep), len(CONTROLS)))
    controls[:, :, 0] = np.asarray(pedal)[:, np.newaxis]
    return controls


def shifts(gear: FloatArray, timestep: float = 0.005) -> list[tuple[float, int, int]]:
    """Returns the gear changes of one run: time [s], gear before, gear after."""
    at = np.flatnonzero(np.diff(gear))
    return [(timestep * (i + 1), int(gear[i]), int(gear[i + 1])) for i in at]


def reversals(gear: FloatArray, within: float = 5.0, timestep: float = 0.005):
    """Returns successive gear changes in opposite directions less than `within` [s] apart."""
    found = []
    changes = shifts(gear, timestep)
    for first, second in itertools.pairwise(changes):
        opposite = (first[2] - first[1]) * (second[2] - second[1]) < 0
        if opposite and second[0] - first[0] < within:
            found.append((first, second))
    return found
