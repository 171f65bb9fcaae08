"""A primal-dual interior-point method for the speed task, in time linear in the road's length.

Slacks s of all inequalities g(x) >= 0 and their multipliers z follow the central path s z = mu by
Mehrotra's predictor and corrector (S. Mehrotra, SIAM Journal on Optimization 2, 1992; slacks and
merit function as in J. Nocedal and S. Wright, Numerical Optimization, chapter 19). Eliminating the
brake forces interval by interval leaves one system over the nodes, solved in time linear in their
number.

The curvature is exact if it is positive definite, else its convex part. If the quick run makes no
progress, a guarded one lowers mu step by step, and the merit function
`cost - mu sum log s + nu |g - s|` gives the length of each step.

The iterations are compiled: `iits_mj/kernels/interior_point.cc`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from controllers.pcc.problem import Problem
from iits_mj import kernels
from iits_mj.core.arrays import FloatArray

_RUN = kernels.function(
    "iits_interior_point", kernels.Integer, kernels.Integer, kernels.Address, kernels.Address
)
# Why a run ends, by the compiled function's number; {0}: iterations, {1}: the time limit.
_NOTES = (
    "",
    "the iterates are not finite",
    "no drive keeps all limits: their multipliers have no bound",
    "the time limit of {1:g} s was reached",
    "the curvature is not positive",
    "no convergence within {0} iterations",
)


@dataclass(frozen=True)
class Settings:
    """Settings of the method.

    Attributes:
      tolerance: of the mean s z and of the inequalities' residuals; that of the Lagrangian's
        gradient is 100 times as large.
      iterations: of one run, at most; time_limit: for both runs [s].
      guarded: True skips the quick run; fallback: False skips the guarded run.
    """

    tolerance: float = 1e-8
    iterations: int = 100
    time_limit: float = 20.0
    guarded: bool = False
    fallback: bool = True


@dataclass(frozen=True)
class Optimum:
    """Result of the method, in the problem's units.

    Attributes:
      b, y: variables, (n + 1,) and (n,).
      time_price: multiplier of the trip time; prices: of the intervals' durations, (n,).
      costate: worth of b at a node for the rest of the drive, (n + 1,); at the last, its cost.
      iterations: of all runs; note: why the optimality conditions do not hold, "" if they do.
    """

    b: FloatArray
    y: FloatArray
    time_price: float
    prices: FloatArray
    costate: FloatArray
    iterations: int
    note: str

    @property
    def converged(self) -> bool:
        """Whether the optimality conditions hold."""
        return not self.note


def minimize(problem: Problem, b: FloatArray, settings: Settings | None = None) -> Optimum:
    """Returns the optimum, or the last iterate, from a guess of b, shape (n + 1,)."""
    settings, p, n = settings or Settings(), problem, problem.intervals
    numbers = (
        *(p.inertia, p.air, *p.fuel, p.calm, p.worth, p.overrun, p.full, p.brake, p.time_max),
        *(settings.tolerance, settings.iterations, settings.time_limit),
        *(settings.guarded, settings.fallback),
    )
    given = np.concatenate([numbers, p.low, p.high, b, p.resistance, p.earliest])
    if given.size != len(numbers) + 3 * (n + 1) + 2 * n:
        raise ValueError(f"the guess and bounds of {n} intervals must have {n + 1} nodes")
    found = np.empty(4 * n + 4)
    reason = _RUN(n, kernels.address(given), kernels.address(found))
    rest = found[2 * n + 1 :]
    time_price, iterations = found[-2:].tolist()
    return Optimum(
        b=found[: n + 1],
        y=found[n + 1 : 2 * n + 1],
        time_price=time_price,
        prices=rest[:n],
        costate=rest[n : 2 * n + 1],
        iterations=int(iterations),
        note=_NOTES[reason].format(int(iterations), settings.time_limit),
    )
