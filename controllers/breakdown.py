"""Broken down, or waiting like everybody else: whom the truck passes of itself.

Somebody who stands with free road before him, while the lanes beside move or are empty, has broken
down. Who stands behind others, or beside others who stand, is in a jam, and the truck stays in its
queue behind him. The judgment has to hold for some seconds without a break before it counts.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from controllers.pull_out import PullOutConfig, blocker
from controllers.road_preview import LanePath, RoadPreview
from controllers.surroundings import Neighbor, Surroundings

if TYPE_CHECKING:
    from controllers.planner_config import PlannerConfig


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
