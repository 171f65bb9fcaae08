from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.special import fresnel

from iits_mj.core.angles import wrap_angles
from iits_mj.road.geometry import (
    Arc,
    Geometry,
    Line,
    ParamPoly3,
    PlanView,
    Poly3,
    Spiral,
)

PLACE = (0.0, 12.0, -7.0, 0.6)


def every_geometry() -> list[Geometry]:
    return [
        Line(*PLACE, 80.0),
        Arc(*PLACE, 80.0, -0.01),
        Spiral(*PLACE, 80.0, 0.002, -0.015),
        Poly3(*PLACE, 80.0, (0.0, 0.0, 2e-3, -1e-5)),
        ParamPoly3(*PLACE, 80.0, (0.0, 1.0, 0.0, -1e-6), (0.0, 0.0, 1e-3, 2e-6)),
        ParamPoly3(*PLACE, 80.0, (0.0, 70.0, 15.0, -8.0), (0.0, 0.0, 22.0, -6.0), True),
    ]


@given(
    start=st.floats(-0.05, 0.05),
    end=st.floats(-0.05, 0.05),
    length=st.floats(1.0, 200.0),
)
def test_clothoid_equals_the_numerical_integral_of_its_heading(start, end, length):
    spiral = Spiral(0.0, 0.0, 0.0, 0.0, length, start, end)
    rate = (end - start) / length

    def tangent(s, _):
        angle = s * (start + 0.5 * rate * s)
        return [np.cos(angle), np.sin(angle)]

    solution = solve_ivp(tangent, (0.0, length), [0.0, 0.0], rtol=1e-10, atol=1e-10)
    point = spiral.evaluate(length)
    assert np.allclose([point.x, point.y], solution.y[:, -1], atol=1e-6)


def test_clothoid_from_straight_equals_fresnel_integrals():
    spiral = Spiral(0.0, 0.0, 0.0, 0.0, 120.0, 0.0, 1.0 / 300.0)
    s = np.linspace(0.0, 120.0, 50)
    scale = np.sqrt(np.pi * 120.0 * 300.0)
    sine, cosine = fresnel(s / scale)
    point = spiral.evaluate(s)
    assert np.allclose(point.x, scale * cosine, atol=1e-9)
    assert np.allclose(point.y, scale * sine, atol=1e-9)


@pytest.mark.parametrize("geometry", every_geometry(), ids=lambda g: type(g).__name__)
def test_heading_speed_and_curvature_are_the_derivatives_of_position(geometry):
    s = np.linspace(1.0, 79.0, 40)
    h = 1e-4
    before, here, after = (geometry.evaluate(s + d) for d in (-h, 0.0, h))
    dx, dy = (after.x - before.x) / (2 * h), (after.y - before.y) / (2 * h)
    assert np.allclose(np.hypot(dx, dy), here.speed, atol=1e-7)
    assert np.allclose(wrap_angles(np.arctan2(dy, dx) - here.heading), 0.0, atol=1e-7)
    turn = wrap_angles(after.heading - before.heading) / (2 * h) / here.speed
    assert np.allclose(turn, here.curvature, atol=1e-7)


@pytest.mark.parametrize("geometry", every_geometry(), ids=lambda g: type(g).__name__)
def test_every_geometry_starts_at_its_place_and_heading(geometry):
    point = geometry.evaluate(0.0)
    assert (point.x, point.y, point.heading) == pytest.approx((12.0, -7.0, 0.6), abs=1e-9)


def test_arc_ends_on_its_circle():
    arc = Arc(0.0, 0.0, 0.0, 0.0, 500.0 * np.pi, 1.0 / 500.0)
    point = arc.evaluate(500.0 * np.pi)
    assert (float(point.x), float(point.y)) == pytest.approx((0.0, 1000.0), abs=1e-9)


def test_poly3_is_evaluated_by_arc_length_not_by_u():
    curve = Poly3(0.0, 0.0, 0.0, 0.0, 50.0, (0.0, 0.5, 0.0, 0.0))
    point = curve.evaluate(50.0)
    assert float(np.hypot(point.x, point.y)) == pytest.approx(50.0, abs=1e-9)


def test_normalized_cubic_is_evaluated_at_even_distances():
    curve = ParamPoly3(0.0, 0.0, 0.0, 0.0, 80.0, (0.0, 10.0, 60.0, 10.0), (0.0,) * 4, True)
    point = curve.evaluate(np.linspace(0.0, 80.0, 9))
    assert np.allclose(np.diff(point.x), 10.0, atol=1e-8)


def test_evaluation_at_a_joint_takes_the_record_before_or_after():
    plan = PlanView((Line(0.0, 0.0, 0.0, 0.0, 10.0), Line(10.0, 10.5, 0.0, 0.0, 10.0)))
    assert float(plan.evaluate(10.0, -1).x) == 10.0
    assert float(plan.evaluate(10.0, 1).x) == 10.5
    (jump,) = plan.jumps()
    assert (jump.s, jump.dx, jump.dy, jump.heading) == pytest.approx((10.0, 0.5, 0.0, 0.0))
