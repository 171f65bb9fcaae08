import numpy as np
import pytest

from iits_mj.core.errors import InputError
from iits_mj.core.units import GRAVITY
from iits_mj.validation.pbs import measures
from iits_mj.validation.pbs.maneuvers import LaneChange, PulseSteer

TIME = np.arange(0.0, 20.0, 0.01)


def test_tracking_ability_is_the_width_of_bodies_and_the_offset_of_the_last_one():
    # Front unit 2.5 m wide on the middle, last unit 0.3 m aside and 20 m behind.
    x = 25.0 * TIME
    front, rear = np.full_like(x, 1.25), np.full_like(x, -1.25 - 0.3)
    points = np.stack([np.column_stack([x, front]), np.column_stack([x - 20.0, rear])], axis=1)
    assert measures.tracking_ability(points) == pytest.approx(2.8)
    with pytest.raises(InputError, match="too short"):
        measures.tracking_ability(points[:10])


def test_friction_demand_is_the_used_share_of_the_available_friction():
    forces = np.zeros((5, 2, 3))
    forces[..., 2] = 30e3
    forces[3, :, :2] = [3e3, 4e3]
    assert measures.friction_demand(forces) == pytest.approx(100.0 * 5e3 / 30e3 / 0.8)


def test_rearward_amplification_is_the_ratio_of_the_peaks():
    front = np.sin(TIME)
    assert measures.rearward_amplification(front, -1.7 * np.roll(front, 40)) == pytest.approx(1.7)
    with pytest.raises(InputError, match="no lateral acceleration"):
        measures.rearward_amplification(0.0 * front, front)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_transient_off_tracking_is_the_overshoot_beyond_the_steer_axles_path(side):
    change = LaneChange()
    x = change.speed * TIME
    front = np.column_stack([x, side * change.path(x - 100.0)])
    bump = 0.4 * np.exp(-(((x - 170.0) / 10.0) ** 2)) - 0.9 * np.exp(-(((x - 110.0) / 10.0) ** 2))
    rear = front - [20.0, 0.0]
    rear[:, 1] = side * (change.path(rear[:, 0] - 100.0) + np.interp(rear[:, 0], x, bump))
    assert measures.transient_off_tracking(front, rear) == pytest.approx(0.4, abs=2e-3)
    with pytest.raises(InputError, match="not changed"):
        measures.transient_off_tracking(front * [1.0, 0.0], rear)


def test_lane_change_moves_the_truck_by_a_lane_with_the_acceleration_of_one_sine():
    change = LaneChange()
    assert change.offset == pytest.approx(1.46, abs=0.01)
    path = change.path(change.speed * TIME)
    assert path[-1] == pytest.approx(change.offset)
    acceleration = np.gradient(np.gradient(path, TIME), TIME)
    assert acceleration.max() == pytest.approx(0.15 * GRAVITY, rel=0.01)


def test_pulse_rises_and_falls_once():
    pulse = PulseSteer().steer(TIME)
    assert pulse.max() == pytest.approx(1.0)
    assert np.all(pulse[TIME > 0.4] == 0.0)


@pytest.mark.parametrize("damping", [0.05, 0.15, 0.3])
def test_yaw_damping_is_that_of_the_worst_swing(damping):
    def swing(d):
        return np.exp(-d * 3.0 * TIME) * np.sin(3.0 * np.sqrt(1.0 - d**2) * TIME)

    found = measures.yaw_damping([swing(0.5), swing(damping)])
    assert found == pytest.approx(damping, rel=0.03)


def test_acceleration_time_of_a_constant_acceleration():
    distance = 0.5 * 0.6 * TIME**2
    assert measures.acceleration_time(TIME, distance) == pytest.approx(
        np.sqrt(200.0 / 0.6), rel=1e-3
    )
    assert measures.acceleration_time(TIME[:300], distance[:300]) == np.inf


def test_front_corners_are_compared_at_one_place():
    station = np.linspace(-5.0, 20.0, 500)
    ahead, behind = 0.5 * np.exp(-station / 5.0), 0.6 * np.exp(-station / 8.0)
    early = station < 0.0
    outward = np.column_stack([np.where(early, 0.5, ahead), np.where(early, 0.6, behind)])
    both = np.column_stack([station, station])
    maxima, paths = measures.front_corner_excess(outward, both)
    assert maxima == pytest.approx(0.1, abs=1e-3)
    assert paths == pytest.approx(np.max((behind - ahead)[~early]), abs=1e-3)
    assert measures.front_corner_excess(outward[:, :1], both[:, :1]) == (-np.inf, -np.inf)


@pytest.mark.parametrize(
    "measure",
    [
        lambda bad: measures.tracking_ability(np.full((9, 2, 2), bad)),
        lambda bad: measures.friction_demand(np.full((9, 2, 3), bad)),
        lambda bad: measures.yaw_damping([np.full(9, bad)]),
        lambda bad: measures.acceleration_time(TIME, np.full_like(TIME, bad)),
        lambda bad: measures.rearward_amplification(np.ones(9), np.full(9, bad)),
    ],
)
@pytest.mark.parametrize("bad", [float("nan"), float("inf")])
def test_values_that_are_not_finite_are_refused(measure, bad):
    with pytest.raises(InputError, match="not finite"):
        measure(bad)
