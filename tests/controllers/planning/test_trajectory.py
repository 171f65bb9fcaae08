import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from controllers.planning.lane_change import LaneChangeConfig, lateral_limit, quintic_change
from controllers.planning.rollover_limits import RollMargins
from controllers.planning.trajectory import Quintic, shortest_to_zero
from iits_mj.core.errors import InputError
from iits_mj.parameters import TruckParameters

MASSES = (19_000.0, 37_000.0, 55_000.0)
MARGINS = RollMargins(TruckParameters.load(), 1.0 / LaneChangeConfig().duration_min)


@given(
    value=st.floats(-8, 8), slope=st.floats(-0.2, 0.2), bend=st.floats(-0.01, 0.01),
    length=st.floats(20, 300),
)  # fmt: skip
def test_quintic_meets_its_six_boundary_conditions(value, slope, bend, length):
    quintic = Quintic.to_zero(100.0, length, value, slope, bend)
    start = [float(part) for part in quintic.evaluate(100.0)[:3]]
    assert start == pytest.approx([value, slope, bend], abs=1e-9)
    end = [float(part) for part in quintic.evaluate(100.0 + length * (1.0 - 1e-9))[:3]]
    assert end == pytest.approx([0.0, 0.0, 0.0], abs=1e-5)


def test_derivatives_agree_with_differences():
    quintic = Quintic.to_zero(0.0, 80.0, 4.0, 0.02, -0.001)
    s = np.linspace(1.0, 79.0, 20)
    h = 1e-3
    for order in range(3):
        ahead, behind = quintic.evaluate(s + h)[order], quintic.evaluate(s - h)[order]
        assert np.allclose((ahead - behind) / (2 * h), quintic.evaluate(s)[order + 1], atol=1e-8)


def test_quintic_is_zero_beyond_its_end_and_constant_before_its_start():
    quintic = Quintic.to_zero(10.0, 50.0, 4.0)
    assert float(quintic.evaluate(61.0)[0]) == 0.0
    assert float(quintic.evaluate(5.0)[0]) == 4.0


@pytest.mark.parametrize("bad", [float("nan"), float("inf")])
def test_a_value_that_is_not_finite_is_named(bad):
    with pytest.raises(InputError, match="finite"):
        Quintic.to_zero(0.0, 50.0, bad)


@settings(max_examples=60, deadline=None)
@given(
    size=st.floats(2.5, 5.0), speed=st.floats(4, 25), mass=st.sampled_from(MASSES),
    felt=st.floats(0.0, 2.0),
)  # fmt: skip
def test_no_lane_change_breaks_its_lateral_limits(size, speed, mass, felt):
    config, margin = LaneChangeConfig(), MARGINS.at(mass)
    limit = lateral_limit(margin, speed, felt, config)
    change = quintic_change(0.0, size, 0.0, 0.0, speed, limit, config)
    if change is None:
        return
    acceleration, jerk = change.peak_lateral(speed)
    assert acceleration <= limit + 1e-9
    assert acceleration * margin.amplified(speed) + felt <= 0.42 * margin.threshold + 1e-9
    assert jerk <= config.jerk + 1e-9
    assert change.length / speed <= config.duration_max + 0.1 or change.length == config.length_min


def length(mass, felt=0.0, speed=20.0, margins=MARGINS):
    limit = lateral_limit(margins.at(mass), speed, felt, LaneChangeConfig())
    change = quintic_change(0.0, 4.0, 0.0, 0.0, speed, limit, LaneChangeConfig())
    return change.length if change else np.inf


def test_a_laden_truck_takes_longer_than_an_empty_one():
    assert length(19_000.0) < length(55_000.0)
    assert 4.5 <= length(19_000.0) / 20.0 <= length(55_000.0) / 20.0 <= 8.0


def test_a_high_load_takes_longer_than_a_low_one():
    low, high = (
        length(
            55_000.0, margins=RollMargins(TruckParameters.load().with_payload_height(h), 1 / 4.5)
        )
        for h in (1.4, 3.0)
    )
    assert low < high


def test_a_bend_makes_a_change_longer_and_a_tight_one_forbids_it():
    assert length(55_000.0) < length(55_000.0, felt=1.1) < np.inf
    assert length(55_000.0, felt=25.0**2 / 300.0) == np.inf


def test_a_duration_that_is_too_short_gives_no_quintic():
    assert shortest_to_zero(0, 4.0, 0, 0, 20.0, 0.5, 1.0, 2.0, 3.0, 10.0) is None
