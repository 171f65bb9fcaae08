import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from controllers.lane_change import LaneChangeConfig, lateral_limit, quintic_change
from controllers.quintic import Quintic, shortest_to_zero
from iits_mj.errors import InputError


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
    size=st.floats(2.5, 5.0), speed=st.floats(4, 25), mass=st.floats(19_000, 55_000),
    radius=st.floats(500, 1e6),
)  # fmt: skip
def test_no_lane_change_breaks_its_lateral_limits(size, speed, mass, radius):
    config = LaneChangeConfig()
    change = quintic_change(0.0, size, 0.0, 0.0, speed, mass, 1.0 / radius, config)
    if change is None:
        return
    acceleration, jerk = change.peak_lateral(speed)
    assert acceleration <= lateral_limit(mass, speed, 1.0 / radius, config) + 1e-9
    assert jerk <= config.jerk + 1e-9
    assert change.length / speed <= config.duration_max + 0.1 or change.length == config.length_min


def test_a_laden_truck_takes_longer_than_an_empty_one():
    lengths = [
        quintic_change(0.0, 4.0, 0.0, 0.0, 20.0, mass, 0.0, LaneChangeConfig()).length
        for mass in (19_000.0, 55_000.0)
    ]
    assert lengths[0] < lengths[1]
    assert 4.5 <= lengths[0] / 20.0 <= lengths[1] / 20.0 <= 8.0


def test_a_tight_curve_at_speed_leaves_no_room_for_a_change():
    assert quintic_change(0, 4.0, 0, 0, 25.0, 55_000.0, 1 / 300.0, LaneChangeConfig()) is None


def test_too_short_a_time_gives_none():
    assert shortest_to_zero(0, 4.0, 0, 0, 20.0, 0.5, 1.0, 2.0, 3.0, 10.0) is None
