import dataclasses
import functools

import numpy as np
import pytest

from controllers.decision.observation import (
    FEATURES,
    OBSERVATION_SIZE,
    ObservationHistory,
    mirrored,
    observation,
    observe_frame,
)
from iits_mj.core.errors import InputError
from iits_mj.core.messages import EgoState, Scene
from iits_mj.road import Route
from tests.controllers.scenes import car

ROUTE = Route.straight(length=5000.0)
EGO = EgoState(station=1000.0, offset=float(ROUTE.lane_offset(1, 1000.0)), speed=16.0)


def frame(*vehicles, ego=EGO):
    return observe_frame(Scene(0.0, ego, tuple(vehicles)), ROUTE, 16.67)


def test_on_an_empty_road_only_the_trucks_row_is_not_zero():
    rows = frame()
    assert rows.shape == (9, 6)
    assert rows.dtype == np.float32
    assert np.allclose(rows[0], [1.0, 1.0, 4.0 / 8.0, 16.0 / 40.0, 0.0, 16.67 / 40.0])
    assert not rows[1:].any()


def test_rows_are_nearest_first_two_behind_and_six_ahead():
    ahead = [car(ROUTE, f"a{i}", 1030.0 + 8.0 * i, 0, 12.0) for i in range(8)]
    behind = [car(ROUTE, f"b{i}", 970.0 - 8.0 * i, 2, 18.0) for i in range(3)]
    rows = frame(*reversed(ahead), *reversed(behind))
    dx = rows[:, 1] * 250.0
    assert np.allclose(dx[3:], [31.0 + 8.0 * i for i in range(6)], atol=1e-3)
    assert np.allclose(dx[1:3], [-29.0, -37.0], atol=1e-3)
    assert np.allclose(rows[3, 2:] * [8, 40, 40, 40], [-4.0, -4.0, 0.0, 4.67], atol=1e-3)


@pytest.mark.parametrize(
    ("station", "seen"),
    [(1248.9, True), (1249.2, False), (1000.0 - 67.4, True), (1000.0 - 67.6, False)],
)
def test_range_is_250_m_ahead_and_50_m_behind_the_trailer(station, seen):
    assert frame(car(ROUTE, "v", station, 0, 12.0)).any(axis=1).sum() == 1 + seen


def test_a_vehicle_on_no_lane_of_the_route_is_not_observed():
    other_side = dataclasses.replace(car(ROUTE, "o", 1040.0, 0, 12.0), lane=-1)
    assert frame(other_side).any(axis=1).sum() == 1


def test_observed_values_are_clipped_to_one():
    rows = frame(car(ROUTE, "rocket", 1050.0, 0, 90.0))
    assert np.abs(rows).max() == 1.0


def test_a_mirrored_observation_equals_that_of_the_mirrored_scene():
    road = Route.straight(length=5000.0, lanes=2, lane_width=4.0)

    def seen(lanes, side):
        offset = float(road.lane_offset(lanes[0], 1000.0)) + 0.25 * side
        ego = EgoState(station=1000.0, offset=offset, speed=16.0, lateral_speed=0.4 * side)
        cars = [
            car(road, f"v{i}", 1040.0 - 70.0 * i, lane, 12.0 + i, lateral_speed=0.3 * side)
            for i, lane in enumerate(lanes[1:])
        ]
        return observation([observe_frame(Scene(0.0, ego, tuple(cars)), road, 16.67)] * 4)

    here, there = seen((0, 1, 0), 1), seen((1, 0, 1), -1)
    assert np.allclose(mirrored(here, 4.0), there, atol=1e-6)
    assert np.allclose(mirrored(np.stack([there, here]), 4.0), [here, there], atol=1e-6)


@pytest.mark.parametrize("field", ["station", "offset", "speed", "lateral_speed"])
def test_nan_is_refused_with_the_vehicle_and_the_number_by_name(field):
    broken = dataclasses.replace(car(ROUTE, "v", 1050.0, 0, 12.0), **{field: float("nan")})
    with pytest.raises(InputError, match=f"'v': {field}"):
        frame(broken)


def test_history_stacks_now_1_2_and_3_seconds_ago():
    history = ObservationHistory()
    for k in range(45):
        rows = np.zeros((9, 6), dtype=np.float32)
        rows[0, 0] = 0.01 * k
        history.add(0.1 * k, rows)
    stacked = history.observation()
    assert stacked.shape == (OBSERVATION_SIZE,) == (216,)
    assert np.allclose(stacked.reshape(4, 9, 6)[:, 0, 0], [0.44, 0.34, 0.24, 0.14])


def test_the_first_frame_replaces_missing_earlier_ones():
    history = ObservationHistory()
    history.add(0.0, frame(car(ROUTE, "v", 1050.0, 0, 12.0)))
    stacked = history.observation().reshape(4, -1)
    assert np.array_equal(stacked[0], stacked[3])


def test_observation_of_frames_equals_that_of_the_history():
    frames = [frame(car(ROUTE, "v", 1040.0 + 5 * i, 0, 12.0)) for i in range(4)]
    assert np.array_equal(observation(frames), np.concatenate([f.ravel() for f in frames]))


def test_history_refuses_times_not_increasing_wrong_shapes_and_nan():
    history = ObservationHistory()
    with pytest.raises(InputError, match="before any frame"):
        history.observation()
    history.add(1.0, frame())
    with pytest.raises(InputError, match="later"):
        history.add(1.0, frame())
    with pytest.raises(InputError, match="shape"):
        history.add(2.0, np.zeros((8, 6), dtype=np.float32))
    bad = frame()
    bad[4, 2] = np.nan
    with pytest.raises(InputError, match=f"{FEATURES[2]} of row ahead2"):
        history.add(2.0, bad)


def test_a_frame_given_as_a_function_is_made_once_and_only_if_it_is_needed():
    history, made = ObservationHistory(), []

    def make(k):
        made.append(k)
        return frame(car(ROUTE, "v", 1040.0 + k, 0, 12.0))

    for k in range(45):
        history.add(0.1 * k, functools.partial(make, k))
    assert not made
    stacked = history.observation()
    assert np.array_equal(stacked, history.observation())
    assert made == [44, 34, 24, 14]
    assert np.array_equal(stacked[:54], make(44).ravel())
    history.add(9.0, lambda: np.full((9, 6), np.nan, dtype=np.float32))
    with pytest.raises(InputError, match="must be finite"):
        history.observation()
