"""The steering plugin on the truck: ratio, play, Ackermann geometry, rate limit."""

import numpy as np
import pytest

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


def test_road_wheels_follow_by_ratio_less_half_the_play(truck):
    steering = truck.parameters.steering
    angles = turn(truck, 90, speed=2.0)
    expected = (np.radians(90) - 0.5 * steering.dead_band) / steering.ratio
    assert angles.mean() == pytest.approx(expected, rel=0.02)


@pytest.mark.parametrize("sign", [1, -1])
def test_inner_wheel_turns_more_as_ackermann_says(truck, sign):
    left, right = sign * turn(truck, sign * 700, seconds=4.0, speed=2.0)[:: 1 if sign > 0 else -1]
    wheelbase, track = 3.9, truck.parameters.tractor.axles[0].track
    assert 1 / np.tan(right) - 1 / np.tan(left) == pytest.approx(track / wheelbase, rel=0.05)


def test_reversal_within_the_play_moves_nothing(truck):
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
