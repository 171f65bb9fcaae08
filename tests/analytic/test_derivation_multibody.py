"""The linear model against an independent nonlinear planar multibody (`planar_multibody.py`)."""

import dataclasses

import numpy as np
import pytest

from iits_mj.analytic import Kinematic, YawPlane
from iits_mj.parameters import TruckParameters
from tests.analytic.planar_multibody import SIGNALS, PlanarTruck, disagreement, ramp_step

PARAMETERS = TruckParameters.load()
LADEN = YawPlane.from_parameters(PARAMETERS, 36_000.0)
V80 = 80.0 / 3.6


def _road_wheel(degrees):
    return np.deg2rad(degrees) / PARAMETERS.steering.ratio


@pytest.mark.parametrize("degrees", [3.0, 15.0])
@pytest.mark.parametrize(
    ("payload", "speed"),
    [(36_000.0, 80.0), (0.0, 80.0), (36_000.0, 100.0), (18_000.0, 60.0), (9_000.0, 25.0)],
)
@pytest.mark.parametrize("trail", [True, False], ids=["trail", "no trail"])
def test_linear_model_agrees_with_the_multibody_within_1_percent(payload, speed, degrees, trail):
    model = YawPlane.from_parameters(PARAMETERS, payload, pneumatic_trail=trail)
    found = disagreement(model, speed / 3.6, _road_wheel(degrees), 8.0)
    assert set(found) == set(SIGNALS)
    assert max(found.values()) < 0.01, found


def test_linear_model_agrees_with_the_multibody_for_a_truck_unlike_ours():
    model = dataclasses.replace(
        LADEN,
        inertia=np.array([LADEN.inertia[0], 3.0e5]),
        cg=np.array([LADEN.cg[0], 4.0]),
        couplings=LADEN.reference + np.array([2.6]),
        cornering=LADEN.cornering * [1.0, 0.8, 1.3, 1.2, 1.0, 0.7],
    )
    assert max(disagreement(model, 22.0, 0.001, 8.0).values()) < 0.01


def test_disagreement_falls_with_the_square_of_the_steer_angle():
    """The rest is the multibody's geometry: no linear term differs."""
    large, small = (disagreement(LADEN, V80, _road_wheel(d), 8.0) for d in (30.0, 10.0))
    for name in SIGNALS:
        assert large[name] / small[name] == pytest.approx(9.0, rel=0.15), name


def test_linear_model_leaves_1_percent_within_3_degrees_of_the_road_wheels_at_80_kmh():
    assert max(disagreement(LADEN, V80, np.deg2rad(3.5), 8.0).values()) > 0.01


@pytest.mark.parametrize("name", ["inertia", "couplings", "cg"])
def test_comparison_notices_a_number_that_is_5_percent_off(name):
    wrong = dataclasses.replace(LADEN, **{name: 1.05 * getattr(LADEN, name)})
    time = np.linspace(0.0, 8.0, 801)
    right, other = (
        PlanarTruck(model).drive(V80, ramp_step(_road_wheel(15.0)), time)
        for model in (LADEN, wrong)
    )
    difference = right.articulation - other.articulation
    assert np.sqrt(np.mean(difference**2) / np.mean(right.articulation**2)) > 0.01


def test_multibody_keeps_its_hitch_closed_and_its_speed():
    time = np.linspace(0.0, 10.0, 501)
    motion = PlanarTruck(LADEN).drive(V80, ramp_step(_road_wheel(45.0)), time)
    assert motion.hitch_error.max() < 1e-5
    np.testing.assert_allclose(motion.speed, V80, rtol=1e-5)


def test_multibody_without_tires_keeps_its_kinetic_energy():
    free = dataclasses.replace(LADEN, cornering=0.0 * LADEN.cornering)
    time = np.linspace(0.0, 8.0, 401)
    coasting = PlanarTruck(free, hold_speed=False)
    motion = coasting.drive(15.0, lambda now: 0.0, time, spin=(0.8, -0.5))
    assert np.ptp(motion.articulation) > 1.0
    np.testing.assert_allclose(motion.energy, motion.energy[0], rtol=1e-5)


def test_slow_multibody_off_tracks_like_the_kinematic_model():
    lengths = Kinematic.from_parameters(PARAMETERS)
    time = np.linspace(0.0, 100.0, 1001)
    motion = PlanarTruck(LADEN).drive(1.5, lambda now: 0.08 * min(now / 5.0, 1.0), time)
    # The scrub of tandem and tri-axle makes a slow truck differ a little from the slip-free one.
    phi = lengths.L * motion.yaw_rate[-1] / motion.speed[-1]
    psi = -np.arctan2(lengths.hitches[0], lengths.L / np.tan(phi)) - np.arcsin(
        lengths.lengths[0] / np.hypot(lengths.hitches[0], lengths.L / np.tan(phi))
    )
    assert motion.articulation[-1] == pytest.approx(-psi, rel=0.05)
