"""Broken down, or waiting like everybody else: whom the truck passes of itself.

Somebody who stands with free road before him, while the lanes beside move or are empty, has broken
down. Who stands behind others, or beside others who stand, is in a jam, and the truck stays in its
queue behind him. The judgment has to hold for some seconds without a break before it counts.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from controllers.planning.crossing import bodies_along
from controllers.planning.predicted_boxes import poses, touching
from controllers.planning.road_preview import LanePath, RoadPreview
from controllers.planning.surroundings import Neighbor, Surroundings
from controllers.planning.trajectory import Quintic
from iits_mj.parameters import TruckParameters

# --- Past a vehicle that stands in the lane: pulling out from low speed ---
# At walking pace the size of a lane change is bounded by how far the truck can steer and by where
# its trailer goes, not by comfort. The way is chosen so that neither tractor nor trailer touches
# who stands, which needs some distance to it: the truck stops early enough behind it.


@dataclass(frozen=True)
class PullOutConfig:
    """How a standing vehicle is passed.

    Attributes:
      lead_speed: who is slower stands in the way [m/s].
      speed: while pulling out [m/s].
      lengths: of the change, tried from the gentle one to the tight one [m]; 19 m for a lane of
        4 m has a radius of 16 m, more than the truck's least.
      room: beside and behind who stands [m].
      gap: kept to who stands, from the front bumper, for the pull-out [m].
      patience: after standing so long behind somebody who stands alone the truck passes it of
        itself: a decision maker that weighs accelerations sees no gain while there is room ahead
        [s].
      free: road ahead of who stands, and beside, that a jam would fill [m].
      creep_speed: who is slower there is in a queue [m/s].
      sight: how far lanes beside are looked along [m].
      moves: who is faster has driven on, which ends the reason to pull out [m/s].
      deceleration: to that place, positive [m/s2]; who is nearer already stops nearer.
      light_near: a vehicle within this of a traffic light's line waits there [m].
      reach: from a vehicle on this far, the trailer is past it [m].
    """

    lead_speed: float = 0.5
    speed: float = 3.0
    lengths: tuple[float, ...] = (30.0, 25.0, 22.0, 19.0)
    room: float = 0.35
    gap: float = 16.0
    patience: float = 5.0
    free: float = 40.0
    creep_speed: float = 2.0
    sight: float = 150.0
    moves: float = 1.0
    deceleration: float = 1.0
    light_near: float = 150.0
    reach: float = 35.0


def blocker(
    surroundings: Surroundings, path: LanePath, config: PullOutConfig, reach: float
) -> Neighbor | None:
    """Who stands ahead in the lane of a path within `reach` metres, not at a traffic light."""
    leader = surroundings.leader(path)
    if leader is None or abs(leader.vehicle.speed) > config.lead_speed or leader.gap > reach:
        return None
    light = surroundings.scene.signals.light
    if light is not None and -5.0 < light.station - leader.vehicle.station < config.light_near:
        return None
    return leader


def way_past(
    surroundings: Surroundings,
    preview: RoadPreview,
    parameters: TruckParameters,
    target: LanePath,
    state: tuple[float, float, float],
    config: PullOutConfig,
) -> Quintic | None:
    """The gentlest change on which the truck touches nobody who stands; None: there is none.

    Args:
      surroundings: the traffic.
      preview: of the road.
      parameters: of the truck.
      target: path of the lane to go to.
      state: offset from that path [m], slope [1] and bend [1/m] at the truck.
      config: settings.
    """
    ego = surroundings.scene.ego
    slow = np.abs(surroundings.speed) <= config.lead_speed
    near = np.abs(surroundings.station - ego.station) < max(config.lengths) + config.reach
    boxes = poses(surroundings.table[slow & near & surroundings.here], preview)
    standing = boxes.ahead(np.zeros(1))
    stations = np.arange(ego.station, ego.station + max(config.lengths) + config.reach, 1.0)
    for length in config.lengths:
        residual = Quintic.to_zero(ego.station, length, *state)
        units = bodies_along(parameters, preview, target, residual, stations)
        # Where the truck is now it touches nobody: nearer than the room is no reason to stay.
        if not any(touching(unit, standing, config.room)[1:].any() for unit in units):
            return residual
    return None


def stop_behind(
    leader: Neighbor | None, speed: float, front: float, config: PullOutConfig
) -> float:
    """Where the front bumper stops behind who stands, with room to pull out [m]; inf: anywhere.

    Args:
      leader: who stands, None for nobody.
      speed: of the truck [m/s].
      front: station of its front bumper [m].
      config: settings.
    """
    if leader is None:
        return np.inf
    stop = front + leader.gap - config.gap
    return stop if stop - front >= speed**2 / (2.0 * config.deceleration) - 1.0 else np.inf


# --- Broken down, or waiting like everybody else: whom the truck passes of itself ---

if TYPE_CHECKING:
    from controllers.planning.config import PlannerConfig


def stands_alone(
    surroundings: Surroundings,
    preview: RoadPreview,
    path: LanePath,
    leader: Neighbor,
    config: PullOutConfig,
) -> bool:
    """Whether nobody else stands before somebody who stands, nor in the lanes beside him.

    Args:
      surroundings: the traffic.
      preview: of the road.
      path: of his lane.
      leader: who stands.
      config: settings.
    """
    one = leader.vehicle
    middle = surroundings.station
    near = surroundings.here & (middle > surroundings.front)
    near &= middle < one.station + one.length + config.free
    others = np.array([vehicle.id != one.id for vehicle in surroundings.scene.vehicles])
    queues = near & others & (np.abs(surroundings.speed) < config.creep_speed)
    if not queues.any():
        return True
    station = surroundings.scene.ego.station
    for lane in (path.lane - 1, path.lane, path.lane + 1):
        if not preview.lane_exists(lane, station):
            continue
        along = path if lane == path.lane else preview.follow(lane, station, config.sight)
        if bool((queues & surroundings.within(along)).any()):
            return False
    return True


class Breakdown:
    """Remembers how long the truck has been standing behind whom.

    Args:
      preview: of the road.
      config: settings of the planner.
    """

    def __init__(self, preview: RoadPreview, config: PlannerConfig) -> None:
        self._preview = preview
        self._config = config
        self.reset()

    def reset(self) -> None:
        """Forgets who stood."""
        self._who, self._since = "", 0.0

    def passes(self, surroundings: Surroundings, path: LanePath) -> tuple[bool, str]:
        """Whether the truck passes who stands ahead of itself; else why not, "" for nobody there.

        Args:
          surroundings: the traffic.
          path: of the truck's lane.
        """
        config, scene = self._config.pull_out, surroundings.scene
        who = None
        if scene.ego.speed <= config.lead_speed:
            who = blocker(surroundings, path, config, config.gap + 10.0)
        if who is None:
            self.reset()
            return False, ""
        if not stands_alone(surroundings, self._preview, path, who, config):
            self.reset()
            return False, f"staying in the queue behind {who.vehicle.id}"
        if who.vehicle.id != self._who:
            self._who, self._since = who.vehicle.id, scene.time
        return scene.time - self._since >= config.patience, ""
