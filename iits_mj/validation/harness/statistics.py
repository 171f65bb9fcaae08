"""Statistics: means with confidence intervals, paired tests, correction for several tests."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.stats import t as student
from scipy.stats import wilcoxon

LEVEL = 0.95


@dataclass(frozen=True)
class Estimate:
    """Mean of `count` values, standard deviation, and half of the 95 % interval of the mean.

    The half interval of a single value is inf.
    """

    mean: float
    std: float
    half: float
    count: int

    @property
    def low(self) -> float:
        """Lower end of the interval."""
        return self.mean - self.half

    @property
    def high(self) -> float:
        """Upper end of the interval."""
        return self.mean + self.half


@dataclass(frozen=True)
class Paired(Estimate):
    """Estimate of a difference, with two tests of the hypothesis that it is zero.

    Attributes:
      t_p: of Student's paired test; wilcoxon_p: of Wilcoxon's signed-rank test; both two-sided.
    """

    t_p: float
    wilcoxon_p: float


def estimate(values: ArrayLike) -> Estimate:
    """Mean, standard deviation (n - 1) and half of the 95 % interval of values of shape (n,)."""
    x = np.asarray(values, dtype=float)
    if x.size == 0:
        return Estimate(math.nan, math.nan, math.nan, 0)
    half = half_width(x) if x.size > 1 else math.inf
    return Estimate(float(x.mean()), deviation(x), half, int(x.size))


def half_width(values: NDArray[np.float64]) -> float:
    """Half of the 95 % interval of the mean, Student's t; 0 for a single value."""
    if values.size < 2:
        return 0.0
    quantile = float(student.ppf(0.5 + 0.5 * LEVEL, values.size - 1))
    return quantile * deviation(values) / math.sqrt(values.size)


def deviation(values: NDArray[np.float64]) -> float:
    """Standard deviation of a sample; 0 for a single value."""
    return float(values.std(ddof=1)) if values.size > 1 else 0.0


def paired(first: ArrayLike, second: ArrayLike) -> Paired:
    """Difference first less second, value by value, both of shape (n,).

    Both p are 1 for fewer than two values, and when all differences are zero.
    """
    difference = np.asarray(first, dtype=float) - np.asarray(second, dtype=float)
    known = estimate(difference)
    t_p = wilcoxon_p = 1.0
    if known.count > 1 and np.any(difference != 0.0):
        wilcoxon_p = float(wilcoxon(difference).pvalue)
        t_p = 0.0
        if known.std > 0.0:
            statistic = known.mean / (known.std / math.sqrt(known.count))
            t_p = float(2.0 * student.sf(abs(statistic), known.count - 1))
    return Paired(known.mean, known.std, known.half, known.count, t_p, wilcoxon_p)


def holm(p_values: Sequence[float]) -> list[float]:
    """p-values with Holm's correction for several tests (Scand. J. Stat. 6, 1979, 65-70)."""
    corrected = [math.nan] * len(p_values)
    least = 0.0
    for rank, i in enumerate(sorted(range(len(p_values)), key=p_values.__getitem__)):
        least = max(least, min(1.0, (len(p_values) - rank) * p_values[i]))
        corrected[i] = least
    return corrected
