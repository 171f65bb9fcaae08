"""A truck on one slide joint: the real powertrain and brakes, twelve wheels, no suspension.

Each tire is a fixed tendon between slide and wheel: a stiff spring and damper (no slip), or dry
friction of a given grip (for ABS). A grade tilts gravity.
"""

import math

import mujoco
import numpy as np

import iits_mj  # registers the plugin
from iits_mj.core.units import GRAVITY
from iits_mj.model import air_brake, powertrain
from iits_mj.parameters import TruckParameters

PARAMETERS = TruckParameters.load()
RPM = 2 * math.pi / 60
KMH = 1 / 3.6
SIDES = ("left", "right")
assert iits_mj.__version__


def axle_brakes(name):
    """Returns a parameter of the brake of every axle, (axles,)."""
    return np.array([getattr(axle.brake, name) for axle in PARAMETERS.axles])


def sled_xml(mass, *, timestep=0.002, grade=0.0, grip=None, rolling=True, changes=None, sensors=()):
    """Returns the MJCF of a sled of `mass` [kg]; `changes` has attributes by (plugin, name)."""
    p = PARAMETERS
    configs = {
        "powertrain": powertrain.config(p),
        "air_brake": air_brake.config(p, p.payload_max),
    }
    for (plugin, name), value in (changes or {}).items():
        configs[plugin][name] = value
    extension = "".join(
        f'<plugin plugin="iits.{plugin}"><instance name="{plugin}">'
        + "".join(f'<config key="{k}" value="{v}"/>' for k, v in config.items())
        + "</instance></plugin>"
        for plugin, config in configs.items()
    )
    angle = math.atan(grade)
    wheels, tendons, shaft = [], [], []
    load = mass * GRAVITY / (2 * len(p.axles))
    for axle in p.axles:
        radius = p.tires[axle.tire].rolling_radius
        inertia = axle.wheel_inertia_spin
        for side in SIDES:
            name = f"{axle.name}_{side}"
            wheels.append(f"""
              <body name="{name}_hub"><plugin plugin="iits.air_brake" instance="air_brake"/>
                <body name="{name}_wheel"><joint name="{name}_spin" axis="0 1 0"/>
                  <inertial pos="0 0 0" mass="1" diaginertia="{inertia} {inertia} {inertia}"/>
                </body></body>""")
            tire = (
                'stiffness="2e6" damping="4e4"' if grip is None else f'frictionloss="{grip * load}"'
            )
            tendons.append(
                f'<fixed name="{name}_tire" {tire}><joint joint="slide" coef="1"/>'
                f'<joint joint="{name}_spin" coef="{-radius}"/></fixed>'
            )
            if axle.driven:
                coefficient = p.gearbox.final_drive / 4
                shaft.append(f'<joint joint="{name}_spin" coef="{coefficient}"/>')
    resistance = mass * GRAVITY * p.tires["steer"].rolling_resistance if rolling else 0.0
    actuators = "".join(
        f'<plugin name="{name}" plugin="iits.{plugin}" instance="{plugin}"'
        ' tendon="propeller_shaft"/>'
        for name, plugin in (
            ("accelerator_pedal", "powertrain"),
            ("xbr_demand", "air_brake"),
            ("xbr_mode", "air_brake"),
            ("parking_brake", "air_brake"),
            ("engine_brake", "powertrain"),
            ("transmission_mode", "powertrain"),
            ("brake_pedal", "air_brake"),
            ("xbr_ebi_mode", "air_brake"),
            ("retarder", "powertrain"),
        )
    )
    signals = [(name, "powertrain") for name in powertrain.SIGNALS]
    signals += [(name, "air_brake") for name in air_brake.SIGNALS] + list(sensors)
    sensor = "".join(
        f'<plugin name="{name}" plugin="iits.{plugin}" instance="{plugin}"/>'
        for name, plugin in signals
    )
    return f"""
    <mujoco>
      <option timestep="{timestep}" integrator="implicitfast"
        gravity="{-GRAVITY * math.sin(angle)} 0 {-GRAVITY * math.cos(angle)}"/>
      <extension>{extension}</extension>
      <worldbody><body name="sled">
        <joint name="slide" type="slide" axis="1 0 0" frictionloss="{resistance}"/>
        <inertial pos="0 0 0" mass="{mass - 12}" diaginertia="1 1 1"/>
        {"".join(wheels)}
      </body></worldbody>
      <tendon><fixed name="propeller_shaft">{"".join(shaft)}</fixed>{"".join(tendons)}</tendon>
      <actuator>{actuators}</actuator>
      <sensor>{sensor}</sensor>
    </mujoco>"""


class Sled:
    """Model and data of a sled, with names for controls and signals."""

    def __init__(self, mass=19_000.0, *, speed=0.0, **options):
        self.model = mujoco.MjModel.from_xml_string(sled_xml(mass, **options))
        self.data = mujoco.MjData(self.model)
        self.data.qvel[0] = speed
        for axle in PARAMETERS.axles:
            for side in SIDES:
                dof = self.model.joint(f"{axle.name}_{side}_spin").dofadr[0]
                self.data.qvel[dof] = speed / PARAMETERS.tires[axle.tire].rolling_radius

    def command(self, **controls):
        for name, value in controls.items():
            self.data.actuator(name).ctrl = value

    def run(self, seconds, **controls):
        self.command(**controls)
        mujoco.mj_step(self.model, self.data, round(seconds / self.model.opt.timestep))
        return self

    def record(self, seconds, *names, **controls):
        """Returns signals after every step, shape (steps, names).

        `speed` and `position` are those of the sled.
        """
        self.command(**controls)
        rows = []
        for _ in range(round(seconds / self.model.opt.timestep)):
            mujoco.mj_step(self.model, self.data)
            rows.append([self[name] for name in names])
        return np.array(rows)

    def __getitem__(self, name):
        if name == "speed":
            return self.data.qvel[0]
        if name == "position":
            return self.data.qpos[0]
        return self.data.sensor(name).data[0]

    def wheels(self, name):
        """Returns a sensor of all wheel ends, axle by axle, left before right, shape (12,)."""
        return self.data.sensor(name).data.copy()
