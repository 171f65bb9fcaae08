"""Stopped vehicles: those that the truck passes without a decision, and the path past them.

A stopped vehicle with free road ahead, while the lanes beside move or are empty, has broken down. A
vehicle stopped behind others, or beside other stopped vehicles, is in a jam, and the truck stays in
the queue behind it. The truck passes only after some seconds without a sign of a jam.

At walking pace the truck's steering and the trailer's path limit a lane change, not comfort. On the
path past a stopped vehicle neither tractor nor trailer touches it. This needs some distance, so the
truck stops early enough behind it.
"""

from __future__ import annotations

import numpy as np

from controllers.planning.config import PassingConfig, PlannerConfig
from controllers.planning.predicted_boxes import Poses, bodies_along
from controllers.planning.road_preview import LanePath, RoadPreview
from controllers.planning.trajectory import Quintic
from iits_mj.core.messages import Scene
from iits_mj.core.neighbors import Neighbor
from iits_mj.parameters import TruckParameters
from iits_mj.parameters.mass_state import payload_of


def stopped_leader(
    scene: Scene, path: LanePath, config: PassingConfig, reach: float
) -> Neighbor | None:
    """The stopped vehicle ahead in the lane of a path, within `reach` meters, not at a light."""
    leader = scene.neighbors.leader_along_path(path)
    if leader is None or abs(leader.speed) > config.lead_speed or leader.gap > reach:
        return None
    light = scene.signals.light
    if light is not None and -5.0 < light.station - leader.station < config.light_near:
        return None
    return leader


def way_past(
    scene: Scene,
    preview: RoadPreview,
    parameters: TruckParameters,
    target: LanePath,
    state: tuple[float, float, float],
    config: PassingConfig,
) -> Quintic | None:
    """The gentlest change on which the truck touches no stopped vehicle, None if there is none.

    Args:
      scene: the truck and the traffic.
      preview: of the road.
      parameters: of the truck.
      target: path of the lane to go to.
      state: offset from that path [m], slope [1] and bend [1/m] at the truck.
      config: settings.
    """
    ego, neighbors = scene.ego, scene.neighbors
    longest = max(config.lengths)
    near = np.abs(neighbors.station - ego.station) < longest + config.reach
    slow = np.abs(neighbors.speed) <= config.lead_speed
    stopped = Poses.of(neighbors, slow & near & neighbors.on_level(preview), preview)
    boxes = stopped.ahead(np.zeros(1))
    stations = np.arange(ego.station, ego.station + longest + config.reach, 1.0)
    for length in config.lengths:
        residual = Quintic.to_zero(ego.station, length, *state)
        units = bodies_along(
            parameters, preview, target, residual, stations, payload_of(parameters, ego.mass)
        )
        # At its present position the truck touches nothing, even where it has less than the room.
        if not any(unit.touch(boxes, config.room)[1:].any() for unit in units):
            return residual
    return None


def _is_alone(
    scene: Scene, preview: RoadPreview, path: LanePath, leader: Neighbor, config: PassingConfig
) -> bool:
    """Whether no vehicle queues ahead of a stopped vehicle, nor in the lanes beside it."""
    neighbors, station = scene.neighbors, scene.ego.station
    near = neighbors.on_level(preview) & (neighbors.station > neighbors.front)
    near &= neighbors.station < leader.station + leader.length + config.free
    others = np.array([name != leader.id for name in neighbors.ids])
    queues = near & others & (np.abs(neighbors.speed) < config.creep_speed)
    if not queues.any():
        return True
    for lane in (path.lane - 1, path.lane, path.lane + 1):
        if not preview.lane_exists(lane, station):
            continue
        along = path if lane == path.lane else preview.follow(lane, station, config.sight)
        if bool((queues & neighbors.along_path(along)).any()):
            return False
    return True


class StoppedLeader:
    """Measures how long the truck has waited behind a stopped vehicle."""

    def __init__(self, preview: RoadPreview, config: PlannerConfig) -> None:
        self._preview = preview
        self._config = config.passing
        self.reset()

    def reset(self) -> None:
        """Clears the vehicle."""
        self._id, self._since = "", 0.0

    def passes(self, scene: Scene, path: LanePath) -> tuple[bool, str]:
        """Whether the truck passes the stopped vehicle ahead without a decision; else the reason.

        The reason is "" if there is no stopped vehicle ahead or the truck has not waited enough.
        """
        config, leader = self._config, None
        if scene.ego.speed <= config.lead_speed:
            leader = stopped_leader(scene, path, config, config.gap + 10.0)
        if leader is None:
            self.reset()
            return False, ""
        if not _is_alone(scene, self._preview, path, leader, config):
            self.reset()
            return False, f"staying in the queue behind {leader.id}"
        if leader.id != self._id:
            self._id, self._since = leader.id, scene.time
        return scene.time - self._since >= config.patience, ""
