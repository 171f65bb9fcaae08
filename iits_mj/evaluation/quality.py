"""Quality of the trips of a method: what its lane changes impose on others, use of lanes, fuel."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from controllers.decision.quality import IMPOSED, IMPOSED_TIME, LASTS
from iits_mj.core.units import DIESEL_DENSITY
from iits_mj.evaluation.trials import Trial

EXPLANATION = (
    f"Hard braking: share of the changes whose new follower brakes harder than {IMPOSED:g} m/s2 "
    f"within {IMPOSED_TIME:g} s of the start, for {LASTS:g} s or longer. Braking: hardest braking "
    "of the new follower in that time, mean over the changes. Time to collision and time gap, to "
    "the new leader (front) and of the new follower (rear): the least of all trips at the start of "
    "a change. Right lane: share of the time in which the truck keeps or enters it. Beside: share "
    "of the time in which a vehicle of a neighboring lane overlaps the truck's length."
)


@dataclass(frozen=True)
class Figure:
    """A figure of a method's trips.

    Attributes:
      name: of the figure; short: for a narrow table; unit.
      value: nan if the trips do not have it, inf if there was no such vehicle.
      digits: after the point.
    """

    name: str
    short: str
    unit: str
    value: float
    digits: int

    @property
    def text(self) -> str:
        """The value, "-" without one."""
        return f"{self.value:.{self.digits}f}" if math.isfinite(self.value) else "-"


def quality_figures(trips: Sequence[Trial]) -> list[Figure]:
    """Returns the figures of a method's trips; none if the trips have none.

    Trips of earlier versions of the code do not have the figures, and are left out.
    """
    known = [trip for trip in trips if math.isfinite(trip.imposed_brakings)]
    if not known:
        return []
    changes = sum(trip.changes for trip in known)
    time = sum(trip.time for trip in known)
    distance = sum(trip.distance for trip in known) or math.nan

    def share(column: str) -> float:
        if time <= 0.0:
            return math.nan
        return 100.0 * sum(getattr(trip, column) * trip.time for trip in known) / time

    def per_change(total: float) -> float:
        return total / changes if changes else math.nan

    def least() -> Iterator[Figure]:
        for name, short, column in (
            ("time to collision", "TTC", "collision_time"),
            ("time gap", "gap", "change_time_gap"),
        ):
            for end in ("front", "rear"):
                value = min(getattr(trip, f"{column}_{end}") for trip in known)
                yield Figure(f"{name} at a change, {end}", f"{short} {end}", "s", value, 2)

    braked = per_change(sum(trip.imposed_brakings for trip in known))
    imposed = per_change(sum(t.imposed_deceleration * t.changes for t in known if t.changes))
    fuel = sum(trip.fuel for trip in known) / DIESEL_DENSITY / (distance / 1e5)
    return [
        Figure("changes that impose hard braking", "hard", "%", 100.0 * braked, 2),
        Figure("braking of the new follower", "braking", "m/s2", imposed, 2),
        *least(),
        Figure("time in the right lane", "right", "%", share("right_share"), 1),
        Figure("time beside a vehicle", "beside", "%", share("beside_share"), 1),
        Figure("fuel", "fuel", "l/100 km", fuel, 1),
    ]
