"""Bends of maps that netconvert wrote become arcs between the same tangents."""

from __future__ import annotations

import math

import numpy as np
import pytest

from iits_mj.road.converted import with_arcs
from iits_mj.road.elements import Lane, LaneSection, OpenDriveMap, Road, Signal
from iits_mj.road.geometry import Line, ParamPoly3
from iits_mj.road.polynomials import Cubic


def corner(before: float, after: float) -> Road:
    """20 m straight on, then a right angle to the left over the legs `before` and `after`."""
    u, v = (0.0, 2.0 * before, -before, 0.0), (0.0, 0.0, after, 0.0)
    length = ParamPoly3(20.0, 20.0, 0.0, 0.0, 1.0, u, v, True).curve_length
    bend = ParamPoly3(20.0, 20.0, 0.0, 0.0, length, u, v, True)
    lane = Lane(-1, widths=(Cubic(0.0, 3.0, 1.0 / (20.0 + length)),))
    return Road(
        id="1",
        length=20.0 + length,
        geometries=(Line(0.0, 0.0, 0.0, 0.0, 20.0), bend),
        sections=(LaneSection(0.0, (Lane(0, "none"), lane)),),
        elevations=(Cubic(0.0, 5.0), Cubic(20.0, 5.0, 0.05)),
        signals=(Signal("7", 20.0 + length, -2.0),),
    )


@pytest.mark.parametrize(("before", "after"), [(12.0, 12.0), (12.0, 30.0), (25.0, 12.0)])
def test_a_corner_becomes_the_largest_arc_between_its_tangents(before, after):
    old = corner(before, after)
    (road,) = with_arcs(OpenDriveMap((old,))).roads
    end, was = road.plan.evaluate(road.length), old.plan.evaluate(old.length)
    assert (float(end.x), float(end.y)) == pytest.approx((float(was.x), float(was.y)), abs=1e-6)
    assert float(end.heading) == pytest.approx(0.5 * math.pi)
    fine = np.linspace(0.0, road.length, 400)
    assert np.abs(road.plan.evaluate(fine).curvature).max() == pytest.approx(1.0 / 12.0)
    assert all(math.hypot(jump.dx, jump.dy) < 1e-9 for jump in road.plan.jumps())
    straight = 20.0 + before + after - 24.0
    assert road.length == pytest.approx(straight + 12.0 * 0.5 * math.pi)


def test_heights_widths_and_signals_keep_their_places_at_the_ends():
    old = corner(12.0, 12.0)
    (road,) = with_arcs(OpenDriveMap((old,))).roads
    for s, was in ((0.0, 0.0), (20.0, 20.0), (road.length, old.length)):
        assert road.elevation.at(s) == pytest.approx(old.elevation.at(was))
    width = road.sections[0].lane(-1).widths[0]
    assert width.a + width.b * road.length == pytest.approx(4.0)
    assert road.signals[0].s == pytest.approx(road.length)
    # Between them the height neither overshoots nor has a step of its grade.
    fine = road.elevation.evaluate(np.linspace(0.0, road.length, 500))
    assert np.diff(fine).min() > -1e-12
    assert fine.max() <= old.elevation.at(old.length) + 1e-9
