import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from controllers.planning.following import (
    FollowingConfig,
    Lead,
    braking_profile,
    curve_speed,
    follow_acceleration,
    idm_acceleration,
    required_deceleration,
)
from controllers.planning.safety import SafetyConfig, front_gap_needed, rear_gap_needed

CONFIG = FollowingConfig()


@pytest.mark.parametrize("gap", [30.0, 60.0, 200.0])
def test_a_faster_leader_beyond_the_time_gap_causes_no_braking(gap):
    assert follow_acceleration(16.67, 16.67, gap, 19.0, 0.0, CONFIG) >= -1e-9


def test_a_far_leader_causes_no_braking():
    assert follow_acceleration(16.67, 16.67, 300.0, 12.5, 0.0, CONFIG) >= -1e-9


def test_a_car_that_cuts_in_at_equal_speed_causes_only_gentle_braking():
    assert follow_acceleration(16.67, 16.67, 12.0, 16.67, 0.0, CONFIG) > -1.2
    assert idm_acceleration(16.67, 16.67, 12.0, 16.67, CONFIG) < -3.0


def test_a_standing_obstacle_is_braked_for_at_the_kinematic_rate():
    needed = 16.67**2 / (2 * (90.0 - CONFIG.standstill_gap))
    wanted = -follow_acceleration(16.67, 16.67, 90.0, 0.0, 0.0, CONFIG)
    assert needed * 0.95 <= wanted <= needed * 1.6


@given(
    speed=st.floats(0, 30), desired=st.floats(1, 30), gap=st.floats(1, 500),
    lead=st.floats(0, 30), closer=st.floats(0.5, 20),
)  # fmt: skip
def test_idm_never_accelerates_more_for_a_nearer_leader(speed, desired, gap, lead, closer):
    near = idm_acceleration(speed, desired, max(gap - closer, 0.5), lead, CONFIG)
    assert near <= idm_acceleration(speed, desired, gap, lead, CONFIG) + 1e-9


def test_a_braking_leader_is_predicted_to_stop_and_stay():
    way, speed = Lead(20.0, 5.0, -3.0).at(20.0)
    assert speed == 0.0
    assert way == pytest.approx(25.0 / 6.0)


def test_braking_profile_meets_every_limit_at_the_rate():
    s = np.arange(0.0, 500.0, 5.0)
    limit = np.where(s < 300.0, 22.0, 8.0)
    v = braking_profile(s, limit, 0.5)
    assert np.all(v <= limit + 1e-9)
    slope = np.diff(v**2) / (2 * np.diff(s))
    assert slope.min() >= -0.5 - 1e-9
    assert v[0] == pytest.approx(math.sqrt(min(22.0**2, 64.0 + 300.0)), rel=1e-6)


def test_curve_speed_of_a_500_m_radius():
    assert curve_speed(np.array([1 / 500.0]), 1.0)[0] == pytest.approx(math.sqrt(500.0))


def test_required_deceleration_is_zero_for_a_faster_leader():
    assert required_deceleration(5.0, 10.0, 12.0, 2.0) == 0.0


def test_safety_gaps_grow_with_closing_speed_at_both_ends():
    config = SafetyConfig()
    assert front_gap_needed(16.67, 12.5, config) > front_gap_needed(12.5, 12.5, config)
    assert rear_gap_needed(12.5, 20.0, config) > rear_gap_needed(12.5, 12.5, config) + 20.0
    assert 10.0 < front_gap_needed(15.0, 15.0, config) < 30.0
