"""`Truck` as a user calls it: load, command, step, observe."""

import subprocess
import sys

import mujoco
import numpy as np
import pytest
from mujoco import rollout

import iits_mj
from iits_mj.core.errors import Error, InputError
from iits_mj.core.messages import XbrMode
from iits_mj.road import Route
from iits_mj.truck.truck import without_sensors

FULL = mujoco.mjtState.mjSTATE_FULLPHYSICS


@pytest.fixture(scope="module")
def truck():
    return iits_mj.Truck.load(payload=20_000, visuals=False)


def state(model, data):
    values = np.empty(mujoco.mj_stateSize(model, FULL))
    mujoco.mj_getState(model, data, values, FULL)
    return values


def controls(model, steps, rng):
    """Smooth random commands: pedal, brake phases, steering."""
    ctrl = np.zeros((steps, model.nu))
    ctrl[:, 0] = np.repeat(rng.uniform(0, 1, steps // 50), 50)
    ctrl[:, 1] = -np.repeat(rng.uniform(0, 3, steps // 100), 100)
    ctrl[:, 2] = np.repeat(rng.integers(0, 3, steps // 100), 100)
    ctrl[:, 3] = np.repeat(rng.uniform(-0.5, 0.5, steps // 50), 50)
    return ctrl


def test_truck_pulls_away_changes_up_and_stops(truck):
    truck.reset()
    truck.command(accelerator_pedal=0.6)
    gears = []
    for _ in range(150):
        truck.step(50)
        gears.append(truck.observe().gear)
    moving = truck.observe()
    assert moving.speed > 5.0
    assert gears[10] < max(gears)
    assert moving.fuel_used > 0.05
    truck.command(accelerator_pedal=0.0, xbr_demand=-2.0, xbr_mode=XbrMode.MAXIMUM)
    truck.step(4000)
    assert abs(truck.observe().speed) < 0.01


def test_observation_is_finite_and_at_the_reset_pose(truck):
    ego = truck.reset(station=100.0, offset=1.5, speed=12.0)
    assert (ego.station, ego.offset) == pytest.approx((100.0, 1.5), abs=1e-6)
    assert ego.speed == pytest.approx(12.0, abs=1e-6)
    assert ego.mass == 39_000
    values = [v for v in vars_of(ego) if isinstance(v, float)]
    assert np.isfinite(values).all()


@pytest.mark.parametrize("payload", [0.0, 36_000.0])
def test_truck_stands_in_equilibrium_after_a_reset(payload):
    truck = iits_mj.Truck.load(payload, visuals=False)
    truck.reset(station=250.0, offset=1.0)
    assert np.abs(truck.data.qacc).max() < 1e-5
    np.testing.assert_allclose(truck.data.qpos[2:], truck.model.qpos0[2:], atol=1e-12)


@pytest.mark.parametrize("grade", [-0.05, 0.08])
def test_units_stand_in_line_on_a_grade_after_a_reset(grade):
    truck = iits_mj.Truck.load(route=Route.straight(grade=grade), visuals=False)
    assert truck.observe().pitch == pytest.approx(-np.arctan(grade), abs=1e-9)
    np.testing.assert_allclose(truck.data.qpos[7:], truck.model.qpos0[7:], atol=1e-12)


def test_impossible_payload_height_is_refused_by_name():
    with pytest.raises(InputError, match="payload_height"):
        iits_mj.Truck.load(payload_height=0.5, visuals=False)


def vars_of(ego):
    return [getattr(ego, name) for name in ego.__dataclass_fields__]


def test_steering_left_yaws_left_and_the_trailer_follows(truck):
    truck.reset(speed=15.0)
    truck.command(steering_wheel_angle=0.5, xbr_demand=0.0, xbr_mode=XbrMode.OFF)
    truck.step(2000)
    ego = truck.observe()
    assert ego.yaw_rate > 0.02
    assert ego.trailer_yaw_rate == pytest.approx(ego.yaw_rate, rel=0.1)
    assert ego.articulation > 0


def test_two_runs_and_a_reset_are_bit_identical(truck):
    ctrl = controls(truck.model, 1000, np.random.default_rng(3))
    finals = []
    for _ in range(2):
        truck.reset(speed=10.0)
        for row in ctrl:
            truck.data.ctrl[:] = row
            truck.step()
        finals.append(state(truck.model, truck.data))
    np.testing.assert_array_equal(finals[0], finals[1])


def test_observing_does_not_change_the_motion(truck):
    finals = []
    for watch in (False, True):
        truck.reset(speed=10.0)
        truck.command(accelerator_pedal=0.3, steering_wheel_angle=0.3)
        for _ in range(200):
            truck.step()
            if watch:
                truck.observe()
        truck.observe()  # updates the plugins' uncommitted state in both runs
        finals.append(state(truck.model, truck.data))
    np.testing.assert_array_equal(finals[0], finals[1])


@pytest.mark.parametrize("threads", [0, 1, 2])
def test_threaded_rollout_equals_stepping_bit_for_bit(truck, threads):
    truck.reset(speed=10.0)
    model, initial = truck.model, state(truck.model, truck.data)
    ctrl = np.stack([controls(model, 500, np.random.default_rng(i)) for i in range(3)])
    with rollout.Rollout(nthread=threads) as pool:
        data = [mujoco.MjData(model) for _ in range(max(1, threads))]
        states, _ = pool.rollout(model, data, np.tile(initial, (3, 1)), ctrl)
    for i in range(3):
        single = mujoco.MjData(model)
        mujoco.mj_setState(model, single, initial, FULL)
        for row in ctrl[i]:
            single.ctrl[:] = row
            mujoco.mj_step(model, single)
        np.testing.assert_array_equal(state(model, single), states[i, -1])


def test_state_restored_in_the_middle_continues_bit_for_bit(truck):
    model = truck.model
    ctrl = controls(model, 1000, np.random.default_rng(5))
    truck.reset(speed=10.0)
    for row in ctrl[:400]:
        truck.data.ctrl[:] = row
        truck.step()
    middle = state(model, truck.data)
    other = mujoco.MjData(model)
    mujoco.mj_setState(model, other, middle, FULL)
    copied = mujoco.MjData(model)
    mujoco.mj_copyData(copied, model, truck.data)
    for data in (truck.data, other, copied):
        for row in ctrl[400:]:
            data.ctrl[:] = row
            mujoco.mj_step(model, data)
    final = state(model, truck.data)
    np.testing.assert_array_equal(final, state(model, other))
    np.testing.assert_array_equal(final, state(model, copied))


def test_a_second_forward_evaluation_changes_nothing(truck):
    truck.reset(speed=10.0)
    truck.command(accelerator_pedal=0.5, xbr_demand=-1.0, xbr_mode=XbrMode.ADDITION)
    truck.step(100)
    mujoco.mj_forward(truck.model, truck.data)
    before = state(truck.model, truck.data), truck.data.qacc.copy()
    mujoco.mj_forward(truck.model, truck.data)
    np.testing.assert_array_equal(before[0], state(truck.model, truck.data))
    np.testing.assert_array_equal(before[1], truck.data.qacc)


@pytest.mark.parametrize("payload", [0.0, 36_000.0])
def test_truck_starts_stops_holds_and_restarts_on_a_5_percent_grade(payload):
    truck = iits_mj.Truck.load(payload, route=Route.straight(grade=0.05), visuals=False)
    truck.reset(station=100.0)
    truck.command(xbr_demand=-2.0, xbr_mode=XbrMode.MAXIMUM)
    truck.step(2500)
    held = truck.observe().station
    truck.step(5000)
    assert truck.observe().station == pytest.approx(held, abs=1e-3), "the truck creeps"
    for _ in range(2):
        lowest = start = truck.observe().station
        truck.command(accelerator_pedal=0.7)
        for k in range(100):
            if k == 5:  # hill start: the brake is released once the clutch engages
                truck.command(xbr_demand=0.0, xbr_mode=XbrMode.OFF)
            truck.step(50)
            lowest = min(lowest, truck.observe().station)
        ego = truck.observe()
        assert ego.speed > 1.5
        assert lowest > start - 0.3, "the truck rolls back"
        truck.command(accelerator_pedal=0.0, xbr_demand=-2.0, xbr_mode=XbrMode.MAXIMUM)
        truck.step(2500)
        held = truck.observe().station
        truck.step(5000)
        assert truck.observe().station == pytest.approx(held, abs=1e-3), "the truck creeps"
    assert not truck.data.warning.number.any()


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("accelerator_pedal", 1.5),
        ("xbr_demand", 1.0),
        ("steering_wheel_angle", float("nan")),
        ("horn", 1.0),
    ],
)
def test_wrong_command_is_refused_and_named(truck, field, value):
    with pytest.raises(InputError, match=field):
        truck.command(**{field: value})


def test_divergence_is_reported_with_its_time(truck):
    truck.reset(speed=20.0)
    truck.step(500)
    truck.data.qvel[0] = 1e20
    with pytest.raises(Error, match=rf"diverged at t = {500 * truck.model.opt.timestep:.3f} s"):
        truck.step()
    truck.reset(speed=20.0)
    truck.step()


def test_wrong_time_step_is_refused():
    with pytest.raises(InputError, match="timestep"):
        iits_mj.Truck.load(timestep=0.1, visuals=False)


def test_overlay_of_parameters_changes_the_truck():
    overlay = {"aerodynamics": {"drag_area": 0.0}, "tires": {"*": {"rolling_resistance": 0.0}}}
    truck = iits_mj.Truck.load(parameters=overlay, visuals=False)
    truck.reset(speed=20.0)
    truck.command(transmission_mode=1)
    truck.step(1000)
    assert truck.observe().speed == pytest.approx(20.0, abs=0.02)


def test_importing_the_package_loads_no_heavy_library():
    code = (
        "import sys, iits_mj;"
        "heavy = {'libsumo', 'torch', 'casadi', 'matplotlib', 'scipy', 'dm_control'};"
        "heavy &= set(sys.modules);"
        "print(sorted(heavy)); sys.exit(bool(heavy))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.parametrize("payload", [0.0, 20_000.0, 36_000.0])
def test_trailer_accelerometer_sits_at_the_center_of_gravity_of_trailer_and_load(payload):
    truck = iits_mj.Truck.load(payload, visuals=False)
    model, data = truck.model, truck.data
    on_trailer = [
        body
        for body in range(model.nbody)
        if model.body(body).name.startswith("trailer") or model.body(body).name == "payload"
    ]
    center = np.average(data.xipos[on_trailer], axis=0, weights=model.body_mass[on_trailer])
    np.testing.assert_allclose(data.site("trailer_cg").xpos, center, atol=0.01)


@pytest.mark.parametrize(
    ("place", "words"),
    [
        ({"station": 1e300}, r"reset: station = 1e\+300 m: allowed is -1e\+06 to 1e\+06 m"),
        ({"station": None}, "reset: station = None m: allowed is"),
        ({"offset": float("nan")}, "reset: offset = nan m: allowed is -1000 to 1000 m"),
        ({"speed": -1.0}, "reset: speed = -1.0 m/s: allowed is 0 to 60 m/s"),
        ({"heading": 1e300}, "heading = 1e\\+300 rad: allowed is -3.14159 to 3.14159 rad"),
        ({"articulation": 9}, "articulation = 9 rad: allowed is -1.5708 to 1.5708 rad"),
    ],
)
def test_an_impossible_place_is_refused_and_the_truck_stays(truck, place, words):
    truck.reset(speed=10.0)
    before = state(truck.model, truck.data)
    with pytest.raises(InputError, match=words):
        truck.reset(**place)
    assert np.array_equal(state(truck.model, truck.data), before)


def test_any_number_in_the_plugins_state_leaves_the_process_alive():
    """A slot of the brake lines or a gear out of range was an index into memory."""
    script = """
import mujoco, iits_mj
import numpy as np
mujoco.set_mju_user_warning(lambda _text: None)
truck = iits_mj.Truck.load(0.0, visuals=False)
model, data = truck.model, truck.data
truck.reset(speed=15.0)
kind = mujoco.mjtState.mjSTATE_INTEGRATION
begin = np.empty(mujoco.mj_stateSize(model, kind))
mujoco.mj_getState(model, data, begin, kind)
for number in (3.7e6, -3.7e6, np.nan):
    for place in range(data.plugin_state.size):
        mujoco.mj_setState(model, data, begin, kind)
        data.plugin_state[place] = number
        mujoco.mj_step(model, data, 2)
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, check=False)
    assert done.returncode == 0, done.stderr.decode()


@pytest.mark.parametrize(
    ("overlay", "words"),
    [
        ({"units": {"trailer": {"length": 1e18}}}, r"units.trailer.length = .*: more than 1e\+09"),
        ({"units": {"trailer": {"length": 1e8}}}, "trailer.length = .*allowed is 1e-09 to 100 m"),
        (
            {"units": {"trailer": {"payload": {"cg_position": 1e308}}}},
            "payload.cg_position = 1e\\+308: more than",
        ),
        ({"tires": {"steer": {"count": 0}}}, "tires.steer.count = 0: allowed is 1 to 4"),
        ({"steering": {"knuckle_inertia": 1e-320}}, "no truck can be built .*armature"),
    ],
)
def test_no_truck_is_built_from_absurd_parameters(overlay, words):
    with pytest.raises(InputError, match=words):
        iits_mj.Truck.load(0.0, parameters=overlay, visuals=False)


def test_steps_without_sensors_move_the_truck_alike_and_leave_the_readings():
    trucks = [iits_mj.Truck.load(visuals=False) for _ in range(2)]
    for truck in trucks:
        truck.reset(speed=15.0)
    plain, quiet = trucks
    before = quiet.data.sensordata.copy()
    with without_sensors(quiet.model):
        mujoco.mj_step(quiet.model, quiet.data, 50)
    np.testing.assert_array_equal(quiet.data.sensordata, before)
    mujoco.mj_step(plain.model, plain.data, 50)
    assert quiet.observe() == plain.observe()
    np.testing.assert_array_equal(quiet.data.plugin_state, plain.data.plugin_state)


def test_a_truck_that_touches_nothing_moves_alike_without_collision_detection():
    trucks = [iits_mj.Truck.load(visuals=False) for _ in range(2)]
    for truck, detects in zip(trucks, (True, False), strict=True):
        truck.reset(speed=15.0)
        truck.detects_contacts = detects
        truck.step(50)
    plain, quiet = trucks
    assert quiet.observe() == plain.observe()
    np.testing.assert_array_equal(quiet.data.plugin_state, plain.data.plugin_state)
    assert quiet.model.opt.disableflags == 0


def test_a_callback_gets_its_sensors_in_every_step():
    truck = iits_mj.Truck.load(visuals=False)
    mujoco.set_mjcb_control(lambda model, data: None)
    try:
        with without_sensors(truck.model):
            assert truck.model.opt.disableflags == 0
    finally:
        mujoco.set_mjcb_control(None)
