"""Failures of the truck's parts: what the truck does without them."""

import copy

import numpy as np
import pytest

import iits_mj
from iits_mj.core.errors import InputError
from iits_mj.core.messages import VehicleCommand, XbrMode
from iits_mj.road import Route
from iits_mj.simulation import DriveConfig, Simulation

STOP = {"xbr_demand": -4.0, "xbr_mode": XbrMode.MAXIMUM}
DRIVE = "tractor_axle2_left"
STEER = "tractor_axle1_left"


@pytest.fixture(scope="module")
def truck():
    return iits_mj.Truck.load(visuals=False)  # 55 t


def begin(truck, speed=22.0):
    truck.reset(speed=speed)
    truck.command(VehicleCommand())


def pressures(truck):
    """Of the chambers [bar], axle by axle."""
    return truck.sensor("brake_pressures").reshape(-1, 2) / 1e5


def test_a_fault_is_copied_and_ends_with_a_reset_or_repair(truck):
    begin(truck)
    clean = truck.data.plugin_state.copy()
    truck.faults.stick_speed_sensor(STEER, 30.0)
    truck.faults.leak("trailer")
    truck.faults.puncture(DRIVE)
    faulty = truck.data.plugin_state.copy()
    assert np.count_nonzero(faulty != clean) == 4
    twin = copy.deepcopy(truck)
    truck.step(200)
    twin.step(200)
    assert np.array_equal(twin.data.qpos, truck.data.qpos)
    assert twin.read("reservoir_pressure_trailer") < 5e5
    truck.data.plugin_state[:] = faulty
    truck.faults.clear()
    assert np.array_equal(truck.data.plugin_state, clean)
    begin(twin)
    assert np.array_equal(twin.data.plugin_state, clean)


@pytest.mark.parametrize(
    ("fail", "words"),
    [
        (lambda f: f.puncture("wheel"), "wheel 'wheel' is not known; use one of: tractor_axle1"),
        (lambda f: f.puncture(STEER, 1.5), "lost = 1.5: allowed is 0 to 1"),
        (lambda f: f.leak("rear"), "circuit 'rear' is not known; use one of: front, drive"),
        (lambda f: f.leak("front", float("nan")), "rate = nan 1/s: allowed is 0 to 100"),
        (lambda f: f.stick_speed_sensor(STEER, -1.0), "speed = -1.0 rad/s: allowed is 0 to"),
    ],
)
def test_an_impossible_fault_is_refused(truck, fail, words):
    with pytest.raises(InputError, match=words):
        fail(truck.faults)


@pytest.mark.parametrize("wheel", [STEER, DRIVE, "trailer_axle1_left"])
def test_abs_gives_up_a_broken_speed_sensor_and_the_wheel_brakes_again(truck, wheel):
    """A sensor that shows zero looks like a locked wheel, whose brake ABS releases."""
    begin(truck)
    row = truck.faults.wheels.index(wheel) // 2
    truck.faults.stick_speed_sensor(wheel)
    truck.command(**STOP)
    truck.step(750)
    assert pressures(truck)[row, 0] < 0.3  # released: a locked wheel and a broken wire look alike
    assert truck.report().abs_operational == 1.0
    truck.step(600)
    assert pressures(truck)[row, 0] == pytest.approx(pressures(truck)[5, 1], rel=0.2)
    assert truck.report().abs_operational == 0.0
    truck.step(2250)
    assert abs(truck.observe().speed) < 0.1
    assert truck.report().abs_operational == 0.0  # until the wheel is seen to turn


def test_a_sensor_that_shows_a_turning_wheel_does_not_release_its_brake(truck):
    begin(truck)
    truck.faults.stick_speed_sensor(STEER, 40.0)
    truck.command(**STOP)
    truck.step(500)
    assert pressures(truck)[0, 0] == pytest.approx(pressures(truck)[0, 1], rel=0.01)
    shown = 40.0 * truck.parameters.tires["steer"].rolling_radius
    assert truck.report().wheel_speeds[0] == pytest.approx(shown)


def test_wheels_that_abs_releases_on_ice_do_not_count_as_broken_sensors():
    road = Route.straight(friction=0.1)
    truck = iits_mj.Truck.load(visuals=False, route=road)
    begin(truck)
    truck.command(xbr_demand=-8.0, xbr_mode=XbrMode.MAXIMUM)
    for _ in range(60):
        truck.step(50)
        assert truck.report().abs_operational == 1.0


@pytest.mark.parametrize(("circuit", "rows"), [("front", [0]), ("drive", [1, 2])])
def test_the_other_circuits_stop_the_truck_when_one_has_lost_its_air(truck, circuit, rows):
    begin(truck)
    truck.faults.leak(circuit, 5.0)
    truck.step(500)
    truck.command(**STOP)
    truck.step(750)
    before = truck.observe().speed
    truck.step(1000)
    others = [row for row in range(6) if row not in rows]
    assert pressures(truck)[rows].max() < 0.1
    assert pressures(truck)[others].min() > 3.0
    deceleration = (before - truck.observe().speed) / 2.0
    assert 2.2 < deceleration < 4.0  # UN R13 wants 2.2 m/s2 of the secondary braking system
    # The spring brakes of the tractor stay released: one circuit holds them off.
    begin(truck)
    truck.faults.leak(circuit, 5.0)
    truck.step(1500)
    assert truck.observe().speed > 20.0


def test_the_spring_brakes_stop_a_tractor_that_has_lost_both_circuits(truck):
    begin(truck)
    truck.faults.leak("front")
    truck.faults.leak("drive")
    truck.step(9000)
    assert abs(truck.observe().speed) < 0.1


def test_a_torn_trailer_hose_stops_the_truck_by_the_trailers_spring_brakes(truck):
    begin(truck)
    truck.faults.leak("trailer")
    truck.step(1000)
    before = truck.observe().speed
    truck.step(1500)
    assert 1.5 < (before - truck.observe().speed) / 3.0 < 2.5
    truck.step(4000)
    assert abs(truck.observe().speed) < 0.1
    assert truck.read("reservoir_pressure_front") > 8e5  # the tractor keeps its air
    truck.command(accelerator_pedal=1.0)
    truck.step(1500)
    assert truck.observe().speed < 1.0  # at most it drags the braked trailer


def test_a_flat_steer_tire_sinks_drags_and_pulls_to_its_side(truck):
    loads = {}
    for lost in (0.0, 1.0):
        begin(truck)
        truck.faults.puncture(STEER, lost)
        truck.step(2500)
        ego = truck.observe()
        loads[lost] = truck.sensor("tractor_axle1_left_tire_force")[2]
        if lost:
            assert ego.offset > 1.0
            assert ego.z < -0.03
    assert 0.2 * loads[0.0] < loads[1.0] < 0.9 * loads[0.0]


def test_the_second_tire_of_a_twin_carries_the_load_of_a_flat_one(truck):
    begin(truck)
    truck.step(1000)
    load = truck.sensor("tractor_axle2_left_tire_force")[2]
    truck.faults.puncture(DRIVE)
    truck.step(1500)
    ego = truck.observe()
    assert truck.sensor("tractor_axle2_left_tire_force")[2] > 0.6 * load
    assert abs(ego.offset) < 0.2


def test_the_driving_stack_keeps_its_lane_with_a_flat_steer_tire():
    config = DriveConfig(
        traffic_mode="none",
        decision="keep",
        speed_planner="cruise",
        duration=30.0,
        start_speed=22.0,
        speed=22.0,
        start_station=900.0,
    )
    with Simulation(config, visuals=False) as simulation:
        while simulation.time < 5.0:
            simulation.cycle()
        simulation.truck.faults.puncture(STEER)
        lane = simulation.route.lane_offset(0, 1000.0)
        worst = 0.0
        while simulation.time < 20.0 and not simulation.ended:
            simulation.cycle()
            ego = simulation.frame.ego
            lane = float(simulation.route.lane_offset(0, ego.station))
            worst = max(worst, abs(ego.offset - lane))
        assert simulation.ended == ""
        assert worst < 0.6
