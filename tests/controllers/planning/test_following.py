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
)
from controllers.planning.safety import SafetyConfig, front_gap_needed, rear_gap_needed
from iits_mj.core.neighbors import Neighbor
from tests.controllers.planning.speed_plan_in_python import LEAST_ROOM, required_deceleration

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


def test_required_deceleration_stops_the_closing_exactly_at_the_margin():
    gap, speed, lead_speed, margin = 50.0, 20.0, 12.0, 6.0
    braking = required_deceleration(gap, speed, lead_speed, margin)
    duration = (speed - lead_speed) / braking
    left = gap - (speed - lead_speed) * duration + 0.5 * braking * duration**2
    assert left == pytest.approx(margin)
    # A larger margin leaves less room, hence needs more braking.
    assert required_deceleration(gap, speed, lead_speed, 2.0 * margin) > braking


def test_required_deceleration_is_finite_within_the_margin():
    assert required_deceleration(2.0, 6.0, 4.0, 3.0) == pytest.approx(2.0**2 / (2.0 * LEAST_ROOM))


@pytest.mark.parametrize(("speed", "acceleration"), [(10.0, 1.5), (10.0, -2.0), (3.0, -0.4)])
def test_the_predicted_lead_is_the_integral_of_its_fading_acceleration(speed, acceleration):
    lead, step = Lead(20.0, speed, acceleration), 1e-3
    times = np.arange(0.0, 4.0, step) + 0.5 * step
    speeds = speed + np.cumsum(acceleration * np.exp(-0.5 * times)) * step
    way, reached = lead.at(4.0)
    assert reached == pytest.approx(speeds[-1], abs=2e-3)
    assert way == pytest.approx(speeds.sum() * step, abs=5e-3)
    assert lead.at(0.0) == (0.0, speed)


def test_a_lead_at_rest_stays_and_one_that_rolls_back_counts_as_stopped():
    assert Lead(20.0, 0.0, -1.0).at(2.0) == (0.0, 0.0)
    assert Lead(20.0, 0.0).at(2.0) == (0.0, 0.0)
    rolling = Neighbor("car", 9.0, 50.0, 0.0, -1.0, -0.5, 4.5, 1.8)
    assert Lead.of(rolling, 4.0) == Lead(9.0, 0.0, -0.5, 4.0)


def test_the_free_road_acceleration_has_its_power_law_and_ends_at_the_desired_speed():
    a, b, exponent = CONFIG.acceleration_max, CONFIG.deceleration, CONFIG.exponent
    assert idm_acceleration(0.0, 20.0, math.inf, 0.0, CONFIG) == a
    half = idm_acceleration(10.0, 20.0, math.inf, 10.0, CONFIG)
    assert half == pytest.approx(a * (1.0 - 0.5**exponent))
    assert idm_acceleration(20.0, 20.0, math.inf, 20.0, CONFIG) == 0.0
    faster = idm_acceleration(24.0, 20.0, math.inf, 24.0, CONFIG)
    assert faster == pytest.approx(-b * (1.0 - (20.0 / 24.0) ** (a * exponent / b)))


def test_the_gap_to_a_leader_of_equal_speed_is_standstill_gap_plus_time_gap():
    gap = CONFIG.standstill_gap + 15.0 * CONFIG.time_gap
    a = CONFIG.acceleration_max
    assert idm_acceleration(15.0, 20.0, gap, 15.0, CONFIG) == pytest.approx(0.0, abs=1e-12)
    nearer = idm_acceleration(15.0, 20.0, 0.5 * gap, 15.0, CONFIG)
    assert nearer == pytest.approx(a * (1.0 - 2.0**2))
    # The improved model: free acceleration times 1 - ratio^(2 a / free).
    free = a * (1.0 - 0.75**CONFIG.exponent)
    farther = idm_acceleration(15.0, 20.0, 2.0 * gap, 15.0, CONFIG)
    assert farther == pytest.approx(free * (1.0 - 0.5 ** (2.0 * a / free)))
    # Above the desired speed, both terms count within the gap, the free one beyond it.
    above = idm_acceleration(15.0, 12.0, math.inf, 15.0, CONFIG)
    assert idm_acceleration(15.0, 12.0, 2.0 * gap, 15.0, CONFIG) == above < 0.0
    both = idm_acceleration(15.0, 12.0, 0.5 * gap, 15.0, CONFIG)
    assert both == pytest.approx(above + a * (1.0 - 2.0**2))


def test_the_wanted_gap_grows_with_the_closing_speed_and_never_below_the_standstill_gap():
    a, b = CONFIG.acceleration_max, CONFIG.deceleration
    closing = 15.0 * 5.0 / (2.0 * math.sqrt(a * b))
    wanted = CONFIG.standstill_gap + 15.0 * CONFIG.time_gap + closing
    assert idm_acceleration(15.0, 20.0, wanted, 10.0, CONFIG) == pytest.approx(0.0, abs=1e-12)
    # A much faster leader: only the standstill gap is left.
    near = idm_acceleration(5.0, 20.0, CONFIG.standstill_gap, 30.0, CONFIG)
    assert near == pytest.approx(0.0, abs=1e-12)
    # Bumper to bumper, the model stays finite, also with a desired speed of zero.
    assert math.isfinite(idm_acceleration(1.0, 0.0, 0.0, 0.0, CONFIG))
    touching = idm_acceleration(0.0, 10.0, 0.0, 0.0, CONFIG)
    assert touching == pytest.approx(a * (1.0 - (CONFIG.standstill_gap / 0.1) ** 2))


def heuristic(speed, gap, lead_speed, lead_acceleration):
    """Constant-acceleration heuristic: neither vehicle changes its acceleration, no collision."""
    room, lead = gap - CONFIG.standstill_gap, min(lead_acceleration, CONFIG.acceleration_max)
    if lead_speed * (speed - lead_speed) <= -2.0 * room * lead:
        return speed**2 * lead / (lead_speed**2 - 2.0 * room * lead)
    return lead - max(speed - lead_speed, 0.0) ** 2 / (2.0 * room)


@pytest.mark.parametrize(
    ("speed", "gap", "lead_speed", "lead_acceleration"),
    [
        # The leader stops first; the truck reaches it first; it drives on; it accelerates hard.
        (15.0, 20.0, 13.0, -2.0),
        (18.0, 25.0, 10.0, -0.5),
        (15.0, 12.0, 15.0, 0.0),
        (15.0, 9.0, 14.0, 9.0),
        (10.0, 5.0, 10.0, 0.3),
    ],
)
def test_the_acc_model_tempers_idm_by_the_heuristic(speed, gap, lead_speed, lead_acceleration):
    idm = idm_acceleration(speed, 20.0, gap, lead_speed, CONFIG)
    held = heuristic(speed, gap, lead_speed, lead_acceleration)
    assert idm < held
    regain, coolness = CONFIG.regain_deceleration, CONFIG.coolness
    tempered = held + regain * math.tanh((idm - held) / regain)
    found = follow_acceleration(speed, 20.0, gap, lead_speed, lead_acceleration, CONFIG)
    assert found == pytest.approx((1.0 - coolness) * idm + coolness * tempered)
    assert idm < found < held


def test_idm_counts_alone_where_it_is_gentler_and_on_the_free_road():
    idm = idm_acceleration(15.0, 20.0, 150.0, 15.0, CONFIG)
    assert follow_acceleration(15.0, 20.0, 150.0, 15.0, -3.0, CONFIG) == idm
    free = idm_acceleration(15.0, 20.0, math.inf, 0.0, CONFIG)
    assert follow_acceleration(15.0, 20.0, math.inf, 0.0, -3.0, CONFIG) == free
    assert follow_acceleration(15.0, 20.0, 1.0, 15.0, 0.0, CONFIG) < -1.0


def test_a_road_without_limits_has_a_finite_profile_and_a_straight_one_no_curve_speed():
    s = np.array([0.0, 10.0, 20.0])
    assert braking_profile(s, np.full(3, np.inf), 0.5) == pytest.approx(np.full(3, 100.0))
    assert braking_profile(s, np.array([30.0, 30.0, 0.0]), 0.5)[1] == pytest.approx(math.sqrt(10.0))
    assert curve_speed(np.array([0.0, -0.01]), 1.0) == pytest.approx([1000.0, 10.0])
