"""Air brakes under any order of commands, grades, loads, grips and resets, with and without air."""

import numpy as np
import pytest
from hypothesis import strategies as st
from hypothesis.stateful import initialize, rule
from numpy.lib.stride_tricks import sliding_window_view

from tests.plugin.sled_states import HEAVY, LIGHT, SledMachine
from tests.plugin.vehicle_sled import PARAMETERS, Sled, axle_brakes
from tests.stateful import SLOW, explore

BRAKE = PARAMETERS.air_brake
ATMOSPHERE = 101_325.0
CIRCUIT = np.repeat([0, 1, 1, 2, 2, 2], 2)  # of each wheel: front, drive, trailer
RESERVOIRS = tuple(f"reservoir_pressure_{circuit}" for circuit in ("front", "rear", "trailer"))
SLACK = 1.0  # [Pa]
DEAD_TIME = max(axle_brakes("dead_time")) + BRAKE.trailer_line_delay
# The spring brakes are on this time after the air is lost [s].
SPRINGS_ON = 8 * BRAKE.parking_time_constant
# A wheel that turns faster is not rocking on its tire and its elastic brake [rad/s].
TURNING = 10.0


class Brakes(SledMachine):
    """Checks the brakes of a sled after every step."""

    @initialize(
        mass=st.floats(LIGHT, HEAVY),
        speed=st.sampled_from([0.0, 5.0, 15.0, 25.0]),
        timestep=st.sampled_from([0.005, 0.005, 0.002]),
        grip=st.sampled_from([None, None, 0.7, 0.15]),
        reservoirs=st.sampled_from([1.0, 1.0, 0.2]),
        compressor=st.sampled_from([1.0, 1.0, 0.0]),
    )
    def start(self, mass, speed, timestep, grip, reservoirs, compressor):
        self.volumes = reservoirs * np.array(BRAKE.reservoir_volume)
        self.displacement = compressor * BRAKE.compressor_displacement
        changes = {
            ("air_brake", "reservoir_volume"): " ".join(map(str, self.volumes)),
            ("air_brake", "compressor_displacement"): str(self.displacement),
        }
        sled = Sled(mass, speed=speed, timestep=timestep, grip=grip, changes=changes)
        self.begin(sled, mass)

    def begun(self):
        self.last = None
        self.recent = np.empty((0, len(RESERVOIRS)))
        self.without_air = 0.0
        self.most_work = 0.0

    @rule(times=st.integers(1, 12))
    def pump_the_brake_pedal(self, times):
        for _ in range(times):
            self.run(0.6, brake_pedal=1.0)
            self.run(0.4, brake_pedal=0.0)

    def check(self, rows, speeds):
        named = {name: self.column(rows, name) for name in self.columns}
        named["reservoirs"] = np.stack([named[name] for name in RESERVOIRS], axis=1)
        if self.last is None:
            self.last = {name: values[0] for name, values in named.items()}
        before = {
            name: np.vstack([self.last[name], named[name][:-1]])
            for name in ("reservoirs", "brake_pressures")
        }
        self.check_air(named, before)
        self.check_torques(named)
        self.check_springs(named)
        self.last = {name: values[-1] for name, values in named.items()}

    def check_air(self, named, before):
        h = self.sled.model.opt.timestep
        chambers, reservoirs = named["brake_pressures"], named["reservoirs"]
        assert reservoirs.min() >= 0.0
        assert reservoirs.max() <= BRAKE.governor_cut_out + SLACK
        assert chambers.min() >= 0.0
        assert chambers.max() <= BRAKE.pressure_max + SLACK
        # A chamber fills from a reservoir of higher pressure only: the highest one in the dead time
        # of the lines, which hold the pressure of that time while the reservoir empties.
        steps = round(DEAD_TIME / h) + 2
        known = np.vstack([self.recent, before["reservoirs"]])[-len(reservoirs) - steps :]
        self.recent = known[-steps:]
        known = np.vstack([known[:1]] * (len(reservoirs) + steps - len(known)) + [known])
        highest = sliding_window_view(known, steps + 1, axis=0).max(axis=-1)
        rising = chambers > before["brake_pressures"] + SLACK
        assert np.all((chambers <= highest[-len(chambers) :, CIRCUIT] + SLACK)[rising])
        # Only the compressor raises the pressure of a reservoir, by the air that it takes in.
        gained = (reservoirs - before["reservoirs"]) @ self.volumes
        speed = np.append(self.last["engine_speed"], named["engine_speed"][:-1])
        speed = np.maximum(speed, named["engine_speed"])
        delivered = h * ATMOSPHERE * self.displacement * speed
        assert np.all(gained <= delivered * (1.0 + 1e-6) + 1e-6)
        off = named["compressor_active"] == 0.0
        was_off = np.append(self.last["compressor_active"], named["compressor_active"][:-1]) == 0.0
        assert np.all((reservoirs <= before["reservoirs"])[off & was_off])
        # Chambers and reservoirs together never gain more air than that.
        volumes = np.repeat(axle_brakes("chamber_volume"), 2)
        stored = gained + (chambers - before["brake_pressures"]) @ volumes
        assert np.all(stored <= delivered * (1.0 + 1e-6) + 1e-3)

    def check_torques(self, named):
        torque, speed = named["brake_torques"], named["wheel_speeds"]
        turning = np.abs(speed) > TURNING
        assert np.all((torque * np.sign(speed))[turning] >= 0.0)
        # The work of the brakes rises, except for what elastic brakes can give back.
        work = np.append(self.most_work, named["brake_work"])
        given_back = np.maximum.accumulate(work) - work
        assert given_back.max() <= self.elastic_energy()
        self.most_work = work.max()
        if named["xbr_active"].any():
            assert self.controls["xbr_demand"] < 0.0
            assert self.controls["xbr_mode"] in (1, 2)

    def elastic_energy(self):
        """More than the greatest energy that the elastic brakes hold [J]."""
        inertias = np.repeat([axle.wheel_inertia_spin for axle in PARAMETERS.axles], 2)
        stiffness = np.minimum(BRAKE.stiffness, 0.4 * inertias / self.sled.model.opt.timestep**2)
        torque = np.repeat(axle_brakes("torque_per_pressure"), 2) * BRAKE.pressure_max
        return 1.3 * float(np.sum(0.5 * torque**2 / stiffness))

    def check_springs(self, named):
        """Without air the springs brake every wheel that has them, whatever the commands are."""
        h = self.sled.model.opt.timestep
        torque = named["brake_torques"] * np.sign(named["wheel_speeds"])
        turning = np.abs(named["wheel_speeds"]) > TURNING
        for air, turns, brake in zip(named["reservoirs"], turning, torque, strict=True):
            lost = air.max() <= BRAKE.spring_full_pressure
            self.without_air = self.without_air + h if lost else 0.0
            if self.without_air > SPRINGS_ON:
                sprung = turns & (CIRCUIT > 0)
                assert np.all(brake[sprung] > 0.99 * BRAKE.parking_torque)


def test_any_order_of_commands_keeps_air_and_brake_torque_within_physics():
    explore(Brakes, runs=15, rules=20)


@pytest.mark.slow
def test_many_orders_of_commands_keep_air_and_brake_torque_within_physics():
    explore(Brakes, runs=15, rules=40, factor=SLOW)
