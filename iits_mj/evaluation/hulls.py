"""Lower hull of the rules: the least speed loss that the rules reach with a number of lane changes.

A method is compared with the hull at its own number of lane changes, because a difference of losses
alone depends on the price that a method sets on a change. A point of the hull between two rules is
a mixture of them: some trips by one, the others by the other. The rules' sweep varies the price.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from iits_mj.validation.harness.statistics import Estimate, estimate

# Rules that are points of a hull, with any options.
HULL_RULES = ("keep", "conservative", "neutral", "aggressive", "mobil", "lookahead")
_THRESHOLDS = (0.0, 0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.6, 0.8)
# Cost of a change [m] by the look-ahead's horizon [s].
_COSTS = {
    14: (3, 6, 9, 14, 20, 30),
    30: (10, 25, 40, 60, 90, 130),
    60: (25, 50, 90, 140, 200, 300),
}
# Methods of a sweep.
SWEEP = (
    "keep",
    *(f"mobil:threshold={threshold:g}" for threshold in _THRESHOLDS),
    *(
        f"lookahead:horizon={horizon}:change_cost={cost}"
        for horizon, costs in _COSTS.items()
        for cost in costs
    ),
)


class Trip(Protocol):
    """What counts of a trip: trips of one seed are compared."""

    @property
    def seed(self) -> int:
        """Of the trip."""

    @property
    def changes(self) -> int:
        """Number of lane changes."""

    @property
    def speed_loss(self) -> float:
        """Share of the reference speed [1]."""


@dataclass(frozen=True)
class Point:
    """A rule's means over the trips of a cell: lane changes and speed loss [%]."""

    method: str
    changes: float
    loss: float


@dataclass(frozen=True)
class Comparison:
    """A method beside the hull at its number of lane changes.

    Attributes:
      changes, loss: of the method [1, %]; hull: loss of the hull [%].
      ends: the rules between which the hull is met; one where the method changes lanes more often
        than the best rule.
      difference: loss of the method less the hull's over the same trips [% points].
    """

    method: str
    changes: float
    loss: float
    hull: float
    ends: tuple[str, ...]
    difference: Estimate


def is_hull_rule(method: str) -> bool:
    """Returns whether a method is a shipped rule, with or without options."""
    return method.partition(":")[0] in HULL_RULES


def family(method: str) -> str:
    """Returns the name of the rules that differ from a method by the swept option only."""
    name, *options = method.split(":")
    horizons = [text.removeprefix("horizon=") for text in options if text.startswith("horizon=")]
    return f"{name} {horizons[0] if horizons else 14} s" if name == "lookahead" else name


def points(trials: Mapping[str, Sequence[Trip]]) -> list[Point]:
    """Returns the rules among the methods of a cell, by their number of lane changes."""
    found = [
        Point(
            name,
            float(np.mean([trial.changes for trial in rows])),
            100.0 * float(np.mean([trial.speed_loss for trial in rows])),
        )
        for name, rows in trials.items()
        if rows and is_hull_rule(name)
    ]
    return sorted(found, key=lambda point: (point.changes, point.loss, point.method))


def lower_hull(found: Sequence[Point]) -> list[Point]:
    """Returns the points of the lower convex hull up to that of the least loss.

    Args:
      found: by their number of lane changes.
    """
    hull: list[Point] = []
    for point in found:
        if hull and point.loss >= hull[-1].loss:
            continue
        if hull and point.changes == hull[-1].changes:
            hull.pop()
        while len(hull) > 1 and _slope(hull[-2], point) <= _slope(hull[-2], hull[-1]):
            hull.pop()
        hull.append(point)
    return hull


def against_hull(trials: Mapping[str, Sequence[Trip]], method: str) -> Comparison | None:
    """Compares a method with the hull of the rules of a cell.

    The interval is that of the values `loss - slope * changes` over the same trips, where the slope
    is that of the hull at the method: on this line, a trip of the method, and one of the mixture of
    rules, count as their distance from the hull. It thus covers the spread of losses and changes.
    The hull's points are chosen by the same trips, which favors the rules.

    Args:
      trials: trips of the cell, by method.
      method: to compare.

    Returns:
      None if the rules are less than two, have no trip in common with the method, or if the method
      changes lanes less often than each of them.
    """
    known = points(trials)
    rows = trials.get(method, ())
    if len(known) < 2 or not rows:
        return None
    hull = lower_hull(known)
    changes = float(np.mean([trial.changes for trial in rows]))
    if changes < hull[0].changes:
        return None
    first = max(i for i, point in enumerate(hull) if point.changes <= changes)
    ends = hull[first : first + 2]
    slope, share = 0.0, 0.0
    if len(ends) == 2:
        slope = _slope(*ends)
        share = (changes - ends[0].changes) / (ends[1].changes - ends[0].changes)
        ends = ends if share > 0.0 else ends[:1]

    def values(name: str) -> dict[int, float]:
        return {t.seed: 100.0 * t.speed_loss - slope * t.changes for t in trials[name]}

    own, *others = (values(name) for name in (method, *(point.method for point in ends)))
    weights = (1.0 - share, share)[: len(others)]
    seeds = sorted(set(own).intersection(*others))
    if not seeds:
        return None
    difference = [
        own[seed] - sum(w * other[seed] for w, other in zip(weights, others, strict=True))
        for seed in seeds
    ]
    loss = 100.0 * float(np.mean([trial.speed_loss for trial in rows]))
    at = ends[0].loss + slope * (changes - ends[0].changes)
    names = tuple(point.method for point in ends)
    return Comparison(method, changes, loss, at, names, estimate(difference))


def mean_over_cells(comparisons: Sequence[Comparison]) -> Estimate:
    """Returns the mean of the differences of several cells, whose trips are independent."""
    differences = [comparison.difference for comparison in comparisons]
    count = len(differences)
    if count == 0:
        return estimate([])
    means = [difference.mean for difference in differences]
    half = math.sqrt(sum(difference.half**2 for difference in differences)) / count
    trips = sum(difference.count for difference in differences)
    return Estimate(float(np.mean(means)), float(np.std(means)), half, trips)


def _slope(first: Point, second: Point) -> float:
    return (second.loss - first.loss) / (second.changes - first.changes)
