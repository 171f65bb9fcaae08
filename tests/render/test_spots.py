"""Soft spots: drops, spray and the shade below vehicles."""

from __future__ import annotations

import numpy as np

from iits_mj.render.spots import COLUMNS, FALL, rain, shade, spray

AXES = np.eye(3)
GRAY = np.array([0.6, 0.6, 0.6])


def drops(time: float, eye: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> np.ndarray:
    return rain(200, time, np.array(eye), np.zeros(3), GRAY)


def test_drops_are_about_the_eye_and_fall() -> None:
    first, later = drops(1.0), drops(1.02)
    assert first.shape == (200, COLUMNS)
    assert np.abs(first[:, :2]).max() <= 13.0
    assert np.abs(first[:, 2]).max() <= 7.0
    fallen = later[:, 2] - first[:, 2]
    stayed = np.abs(fallen) < 1.0
    assert stayed.mean() > 0.95
    np.testing.assert_allclose(fallen[stayed], -0.02 * FALL, atol=1e-9)


def test_drops_stay_in_the_map_when_the_eye_moves() -> None:
    still, moved = drops(1.0), drops(1.0, (2.0, 0.0, 0.0))
    shift = moved[:, 0] - still[:, 0]
    assert np.mean(np.isclose(shift, -2.0)) > 0.85


def test_same_time_gives_the_same_drops() -> None:
    np.testing.assert_array_equal(drops(3.7), drops(3.7))


def test_spray_needs_water_and_speed_and_is_behind_the_axle() -> None:
    place, forward = np.array([10.0, 0.0, 0.0]), np.array([1.0, 0.0, 0.0])

    def cloud(speed: float, wet: float) -> np.ndarray:
        return spray(place, forward, speed, 2.0, AXES, GRAY, wet)

    assert not len(cloud(5.0, 1.0))
    assert not len(cloud(20.0, 0.0))
    fast, slow = cloud(22.0, 1.0), cloud(12.0, 1.0)
    assert fast[:, 12].max() > slow[:, 12].max() > 0.0
    assert (fast[:, 0] <= 10.0).all()
    assert (fast[:, 2] > 0.0).all()
    assert ((fast[:, 12] >= 0.0) & (fast[:, 12] <= 1.0)).all()


def test_shade_covers_the_vehicle_and_adds_no_light() -> None:
    found = shade(np.zeros(3), np.array([0.0, 1.0, 0.0]), (6.0, 1.25), 0.5)
    assert found.shape == (1, COLUMNS)
    assert np.linalg.norm(found[0, 3:6]) > 6.0
    assert 1.25 < np.linalg.norm(found[0, 6:9]) < 2.0
    np.testing.assert_array_equal(found[0, 9:12], 0.0)
    assert found[0, 12] == 0.5
