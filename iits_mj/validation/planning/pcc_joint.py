"""The joint plan of speed, gear and eco-roll beside the plan of speed alone, with its bound."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from controllers.pcc.joint import (
    NEUTRAL,
    GearTables,
    JointPlan,
    JointTask,
    gears_at,
    lower_bound,
    plan_at,
    plan_in_time,
    tightened,
)
from iits_mj.core.results import Check
from iits_mj.validation.planning.pcc_case import SolvedPlan

STATES = 120
# For the bound. Long climbs at full power make it loose, erratically so over the states, and the
# greatest of several bounds is a bound.
BOUND_STATES = (60, 100, 200)
INTERVALS_MAX = 2_500  # of the road: the bound of 125 km at 50 m takes most of a minute
_PRICES = (0.9, 1.0)  # over the plan's price, for the bound
_SPARE = 1e-6  # of the speeds at the ends of the tables


@dataclass(frozen=True)
class JointComparison:
    """Cruise, plan of speed alone and joint plan, all with the same truck, map and gears.

    Attributes:
      cruise, convex: the drives of a `SolvedPlan` with the best gears for their speeds.
      joint: the plan of speed, gear and neutral in the time of the cruise.
      bound: fuel below which no plan gets in this time [kg].
    """

    cruise: JointPlan
    convex: JointPlan
    joint: JointPlan
    bound: float

    def saving(self, fuel: float) -> float:
        """Returns the saving of a fuel [kg] against the cruise [%]."""
        return 100.0 * (1.0 - fuel / float(self.cruise.fuel.sum()))

    @property
    def convex_saving(self) -> float:
        """Saving of the plan of speed alone, in its best gears [%]."""
        return self.saving(float(self.convex.fuel.sum()))

    @property
    def joint_saving(self) -> float:
        """Saving of the joint plan [%]; arriving early has no worth."""
        return self.saving(float(self.joint.fuel.sum()))

    @property
    def bound_saving(self) -> float:
        """Saving that no plan exceeds [%]."""
        return self.saving(self.bound)

    @property
    def closed(self) -> float:
        """Share of the gap between the plan of speed alone and the bound that is closed [%]."""
        gap = self.bound_saving - self.convex_saving
        return 100.0 * (self.joint_saving - self.convex_saving) / gap if gap > 0.0 else np.nan

    @property
    def rolling_share(self) -> float:
        """Share of the road that the joint plan rolls in neutral [%]."""
        return 100.0 * float(np.mean(self.joint.gear == NEUTRAL))


def joint_task_of(
    case: SolvedPlan, *, neutral: bool = True, slows: bool = False, states: int = STATES
) -> JointTask:
    """Returns the task of speed and gear of a solved plan, at that plan's price of a second."""
    task = case.task
    drives = (case.solution.baseline.speed, case.solution.plan.speed)
    low = min(float(np.sqrt(task.b_low.min())), *(float(v.min()) for v in drives))
    high = max(float(np.sqrt(min(task.b_high.max(), 3.6e3))), *(float(v.max()) for v in drives))
    tables = GearTables.of(
        case.parameters, low * (1.0 - _SPARE), high * (1.0 + _SPARE), neutral=neutral, slows=slows
    )
    b_high = np.minimum(task.b_high, high**2)
    price = max(case.solution.time_price, 0.0)
    return JointTask(
        task.vehicle,
        task.road,
        tables,
        np.minimum(task.b_low, b_high),
        b_high,
        price,
        states=states,
    )


def compare_jointly(case: SolvedPlan, *, neutral: bool = True) -> JointComparison:
    """Plans speed and gear of a case together and bounds what any such plan can save.

    Raises:
      PlanningError: no gear runs at some speed of the band, or no joint plan is fast enough.
    """
    task, time = joint_task_of(case, neutral=neutral), case.solution.baseline.time
    cruise, convex = (
        gears_at(task, drive.speed) for drive in (case.solution.baseline, case.solution.plan)
    )
    joint = plan_in_time(task, time * (1.0 + _SPARE))
    bounds = [
        lower_bound(replace(task, states=states, price=share * joint.price), time)
        for states in BOUND_STATES
        for share in _PRICES
    ]
    return JointComparison(cruise, convex, joint, max(bounds))


def plan_to_drive(case: SolvedPlan) -> JointPlan:
    """Returns the joint plan in which changes of gear cost speed, as on the truck.

    A second is worth as much as in the joint plan without this cost, so it takes a little longer.
    """
    price = plan_in_time(joint_task_of(case), case.solution.baseline.time * (1.0 + _SPARE)).price
    return plan_at(tightened(joint_task_of(case, slows=True)).at_price(price))


def joint_checks(found: JointComparison) -> list[Check]:
    """Returns the figures of a comparison."""
    what = "speed, gear and eco-roll planned together"
    return [
        Check(f"saving, {what}", found.joint_saving, "%", found.convex_saving),
        Check("saving that no plan of speed and gear exceeds", found.bound_saving, "%"),
        Check("of the gap to it closed by gear and eco-roll", found.closed, "%"),
        Check("changes of gear, joint plan", found.joint.changes, "1", float(found.cruise.changes)),
        Check("road in neutral, joint plan", found.rolling_share, "%"),
    ]
