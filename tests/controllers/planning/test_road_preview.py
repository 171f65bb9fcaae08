"""Short bends keep their radius, and seams do not become bends."""

from types import SimpleNamespace

import numpy as np
import pytest

from controllers.planning.planner import Planner
from controllers.planning.road_preview import gradient, road_curvature
from iits_mj.core.messages import EgoState, Scene
from iits_mj.road.measured import Lanes, measured_route


class Heading:
    """A road with a given heading."""

    def __init__(self, station, heading):
        self._table = station, heading

    def evaluate(self, station, offset):
        return SimpleNamespace(heading=np.interp(station, *self._table))


STATION = np.arange(0.0, 400.0, 5.0)


@pytest.mark.parametrize("radius", [7.5, 15.0, 40.0])
def test_a_quarter_turn_keeps_its_radius(radius):
    arc = 0.5 * np.pi * radius
    road = Heading([0.0, 201.0, 201.0 + arc, 400.0], [0.0, 0.0, 0.5 * np.pi, 0.5 * np.pi])
    found = road_curvature(road, STATION)
    assert found.max() == pytest.approx(1.0 / radius, rel=0.02)
    # The turn is neither lost nor doubled.
    assert found.sum() * 5.0 == pytest.approx(0.5 * np.pi, rel=1e-6)


def test_a_kink_at_a_seam_is_no_bend():
    kink = 0.015
    road = Heading([0.0, 201.0, 201.1, 400.0], [0.0, 0.0, kink, kink])
    found = road_curvature(road, STATION)
    assert found.max() <= kink / 25.0 + 1e-9
    assert found.sum() * 5.0 == pytest.approx(kink)


def test_a_plans_curvature_is_that_of_its_points_and_its_speed_fits_it():
    station = np.arange(0.0, 600.0, 1.0)
    curvature = np.where((station > 200.0) & (station < 219.0), 1.0 / 12.0, 0.0)
    road = measured_route(
        station, np.zeros_like(station), curvature=curvature, lanes=Lanes(1, 3.5, 14.0)
    )
    planner = Planner(road)
    greatest = 0.0
    for place in np.arange(195.0, 225.0, 2.0):
        planner.reset()
        offset = float(planner.preview.follow(0, place, 100.0).driven_at(place))
        plan = planner.plan(
            Scene(0.0, EgoState(station=place, offset=offset, speed=3.0, mass=19e3))
        )
        way, turn = np.hypot(np.diff(plan.x), np.diff(plan.y)), np.diff(plan.yaw)
        middle = 0.5 * (plan.curvature[1:] + plan.curvature[:-1])
        assert np.abs(turn / way - middle).max() < 0.02
        greatest = max(greatest, float(np.abs(plan.speed**2 * plan.curvature).max()))
    assert planner.config.speed.curve_acceleration * 1.1 > greatest > 0.5


def test_the_gradient_equals_numpys_to_the_bit():
    rng = np.random.default_rng(2)
    for count in (2, 3, 110):
        values, step = rng.normal(size=count), float(rng.uniform(1.0, 9.0))
        assert gradient(values, step).tobytes() == np.gradient(values, step).tobytes()
