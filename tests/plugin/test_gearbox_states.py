"""Engine, clutch and gearbox under any order of commands, grades, loads and resets."""

import numpy as np
import pytest
from hypothesis import strategies as st
from hypothesis.stateful import initialize

from tests.plugin.sled_states import HEAVY, LIGHT, SledMachine
from tests.plugin.test_powertrain_energy import SUMS, shaft_shares
from tests.plugin.vehicle_sled import PARAMETERS, Sled
from tests.stateful import SLOW, explore

ENGINE, GEARBOX = PARAMETERS.engine, PARAMETERS.gearbox
SHIFTING = GEARBOX.shifting
METERS_PER_RADIAN = PARAMETERS.tires["drive"].rolling_radius / GEARBOX.final_drive
REVERSE, NEUTRAL, TOP = -1, 0, len(GEARBOX.ratios)
DRIVE_MODE, NEUTRAL_MODE, REVERSE_MODE = 0, 1, 2
# The longest time that a change may take: cut, synchronization up to its limit, closing [s].
CHANGE = GEARBOX.shift_cut_time + GEARBOX.synchronization_time_max + GEARBOX.clutch_close_time


class Drivetrain(SledMachine):
    """Checks the powertrain of a sled after every step."""

    @initialize(
        mass=st.floats(LIGHT, HEAVY),
        speed=st.sampled_from([0.0, 2.0, 10.0, 22.0]),
        timestep=st.sampled_from([0.005, 0.005, 0.002]),
        strategy=st.sampled_from(["adaptive", "tables"]),
    )
    def start(self, mass, speed, timestep, strategy):
        changes = {("powertrain", "shift_strategy"): strategy}
        self.begin(Sled(mass, speed=speed, timestep=timestep, changes=changes), mass)

    def begun(self):
        self.shares = shaft_shares(self.sled.model)
        self.last = None
        self.shaft_work, self.turned, self.start_sums = 0.0, 0.0, None
        self.changing = 0.0

    def check(self, rows, speeds):
        named = {name: self.column(rows, name) for name in self.columns}
        self.check_gears(named, speeds)
        self.check_engine(named, speeds)
        self.check_clutch(named)
        self.check_energy(named, speeds)
        self.last = {name: values[-1] for name, values in named.items()}

    def before(self, named, name):
        """The sensor one step earlier, for every step."""
        first = named[name][0] if self.last is None else self.last[name]
        return np.concatenate([[first], named[name][:-1]])

    def check_gears(self, named, speeds):
        gear, shifting = named["gear"], named["shift_in_process"]
        engaged = named["powertrain_report"][:, 0]
        assert set(gear) <= set(range(REVERSE, TOP + 1))
        assert set(engaged) <= set(range(REVERSE, TOP + 1))
        assert set(shifting) <= {0.0, 1.0}
        # Outside a change one gear is engaged, and it stays the same.
        steady = (shifting == 0.0) & (self.before(named, "shift_in_process") == 0.0)
        assert np.all(gear[steady] == self.before(named, "gear")[steady])
        assert np.all(engaged[shifting == 0.0] == gear[shifting == 0.0])
        # A change to reverse begins only near standstill, and so does one to forward gears.
        begun = gear != self.before(named, "gear")
        speed = named["propeller_shaft_speed"] * METERS_PER_RADIAN
        slow = SHIFTING.engage_speed_max + 0.1
        assert np.all(np.abs(speed[begun & (gear == REVERSE)]) < slow)
        assert np.all(speed[begun & (gear > 0)] > -slow)
        # A change ends.
        h = self.sled.model.opt.timestep
        for changing in shifting:
            self.changing = self.changing + h if changing else 0.0
            assert self.changing < CHANGE + 3 * h

    def check_engine(self, named, speeds):
        speed = named["engine_speed"]
        assert speed.min() > 0.0
        # A slope may turn the engine beyond the speed at which the gearbox shifts up: while it
        # shifts, and without limit where there is no higher gear.
        gear = named["powertrain_report"][:, 0].astype(int)
        ratio = np.array([0.0, *GEARBOX.ratios, -GEARBOX.reverse_ratio])[gear]
        driven = ratio * named["propeller_shaft_speed"]
        alone = np.isin(gear, (TOP, REVERSE))
        fastest = SHIFTING.overspeed_braking * ENGINE.engine_brake_speed + 20.0
        assert np.all(speed < np.where(alone, np.maximum(fastest, driven + 20.0), fastest))
        assert np.all(named["fuel_used"] >= self.before(named, "fuel_used"))
        assert named["fuel_rate"].min() >= 0.0
        assert named["engine_torque"].max() <= 1.01 * ENGINE.full_load_torque.max()

    def check_clutch(self, named):
        closed = named["clutch_engagement"]
        assert closed.min() >= 0.0
        assert closed.max() <= 1.0
        retarder = named["retarder_torque"] / GEARBOX.driveline_efficiency
        of_engine = np.abs(named["propeller_shaft_torque"]) - retarder
        assert np.all(of_engine[closed == 0.0] <= 1e-6)
        in_neutral = (named["gear"] == NEUTRAL) & (named["shift_in_process"] == 0.0)
        assert np.all(of_engine[in_neutral] <= 1e-6)
        most = max(*GEARBOX.ratios, GEARBOX.reverse_ratio) * GEARBOX.clutch_torque_max
        losses = GEARBOX.efficiency * GEARBOX.driveline_efficiency
        assert of_engine.max() <= most / losses

    def check_energy(self, named, speeds):
        h = self.sled.model.opt.timestep
        shaft = speeds @ self.shares
        work = h * named["propeller_shaft_torque"] * 0.5 * (shaft[:-1] + shaft[1:])
        sums = np.array([named[name] for name in SUMS])
        if self.start_sums is None:
            # Sensors show the sums before the step.
            self.start_sums = sums[:, 0]
        engine, loss, retarder, stored = sums[:, -1] - self.start_sums
        balance = engine - loss - retarder - stored - (self.shaft_work + work[:-1].sum())
        self.shaft_work += work.sum()
        self.turned += np.abs(work).sum() + np.abs(np.diff(sums)).sum()
        assert abs(balance) <= 1e-8 * (1e4 + self.turned)
        falls = np.diff(named["retarder_work"])
        assert falls.min(initial=0.0) > -1e-3, falls.min()
        assert np.all(named["driveline_energy"] >= 0.0)


def test_any_order_of_commands_keeps_engine_clutch_and_gearbox_within_physics():
    explore(Drivetrain, runs=15, rules=20)


@pytest.mark.slow
def test_many_orders_of_commands_keep_engine_clutch_and_gearbox_within_physics():
    explore(Drivetrain, runs=15, rules=40, factor=SLOW)
