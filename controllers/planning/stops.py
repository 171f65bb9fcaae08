"""Where the truck has to stand: lights, bends, lane ends, behind who is passed later.

Each of them gives a place and how hard to brake for it. The nearest is what the speed plan stops
at; the others bound the speed on the way.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from controllers.planning.crossing import is_free
from controllers.planning.road_preview import LanePath, RoadPreview
from controllers.planning.speed_plan import HOLD_REACH
from controllers.planning.stop_line import LightDemand, LightStop
from controllers.planning.stopped_vehicle import blocker, stop_behind
from controllers.planning.surroundings import Surroundings
from controllers.planning.tight_bend_yield import DECELERATION, RESTS, BendWait
from iits_mj.core.arrays import FloatArray
from iits_mj.core.messages import EgoState, Scene
from iits_mj.parameters import TruckParameters

if TYPE_CHECKING:
    from controllers.planning.config import PlannerConfig
    from controllers.planning.lane_change import Change


class Stops:
    """Looks for the places to stand at, anew in every cycle.

    Args:
      preview: of the road.
      config: settings of the planner.
      parameters: of the truck.

    Attributes:
      light: what the next light asks for; bend_reason: why the truck waits before a bend.
    """

    def __init__(
        self, preview: RoadPreview, config: PlannerConfig, parameters: TruckParameters
    ) -> None:
        self._preview = preview
        self._config = config
        self._line = LightStop(config.light)
        self.bends = BendWait(preview, parameters)
        self.reset()

    def reset(self) -> None:
        """Forgets choices and waits."""
        self._line.reset()
        self.bends.reset()
        self.light = LightDemand()
        self.bend_reason = ""
        self._bend = self._room = math.inf
        self._held: float | None = None

    def look(
        self, surroundings: Surroundings, path: LanePath, cap: FloatArray, change: Change | None
    ) -> FloatArray:
        """Finds all places but the lane's end; the bound on the speed with that of bends.

        Args:
          surroundings: the traffic.
          path: of the lane kept or changed to.
          cap: bound on the speed so far, shape of path.station [m/s].
          change: under way, or None.
        """
        scene = surroundings.scene
        self.light = self._line.demand(
            scene.signals.light,
            surroundings.front,
            scene.ego.speed,
            scene.time,
            lambda line: is_free(scene, self._preview, line),
        )
        self._room = self._keeps_room(surroundings, path, change)
        cap, self._bend, self.bend_reason = self.bends.demand(surroundings, path, cap)
        return cap

    def nearest(
        self, scene: Scene, path: LanePath, cap: FloatArray, *, waits: bool
    ) -> tuple[float, float, FloatArray]:
        """Where the steer axle stands next [m], how hard to brake [m/s2], bound up to there.

        Args:
          scene: the truck.
          path: of the lane.
          cap: bound on the speed so far, shape of path.station [m/s].
          waits: the lane ends and the next one is not free.
        """
        (stop, deceleration), *further = self._places(scene, path, waits=waits)
        for place, braking in further:
            left = np.maximum(place - path.station, 0.0)
            cap = np.minimum(cap, np.sqrt(2.0 * braking * left))
        light, ego = self.light, scene.ego
        if math.isfinite(light.speed):
            way = np.maximum(path.station - ego.station, 0.0)
            square = ego.speed**2 - 2.0 * self._config.light.arrival_deceleration * way
            arriving = np.sqrt(np.maximum(square, light.speed**2))
            before = path.station < light.stop - scene.footprint.front_overhang
            cap = np.minimum(cap, np.where(before, arriving, np.inf))
        return stop, deceleration, cap

    def holds(self, stop: float, ego: EgoState) -> bool:
        """Whether the truck has come to rest at a stop, which it then does not creep on from."""
        if self._held is not None and stop > self._held + HOLD_REACH:
            self._held = None
        left = stop - ego.station
        rests = left < HOLD_REACH and ego.speed < (RESTS if left > 0.0 else 2.0 * RESTS)
        if self._held is None and rests:
            self._held = stop
        return self._held is not None

    def _places(self, scene: Scene, path: LanePath, *, waits: bool) -> list[tuple[float, float]]:
        """Where the steer axle has to stand [m] and how hard to brake for it, nearest first."""
        overhang, speed = scene.footprint.front_overhang, self._config.speed
        end = (path.end - speed.stop_gap - overhang, speed.following.preview_deceleration)
        if waits:
            merge = self._config.merge
            end = (path.end - merge.room - overhang, merge.stop_deceleration)
        stops = [end, (self.light.stop - overhang, self.light.deceleration)]
        stops.append((self._bend, DECELERATION))
        stops.append((self._room - overhang, 0.8 * self._config.pull_out.deceleration))
        return sorted(stop for stop in stops if math.isfinite(stop[0])) or [(math.inf, end[1])]

    def _keeps_room(
        self, surroundings: Surroundings, path: LanePath, change: Change | None
    ) -> float:
        """Where the front bumper stops behind who stands, to pull out later [m]."""
        ego, config = surroundings.scene.ego, self._config.pull_out
        beside = (path.lane - 1, path.lane + 1)
        usable = [lane for lane in beside if lane in self._config.lanes]
        under_way = change is not None and not (change.pull_out and change.aborted)
        if under_way or not any(self._preview.lane_exists(i, ego.station) for i in usable):
            return math.inf
        leader = blocker(surroundings, path, config, self._config.speed.preview)
        return stop_behind(leader, ego.speed, surroundings.front, config)
