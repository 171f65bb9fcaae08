"""Look-ups at single places: the compiled form gives the bits of the same formulas in Python."""

from __future__ import annotations

import copy
import math
import pickle
from collections.abc import Callable

import numpy as np
import pytest

from iits_mj.road import RoadMap, Route
from iits_mj.road.opendrive import parse
from iits_mj.road.reference_line import ReferenceLine
from tests.road.opendrive_text import document, road
from tests.road.test_route import BACK, FORTH, HIGHWAY

TURN = 2.0 * math.pi
ARC = '<geometry s="0" x="0" y="0" hdg="0" length="60"><arc curvature="0.05"/></geometry>'
TIGHT = document(road(geometry=ARC, length=60)).encode()
LINES = {
    "highway": HIGHWAY.line,
    "spiral": FORTH.line,
    "spiral back": BACK.line,
    # Offsets reach beyond the bend's center.
    "tight bend": RoadMap(parse(TIGHT, "arc"), "arc").route().line,
    "straight": Route.straight(length=730.0, grade=-0.03).line,
}


class Formulas:
    """Values of a line at single places, in Python."""

    def __init__(self, line: ReferenceLine) -> None:
        self.length, self.spacing = line.length, line.spacing
        self.knots = line.table.numbers[1:]

    def at(self, station: float) -> tuple[list[tuple[float, float]], float, float, float, float]:
        """x, y, z, superelevation with slopes; heading; curvature; the way through; beyond."""
        h = self.spacing
        inside = min(max(station, 0.0), self.length)
        i = min(int(inside / h), len(self.knots) - 2)
        t = inside / h - i
        knot, following = self.knots[i : i + 2].tolist()
        columns = []
        for a, b, slope, next_slope in zip(
            knot[:4], following[:4], knot[4:8], following[4:8], strict=True
        ):
            u, v, rise = h * slope, h * next_slope, b - a
            c, d = 3.0 * rise - 2.0 * u - v, u + v - 2.0 * rise
            value = a + t * (u + t * (c + t * d))
            columns.append((value, (u + t * (2.0 * c + 3.0 * t * d)) / h))
        heading = math.atan2(columns[1][1], columns[0][1])
        heading -= TURN * round((heading - knot[9]) / TURN)
        beyond = station - inside
        curvature = knot[8] + t * (following[8] - knot[8]) if beyond == 0.0 else 0.0
        return columns, heading, curvature, t, beyond

    def evaluate(self, station: float, offset: float) -> tuple[float, ...]:
        ((x, _), (y, _), (z, grade), (roll, _)), heading, curvature, _, beyond = self.at(station)
        sine, cosine = math.sin(heading), math.cos(heading)
        x, y = x + beyond * cosine - offset * sine, y + beyond * sine + offset * cosine
        z = z + beyond * grade + offset * math.tan(roll)
        return x, y, z, heading, curvature, grade, roll

    def height(self, station: float) -> float:
        columns, *_, beyond = self.at(station)
        z, grade = columns[2]
        return z + beyond * grade

    def locate(self, x: float, y: float, station: float) -> tuple[float, float] | None:
        for _ in range(12):
            foot_x, foot_y, _, heading, curvature, _, _ = self.evaluate(station, 0.0)
            sine, cosine = math.sin(heading), math.cos(heading)
            dx, dy = x - foot_x, y - foot_y
            along, offset = dx * cosine + dy * sine, dy * cosine - dx * sine
            step = along / max(1.0 - curvature * offset, 0.2)
            station += min(max(step, -50.0), 50.0)
            if abs(step) < 1e-7:
                return station, offset
        return None


@pytest.fixture(params=LINES)
def line(request: pytest.FixtureRequest) -> ReferenceLine:
    return LINES[request.param]


def places(line: ReferenceLine) -> list[tuple[float, float]]:
    """Stations and offsets anywhere, at knots, at both ends and beyond them."""
    generator = np.random.default_rng(3)
    stations = generator.uniform(-60.0, line.length + 60.0, 600)
    knots = line.spacing * generator.integers(0, round(line.length / line.spacing), 50)
    every = np.concatenate((stations, knots, [-0.0, 0.0, line.length, -1e6, 1e6]))
    return list(zip(every.tolist(), generator.uniform(-30.0, 30.0, every.size), strict=True))


def test_points_are_those_of_the_formulas(line):
    formulas = Formulas(line)
    for station, offset in places(line):
        assert tuple(line.evaluate(station, offset)) == formulas.evaluate(station, float(offset))


def test_heights_and_mean_grades_are_those_of_the_formulas(line):
    formulas = Formulas(line)
    for station, _ in places(line):
        assert line.height(station) == formulas.height(station) == line.evaluate(station).z
        rise = formulas.height(station + 20.0) - formulas.height(station - 20.0)
        assert line.mean_grade(station, 40.0) == rise / 40.0


def test_points_are_located_where_the_formulas_find_them(line):
    formulas = Formulas(line)
    generator = np.random.default_rng(4)
    for station, offset in places(line):
        point = line.evaluate(station, offset)
        near = station + float(generator.uniform(-30.0, 30.0))
        found = formulas.locate(point.x, point.y, near)
        if found is not None and abs(found[1]) < 50.0:
            assert line.locate(point.x, point.y, near) == found


def test_single_places_agree_with_arrays(line):
    stations, offsets = np.array(places(line)).T
    together = np.array(line.evaluate(stations, offsets))
    single = np.array([line.evaluate(*place) for place in places(line)]).T
    np.testing.assert_allclose(single, together, rtol=1e-12, atol=1e-9)


@pytest.mark.parametrize("twin", [copy.deepcopy, lambda route: pickle.loads(pickle.dumps(route))])
def test_a_copy_gives_the_same_places_after_its_original_is_gone(
    twin: Callable[[Route], Route],
) -> None:
    route = RoadMap.builtin().route()
    expected = route.evaluate(1234.5, 1.0)
    other = twin(route)
    del route
    assert other.evaluate(1234.5, 1.0) == expected
    assert other.locate(expected.x, expected.y) == pytest.approx((1234.5, 1.0), abs=1e-6)
    assert other.line.table.address == other.line.table.numbers.ctypes.data


def test_a_station_that_is_not_a_number_has_no_place(line):
    assert all(math.isnan(value) for value in line.evaluate(math.nan))
    assert math.isnan(line.height(math.nan))
    assert line.locate(*line.evaluate(20.0)[:2], math.nan) == pytest.approx((20.0, 0.0), abs=1e-6)


def test_the_center_of_a_bend_is_found_in_the_bend_and_not_on_a_nearer_part_of_the_line():
    records = (
        (0.0, -50.0, 4.0, 0.0, 100.0, 0.0),
        (100.0, 50.0, 4.0, 0.0, 30.0 * math.pi, 1.0 / 30.0),
        (100.0 + 30.0 * math.pi, 50.0, 64.0, math.pi, 25.0, 0.0),
        (125.0 + 30.0 * math.pi, 25.0, 64.0, math.pi, 15.0 * math.pi, 1.0 / 30.0),
        (125.0 + 45.0 * math.pi, -5.0, 34.0, 1.5 * math.pi, 34.0, 0.0),
        (159.0 + 45.0 * math.pi, -5.0, 0.0, 1.5 * math.pi, 2.5 * math.pi, 0.2),
        (159.0 + 47.5 * math.pi, 0.0, -5.0, 0.0, 40.0, 0.0),
    )
    geometry = "".join(
        f'<geometry s="{s!r}" x="{x}" y="{y}" hdg="{heading!r}" length="{length!r}">'
        f'<arc curvature="{curvature!r}"/></geometry>'
        for s, x, y, heading, length, curvature in records
    )
    text = document(road(geometry=geometry, length=199.0 + 47.5 * math.pi))
    line = RoadMap(parse(text.encode(), "bow"), "bow").route().line
    bend = records[5][0]
    station, offset = line.locate(0.0, 0.0, bend + 3.0)
    assert bend - 10.0 < station < bend + 15.0
    assert 2.0 < abs(offset) < 8.0
