"""The planner's compiled functions round as their Python forms."""

import dataclasses
import math

import numpy as np
import pytest

from controllers.planning import following, speed_caps, speed_plan
from controllers.planning.config import FollowingConfig, Powers
from controllers.planning.following import Lead
from controllers.planning.road_preview import RoadPreview, gradient
from controllers.planning.speed_plan import SpeedConfig, SpeedState
from controllers.planning.trajectory import Quintic, on_road
from iits_mj.core.angles import wrap_angles
from iits_mj.core.errors import InputError
from iits_mj.core.messages import EgoState, SpeedProfile
from iits_mj.road import RoadMap
from tests.controllers.planning import speed_plan_in_python as in_python

PREVIEW = RoadPreview(RoadMap.builtin().route())
CONFIG = SpeedConfig(powers=Powers(300e3, 0.006, 3.0))


def leads_of(generator):
    """Up to three leaders, some of which brake or no longer count after a time."""
    for gap, speed, until in generator.uniform([0.0, 0.0, 0.0], [120.0, 25.0, 8.0], (3, 3)):
        if generator.random() < 0.5:
            acceleration = generator.choice([0.0, 1.0, -0.5, -3.0])
            yield Lead(gap, speed, float(acceleration), until if until < 4.0 else math.inf)


def test_car_following_and_leaders():
    generator = np.random.default_rng(2)
    for row in generator.uniform([0, 0, 0, 0, -4], [30, 30, 90, 30, 2], (2000, 5)).tolist():
        speed, desired, gap, lead_speed, acceleration = row
        for distance in (gap, math.inf):
            idm = speed, desired, distance, lead_speed, FollowingConfig()
            assert following.idm_acceleration(*idm) == in_python.idm_acceleration(*idm)
            both = speed, desired, distance, lead_speed, acceleration, FollowingConfig()
            assert following.follow_acceleration(*both) == in_python.follow_acceleration(*both)
        lead = Lead(gap, speed, acceleration)
        assert lead.at(desired) == in_python.lead_at(lead, desired)
        leads = list(leads_of(generator))
        urgency = in_python.most_urgent(leads, desired, CONFIG)
        assert speed_plan.most_urgent(leads, desired, CONFIG) == urgency
        power = speed, 20e3 + 1e3 * gap, 0.02 * acceleration, CONFIG
        assert speed_plan.power_acceleration(*power) == in_python.power_acceleration(*power)


def test_speed_plan():
    generator = np.random.default_rng(3)
    for _ in range(300):
        station = float(generator.uniform(200.0, 14_000.0))
        path = PREVIEW.follow(0, station, 400.0, 150.0)
        cap = generator.uniform(0.5, 22.0) + np.cumsum(
            generator.normal(0.0, 0.3, len(path.station))
        )
        speed = float(generator.choice([0.0, 0.2, 1.5, 5.0, 15.0, 22.0]))
        start = SpeedState(station, speed, float(generator.uniform(-2.0, 1.0)))
        stop = station + float(generator.choice([-1.0, 0.5, 3.0, 30.0, 120.0, math.inf]))
        emergency = float(generator.choice([0.0, 0.0, 0.0, 4.0]))
        arguments = (
            *(start, path, np.maximum(cap, 0.0), list(leads_of(generator))),
            *(float(generator.uniform(19e3, 55e3)), PREVIEW, 60, 0.1, CONFIG),
            *(stop, emergency, bool(generator.random() < 0.2)),
        )
        found, expected = speed_plan.roll_out(*arguments), in_python.roll_out(*arguments)
        assert np.array_equal(found, expected)


def test_bound_on_the_speed():
    generator = np.random.default_rng(5)
    for _ in range(200):
        here = float(generator.uniform(0.0, PREVIEW.route.length))
        path = PREVIEW.follow(int(generator.integers(3)), here, 400.0, 150.0)
        offset = path.offset + float(generator.choice([0.0, 200.0, -300.0, math.nan]))
        path = dataclasses.replace(path, offset=offset)
        station = np.sort(generator.uniform(0.0, PREVIEW.route.length, 40))
        profile = SpeedProfile(station, generator.uniform(5.0, 40.0, 40))
        wanted = np.interp(path.station, station, profile.speed)
        expected = in_python.speed_cap(path, PREVIEW, CONFIG, wanted)
        for reference in (profile, SpeedProfile(path.station, wanted)):
            found = speed_plan.speed_cap(path, PREVIEW, CONFIG, reference)
            assert np.array_equal(found, expected)


def test_reference_speed():
    generator = np.random.default_rng(7)
    for _ in range(300):
        here, speed = float(generator.uniform(-300.0, 900.0)), float(generator.uniform(-1.0, 12.0))
        station = 5.0 * np.arange(int(generator.integers(2, 150)))
        nodes = np.sort(generator.uniform(-100.0, 800.0, int(generator.integers(1, 30))))
        profile = SpeedProfile(nodes, generator.uniform(0.0, 25.0, len(nodes)))
        if generator.random() < 0.2:
            profile.speed[-1] = math.nan
        found = speed_caps._reference(station, profile, EgoState(station=here, speed=speed)).speed
        expected = in_python.reference(station, profile, here, speed)
        unknown = np.isnan(expected)
        assert np.array_equal(found[~unknown], expected[~unknown])
        # The launch of an unknown reference is unknown too, or that of the known part.
        assert np.isnan(found[unknown]).any() or not unknown.any()


def test_a_reference_needs_a_speed_for_each_station():
    for count in (0, 3):
        profile = SpeedProfile(np.arange(count) * 10.0, np.ones(0))
        with pytest.raises(InputError, match="reference speed"):
            speed_caps._reference(np.arange(4.0), profile, EgoState())


def points_in_python(path, residual, station):
    """Offset, x, y, z, yaw and curvature as `on_road` gives them."""
    slopes = gradient(path.driven, PREVIEW.step)
    tables = path.driven, slopes, gradient(slopes, PREVIEW.step)
    offset, slope, bend = (np.interp(station, path.station, table) for table in tables)
    if residual is not None:
        value, first, second, _ = residual.evaluate(station)
        offset, slope, bend = offset + value, slope + first, bend + second
    curvature = np.interp(station, PREVIEW.station, PREVIEW.curvature)
    stretch = 1.0 - curvature * offset
    places = zip(station.tolist(), offset.tolist(), strict=True)
    x, y, z, heading, *_ = np.array([PREVIEW.route.evaluate(*place) for place in places]).T
    yaw = heading + np.array(list(map(math.atan2, slope.tolist(), stretch.tolist())))
    ways, turns = np.hypot(np.diff(x), np.diff(y)), wrap_angles(np.diff(yaw))
    moves = ways > 0.02
    pieces = np.zeros((2, len(yaw) + 1))
    pieces[0, 1:-1], pieces[1, 1:-1] = np.where(moves, turns / np.maximum(ways, 0.02), 0.0), moves
    total, count = pieces[:, 1:] + pieces[:, :-1]
    still = curvature / stretch + bend / stretch**2
    bent = np.where(count > 0.0, total / np.maximum(count, 1.0), still)
    return np.array([offset, x, y, z, yaw, bent])


def test_points_of_a_trajectory():
    generator = np.random.default_rng(4)
    for _ in range(200):
        here = float(generator.uniform(0.0, PREVIEW.route.length))
        path = PREVIEW.follow(int(generator.integers(2)), here, 400.0, 150.0)
        residual = None
        if generator.random() < 0.6:
            start = here + float(generator.uniform(-60.0, 20.0))
            residual = Quintic.to_zero(
                start, float(generator.uniform(30.0, 120.0)), 3.5, 0.01, 1e-4
            )
        # The truck may stand, and the plan may reach beyond the end of the road.
        station = here + np.cumsum(generator.choice([0.0, 0.001, 1.6], 61))
        plan = on_road(PREVIEW, path, residual, 3.0, station, station, station, 0.1)
        found = plan.offset, plan.x, plan.y, plan.z, plan.yaw, plan.curvature
        assert np.array_equal(found, points_in_python(path, residual, station), equal_nan=True)


@pytest.mark.parametrize("station", [-5.0, 0.0, 2.5, 7_001.3, 1e5])
def test_values_at_one_station(station):
    path = PREVIEW.follow(0, 7_000.0, 400.0)
    assert path.offset_at(station) == np.interp(station, path.station, path.offset)
    assert path.driven_at(station) == np.interp(station, path.station, path.driven)
    assert PREVIEW.grade_at(station) == np.interp(station, PREVIEW.station, PREVIEW.grade)
