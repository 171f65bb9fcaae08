"""Air brakes of trucks with other axles: without a trailer, with many axles, with a lifted one."""

import mujoco
import numpy as np
import pytest

import iits_mj  # registers the plugin
from iits_mj.core.units import GRAVITY
from iits_mj.model import air_brake
from iits_mj.parameters import TruckParameters

assert iits_mj.__version__
CONFIG = air_brake.config(TruckParameters.load(), 36_000.0)
PER_AXLE = (
    *("dead_time", "build_up_time_constant", "release_time_constant", "torque_per_pressure"),
    *("parking_torque", "wheel_radius", "chamber_volume"),
)
FRONT, DRIVE, TRAILER = range(3)
# Axles of today's truck from which each circuit's are copied.
LIKE = {FRONT: 0, DRIVE: 1, TRAILER: 3}
RADIUS = 0.5
ACTUATORS = ("xbr_demand", "xbr_mode", "parking_brake")
SENSORS = ("brake_pressures", "wheel_speeds", "abs_active", "brake_work", "brake_pressure_trailer")


class Vehicle:
    """A vehicle on one slide joint with axles of the given circuits, all equally loaded.

    Its tires have dry friction. Those of the `raised` axles do not touch the road; with `told`,
    the plugin knows that these axles are lifted.
    """

    def __init__(self, circuits, mass, *, raised=(), told=True, grip=0.9, speed=20.0, **changes):
        self.count = len(circuits)
        config = dict(CONFIG)
        for name in PER_AXLE:
            values = CONFIG[name].split()
            config[name] = " ".join(values[LIKE[circuit]] for circuit in circuits)
        config["wheel_radius"] = " ".join([str(RADIUS)] * self.count)
        config["circuit"] = " ".join(map(str, circuits))
        if raised and told:
            config["lifted"] = " ".join(str(int(k in raised)) for k in range(self.count))
        keys = "".join(f'<config key="{k}" value="{v}"/>' for k, v in (config | changes).items())
        load = mass * GRAVITY / (2 * (self.count - len(raised)))
        names = [f"axle{k}_{side}" for k in range(self.count) for side in ("left", "right")]
        wheels = "".join(
            f"""<body name="{name}_hub"><plugin plugin="iits.air_brake" instance="air_brake"/>
            <body><joint name="{name}" axis="0 1 0"/>
            <inertial pos="0 0 0" mass="1" diaginertia="15 15 15"/></body></body>"""
            for name in names
        )
        tires = "".join(
            f"""<fixed frictionloss="{grip * load}"><joint joint="slide" coef="1"/>
            <joint joint="{name}" coef="{-RADIUS}"/></fixed>"""
            for i, name in enumerate(names)
            if i // 2 not in raised
        )
        actuators = "".join(
            f'<plugin name="{n}" plugin="iits.air_brake" instance="air_brake" joint="slide"/>'
            for n in ACTUATORS
        )
        sensors = "".join(
            f'<plugin name="{n}" plugin="iits.air_brake" instance="air_brake"/>' for n in SENSORS
        )
        self.model = mujoco.MjModel.from_xml_string(f"""
        <mujoco>
          <option timestep="0.002" integrator="implicitfast"/>
          <extension><plugin plugin="iits.air_brake">
            <instance name="air_brake">{keys}</instance></plugin></extension>
          <worldbody><body name="sled"><joint name="slide" type="slide" axis="1 0 0"/>
            <inertial pos="0 0 0" mass="{mass - 2 * self.count}" diaginertia="1 1 1"/>{wheels}
          </body></worldbody>
          <tendon>{tires}</tendon><actuator>{actuators}</actuator><sensor>{sensors}</sensor>
        </mujoco>""")
        self.data = mujoco.MjData(self.model)
        self.data.qvel[0] = speed
        self.data.qvel[1:] = speed / RADIUS

    def brake(self, deceleration, seconds):
        """Returns speed [m/s] and ABS over the steps of a demand [m/s2]."""
        self.data.ctrl[:2] = -deceleration, 2
        rows = []
        for _ in range(round(seconds / 0.002)):
            mujoco.mj_step(self.model, self.data)
            rows.append((self.data.qvel[0], self["abs_active"][0]))
        return np.array(rows).T

    def __getitem__(self, sensor):
        return self.data.sensor(sensor).data

    @property
    def pressures(self):
        """Of each axle [Pa], shape (axles,)."""
        return self["brake_pressures"].reshape(-1, 2).mean(axis=1)


NO_TRAILER = {"reservoir_volume": "0.03 0.03 0"}
RIGID = [FRONT, DRIVE]
TRUCKS = {
    "4x2 tractor": (RIGID, 7_100, NO_TRAILER),
    "8x4 rigid truck": ([FRONT, FRONT, DRIVE, DRIVE], 32_000, NO_TRAILER),
    "4x2 with semitrailer": (RIGID + 3 * [TRAILER], 36_000, {}),
    "rigid truck with drawbar trailer": ([FRONT, DRIVE, DRIVE, TRAILER, TRAILER], 40_000, {}),
    "B-double": ([FRONT, DRIVE, DRIVE] + 6 * [TRAILER], 62_000, {}),
    "A-double": ([FRONT, DRIVE, DRIVE] + 8 * [TRAILER], 79_000, {}),
    "sixteen axles": ([FRONT, FRONT, DRIVE, DRIVE] + 12 * [TRAILER], 110_000, {}),
}


@pytest.mark.parametrize("name", TRUCKS)
def test_every_truck_reaches_the_demanded_deceleration(name):
    circuits, mass, changes = TRUCKS[name]
    vehicle = Vehicle(circuits, mass, **changes)
    speed, abs_active = vehicle.brake(2.0, 4.0)
    assert -np.diff(speed[1000:]).mean() / 0.002 == pytest.approx(2.0, rel=0.03)
    assert not abs_active.any()
    assert (vehicle.pressures > 30e3).all()
    assert np.isfinite(vehicle.data.plugin_state).all()


@pytest.mark.parametrize("name", TRUCKS)
def test_every_truck_stops_with_abs_on_a_slippery_road(name):
    circuits, mass, changes = TRUCKS[name]
    vehicle = Vehicle(circuits, mass, grip=0.25, speed=15.0, **changes)
    speed, abs_active = vehicle.brake(8.0, 4.0)
    assert abs_active.any()
    deceleration = -np.diff(speed[250:1500]).mean() / 0.002
    assert 0.8 * 0.25 * GRAVITY < deceleration < 1.02 * 0.25 * GRAVITY
    # The wheels keep turning.
    assert vehicle["wheel_speeds"].min() * RADIUS > 0.5 * speed[-1]


def test_both_front_axles_of_an_8x4_brake_alike():
    vehicle = Vehicle([FRONT, FRONT, DRIVE, DRIVE], 32_000, **NO_TRAILER)
    vehicle.brake(3.0, 3.0)
    assert vehicle.pressures[0] == vehicle.pressures[1]
    assert vehicle["brake_pressure_trailer"][0] == 0


def test_spring_brakes_of_a_truck_without_trailer_hold_and_release():
    vehicle = Vehicle(RIGID, 15_000, speed=0.0, **NO_TRAILER)
    vehicle.data.ctrl[2] = 1.0
    mujoco.mj_step(vehicle.model, vehicle.data, 1000)
    vehicle.data.ctrl[2] = 0.0
    mujoco.mj_step(vehicle.model, vehicle.data, 1000)
    assert np.isfinite(vehicle.data.plugin_state).all()
    vehicle.data.qvel[0] = 5.0
    vehicle.data.qvel[1:] = 5.0 / RADIUS
    mujoco.mj_step(vehicle.model, vehicle.data, 500)
    assert vehicle.data.qvel[0] == pytest.approx(5.0, rel=1e-3)


LIFTED = [FRONT, DRIVE, DRIVE]


def test_lifted_axle_stays_without_pressure_and_does_not_wake_abs():
    vehicle = Vehicle(LIFTED, 15_000, raised=(2,), **NO_TRAILER)
    speed, abs_active = vehicle.brake(3.0, 4.0)
    assert -np.diff(speed[1000:]).mean() / 0.002 == pytest.approx(3.0, rel=0.02)
    assert not abs_active.any()
    assert vehicle.pressures[2] == 0
    # It turns on in the air, as before the braking.
    assert vehicle["wheel_speeds"][-1] == pytest.approx(20.0 / RADIUS, rel=1e-6)
    # The monitor of the wheels' sensors does not mind: those numbers are the last of the state.
    assert not vehicle.data.plugin_state[-32:].any()


def test_axle_in_the_air_of_which_the_brakes_do_not_know_keeps_abs_active():
    vehicle = Vehicle(LIFTED, 15_000, raised=(2,), told=False, **NO_TRAILER)
    assert vehicle.brake(3.0, 4.0)[1][500:].any()


def test_lifted_axle_brakes_like_a_truck_without_it():
    lifted = Vehicle(LIFTED, 15_000, raised=(2,), **NO_TRAILER)
    absent = Vehicle(RIGID, 15_000, **NO_TRAILER)
    speeds = [vehicle.brake(3.0, 3.0)[0] for vehicle in (lifted, absent)]
    assert speeds[0] == pytest.approx(speeds[1], rel=2e-3)
    assert lifted.pressures[:2] == pytest.approx(absent.pressures, rel=1e-2)


@pytest.mark.parametrize(
    ("circuits", "changes", "message"),
    [
        (RIGID, {"reservoir_volume": "0.03 0 0.03"}, "reservoir_volume 0 of circuit 1, which has"),
        (17 * [FRONT], {}, "34 hub bodies reference it; allowed are 2 to 32"),
        (RIGID, {"lifted": "0"}, "'lifted' has 1 numbers; allowed are 2"),
    ],
)
def test_wrong_axles_are_refused(circuits, changes, message):
    with pytest.raises(ValueError, match="plugin instance") as error:
        Vehicle(circuits, 15_000, **changes)
    assert message in str(error.value)
