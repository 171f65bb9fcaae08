"""What the state machines of gearbox and brakes share: a sled with rules for its driver."""

from __future__ import annotations

import copy
import math

import mujoco
import numpy as np
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, rule

from tests.plugin.vehicle_sled import PARAMETERS, SIDES, Sled

SHARES = st.sampled_from([0.0, 0.1, 0.4, 0.7, 1.0])
TIMES = st.sampled_from([0.05, 0.3, 1.0, 3.0])
WRONG = st.sampled_from([math.nan, math.inf, -math.inf, 1e12, -1e12])
CONTROLS = (
    *("accelerator_pedal", "xbr_demand", "xbr_mode", "parking_brake", "engine_brake"),
    *("transmission_mode", "brake_pedal", "xbr_ebi_mode", "retarder"),
)
FULL = mujoco.mjtState.mjSTATE_INTEGRATION
LIGHT, HEAVY = 15_000.0, 60_000.0
# Beyond these speeds no slope pushes the sled on [m/s].
FASTEST, FASTEST_BACKWARD = 28.0, -2.0


def state(sled):
    """The whole state, from which the motion follows."""
    values = np.zeros(mujoco.mj_stateSize(sled.model, FULL))
    mujoco.mj_getState(sled.model, sled.data, values, FULL)
    return values


class SledMachine(RuleBasedStateMachine):
    """A sled whose driver may do anything. Subclasses make `self.sled` and check `rows`.

    Attributes:
      sled: the vehicle; controls: the present ones by name.
    """

    sled: Sled

    def begin(self, sled, mass):
        self.sled, self.mass = sled, mass
        self.columns = {}
        for i in range(sled.model.nsensor):
            first = sled.model.sensor_adr[i]
            self.columns[sled.model.sensor(i).name] = slice(first, first + sled.model.sensor_dim[i])
        self.controls, self.slope = dict.fromkeys(CONTROLS, 0.0), 0.0
        self.begun()

    def begun(self):
        """Called after a start and after a reset."""

    def column(self, rows, name):
        """A sensor after every step: shape (steps,), or (steps, numbers)."""
        found = rows[:, self.columns[name]]
        return found[:, 0] if found.shape[1] == 1 else found

    def run(self, seconds, **controls):
        """Sets controls, steps, and checks what the sensors showed in every step."""
        self.controls.update(controls)
        sled = self.sled
        sled.command(**self.controls)
        pushed = FASTEST_BACKWARD < sled["speed"] < FASTEST or self.slope * sled["speed"] < 0.0
        sled.model.opt.gravity[0] = self.slope if pushed else 0.0
        rows, speeds = [], [sled.data.qvel.copy()]
        for _ in range(max(1, round(seconds / sled.model.opt.timestep))):
            mujoco.mj_step(sled.model, sled.data)
            rows.append(sled.data.sensordata.copy())
            speeds.append(sled.data.qvel.copy())
        rows, speeds = np.array(rows), np.array(speeds)
        assert np.isfinite(rows).all()
        assert np.isfinite(speeds).all()
        assert np.isfinite(sled.data.plugin_state).all()
        bad = mujoco.mjtWarning.mjWARN_BADCTRL
        for i, warning in enumerate(sled.data.warning):
            assert i == bad or warning.number == 0
        self.check(rows, speeds)

    def check(self, rows, speeds):
        """Checks the sensors of every step, and the speeds before, between and after them."""
        raise NotImplementedError

    @rule(pedal=SHARES, seconds=TIMES)
    def accelerate(self, pedal, seconds):
        self.run(seconds, accelerator_pedal=pedal)

    @rule(pedal=SHARES, seconds=TIMES)
    def press_the_brake_pedal(self, pedal, seconds):
        self.run(seconds, brake_pedal=pedal)

    @rule(
        demand=st.sampled_from([0.0, -0.5, -2.0, -8.0]),
        mode=st.integers(0, 3),
        ebi_mode=st.integers(0, 3),
        seconds=TIMES,
    )
    def demand_deceleration(self, demand, mode, ebi_mode, seconds):
        self.run(seconds, xbr_demand=demand, xbr_mode=mode, xbr_ebi_mode=ebi_mode)

    @rule(seconds=TIMES)
    def release_the_brakes(self, seconds):
        released = ("brake_pedal", "xbr_demand", "xbr_mode", "parking_brake", "engine_brake")
        self.run(seconds, **dict.fromkeys((*released, "retarder"), 0.0))

    @rule(engine_brake=SHARES, retarder=SHARES, seconds=TIMES)
    def use_the_endurance_brakes(self, engine_brake, retarder, seconds):
        self.run(seconds, engine_brake=engine_brake, retarder=retarder)

    @rule(share=SHARES, seconds=TIMES)
    def move_the_parking_brake(self, share, seconds):
        self.run(seconds, parking_brake=share)

    @rule(mode=st.sampled_from([0, 0, 1, 2]), seconds=TIMES)
    def move_the_selector(self, mode, seconds):
        self.run(seconds, transmission_mode=mode)

    @rule(acceleration=st.sampled_from([-1.2, -0.5, 0.0, 0.5, 1.2]), seconds=TIMES)
    def change_the_grade(self, acceleration, seconds):
        self.slope = acceleration
        self.run(seconds)

    @rule(mass=st.floats(LIGHT, HEAVY))
    def load_or_unload(self, mass):
        self.mass = mass
        self.sled.model.body("sled").mass = mass - 12
        self.run(0.2)

    @rule(name=st.sampled_from(CONTROLS), value=WRONG)
    def send_a_wrong_number(self, name, value):
        before = self.controls[name]
        self.run(0.1, **{name: value})
        self.run(0.1, **{name: before})

    @rule(speed=st.sampled_from([0.0, -2.0, 3.0, 12.0, 25.0]))
    def reset(self, speed):
        mujoco.mj_resetData(self.sled.model, self.sled.data)
        roll(self.sled, speed)
        self.controls, self.slope = dict.fromkeys(CONTROLS, 0.0), 0.0
        self.begun()
        self.run(0.05)

    @rule(pedal=SHARES)
    def continue_as_a_copy(self, pedal):
        """A copy of the data in this state moves as the original, bit for bit."""
        other = copy.copy(self.sled)
        other.data = copy.copy(self.sled.data)
        self.run(0.4, accelerator_pedal=pedal)
        other.command(**self.controls)
        steps = max(1, round(0.4 / other.model.opt.timestep))
        for _ in range(steps):
            mujoco.mj_step(other.model, other.data)
        assert state(other).tobytes() == state(self.sled).tobytes()
        self.sled = other


def roll(sled, speed):
    """Sets the speed of sled and wheels."""
    sled.data.qvel[0] = speed
    for axle in PARAMETERS.axles:
        for side in SIDES:
            dof = sled.model.joint(f"{axle.name}_{side}_spin").dofadr[0]
            sled.data.qvel[dof] = speed / PARAMETERS.tires[axle.tire].rolling_radius
