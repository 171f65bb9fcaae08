"""The columns of vehicles on lanes, bit for bit those of the array form of the same equations."""

import numpy as np
import pytest

from iits_mj.core.vehicles import COLUMNS
from iits_mj.kernels import Table
from traffic_bridge.network.lane_table import LanePoses, LaneTable, _pieces

ROW = {name: k for k, name in enumerate(COLUMNS)}
STEP = 0.1


def lane(name):
    rng = np.random.default_rng(int(name))
    count = int(rng.integers(3, 9))
    spacing = float(rng.uniform(1.0, 5.0))
    direction = int(rng.integers(-1, 2))
    station = np.cumsum(rng.uniform(1.0, 5.0, count)) * (direction or 1)
    length = spacing * (count - 1)
    rest = (direction, length, spacing, station, rng.normal(size=count))
    return LaneTable(name, "edge", 0, int(name) - 2, *rest, rng.normal(size=(7, count)))


def expected(tables, center, speed, last_speed):
    """x, y, z, yaw, pitch, roll, yaw rate, acceleration, station and offset, shape (10, n)."""
    pieces = [_pieces(table) for table in tables]
    scale = np.array([1.0 / table.spacing for table in tables])
    direction = np.array([table.direction for table in tables])
    place = center * scale
    piece = np.minimum(np.maximum(place, 0.0).astype(int), [len(rows) - 1 for rows in pieces])
    inside = place - piece
    t = np.minimum(np.maximum(inside, 0.0), 1.0)
    beyond = inside - t
    c = np.array([rows[k] for rows, k in zip(pieces, piece, strict=True)]).T
    xyz = c[:3] + t * (c[3:6] + t * (c[6:9] + t * c[9:12]))
    xyz += beyond * (c[3:6] + t * (2.0 * c[6:9] + 3.0 * t * c[9:12]))
    station, offset, yaw, pitch, roll, curvature = c[12:18] + t * c[18:24]
    station += direction * beyond / scale
    acceleration = (speed - last_speed) / STEP
    return np.array([*xyz, yaw, pitch, roll, curvature * speed, acceleration, station, offset])


def evaluated(poses, names, positions, speed, last_speed, length):
    count = len(names)
    columns = np.zeros((len(COLUMNS), count))
    columns[ROW["speed"]], columns[ROW["length"]] = last_speed, length
    given, centers, columns = Table((speed, positions)), Table(np.zeros(count)), Table(columns)
    lanes = poses.lanes(poses.numbers(names))
    before = poses.evaluate(lanes, given, centers, columns, elapsed=STEP)
    if before:
        poses.evaluate(lanes, given, centers, columns, placed=True, elapsed=STEP)
    return before, lanes, centers.numbers, columns.numbers


@pytest.mark.parametrize("seed", range(20))
def test_columns_on_lanes_have_the_bits_of_the_array_form(seed):
    rng = np.random.default_rng(seed)
    count = int(rng.integers(1, 40))
    poses, names = LanePoses(lane), [str(k) for k in rng.integers(0, 6, count)]
    # Also before the beginning and beyond the end of the lanes.
    position = rng.uniform(-2.0, 30.0, count)
    speed, last_speed, length = rng.uniform(0.0, 30.0, (3, count))
    before, lanes, centers, columns = evaluated(poses, names, position, speed, last_speed, length)
    assert before == (position - 0.5 * length < 0.0).sum()
    np.testing.assert_array_equal(centers, position - 0.5 * length)
    tables = [poses.tables[number] for number in lanes.numbers]
    assert [table.id for table in tables] == names
    assert lanes.route_lanes.tolist() == [table.lane for table in tables]
    assert lanes.directions.tolist() == [table.direction for table in tables]
    rows = [
        *("x", "y", "z", "yaw", "pitch", "roll", "yaw_rate"),
        *("acceleration", "station", "offset"),
    ]
    np.testing.assert_array_equal(
        columns[[ROW[name] for name in rows]], expected(tables, centers, speed, last_speed)
    )
    np.testing.assert_array_equal(columns[ROW["speed"]], speed)
    np.testing.assert_array_equal(columns[ROW["lateral_speed"]], 0.0)
