"""Keeping right: when the truck returns to the right lane, and when it may pass on the left.

A lane stays free if its leader stays beyond the following distance for 20 s (`keep_right_time`),
while the truck drives at the reference speed and the leader at its own. Where the truck keeps
right, it returns to the right lane when that lane stays free and the planner's gaps allow the
change, and it passes on the left only when its own lane does not stay free. Signs that forbid
trucks to overtake have the same effect on their stretch, on which the truck does not pass at all.

The definition is that of the Vienna Convention on Road Traffic (1968), articles 10 and 11: vehicles
keep to the edge of the carriageway, and return to it after overtaking. Planner, decision makers and
fast world (iits_mj/kernels/fast_world.cc) use the same compiled function.
"""

from __future__ import annotations

from controllers.planning.config import FollowingConfig, LaneChangeConfig
from iits_mj import kernels
from iits_mj.core.neighbors import Neighbor
from iits_mj.kernels import Address, Integer, Real

_stays_free = kernels.function("iits_stays_free", Integer, Address, *4 * [Real])


def stays_free(
    leader: Neighbor | None,
    speed: float,
    reference_speed: float,
    following: FollowingConfig,
    seconds: float = LaneChangeConfig.keep_right_time,
) -> bool:
    """Whether the leader of a lane stays beyond the following distance for some seconds.

    Args:
      leader: in the lane, None without one.
      speed: of the truck [m/s].
      reference_speed: [m/s]; a faster truck counts with its own speed.
      following: has the following distance, `standstill_gap + time_gap * speed`.
      seconds: [s].
    """
    if leader is None:
        return True
    speed = max(speed, reference_speed)
    table = following.table.address
    return bool(_stays_free(table, speed, leader.gap, leader.speed, seconds))
