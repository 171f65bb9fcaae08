"""MOBIL for all vehicles of the fast world at once: the rule of `traffic_bridge`, in arrays.

    safety      a~_n >= -b_safe, a~_c >= -b_safe, and room for the vehicle
    for itself  a~_c - a_c > a_th (the symmetric rule with p = 0)
    keep right  to the right   a~_c^eur - a_c + p (a~_o - a_o) > a_th - a_bias
                to the left    a~_c - a_c^eur + p (a~_n - a_n) > a_th + a_bias

c decides, n is its follower after the change, o before it; `a~` are accelerations after the change.
Kesting, Treiber and Helbing, Transportation Research Record 1999 (2007), 86-94.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from controllers.decision.fast_world.config import Drivers, idm_acceleration
from iits_mj.core.arrays import FloatArray, IntArray

MARGIN = 2.0  # [m] that must be free ahead and behind after a change
CRITICAL_SPEED = 60.0 / 3.6  # [m/s]: below it lanes may pass on the right


@dataclass(frozen=True)
class Vehicles:
    """Vehicles of a road with two lanes, arrays of shape (n,); stations of front bumpers."""

    front: FloatArray
    length: FloatArray
    speed: FloatArray
    desired: FloatArray
    lane: IntArray
    drivers: Drivers


class Queue:
    """Leader and follower of every vehicle in its lane.

    Args:
      vehicles: n of them, on any lanes.
    """

    def __init__(self, vehicles: Vehicles) -> None:
        self._vehicles = vehicles
        n = vehicles.front.size
        order = np.lexsort((vehicles.front, vehicles.lane))
        same = vehicles.lane[order[:-1]] == vehicles.lane[order[1:]]
        self.leader = np.full(n, -1)
        self.leader[order[:-1][same]] = order[1:][same]
        self.follower = np.full(n, -1)
        self.follower[order[1:][same]] = order[:-1][same]

    def ahead(self) -> tuple[FloatArray, FloatArray]:
        """Returns gap to and speed of each leader, (n,); inf and the own speed without one."""
        return gap_between(self._vehicles, np.arange(self.leader.size), self.leader)


def gap_between(
    vehicles: Vehicles, behind: IntArray, leader: IntArray
) -> tuple[FloatArray, FloatArray]:
    """Returns gap to and speed of leaders; inf and the own speed where the index is -1."""
    has = leader >= 0
    gap = (vehicles.front - vehicles.length)[leader] - vehicles.front[behind]
    speed = np.where(has, vehicles.speed[leader], vehicles.speed[behind])
    return np.where(has, gap, np.inf), speed


def gains(vehicles: Vehicles, deciders: IntArray, keeps_right: bool) -> FloatArray:
    """Returns each decider's gain above the threshold of a change to the other lane [m/s2].

    Shape (m,); -inf where the change is not safe.

    Args:
      vehicles: all of them.
      deciders: indices, shape (m,).
      keeps_right: the keep-right rule; else the symmetric one with p = 0.
    """
    queue = Queue(vehicles)
    leader, follower = queue.leader[deciders], queue.follower[deciders]
    new_leader, new_follower = _beside(vehicles, deciders)
    kinds, own_speed = vehicles.drivers.of(deciders), vehicles.speed[deciders]
    rear = (vehicles.front - vehicles.length)[deciders]

    def driven(index: IntArray, gap: FloatArray, speed: FloatArray) -> FloatArray:
        own, desired = vehicles.speed[index], vehicles.desired[index]
        value = idm_acceleration(own, desired, gap, speed, vehicles.drivers.of(index))
        return np.where(index >= 0, value, 0.0)

    gap, speed = gap_between(vehicles, deciders, leader)
    new_gap, new_speed = gap_between(vehicles, deciders, new_leader)
    gap_behind = np.where(follower >= 0, rear - vehicles.front[follower], np.inf)
    new_gap_behind = np.where(new_follower >= 0, rear - vehicles.front[new_follower], np.inf)
    before, after = driven(deciders, gap, speed), driven(deciders, new_gap, new_speed)
    braking = driven(new_follower, new_gap_behind, own_speed)
    gain = after - before
    if keeps_right:
        to_right = vehicles.lane[deciders] > 0
        left_gap = np.where(to_right, gap, new_gap)
        left_speed = np.where(to_right, speed, new_speed)
        bound = (left_gap < np.inf) & (own_speed > left_speed) & (left_speed > CRITICAL_SPEED)
        lesser = np.minimum(before, after)
        there = np.where(bound & to_right, lesser, after)
        here = np.where(bound & ~to_right, lesser, before)
        new = braking - driven(new_follower, *gap_between(vehicles, new_follower, new_leader))
        freed = driven(follower, *gap_between(vehicles, follower, leader))
        old = freed - driven(follower, gap_behind, own_speed)
        bias = np.where(to_right, 1.0, -1.0) * kinds.keep_right_bias
        gain = there - here + bias + kinds.politeness * np.where(to_right, old, new)
    safe = (new_gap >= MARGIN) & (new_gap_behind >= MARGIN)
    safe &= (after >= -kinds.safe_braking) & (braking >= -kinds.safe_braking)
    return np.where(safe, gain - kinds.change_threshold, -np.inf)


def _beside(vehicles: Vehicles, deciders: IntArray) -> tuple[IntArray, IntArray]:
    """Returns indices of leader and follower in the other lane, -1 for none."""
    leader, follower = np.full(deciders.size, -1), np.full(deciders.size, -1)
    for lane in (0, 1):
        asks = np.flatnonzero(vehicles.lane[deciders] == 1 - lane)
        there = np.flatnonzero(vehicles.lane == lane)
        if asks.size == 0 or there.size == 0:
            continue
        there = there[np.argsort(vehicles.front[there], kind="stable")]
        place = np.searchsorted(vehicles.front[there], vehicles.front[deciders[asks]], side="right")
        leader[asks] = np.where(place < there.size, there[np.minimum(place, there.size - 1)], -1)
        follower[asks] = np.where(place > 0, there[np.maximum(place - 1, 0)], -1)
    return leader, follower
