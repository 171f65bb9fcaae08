"""One call of the speed plan: the equations of its steps, stops, leaders, power and emergencies."""

import dataclasses
import math

import numpy as np
import pytest

from controllers.planning.config import FollowingConfig, Powers
from controllers.planning.following import Lead, follow_acceleration
from controllers.planning.road_preview import RoadPreview
from controllers.planning.speed_plan import (
    SpeedConfig,
    SpeedState,
    most_urgent,
    power_acceleration,
    roll_out,
    speed_cap,
)
from iits_mj.core.messages import SpeedProfile
from iits_mj.parameters import TruckParameters
from iits_mj.road import Route
from iits_mj.road.measured import Lanes, measured_route
from tests.controllers.planning.speed_plan_in_python import _behind, _desired_speed, _to_stop

POWERS = Powers(300e3, 0.006, 3.0)
CONFIG = SpeedConfig(cruise_speed=20.0, powers=POWERS)
FOLLOWING = CONFIG.following
PREVIEW = RoadPreview(Route.straight(length=3_000.0, speed_limit=22.0))
PARAMETERS = TruckParameters.load()
STEP = 0.1


def rolled(speed=15.0, acceleration=0.0, station=500.0, leads=(), mass=19_000.0, **fields):
    """Station, speed, acceleration over 6 s at a cap of 20 m/s."""
    path = PREVIEW.follow(0, station, CONFIG.preview, 150.0)
    cap = fields.pop("cap", np.full(len(path.station), 20.0))
    start = SpeedState(station, speed, acceleration)
    steps = fields.pop("steps", 60)
    preview = fields.pop("preview", PREVIEW)
    return roll_out(start, path, cap, list(leads), mass, preview, steps, STEP, CONFIG, **fields)


def test_station_and_speed_are_the_integrals_of_the_acceleration():
    s, v, a = rolled(leads=[Lead(40.0, 12.0)])
    assert len(s) == len(v) == len(a) == 61
    assert (s[0], v[0]) == (500.0, 15.0)
    assert np.diff(v) == pytest.approx(STEP * a[:-1])
    assert np.diff(s) == pytest.approx(STEP * v[:-1] + 0.5 * STEP**2 * a[:-1])


def test_the_jerk_is_bounded_and_half_as_great_when_accelerating():
    _, _, braking = rolled(speed=20.0, leads=[Lead(12.0, 10.0)])
    change = np.diff([0.0, *braking]) / STEP
    assert change.min() == pytest.approx(-FOLLOWING.jerk_max)
    _, _, driving = rolled(speed=8.0)
    change = np.diff([0.0, *driving]) / STEP
    assert change.max() == pytest.approx(0.5 * FOLLOWING.jerk_max)
    assert driving.max() <= FOLLOWING.acceleration_max


def test_the_plan_brakes_no_harder_than_its_bound_and_pulls_no_harder_than_the_engine():
    _, _, a = rolled(speed=20.0, leads=[Lead(5.0, 2.0)])
    assert a.min() == pytest.approx(-FOLLOWING.deceleration_max)
    _, v, a = rolled(speed=15.0, mass=55_000.0)
    assert a[20] == pytest.approx(power_acceleration(v[20], 55_000.0, 0.0, CONFIG))
    assert 0.2 < a[20] < 0.5


def test_emergency_braking_demands_its_deceleration_at_once_and_ends_at_rest():
    s, v, a = rolled(speed=8.0, emergency=4.0)
    assert a[0] == -4.0
    assert v[10] == pytest.approx(4.0)
    assert s[-1] - s[0] == pytest.approx(8.0**2 / 8.0, abs=0.05)
    assert (v[-1], a[-1]) == (0.0, 0.0)


def test_a_truck_that_comes_to_rest_within_a_step_moves_only_until_then():
    s, v, _ = rolled(speed=0.21, acceleration=-2.0, emergency=2.1, steps=2)
    assert v[1] == pytest.approx(0.0, abs=1e-9)
    assert s[1] - s[0] == pytest.approx(0.21**2 / 4.2, abs=1e-6)
    s, v, _ = rolled(speed=0.05, emergency=2.0, steps=3)
    # It stands after 25 ms of the step of 100 ms, at its whole stopping distance.
    assert s[1] - s[0] == pytest.approx(0.05**2 / 4.0)
    assert s[-1] == s[1]


def test_a_start_below_zero_counts_as_standstill():
    _, v, _ = rolled(speed=-0.3, steps=1)
    assert v[0] == 0.0


@pytest.mark.parametrize("speed", [6.0, 15.0])
def test_the_truck_stops_at_its_stop_and_not_before(speed):
    following = FOLLOWING
    room = speed**2 / (2.0 * following.preview_deceleration) + 20.0
    state, rows = SpeedState(500.0, speed, 0.0), []
    for _ in range(900):
        held = bool(rows) and rows[-1][1] == 0.0
        s, v, a = rolled(state.speed, state.acceleration, state.station, stop=500.0 + room, steps=2)
        state = SpeedState(float(s[1]), float(v[1]), float(a[1]))
        rows.append((state.station, state.speed, state.acceleration))
        if held:
            break
    station, v, a = np.array(rows).T
    assert station[-1] == pytest.approx(500.0 + room, abs=1.0)
    assert station.max() <= 500.0 + room + 0.05
    assert a.min() > -1.4


def test_a_held_truck_keeps_braking_and_does_not_move():
    s, v, a = rolled(speed=0.3, acceleration=-0.5, stop=501.0, hold=True)
    assert v[-1] == 0.0
    assert a[-1] == pytest.approx(-1.2)
    assert s[-1] - s[0] < 0.1
    _, _, a = rolled(speed=0.0, stop=501.0, hold=True)
    assert not a.any()


def test_every_leader_counts_until_its_time_and_the_nearest_decides():
    alone = rolled(speed=20.0)[2]
    assert np.abs(alone).max() < 1e-9
    near = rolled(speed=20.0, leads=[Lead(15.0, 18.0)])[2]
    both = rolled(speed=20.0, leads=[Lead(200.0, 19.0), Lead(15.0, 18.0)])[2]
    assert both == pytest.approx(near)
    assert near[10] < -0.5
    # It no longer counts after its time.
    brief = rolled(speed=20.0, leads=[Lead(15.0, 18.0, until=0.5)])[2]
    assert brief[:6] == pytest.approx(near[:6])
    assert brief[10] > near[10] + 0.3


def test_the_power_bounds_the_acceleration_by_mass_grade_and_speed():
    for speed, grade in ((20.0, 0.0), (12.0, 0.02), (5.0, -0.01)):
        driving = 300e3 / speed - 40_000.0 * 9.81 * (grade + 0.006) - 3.0 * speed**2
        found = power_acceleration(speed, 40_000.0, grade, CONFIG)
        assert found == pytest.approx(max(driving / 40_000.0, 0.05), rel=1e-3)
    # Below 3 m/s the clutch and the gear limit the force, above the power all the plan asks for.
    resisted = 9.81 * 0.006
    assert power_acceleration(1.0, 40_000.0, 0.0, CONFIG) == pytest.approx(
        300e3 / (3.0 * 40_000.0) - resisted, rel=1e-3
    )
    assert power_acceleration(20.0, 40_000.0, 0.10, CONFIG) == 0.05


def test_the_grade_at_the_truck_limits_the_plan():
    hill = RoadPreview(Route.straight(length=3_000.0, grade=0.05, speed_limit=22.0))
    path = hill.follow(0, 500.0, CONFIG.preview, 150.0)
    start = SpeedState(500.0, 15.0, 0.0)
    cap = np.full(len(path.station), 20.0)
    _, v, a = roll_out(start, path, cap, [], 40_000.0, hill, 20, STEP, CONFIG)
    assert a[-1] == pytest.approx(power_acceleration(v[-1], 40_000.0, 0.05, CONFIG), abs=0.01)


def test_the_plan_looks_ahead_by_a_second_for_the_onset_of_braking():
    path = PREVIEW.follow(0, 500.0, CONFIG.preview, 150.0)
    cap = np.where(path.station < 530.0, 20.0, 20.0 - 0.1 * (path.station - 530.0))
    _, v, a = rolled(speed=20.0, cap=np.maximum(cap, 5.0))
    onset = int(np.argmax(a < -0.01)) * STEP
    assert onset == pytest.approx(0.5, abs=0.25)
    # The cap falls by 0.1 1/s: the deceleration is 0.1 v once the plan has settled.
    assert a.min() == pytest.approx(-0.1 * v[int(a.argmin())], abs=0.25)


def test_the_cap_is_the_least_of_profile_limit_and_curve_speed():
    path = PREVIEW.follow(0, 500.0, CONFIG.preview, 150.0)
    assert speed_cap(path, PREVIEW, CONFIG) == pytest.approx(20.0)
    fast = SpeedProfile(np.array([0.0, 3_000.0]), np.array([30.0, 30.0]))
    assert speed_cap(path, PREVIEW, CONFIG, fast) == pytest.approx(22.0)
    slow = SpeedProfile(np.array([0.0, 3_000.0]), np.array([9.0, 9.0]))
    assert speed_cap(path, PREVIEW, CONFIG, slow) == pytest.approx(9.0)


def test_the_cap_falls_before_a_bend_and_is_lower_on_its_inside():
    station = np.arange(0.0, 600.0, 1.0)
    curvature = np.where((station > 200.0) & (station < 260.0), 1.0 / 60.0, 0.0)
    road = measured_route(station, np.zeros(600), curvature=curvature, lanes=Lanes(1, 3.5, 30.0))
    preview = RoadPreview(road)
    path = preview.follow(0, 100.0, 400.0, 100.0)
    bend = (path.station > 210.0) & (path.station < 250.0)
    least = []
    for aside in (10.0, 0.0, -10.0):
        beside = dataclasses.replace(path, offset=np.full_like(path.offset, aside))
        cap = speed_cap(beside, preview, CONFIG)
        least.append(float(cap[bend].mean()))
        expected = math.sqrt(CONFIG.curve_acceleration * (60.0 - aside))
        assert least[-1] == pytest.approx(expected, rel=0.03)
        before = int(np.argmax(path.station > 200.0)) - 1
        assert cap[before] < 1.1 * least[-1]
        assert cap[0] > 1.2 * least[-1]
    assert least == sorted(least)


@pytest.mark.parametrize(
    ("left", "share", "expected"),
    [
        # Share: the needed deceleration over the wanted one.
        (10.0, 0.0, FOLLOWING.acceleration_max),
        (10.0, 0.25, 0.5 * FOLLOWING.acceleration_max),
        (10.0, 0.5, 0.0),
        (10.0, 0.65, -0.4 * 0.5),
        (10.0, 0.9, -0.9 * 0.5),
        (3.0, 1.5, -1.5 * 0.5),
    ],
)
def test_the_last_meters_end_in_finite_time(left, share, expected):
    speed = math.sqrt(2.0 * left * share * 0.5)
    assert _to_stop(speed, left, 0.5, FOLLOWING) == pytest.approx(expected, abs=1e-9)


def test_at_a_stop_the_truck_brakes_firmly():
    assert _to_stop(0.2, 0.04, 0.5, FOLLOWING) == -1.2
    assert _to_stop(0.2, -1.0, 0.5, FOLLOWING) == -1.2


@pytest.mark.parametrize("to_cap", [-0.5, 0.0, 0.3, 0.8, 3.0])
def test_behind_a_leader_the_free_term_does_not_lag_a_rising_reference(to_cap):
    desired = _desired_speed(12.0, 13.0, to_cap, FOLLOWING)
    free = FOLLOWING.acceleration_max * (1.0 - (12.0 / desired) ** FOLLOWING.exponent)
    assert desired >= 13.0
    assert free >= min(to_cap, 0.9 * FOLLOWING.acceleration_max) - 1e-9
    if to_cap <= 0.0:
        assert desired == 13.0


# --- emergencies ----------------------------------------------------------------------------


def test_the_required_braking_counts_reaction_time_and_margin():
    speed, lead_speed, gap = 20.0, 10.0, 60.0
    left = gap - (speed - lead_speed) * CONFIG.reaction_time - CONFIG.emergency_margin
    expected = (speed - lead_speed) ** 2 / (2.0 * left)
    assert most_urgent([Lead(gap, lead_speed)], speed, CONFIG) == pytest.approx(expected)
    assert most_urgent([], speed, CONFIG) == 0.0
    assert most_urgent([Lead(gap, 25.0)], speed, CONFIG) == 0.0
    # The most urgent of several leaders.
    several = [Lead(gap, 25.0), Lead(gap, lead_speed), Lead(200.0, 5.0)]
    assert most_urgent(several, speed, CONFIG) == pytest.approx(expected)


def test_behind_a_leader_that_brakes_to_rest_the_truck_must_stop_too():
    lead = Lead(30.0, 15.0, -4.0)
    way, lead_speed = lead.at(CONFIG.reaction_time)
    room = 30.0 + way - 15.0 * CONFIG.reaction_time - CONFIG.emergency_margin
    expected = 15.0**2 / (2.0 * (room + lead_speed**2 / 8.0))
    assert most_urgent([lead], 15.0, CONFIG) == pytest.approx(expected)
    # A leader that brakes gently does not stop.
    gentle = most_urgent([dataclasses.replace(lead, acceleration=-0.9)], 15.0, CONFIG)
    assert gentle < 0.1
    # Within the margin the result is large but finite.
    close = most_urgent([Lead(1.0, 0.0, -2.0)], 10.0, CONFIG)
    assert 100.0 < close < math.inf


@pytest.mark.parametrize("speed", [0.8, 1.5])
def test_a_truck_that_creeps_within_the_margin_brakes_hard(speed):
    near = 0.5 * CONFIG.emergency_margin
    assert most_urgent([Lead(near, 0.0)], speed, CONFIG) > CONFIG.emergency_onset
    assert most_urgent([Lead(near, speed)], speed, CONFIG) == 0.0


def test_the_default_powers_are_those_of_the_shipped_truck():
    power, rolling, drag = Powers.of(PARAMETERS)
    config = SpeedConfig()
    expected = power / (30_000.0 * 15.0) - 9.81 * rolling - drag * 225.0 / 30_000.0
    assert power_acceleration(15.0, 30_000.0, 0.0, config) == pytest.approx(expected, rel=1e-3)
    assert FollowingConfig() == FOLLOWING


@pytest.mark.parametrize("acceleration", [-1.5, 0.8])
def test_behind_a_leader_its_acceleration_fades_and_ends_with_its_motion(acceleration):
    lead, time = Lead(30.0, 12.0, acceleration), 1.0
    way, speed = lead.at(time)
    fading = acceleration * math.exp(-0.5 * time)
    desired = _desired_speed(14.0, 20.0, 0.3, FOLLOWING)
    gap = 30.0 + way - 14.0
    expected = follow_acceleration(14.0, desired, gap, speed, fading, FOLLOWING)
    assert _behind(14.0, 14.0, time, 20.0, 0.3, [lead], FOLLOWING) == pytest.approx(expected)
    # A leader at rest does not brake any more.
    still = Lead(30.0, 0.0, -1.5)
    expected = follow_acceleration(14.0, desired, 16.0, 0.0, 0.0, FOLLOWING)
    assert _behind(14.0, 14.0, time, 20.0, 0.3, [still], FOLLOWING) == pytest.approx(expected)
