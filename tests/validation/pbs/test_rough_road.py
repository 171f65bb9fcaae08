import mujoco
import numpy as np
import pytest

from iits_mj.core.errors import InputError
from iits_mj.plugin import register
from iits_mj.validation.pbs.maneuvers import StraightPath
from iits_mj.validation.pbs.rough_road import (
    START,
    STEP,
    RoughRoad,
    roughness_index,
    wheel_tracks,
)

PLACE = np.arange(0.0, 2000.0, STEP)


def test_flat_and_evenly_rising_roads_have_no_roughness():
    assert roughness_index(np.zeros_like(PLACE)) == 0.0
    # The golden car settles on the slope within its run-up but for its slow decay.
    assert roughness_index(0.01 * PLACE) < 0.05


def test_roughness_is_proportional_to_the_amplitude():
    track = wheel_tracks(len(PLACE), seed=3)[0]
    assert roughness_index(2.0 * track) == pytest.approx(2.0 * roughness_index(track))


def test_iso_8608_class_a_has_the_known_roughness():
    # 2.2 m/km at the middle of class A, by the literature's relation of index and spectrum.
    tracks = wheel_tracks(40_000, seed=1)
    assert np.mean([roughness_index(track) for track in tracks]) == pytest.approx(2.2, abs=0.2)


def test_wheel_tracks_agree_in_long_waves_and_differ_in_short_ones():
    left, right = np.fft.rfft(wheel_tracks(40_000, seed=1))
    frequency = np.fft.rfftfreq(40_000, STEP)

    def coherence(low, high):
        band = (frequency > low) & (frequency < high)
        cross = np.abs(np.sum(left[band] * np.conj(right[band]))) ** 2
        return cross / np.sum(np.abs(left[band]) ** 2) / np.sum(np.abs(right[band]) ** 2)

    assert coherence(0.01, 0.03) > 0.8
    assert coherence(0.5, 1.0) < 0.1


@pytest.mark.parametrize("seed", [0, 7])
def test_road_has_the_roughness_and_cross_slope_of_the_test(seed):
    path = StraightPath()
    road = RoughRoad.of(path, seed)
    measured = (road.station >= START) & (road.station <= START + path.length)
    found = [roughness_index(road.track(side)[measured]) for side in (1.0, -1.0)]
    assert np.mean(found) == pytest.approx(path.roughness)
    assert found == pytest.approx([path.roughness] * 2, rel=0.1)
    assert road.tilt[measured].mean() == pytest.approx(path.cross_slope, abs=2e-3)
    assert road.height[0] == road.tilt[0] == 0.0
    same = RoughRoad.of(path, seed)
    np.testing.assert_array_equal(road.height, same.height)


def test_wheels_meet_the_heights_of_the_road():
    register()
    spec = mujoco.MjSpec()
    road = RoughRoad.of(StraightPath(length=50.0))
    road.add_to(spec)
    table = spec.compile().numeric_data
    rows = table[4:].reshape(-1, 11)
    assert table[1] == len(road.station)
    np.testing.assert_array_equal(rows[:, 0], road.station)
    np.testing.assert_array_equal(rows[:, 2], road.height)
    np.testing.assert_allclose(rows[:, 7], road.tilt, atol=1e-15)


@pytest.mark.parametrize("track", [np.zeros(10), np.full(1000, np.nan)])
def test_tracks_that_are_short_or_not_finite_are_refused(track):
    with pytest.raises(InputError, match="finite heights"):
        roughness_index(track)
