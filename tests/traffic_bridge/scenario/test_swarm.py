"""Swarms: vehicles around the truck on all lanes of a map."""

import itertools
import math

import numpy as np
import pytest

from iits_mj.road import RoadMap, Route
from tests.traffic_bridge.scenario.scene import drive
from traffic_bridge import Swarm

RING = {"inner": 100.0, "half_length": 250.0, "half_width": 100.0}


@pytest.fixture(scope="module")
def highway() -> Route:
    return RoadMap.builtin().route()


def ride(road, count=10, seed=0, **settings):
    swarm = Swarm(name="swarm", count=count, speed=22.0, **(RING | settings))
    return drive([swarm], 20.0, road=road, seed=seed)


def test_vehicles_appear_in_the_ring_and_disappear_outside_the_ellipse(highway):
    run = ride(highway)
    seen = set()
    for frame, station in zip(run.frames, run.stations, strict=True):
        x, y = (float(v) for v in highway.evaluate(station, highway.lane_offset(0, station))[:2])
        for row in frame:
            away = math.hypot(row.x - x, row.y - y)
            if row.id not in seen:
                assert 95.0 < away < 270.0, row.id
                seen.add(row.id)
            assert away < 250.0 * 1.05 + 60.0
    assert len(seen) > 10
    assert all(name.startswith("swarm.") for name in seen)


def test_the_swarm_has_its_number_where_there_is_room(highway):
    counts = [len(frame) for frame in ride(highway).frames]
    assert counts[0] == 10
    assert min(counts) >= 6
    assert max(counts) == 10
    assert 10 < len(ride(highway, count=400).frames[0]) < 40


def test_vehicles_of_a_swarm_do_not_touch_each_other(highway):
    for frame in ride(highway, count=60).frames[::20]:
        rows = sorted(frame, key=lambda row: row.station)
        for a, b in itertools.combinations(rows, 2):
            if abs(a.offset - b.offset) < 0.5 * (a.width + b.width):
                assert abs(a.station - b.station) > 0.5 * (a.length + b.length), (a.id, b.id)


def test_types_have_their_shares_and_speeds_are_near_the_desired_one(highway):
    run = ride(highway, count=60, mix={"car": 1.0, "truck": 1.0, "van": 0.0})
    kinds = [row.kind for row in run.frames[0]]
    assert set(kinds) == {"car", "truck"}
    assert 0.25 < kinds.count("truck") / len(kinds) < 0.75
    assert {row.speed for row in run.frames[0]} == {22.0}
    assert np.mean([row.speed for row in run.frames[-1]]) == pytest.approx(22.0, abs=5.0)


def test_a_seed_decides_where_the_vehicles_are(highway):
    assert ride(highway, seed=3).frames == ride(highway, seed=3).frames
    assert ride(highway, seed=3).frames[0] != ride(highway, seed=4).frames[0]


def test_a_swarm_ends_with_its_event(highway):
    swarm = Swarm(name="swarm", count=10, speed=22.0, until=5.0, **RING)
    run = drive([swarm], 6.0, road=highway)
    assert [len(run.frames[k]) for k in (0, 49)] == [10, pytest.approx(10, abs=3)]
    assert len(run.frames[-1]) == 0
