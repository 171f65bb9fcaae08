"""What the growth figures compare; the times themselves are not tested."""

import numpy as np
import pytest

from benchmarks import growth
from iits_mj.parameters import TruckParameters
from iits_mj.road import RoadMap


def test_the_trucks_of_the_figure_have_more_and_more_wheels():
    wheels = [2 * len(TruckParameters.load(name).axles) for name in growth.TRUCKS]
    assert wheels == [4, 10, 12, 18, 22]


def test_a_long_highway_repeats_the_bends_and_grades_of_the_built_in_one(tmp_path):
    once = RoadMap.builtin().route()
    long = RoadMap.from_opendrive(growth.long_highway(2, tmp_path / "long.xodr")).route()
    assert long.length == pytest.approx(2 * once.length)
    stations = np.arange(100.0, once.length - 100.0, 50.0)
    for start in (0.0, once.length):
        np.testing.assert_allclose(
            long.evaluate(start + stations, 0.0).grade,
            once.evaluate(stations, 0.0).grade,
            atol=1e-9,
        )


def test_a_table_is_drawn_with_a_line_for_each_name():
    assert {name for name, *_ in growth.PANELS} == growth.FIGURES.keys()
    rows = [
        {"figure": name, "line": line, "x": str(x), "y": "1"}
        for name in growth.FIGURES
        for line in ("memory", "drive", "new map", "known map")
        for x in (1, 2)
    ]
    figure = growth.draw(rows)
    assert [len(axes.lines) for axes in figure.axes] == [4] * 7 + [2, 1, 1]
