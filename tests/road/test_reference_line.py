"""The fast forms of the reference line against the general ones."""

import numpy as np
import pytest

from iits_mj.road import RoadMap
from iits_mj.road.reference_line import ReferenceLine


@pytest.fixture(scope="module")
def line() -> ReferenceLine:
    return RoadMap.builtin().route().line


@pytest.fixture(scope="module")
def places(line: ReferenceLine) -> list[float]:
    random = np.random.default_rng(3).uniform(-60.0, line.length + 60.0, 2000).tolist()
    return [*random, 0.0, line.length, line.spacing, -1.0, line.length + 1.0]


def test_one_point_is_that_of_an_array(line: ReferenceLine, places: list[float]) -> None:
    offsets = np.random.default_rng(4).uniform(-9.0, 9.0, len(places))
    every = np.array(line.evaluate(np.array(places), offsets))
    each = [line.evaluate(s, o) for s, o in zip(places, offsets.tolist(), strict=True)]
    # Sines and arc tangents of NumPy and of Python may differ in the last bit.
    assert np.allclose(np.array(each).T, every, rtol=1e-14, atol=1e-12)


def test_height_has_the_bits_of_the_whole_point(line: ReferenceLine, places: list[float]) -> None:
    assert all(line.height(s) == line.evaluate(s).z for s in places)


def test_kept_pieces_change_nothing(line: ReferenceLine, places: list[float]) -> None:
    first = [line.evaluate(s, 2.0) for s in places]
    again = [line.evaluate(s, 2.0) for s in reversed(places)]
    assert again[::-1] == first
