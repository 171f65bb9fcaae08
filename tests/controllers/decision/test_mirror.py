"""Learning from mirror images: mirrored transitions and the symmetry of the fast world."""

import numpy as np
import pytest

from controllers.decision.fast_world.config import LANE_WIDTH, HighwayConfig, Obstacle
from controllers.decision.fast_world.traffic import HighwayTraffic
from controllers.decision.learning.replay import Batch, Transition, mirror_half
from controllers.decision.observation import OBSERVATION_SIZE, mirrored
from iits_mj.road import RoadMap


def batch(symmetric, count=400):
    random = np.random.default_rng(0)
    return Batch.of(
        [
            Transition(
                random.uniform(-1.0, 1.0, OBSERVATION_SIZE).astype(np.float32),
                int(random.integers(3)),
                float(random.normal()),
                0.9,
                random.uniform(-1.0, 1.0, OBSERVATION_SIZE).astype(np.float32),
                symmetric,
            )
            for _ in range(count)
        ]
    )


def test_half_of_a_batch_is_mirrored_with_its_actions():
    before = batch(symmetric=True)
    after = mirror_half(before, np.random.default_rng(1))
    changed = (after.observation != before.observation).any(axis=1)
    assert changed.mean() == pytest.approx(0.5, abs=0.1)
    assert np.array_equal(after.observation[changed], mirrored(before.observation[changed], 4.0))
    assert np.array_equal(after.following[changed], mirrored(before.following[changed], 4.0))
    assert np.array_equal(after.action[changed], 2 - before.action[changed])
    assert np.array_equal(after.action[~changed], before.action[~changed])
    assert np.array_equal(after.following[~changed], before.following[~changed])
    assert np.array_equal(after.reward, before.reward)


def test_lanes_of_the_built_in_road_have_the_width_of_the_mirror_image():
    road = RoadMap.builtin().route()
    stations = np.linspace(0.0, road.length, 50)
    widths = [road.lane_offset(1, s) - road.lane_offset(0, s) for s in stations]
    assert np.allclose(widths, LANE_WIDTH)


def test_transitions_in_traffic_that_keeps_right_are_not_mirrored():
    before = batch(symmetric=False)
    after = mirror_half(before, np.random.default_rng(1))
    assert np.array_equal(after.observation, before.observation)
    assert np.array_equal(after.action, before.action)


def fronts_by_lane(flipped, keeps_right):
    """Simulates a minute of dense traffic behind a slow truck; no vehicle enters or leaves."""
    dense = HighwayTraffic.of(HighwayConfig(0.1, keeps_right=keeps_right), np.random.default_rng(3))
    dense.fill(Obstacle(0.0, 16.5, 8.0, 0))
    # Vehicles that enter are drawn for each lane separately and have no mirror image.
    closed = HighwayConfig(0.0, keeps_right=keeps_right, window_behind=1e5, window_ahead=1e5)
    traffic = HighwayTraffic.of(closed, np.random.default_rng(3))
    traffic.fill(Obstacle(0.0, 16.5, 8.0, 0))  # nothing
    inside = dense.state["vehicles"][0][: dense.front.size][dense.front < 400.0]
    traffic.state["count"] = inside.size
    traffic.state["vehicles"][0][: inside.size] = inside
    if flipped:
        traffic.lane[:] = 1 - traffic.lane
    before = traffic.lane.copy()
    for k in range(300):
        traffic.step([Obstacle(8.0 * 0.2 * k, 16.5, 8.0, int(flipped))])
    return traffic.front, 1 - traffic.lane if flipped else traffic.lane, traffic.lane != before


def test_mirrored_traffic_drives_as_before_unless_it_keeps_right():
    front, lane, changed = fronts_by_lane(False, keeps_right=False)
    other_front, other_lane, _ = fronts_by_lane(True, keeps_right=False)
    assert changed.any()
    assert np.array_equal(lane, other_lane)
    assert np.array_equal(front, other_front)


def test_mirrored_traffic_that_keeps_right_drives_differently():
    _, lane, _ = fronts_by_lane(False, keeps_right=True)
    _, other_lane, _ = fronts_by_lane(True, keeps_right=True)
    assert not np.array_equal(lane, other_lane)
