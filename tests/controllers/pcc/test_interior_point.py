"""The mathematics of the interior-point method: derivatives, linear systems, both runs."""

import numpy as np
import pytest

from controllers.pcc.interior_point import NodeSystem, Settings, minimize
from controllers.pcc.problem import Inequalities, Point, Problem

N = 7


def problem(rng, behind=True, calm=0.3):
    """Returns a small problem with bounds at all nodes; first and fourth node are pinned."""
    low, high = np.full(N + 1, 0.3), np.full(N + 1, 1.6)
    low[[0, 3]] = high[[0, 3]] = 1.0
    earliest = np.zeros(N)
    if behind:
        earliest[2:5] = [2.0, 3.1, 4.0]
    return Problem(
        inertia=3.0,
        air=0.08,
        resistance=rng.uniform(-1.0, 1.2, N),
        fuel=(0.05, 0.75, 0.2),
        calm=calm,
        worth=0.4,
        overrun=0.04,
        full=1.0,
        brake=4.0,
        low=low,
        high=high,
        time_max=7.5,
        earliest=earliest,
    )


def state(rng):
    b = rng.uniform(0.6, 1.3, N + 1)
    b[[0, 3]] = 1.0
    return b, rng.uniform(0.1, 1.0, N)


def difference(function, x, step=1e-6):
    """Returns the Jacobian of a function of a vector by central differences."""
    columns = []
    for i in range(x.size):
        shift = np.zeros(x.size)
        shift[i] = step
        columns.append((function(x + shift) - function(x - shift)) / (2.0 * step))
    return np.array(columns).T


def parts(task, x):
    return Point(task, x[: N + 1], x[N + 1 :])


def lagrangian_slope(task, limits, z):
    def slope(x):
        return np.concatenate(limits.gradient(parts(task, x), z))

    return slope


@pytest.mark.parametrize("behind", [True, False])
def test_gradient_of_the_lagrangian_equals_finite_differences(behind):
    rng = np.random.default_rng(1)
    task = problem(rng, behind)
    limits = Inequalities(task)
    z = rng.uniform(0.0, 2.0, limits.present.size) * limits.present
    x = np.concatenate(state(rng))

    def value(x):
        at = parts(task, x)
        return np.array([at.cost() - z @ limits.values(at)])

    expected = difference(value, x)[0]
    expected[: N + 1][limits.pinned] = 0.0
    found = lagrangian_slope(task, limits, z)(x)
    assert found == pytest.approx(expected, abs=1e-7)


@pytest.mark.parametrize("behind", [True, False])
def test_change_of_the_inequalities_equals_finite_differences(behind):
    rng = np.random.default_rng(2)
    task = problem(rng, behind)
    limits = Inequalities(task)
    x = np.concatenate(state(rng))
    step = rng.normal(size=x.size)
    jacobian = difference(lambda x: limits.values(parts(task, x)), x)
    found = limits.change(parts(task, x), step[: N + 1], step[N + 1 :])
    there = limits.present > 0.0
    assert found[there] == pytest.approx((jacobian @ step)[there], abs=1e-7)


def test_curvature_over_the_nodes_is_the_hessian_with_brakes_eliminated():
    rng = np.random.default_rng(3)
    task = problem(rng, behind=False)
    limits = Inequalities(task)
    b, y = state(rng)
    x = np.concatenate([b, y])
    z = rng.uniform(0.1, 2.0, limits.present.size) * limits.present
    z[limits.nodes] = 0.0
    z[-1] = 0.7
    s = rng.uniform(0.01, 1.0, z.size)
    weights = z / s
    weights[-1] = 0.0  # the trip time is a border of the system, not part of its bands
    hessian = difference(lagrangian_slope(task, limits, z), x, 1e-5)
    jacobian = difference(lambda x: limits.values(parts(task, x)), x)
    hessian = hessian + jacobian.T @ (weights[:, None] * jacobian)
    nodes, brakes = slice(0, N + 1), slice(N + 1, None)
    cross = np.linalg.solve(hessian[brakes, brakes], hessian[brakes, nodes])
    expected = hessian[nodes, nodes] - hessian[nodes, brakes] @ cross
    at = Point(task, b, y)
    rows, _, _ = limits.weights(weights)
    h00, h01, h11, weight, u0, u1 = at.curvature(rows, limits.slopes(at, z)[1])
    found = np.diag(np.append(h00, 0.0) + np.insert(h11, 0, 0.0))
    found += np.diag(h01, 1) + np.diag(h01, -1)
    free = np.flatnonzero(~limits.pinned)
    assert found[np.ix_(free, free)] == pytest.approx(expected[np.ix_(free, free)], abs=1e-3)
    assert weight == pytest.approx(np.diag(hessian[brakes, brakes]), rel=1e-5)
    lever = np.zeros((N, N + 1))
    lever[np.arange(N), np.arange(N)], lever[np.arange(N), np.arange(1, N + 1)] = u0, u1
    assert lever[:, free] == pytest.approx(cross[:, free], abs=1e-4)


def test_convex_part_of_the_curvature_has_no_negative_eigenvalue():
    rng = np.random.default_rng(4)
    for _ in range(50):
        task = problem(rng, calm=5.0)
        at = Point(task, *state(rng))
        weights = tuple(rng.uniform(0.0, 5.0, N) for _ in range(3))
        h00, h01, h11, *_ = at.curvature(weights, rng.normal(0.0, 3.0, N), convex=True)
        assert (h00 >= 0.0).all()
        assert (h00 * h11 - h01**2 >= -1e-9 * h00 * h11).all()


@pytest.mark.parametrize("behind", [True, False])
def test_node_system_agrees_with_a_dense_solver(behind):
    rng = np.random.default_rng(5)
    diagonal, beside = rng.uniform(2.0, 3.0, N + 1), rng.normal(0.0, 0.3, N)
    d0, d1 = -rng.uniform(0.1, 1.0, (2, N))
    weights = rng.uniform(0.0, 3.0, N)
    weights[3] = 0.0
    if not behind:
        weights[:-1] = 0.0
    matrix = np.diag(diagonal) + np.diag(beside, 1) + np.diag(beside, -1)
    slope = np.zeros((N, N + 1))
    slope[np.arange(N), np.arange(N)], slope[np.arange(N), np.arange(1, N + 1)] = d0, d1
    times = np.tril(np.ones((N, N))) @ slope
    matrix += times.T @ (weights[:, None] * times)
    right = rng.normal(size=N + 1)
    system = NodeSystem(diagonal, beside, (d0, d1), weights, behind)
    assert system.definite
    assert system.solve(right) == pytest.approx(np.linalg.solve(matrix, right), abs=1e-12)


def test_node_system_detects_an_indefinite_matrix():
    system = NodeSystem(
        np.array([1.0, -1.0, 1.0]), np.zeros(2), (np.ones(2),) * 2, np.ones(2), False
    )
    assert not system.definite


@pytest.mark.parametrize("guarded", [False, True])
def test_quick_and_guarded_run_end_at_an_optimum(guarded):
    rng = np.random.default_rng(6)
    task = problem(rng, behind=True)
    found = minimize(task, np.ones(N + 1), Settings(guarded=guarded))
    assert found.converged, found.note
    limits = Inequalities(task)
    values = limits.values(Point(task, found.b, found.y))
    assert values[limits.present > 0.0].min() > -1e-7
    # No random step that keeps the limits lowers the cost.
    at = Point(task, found.b, found.y)
    least = at.cost()
    kept = 0
    for _ in range(4000):
        b, y = found.b + rng.normal(0.0, 1e-3, N + 1), found.y + rng.normal(0.0, 1e-3, N)
        b[limits.pinned] = found.b[limits.pinned]
        other = Point(task, np.clip(b, task.low, task.high), np.clip(y, 0.0, task.brake))
        if limits.values(other)[limits.present > 0.0].min() > -1e-9:
            kept += 1
            assert other.cost() > least - 1e-7
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
    task = problem(np.random.default_rng(8), behind=False)
    hopeless = Problem(**{**task.__dict__, "time_max": 3.0})
    found = minimize(hopeless, np.ones(N + 1), Settings(iterations=60))
    assert not found.converged
    assert found.note


def test_time_limit_ends_the_method():
    found = minimize(problem(np.random.default_rng(9)), np.ones(N + 1), Settings(time_limit=0.0))
    assert not found.converged
    assert "time limit" in found.note
