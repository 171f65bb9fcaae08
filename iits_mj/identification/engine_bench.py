"""The powertrain plugin on a test bench: a rotor that is driven at the recorded engine speed.

The bench's gearbox has a single ratio, so that the engine turns with the rotor, and its controller
has no reason to change gear; pedal and engine speed go in, the crankshaft's torque comes out. What
is identified is therefore the engine that the truck will have, not a copy of its equations.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from mujoco import rollout

from iits_mj.core.arrays import FloatArray
from iits_mj.model import powertrain
from iits_mj.parameter_files import Table2D
from iits_mj.parameters import TruckParameters
from iits_mj.plugin_library import register

STEP = 0.005
# A rotor that the engine cannot disturb, and the gain of the machine that drives it.
_INERTIA = 1e4
_GAIN = 1e6
# Vehicle speeds [m/s] at which the bench's gearbox would change up and down: never.
_NEVER_UP, _NEVER_DOWN = 199.0, 0.0
_DELAY = 10.0
_SIGNALS = ("engine_torque", "shift_in_process", "clutch_engagement")


@dataclass(frozen=True)
class Stretch:
    """Engine speed [rad/s] and pedal over time, on a grid of `STEP`, each of shape (n,)."""

    engine_speed: FloatArray
    pedal: FloatArray


def torques(parameters: TruckParameters, stretches: Sequence[Stretch]) -> list[FloatArray]:
    """Crankshaft torque [N m] in each stretch, (n,); NaN while the bench's driveline is open.

    Each begins without torque, as after a gear change.
    """
    model = _model(parameters)
    data = mujoco.MjData(model)
    longest = max(len(s.pedal) for s in stretches)
    states, controls = [], np.zeros((len(stretches), longest, model.nu))
    pedal, machine = (
        int(model.actuator_ctrladr[model.actuator(n).id]) for n in ("accelerator_pedal", "machine")
    )
    for index, stretch in enumerate(stretches):
        mujoco.mj_resetData(model, data)
        data.qvel[0] = stretch.engine_speed[0]
        states.append(_state(model, data))
        for column, values in ((pedal, stretch.pedal), (machine, stretch.engine_speed)):
            controls[index, : len(values), column] = values
            controls[index, len(values) :, column] = values[-1]
    _, sensors = rollout.rollout(model, data, np.array(states), controls)
    torque, shifting, engagement = (
        sensors[:, :, int(model.sensor(name).adr[0])] for name in _SIGNALS
    )
    closed = (shifting < 0.5) & (engagement > 0.99)
    torque = np.where(closed, torque, np.nan)
    return [np.asarray(row[: len(s.pedal)]) for row, s in zip(torque, stretches, strict=True)]


def _state(model: mujoco.MjModel, data: mujoco.MjData) -> FloatArray:
    kind = mujoco.mjtState.mjSTATE_FULLPHYSICS
    state = np.empty(mujoco.mj_stateSize(model, kind))
    mujoco.mj_getState(model, data, state, kind)
    return state


def _model(parameters: TruckParameters) -> mujoco.MjModel:
    register()
    gearbox = parameters.gearbox
    gears = len(gearbox.ratios)

    def never(table: Table2D, speed: float) -> Table2D:
        return dataclasses.replace(table, values=np.full_like(table.values, speed))

    single = dataclasses.replace(
        gearbox,
        final_drive=1.0,
        # The plugin wants ratios that fall; these do so by a millionth.
        ratios=1.0 - 1e-6 * np.arange(gears, dtype=np.float64),
        start_gear=gears,
        downshift_delay=_DELAY,
        upshift=never(gearbox.upshift, _NEVER_UP),
        downshift=never(gearbox.downshift, _NEVER_DOWN),
    )
    config = powertrain.config(dataclasses.replace(parameters, gearbox=single))
    attributes = "".join(f'<config key="{k}" value="{v}"/>' for k, v in config.items())
    sensors = "".join(
        f'<plugin name="{name}" plugin="iits.powertrain" instance="powertrain"/>'
        for name in _SIGNALS
    )
    return mujoco.MjModel.from_xml_string(f"""
      <mujoco>
        <option timestep="{STEP}" integrator="implicitfast" gravity="0 0 0"/>
        <extension><plugin plugin="iits.powertrain">
          <instance name="powertrain">{attributes}</instance>
        </plugin></extension>
        <worldbody><body name="rotor"><joint name="rotor" axis="1 0 0"/>
          <inertial pos="0 0 0" mass="1" diaginertia="{_INERTIA} {_INERTIA} {_INERTIA}"/>
        </body></worldbody>
        <tendon><fixed name="shaft"><joint joint="rotor" coef="1"/></fixed></tendon>
        <actuator>
          <plugin name="accelerator_pedal" plugin="iits.powertrain" instance="powertrain"
            tendon="shaft"/>
          <velocity name="machine" joint="rotor" kv="{_GAIN}"/>
        </actuator>
        <sensor>{sensors}</sensor>
      </mujoco>""")
