"""The steering plugin on the truck: ratio, play, Ackermann geometry, rate limit."""

import mujoco
import numpy as np
import pytest

from iits_mj.core.errors import InputError
from iits_mj.road import Route
from iits_mj.truck import Truck


@pytest.fixture(scope="module")
def truck():
    return Truck.load(visuals=False)


def road_wheels(truck):
    return np.array([truck.sensor(f"steer_angle_{side}")[0] for side in ("left", "right")])


def turn(truck, degrees, seconds=2.0, speed=0.0):
    truck.reset(speed=speed)
    truck.command(steering_wheel_angle=np.radians(degrees))
    truck.step(round(seconds / truck.model.opt.timestep))
    truck.observe()
    return road_wheels(truck)


def test_road_wheels_turn_by_the_ratio_less_half_the_play(truck):
    steering = truck.parameters.steering
    angles = turn(truck, 90, speed=2.0)
    expected = (np.radians(90) - 0.5 * steering.dead_band) / steering.ratio
    assert angles.mean() == pytest.approx(expected, rel=0.02)


@pytest.mark.parametrize("sign", [1, -1])
def test_inner_wheel_turns_more_by_ackermann_geometry(truck, sign):
    left, right = sign * turn(truck, sign * 700, seconds=4.0, speed=2.0)[:: 1 if sign > 0 else -1]
    wheelbase, track = 3.9, truck.parameters.lead.axles[0].track
    assert 1 / np.tan(right) - 1 / np.tan(left) == pytest.approx(track / wheelbase, rel=0.05)


def test_reversal_within_the_play_does_not_move_the_road_wheels(truck):
    turn(truck, 90, speed=2.0)
    before = road_wheels(truck)
    truck.command(steering_wheel_angle=np.radians(88.5))
    truck.step(500)
    truck.observe()
    np.testing.assert_allclose(road_wheels(truck), before, atol=3e-5)


def test_steering_wheel_turns_no_faster_than_its_actuator(truck):
    truck.reset()
    truck.command(steering_wheel_angle=6.0)
    positions = []
    for _ in range(100):
        truck.step(5)
        positions.append(truck.observe().steering_wheel_angle)
    rate = np.diff(positions) / (5 * truck.model.opt.timestep)
    assert rate.max() == pytest.approx(truck.parameters.steering.rate_max, rel=1e-6)


def test_turning_the_wheel_by_the_ratio_turns_the_road_wheels_by_one(truck):
    ratio = truck.parameters.steering.ratio
    first, second = (turn(truck, degrees, speed=1.0).mean() for degrees in (20.0, 20.0 + ratio))
    assert np.degrees(second - first) == pytest.approx(1.0, rel=0.02)


def test_play_is_the_hysteresis_between_turning_out_and_back(truck):
    """In a slow sweep to the left and back equal road-wheel angles are a dead band apart."""
    steering = truck.parameters.steering
    truck.reset(speed=1.0)
    out, back = [], []
    sweep = np.arange(0.0, 40.0, 0.5)
    for degrees, found in [(d, out) for d in sweep] + [(d, back) for d in sweep[::-1]]:
        truck.command(steering_wheel_angle=np.radians(degrees))
        truck.step(150)
        truck.observe()
        found.append((road_wheels(truck).mean(), np.radians(degrees)))
    half = 0.5 * max(angle for angle, _ in out)
    there = np.interp(half, *np.transpose(out))
    again = np.interp(half, *np.transpose(back[::-1]))
    assert there - again == pytest.approx(steering.dead_band, rel=0.1)


def test_straight_wheels_stay_straight_within_the_play(truck):
    truck.reset(speed=10.0)
    truck.command(steering_wheel_angle=0.45 * truck.parameters.steering.dead_band)
    truck.step(1000)
    truck.observe()
    np.testing.assert_allclose(road_wheels(truck), 0.0, atol=1e-9)


def test_aligning_moment_turns_the_wheels_back_by_the_linkages_compliance(truck):
    """Tires pull towards straight ahead; a linkage a quarter as stiff yields four times as much."""
    steering = truck.parameters.steering
    target = (np.radians(30) - 0.5 * steering.dead_band) / steering.ratio
    soft = Truck.load(
        parameters={"steering": {"stiffness": 0.25 * steering.stiffness}}, visuals=False
    )
    losses = []
    for each in (truck, soft):
        losses.append(target - turn(each, 30, seconds=3.0, speed=20.0).mean())
        sides = [each.sensor(f"tractor_axle1_{side}_tire_force")[1] for side in ("left", "right")]
        moment = np.mean(sides) * each.parameters.tires["steer"].pneumatic_trail
        assert losses[-1] > 0.0
        stiffness = each.parameters.steering.stiffness
        assert losses[-1] == pytest.approx(moment / stiffness, rel=0.25)  # trail falls with slip
    assert losses[1] / losses[0] == pytest.approx(4.0, rel=0.1)


def test_small_steps_follow_with_the_actuators_time_constant(truck):
    steering = truck.parameters.steering
    step = 0.5 * steering.rate_max * steering.time_constant  # slower than the rate limit
    truck.reset()
    truck.command(steering_wheel_angle=step)
    truck.step(round(steering.time_constant / truck.model.opt.timestep))
    reached = truck.observe().steering_wheel_angle
    assert reached / step == pytest.approx(1.0 - np.exp(-1.0), abs=0.02)


def test_steering_wheel_stops_at_its_greatest_angle(truck):
    end = truck.parameters.steering.angle_max
    truck.reset()
    truck.data.ctrl[truck.model.actuator("steering_wheel_angle").id] = 2.0 * end
    truck.step(2000)
    assert truck.observe().steering_wheel_angle == pytest.approx(end, rel=1e-6)


def two_steered_axles(wheelbase, track, tendon=4):
    """Returns the MJCF of four knuckles of an 8x4 truck; the tendon has the first `tendon` ones."""
    config = {
        "ratio": 20,
        "dead_band": 0,
        "angle_max": 15,
        "rate_max": 12,
        "stiffness": 60e3,
        "time_constant": 0.05,
        "wheelbase": wheelbase,
        "track": track,
    }
    keys = "".join(f'<config key="{k}" value="{v}"/>' for k, v in config.items())
    names = [f"axle{axle}_{side}" for axle in (1, 2) for side in ("left", "right")]
    bodies = "".join(
        f'''<body name="{name}"><joint name="{name}" axis="0 0 1" damping="800" armature="5"/>
          <inertial pos="0 0 0" mass="200" diaginertia="20 20 20"/></body>'''
        for name in names
    )
    joints = "".join(f'<joint joint="{name}" coef="0.25"/>' for name in names[:tendon])
    return f"""
    <mujoco>
      <option timestep="0.002" integrator="implicitfast" gravity="0 0 0"/>
      <extension><plugin plugin="iits.steering">
        <instance name="steering">{keys}</instance></plugin></extension>
      <worldbody>{bodies}</worldbody>
      <tendon><fixed name="linkage">{joints}</fixed></tendon>
      <actuator><plugin name="steering_wheel" plugin="iits.steering" instance="steering"
        tendon="linkage"/></actuator>
      <sensor><plugin name="angle" plugin="iits.steering" instance="steering"/></sensor>
    </mujoco>"""


def test_second_steered_axle_turns_less_about_the_same_center():
    model = mujoco.MjModel.from_xml_string(two_steered_axles("5.3 3.5", "2.05 2.05"))
    data = mujoco.MjData(model)
    data.ctrl[0] = 8.0
    mujoco.mj_step(model, data, 3000)
    assert data.sensor("angle").data[0] == pytest.approx(8.0)
    centers = [
        ahead / np.tan(angle) + side * 0.5 * 2.05
        for angle, ahead, side in zip(data.qpos, (5.3, 5.3, 3.5, 3.5), (1, -1, 1, -1), strict=True)
    ]
    assert centers == pytest.approx([5.3 / np.tan(8.0 / 20)] * 4, rel=1e-6)


@pytest.mark.parametrize(
    ("wheelbase", "track", "tendon", "message"),
    [
        ("5.3 3.5", "2.05", 4, "'track' has 1 numbers; allowed are 2 to 2"),
        ("5.3 3.5", "2 2", 2, "wheelbase has 2 axles, the tendon 2 joints"),
        ("5.3", "2", 4, "wheelbase has 1 axles, the tendon 4 joints"),
        ("-1.2 3", "2 2", 4, "'wheelbase' begins with -1.2; allowed are 0.5 to 20"),
    ],
)
def test_steering_refuses_axles_without_their_knuckles(wheelbase, track, tendon, message):
    with pytest.raises(ValueError, match=message.replace("(", r"\(")):
        mujoco.MjModel.from_xml_string(two_steered_axles(wheelbase, track, tendon))


def torque(truck):
    return float(truck.sensor("steering_wheel_torque")[0])


def cornering(truck, degrees, kmh=70.0):
    """Returns lateral acceleration and the driver's torque in a steady corner."""
    truck.reset(speed=kmh / 3.6)
    truck.command(steering_wheel_angle=np.radians(degrees), accelerator_pedal=0.2)
    truck.step(round(4.0 / truck.model.opt.timestep))
    return truck.observe().lateral_acceleration, torque(truck)


def test_driver_needs_no_torque_straight_ahead(truck):
    assert cornering(truck, 0.0)[1] == pytest.approx(0.0, abs=1e-6)


def test_torque_to_the_left_and_to_the_right_are_equal_and_have_the_sign_of_the_turn(truck):
    left, right = cornering(truck, 25.0)[1], cornering(truck, -25.0)[1]
    assert left > 1.0
    assert right == pytest.approx(-left, rel=1e-6)


def test_torque_rises_with_lateral_acceleration_degressively_within_8_newton_meters(truck):
    """At 1 m/s2 it is 2 to 3 N m; drivers of trucks hold 2 to 8 N m."""
    points = np.array([cornering(truck, degrees) for degrees in (8.0, 20.0, 40.0, 60.0)])
    slopes = np.diff(points[:, 1]) / np.diff(points[:, 0])
    assert 2.0 < np.interp(1.0, *points.T) < 3.0
    assert (slopes > 0.2).all()
    assert (np.diff(slopes) < 0.0).all()
    assert 2.0 < points[-1, 1] < 8.0


def on_center(truck):
    """Returns the torque on center of turning to the left less that of turning back, 2.5 deg/s."""
    truck.reset(speed=20.0)
    felt = {}
    for direction in (1.0, -1.0):
        for degrees in np.arange(-3.0, 3.0, 0.1) * direction:
            truck.command(steering_wheel_angle=np.radians(degrees), accelerator_pedal=0.2)
            truck.step(20)
            if abs(truck.observe().steering_wheel_angle) < np.radians(0.1):
                felt[direction] = torque(truck)
    return felt[1.0] - felt[-1.0]


def test_friction_of_the_gear_is_felt_on_center(truck):
    smooth = Truck.load(parameters={"steering": {"friction": 0.2}}, visuals=False)
    rough = on_center(truck)
    assert 0.5 < rough < 2.0 * truck.parameters.steering.friction
    # A great part of the friction acts at so low a rate.
    assert 1.0 < rough - on_center(smooth) < 2.0 * 0.8


def test_torque_is_lower_on_a_slippery_road():
    torques = []
    for friction in (0.8, 0.2):
        road = Route.straight(friction=friction)
        slippery = Truck.load(0.0, route=road, visuals=False)
        slippery.reset(station=100.0, speed=50.0 / 3.6)
        slippery.command(steering_wheel_angle=np.radians(60.0))
        slippery.step(1000)
        slippery.observe()
        torques.append(torque(slippery))
    assert 0.0 < torques[1] < 0.85 * torques[0]


def test_steering_on_the_spot_is_heavier_than_on_the_road_and_within_unece_r79(truck):
    """UN R79 allows 450 N at the rim of a wheel with 0.225 m without, 200 N with the boost."""
    truck.reset()
    truck.command(steering_wheel_angle=3.0)
    truck.step(round(0.3 / truck.model.opt.timestep))
    truck.observe()
    parking = torque(truck)
    assert cornering(truck, 40.0)[1] < parking < 200.0 * 0.225
    assert 5.0 < parking < 10.0


def test_failed_boost_leaves_the_whole_load_to_the_driver(truck):
    manual = Truck.load(
        parameters={"steering": {"boost_torque": [], "boost_assistance": []}}, visuals=False
    )
    loads = [cornering(each, 25.0)[1] for each in (Truck.load(visuals=False), manual)]
    assert loads[1] > 5.0 * loads[0]


def test_sensor_of_the_torque_changes_no_bit_of_the_motion():
    def without(spec):
        spec.delete(spec.sensor("steering_wheel_torque"))

    states = []
    for edit in (None, without):
        each = Truck.load(visuals=False, edit_spec=edit)
        each.reset(speed=10.0)
        each.data.ctrl[[0, 3]] = 0.5, 1.0
        mujoco.mj_step(each.model, each.data, 500)
        states.append(np.concatenate([each.data.qpos, each.data.qvel, each.data.plugin_state]))
    np.testing.assert_array_equal(*states)


@pytest.mark.parametrize("curve", [([0.0, 1.0], [0.0, 100.0, 200.0]), ([1.0, 2.0], [0.0, 10.0])])
def test_bad_boost_curve_is_refused_by_name(curve):
    with pytest.raises((ValueError, InputError), match="boost_torque"):
        Truck.load(
            parameters={
                "steering": {"boost_torque": list(curve[0]), "boost_assistance": list(curve[1])}
            },
            visuals=False,
        )
