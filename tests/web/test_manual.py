import itertools
import math

import pytest

from iits_mj.core.messages import EgoState, TransmissionMode, XbrMode
from iits_mj.parameters import TruckParameters, shipped_trucks
from iits_mj.simulation import DriveConfig, Observer, Simulation
from iits_mj.simulation.parts import make_stack
from iits_mj.web.manual import Hands, ManualDriver, Wheel


@pytest.fixture(scope="module")
def parameters():
    return TruckParameters.load()


@pytest.mark.parametrize("name", shipped_trucks())
def test_full_steering_stays_below_two_meters_per_second_squared_at_speed(name):
    truck = TruckParameters.load(name)
    wheel = Wheel(truck)
    unsteered = [axle.position for axle in truck.lead.axles if not axle.steered]
    wheelbase = sum(unsteered) / len(unsteered)
    for speed in (10.0, 16.7, 25.0):
        road_wheels = wheel.angle_limit(speed) / truck.steering.ratio
        # Without understeer this is the bend that the angle gives.
        assert speed**2 * math.tan(road_wheels - 0.018) / wheelbase == pytest.approx(1.8, rel=0.01)
    assert wheel.angle_limit(0.0) <= truck.steering.angle_max


def test_the_steering_wheel_turns_at_a_limited_rate_and_returns(parameters):
    wheel, ego = Wheel(parameters), EgoState(speed=5.0)
    angles = [wheel.command(Hands(steer=1.0), ego).steering_wheel_angle for _ in range(20)]
    assert angles[0] == pytest.approx(0.1)
    assert all(0.0 < b - a < 0.1 + 1e-9 for a, b in itertools.pairwise(angles))
    for _ in range(100):
        back = wheel.command(Hands(), ego).steering_wheel_angle
    assert back == 0.0


def test_brake_excludes_the_accelerator(parameters):
    wheel, ego = Wheel(parameters), EgoState(speed=10.0)
    for _ in range(60):
        both = wheel.command(Hands(pedal=1.0, brake=1.0), ego)
    assert both.accelerator_pedal == 0.0
    assert both.xbr_demand == pytest.approx(-6.0)
    assert both.xbr_mode is XbrMode.MAXIMUM
    for _ in range(60):
        pedal = wheel.command(Hands(pedal=0.7, reverse=True, retarder=0.5), ego)
    assert pedal.accelerator_pedal == pytest.approx(0.7)
    assert pedal.xbr_mode is XbrMode.OFF
    assert pedal.transmission_mode is TransmissionMode.REVERSE
    assert pedal.retarder == 0.5


@pytest.mark.parametrize("wrong", [None, "1", math.nan, math.inf, True, [1.0]])
def test_inputs_that_are_no_numbers_count_as_none(wrong):
    assert Hands.of({"pedal": wrong, "steer": wrong}) == Hands()
    assert Hands.of({"pedal": 7.0, "steer": -7.0, "reverse": 1}) == Hands(pedal=1.0, steer=-1.0)


class Script(Observer):
    """Takes and releases the wheel at fixed times, and keeps the states."""

    def __init__(self, driver, take, release, period):
        self.driver, self.take, self.release, self.period = driver, take, release, period
        self.states = []

    def commanded(self, ego, wanted, obeyed):
        if abs(ego.time - self.take) < 1e-6:
            self.driver.take()
        if abs(ego.time - self.release) < 1e-6:
            self.driver.release()
        self.states.append((ego, wanted, self.driver.driving))


def drive(commands="direct", period=0.1):
    config = DriveConfig(
        duration=12.0, traffic_mode="none", speed_planner="cruise", commands=commands
    )

    def hands(time):
        return Hands(pedal=0.6, steer=0.3 if time < 4.0 else -0.2)

    def driver(route, truck):
        stack = make_stack(config, route, truck.parameters)
        return ManualDriver(stack, route, truck.parameters, hands)

    with Simulation(config, driver=driver, visuals=False) as simulation:
        script = Script(simulation.driver, take=2.02, release=5.0, period=period)
        simulation.run([script])
    return script.states, simulation


@pytest.fixture(scope="module")
def driven():
    return drive()


def test_a_person_steers_and_the_automatic_driver_returns_to_the_lane(driven):
    states, simulation = driven
    own = [ego for ego, _, driving in states if driving]
    assert own[0].time == pytest.approx(2.1)
    assert own[-1].time == pytest.approx(5.08, abs=0.03)
    # To the left of the lane's middle, then back.
    offset = own[-1].offset - float(simulation.route.lane_offset(0, own[-1].station))
    assert offset > 0.4
    last = states[-1][0]
    assert abs(last.offset - float(simulation.route.lane_offset(0, last.station))) < 0.3
    assert not simulation.failed


def test_the_steering_wheel_does_not_jump_when_the_driver_changes(driven):
    angles = [wanted.steering_wheel_angle for _, wanted, _ in driven[0]]
    assert max(abs(b - a) for a, b in itertools.pairwise(angles)) < 0.25


def test_the_same_inputs_at_the_same_times_give_the_same_drive(driven):
    again, _ = drive(period=0.004)
    assert [ego for ego, *_ in again] == [ego for ego, *_ in driven[0]]


def test_commands_of_a_person_pass_through_j1939_frames(driven):
    states, simulation = drive(commands="j1939")
    assert simulation.path.receiver.accepted["IITS_COMMAND"] > 400
    direct = [ego.offset for ego, *_ in driven[0]]
    # Steps of the signals: 2 mrad of the steering wheel.
    assert max(abs(a[0].offset - b) for a, b in zip(states, direct, strict=True)) < 0.1
