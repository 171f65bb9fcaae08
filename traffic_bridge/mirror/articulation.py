"""Poses of tractor and semitrailer from the path of the articulated truck's center alone.

The traffic gives one pose per vehicle: that of its bounding box's center, which lies on the
semitrailer between kingpin and axles. The axle group, which does not slip sideways, is pulled after
the center (a tractrix), and the tractor points in the direction in which the kingpin moves.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from iits_mj.core.angles import wrap_angle
from iits_mj.core.errors import InputError

# Of a 16.5 m combination within 96/53/EC, from either end of it [m].
KINGPIN_FROM_FRONT = 4.5
AXLES_FROM_REAR = 3.8
SHORTEST = 12.0
# A center that moved farther than this in one step was teleported by SUMO [m].
LONGEST_STEP = 8.0
BACKWARDS = 0.5  # cosine between motion and heading below which the motion is ignored
STEEPEST = 0.95  # sine of the largest angle between center's heading and semitrailer in a bend
AT_REST = 1e-6  # [m]: smaller motion has no direction


@dataclass(frozen=True, slots=True)
class Articulation:
    """Distances on an articulated truck.

    Attributes:
      kingpin: from the box's center forward to the kingpin [m].
      axles: from the box's center back to the middle of the semitrailer's axle group [m].
    """

    kingpin: float
    axles: float

    @classmethod
    def of_length(cls, length: float) -> Articulation:
        """The distances on a combination of a length [m].

        Raises:
          InputError: it is too short to consist of two units.
        """
        if not length >= SHORTEST:
            raise InputError(
                f"articulated truck of length {length!r} m: two units need {SHORTEST:g} m or more"
            )
        return cls(0.5 * length - KINGPIN_FROM_FRONT, 0.5 * length - AXLES_FROM_REAR)

    def settled(self, yaw: float, curvature: float) -> float:
        """Yaw of a semitrailer in a steady bend [rad]: its axles move on a concentric circle.

        Args:
          yaw: direction in which the box's center moves [rad].
          curvature: of the center's path [1/m], positive to the left.
        """
        return yaw - math.asin(min(max(curvature * self.axles, -STEEPEST), STEEPEST))

    def pulled(self, trailer_yaw: float, direction: float, way: float) -> float:
        """Yaw of the semitrailer after its center has moved along a straight line [rad].

        The exact tractrix of a straight pull: d(psi)/ds = sin(chi - psi) / d, with chi the pull's
        direction and d = `axles`, is solved by tan((chi - psi)/2) falling as exp(-s / d). Paths are
        chains of such chords, so the result does not depend on speed or time step.

        Args:
          trailer_yaw: before [rad].
          direction: of the motion [rad].
          way: its length [m]; negative to go back in time.
        """
        half = 0.5 * wrap_angle(direction - trailer_yaw)
        return direction - 2.0 * math.atan(math.tan(half) * math.exp(-way / self.axles))


class TrailerMemory:
    """The semitrailers' yaw from frame to frame; a function of the frames alone."""

    def __init__(self) -> None:
        self._known: dict[str, tuple[float, float, float]] = {}

    def clear(self) -> None:
        """Forgets all vehicles."""
        self._known.clear()

    def follow(
        self,
        names: Sequence[str],
        trucks: Sequence[Articulation],
        places: Sequence[tuple[float, float, float, float]],
    ) -> list[float]:
        """Yaw of the semitrailers in a new frame [rad].

        A new vehicle, or one that SUMO has teleported, is assumed to be in a steady bend.

        Args:
          names: of the n trucks; others are forgotten.
          trucks: their distances.
          places: of their boxes' centers: x, y [m], yaw [rad] and curvature of the path [1/m].
        """
        known, self._known = self._known, {}
        found = []
        for name, truck, (x, y, yaw, curvature) in zip(names, trucks, places, strict=True):
            last = known.get(name)
            trailer = None if last is None else _follow(truck, last, x, y, yaw)
            if trailer is None:
                trailer = truck.settled(yaw, curvature)
            self._known[name] = (x, y, trailer)
            found.append(trailer)
        return found


def _follow(
    truck: Articulation, last: tuple[float, float, float], x: float, y: float, yaw: float
) -> float | None:
    """The semitrailer's yaw if its center moved here from the last place, else None."""
    dx, dy = x - last[0], y - last[1]
    way = math.hypot(dx, dy)
    if way < AT_REST:
        return last[2]
    direction = math.atan2(dy, dx)
    if way > LONGEST_STEP or math.cos(direction - yaw) < BACKWARDS:
        return None
    return truck.pulled(last[2], direction, way)
