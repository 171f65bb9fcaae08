"""One wheel end on a carriage: prescribed motion, measured forces of the tire plugin."""

import mujoco
import numpy as np

from iits_mj.model.connections import tire_config
from iits_mj.parameters import TruckParameters

PARAMETERS = TruckParameters.load()
COMMON = PARAMETERS.tire_common


def rig(kind="drive", *, extra="", before="", hub_joint="", wheel_joint="", **changes):
    """Returns model and data of one wheel end on a carriage that slides along x, y, z.

    `hub_joint` is the MJCF of a further joint of the hub, `wheel_joint` holds attributes of the
    wheel's joint, `before` is MJCF of bodies before it in the model, `extra` is MJCF at the end of
    the model; `changes` replaces tire attributes.
    """
    figures = {**tire_config(PARAMETERS, kind), **changes}
    config = "".join(f'<config key="{k}" value="{v:.17g}"/>' for k, v in figures.items())
    radius = PARAMETERS.tires[kind].free_radius
    model = mujoco.MjModel.from_xml_string(f"""
    <mujoco>
      <option timestep="0.001" integrator="implicitfast"/>
      <extension>
        <plugin plugin="iits.tire"><instance name="tire">{config}</instance></plugin>
      </extension>
      <worldbody>{before}
        <body name="hub" pos="0 0 {radius}">
          <joint name="x" type="slide" axis="1 0 0"/><joint name="y" type="slide" axis="0 1 0"/>
          <joint name="z" type="slide" axis="0 0 1"/>{hub_joint}
          <inertial pos="0 0 0" mass="500" diaginertia="50 50 50"/>
          <body name="wheel">
            <joint name="spin" type="hinge" axis="0 1 0" {wheel_joint}/>
            <inertial pos="0 0 0" mass="200" diaginertia="20 34 20"/>
            <plugin plugin="iits.tire" instance="tire"/>
          </body>
        </body>
      </worldbody>
      <sensor>
        <plugin name="wheel_tire_force" plugin="iits.tire" instance="tire"
                objtype="body" objname="wheel"/>
        <plugin name="wheel_tire_slip" plugin="iits.tire" instance="tire"
                objtype="body" objname="wheel"/>
      </sensor>
      {extra}
    </mujoco>""")
    return model, mujoco.MjData(model)


def rolling_radius(tire, deflection):
    nominal = COMMON.nominal_load / tire.vertical_stiffness
    return tire.rolling_radius + (nominal - deflection) / 3


def drive(
    model, data, *, load, speed, slip_angle=0.0, slip=0.0, seconds=2.0, kind="drive", count=None
):
    """Returns the tire force (3,) [N] after `seconds` of motion at a given load and slip.

    `load` is that of the wheel end; `count` is its number of tires if the rig changes it.
    """
    tire = PARAMETERS.tires[kind]
    deflection = load / ((count or tire.count) * tire.vertical_stiffness)
    spin = model.joint("spin").dofadr[0]
    for _ in range(round(seconds / model.opt.timestep)):
        data.qpos[2:] = 0.0
        data.qpos[2] = -deflection
        data.qvel[:] = 0.0
        data.qvel[:2] = speed, -speed * np.tan(slip_angle)
        data.qvel[spin] = speed / rolling_radius(tire, deflection) * (1 + slip)
        mujoco.mj_step(model, data)
    return data.sensor("wheel_tire_force").data.copy()


ROAD = """<custom><numeric name="iits_road" size="{size}" data="{data}"/></custom>"""


def road(rows):
    assert len(rows) < 45  # the XML reader of MuJoCo 3.17 takes at most 500 numbers
    data = np.concatenate([[1, len(rows), 0, 1.0], np.ravel(rows)])
    return ROAD.format(size=data.size, data=" ".join(f"{v:.12g}" for v in data))
