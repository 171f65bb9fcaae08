"""Leader and follower side by side, as car-following models are calibrated to them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from iits_mj.core.arrays import FloatArray
from iits_mj.core.errors import InputError
from traffic_bridge.datasets.trajectories import Trajectories


@dataclass(frozen=True, eq=False)
class Pair:
    """A vehicle behind one and the same leader, without interruption; arrays of shape (n,).

    Attributes:
      follower, leader: names; kind: of the follower.
      lane: of the follower at the beginning, index from the right.
      leader_length: [m].
      time: [s], evenly spaced.
      station, speed, acceleration: of the follower, front bumper [m], [m/s], [m/s2].
      leader_station, leader_speed, leader_acceleration: of the leader, front bumper.
    """

    follower: str
    leader: str
    kind: str
    lane: int
    leader_length: float
    time: FloatArray
    station: FloatArray
    speed: FloatArray
    acceleration: FloatArray
    leader_station: FloatArray
    leader_speed: FloatArray
    leader_acceleration: FloatArray

    @property
    def gap(self) -> FloatArray:
        """From the follower's front to the leader's rear [m], shape (n,)."""
        return self.leader_station - self.leader_length - self.station

    @property
    def duration(self) -> float:
        """[s]."""
        return float(self.time[-1] - self.time[0])


def pairs(trajectories: Trajectories, minimum_duration: float = 15.0) -> tuple[Pair, ...]:
    """Every stretch in which a vehicle follows one leader, both being recorded.

    A stretch ends where the leader changes, where follower or leader is missing for an instant, and
    where the follower changes lanes.

    Args:
      trajectories: of any source.
      minimum_duration: shorter stretches are left out [s].

    Raises:
      InputError: the duration is not positive.
    """
    if not (np.isfinite(minimum_duration) and minimum_duration > 0.0):
        raise InputError(f"minimum_duration {minimum_duration!r}: must be positive")
    t = trajectories
    ahead = t.leader_rows
    if not len(t):
        return ()
    goes_on = (
        (np.diff(t.vehicle) == 0)
        & (np.diff(t.leader) == 0)
        & (np.diff(t.lane) == 0)
        & (np.diff(t.time) < 1.5 * t.step)
        & (ahead[1:] >= 0)
        & (ahead[:-1] >= 0)
    )
    starts = np.concatenate(([0], np.flatnonzero(~goes_on) + 1))
    ends = np.concatenate((starts[1:], [len(t)]))
    long = (t.time[ends - 1] - t.time[starts] >= minimum_duration - 1e-6) & (ahead[starts] >= 0)
    return tuple(_pair(t, slice(a, b)) for a, b in zip(starts[long], ends[long], strict=True))


def _pair(t: Trajectories, rows: slice) -> Pair:
    ahead = t.leader_rows[rows]
    first = rows.start
    return Pair(
        follower=t.ids[t.vehicle[first]],
        leader=t.ids[t.leader[first]],
        kind=t.kinds[t.vehicle[first]],
        lane=int(t.lane[first]),
        leader_length=float(t.length[t.leader[first]]),
        time=t.time[rows],
        station=t.station[rows],
        speed=t.speed[rows],
        acceleration=t.acceleration[rows],
        leader_station=t.station[ahead],
        leader_speed=t.speed[ahead],
        leader_acceleration=t.acceleration[ahead],
    )
