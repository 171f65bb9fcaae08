"""Known answers of the yaw-plane model: closed forms of one unit, and doubles of the literature.

Rearward amplification is high for doubles with an A-dolly, low for B-doubles: Fancher and Winkler,
"A Methodology for Measuring Rearward Amplification" (3rd Int. Symposium on Heavy Vehicle Weights
and Dimensions, 1992), and Winkler et al., "Evaluation of Innovative Converter Dollies"
(UMTRI-93-47, 1993). In the lane change of FHWA's Comprehensive Truck Size and Weight Limits Study
(2015, figure 15) the second trailer of a double of 28 ft trailers peaks at 0.24 to 0.30 g, its
tractor at about 0.15 g: a factor of 1.6 to 2.
"""

import dataclasses

import numpy as np
import pytest

from iits_mj.analytic import (
    YawPlane,
    amplification,
    critical_speed,
    rearward_amplification,
    simulate,
    single_sine,
    steady_off_tracking,
    understeer_gradient,
    yaw_rate_gain,
)
from iits_mj.core.units import GRAVITY
from tests.analytic.planar_multibody import PlanarTruck, ramp_step

V88 = 88.0 / 3.6
# Cornering stiffness of loaded truck tires over their load [1/rad].
PER_LOAD = 5.5


def combination(*units):
    """A combination with tires in proportion to their static loads.

    Each unit is (mass [kg], CG, radius of gyration, coupling of the next unit, axles), positions
    behind its origin [m]; the first axle of the first unit is steered, the others carry equally.
    """
    loads, pull = [], 0.0
    for index, (mass, cg, _, coupling, axles) in reversed(list(enumerate(units))):
        weight, rear = mass * GRAVITY, axles[1:] if index == 0 else axles
        moment = weight * cg + pull * coupling
        group = moment / np.mean(rear)
        loads = [*([group / len(rear)] * len(rear)), *loads]
        pull = weight + pull - group
        if index == 0:
            loads = [pull, *loads]
    mass, cg, gyration, coupling, axles = zip(*units, strict=True)
    unit = np.repeat(np.arange(len(units)), [len(group) for group in axles])
    return YawPlane(
        mass=np.array(mass),
        inertia=np.array(mass) * np.array(gyration) ** 2,
        cg=np.array(cg),
        couplings=np.array(coupling[:-1]),
        unit=unit,
        position=np.concatenate(axles),
        cornering=PER_LOAD * np.array(loads),
        steer=np.eye(len(unit))[0],
        trail=np.zeros(len(unit)),
        reference=cg[0],
    )


TRACTOR = (9_000.0, 1.5, 1.9, 3.9, (0.0, 3.6, 4.9))
SEMITRAILER = combination(TRACTOR, (33_000.0, 5.5, 3.8, 0.0, (6.6, 7.9, 9.2)))
B_DOUBLE = combination(
    TRACTOR,
    (22_000.0, 4.0, 2.6, 7.4, (5.95, 7.2, 8.45)),
    (28_000.0, 5.7, 3.8, 0.0, (7.55, 8.8, 10.05)),
)
# Two 28 ft trailers of 6.5 m wheelbase, single axles, and an A-dolly of 2 m.
WESTERN_DOUBLE = combination(
    (6_500.0, 1.2, 1.7, 3.3, (0.0, 3.3)),
    (15_000.0, 3.3, 2.3, 7.4, (6.5,)),
    (1_200.0, 1.95, 0.5, 2.0, (2.0,)),
    (15_000.0, 3.3, 2.3, 0.0, (6.5,)),
)
A_DOUBLE = combination(
    TRACTOR,
    (26_000.0, 5.0, 3.4, 10.5, (6.9, 8.1, 9.3)),
    (2_500.0, 4.2, 0.9, 4.4, (3.75, 5.05)),
    (24_000.0, 5.0, 3.4, 0.0, (6.9, 8.1, 9.3)),
)


def bicycle(understeer=0.0):
    """One unit whose front tires are weaker by a share than in proportion to their load."""
    model = combination((18_000.0, 2.4, 2.2, 0.0, (0.0, 4.0)))
    return dataclasses.replace(model, cornering=model.cornering * [1.0 - understeer, 1.0])


def gradient(model):
    """Understeer gradient of the bicycle, `m (b C_r - a C_f) / (C_f C_r L)` [rad s2/m]."""
    (mass,), (a,), (front, rear) = model.mass, model.cg, model.cornering
    length = model.wheelbase
    return mass * ((length - a) * rear - a * front) / (front * rear * length)


@pytest.mark.parametrize("understeer", [-0.2, 0.0, 0.3])
@pytest.mark.parametrize("speed", [5.0, 20.0])
def test_one_unit_has_the_gain_and_eigenvalues_of_the_bicycle_model(understeer, speed):
    model = bicycle(understeer)
    assert understeer_gradient(model) == pytest.approx(gradient(model), rel=1e-9, abs=1e-12)
    expected = speed / (model.wheelbase + gradient(model) * speed**2)
    system = model.at(speed)
    assert yaw_rate_gain(system) == pytest.approx(expected, rel=1e-9)
    # Characteristic polynomial of the textbook's bicycle.
    (mass,), (inertia,), (a,), (front, rear) = model.mass, model.inertia, model.cg, model.cornering
    b = model.wheelbase - a
    total = (front + rear) / (mass * speed) + (a**2 * front + b**2 * rear) / (inertia * speed)
    product = front * rear * model.wheelbase**2 / (mass * inertia * speed**2)
    product += (b * rear - a * front) / inertia
    values = system.eigenvalues()
    assert values.sum().real == pytest.approx(-total, rel=1e-9)
    assert np.prod(values).real == pytest.approx(product, rel=1e-9)


def test_one_unit_is_unstable_beyond_the_textbooks_critical_speed():
    model = bicycle(-0.5)
    expected = np.sqrt(-model.wheelbase / gradient(model))
    assert critical_speed(model) == pytest.approx(expected, rel=1e-6)
    assert critical_speed(bicycle()) == np.inf


def test_one_unit_does_not_amplify_slow_steering():
    assert amplification(bicycle().at(V88), np.array([0.01]))[0, 0] == pytest.approx(1.0, abs=0.01)


@pytest.mark.parametrize(
    "model", [SEMITRAILER, B_DOUBLE, WESTERN_DOUBLE, A_DOUBLE], ids=lambda m: str(m.units)
)
def test_all_units_turn_alike_in_the_steady_state(model):
    system = model.at(V88)
    rates = system.steady_state()[1 : 1 + model.units]
    np.testing.assert_allclose(rates, rates[0], rtol=1e-9)
    assert steady_off_tracking(system, 400.0) > steady_off_tracking(model.at(2.0), 400.0)


def test_b_double_amplifies_less_than_an_a_double():
    semitrailer, b_double, a_double, western = (
        rearward_amplification(model.at(V88))
        for model in (SEMITRAILER, B_DOUBLE, A_DOUBLE, WESTERN_DOUBLE)
    )
    assert 0.8 < semitrailer < 1.2
    assert 1.0 < b_double < 1.5
    assert 1.3 * b_double < min(a_double, western)
    assert 1.6 < western < 2.0


def test_units_of_an_a_double_amplify_from_front_to_rear():
    gains = amplification(WESTERN_DOUBLE.at(V88), np.array([0.4]))[0]
    assert gains[0] < gains[1] < gains[3]


def test_dolly_double_is_less_damped_than_a_b_double_and_less_at_higher_speed():
    b_double, slow, fast = (
        model.at(speed).damping_ratio()
        for model, speed in ((B_DOUBLE, V88), (WESTERN_DOUBLE, 20.0), (WESTERN_DOUBLE, 28.0))
    )
    assert b_double > slow > fast > 0.0


@pytest.mark.parametrize("model", [B_DOUBLE, WESTERN_DOUBLE], ids=["3 units", "4 units"])
def test_linear_model_agrees_with_the_multibody(model):
    time = np.linspace(0.0, 8.0, 801)
    step = ramp_step(0.003)
    peer = PlanarTruck(model).drive(V88, step, time)
    ours = simulate(model.at(V88), time, np.array([step(now) for now in time]))
    for found, expected in (
        (ours.yaw_rates, peer.yaw_rates),
        (ours.articulations, -np.diff(peer.headings, axis=1)),
        (ours.y, peer.y),
    ):
        error = np.sqrt(np.mean((found - expected) ** 2, axis=0) / np.mean(expected**2, axis=0))
        assert np.max(error) < 0.01
    assert peer.hitch_error.max() < 1e-5


def test_response_to_a_ramp_of_steering_is_exact_for_any_step():
    system = B_DOUBLE.at(V88)
    time, unit = single_sine(2.5, 8.0, 0.005)
    fine = simulate(system, time, 0.01 * unit)
    # Straight between every tenth sample: the coarse grid must give the same states there.
    coarse = simulate(system, time[::10], 0.01 * unit[::10])
    straight = np.interp(time, time[::10], 0.01 * unit[::10])
    same = simulate(system, time[: len(time) // 10 * 10], straight[: len(time) // 10 * 10])
    count = len(same.time[::10])
    np.testing.assert_allclose(
        coarse.yaw_rates[:count], same.yaw_rates[::10], atol=1e-12 + 1e-9 * fine.yaw_rate.max()
    )
