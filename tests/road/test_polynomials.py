from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from iits_mj.road.polynomials import Cubic, PiecewiseCubic, combine, constant

PROFILE = PiecewiseCubic(
    [Cubic(0.0, 1.0, 0.2, -0.01, 1e-4), Cubic(30.0, 4.0, -0.1), Cubic(70.0, 0.0, 0.0, 0.02)]
)


def test_without_records_a_profile_is_zero():
    assert PiecewiseCubic().at(17.0) == 0.0


@given(s=st.floats(-20.0, 120.0))
def test_scalar_and_vector_evaluation_agree(s):
    assert PROFILE.at(s) == float(PROFILE.evaluate(s))


@given(s=st.floats(15.0, 90.0), direction=st.sampled_from([1, -1]))
def test_a_profile_over_travel_has_the_same_values(s, direction):
    start, end = (10.0, 95.0) if direction > 0 else (95.0, 10.0)
    travelled = PROFILE.along(start, end, direction, 1000.0)
    p = 1000.0 + abs(s - start)
    if min(abs(s - 30.0), abs(s - 70.0)) > 1e-6:
        assert np.isclose(travelled.at(p), PROFILE.at(s), atol=1e-9)
        slope = direction * PROFILE.evaluate(s, 1)
        assert np.isclose(travelled.evaluate(p, 1), slope, atol=1e-9)


@given(s=st.floats(0.0, 100.0))
def test_a_combination_is_the_weighted_sum(s):
    other = PiecewiseCubic([Cubic(0.0, 2.0, 0.3), Cubic(45.0, -1.0, 0.0, 1e-3)])
    total = combine([(1.0, PROFILE), (-2.0, other), (1.0, constant(5.0))], 3.0)
    assert np.isclose(total.at(s), PROFILE.at(s) - 2.0 * other.at(s) + 8.0, atol=1e-9)


def test_derivatives_equal_finite_differences():
    s, h = np.array([5.0, 40.0, 90.0]), 1e-4
    slope = (PROFILE.evaluate(s + h) - PROFILE.evaluate(s - h)) / (2 * h)
    assert np.allclose(PROFILE.evaluate(s, 1), slope, atol=1e-7)
    bend = (PROFILE.evaluate(s + h, 1) - PROFILE.evaluate(s - h, 1)) / (2 * h)
    assert np.allclose(PROFILE.evaluate(s, 2), bend, atol=1e-7)
