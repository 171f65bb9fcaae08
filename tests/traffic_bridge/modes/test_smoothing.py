import numpy as np
import pytest

from traffic_bridge.modes.smoothing import (
    REACH,
    SIDE_MARGIN,
    SIDEWAYS,
    Box,
    LateralSmoother,
    Shift,
    _Boxes,
    quintic,
)

SIZE = np.array([[4.7, 1.85]])


def evaluate(c, t):
    return sum(ck * t**k for k, ck in enumerate(c))


def test_quintic_begins_at_the_given_state_and_ends_at_rest():
    c = quintic(-4.0, 0.3, -0.2, 3.5)
    d = [k * ck for k, ck in enumerate(c)][1:]
    dd = [k * ck for k, ck in enumerate(d)][1:]
    assert np.allclose([evaluate(c, 0), evaluate(d, 0), evaluate(dd, 0)], [-4.0, 0.3, -0.2])
    assert np.allclose([evaluate(c, 3.5), evaluate(d, 3.5), evaluate(dd, 3.5)], 0.0, atol=1e-9)


def shown(smoother, names, station, offset, speed, size=SIZE):
    """Offsets at which vehicles of a straight road along x are shown."""
    station, offset, speed = (np.array(a, dtype=float) for a in (station, offset, speed))
    heading, along = np.zeros(len(names)), np.ones(len(names))
    shifts = smoother.update(
        list(names),
        np.round(offset).astype(int),
        np.stack((station, offset, heading)),
        speed,
        size.T,
        np.stack((station, offset, along)),
        0.1,
    )
    for shift in shifts:
        offset[shift.number] += shift.offset
    return offset


def shown_track(smoother, offsets, speed=15.0):
    return np.array(
        [
            shown(smoother, ["a"], [1.5 * k], [offset], [speed])[0]
            for k, offset in enumerate(offsets)
        ]
    )


def test_a_jump_becomes_a_motion_of_the_configured_duration():
    track = shown_track(LateralSmoother(3.5), [0.0] * 10 + [4.0] * 60)
    assert np.abs(np.diff(track)).max() < 0.25
    moving = np.flatnonzero(np.abs(np.diff(track)) > 1e-3)
    assert 2.8 < 0.1 * (moving[-1] - moving[0]) < 3.6
    assert track[-1] == 4.0


def test_a_second_jump_during_the_motion_stays_continuous():
    track = shown_track(LateralSmoother(3.5), [0.0] * 5 + [4.0] * 15 + [0.0] * 60)
    assert np.abs(np.diff(track)).max() < 0.3
    assert track[-1] == 0.0


def test_a_stopped_vehicle_does_not_slide_sideways():
    track = shown_track(LateralSmoother(3.5), [0.0] * 5 + [4.0] * 50, speed=0.0)
    assert np.abs(np.diff(track[6:])).max() < 1e-9


def test_zero_duration_shows_the_instantaneous_change():
    assert shown_track(LateralSmoother(0.0), [0.0, 4.0]).tolist() == [0.0, 4.0]


def test_a_vehicle_that_closes_in_leaves_its_lane_before_contact():
    smoother = LateralSmoother(3.5)
    # A car at 20 m/s, 14 m behind a truck at 10 m/s, changes to the next lane.
    sizes = np.array([[4.7, 1.85], [16.5, 2.55]])
    for k in range(40):
        station = np.array([2.0 * k, 24.6 + 1.0 * k])
        offset = np.array([0.0 if k == 0 else 4.0, 0.0])
        seen = shown(smoother, ["car", "truck"], station, offset, [20.0, 10.0], sizes)
        along = abs(station[1] - station[0]) < 0.5 * sizes[:, 0].sum()
        across = abs(seen[1] - seen[0]) < 0.5 * sizes[:, 1].sum()
        assert not (along and across), k


def test_a_bend_causes_no_lateral_motion_and_a_lane_change_in_a_bend_does():
    smoother = LateralSmoother(3.5)
    radius, sideways = 12.0, []
    for k in range(60):
        angle = 0.05 * k
        # From the lane of 12 m to one 3 m inside it.
        r = radius if k < 20 else radius - 3.0
        pose = np.array([[r * np.sin(angle)], [-r * np.cos(angle)], [angle]])
        road = np.array([[radius * angle], [0.0], [0.0]])
        shifts = smoother.update(
            ["a"], np.array([k < 20]), pose, np.array([6.0]), SIZE.T, road, 0.1
        )
        sideways.append(shifts[0].offset if shifts else 0.0)
    assert sideways[:20] == [0.0] * 20
    assert abs(sideways[20] + 3.0) < 0.1
    assert sideways[-1] == 0.0
    assert np.abs(np.diff(sideways[20:])).max() < 0.25


def test_a_vehicle_that_comes_into_view_again_is_shown_without_lateral_motion():
    smoother = LateralSmoother(3.5)
    assert (
        shown(smoother, ["a", "b"], [0.0, 50.0], [0.0, 0.0], [15.0, 15.0], np.tile(SIZE, (2, 1)))[1]
        == 0.0
    )
    shown(smoother, ["a"], [1.5], [0.0], [15.0])
    seen = shown(smoother, ["a", "b"], [3.0, 53.0], [0.0, 4.0], [15.0, 15.0], np.tile(SIZE, (2, 1)))
    assert seen.tolist() == [0.0, 4.0]


def test_lateral_speed_of_a_slow_vehicle_is_continuous_and_limited_by_its_speed():
    smoother = LateralSmoother(3.5)
    # A car starts close behind a stopped truck, which makes its lane change urgent.
    sizes = np.array([[4.7, 1.85], [16.5, 2.55]])
    place, last, sideways = 0.0, 0.0, []
    for k in range(150):
        speed = min(0.02 * k, 2.0)
        place += 0.1 * speed
        station = np.array([place, 14.0])
        offset = np.array([0.0 if k < 3 else 4.0, 0.0])
        shifts = smoother.update(
            ["car", "truck"],
            np.round(offset).astype(int),
            np.stack((station, offset, np.zeros(2))),
            np.array([speed, 0.0]),
            sizes.T,
            np.stack((station, offset, np.ones(2))),
            0.1,
        )
        now = shifts[0].speed if shifts else 0.0
        assert abs(now) <= 0.5 + 0.7 * speed + 0.05, k
        assert abs(now - last) <= 0.35, k
        sideways.append(now)
        last = now
    assert max(sideways) > 0.3


@pytest.mark.parametrize("seed", range(20))
def test_vehicles_beside_are_those_that_the_conditions_name_one_by_one(seed):
    rng = np.random.default_rng(seed)
    count = int(rng.integers(1, 40))
    station, offset = rng.uniform(0.0, 250.0, count), rng.choice([0.0, 2.0, 3.75, 7.5], count)
    direction, speed = rng.integers(-1, 2, count), rng.uniform(0.0, 30.0, count)
    size = np.array([rng.uniform(4.0, 16.0, count), rng.uniform(1.7, 2.6, count)])
    own = int(rng.integers(count))
    obstacle = Box(station[own], offset[own] + 0.5, 3.0, 16.0, 2.5)
    shift = Shift(own, 0.7, 0.0, 0.0)
    boxes = _Boxes((station, offset, direction), speed, size, [shift], [obstacle])
    box, aim = boxes.box(own), boxes.aim(own)
    assert box.offset == offset[own] + direction[own] * 0.7
    others = [boxes.box(k) for k in range(count) if k != own and direction[k] != 0]
    near = [
        other
        for other in others
        if abs(other.offset - box.offset) < SIDEWAYS and abs(other.station - box.station) < REACH
    ]
    expected = [
        other
        for other in [*near, obstacle]
        if abs(other.offset - box.offset)
        < 0.5 * (other.width + box.width) + SIDE_MARGIN
        <= abs(other.offset - aim)
    ]
    assert boxes.beside(box, aim) == expected
