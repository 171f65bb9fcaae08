"""Least squares with confidence intervals, and the verdict on what a log can show at all."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import stats
from scipy.optimize import least_squares

FloatArray = NDArray[np.float64]

# A parameter whose 95 % interval is wider than +/- this share of its value is not identified.
WIDEST = 0.15
# A column of the scaled Jacobian weaker than this share of the strongest is not excited.
WEAKEST = 1e-5
# Columns of unit length hang together when a singular value is below this share of the greatest.
COLLINEAR = 1e-3


@dataclass(frozen=True)
class Estimate:
    """One parameter as a log shows it.

    Attributes:
      name, unit: of the parameter; value: fitted, or the prior when it is not identifiable.
      prior: value before the fit; half_width: of the 95 % interval, inf when nothing is known.
      identifiable: whether the log shows it; reason: why not, in words.
    """

    name: str
    value: float
    unit: str
    prior: float
    half_width: float
    identifiable: bool
    reason: str = ""


@dataclass(frozen=True)
class Free:
    """A parameter to fit: start value (prior), bounds, and a size that makes it dimensionless."""

    name: str
    unit: str
    prior: float
    low: float
    high: float


def fit(
    free: Sequence[Free],
    residual: Callable[[FloatArray], Sequence[FloatArray]],
) -> tuple[list[Estimate], FloatArray]:
    """Fits parameters and judges them.

    The covariance is the cluster-robust sandwich over the residual's groups (windows of the log),
    since the errors inside a window hang together.

    Args:
      free: the parameters, k of them.
      residual: parameter values (k,) to groups of residuals, all in one unit.

    Returns:
      The estimates, and the fitted values (k,), where what cannot be identified keeps its prior.
    """
    prior = np.array([f.prior for f in free])
    size = np.maximum(np.abs(prior), 1e-12)
    active = list(range(len(free)))
    values, reasons = prior.copy(), {}
    widths = np.full(len(free), math.inf)

    def stacked(scaled: FloatArray) -> FloatArray:
        trial = values.copy()
        trial[active] = scaled * size[active]
        return np.concatenate(list(residual(trial)))

    # Drop one unseen parameter at a time: the others may be visible without it.
    while active:
        low = np.array([free[i].low for i in active]) / size[active]
        high = np.array([free[i].high for i in active]) / size[active]
        start = np.clip(prior[active] / size[active], low, high)
        solution = least_squares(stacked, start, bounds=(low, high), x_scale="jac", loss="soft_l1")
        names = [free[i].name for i in active]
        unseen = _hidden(solution.jac)
        if unseen:
            dropped, reason = max(unseen), _reason(names, max(unseen), unseen[max(unseen)])
        else:
            groups = [len(group) for group in residual(values)]
            relative = _half_widths(solution.jac, stacked(solution.x), groups)
            widths[active] = relative * size[active]
            share = relative / np.maximum(np.abs(solution.x), 1e-12)
            weak = np.flatnonzero(share > WIDEST)
            if not len(weak):
                values[active] = solution.x * size[active]
                break
            dropped = int(weak[-1])
            reason = f"the log is too weak: +/-{100.0 * share[dropped]:.0f} % of the value"
        reasons[active[dropped]] = reason
        values[active[dropped]] = prior[active[dropped]]
        del active[dropped]
    estimates = []
    for i, parameter in enumerate(free):
        reason = reasons.get(i, "")
        if not reason and not parameter.low * 1.001 < values[i] < parameter.high * 0.999:
            reason = f"the fit runs into its bound {values[i]:g}"
        kept = parameter.prior if reason else float(values[i])
        estimates.append(
            Estimate(
                parameter.name,
                kept,
                parameter.unit,
                parameter.prior,
                float(widths[i]),
                not reason,
                reason,
            )
        )
    return estimates, values


def _hidden(jacobian: FloatArray) -> dict[int, list[int]]:
    """Columns in unexcited directions: index to all columns of its direction."""
    norms = np.linalg.norm(jacobian, axis=0)
    silent = norms <= WEAKEST * norms.max(initial=0.0)
    if silent.any():
        return {int(k): [int(k)] for k in np.flatnonzero(silent)}
    _, sizes, directions = np.linalg.svd(jacobian / norms, full_matrices=False)
    found: dict[int, list[int]] = {}
    for size, direction in zip(sizes, directions, strict=True):
        if size < COLLINEAR * sizes[0]:
            partners = [int(k) for k in np.flatnonzero(np.abs(direction) > 0.1)]
            # The last named gives way: callers name the parameters they trust most first.
            found[partners[-1]] = partners
    return found


def _reason(names: list[str], index: int, partners: list[int]) -> str:
    others = [names[k] for k in partners if k != index]
    if not others:
        return "the log does not excite it"
    return f"the log shows it only together with {', '.join(others)}"


def _half_widths(jacobian: FloatArray, residuals: FloatArray, groups: list[int]) -> FloatArray:
    bread = np.linalg.inv(jacobian.T @ jacobian)
    meat = np.zeros_like(bread)
    start = 0
    for count in groups:
        rows = slice(start, start + count)
        score = jacobian[rows].T @ residuals[rows]
        meat += np.outer(score, score)
        start += count
    number, k = len(groups), jacobian.shape[1]
    if number <= k + 1:
        return np.full(k, math.inf)
    covariance = bread @ meat @ bread * number / (number - k)
    return np.asarray(stats.t.ppf(0.975, number - k) * np.sqrt(np.diag(covariance)))
