"""Handling measures against the nonlinear multibody, and at their limits."""

import dataclasses

import numpy as np
import pytest

from iits_mj.analytic import (
    Kinematic,
    YawPlane,
    critical_speed,
    rearward_amplification,
    simulate,
    single_sine,
    steady_off_tracking,
    step_response,
    understeer_gradient,
    worst_rearward_amplification,
    yaw_rate_gain,
)
from iits_mj.core.errors import InputError
from iits_mj.parameters import TruckParameters
from tests.analytic.planar_multibody import PlanarTruck

PARAMETERS = TruckParameters.load()
LADEN = YawPlane.from_parameters(PARAMETERS, 36_000.0)
EMPTY = YawPlane.from_parameters(PARAMETERS, 0.0)
V80 = 80.0 / 3.6


def _with(A):
    return dataclasses.replace(LADEN.at(V80), A=np.asarray(A, dtype=float))


def _oversteering():
    return dataclasses.replace(LADEN, cornering=LADEN.cornering * [3, 1, 1, 1, 1, 1])


def _swinging():
    """A trailer whose load lies behind its axles."""
    return dataclasses.replace(LADEN, cg=np.array([LADEN.cg[0], LADEN.group(1) + 1.5]))


def _point(motion, model, behind_hitch):
    """Track of a point of the trailer in the multibody, shape (n, 2)."""
    hitch, trailer = float(model.couplings[0]), motion.yaw - motion.articulation
    return np.column_stack(
        [
            motion.x - hitch * np.cos(motion.yaw) - behind_hitch * np.cos(trailer),
            motion.y - hitch * np.sin(motion.yaw) - behind_hitch * np.sin(trailer),
        ]
    )


@pytest.mark.parametrize("model", [LADEN, EMPTY], ids=["laden", "empty"])
def test_rearward_amplification_is_that_of_the_multibody(model):
    time, unit = single_sine(2.5, 12.0, 0.005)
    motion = PlanarTruck(model).drive(V80, lambda now: np.interp(now, time, 0.002 * unit), time)

    def peak(track):
        return np.abs(np.gradient(np.gradient(track, time), time)[2:-2]).max()

    expected = peak(_point(motion, model, model.cg[1])[:, 1]) / peak(motion.y)
    assert rearward_amplification(model.at(V80), 0.4) == pytest.approx(expected, rel=0.01)


@pytest.mark.parametrize("frequency", [0.25, 0.4, 0.9])
def test_frequency_response_is_that_of_the_multibody(frequency):
    periods = 4
    time = np.arange(0.0, 12.0 + periods / frequency, 0.01)
    motion = PlanarTruck(LADEN).drive(
        V80, lambda now: 0.002 * np.sin(2.0 * np.pi * frequency * now), time
    )
    wave = np.exp(-2j * np.pi * frequency * time)
    last = time >= time[-1] - periods / frequency
    gains = LADEN.at(V80).frequency_response(np.array([frequency]))[0, 1:]
    signals = (motion.yaw_rate, motion.trailer_yaw_rate, motion.articulation)
    for signal, gain in zip(signals, gains, strict=True):
        found = 2j * np.mean((signal * wave)[last]) / 0.002
        assert abs(found - gain) < 0.02 * abs(gain)


@pytest.mark.parametrize(("speed", "steer"), [(8.0, 0.02), (V80, 0.006), (28.0, 0.004)])
def test_steady_off_tracking_is_that_of_the_multibody(speed, steer):
    time = np.linspace(0.0, 25.0, 2501)
    motion = PlanarTruck(LADEN).drive(speed, lambda now: steer * min(now / 2.0, 1.0), time)

    def radius(track):
        return np.linalg.norm((track[-1] - track[-3]) / (time[-1] - time[-3])) / motion.yaw_rate[-2]

    front = radius(np.column_stack([motion.x, motion.y]))
    rear = radius(_point(motion, LADEN, LADEN.group(1)))
    expected = rear - front
    found = steady_off_tracking(LADEN.at(speed), front)
    assert found == pytest.approx(expected, abs=0.01 + 0.02 * abs(expected))


def test_off_tracking_changes_its_sign_with_speed_at_the_same_radius():
    values = [steady_off_tracking(LADEN.at(v), 300.0) for v in (3.0, 15.0, 20.0, 25.0)]
    assert values == sorted(values)
    assert values[0] < 0.0 < values[-1]


def test_trailer_repeats_the_tractor_under_slow_steering():
    assert rearward_amplification(LADEN.at(V80), 0.02) == pytest.approx(1.0, abs=0.02)


def test_worst_gain_is_the_greatest_of_steady_sines():
    system = LADEN.at(V80)
    gain, frequency = worst_rearward_amplification(system)
    time = np.arange(0.0, 40.0, 0.01)
    for other in (0.7 * frequency, frequency, 1.4 * frequency):
        swing = simulate(system, time, 1e-2 * np.sin(2.0 * np.pi * other * time))
        late = time > 20.0
        ratio = (
            np.abs(swing.trailer_lateral_acceleration[late]).max()
            / np.abs(swing.steer_axle_acceleration[late]).max()
        )
        assert ratio <= gain * 1.005
        if other == frequency:
            assert ratio == pytest.approx(gain, rel=0.005)


def test_steer_axle_accelerates_as_its_path_bends():
    system = LADEN.at(V80)
    time = np.arange(0.0, 6.0, 0.005)
    swing = simulate(system, time, 1e-4 * np.sin(2.0 * time))
    bend = np.gradient(np.gradient(swing.y, time), time)
    np.testing.assert_allclose(
        bend[3:-3], swing.steer_axle_acceleration[3:-3], atol=2e-3 * np.abs(bend).max()
    )


def test_oversteering_truck_grows_without_swinging_beyond_its_critical_speed():
    model = _oversteering()
    limit = critical_speed(model)
    assert model.at(0.999 * limit).stable
    beyond = model.at(1.05 * limit)
    assert beyond.eigenvalues()[0].imag == 0.0
    assert beyond.damping_ratio() == -1.0
    assert yaw_rate_gain(model.at(0.999 * limit)) > 50.0 * yaw_rate_gain(model.at(0.3 * limit))
    assert understeer_gradient(model) < 0.0


def test_trailer_loaded_behind_its_axles_swings_beyond_its_critical_speed():
    model = _swinging()
    limit = critical_speed(model)
    assert 1.0 < limit < 60.0
    assert model.at(0.999 * limit).stable
    beyond = model.at(1.001 * limit)
    assert beyond.eigenvalues()[0].real > 0.0
    assert beyond.eigenvalues()[0].imag != 0.0
    assert -0.1 < beyond.damping_ratio() < 0.0


def test_critical_speed_does_not_depend_on_where_the_search_ends():
    model = _oversteering()
    assert critical_speed(model, 60.0) == pytest.approx(critical_speed(model, 97.0), rel=1e-6)
    assert critical_speed(model, 0.5 * critical_speed(model)) == np.inf


def test_truck_unstable_at_every_speed_has_critical_speed_zero():
    pushed = dataclasses.replace(LADEN, position=LADEN.position * [1, 1, 1, -1, -1, -1])
    assert critical_speed(pushed) == pytest.approx(0.0, abs=1e-6)


def test_damping_ratio_of_swinging_decaying_drifting_and_growing_motions():
    swing = [[0.0, 1.0, 0.0, 0.0], [-4.0, -1.2, 0.0, 0.0], [0.0, 0.0, -3.0, 0.0], [0, 0, 0, -1.0]]
    assert _with(swing).damping_ratio() == pytest.approx(0.3)
    assert _with(np.diag([-1.0, -2.0, -3.0, -4.0])).damping_ratio() == 1.0
    drift = _with(np.diag([-1.0, -2.0, -3.0, 0.0]))
    assert drift.damping_ratio() == 0.0
    assert not drift.stable
    assert _with(np.diag([-1.0, 0.5, -3.0, -4.0])).damping_ratio() == -1.0


@pytest.mark.parametrize(
    "measure",
    [rearward_amplification, worst_rearward_amplification, lambda s: steady_off_tracking(s, 300.0)],
)
def test_unstable_truck_has_no_steady_measures(measure):
    model = _oversteering()
    with pytest.raises(InputError, match="not stable"):
        measure(model.at(1.1 * critical_speed(model)))


@pytest.mark.parametrize("radius", [0.0, -50.0, float("nan"), float("inf")])
def test_off_tracking_needs_a_radius(radius):
    with pytest.raises(InputError, match="radius"):
        steady_off_tracking(LADEN.at(V80), radius)
    with pytest.raises(InputError, match="radius"):
        Kinematic.from_parameters(PARAMETERS).off_tracking(radius)


@pytest.mark.parametrize("value", [0.0, -1.0, float("nan")])
def test_measures_refuse_impossible_settings(value):
    with pytest.raises(InputError, match="frequency"):
        rearward_amplification(LADEN.at(V80), value)
    with pytest.raises(InputError, match="limit"):
        critical_speed(LADEN, value)
    with pytest.raises(InputError, match="period"):
        single_sine(value, 10.0)


@pytest.mark.parametrize(
    ("time", "steer", "word"),
    [
        ([0.0, 0.1, 0.3], [0.0, 0.0, 0.0], "uniform"),
        ([0.3, 0.2, 0.1], [0.0, 0.0, 0.0], "uniform"),
        ([0.0, float("nan"), 0.2], [0.0, 0.0, 0.0], "uniform"),
        ([0.0, 0.1, 0.2], [0.0, float("nan"), 0.0], "finite"),
        ([0.0], [0.0], "vectors"),
    ],
)
def test_simulation_refuses_bad_samples(time, steer, word):
    with pytest.raises(InputError, match=word):
        simulate(LADEN.at(V80), np.array(time), np.array(steer))


@pytest.mark.parametrize(("speed", "steer"), [(float("nan"), 0.1), (1.0, float("nan")), (1.0, 1.6)])
def test_kinematic_simulation_refuses_bad_samples(speed, steer):
    time = np.linspace(0.0, 1.0, 11)
    with pytest.raises(InputError, match=r"finite"):
        Kinematic.from_parameters(PARAMETERS).simulate(time, np.full(11, speed), np.full(11, steer))


def test_step_starts_with_the_side_force_of_the_steer_axle_alone():
    answer = step_response(LADEN.at(V80), 0.01, 1.0)
    kick = np.linalg.solve(LADEN.inertia_matrix(), LADEN.forces(V80)[:, -1]) * 0.01
    assert answer.lateral_acceleration[0] == pytest.approx(kick[0])
    assert answer.steer_axle_acceleration[0] == pytest.approx(kick[0] + LADEN.reference * kick[1])
