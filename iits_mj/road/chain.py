"""Joins the roads of a chain end to end.

Joining trims overlaps, bridges gaps and shifts parallel reference lines.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from iits_mj.core.arrays import FloatArray
from iits_mj.core.errors import MapError
from iits_mj.road.elements import Road

Node = tuple[str, int]

CHAIN_LENGTH_LIMIT = 1e6
GAP_LIMIT = 3.0
SHIFT_LIMIT = 20.0
# A smaller lateral step is blended; a larger one is another choice of reference line.
BLENDED_LATERAL_STEP = 0.3


class LinkError(MapError):
    """Two roads that the map links cannot be driven one after the other.

    Attributes:
      link: (road id, direction) of both.
    """

    def __init__(self, message: str, link: tuple[Node, Node]) -> None:
        """`message` names the map, both roads and the reason."""
        super().__init__(message)
        self.link = link


@dataclass(frozen=True)
class Piece:
    """A stretch of one road in a chain.

    Attributes:
      road: the road; direction: +1 along its s, -1 against it.
      s_start, s_end: where it is entered and left; may lie slightly outside to bridge a gap.
      p_start: chain parameter at the entry.
      shift: of the chain's reference line to the left (in travel) of the road's [m].
    """

    road: Road
    direction: int
    s_start: float
    s_end: float
    p_start: float
    shift: float = 0.0

    @property
    def length(self) -> float:
        """Metres of road s."""
        return abs(self.s_end - self.s_start)

    @property
    def p_end(self) -> float:
        """Chain parameter at the exit."""
        return self.p_start + self.length

    def s_at(self, p: ArrayLike) -> FloatArray:
        """Road s at chain parameters."""
        return self.s_start + self.direction * (np.asarray(p, dtype=float) - self.p_start)

    def p_at(self, s: float) -> float:
        """Chain parameter at a road s."""
        return self.p_start + self.direction * (s - self.s_start)

    def state(self, s: ArrayLike, side: int = 1, roll_scale: float = 1.0) -> FloatArray:
        """Exact values and derivatives by p, shape (3, 4, n): order of derivative; x, y, z, roll.

        Where two records meet, `side` selects the one after (+1) or before (-1) in travel. Second
        derivatives of z and roll are zero.
        """
        s = np.atleast_1d(np.asarray(s, dtype=float))
        sign = self.direction
        plan = self.road.plan.evaluate(s, side * sign)
        sine, cosine = sign * np.sin(plan.heading), sign * np.cos(plan.heading)
        bend = sign * plan.curvature
        stretch = 1.0 - bend * self.shift
        speed = plan.speed * stretch
        profile = self.road.superelevation
        roll = sign * roll_scale * profile.evaluate(s, 0, side * sign)
        roll_rate = roll_scale * profile.evaluate(s, 1, side * sign)
        height = self.road.elevation.evaluate(s, 0, side * sign)
        grade = sign * self.road.elevation.evaluate(s, 1, side * sign)
        zero = np.zeros_like(s)
        normal = bend * plan.speed * speed
        return np.array(
            [
                [
                    plan.x - self.shift * sine,
                    plan.y + self.shift * cosine,
                    height + self.shift * np.tan(roll),
                    roll,
                ],
                [
                    speed * cosine,
                    speed * sine,
                    grade + self.shift * roll_rate / np.cos(roll) ** 2,
                    roll_rate,
                ],
                [-normal * sine, normal * cosine, zero, zero],
            ]
        )

    def steepest(self) -> float:
        """Greatest cross slope of the road on this stretch [rad]."""
        s = np.linspace(self.s_start, self.s_end, max(int(self.length), 10))
        return float(np.max(np.abs(self.road.superelevation.evaluate(s))))

    def breaks(self) -> list[float]:
        """Road s of every record that starts inside, in the order of travel."""
        low, high = sorted((self.s_start, self.s_end))
        places = {*map(float, self.road.plan.starts)}
        places.update(self.road.elevation.breaks(), self.road.superelevation.breaks())
        return sorted((s for s in places if low < s < high), reverse=self.direction < 0)


def join(roads: dict[str, Road], chain: Sequence[Node], source: str) -> list[Piece]:
    """Joins the roads of a chain end to end.

    Overlaps are trimmed and gaps are bridged by extending the next road backwards. Where the next
    road's reference line runs beside the last one's (in another lane), the chain keeps its line by
    a parallel shift.

    Raises:
      LinkError: two roads do not meet.
    """
    pieces: list[Piece] = []
    for identity, direction in chain:
        road = roads[identity]
        entry, leave = (0.0, road.length) if direction > 0 else (road.length, 0.0)
        if not pieces:
            pieces.append(Piece(road, direction, entry, leave, 0.0))
            continue
        last = pieces[-1]
        link = (last.road.id, last.direction), (identity, direction)
        end = last.state(last.s_end, -1)[0, :2, 0]
        start, lateral = _project(Piece(road, direction, entry, leave, 0.0), end)
        along = direction * (start - entry)
        if abs(along) > GAP_LIMIT or abs(lateral) > SHIFT_LIMIT:
            raise LinkError(f"{source}: {apart(last.road.id, identity, along, lateral)}", link)
        if direction * (leave - start) < 0.1:
            continue
        shift = lateral if abs(lateral) > BLENDED_LATERAL_STEP else 0.0
        pieces.append(Piece(road, direction, start, leave, last.p_end, shift))
        sampled = road.plan.evaluate(np.linspace(0.0, road.length, 200))
        tightest = float(np.max(np.abs(sampled.curvature)))
        if tightest * abs(shift) > 0.8:
            raise LinkError(
                f"{source}: road {identity!r} bends with a radius of {1 / tightest:.1f} m, too "
                f"tight to follow a line {shift:.1f} m beside its reference line",
                link,
            )
    return pieces


def apart(before: str, after: str, along: float, lateral: float) -> str:
    """Words for two linked roads that do not meet."""
    return (
        f"road {before!r} is linked to {after!r}, but they are "
        f"{math.hypot(along, lateral):.1f} m apart ({along:.1f} m along, {lateral:.1f} m across); "
        f"up to {GAP_LIMIT:g} m along are bridged"
    )


def _project(piece: Piece, point: FloatArray) -> tuple[float, float]:
    """Road s abreast of a point near the piece's entry, and the point's offset to the left."""
    s = piece.s_start
    lateral = 0.0
    for _ in range(20):
        state = piece.state(s)
        position, tangent = state[0, :2, 0], state[1, :2, 0]
        norm = float(np.hypot(*tangent))
        dx, dy = point - position
        along = float((dx * tangent[0] + dy * tangent[1]) / norm)
        lateral = float((dy * tangent[0] - dx * tangent[1]) / norm)
        s += piece.direction * along / norm
        if abs(along) < 1e-9 or abs(s - piece.s_start) > 2.0 * GAP_LIMIT:
            break
    return s, lateral
