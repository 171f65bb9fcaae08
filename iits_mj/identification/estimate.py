"""Least squares with confidence intervals, and tests whether a log identifies a parameter.

The optimizer is scipy's `least_squares` (trust region, bounds). MuJoCo's `mujoco.sysid` wraps the
same one, but its intervals assume white residuals; those of a drive are not white.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import stats
from scipy.optimize import least_squares

from iits_mj.core.arrays import FloatArray

Residual = Callable[[FloatArray], Sequence[FloatArray]]

# A parameter whose 95 % interval is wider than +/- this share of its value is not identified.
WIDEST = 0.15
# A column of the scaled Jacobian weaker than this share of the strongest is not excited.
WEAKEST = 1e-5
# Columns of unit length are collinear when a singular value is below this share of the greatest.
COLLINEAR = 1e-3
# Least correlation of the errors of two estimates that a warning names together.
CORRELATED = 0.9


@dataclass(frozen=True)
class Estimate:
    """One parameter by a log.

    Attributes:
      name, unit: of the parameter; value: fitted, or the prior if it is not identifiable.
      prior: value before the fit; half_width: of the 95 % interval, inf if unknown.
      identifiable: whether the log shows the parameter; reason: why it does not.
    """

    name: str
    value: float
    unit: str
    prior: float
    half_width: float
    identifiable: bool
    reason: str = ""

    def __str__(self) -> str:
        """One line with value and interval, or with the reason against it."""
        if not self.identifiable:
            return f"{self.name}: not identifiable, {self.reason}; kept {self.prior:.5g}"
        unit = "" if self.unit == "1" else f" {self.unit}"
        return f"{self.name} = {self.value:.6g} +/- {self.half_width:.2g}{unit} (95 %)"

    def widened(self, share: float) -> Estimate:
        """The estimate with an error of the model, a share of the value, added to its interval."""
        return replace(self, half_width=float(np.hypot(self.half_width, share * self.value)))


@dataclass(frozen=True)
class Free:
    """A parameter to fit: name, unit, start value (prior), bounds."""

    name: str
    unit: str
    prior: float
    low: float = -math.inf
    high: float = math.inf

    def unseen(self, reason: str) -> Estimate:
        """The estimate of a parameter that the log does not show: it keeps its prior."""
        return self.judged(self.prior, math.inf, reason)

    def judged(self, value: float, half_width: float, reason: str = "") -> Estimate:
        """The estimate with a value, or with the prior if there is a reason against it."""
        kept = self.prior if reason else float(value)
        return Estimate(self.name, kept, self.unit, self.prior, half_width, not reason, reason)


def unseen(free: Sequence[Free], reason: str) -> list[Estimate]:
    """The estimates of parameters that the log does not show, all for one reason."""
    return [f.unseen(reason) for f in free]


def too_weak(share: float) -> str:
    """The reason against an interval of +/- this share of the value; "" if it is narrow."""
    return "" if share <= WIDEST else f"the log is too weak: +/-{100.0 * share:.0f} % of the value"


def fit(
    free: Sequence[Free],
    residual: Residual,
    *,
    start: FloatArray | None = None,
    step: float | None = None,
    tolerance: float = 1e-8,
) -> tuple[list[Estimate], FloatArray]:
    """Fits parameters together and judges each.

    The covariance is the jackknife over the residual's groups (windows of the log), since the
    errors inside a window are correlated. A parameter with too wide an interval stays free, so that
    the intervals of the others hold for any value of it. Parameters that the log shows only
    together are not identified.

    Args:
      free: the parameters, k of them.
      residual: gives groups of residuals, all in one unit, for parameter values (k,).
      start: values at which the search begins, shape (k,); default: the priors.
      step: relative step of the difference quotients, for a residual with rounding errors.
      tolerance: relative change of costs or parameters at which the search ends.

    Returns:
      The estimates, and the values of the best fit (k,), identifiable or not.
    """
    prior = np.array([f.prior for f in free])
    values = prior if start is None else np.array(start, dtype=float)
    size = np.maximum(np.abs(prior), 1e-12)
    active = list(range(len(free)))
    reasons: dict[int, str] = {}
    widths = np.full(len(free), math.inf)

    def stacked(scaled: FloatArray) -> FloatArray:
        trial = values.copy()
        trial[active] = scaled * size[active]
        return np.concatenate(list(residual(trial)))

    while active:
        low = np.array([free[i].low for i in active]) / size[active]
        high = np.array([free[i].high for i in active]) / size[active]
        first = np.clip(values[active] / size[active], low, high)
        solution = least_squares(
            stacked,
            first,
            bounds=(low, high),
            x_scale="jac",
            loss="soft_l1",
            diff_step=step,
            ftol=tolerance,
            xtol=tolerance,
        )
        hidden = _hidden(solution.jac)
        if hidden is None:
            values[active] = solution.x * size[active]
            groups = [len(group) for group in residual(values)]
            covariance = _covariance(solution.jac, stacked(solution.x), groups)
            quantile = stats.t.ppf(0.975, max(len(groups) - len(active), 1))
            widths[active] = quantile * np.sqrt(np.diag(covariance)) * size[active]
            reasons |= _weak([free[i] for i in active], active, values, widths, covariance)
            break
        for k in hidden:
            others = [free[active[j]].name for j in hidden if j != k]
            reasons[active[k]] = (
                f"the log shows it only together with {', '.join(others)}"
                if others
                else "the log does not excite it"
            )
        del active[hidden[-1]]
    for i, f in enumerate(free):
        if not f.low * 1.001 < values[i] < f.high * 0.999:
            reasons.setdefault(i, f"the fit runs into its bound {values[i]:g}")
    return [
        f.judged(values[i], float(widths[i]), reasons.get(i, "")) for i, f in enumerate(free)
    ], values


def _weak(
    free: list[Free],
    places: list[int],
    values: FloatArray,
    widths: FloatArray,
    covariance: FloatArray,
) -> dict[int, str]:
    """Reasons against the parameters with too wide an interval, by their place among all."""
    reasons = {}
    deviation = np.sqrt(np.diag(covariance))
    for k, place in enumerate(places):
        share = widths[place] / max(abs(values[place]), 1e-12)
        if not np.isfinite(share):
            reasons[place] = "the log has too few stretches that can be compared"
            continue
        reason = too_weak(share)
        if not reason:
            continue
        if np.isfinite(covariance).all():
            correlation = covariance[k] / (deviation[k] * deviation)
            partners = [
                f"{free[j].name} ({correlation[j]:+.2f})"
                for j in np.argsort(-np.abs(correlation))
                if j != k and abs(correlation[j]) > CORRELATED
            ]
            if partners:
                reason += f", its error correlates with that of {partners[0]}"
        reasons[place] = reason
    return reasons


def _hidden(jacobian: FloatArray) -> list[int] | None:
    """Columns of a direction without effect on the residual; None if there is none."""
    norms = np.linalg.norm(jacobian, axis=0)
    silent = np.flatnonzero(norms <= WEAKEST * norms.max(initial=0.0))
    if len(silent):
        return [int(silent[-1])]
    _, sizes, directions = np.linalg.svd(jacobian / norms, full_matrices=False)
    if sizes[-1] >= COLLINEAR * sizes[0]:
        return None
    return [int(k) for k in np.flatnonzero(np.abs(directions[-1]) > 0.1)]


def _covariance(jacobian: FloatArray, residuals: FloatArray, groups: list[int]) -> FloatArray:
    """Cluster-robust covariance of the scaled parameters, shape (k, k); inf with too few groups.

    CR3, which is the jackknife over groups (Bell and McCaffrey, Survey Methodology 28, 2002): with
    M = J'J, and G, s of one group, the parameters without it differ by (M - G)^-1 s. A plain
    sandwich is too narrow with the twenty windows of a drive.
    """
    number, k = len(groups), jacobian.shape[1]
    if number <= k + 1:
        return np.full((k, k), math.inf)
    whole = jacobian.T @ jacobian
    covariance = np.zeros_like(whole)
    start = 0
    for count in groups:
        rows = slice(start, start + count)
        own = jacobian[rows].T @ jacobian[rows]
        score = jacobian[rows].T @ residuals[rows]
        start += count
        try:
            change = np.linalg.solve(whole - own, score)
        except np.linalg.LinAlgError:
            # This group alone shows a parameter: there is no estimate of its error.
            return np.full((k, k), math.inf)
        covariance += np.outer(change, change)
    return np.asarray(covariance * (number - 1) / number)
