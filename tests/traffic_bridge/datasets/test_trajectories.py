"""Columns and checks of `Trajectories`, and the pairs in them."""

import dataclasses

import numpy as np
import pytest

from iits_mj.core.errors import InputError
from traffic_bridge.datasets import Trajectories, pairs


def two(**changes):
    """A leader at 20 m/s 30 m ahead of its follower at 19 m/s, for 20 s."""
    time = np.arange(201) * 0.1
    values = {
        "source": "two vehicles",
        "ids": ("lead", "tail"),
        "kinds": ("truck", "car"),
        "length": [10.0, 4.0],
        "width": [2.5, 1.8],
        "time": np.tile(time, 2),
        "vehicle": np.repeat([0, 1], 201),
        "lane": np.zeros(402),
        "station": np.concatenate((50.0 + 20.0 * time, 20.0 + 19.0 * time)),
        "offset": np.zeros(402),
        "speed": np.repeat([20.0, 19.0], 201),
        "acceleration": np.zeros(402),
        "leader": np.repeat([-1, 0], 201),
        "lane_count": 2,
    }
    return Trajectories(**{**values, **changes})


def test_gap_of_a_pair_is_from_front_to_the_leaders_rear():
    (pair,) = pairs(two())
    assert (pair.follower, pair.leader, pair.kind) == ("tail", "lead", "car")
    assert pair.duration == pytest.approx(20.0)
    assert pair.gap[0] == pytest.approx(50.0 - 10.0 - 20.0)
    assert pair.gap[-1] == pytest.approx(40.0)


def test_a_pair_ends_where_the_leader_is_lost_or_the_lane_changes():
    whole = two()
    hole = np.ones(402, dtype=bool)
    hole[100] = False  # the leader at 10 s
    first, second = pairs(whole.select(hole), minimum_duration=5.0)
    assert first.time[-1] == pytest.approx(9.9)
    assert second.time[0] == pytest.approx(10.1)
    lane = np.zeros(402)
    lane[201 + 120 :] = 1
    (kept,) = pairs(two(lane=lane), minimum_duration=10.0)
    assert kept.duration == pytest.approx(11.9)
    assert pairs(two(), minimum_duration=21.0) == ()
    with pytest.raises(InputError, match="minimum_duration"):
        pairs(two(), minimum_duration=float("nan"))


def test_rows_of_the_leader_have_the_same_instant():
    found = two()
    rows = found.leader_rows
    assert (rows[:201] == -1).all()
    assert np.array_equal(rows[201:], np.arange(201))
    assert found.find_rows([1, 1, 0], [0.3, 99.0, 20.0]).tolist() == [204, -1, 200]


def test_a_time_window_keeps_the_vehicles_in_it():
    found = two().between(5.0, 6.0)
    assert len(found) == 20
    assert found.duration == pytest.approx(0.9)
    alone = two().select(np.repeat([False, True], 201))
    assert alone.ids == ("tail",)
    assert (alone.leader == -1).all()
    assert two().step == pytest.approx(0.1)


def test_arrays_cannot_be_written_to():
    found = two()
    with pytest.raises(ValueError, match="read-only"):
        found.station[0] = 1.0
    with pytest.raises(dataclasses.FrozenInstanceError):
        found.ids = ()


def _with(column, place, value):
    base = np.array(getattr(two(), column), dtype=float)
    base[place] = value
    return {column: base}


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        (_with("station", 7, np.nan), r"station of vehicle 'lead' at 0.7 s is nan"),
        (_with("speed", 205, -1.0), r"speed of vehicle 'tail' at 0.4 s is -1"),
        (_with("time", 3, 0.2), "sorted by vehicle, then by increasing time"),
        (_with("time", 3, 1e12), "below 1e8 s"),
        (_with("vehicle", 0, 1), "sorted by vehicle"),
        (_with("vehicle", 0, 5), "outside the 2 given"),
        (_with("lane", 9, 2), r"lane of vehicle 'lead' at 0.9 s is 2: must be 0 to 1"),
        (_with("leader", 9, 0), "another vehicle's index"),
        ({"ids": ("a", "a")}, "occurs twice"),
        ({"kinds": ("car", "tank")}, "'tank'; known are"),
        ({"length": [1.0]}, "must be equal numbers"),
        ({"width": [1.0, -2.0]}, "width of vehicle 'tail'"),
        ({"ids": ("a", "b", "c"), "kinds": ("car",) * 3, "length": [4.0] * 3, "width": [2.0] * 3},
         "'c' has no rows"),
        ({"offset": np.zeros(3)}, "different shapes"),
        ({"lane_count": 0}, "0 lanes"),
    ],
)  # fmt: skip
def test_impossible_values_are_named(changes, words):
    with pytest.raises(InputError, match=words):
        two(**changes)


def test_an_unknown_vehicle_is_refused():
    with pytest.raises(InputError, match="no vehicle 'other'"):
        two().rows("other")
    with pytest.raises(InputError, match="no vehicle 2 among 2"):
        two().rows(2)
    with pytest.raises(InputError, match="mask of shape"):
        two().select(np.ones(3, dtype=bool))
