import math

import numpy as np

from controllers.tracking.driveline_inverse import interpolate


def test_one_number_has_the_bits_of_numpys_interpolation() -> None:
    rng = np.random.default_rng(1)
    for _ in range(3000):
        count, digits = rng.integers(1, 70), rng.integers(1, 16)
        # Rounded, so that some places are there twice and some are asked for exactly.
        places, values = np.sort(rng.normal(size=count).round(digits)), rng.normal(size=count)
        for x in (float(rng.normal()), float(rng.choice(places)), float(places[0]), 9.0, -9.0):
            expected = float(np.interp(x, places, values))
            assert interpolate(x, places.tolist(), values.tolist()) == expected


def test_not_a_number_stays_none() -> None:
    assert math.isnan(interpolate(math.nan, [0.0, 1.0], [2.0, 3.0]))
