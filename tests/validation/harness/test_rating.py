"""ISO/TS 18571: each score answers to its own error only, with the numbers of its definition."""

import numpy as np
import pytest

from iits_mj.core.errors import InputError
from iits_mj.validation.harness.rating import rate

COUNT = 500
TIME = np.linspace(0.0, 1.0, COUNT)


def pulse(time):
    """A pulse that is over before the end, so that a shift loses nothing."""
    return np.exp(-(((time - 0.4) / 0.08) ** 2))


def test_equal_signals_have_the_greatest_rating():
    rating = rate(pulse(TIME), pulse(TIME))
    assert rating.overall == pytest.approx(1.0)
    assert (rating.grade, rating.shift) == ("excellent", 0)


def test_an_offset_in_the_middle_of_the_corridors_counts_a_quarter():
    # Half-way between 5 and 50 % of the greatest value, squared.
    rating = rate(pulse(TIME) + 0.275, pulse(TIME))
    assert rating.corridor == pytest.approx(0.25, abs=1e-3)
    assert rating.phase == 1.0
    assert rating.slope == pytest.approx(1.0, abs=1e-9)


@pytest.mark.parametrize("samples", [20, -35])
def test_a_shift_costs_phase_only(samples):
    step = TIME[1]
    rating = rate(pulse(TIME - samples * step), pulse(TIME))
    assert rating.shift == samples
    assert rating.phase == pytest.approx(1.0 - abs(samples) / (0.2 * COUNT))
    assert rating.magnitude == pytest.approx(1.0, abs=1e-3)
    assert rating.slope == pytest.approx(1.0, abs=1e-3)


def test_twice_the_signal_has_half_the_slope_score_and_a_low_magnitude_score():
    rating = rate(2.0 * pulse(TIME), pulse(TIME))
    assert rating.slope == pytest.approx(0.5, abs=1e-9)
    assert rating.magnitude < 0.5
    assert rating.phase == 1.0


def test_warping_forgives_a_stretched_course_that_the_corridor_does_not():
    slower = pulse(0.4 + 0.8 * (TIME - 0.4))
    rating = rate(slower, pulse(TIME))
    assert rating.magnitude > 0.98
    assert rating.corridor < 0.98


def test_scores_are_those_of_an_independent_program():
    # objective_rating_metrics 1.3 on PyPI, which was made apart from this code.
    time = 0.01 * np.arange(400)
    wave = np.sin(np.pi * time) * np.exp(-0.2 * time)
    rise, slow = (1.0 / (1.0 + np.exp((t - time) * k)) for t, k in ((1.5, 6.0), (1.7, 4.0)))
    pairs = (
        (np.interp(time - 0.12, time, wave), wave, (0.5440, 0.8500, 1.0, 1.0)),
        (0.8 * wave, wave, (0.7915, 1.0, 0.8607, 0.9)),
        (wave + 0.12 + 0.05 * np.sin(9.0 * time), wave, (0.6684, 1.0, 0.8915, 0.8982)),
        (1.1 * slow, rise, (0.8551, 0.7375, 0.8894, 0.8249)),
    )
    for simulated, measured, expected in pairs:
        rating = rate(simulated, measured)
        scores = (rating.corridor, rating.phase, rating.magnitude, rating.slope)
        np.testing.assert_allclose(scores, expected, atol=6e-5)


def test_rating_is_the_weighted_mean():
    rating = rate(1.2 * pulse(TIME - 0.02), pulse(TIME))
    expected = 0.4 * rating.corridor
    expected += 0.2 * (rating.phase + rating.magnitude + rating.slope)
    assert rating.overall == pytest.approx(expected)


@pytest.mark.parametrize(
    ("simulated", "measured", "match"),
    [
        (pulse(TIME)[:-1], pulse(TIME), "one length"),
        (pulse(TIME)[:20], pulse(TIME)[:20], "50 samples"),
        (np.where(TIME > 0.5, np.nan, 0.0), pulse(TIME), "not finite"),
        (pulse(TIME), np.full(COUNT, 0.3), "always 0.3"),
    ],
)
def test_signals_that_cannot_be_compared_are_refused(simulated, measured, match):
    with pytest.raises(InputError, match=match):
        rate(simulated, measured)
