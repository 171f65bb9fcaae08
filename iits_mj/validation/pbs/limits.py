"""Limits of the Performance-Based Standards and the level that a combination reaches.

Source of every limit: National Transport Commission, "Performance-Based Standards Scheme - The
Standards and Vehicle Assessment Rules" (2008 with amendments, now the National Heavy Vehicle
Regulator's), part C, grade L. Levels 1 to 4 stand for road classes: general access, B-double,
type 1 and type 2 road train routes. The limits are not yet compared with the text of the Rules.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from iits_mj.core.errors import InputError


@dataclass(frozen=True)
class Standard:
    """A safety standard.

    Attributes:
      name: of the measure; unit: of its limits.
      limits: of the levels 1 to 4.
      least: True when a value must be at least the limit, else at most.
    """

    name: str
    unit: str
    limits: tuple[float, float, float, float]
    least: bool = False

    def level(self, value: float) -> int | None:
        """Returns the lowest level whose limit the value keeps; None if it keeps none.

        Raises:
          InputError: the value is NaN.
        """
        if math.isnan(value):
            raise InputError(f"{self.name} is not a number: the maneuver gave no value")
        for level, limit in enumerate(self.limits, start=1):
            if (value >= limit) if self.least else (value <= limit):
                return level
        return None

    def must(self, level: int) -> str:
        """Returns the bound of a level as text."""
        return f"{'>=' if self.least else '<='} {self.limits[level - 1]:g}"


STANDARDS = {
    "startability": Standard("startability", "%", (15.0, 12.0, 10.0, 5.0), least=True),
    "gradeability_a": Standard("gradeability A", "%", (20.0, 15.0, 12.0, 8.0), least=True),
    "gradeability_b": Standard(
        "gradeability B: speed on 1 %", "km/h", (80.0, 70.0, 70.0, 60.0), least=True
    ),
    "acceleration": Standard("time for 100 m from rest", "s", (20.0, 23.0, 26.0, 29.0)),
    "tracking_ability": Standard("tracking on a straight path", "m", (2.9, 3.0, 3.1, 3.3)),
    "swept_path": Standard("low-speed swept path", "m", (7.4, 8.7, 10.6, 13.7)),
    "frontal_swing": Standard("frontal swing", "m", (0.7,) * 4),
    "front_paths": Standard("frontal swing, maximum of difference", "m", (0.4,) * 4),
    "front_maxima": Standard("frontal swing, difference of maxima", "m", (0.2,) * 4),
    "tail_swing": Standard("tail swing", "m", (0.30, 0.35, 0.35, 0.50)),
    "friction_demand": Standard("steer tire friction demand", "%", (80.0,) * 4),
    "rollover": Standard("static rollover threshold", "g", (0.35,) * 4, least=True),
    # Over the rollover threshold of the last roll-coupled units, in g.
    "amplification": Standard("rearward amplification over threshold", "1/g", (5.7,) * 4),
    "off_tracking": Standard("high-speed transient off-tracking", "m", (0.6, 0.8, 1.0, 1.2)),
    "yaw_damping": Standard("yaw damping coefficient", "1", (0.15,) * 4, least=True),
}


def level_of_length(length: float) -> int:
    """Returns the level of the roads that a combination may use by its length [m].

    The Rules allow 20, 30, 42 and 60 m (class B of levels 2 to 4).
    """
    return 1 + sum(length > most for most in (20.0, 30.0, 42.0))


def reached(values: Mapping[str, float]) -> tuple[dict[str, int | None], int | None]:
    """Returns the level of each measure, and of the combination: the worst of its measures.

    Args:
      values: by the keys of `STANDARDS`, in their units. A single unit has no amplification.

    Raises:
      InputError: an unknown measure, or a value that is NaN.
    """
    for name in values:
        if name not in STANDARDS:
            raise InputError(f"measure {name!r} is none of {sorted(STANDARDS)}")
    levels = {name: STANDARDS[name].level(value) for name, value in values.items()}
    found = [level for level in levels.values() if level is not None]
    overall = max(found) if found and len(found) == len(levels) else None
    return levels, overall
