"""How fast the truck may go along its route: what plans take for the road's limits.

They are the trajectory planner's own bounds, so that a plan, its schedule and the lag behind it are
of a drive that can be driven: the map's limits with changing signs laid over them, bends by comfort
and by the truck's roll-over margin, each come down to at its gentle deceleration.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from controllers.lateral_limits import RollMargins
from controllers.planner_config import PlannerConfig
from controllers.road_preview import LanePath, RoadPreview
from controllers.speed_caps import SpeedCaps
from controllers.speed_zones import with_zones
from iits_mj.core.arrays import FloatArray
from iits_mj.messages import Scene, SpeedProfile
from iits_mj.parameters import TruckParameters

if TYPE_CHECKING:
    from iits_mj.road import Route

_FREE = 1e3  # [m/s] in place of no wish


class RoadLimits:
    """Greatest speeds over station, as they hold now.

    Args:
      route: the truck's road.
      step: between the nodes of plans [m].
      planner: settings of the trajectory planner.
      parameters: of the truck, with its payload's height.
    """

    def __init__(
        self, route: Route, step: float, planner: PlannerConfig, parameters: TruckParameters
    ) -> None:
        self._route, self._preview = route, RoadPreview(route)
        self._caps = SpeedCaps(self._preview, planner)
        self._margins = RollMargins(parameters, 1.0 / planner.change.duration_min)
        self._around = math.ceil(0.5 * step / self._preview.step)
        self._holding: tuple[object, ...] | None = None
        self._limit: FloatArray = np.empty(0)

    def update(self, scene: Scene) -> bool:
        """Takes what holds now; true where that is something else than before.

        Args:
          scene: the truck, its mass and lane, and the signs.

        Raises:
          InputError: a zone's limit is no positive number, or its ends are none.
        """
        ego, zones = scene.ego, scene.signals.zones
        of_lane = any(zone.lane is not None for zone in zones)
        lane = max(int(self._route.lane_at(ego.station, ego.offset)), 0) if of_lane else 0
        zones = tuple(zone for zone in zones if zone.lane is None or zone.lane == lane)
        margin = self._margins.at(ego.mass)
        if self._holding == (margin.threshold, zones):
            return False
        preview, station = self._preview, self._preview.station
        path = with_zones(
            LanePath(station, preview.offset[0], preview.speed_limit[0], 1.0, math.inf, lane), zones
        )
        free = SpeedProfile(station, np.full(station.size, _FREE))
        slowest = self._caps.cap(path, free, margin, ego)
        # A node stands for half a step to both sides.
        padded = np.pad(slowest, self._around, mode="edge")
        window = np.lib.stride_tricks.sliding_window_view(padded, 2 * self._around + 1)
        self._limit = np.asarray(window.min(axis=1))
        self._holding = (margin.threshold, zones)
        return True

    def at(self, station: FloatArray) -> FloatArray:
        """Greatest speed at the nodes of a plan [m/s], shape as station."""
        row = np.round(station / self._preview.step).astype(int)
        return np.asarray(self._limit[np.clip(row, 0, self._limit.size - 1)])
