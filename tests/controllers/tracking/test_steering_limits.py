"""Steering call by call: rate and angle limits, the integral, the deadband, and the play."""

import dataclasses
import math

import numpy as np
import pytest

from controllers.tracking.lateral import LateralController, check_finite, unit_motions
from controllers.tracking.lateral_gains import (
    CalmConfig,
    Gains,
    LateralConfig,
    LateralGains,
    PlayConfig,
    state_weight,
)
from controllers.tracking.lateral_model import LateralModel
from iits_mj.core.errors import InputError
from iits_mj.core.messages import EgoState
from iits_mj.core.timing import CONTROL_PERIOD
from iits_mj.parameters import TruckParameters
from tests.controllers.tracking.reference import (
    DisturbanceObserver,
    PathView,
    Steering,
    SteeringPlay,
    gains_at,
)
from tests.controllers.tracking.test_lateral import arc, on_arc

PARAMETERS = TruckParameters.load()
STEERING = PARAMETERS.steering
HALF = 0.5 * STEERING.dead_band
# Few speeds, so that the gains are computed quickly.
CONFIG = LateralConfig(speed_grid=(5.0, 10.0, 20.0))


@pytest.fixture(scope="module")
def made():
    return LateralController(PARAMETERS, CONFIG)


@pytest.fixture
def controller(made):
    made.reset()
    return made


def straight(length=200.0, speed=20.0):
    """A straight path along x."""
    path = arc(1e9, 2.0, length, speed)
    return dataclasses.replace(path, curvature=np.zeros_like(path.curvature))


def beside(aside, station=10.0, speed=20.0, **fields):
    """A laden truck beside a straight path, parallel to it."""
    return EgoState(x=station, y=aside, station=station, speed=speed, mass=55_000.0, **fields)


def held(controller, ego, path, steps):
    """Wheel angles while the truck's state does not change."""
    return np.array([controller.steer(ego, path) for _ in range(steps)])


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_the_wheel_turns_no_faster_than_the_gear_and_up_to_its_end_stop(controller, side):
    ego = dataclasses.replace(beside(-0.9 * side, speed=5.0), yaw=-1.2 * side)
    wheels = held(controller, ego, straight(), 400)
    rate = np.diff(wheels) / CONTROL_PERIOD
    # Between its angle's sine and the angle itself lies the cosine of the greatest angle.
    most = STEERING.rate_max / math.cos(STEERING.angle_max / STEERING.ratio)
    assert np.abs(rate[2:]).max() <= most + 1e-9
    assert side * rate[5] == pytest.approx(STEERING.rate_max, rel=0.01)
    # The least correction is omitted before the end stop, too.
    assert wheels[-1] == pytest.approx(side * STEERING.angle_max, abs=0.1)
    assert np.abs(wheels).max() <= STEERING.angle_max


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_an_offset_beyond_its_bound_steers_as_one_at_the_bound(controller, side):
    demands = []
    for aside in (0.5, 1.0, 3.0):
        controller.reset()
        ego = beside(aside * side * CONFIG.error_max)
        demands.append(side * held(controller, ego, straight(), 3)[-1])
    assert demands[0] > demands[1] == pytest.approx(demands[2])
    assert demands[1] < -0.01


def integral_after(controller, aside, speed, steps):
    controller.reset()
    held(controller, beside(aside, speed=speed), straight(), steps)
    return controller.memory.integral


def test_the_integral_is_that_of_the_offset_over_time(controller):
    found = integral_after(controller, 0.2, 20.0, 10)
    assert found == pytest.approx(10 * 0.2 * CONTROL_PERIOD)
    assert integral_after(controller, -0.2, 20.0, 10) == pytest.approx(-found)


@pytest.mark.parametrize(("aside", "speed"), [(0.61, 20.0), (-0.61, 20.0), (0.2, 2.0), (0.2, 1.0)])
def test_the_integral_rests_far_from_the_path_and_at_walking_pace(controller, aside, speed):
    assert integral_after(controller, aside, speed, 5) == 0.0


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_the_integral_is_bounded(controller, side):
    controller.reset()
    bound = CONFIG.integral_max
    controller.memory.integral = side * (bound - 0.005)
    held(controller, beside(0.4 * side), straight(), 2)
    assert controller.memory.integral == side * bound


def test_the_integral_steers_against_a_lasting_offset(controller):
    """A positive integral of the offset to the left steers to the right."""
    wheels = []
    for integral in (0.0, CONFIG.integral_max):
        controller.reset()
        controller.memory.integral = integral
        wheels.append(held(controller, beside(0.3), straight(), 5)[-1])
    assert wheels[1] < wheels[0] < 0.0


def test_small_corrections_are_omitted_and_large_ones_lack_the_idle_angle():
    controller, response = Steering(PARAMETERS, CONFIG), 90.0
    idle = CONFIG.idle_acceleration / response
    assert idle < CONFIG.idle_angle
    for steady in (-0.02, 0.0, 0.03):
        for beyond in (-3.0, -0.9, 0.0, 0.9, 3.0):
            controller.demand = steady + beyond * idle
            wanted = steady + np.sign(beyond) * max(abs(beyond) - 1.0, 0.0) * idle
            assert controller.quieted(steady, response) == pytest.approx(wanted, abs=1e-12)
    controller.demand = 0.1
    assert controller.quieted(0.0, 1e-3) == pytest.approx(0.1 - CONFIG.idle_angle)
    for demand in (-5.0, 5.0):
        controller.demand = demand
        assert abs(controller.quieted(0.0, response)) == controller.most


@pytest.mark.parametrize(("speed", "share"), [(1.0, 0.0), (3.0, 0.0), (4.5, 0.5), (6.0, 1.0)])
def test_the_disturbance_counts_more_the_faster_the_truck_drives(speed, share):
    assert Steering(PARAMETERS, CONFIG).trust(speed) == pytest.approx(share)


def test_gains_are_kept_for_a_similar_mass_only(controller):
    first = controller.gains(40_000.0)
    assert controller.gains(40_150.0) is first
    assert controller.gains(39_850.0) is first
    assert controller.gains(40_250.0) is not first


def test_the_wheel_keeps_its_last_angle_below_the_least_speed(controller):
    path = straight()
    driving = held(controller, beside(0.4), path, 20)[-1]
    resting = beside(0.4, speed=0.9 * CONFIG.speed_min, steering_wheel_angle=9.0)
    assert controller.steer(resting, path) == driving
    assert controller.steer(beside(0.4, speed=CONFIG.speed_min), path) != driving


def test_a_reset_forgets_everything(controller):
    path = straight()
    first = held(controller, beside(0.3), path, 10)
    assert controller.error == pytest.approx(0.3)
    held(controller, beside(0.5, lateral_speed=0.4), path, 30)
    controller.reset()
    assert controller.error == 0.0
    assert np.array_equal(held(controller, beside(0.3), path, 10), first)


def test_a_new_trajectory_replaces_the_old_one(controller):
    controller.steer(beside(0.3), straight())
    moved = dataclasses.replace(straight(), y=np.full(len(straight().y), 0.5))
    controller.steer(beside(0.3), moved)
    assert controller.error == pytest.approx(-0.2)


def test_a_crabwise_truck_heads_along_its_course(controller):
    """Course is heading plus the angle of the speed across: a truck on course needs no steering."""
    drift = 1.0
    crab = math.asin(drift / math.hypot(20.0, drift))
    steers = []
    for yaw in (-crab, 0.0, crab):
        controller.reset()
        ego = dataclasses.replace(beside(0.0, lateral_speed=drift), yaw=yaw)
        steers.append(held(controller, ego, straight(), 25)[-1])
    assert steers[0] > steers[1] > steers[2]


def test_one_step_demands_the_feedback_of_the_whole_state(controller):
    """Offset, course, rates, articulation, angles and integral, each by its own gain."""
    ego = beside(0.2, speed=9.0, lateral_speed=-6.0, yaw_rate=0.02, trailer_yaw_rate=0.03)
    ego = dataclasses.replace(ego, yaw=0.1, articulation=0.2, road_wheel_angle=0.05)
    speed = math.hypot(9.0, 6.0)
    gains = gains_at(controller.gains(55_000.0), speed)
    course = 0.1 + math.asin(-6.0 / speed) + 6.0 / speed
    angle = math.sin(0.05)
    state = [-6.0, 0.02, 0.03, math.sin(0.2), 0.2, course, angle, angle, 1.5]
    controller.memory.integral = 1.5
    controller.steer(ego, straight())
    limit = STEERING.rate_max / STEERING.ratio
    rate = -float(gains.feedback @ state)
    assert abs(rate) < limit
    assert controller.memory.demand == pytest.approx(angle + rate * CONTROL_PERIOD)


def test_on_a_bend_the_demand_is_that_of_its_curvature_ahead(controller):
    path = dataclasses.replace(straight(), curvature=np.full(len(straight().yaw), 1.0 / 400.0))
    path = dataclasses.replace(path, yaw=path.station / 400.0)
    controller.steer(beside(0.0, 0.0, speed=10.0), path)
    gains = gains_at(controller.gains(55_000.0), 10.0)
    rate = -float(gains.preview.sum()) / 400.0
    assert controller.memory.demand == pytest.approx(rate * CONTROL_PERIOD, rel=0.05)
    # While the demand is near the steady angle of the bend, the wheel asks for just that angle.
    steady = 10.0**2 / 400.0 / gains.response
    never = CalmConfig(strength=1e-9)
    config = dataclasses.replace(CONFIG, play=PlayConfig(crossing_rate=1e3), calm=never)
    quick = LateralController(PARAMETERS, config)
    quick._gains, quick._mass = controller._gains, controller._mass
    for off in (-0.5, 0.5):
        quick.reset()
        quick.memory.started = quick.memory.flank = 1.0
        quick.memory.demand = steady + off * CONFIG.idle_acceleration / gains.response
        asked = quick.steer(beside(0.0, 0.0, speed=10.0), path)
        assert asked == pytest.approx(math.asin(steady) * STEERING.ratio + HALF, abs=1e-3)


def test_a_lasting_push_is_balanced_after_the_steady_time(controller):
    """The estimate of the disturbance moves the steady angle with its own time constant."""
    ego, path = beside(0.0, yaw_rate=0.01), straight()
    values, lasting = [], np.zeros(3)
    share = 1.0 - math.exp(-CONTROL_PERIOD / CONFIG.steady_time)
    for _ in range(20):
        controller.steer(ego, path)
        values.append(controller.observed[1].copy())
        lasting = lasting + share * (values[-1] - lasting)
    assert np.abs(values[-1]).max() > 0.0
    assert controller.observed[2] == pytest.approx(lasting)
    slow = beside(0.0, speed=4.5, yaw_rate=0.01)
    controller.reset()
    for _ in range(2):
        controller.steer(slow, path)
    estimate = controller.observed[1].copy()
    assert controller.observed[2] == pytest.approx(share * 0.5 * estimate)


# --- the path -------------------------------------------------------------------------------


def test_the_path_goes_straight_on_beyond_both_ends():
    path = straight(20.0)
    for station in (-7.0, 33.0):
        error, heading = PathView(path).error(beside(0.3, station))
        assert (error, heading) == pytest.approx((0.3, 0.0), abs=1e-5)


def test_the_sagitta_of_a_coarse_path_is_added_to_the_chord():
    view = PathView(arc(50.0, 10.0))
    for station in (12.0, 15.0, 19.0):
        assert view.error(on_arc(station, radius=50.0))[0] == pytest.approx(0.0, abs=5e-3)


def test_curvature_within_the_path_is_the_mean_of_each_piece():
    path = arc()
    yaw = np.where(path.station < 20.0, 0.0, 0.02 * (path.station - 20.0))
    view = PathView(dataclasses.replace(path, yaw=yaw, curvature=np.full(len(yaw), 0.02)))
    seen = view.curvature(np.array([0.0, 10.0, 30.0, 60.0, 64.0]))
    assert seen == pytest.approx([0.0, 0.01, 0.02, 0.02])


def test_yaw_may_jump_by_just_less_than_half_a_turn():
    path = arc()
    yaw = np.zeros(len(path.yaw))
    yaw[5:] = 3.1
    assert np.array_equal(PathView(dataclasses.replace(path, yaw=yaw)).yaw, yaw)
    yaw[5:] = 2.0 * np.pi
    assert PathView(dataclasses.replace(path, yaw=yaw)).yaw == pytest.approx(0.0 * yaw)


# --- disturbance ----------------------------------------------------------------------------

UNIT = Gains(
    speed=1.0,
    feedback=np.zeros(9),
    preview=np.zeros(1),
    disturbance=np.zeros(3),
    motion=np.eye(3, 5),
    blame=2.0 * np.eye(3),
    balance=np.zeros(3),
    response=1.0,
)


def test_the_observer_approaches_an_error_with_its_time_constant():
    observer = DisturbanceObserver(0.5)
    assert not observer.update(np.zeros(5), UNIT).any()
    share = 1.0 - math.exp(-CONTROL_PERIOD / 0.5)
    state = np.array([0.1, 0.2, 0.3, 0.0, 0.0])
    assert observer.update(state, UNIT) == pytest.approx(2.0 * share * state[:3])
    # The same state again agrees with the prediction: the estimate decays.
    kept = 2.0 * share * state[:3]
    assert observer.update(state, UNIT) == pytest.approx((1.0 - share) * kept)
    observer.rest()
    assert observer.value == pytest.approx((1.0 - share) ** 2 * kept)
    # After a rest there is no prediction to compare with.
    assert observer.update(5.0 * state, UNIT) == pytest.approx((1.0 - share) ** 2 * kept)
    observer.reset()
    assert not observer.value.any()
    assert not observer.update(state, UNIT).any()


# --- play -----------------------------------------------------------------------------------


def test_the_first_output_is_read_from_the_road_wheels_then_dragged_by_the_wheel():
    play = SteeringPlay(STEERING, PlayConfig())
    inside = 0.4 * HALF / STEERING.ratio
    assert play.follow(0.0, inside) == pytest.approx(0.4 * HALF)
    # Later road wheel angles do not count.
    assert play.follow(0.0, 0.5) == pytest.approx(0.4 * HALF)
    assert play.follow(2.0, 0.0) == pytest.approx(2.0 - HALF)
    assert play.follow(1.0, 0.0) == pytest.approx(1.0 + HALF)
    play.reset()
    assert play.follow(0.0, -inside) == pytest.approx(-0.4 * HALF)


@pytest.mark.parametrize("flank", [-1.0, 1.0])
def test_the_wheel_stands_half_the_play_ahead_of_the_output_it_pushes(flank):
    play = SteeringPlay(STEERING, PlayConfig(crossing_rate=1e3))
    play.follow(flank * 0.5 * HALF, 0.0)
    wanted = flank * 0.02
    assert play.turn(wanted, 90.0) == pytest.approx(wanted * STEERING.ratio + flank * HALF)
    # A demand slightly behind the output leaves the wheel on its flank.
    play.follow(wanted * STEERING.ratio + flank * HALF, 0.0)
    less = flank * 0.5 * PlayConfig().missing_acceleration / 90.0
    assert play.turn(wanted - less, 90.0) == pytest.approx(wanted * STEERING.ratio + flank * HALF)
    # One far behind it makes the wheel cross the play.
    assert play.turn(0.0, 90.0) == pytest.approx(-flank * HALF)


def test_at_low_speed_the_missing_angle_itself_bounds_the_deadband():
    play = SteeringPlay(STEERING, PlayConfig(crossing_rate=1e3))
    play.follow(0.01, 0.0)
    play.follow(HALF, 0.0)
    assert play.turn(-0.9e-3, 0.0) == pytest.approx(HALF)
    assert play.turn(-1.1e-3, 0.0) == pytest.approx(-1.1e-3 * STEERING.ratio - HALF)


def test_the_play_is_crossed_at_its_rate_to_the_opposite_flank():
    config = PlayConfig()
    play = SteeringPlay(STEERING, config)
    play.follow(HALF, 0.0)
    reach = config.crossing_rate * CONTROL_PERIOD
    wheels = [play.turn(-0.01, 90.0) for _ in range(40)]
    steps = -np.diff([HALF, *wheels])
    crossing = steps[: int(2.0 * HALF / reach)]
    assert crossing == pytest.approx(np.full(len(crossing), reach))
    assert wheels[-1] == pytest.approx(-0.01 * STEERING.ratio - HALF)


def test_the_wheel_stays_between_its_end_stops():
    play = SteeringPlay(STEERING, PlayConfig(crossing_rate=1e3))
    assert play.turn(5.0, 90.0) == STEERING.angle_max
    assert play.turn(-5.0, 90.0) == -STEERING.angle_max


# --- gains ----------------------------------------------------------------------------------


def test_gains_are_interpolated_between_the_speeds_and_held_beyond(made):
    gains = made.gains(55_000.0)
    low, high = gains.gains[1], gains.gains[2]
    between = gains_at(gains, 12.5)
    assert between.response == pytest.approx(0.75 * low.response + 0.25 * high.response)
    assert between.feedback == pytest.approx(0.75 * low.feedback + 0.25 * high.feedback)
    assert gains_at(gains, 1.0).response == gains.gains[0].response
    assert gains_at(gains, 40.0).response == gains.gains[-1].response


def test_a_steady_curve_has_no_cost():
    speed = 15.0
    model = LateralModel.of(PARAMETERS, 55_000.0, CONFIG.lag)
    weight = state_weight(model, speed, CONFIG)
    steady = np.array([-0.3, 0.15, 0.15, 0.1, 0.0, 0.3 / speed, 0.02, 0.02, 0.0])
    assert steady @ weight @ steady == pytest.approx(0.0, abs=1e-12)
    # Each deviation costs its weight: offset, speed across the path, articulation rate, integral.
    for change, cost in (
        ({4: 2.0}, 4.0 * CONFIG.offset_weight),
        ({0: 0.5}, 0.25 * CONFIG.course_weight),
        ({5: 0.1}, (0.1 * speed) ** 2 * CONFIG.course_weight),
        ({1: 0.3}, 0.09 * CONFIG.articulation_weight),
        ({2: 0.3}, 0.09 * CONFIG.articulation_weight),
        ({8: 2.0}, 4.0 * CONFIG.integral_weight),
    ):
        state = np.zeros(9)
        state[list(change)] = list(change.values())
        assert state @ weight @ state == pytest.approx(cost)


def test_preview_and_feedback_keep_a_steady_curve():
    """In a steady curve, feedback and preview cancel: the demanded angle does not change."""
    model = LateralModel.of(PARAMETERS, 55_000.0, CONFIG.lag)
    for speed in CONFIG.speed_grid:
        gains = gains_at(LateralGains.design(model, CONFIG), speed)
        a, _, e = model.matrices(speed)
        kappa = 1e-3
        rows = [0, 1, 2, 3, 5]
        held_rows = np.linalg.solve(
            a[np.ix_([0, 1, 2, 3, 4], [0, 1, 2, 3, 6])][:4][:, [0, 2, 3, 4]],
            -a[:4, 1] * speed * kappa,
        )
        w, r_t, articulation, delta = held_rows
        state = np.array([w, speed * kappa, r_t, articulation, 0.0, -w / speed, delta, delta, 0.0])
        moved = a @ state + e[:, 0] * kappa
        assert moved[rows] == pytest.approx(np.zeros(5), abs=1e-9)
        assert r_t == pytest.approx(speed * kappa)
        rate = -gains.feedback @ state - gains.preview.sum() * kappa
        # The integral of the offset is the remaining freedom: it holds a constant.
        assert rate / gains.feedback[7] == pytest.approx(0.0, abs=0.05 * abs(delta))


def test_a_lasting_disturbance_is_balanced_by_the_steady_feed_forward():
    model = LateralModel.of(PARAMETERS, 55_000.0, CONFIG.lag)
    gains = gains_at(LateralGains.design(model, CONFIG), 20.0)
    a, b, _, disturb = model.discrete(20.0, CONTROL_PERIOD)
    state, push = np.zeros(9), np.array([0.3, -0.02, 0.01])
    for _ in range(3000):
        rate = -gains.feedback @ state - gains.disturbance @ push
        state = a @ state + b[:, 0] * rate + disturb @ push
    assert state[4] == pytest.approx(0.0, abs=0.03)
    assert state[6] == pytest.approx(float(gains.balance @ push), rel=0.01)


def test_a_prediction_holds_the_measured_road_wheel_angle_for_a_step():
    model = LateralModel.of(PARAMETERS, 55_000.0, CONFIG.lag)
    gains = gains_at(LateralGains.design(model, CONFIG), 10.0)
    a, _, _, disturb = model.discrete(10.0, CONTROL_PERIOD)
    state = np.array([0.1, 0.05, 0.04, 0.02, 0.0, 0.0, 0.01, 0.01, 0.0])
    predicted = gains.motion @ state[[0, 1, 2, 3, 6]]
    assert predicted == pytest.approx((a @ state)[:3])
    assert gains.blame @ disturb[:3] == pytest.approx(np.eye(3), abs=1e-9)


@pytest.mark.parametrize(("load", "share"), [(-5_000.0, 0.0), (1e6, 1.0)])
def test_the_models_payload_is_between_none_and_the_greatest(load, share):
    empty = PARAMETERS.gross_mass(0.0)
    model = LateralModel.of(PARAMETERS, empty + load, 0.1)
    expected = PARAMETERS.gross_mass(share * PARAMETERS.payload_max)
    assert model.plane.mass.sum() == pytest.approx(expected)


def test_a_state_names_its_first_value_that_is_not_finite():
    ego = EgoState(speed=math.nan, yaw=math.inf)
    check_finite(ego, ("x", "mass"))
    with pytest.raises(InputError, match="speed is nan"):
        check_finite(ego, ("x", "speed", "yaw"))


def test_the_units_yaw_rates_follow_from_the_articulation_rates():
    ego = EgoState(
        yaw_rate=0.3,
        trailer_yaw_rate=0.05,
        articulation=0.2,
        articulation_rate=0.1,
        rear_articulations=(-0.1, 0.4),
        rear_articulation_rates=(0.04, 0.11),
    )
    motions = unit_motions(ego, 4)
    assert motions == pytest.approx([0.3, 0.2, 0.16, 0.05, 0.2, -0.1, 0.4])
    assert unit_motions(EgoState(yaw_rate=0.3), 1) == [0.3]
    with pytest.raises(InputError, match="1 are needed for 3 units"):
        unit_motions(ego, 3)


def test_an_articulation_that_is_not_finite_is_refused():
    with pytest.raises(InputError, match="articulations behind the first"):
        check_finite(EgoState(rear_articulations=(math.nan,)), ("x", "y"))
