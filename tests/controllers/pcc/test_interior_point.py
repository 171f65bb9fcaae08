"""The interior-point method: the derivatives of its reference, and the compiled runs."""

from dataclasses import replace

import numpy as np
import pytest

from controllers.pcc.interior_point import Settings, minimize
from controllers.pcc.problem import Problem
from tests.controllers.pcc import dense_interior_point as dense

N = 7


def problem(rng, behind=True, calm=0.3, n=N, time_max=7.5):
    """Returns a small problem with bounds at all nodes; first and fourth node are pinned."""
    low, high = np.full(n + 1, 0.3), np.full(n + 1, 1.6)
    low[[0, 3]] = high[[0, 3]] = 1.0
    earliest = np.zeros(n)
    if behind:
        earliest[2:5] = [2.0, 3.1, 4.0]
    return Problem(
        inertia=3.0,
        air=0.08,
        resistance=rng.uniform(-1.0, 1.2, n),
        fuel=(0.05, 0.75, 0.2),
        calm=calm,
        worth=0.4,
        overrun=0.04,
        full=1.0,
        brake=4.0,
        low=low,
        high=high,
        time_max=time_max,
        earliest=earliest,
    )


def state(rng):
    b = rng.uniform(0.6, 1.3, N + 1)
    b[[0, 3]] = 1.0
    return np.append(b, rng.uniform(0.1, 1.0, N))


def difference(function, x, step=1e-6):
    """Returns the Jacobian of a function of a vector by central differences."""
    columns = []
    for i in range(x.size):
        shift = np.zeros(x.size)
        shift[i] = step
        columns.append((function(x + shift) - function(x - shift)) / (2.0 * step))
    return np.array(columns).T


@pytest.mark.parametrize("behind", [True, False])
def test_derivatives_of_the_reference_equal_finite_differences(behind):
    rng = np.random.default_rng(1)
    program = dense.Program(problem(rng, behind))
    x, z = state(rng), rng.uniform(0.0, 2.0, np.count_nonzero(program.there))
    slope = difference(lambda x: np.array([program.cost(x) - z @ program.values(x)]), x)[0]
    assert program.gradient(x, z) == pytest.approx(slope * program.free, abs=1e-7)
    assert program.jacobian(x) == pytest.approx(difference(program.values, x), abs=1e-7)
    free = np.ix_(program.free, program.free)
    curvature = difference(lambda x: program.gradient(x, z), x, 1e-5)
    assert program.hessian(x, z)[free] == pytest.approx(curvature[free], abs=1e-6)


def test_convex_part_of_the_curvature_has_no_negative_eigenvalue():
    rng = np.random.default_rng(4)
    for _ in range(50):
        program = dense.Program(problem(rng, calm=5.0))
        z = rng.uniform(0.0, 5.0, np.count_nonzero(program.there))
        convex = program.hessian(state(rng), z, convex=True)
        assert np.linalg.eigvalsh(convex).min() > -1e-9


@pytest.mark.parametrize("behind", [True, False])
@pytest.mark.parametrize("timed", [True, False])
def test_compiled_run_takes_the_steps_of_the_dense_reference(behind, timed):
    rng = np.random.default_rng(5)
    for n in range(5, 40):
        time_max = 1.2 * n if timed else np.inf
        task = problem(rng, behind, rng.choice([0.0, 0.3]), n, time_max)
        task = replace(task, resistance=0.5 * task.resistance)
        guess = rng.uniform(0.5, 1.5, n + 1)
        found = minimize(task, guess, Settings(fallback=False))
        x, prices, iterations = dense.minimize(task, guess)
        assert found.converged, found.note
        # The last step depends on a gradient at the limit of rounding.
        assert abs(found.iterations - iterations) <= 1
        assert np.append(found.b, found.y) == pytest.approx(x, abs=1e-7)
        assert found.prices == pytest.approx(prices, abs=1e-8)


@pytest.mark.parametrize("guarded", [False, True])
@pytest.mark.parametrize("behind", [True, False])
def test_every_step_of_a_compiled_run_is_that_of_the_dense_reference(behind, guarded):
    rng = np.random.default_rng(10)
    for n in (5, 9):
        task = problem(rng, behind, 0.3, n, 1.2 * n)
        guess = rng.uniform(0.3, 1.7, n + 1)
        for iterations in range(1, 14):
            settings = Settings(guarded=guarded, fallback=False, iterations=iterations)
            found = minimize(task, guess, settings)
            x, prices, done = dense.minimize(task, guess, guarded=guarded, iterations=iterations)
            assert found.iterations == done
            assert np.append(found.b, found.y) == pytest.approx(x, abs=1e-8)
            assert found.prices == pytest.approx(prices, rel=1e-5, abs=1e-8)


def test_a_drive_within_all_limits_is_no_optimum_while_its_cost_falls():
    task = replace(problem(np.random.default_rng(11), behind=False), worth=1e3)
    task = replace(task, resistance=0.1 * task.resistance)
    found = minimize(task, np.ones(N + 1), Settings(tolerance=0.11, fallback=False))
    *_, iterations = dense.minimize(task, np.ones(N + 1), 0.11)
    assert found.iterations == iterations > 0


@pytest.mark.parametrize("guarded", [False, True])
def test_quick_and_guarded_run_end_at_an_optimum(guarded):
    rng = np.random.default_rng(6)
    task = problem(rng, behind=True)
    found = minimize(task, np.ones(N + 1), Settings(guarded=guarded))
    assert found.converged, found.note
    program, at = dense.Program(task), np.append(found.b, found.y)
    assert program.values(at).min() > -1e-7
    # No random step that keeps the limits lowers the cost.
    least = program.cost(at)
    kept = 0
    for _ in range(4000):
        other = at + rng.normal(0.0, 1e-3, at.size) * program.free
        other[: N + 1] = np.clip(other[: N + 1], task.low, task.high)
        other[N + 1 :] = np.clip(other[N + 1 :], 0.0, task.brake)
        if program.values(other).min() > -1e-9:
            kept += 1
            assert program.cost(other) > least - 1e-7
    assert kept > 20


def test_quick_and_guarded_run_find_the_same_optimum():
    task = problem(np.random.default_rng(7), behind=False)
    quick = minimize(task, np.ones(N + 1))
    guarded = minimize(task, np.full(N + 1, 0.5), Settings(guarded=True))
    assert quick.converged
    assert guarded.converged
    assert quick.b == pytest.approx(guarded.b, abs=1e-4)
    assert quick.time_price == pytest.approx(guarded.time_price, abs=1e-4)


def test_an_infeasible_problem_ends_with_the_reason():
    task = replace(problem(np.random.default_rng(8), behind=False), time_max=3.0)
    found = minimize(task, np.ones(N + 1), Settings(iterations=60))
    assert not found.converged
    assert found.note.startswith("no drive keeps all limits")


def test_a_guess_that_is_not_a_number_ends_with_the_reason():
    found = minimize(problem(np.random.default_rng(8)), np.full(N + 1, np.nan))
    assert found.note == "the iterates are not finite"


def test_time_limit_ends_the_method():
    found = minimize(problem(np.random.default_rng(9)), np.ones(N + 1), Settings(time_limit=0.0))
    assert not found.converged
    assert found.note == "the time limit of 0 s was reached"
