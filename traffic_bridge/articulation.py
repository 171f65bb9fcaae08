"""Where the two units of an articulated truck are, from the way of its middle alone.

The traffic gives one pose a vehicle: that of its bounding box's centre, which lies on the
semitrailer between kingpin and axles. The centre moves as told; the axle group, which does not slip
sideways, is pulled after it (a tractrix), and the tractor points where the kingpin goes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from iits_mj.errors import InputError

FloatArray = NDArray[np.float64]

# Of a 16.5 m combination within 96/53/EC, from either end of it [m].
KINGPIN_FROM_FRONT = 4.5
AXLES_FROM_REAR = 3.8
SHORTEST = 12.0
# A centre that moved farther than this in one step was put elsewhere: no path leads there [m].
LONGEST_STEP = 8.0
BACKWARDS = 0.5  # cosine between motion and heading below which the way is not believed
STEEPEST = 0.95  # sine of the greatest angle between centre's heading and semitrailer in a bend
AT_REST = 1e-6  # [m]: so little motion has no direction
NOWHERE = [1e12, 1e12, 0.0]  # x, y [m] and yaw of who was not seen before


@dataclass(frozen=True, eq=False)
class Articulation:
    """Distances on n articulated trucks, each of shape (n,).

    Attributes:
      kingpin: from the box's centre forward to the kingpin [m].
      axles: from the box's centre back to the middle of the semitrailer's axle group [m].
    """

    kingpin: FloatArray
    axles: FloatArray

    @classmethod
    def of_lengths(cls, lengths: Sequence[float]) -> Articulation:
        """The distances on combinations of some lengths [m].

        Raises:
          InputError: one is too short to consist of two units.
        """
        for length in lengths:
            if not length >= SHORTEST:
                raise InputError(
                    f"articulated truck of length {length!r} m: "
                    f"two units need {SHORTEST:g} m or more"
                )
        half = 0.5 * np.asarray(lengths, dtype=np.float64)
        return cls(half - KINGPIN_FROM_FRONT, half - AXLES_FROM_REAR)

    def settled(self, yaw: FloatArray, curvature: FloatArray) -> FloatArray:
        """Yaw of a semitrailer that has long been in a bend: its axles' circle is concentric.

        Args:
          yaw: direction in which the box's centre moves [rad], shape (n,).
          curvature: of the centre's way [1/m], shape (n,), positive to the left.

        Returns:
          [rad], shape (n,).
        """
        sine = np.clip(curvature * self.axles, -STEEPEST, STEEPEST)
        return np.asarray(yaw - np.arcsin(sine))

    def pulled(self, trailer_yaw: FloatArray, direction: FloatArray, way: FloatArray) -> FloatArray:
        """Yaw of the semitrailer after its centre was moved along a straight line.

        The exact tractrix of a straight pull: d(psi)/ds = sin(chi - psi) / d, with chi the pull's
        direction and d = `axles`, is solved by tan((chi - psi)/2) falling as exp(-s / d). Paths are
        chains of such chords, so that the result does not depend on speed or time step.

        Args:
          trailer_yaw: before [rad], shape (n,).
          direction: of the motion [rad], shape (n,).
          way: its length [m], shape (n,); negative for where the semitrailer came from.

        Returns:
          [rad], shape (n,).
        """
        half = 0.5 * _wrapped(direction - trailer_yaw)
        return np.asarray(direction - 2.0 * np.arctan(np.tan(half) * np.exp(-way / self.axles)))

    def tractor_yaw(self, yaw: FloatArray, trailer_yaw: FloatArray) -> FloatArray:
        """Yaw of the tractor: the direction in which the kingpin moves.

        The fifth wheel counts as above the drive axle, which does not slip sideways. The centre
        moves towards `yaw`, which turns the semitrailer at v sin(delta) / d; the kingpin, e ahead,
        moves across the semitrailer by v sin(delta) (1 + e / d) and along it by v cos(delta).

        Args:
          yaw: direction in which the box's centre moves [rad], shape (n,).
          trailer_yaw: [rad], shape (n,).

        Returns:
          [rad], shape (n,).
        """
        delta = yaw - trailer_yaw
        across = np.sin(delta) * (1.0 + self.kingpin / self.axles)
        return np.asarray(trailer_yaw + np.arctan2(across, np.cos(delta)))


class TrailerMemory:
    """The semitrailers' yaw from frame to frame; a function of the frames alone."""

    def __init__(self) -> None:
        self._known: dict[str, list[float]] = {}

    def clear(self) -> None:
        """Forgets everybody."""
        self._known.clear()

    def follow(
        self,
        names: Sequence[str],
        articulation: Articulation,
        x: FloatArray,
        y: FloatArray,
        yaw: FloatArray,
        curvature: FloatArray,
    ) -> FloatArray:
        """Yaw of the semitrailers in a new frame.

        Who is new, or was put elsewhere, is taken to have been in the present bend for long.

        Args:
          names: of the n trucks; others are forgotten.
          articulation: their distances.
          x: of their boxes' centres [m], shape (n,).
          y: as x.
          yaw: direction in which the centres move [rad], shape (n,).
          curvature: of their way [1/m], shape (n,).

        Returns:
          [rad], shape (n,).
        """
        settled = articulation.settled(yaw, curvature)
        last = np.array([self._known.get(name, NOWHERE) for name in names]).reshape(-1, 3)
        dx, dy = x - last[:, 0], y - last[:, 1]
        way, direction = np.hypot(dx, dy), np.arctan2(dy, dx)
        ahead = np.cos(direction - yaw) >= BACKWARDS
        led = (way <= AT_REST) | (way <= LONGEST_STEP) & ahead
        direction = np.where(way > AT_REST, direction, yaw)
        trailer = np.where(
            led, articulation.pulled(last[:, 2], direction, np.where(led, way, 0.0)), settled
        )
        rows = np.column_stack((x, y, trailer)).tolist()
        self._known = dict(zip(names, rows, strict=True))
        return trailer


def _wrapped(angle: FloatArray) -> FloatArray:
    """Angles within half a turn of zero [rad]."""
    return np.asarray(np.remainder(angle + np.pi, 2.0 * np.pi) - np.pi)
