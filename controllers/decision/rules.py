"""Rules that decide on lane changes: the paper's three baselines, MOBIL and look-ahead.

A rule is a row of numbers for a compiled function, which the full chain calls with what the truck
sees, and the fast world with its own state.
"""

from __future__ import annotations

import abc
import functools
import math
from collections.abc import Iterator
from dataclasses import astuple, dataclass

from controllers.decision.base import DecisionContext, Keep, Memoryless
from controllers.planning.config import FollowingConfig, SafetyConfig
from controllers.protocols import DecisionMaker
from iits_mj import kernels
from iits_mj.core.checks import in_range, require_positive
from iits_mj.core.errors import InputError
from iits_mj.core.messages import Decision
from iits_mj.kernels import Address, Integer, Real, Table

CLEARANCE = {"conservative": 150.0, "neutral": 100.0, "aggressive": 50.0}
CAR = FollowingConfig(time_gap=1.2, standstill_gap=2.0, acceleration_max=1.5, deceleration=2.0)
TRUCK = FollowingConfig(time_gap=1.5, standstill_gap=4.0, acceleration_max=0.8, deceleration=1.3)
# A full service-brake application of a laden truck, positive [m/s2].
HARDEST_BRAKING = 6.0
# `RuleModel` of iits_mj/kernels/decision_rules.h.
MODEL = Table([*astuple(CAR), *astuple(TRUCK), *astuple(SafetyConfig()), HARDEST_BRAKING])
_PARAMETERS = 4
_NOBODY = (math.inf, 0.0)
_UNUSABLE = (0.0, *_NOBODY, *_NOBODY, math.inf)

_decision = kernels.function("iits_rule_decision", Integer, Address, Address, Address)
_braking = kernels.function("iits_imposed_braking", None, Address, Address, Address)
_Situation = Real * (3 + 3 * len(_UNUSABLE))
_Sides = Real * 2


class Rule(Memoryless, abc.ABC):
    """Base of the rules.

    Attributes:
      name: of the decision maker.
      number: of the compiled rule.
    """

    name: str
    number: int

    @abc.abstractmethod
    def parameters(self) -> tuple[float, ...]:
        """Parameters of the compiled rule, in its order."""

    @functools.cached_property
    def table(self) -> Table:
        """Number and parameters, for the compiled functions."""
        return _table(self.number, *self.parameters())

    def decide(self, context: DecisionContext) -> Decision:
        """Returns the side to which the rule asks to change, else KEEP."""
        seen = _Situation(*_situation(context))
        return Decision(_decision(self.table.address, seen, MODEL.address))


class ClearanceRule(Rule):
    """Changes lanes when the leader is closer than d and the other lane is free for d both ways.

    Distances are bumper gaps of the whole combination. The left lane is checked first, then the
    right. As in the paper, the truck stays in the left lane on a free road.

    Args:
      name: "conservative", "neutral" or "aggressive": d = 150, 100 or 50 m.

    Raises:
      InputError: the name is unknown.
    """

    number = 1

    def __init__(self, name: str) -> None:
        if name not in CLEARANCE:
            raise InputError(f"rule {name!r} is unknown; allowed are: {', '.join(CLEARANCE)}")
        self.name = name
        self.clearance = CLEARANCE[name]

    def parameters(self) -> tuple[float, ...]:
        """The clearance [m]."""
        return (self.clearance,)


@dataclass(frozen=True)
class Mobil(Rule):
    """MOBIL for a truck: change where it gains acceleration and costs the others little.

    Kesting, Treiber and Helbing, General lane-changing model MOBIL, TRR 1999 (2007): safety
    criterion on the new follower's deceleration, incentive with politeness, bias to the right lane.
    The truck's accelerations are those of the IDM at the speeds that the lanes offer. The planner's
    gaps are a further safety criterion.

    Attributes:
      politeness: weight of the others' loss.
      threshold: gain that is worth a change [m/s2].
      right_bias: preference for the right lane [m/s2].
      safe_deceleration: hardest braking that a new follower may need, positive [m/s2].

    Raises:
      InputError: a value is out of its range; the message names it.
    """

    politeness: float = 0.2
    threshold: float = 0.15
    right_bias: float = 0.12
    safe_deceleration: float = 1.5

    name = "mobil"
    number = 2

    def __post_init__(self) -> None:
        require_positive(self, *vars(self), zero=True)

    def parameters(self) -> tuple[float, ...]:
        """The fields."""
        return astuple(self)


@dataclass(frozen=True)
class LookAhead(Rule):
    """Chooses the lane in which the truck comes farthest, by short roll-outs of the lanes.

    In each lane the truck follows the leader by the IDM for some seconds, while the others keep
    their speed. A change costs some distance, and the right lane is worth some; a change must leave
    the planner's safety gaps.

    Attributes:
      horizon, step: of the roll-outs [s].
      change_cost: distance that a change must gain [m].
      right_gain: distance that the right lane is worth [m]; less than the cost, or the truck would
        change there and back for nothing.

    Raises:
      InputError: a value is out of its range; the message names it.
    """

    horizon: float = 14.0
    step: float = 0.5
    change_cost: float = 9.0
    right_gain: float = 2.0

    name = "lookahead"
    number = 3

    def __post_init__(self) -> None:
        in_range("step", self.step, 0.05, 5.0, "s")
        require_positive(self, "change_cost", "right_gain", zero=True)
        in_range("horizon", self.horizon, self.step, 600.0, "s")

    def parameters(self) -> tuple[float, ...]:
        """The fields."""
        return astuple(self)


def compiled(maker: DecisionMaker) -> Table | None:
    """Returns a decision maker's numbers for the compiled functions, None for one without."""
    if isinstance(maker, Keep):
        return _table(0)
    return maker.table if isinstance(maker, Rule) else None


def imposed_braking(context: DecisionContext) -> dict[Decision, float]:
    """Returns the braking that a change to each side asks of the new follower [m/s2].

    It is the interaction term `a (s* / gap)^2` of the IDM (Treiber et al. 2000, eq. 3) of a car,
    `CAR`: 0 without a follower, and infinite where the lane cannot be used or the planner's gaps
    are not free.
    """
    found = _Sides()
    _braking(_Situation(*_situation(context)), MODEL.address, found)
    return {Decision.LEFT: found[0], Decision.RIGHT: found[1]}


def _table(number: int, *parameters: float) -> Table:
    return Table([number, *parameters, *[0.0] * (_PARAMETERS - len(parameters))])


def _situation(context: DecisionContext) -> Iterator[float]:
    """Yields the numbers of `Situation` in iits_mj/kernels/decision_rules.h."""
    scene, lane = context.scene, context.lane
    yield from (scene.ego.speed, context.reference_speed, scene.footprint.length)
    usable = {lane, *(side for _, side in context.sides())}
    for number in (lane, lane + 1, lane - 1):
        yield from _around(context, number) if number in usable else _UNUSABLE


def _around(context: DecisionContext, lane: int) -> tuple[float, ...]:
    neighbors, route = context.scene.neighbors, context.route
    leader, follower = (
        _NOBODY if found is None else (found.gap, found.speed)
        for found in (
            neighbors.leader_in_lane(route, lane),
            neighbors.follower_in_lane(route, lane),
        )
    )
    return (1.0, *leader, *follower, neighbors.least_gap(route, lane))
