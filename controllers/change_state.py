"""What the state machine across the road remembers and says: a change, and a step."""

from __future__ import annotations

from dataclasses import dataclass

from controllers.road_preview import LanePath
from iits_mj.messages import Decision


@dataclass(slots=True)
class Change:
    """A lane change under way: direction, the lane it left, its size [m], given up or not.

    `passes`: pulling out from low speed past who stands there, "" for an ordinary change.
    """

    direction: Decision
    origin_offset: float
    size: float
    aborted: bool = False
    mandatory: bool = False
    passes: str = ""

    @property
    def pull_out(self) -> bool:
        """Whether it passes somebody who stands."""
        return bool(self.passes)


@dataclass(frozen=True, slots=True)
class Step:
    """What the state machine says in one cycle.

    Attributes:
      path: of the lane kept or changed to; reason: why not as decided, "" for nothing to say.
      refused: the decision refused; unsafe: because of a vehicle.
      wanted: path of the lane that must be reached but is not free, None for none.
    """

    path: LanePath
    reason: str = ""
    refused: Decision = Decision.KEEP
    unsafe: bool = False
    wanted: LanePath | None = None
