"""The planar plants: physical facts, and agreement with MuJoCo's bodies."""

import copy
import pickle

import numpy as np
import pytest

from iits_mj import suite
from iits_mj.analytic import Kinematic, YawPlane
from iits_mj.core.errors import InputError
from iits_mj.core.messages import TransmissionMode
from iits_mj.core.timing import DYNAMIC_PLANTS, PLANTS
from iits_mj.parameters import TruckParameters, shipped_trucks
from iits_mj.road import RoadMap, Route
from iits_mj.road.design import Design
from iits_mj.truck import Truck
from iits_mj.truck.placement import TruckPlacement
from iits_mj.truck.rollouts import Scenario, roll_out

PLANAR = PLANTS[1:]
SLIPPING = DYNAMIC_PLANTS[1:]
STEP = 0.005


def load(plant, payload=36_000.0, **settings):
    return Truck.load(payload, plant=plant, timestep=STEP, visuals=False, **settings)


@pytest.fixture(scope="module", params=PLANAR)
def truck(request):
    return load(request.param)


def drive(truck, steps=400):
    """A bend with braking; all bits of the state and the sensors."""
    truck.reset(speed=20.0)
    truck.command(accelerator_pedal=0.5, steering_wheel_angle=0.5)
    truck.step(steps)
    truck.command(brake_pedal=0.3, steering_wheel_angle=0.5)
    truck.step(steps)
    truck.observe()
    data = truck.data
    return b"".join(
        part.tobytes() for part in (data.qpos, data.qvel, data.plugin_state, data.sensordata)
    )


def test_a_drive_repeats_bit_for_bit(truck):
    assert drive(truck) == drive(truck)


def test_neither_the_size_of_a_call_nor_an_observation_changes_later_bits(truck):
    whole = drive(truck, 200)
    truck.reset(speed=20.0)
    for command in ({"accelerator_pedal": 0.5}, {"accelerator_pedal": 0.0, "brake_pedal": 0.3}):
        truck.command(steering_wheel_angle=0.5, **command)
        for _ in range(50):
            truck.step(3)
            truck.observe()
            truck.step()
    truck.command(accelerator_pedal=0.0)
    state = truck.observe()
    again = truck.data.qpos.copy()
    truck.reset(speed=20.0)
    truck.command(accelerator_pedal=0.5, steering_wheel_angle=0.5)
    truck.step(200)
    truck.command(accelerator_pedal=0.0, brake_pedal=0.3, steering_wheel_angle=0.5)
    truck.step(200)
    np.testing.assert_array_equal(again, truck.data.qpos)
    assert state == truck.observe()
    assert whole  # the same drive with the pedal still down is another one


def test_copies_continue_to_the_bit(truck):
    truck.reset(speed=18.0)
    truck.command(accelerator_pedal=0.6, steering_wheel_angle=0.4)
    truck.step(300)
    twins = [copy.deepcopy(truck), pickle.loads(pickle.dumps(truck))]
    truck.step(200)
    for twin in twins:
        twin.step(200)
        np.testing.assert_array_equal(twin.data.qpos, truck.data.qpos)
        np.testing.assert_array_equal(twin.data.plugin_state, truck.data.plugin_state)


@pytest.mark.parametrize("plant", PLANAR)
def test_roll_outs_on_threads_equal_the_drive_of_one_truck(plant):
    road = RoadMap.builtin().route()
    scenarios = [
        Scenario(route=road, place=TruckPlacement(station=100.0 + 40.0 * k, speed=15.0))
        for k in range(5)
    ]
    controls = {"accelerator_pedal": 0.4, "steering_wheel_angle": [[0.02 * k] for k in range(5)]}
    settings = {"duration": 2.0, "plant": plant, "timestep": STEP}
    one, two = (roll_out(scenarios, controls, threads=n, **settings) for n in (1, 2))
    truck = load(plant, route=road)
    truck.reset(station=100.0 + 40.0 * 3, speed=15.0)
    truck.command(accelerator_pedal=0.4, steering_wheel_angle=0.06)
    truck.step(400)
    truck.observe()
    for name, values in one.values.items():
        np.testing.assert_array_equal(values, two[name])
        np.testing.assert_array_equal(np.squeeze(truck.sensor(name)), values[3, -1])


@pytest.mark.parametrize("plant", PLANTS)
def test_the_laden_truck_holds_on_a_12_percent_grade_and_starts_on_6(plant):
    truck = load(plant, route=Route.straight(grade=0.12))
    truck.reset(station=100.0)
    truck.command(parking_brake=1.0)
    truck.step(2000)
    parked = truck.observe()
    truck.step(2000)
    assert truck.observe().station == pytest.approx(parked.station, abs=1e-4)
    truck = load(plant, route=Route.straight(grade=0.06))
    truck.reset(station=100.0)
    truck.command(accelerator_pedal=1.0)
    truck.step(2000)
    assert truck.observe().speed > 1.0


@pytest.mark.parametrize("plant", PLANAR)
def test_a_truck_that_stops_on_a_level_road_stands(plant):
    truck = load(plant)
    truck.reset(speed=10.0)
    truck.command(brake_pedal=0.4)
    truck.step(3000)
    stopped = truck.observe()
    assert abs(stopped.speed) < 1e-2
    truck.step(1000)
    assert truck.observe().x == pytest.approx(stopped.x, abs=2e-2)


@pytest.mark.parametrize("plant", PLANAR)
@pytest.mark.parametrize("payload", [0.0, 36_000.0])
def test_a_full_stop_is_as_long_as_the_full_trucks(plant, payload):
    distances = []
    for kind in ("full", plant):
        truck = load(kind, payload)
        start = truck.reset(speed=22.0).x
        truck.command(brake_pedal=0.8)
        while truck.observe().speed > 0.1:
            truck.step(10)
        distances.append(truck.observe().x - start)
    assert distances[1] == pytest.approx(distances[0], rel=0.02)


@pytest.mark.parametrize("plant", PLANAR)
def test_a_slippery_road_lengthens_a_stop(plant):
    stops = []
    for friction in (0.8, 0.3):
        truck = load(plant, 0.0, route=Route.straight(friction=friction))
        start = truck.reset(station=50.0, speed=15.0).x
        truck.command(brake_pedal=1.0)
        truck.step(2000)
        stops.append(truck.observe().x - start)
    assert stops[1] > 1.8 * stops[0]


@pytest.mark.parametrize("plant", SLIPPING)
def test_small_steady_steering_turns_as_the_linear_model(plant):
    parameters = {
        "units": {"trailer": {"coupling": {"yaw_friction": 0.0}}},
        "steering": {"dead_band": 0.0},
    }
    truck = load(plant, parameters=parameters)
    speed = truck.reset(speed=18.0).speed
    truck.command(accelerator_pedal=0.35, steering_wheel_angle=0.05)
    truck.step(1200)
    state = truck.observe()
    model = YawPlane.from_parameters(truck.parameters, truck.payload, cruise_speed=speed)
    gain = model.at(state.speed).steady_state()[1]
    assert state.yaw_rate / state.road_wheel_angle == pytest.approx(gain, rel=0.03)


@pytest.mark.parametrize("name", shipped_trucks())
@pytest.mark.parametrize("share", [0.0, 1.0])
@pytest.mark.parametrize("plant", SLIPPING)
def test_every_truck_turns_and_burns_as_its_bodies_do(name, share, plant):
    payload = share * TruckParameters.load(name).payload_max

    def turn(plant):
        truck = load(plant, payload, truck=name)
        truck.reset(speed=20.0)
        truck.command(accelerator_pedal=0.4)
        truck.step(600)
        truck.command(steering_wheel_angle=0.35)
        truck.step(800)
        return truck.observe()

    planar, full = turn(plant), turn("full")
    assert planar.speed == pytest.approx(full.speed, rel=1e-3)
    assert planar.yaw_rate == pytest.approx(full.yaw_rate, rel=0.02)
    angles = [full.articulation, *full.rear_articulations]
    assert [planar.articulation, *planar.rear_articulations] == pytest.approx(angles, rel=0.02)
    assert planar.fuel_used == pytest.approx(full.fuel_used, rel=5e-3)


@pytest.fixture(scope="module")
def bend():
    """A left bend of 200 m radius that climbs by 5 % and leans inward by 0.04 rad."""
    design = Design(
        name="bend",
        alignment=((900.0, 5e-3, 5e-3, 0.04, 0.04),),
        start=(10.0, 20.0, 3.0, 0.4),
        initial_grade=0.05,
    )
    return design.route()


@pytest.mark.parametrize("flat", [None, "tractor_axle1_left"])
@pytest.mark.parametrize("wind", [(0.0, 0.0, 0.0), (9.0, 12.0, 0.0)])
@pytest.mark.parametrize("name", ["tractor_semitrailer_6x4", "a_double"])
def test_pose_and_wheel_loads_on_a_tilted_climbing_bend_are_those_of_the_bodies(
    name, wind, flat, bend
):
    trucks = {}
    for plant in DYNAMIC_PLANTS:
        truck = trucks[plant] = load(plant, truck=name, route=bend)
        truck.reset(station=150.0, speed=14.0)
        truck.model.opt.wind[:] = wind
        truck.command(accelerator_pedal=0.5, steering_wheel_angle=1.0)
        if flat is not None:
            truck.faults.puncture(flat, 0.5)
        truck.step(600)
        truck.observe()
    full = trucks.pop("full")
    for plant, truck in trucks.items():
        # Without the roll of the bodies, the pose and its accelerations are those of the road.
        rolls = plant == "yaw-roll"
        for unit in truck.parameters.units:
            planar, body = (one.data.body(unit.name) for one in (truck, full))
            np.testing.assert_allclose(planar.xpos, body.xpos, atol=0.06)
            turn = body.xmat.reshape(3, 3).T @ planar.xmat.reshape(3, 3)
            rotation = [turn[2, 1], turn[0, 2], turn[1, 0]]
            np.testing.assert_array_less(np.abs(rotation), [6e-3 if rolls else 0.05, 6e-3, 4e-3])
        for wheel in (f"{a.name}_{s}" for a in truck.parameters.axles for s in ("left", "right")):
            forces = [one.sensor(f"{wheel}_tire_force") for one in (truck, full)]
            # The plant does not move the load that a flat tire gives to its neighbors.
            np.testing.assert_allclose(*forces, atol=1600.0 if flat is None else 4000.0)
        accelerations = [one.sensor("tractor_acceleration") for one in (truck, full)]
        np.testing.assert_allclose(*accelerations, atol=0.08 if rolls else 0.35)


def test_a_truck_rolls_down_a_steep_slope_as_its_bodies_do():
    design = Design(
        name="slope",
        alignment=((600.0, 0.0, 0.0, 0.0, 0.0),),
        start=(0.0, 0.0, 100.0, 0.9),
        initial_grade=-0.3,
    )
    road = design.route()
    speeds, stations, loads = [], [], []
    for plant in PLANTS:
        truck = load(plant, route=road)
        truck.reset(station=100.0, speed=1.0)
        truck.command(transmission_mode=float(TransmissionMode.NEUTRAL))
        truck.step(800)
        state = truck.observe()
        speeds.append(state.speed)
        stations.append(state.station)
        loads.append(truck.report().axle_loads)
    assert speeds[0] > 11.0
    np.testing.assert_allclose(speeds[1:], speeds[0], rtol=2e-3)
    np.testing.assert_allclose(stations[1:], stations[0], atol=0.1)
    np.testing.assert_allclose(loads[1:], [loads[0]] * 3, atol=1500.0)


@pytest.mark.parametrize("plant", PLANAR)
def test_accelerations_are_the_change_of_the_velocities(plant, bend):
    truck = load(plant, truck="a_double", route=bend)
    truck.reset(station=150.0, speed=14.0)
    truck.command(brake_pedal=0.2, steering_wheel_angle=2.0)
    truck.step(150)
    truck.observe()
    before, expected = truck.data.qvel.copy(), truck.data.qacc.copy()
    truck.step(1)
    change = (truck.data.qvel - before) / STEP
    hinges = [
        f"{name}_{part}" for name in truck.parameters.coupling_names for part in ("yaw", "roll")
    ]
    lead = int(truck.model.joint("tractor_free").dofadr[0])
    dofs = [lead, lead + 1, lead + 5, *(int(truck.model.joint(h).dofadr[0]) for h in hinges)]
    np.testing.assert_allclose(change[dofs], expected[dofs], atol=0.03)
    assert np.abs(expected[dofs]).max() > 0.3


@pytest.mark.parametrize("plant", PLANAR)
def test_a_state_that_is_read_from_the_joints_again_shows_the_same_pose(plant, bend):
    truck = load(plant, truck="a_double", route=bend)
    truck.reset(station=150.0, speed=14.0)
    truck.command(steering_wheel_angle=2.0)
    truck.step(300)
    truck.observe()
    positions, velocities = truck.data.qpos.copy(), truck.data.qvel.copy()
    truck.data.qvel[0] = np.nextafter(truck.data.qvel[0], np.inf)
    truck.observe()
    np.testing.assert_allclose(truck.data.qpos, positions, atol=2e-3)
    np.testing.assert_allclose(truck.data.qvel, velocities, atol=2e-3)


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize("plant", SLIPPING)
def test_a_coupling_holds_at_its_stop(plant, side):
    limit = 0.3
    parameters = {"units": {"trailer": {"coupling": {"yaw_limit": limit}}}}
    truck = load(plant, 0.0, parameters=parameters)
    truck.reset(speed=5.0)
    truck.command(steering_wheel_angle=12.0 * side, accelerator_pedal=0.3)
    truck.step(400)
    angles, rates = [], []
    for _ in range(60):
        truck.step(10)
        angles.append(side * truck.observe().articulation)
        rates.append(truck.read("articulation_rate"))
    assert truck.left_range == ("a coupling has reached its stop in yaw",)
    assert limit < min(angles)
    assert max(angles) < limit + 0.06
    assert np.abs(rates).max() < 0.02


@pytest.mark.parametrize("plant", SLIPPING)
def test_load_moves_forward_when_braking_and_outward_in_a_bend(plant):
    truck = load(plant)
    truck.reset(speed=20.0)
    truck.command(accelerator_pedal=0.3)
    truck.step(200)
    truck.observe()
    axles = truck.report().axle_loads
    weight = truck.parameters.gross_mass(truck.payload) * 9.81
    assert sum(axles) == pytest.approx(weight, rel=3e-3)
    truck.command(accelerator_pedal=0.0, brake_pedal=0.4, steering_wheel_angle=0.4)
    truck.step(300)
    truck.observe()
    braked = truck.report().axle_loads
    assert braked[0] > 1.1 * axles[0]
    assert sum(braked) == pytest.approx(weight, rel=3e-3)
    left = truck.sensor("trailer_axle1_left_tire_force")[2]
    right = truck.sensor("trailer_axle1_right_tire_force")[2]
    assert right > 1.2 * left


@pytest.mark.parametrize("plant", PLANAR)
def test_the_truck_lies_on_its_road(plant):
    road = RoadMap.builtin().route()
    truck = load(plant, route=road)
    for station in (500.0, 3000.0):
        truck.reset(station=station, speed=15.0)
        truck.step(100)
        state = truck.observe()
        point = road.evaluate(state.station, state.offset)
        assert state.z == pytest.approx(float(point.z), abs=0.02)
        assert -np.tan(state.pitch) == pytest.approx(float(point.grade), abs=0.01)


def test_a_change_of_velocities_from_outside_counts(truck):
    truck.reset(speed=20.0)
    truck.step(10)
    truck.data.qvel[0] = 5.0
    assert truck.observe().speed == pytest.approx(5.0, abs=0.05)


@pytest.mark.parametrize("plant", SLIPPING)
def test_leaving_the_valid_range_is_reported(plant):
    truck = load(plant)
    truck.reset(speed=22.0)
    truck.step(100)
    assert truck.left_range == ()
    truck.command(steering_wheel_angle=3.0)
    truck.step(800)
    assert "a wheel has lifted off the road" in truck.left_range
    truck.reset(speed=10.0)
    assert truck.left_range == ()


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_truck_that_tips_over_has_no_load_below_zero_and_rolls_on(side):
    truck = load("yaw-roll")
    truck.reset(speed=22.0)
    truck.command(steering_wheel_angle=3.0 * side)
    least, roll = [], 0.0
    for _ in range(50):
        truck.step(10)
        roll = max(roll, -side * truck.observe().roll)
        axles = truck.parameters.axles
        wheels = [f"{axle.name}_{end}_tire_force" for axle in axles for end in ("left", "right")]
        least.append(min(truck.read(wheel, 2) for wheel in wheels))
    assert -1e-6 <= min(least) < 1.0
    assert roll > 0.3
    assert "a unit rolls by more than 0.17 rad" in truck.left_range


@pytest.mark.parametrize("name", ["rigid_drawbar", "tractor_semitrailer_6x2"])
def test_a_lifted_axle_is_within_the_valid_range(name):
    truck = load("yaw-roll", 0.0, truck=name)
    truck.reset(speed=15.0)
    truck.step(200)
    assert truck.left_range == ()


def test_a_sharp_crest_leaves_the_valid_range():
    # The grade turns by 8 % within 40 m: at 24 m/s the road falls away with 1.15 m/s2.
    limit = "a crest or dip of the road changes the loads by more than a tenth"
    for change, length, left in ((-0.08, 40.0, (limit,)), (-0.08, 160.0, ())):
        design = Design(
            name="crest",
            alignment=((600.0, 0.0, 0.0, 0.0, 0.0),),
            initial_grade=0.04,
            grades=((300.0, 0.04 + change, length),),
        )
        truck = load("yaw-sideslip", route=design.route())
        truck.reset(station=250.0, speed=25.0)
        truck.step(800)
        assert truck.observe().station > 330.0
        assert truck.left_range == left


def test_roll_outs_tell_which_drive_left_the_valid_range():
    drives = roll_out(
        [Scenario(route=Route.straight(), place=TruckPlacement(speed=22.0))] * 2,
        {"steering_wheel_angle": [[0.0], [3.0]]},
        duration=4.0,
        plant="yaw-sideslip",
        timestep=STEP,
    )
    assert drives.left_range[0] == ()
    assert "a wheel has lifted off the road" in drives.left_range[1]
    full = roll_out([Scenario(route=Route.straight())], {}, duration=0.1)
    assert full.left_range == [()]


@pytest.mark.parametrize("name", ["tractor_semitrailer_6x4", "b_double", "rigid_drawbar"])
def test_the_kinematic_plant_follows_the_kinematic_model(name):
    truck = load("kinematic", None, truck=name)
    truck.reset(speed=4.0)
    model = Kinematic.from_parameters(truck.parameters, truck.payload)
    steps, rows = 5, []
    for n in range(800):
        truck.command(accelerator_pedal=0.2, steering_wheel_angle=4.0 * np.sin(2 * np.pi * n / 400))
        truck.step(steps)
        state = truck.observe()
        hinges = np.array([state.articulation, *state.rear_articulations])
        rows.append((state.yaw_rate, state.road_wheel_angle, state.speed, *hinges))
    rate, steer, speed, *hinges = np.array(rows).T
    time = steps * STEP * np.arange(len(rows))
    # The speed of the plant is that of the first axle; the model's, of the fixed axles.
    expected = model.simulate(time, speed, steer)
    np.testing.assert_allclose(rate, speed * np.tan(steer) / model.L, atol=4e-3)
    headings = -np.cumsum(hinges, axis=0).T
    assert np.abs(headings).max() > 0.25
    np.testing.assert_allclose(headings, expected[:, 4:], atol=0.02)


def test_a_kinematic_truck_loses_less_speed_in_bends_than_one_that_slips():
    speeds = {}
    for plant, steering in (("kinematic", 0.0), ("kinematic", 8.0), ("yaw-sideslip", 8.0)):
        truck = load(plant)
        truck.reset(speed=8.0)
        truck.command(transmission_mode=float(TransmissionMode.NEUTRAL))
        for turn in (1.0, -1.0, 0.0):
            truck.command(steering_wheel_angle=turn * steering)
            truck.step(600)
        speeds[plant, steering] = truck.observe().speed
    straight, bends, slipping = speeds.values()
    # The axles of a group have no common center of turn, so their tires scrub in any case.
    assert slipping < bends < straight


def test_a_kinematic_truck_that_turns_fast_leaves_the_valid_range():
    truck = load("kinematic")
    for speed, left in ((8.0, ()), (20.0, ("a unit without slip turns with more than 2 m/s2",))):
        truck.reset(speed=speed)
        truck.command(accelerator_pedal=0.2, steering_wheel_angle=1.0)
        truck.step(600)
        assert truck.left_range == left


def test_the_full_plant_has_no_limits():
    assert load("full").left_range == ()


def test_an_unknown_plant_is_refused():
    with pytest.raises(
        InputError, match=r"plant 'bicycle'.*full, yaw-roll, yaw-sideslip, kinematic"
    ):
        load("bicycle")


@pytest.mark.parametrize("plant", PLANAR)
def test_the_suite_runs_with_a_planar_plant(plant):
    environment = suite.load("truck", "lane_keep", {"plant": plant, "random": 1})
    environment.reset()
    speed = environment.physics.speed()
    for _ in range(5):
        environment.step(np.zeros(environment.action_spec().shape))
    assert environment.physics.truck.plant == plant
    assert environment.physics.speed() == pytest.approx(speed, abs=1.0)
