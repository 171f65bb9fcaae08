import numpy as np
import pytest
from scipy import special

from iits_mj.core.errors import InputError
from iits_mj.road import Route
from iits_mj.road.unevenness import (
    ACROSS,
    ALONG,
    BAND,
    CLASSES,
    JOINT_DEPTH,
    JOINT_GAP,
    LENGTH,
    ROWS,
    Unevenness,
    random_surface,
    random_track,
    spectrum,
)

frequency = np.fft.rfftfreq(ROWS, ALONG)


@pytest.fixture(scope="module")
def surface():
    return random_surface(CLASSES["C"], np.random.default_rng(5))


def power(tracks):
    return 2.0 * ALONG / ROWS * np.mean(np.abs(np.fft.rfft(tracks, axis=0)) ** 2, axis=1)


@pytest.mark.parametrize("column", [0, 11, 40])
def test_each_wheel_track_lies_within_its_class(surface, column):
    # ISO 8608, table C.1: class C spans 128 to 512e-6 m3 at 0.1 per meter.
    density = power(surface[:, [column]])
    for low in BAND[0] * 2.0 ** np.arange(8):
        octave = (frequency >= low) & (frequency < 2.0 * low)
        reduced = np.mean(density[octave] * (frequency[octave] / 0.1) ** 2)
        assert 128e-6 < reduced < 512e-6


def test_spectrum_ends_with_the_band(surface):
    density = power(surface)
    outside = (frequency < BAND[0]) | (frequency > BAND[1])
    assert density[outside].max() < 1e-12 * density.max()


@pytest.mark.parametrize("columns", [4, 8, 16])
def test_tracks_have_the_coherence_of_an_isotropic_surface(surface, columns):
    left, right = (np.fft.rfft(np.roll(surface, shift, 1), axis=0) for shift in (0, columns))
    for low, high in ((0.015, 0.03), (0.08, 0.12), (0.2, 0.3), (0.5, 0.7)):
        band = (frequency > low) & (frequency < high)
        cross = np.sum(np.real(left[band] * np.conj(right[band])))
        x = np.pi * (low + high) * columns * ACROSS
        found = cross / np.sum(np.abs(left[band]) ** 2)
        assert found == pytest.approx(x * special.k1(x), abs=0.05)


def test_track_has_the_variance_of_its_spectrum():
    density = spectrum(frequency, 16e-6, BAND)
    track = random_track(density, ROWS, ALONG, np.random.default_rng(1))
    assert track.var() == pytest.approx(density.sum() / LENGTH, rel=1e-9)


def test_contact_removes_short_waves_and_keeps_long_ones():
    felt = power(Unevenness("C", seed=3).heights())
    made = power(random_surface(CLASSES["C"], np.random.default_rng([3, 0])))
    # The mean over 0.24 m leaves sinc(0.24 n)^2: 0.43 at 2 per meter, 0.16 at 2.8.
    for low, high, bounds in ((0.02, 0.1, (0.97, 1.0)), (2.0, 2.8, (0.16, 0.43))):
        band = (frequency > low) & (frequency < high)
        assert bounds[0] < felt[band].sum() / made[band].sum() < bounds[1]


def test_one_seed_gives_one_surface():
    one, same, other = (Unevenness("B", 20.0, 30.0, seed) for seed in (1, 1, 2))
    np.testing.assert_array_equal(one.heights(), same.heights())
    assert np.abs(one.heights() - other.heights()).max() > 1e-3
    assert not one.heights().flags.writeable


def test_potholes_lie_where_they_are_said_to():
    uneven = Unevenness(potholes=5.0, seed=4)
    station, offset, diameter, depth = uneven.pothole_places().T
    # 16 m of width are 4.6 lanes.
    assert len(station) == pytest.approx(5.0 * 2.048 * 16.0 / 3.5, abs=1.0)
    wide = diameter > 0.7
    felt = [uneven.height(*place) for place in zip(station[wide], offset[wide], strict=True)]
    assert np.all(np.array(felt) < -0.5 * depth[wide])
    assert uneven.heights().min() > -0.06
    assert np.mean(np.abs(uneven.heights()) < 1e-3) > 0.95


def test_joints_cross_the_road_at_their_distance():
    heights = Unevenness(joint_spacing=16.0).heights()
    np.testing.assert_allclose(heights, heights[:, :1].repeat(64, axis=1), atol=1e-12)
    deep = np.flatnonzero(heights[:, 0] < 0.9 * heights.min())
    assert set(np.diff(deep)) <= {1, 127, 128}
    # A tire feels the gap's area over its contact's length.
    assert heights.sum() * ALONG == pytest.approx(-128 * 64 * JOINT_GAP * JOINT_DEPTH)


def test_height_between_the_rows_is_their_mean():
    uneven = Unevenness("D", seed=1)
    grid = uneven.heights()
    assert uneven.height(3 * ALONG, 5 * ACROSS) == grid[3, 5]
    corners = grid[np.ix_([-1, 0], [-1, 0])]
    assert uneven.height(-0.5 * ALONG, -0.5 * ACROSS) == pytest.approx(corners.mean())
    assert uneven.height(LENGTH + 7.3, 1.1) == pytest.approx(uneven.height(7.3, 1.1))


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"roughness": "E"}, "roughness"),
        ({"potholes": -1.0}, "potholes"),
        ({"potholes": float("nan")}, "potholes"),
        ({"joint_spacing": 0.5}, "joint-spacing"),
        ({"seed": -1}, "seed"),
    ],
)
def test_unusable_values_are_refused_by_name(values, message):
    with pytest.raises(InputError, match=message):
        Unevenness(**values)


def test_text_names_what_is_uneven():
    assert str(Unevenness()) == "smooth"
    assert not Unevenness(seed=9)
    text = str(Unevenness("B", 3.0, 30.0, 7))
    assert text == (
        "ISO 8608 class B, 3 potholes per km of lane, expansion joints every 30.12 m, road seed 7"
    )


def test_cross_slope_falls_to_the_right_and_keeps_the_line():
    road = Route.straight(500.0, grade=0.02)
    leaning = road.with_cross_slope(0.03)
    assert leaning.evaluate(100.0, 0.0) == road.evaluate(100.0, 0.0)._replace(superelevation=0.03)
    stations = np.array([50.0, 200.0])
    drop = road.evaluate(stations, -4.0).z - leaning.evaluate(stations, -4.0).z
    np.testing.assert_allclose(drop, 4.0 * np.tan(0.03))
    assert road.evaluate(100.0, 0.0).superelevation == 0.0


@pytest.mark.parametrize("slope", [0.2, -0.11, float("nan")])
def test_cross_slope_at_which_a_truck_tips_is_refused(slope):
    with pytest.raises(InputError, match="cross slope"):
        Route.straight(500.0).with_cross_slope(slope)
