"""The speed plan follows a reference that rises and falls, alone and behind a vehicle."""

import numpy as np
import pytest

from controllers.planning.following import Lead
from controllers.planning.road_preview import RoadPreview
from controllers.planning.speed_plan import SpeedConfig, SpeedState, roll_out, speed_cap
from iits_mj.core.messages import SpeedProfile
from iits_mj.road import Route

ROUTE = Route.straight(length=3_000.0, speed_limit=40.0)
PREVIEW = RoadPreview(ROUTE)
CONFIG = SpeedConfig(cruise_speed=20.0)


def follow(profile, start, seconds=40.0, mass=19_000.0, leads=()):
    """Station, speed and acceleration of a truck that follows a new plan every 0.1 s."""
    state, rows = start, []
    for k in range(round(10.0 * seconds)):
        path = PREVIEW.follow(0, state.station, CONFIG.preview, 150.0)
        cap = speed_cap(path, PREVIEW, CONFIG, profile)
        ahead = [
            Lead(lead.gap + lead.speed * 0.1 * k - state.station, lead.speed) for lead in leads
        ]
        s, v, a = roll_out(state, path, cap, ahead, mass, PREVIEW, 5, 0.1, CONFIG)
        state = SpeedState(float(s[1]), float(v[1]), float(a[1]))
        rows.append((state.station, state.speed, state.acceleration))
    return np.array(rows).T


def ramp(slope):
    """Speed over station that changes by `slope` per second at 15 to 20 m/s."""
    station = np.arange(0.0, 3_001.0, 10.0)
    squares = 17.0**2 + 2.0 * slope * np.clip(station - 200.0, 0.0, 300.0)
    return SpeedProfile(station, np.sqrt(squares))


@pytest.mark.parametrize("slope", [0.3, 0.1, -0.1, -0.3])
def test_a_rising_or_falling_profile_is_followed_without_lag(slope):
    profile = ramp(slope)
    start = SpeedState(50.0, 17.0, 0.0)
    station, speed, _ = follow(profile, start)
    error = speed - np.interp(station, profile.station, profile.speed)
    assert np.abs(error).max() < 0.12
    assert np.sqrt(np.mean(error**2)) < 0.04


def test_a_set_speed_is_approached_without_overshoot_and_within_the_jerk():
    station = np.array([0.0, 3_000.0])
    _, speed, acceleration = follow(
        SpeedProfile(station, np.full(2, 20.0)), SpeedState(50.0, 15.0, 0.0)
    )
    assert speed.max() < 20.02
    assert speed[-1] == pytest.approx(20.0, abs=0.05)
    assert acceleration.max() <= CONFIG.following.acceleration_max + 1e-9
    assert np.abs(np.diff(acceleration)).max() <= CONFIG.following.jerk_max * 0.1 + 1e-9


def test_a_far_faster_vehicle_does_not_change_the_speed_on_a_profile():
    profile = ramp(0.3)
    start = SpeedState(50.0, 17.0, 0.0)
    alone = follow(profile, start, 25.0)[1]
    behind = follow(profile, start, 25.0, leads=(Lead(400.0, 25.0),))[1]
    assert np.abs(alone - behind).max() < 0.25


def test_a_slower_vehicle_is_followed_at_the_time_gap_whatever_the_profile_says():
    profile = SpeedProfile(np.array([0.0, 3_000.0]), np.array([20.0, 20.0]))
    station, speed, _ = follow(
        profile, SpeedState(50.0, 17.0, 0.0), 60.0, leads=(Lead(150.0, 12.0),)
    )
    gap = 150.0 + 12.0 * 0.1 * len(station) - station[-1]
    wanted = CONFIG.following.standstill_gap + CONFIG.following.time_gap * 12.0
    assert speed[-1] == pytest.approx(12.0, abs=0.2)
    assert gap == pytest.approx(wanted, rel=0.25)
