"""Steering: errors from the path, the play of the gear, disturbances, the loop's damping."""

import dataclasses

import numpy as np
import pytest

from controllers.tracking.lateral import LateralController
from controllers.tracking.lateral_gains import LateralConfig, LateralGains, PlayConfig
from controllers.tracking.lateral_model import LateralModel
from iits_mj.core.angles import wrap_angles
from iits_mj.core.errors import InputError
from iits_mj.core.messages import EgoState, Trajectory
from iits_mj.core.timing import CONTROL_PERIOD
from iits_mj.parameters import TruckParameters, shipped_trucks
from tests.controllers.tracking.plant import softened
from tests.controllers.tracking.reference import (
    DisturbanceObserver,
    PathView,
    SteeringPlay,
    gains_at,
)

PARAMETERS = TruckParameters.load()
STEERING = PARAMETERS.steering
CONFIG = LateralConfig()
HALF = 0.5 * STEERING.dead_band


def arc(radius=100.0, step=2.0, length=60.0, speed=20.0):
    """A path to the left around (0, radius), its points as far apart as a plan's."""
    station = np.arange(0.0, length + step, step)
    yaw = station / radius
    n = len(station)
    return Trajectory(
        time=station / speed,
        station=station,
        offset=np.zeros(n),
        x=radius * np.sin(yaw),
        y=radius * (1.0 - np.cos(yaw)),
        z=np.zeros(n),
        yaw=yaw,
        curvature=np.full(n, 1.0 / radius),
        speed=np.full(n, speed),
        acceleration=np.zeros(n),
    )


def on_arc(station, aside=0.0, turned=0.0, radius=100.0):
    yaw = station / radius
    return EgoState(
        x=(radius - aside) * np.sin(yaw),
        y=radius - (radius - aside) * np.cos(yaw),
        yaw=yaw + turned,
        station=station,
        speed=20.0,
    )


@pytest.mark.parametrize("station", [0.0, 1.0, 7.3, 30.0, 59.9])
def test_a_truck_on_the_arc_has_no_error_between_the_points_of_its_path(station):
    error, heading = PathView(arc()).error(on_arc(station))
    assert error == pytest.approx(0.0, abs=1e-4)
    assert heading == pytest.approx(0.0, abs=1e-9)


def test_the_offset_is_positive_to_the_left_and_the_heading_error_counter_clockwise():
    error, heading = PathView(arc()).error(on_arc(21.0, aside=0.3, turned=0.02))
    assert error == pytest.approx(0.3, abs=1e-3)
    assert heading == pytest.approx(0.02, abs=1e-9)


def test_the_heading_error_does_not_jump_where_yaw_wraps():
    path = arc()
    wrapped = dataclasses.replace(path, yaw=wrap_angles(path.yaw + np.pi - 0.3))
    errors = [
        PathView(wrapped).error(EgoState(station=s, yaw=s / 100.0 + np.pi - 0.3))[1]
        for s in np.arange(60.0)
    ]
    assert np.abs(errors).max() < 1e-9


def test_curvature_ahead_is_that_of_the_arc_and_lasts_beyond_its_end():
    seen = PathView(arc()).curvature(np.linspace(40.0, 90.0, 101))
    assert seen == pytest.approx(np.full(100, 0.01), rel=1e-9)


def test_a_plan_at_standstill_gives_a_finite_error():
    path = arc()
    standing = dataclasses.replace(
        path, **{name: np.full(4, getattr(path, name)[0]) for name in ("station", "x", "y", "yaw")}
    )
    error, heading = PathView(standing).error(EgoState(station=3.0, y=0.2, x=3.0))
    assert error == pytest.approx(0.2, abs=1e-9)
    assert heading == 0.0


class Gear:
    """A gear whose output the wheel drags along within the play."""

    def __init__(self, config=None):
        self.play = SteeringPlay(STEERING, config or PlayConfig())
        self.wheel = self.output = 0.0

    def turn(self, demand, gain=90.0):
        self.play.follow(self.wheel, self.output / STEERING.ratio)
        asked = self.play.turn(demand, gain)
        self.wheel += 0.33 * (asked - self.wheel)
        self.output = min(max(self.output, self.wheel - HALF), self.wheel + HALF)
        return self.output / STEERING.ratio


def test_the_road_wheels_follow_a_slow_sine_through_the_play():
    gear, time = Gear(), np.arange(0.0, 20.0, 0.02)
    demand = 0.01 * np.sin(0.5 * time)
    output = np.array([gear.turn(value) for value in demand])
    bearable = PlayConfig().missing_acceleration / 90.0
    assert np.abs(output - demand)[100:].max() < bearable + 0.005 * 0.25
    assert np.abs(output - demand)[100:].max() < HALF / STEERING.ratio


def test_the_wheel_rests_while_the_demand_trembles_and_crosses_when_it_turns():
    gear = Gear()
    for _ in range(100):
        gear.turn(0.004)
    rest = gear.wheel
    trembling = 0.5 * PlayConfig().missing_acceleration / 90.0
    wheels = []
    for k in range(200):
        gear.turn(0.004 + trembling * np.sin(0.7 * k) - trembling)
        wheels.append(gear.wheel)
    assert np.ptp([rest, *wheels]) < 1e-3
    for _ in range(100):
        gear.turn(0.002)
    assert gear.output == pytest.approx(0.002 * STEERING.ratio, abs=1e-4)
    assert gear.wheel == pytest.approx(gear.output - HALF, abs=1e-4)


def test_the_play_is_crossed_at_its_own_rate():
    gear = Gear()
    for _ in range(100):
        gear.turn(0.004)
    asked = []
    for _ in range(10):
        gear.play.follow(gear.wheel, 0.0)
        asked.append(gear.play.turn(0.002, 90.0))
    assert np.abs(np.diff(asked[:4])).max() <= PlayConfig().crossing_rate * 0.02 + 1e-12


@pytest.mark.parametrize("speed", [8.0, 16.0, 25.0])
def test_the_observer_finds_a_steady_disturbance_and_no_other(speed):
    model = LateralModel.of(PARAMETERS, 55_000.0, CONFIG.lag)
    config = dataclasses.replace(CONFIG, speed_grid=(speed, 30.0))
    gains = LateralGains.design(model, config).gains[0]
    _, _, _, disturb = model.discrete(speed, CONTROL_PERIOD)
    for push in (np.zeros(3), np.array([0.3, -0.02, 0.01])):
        observer = DisturbanceObserver(CONFIG.disturbance_time)
        state = np.array([0.1, 0.02, 0.01, 0.03, 0.004])
        for _ in range(150):
            state[:3], turned = gains.motion @ state + disturb[:3] @ push, state[1] - state[2]
            state[3] += CONTROL_PERIOD * turned
            seen = observer.update(state, gains)
        assert seen == pytest.approx(push, abs=1e-4)


@pytest.mark.parametrize("mass", [19_000.0, 55_000.0])
def test_the_balancing_angle_keeps_a_pushed_truck_on_a_straight_path(mass):
    model, push = LateralModel.of(PARAMETERS, mass, CONFIG.lag), np.array([0.4, -0.03, 0.02])
    a, _, _ = model.matrices(20.0)
    delta = float(model.balance(20.0) @ push)
    steady = np.linalg.solve(a[:4, :4], -a[:4, 6] * delta - np.append(push, 0.0))
    assert steady[1] == pytest.approx(0.0, abs=1e-9)
    assert steady[2] == pytest.approx(0.0, abs=1e-9)


def test_the_model_has_a_plausible_wheelbase_and_understeer_gradient():
    model = LateralModel.of(PARAMETERS, 55_000.0, CONFIG.lag)
    slow, fast = (model.steady_acceleration(speed) / speed**2 for speed in (0.5, 25.0))
    # A tandem's scrub lengthens the wheelbase (Winkler 1998); the tri-axle's, at the hitch ahead
    # of the tandem, is not in that formula.
    plane = model.plane
    front, drive = plane.cornering[0], plane.position[1:3]
    base = drive.mean()
    longer = drive.var() / base * (1.0 + plane.cornering[1:3].sum() / front)
    assert 1.0 / slow == pytest.approx(base + longer, abs=0.15)
    gradient = np.rad2deg(1.0 / fast - 1.0 / slow) / 25.0**2 * 9.81
    assert 0.5 < gradient < 3.0


def closed_loop(plant, gains, speed):
    """Transition of state, estimate and expectation over a step; play left out, square."""
    low, high = CONFIG.disturbance_speed
    trust = min(max((speed - low) / (high - low), 0.0), 1.0)
    at = gains_at(gains, speed)
    a, b, *_ = plant.discrete(speed, CONTROL_PERIOD)
    n, rates, motions = len(a), plant.rates, plant.motions
    share = 1.0 - np.exp(-CONTROL_PERIOD / CONFIG.disturbance_time)
    moving, measured = np.eye(rates, n), np.zeros((motions + 1, n))
    measured[:motions, :motions], measured[motions, motions + 2] = np.eye(motions), 1.0
    seen = share * at.blame
    estimate = np.hstack([seen @ moving, (1.0 - share) * np.eye(rates), -seen])
    rate = -np.append(at.feedback, np.zeros(2 * rates)) - trust * at.disturbance @ estimate
    whole = np.zeros((n + 2 * rates, n + 2 * rates))
    whole[:n, :n] = a
    whole[:n] += b @ rate[None]
    whole[n : n + rates] = estimate
    whole[n + rates :, :n] = at.motion @ measured
    return whole


def least_damping(plant, gains, speed):
    """Greatest real part of the loop's poles [1/s], and least damping ratio of slower ones."""
    values = np.linalg.eigvals(closed_loop(plant, gains, speed)).astype(complex)
    poles = np.log(values[np.abs(values) > 1e-9]) / CONTROL_PERIOD
    oscillating = poles[(np.abs(poles.imag) > 0.3) & (np.abs(poles) < 25.0)]
    return poles.real.max(), min(-oscillating.real / np.abs(oscillating), default=1.0)


SPEEDS = (1.0, 2.0, 4.0, 7.0, 12.0, 18.0, 25.0)


@pytest.mark.parametrize("mass", [19_000.0, 40_000.0, 55_000.0])
@pytest.mark.parametrize("believed", [0.8, 1.0, 1.2])
def test_the_loop_is_damped_although_stiffness_and_mass_are_off_by_a_fifth(mass, believed):
    told = min(max(believed * mass, 19_000.0), 55_000.0)
    gains = LateralGains.design(LateralModel.of(PARAMETERS, told, CONFIG.lag), CONFIG)
    truth = LateralModel.of(PARAMETERS, mass, CONFIG.lag)
    for softer in (0.8, 1.0, 1.2):
        for speed in SPEEDS:
            real, damping = least_damping(softened(truth, softer), gains, speed)
            assert real < -0.03
            assert damping > 0.22


@pytest.mark.parametrize("load", [0.0, 0.5, 1.0])
@pytest.mark.parametrize("name", shipped_trucks())
def test_the_loop_of_every_shipped_truck_is_damped_with_tires_off_by_a_fifth(name, load):
    truck = TruckParameters.load(name)
    model = LateralModel.of(truck, truck.gross_mass(load * truck.payload_max), CONFIG.lag)
    gains = LateralGains.design(model, CONFIG)
    for softer in (0.8, 1.0, 1.2):
        for speed in SPEEDS:
            real, damping = least_damping(softened(model, softer), gains, speed)
            assert real < -0.03
            assert damping > 0.2


def test_steering_damps_the_swing_of_a_drawbar_trailer():
    truck = TruckParameters.load("rigid_drawbar")
    model = LateralModel.of(truck, truck.gross_mass(truck.payload_max), CONFIG.lag)
    free = np.linalg.eigvals(model.matrices(25.0)[0][: model.motions, : model.motions])
    swinging = free[np.abs(free.imag) > 0.3]
    own = (-swinging.real / np.abs(swinging)).min()
    _, damping = least_damping(model, LateralGains.design(model, CONFIG), 25.0)
    assert damping > 1.1 * own


def test_the_wheel_is_held_at_standstill_and_demanded_angles_are_finite():
    controller = LateralController(PARAMETERS)
    held = controller.steer(
        dataclasses.replace(on_arc(5.0), speed=0.0, steering_wheel_angle=0.4), arc()
    )
    assert held == 0.4
    for aside in (-30.0, -1.0, 2.0, 50.0):
        for turned in (-2.0, 0.5, 3.0):
            for lateral in (-9.0, 0.0, 9.0):
                ego = dataclasses.replace(
                    on_arc(20.0, aside, turned), lateral_speed=lateral, speed=1.0
                )
                asked = controller.steer(ego, arc())
                assert np.isfinite(asked)
                assert abs(asked) <= STEERING.angle_max


@pytest.mark.parametrize(
    "wrong",
    [
        {"rate_weight": 0.0},
        {"lag": float("nan")},
        {"speed_grid": (5.0, 4.0)},
        {"speed_grid": (5.0,)},
        {"speed_grid": (0.0, 4.0)},
    ],
)
def test_invalid_settings_are_refused_by_name(wrong):
    with pytest.raises(InputError, match=next(iter(wrong))):
        LateralConfig(**wrong)
