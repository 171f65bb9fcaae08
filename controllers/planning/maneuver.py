"""Which lane, and how to get there: keep, change, give up, leave a lane that ends.

The lateral half of the planner as a state machine. The plan across the road is the lane's path plus
a quintic residual over station, so that the plans of successive cycles are one curve.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from controllers.planning.lane_change import (
    Change,
    LaneChoice,
    Step,
    lateral_limit,
    quintic_back,
    quintic_change,
)
from controllers.planning.road_preview import LanePath, RoadPreview
from controllers.planning.rollover_limits import RollMargin
from controllers.planning.safety import conflict
from controllers.planning.stopped_vehicle import Breakdown, blocker, way_past
from controllers.planning.surroundings import Surroundings
from controllers.planning.trajectory import Quintic
from iits_mj.core.messages import Decision, EgoState, PlanMode, Scene
from iits_mj.parameters import TruckParameters

if TYPE_CHECKING:
    from controllers.planning.config import PlannerConfig

# Places at which the road is looked at along a change [m].
_SAMPLE = 15.0


class Maneuver:
    """Keeps, changes and aborts; one `step` a planning cycle.

    Attributes:
      lane_changes: completed; refused: missing lane or no room in time; unsafe: refused for a
        vehicle; aborted: given up under way.
      change: under way, or None; residual: offset from the path, or None for none.
    """

    def __init__(
        self, preview: RoadPreview, config: PlannerConfig, parameters: TruckParameters
    ) -> None:
        self.preview = preview
        self._parameters = parameters
        self.config = config
        self._lanes = LaneChoice(preview, config)
        self._breakdown = Breakdown(preview, config)
        self.reset()

    def reset(self) -> None:
        """Forgets plan, manoeuvre and counters."""
        self.lane_changes = self.refused = self.unsafe = self.aborted = 0
        self.change: Change | None = None
        self.residual: Quintic | None = None
        self._middle: float | None = None
        self._changed_at = -math.inf
        self._breakdown.reset()

    @property
    def mode(self) -> PlanMode:
        """What is being done across the road."""
        if self.change is None:
            return PlanMode.LANE_KEEPING
        return PlanMode.ABORT if self.change.aborted else PlanMode.LANE_CHANGE

    @property
    def pulls_out_until(self) -> float:
        """Station up to which the truck pulls out slowly [m]; minus infinity when it does not."""
        change, residual = self.change, self.residual
        if change is None or residual is None or not change.pull_out or change.aborted:
            return -math.inf
        return residual.end

    def lane(self, ego: EgoState) -> int:
        """Index of the lane being kept or changed to."""
        middle = ego.offset if self._middle is None else self._middle
        return self.preview.nearest_lane(ego.station, middle)

    def origin(self, ego: EgoState) -> LanePath | None:
        """Path of the lane that is being left, None outside a change."""
        if self.change is None or self.change.aborted or self.residual is None:
            return None
        return self._origin(ego)

    def step(
        self,
        scene: Scene,
        surroundings: Surroundings,
        decision: Decision,
        top: float,
        margin: RollMargin,
    ) -> Step:
        """Goes on with what is under way, or begins what was decided.

        Args:
          scene: the truck.
          surroundings: the traffic of the scene.
          decision: of the decision maker; ignored while a change is under way.
          top: greatest speed that may be reached during a change [m/s].
          margin: of the truck with its load.
        """
        ego = scene.ego
        path = self._lanes.follow(self.lane(ego), ego)
        self._middle = float(path.offset_at(ego.station))
        self._recover(ego, path, margin)
        self._progress(scene, path)
        stands = ego.speed <= self.config.pull_out.lead_speed
        if stands and self.change is not None and self.change.pull_out and self.change.aborted:
            # Given up and standing again: what is left of the way back is driven with the lane.
            self._changed_at, self.change = scene.time, None
        if self.change is None:
            return self._decide(scene, surroundings, path, decision, top, margin)
        if self._must_abort(ego, surroundings, path):
            return Step(self._abort(ego, path, margin))
        return Step(path)

    def _state(self, ego: EgoState) -> tuple[float, float, float]:
        """Planned offset from the path [m], slope and bend, where the truck is."""
        if self.residual is None:
            return 0.0, 0.0, 0.0
        value, slope, bend, _ = self.residual.evaluate(ego.station)
        return float(value), float(slope), float(bend)

    def _recover(self, ego: EgoState, path: LanePath, margin: RollMargin) -> None:
        """Begins anew from where the truck is when it is far from what was planned."""
        error = ego.offset - float(path.driven_at(ego.station))
        planned, slope, _ = self._state(ego)
        if abs(error - planned) > self.config.recover_offset:
            self.residual = self._back(ego, error, slope, 0.0, margin)

    def _back(
        self, ego: EgoState, value: float, slope: float, bend: float, margin: RollMargin
    ) -> Quintic:
        config = self.config.change
        felt = self._felt(ego.station, config.duration_max * ego.speed, ego.speed)
        limit = config.total_share * margin.threshold - felt
        limit /= margin.amplified(ego.speed)
        return quintic_back(ego.station, value, slope, bend, ego.speed, config, limit)

    def _progress(self, scene: Scene, path: LanePath) -> None:
        """Ends what is finished."""
        ego = scene.ego
        if self.residual is None or ego.station < self.residual.end:
            return
        error = abs(ego.offset - float(path.driven_at(ego.station)))
        if self.change is None:
            self.residual = None
        elif error < self.config.settled_offset:
            if not self.change.aborted:
                self.lane_changes += 1
            self._changed_at = scene.time
            self.residual = self.change = None

    def _decide(
        self,
        scene: Scene,
        surroundings: Surroundings,
        path: LanePath,
        decision: Decision,
        top: float,
        margin: RollMargin,
    ) -> Step:
        """Begins a change where one is wanted and possible; else says why not."""
        must = self._lanes.mandatory(scene.ego, path)
        wanted = decision if must is Decision.KEEP else must
        passes, stays = self._breakdown.passes(surroundings, path)
        own = wanted is Decision.KEEP and passes
        wanted = self._lanes.around(scene.ego, path) if own else wanted
        if wanted is Decision.KEEP:
            return Step(path, stays)
        forced = must is not Decision.KEEP
        slow = scene.ego.speed < self.config.change.speed_min and not forced
        who = blocker(surroundings, path, self.config.pull_out, 60.0) if slow else None
        target, why = self._lanes.target(
            scene.ego,
            path,
            wanted,
            forced=forced,
            pull_out=who is not None,
            since=scene.time - self._changed_at,
            finding=self.residual is not None,
        )
        unsafe = False
        if target is not None and not why:
            here = float(np.interp(scene.ego.station, target.station, target.speed_limit))
            limit = self.config.safety.unlimited_speed if math.isinf(here) else here
            why = conflict(surroundings, target, self.config.safety, limit=limit) or ""
            unsafe = bool(why)
        if target is not None and not why and who is not None:
            why = self._pull_out(surroundings, path, target, wanted, who.vehicle.id)
            if not why:
                return Step(target, f"pulling out past {who.vehicle.id}")
        elif target is not None and not why:
            why = self._begin(scene.ego, path, target, wanted, top, margin, forced)
            if not why:
                return Step(target, f"changing to the {wanted.name.lower()}")
        if not forced and not own:
            self.refused += 1
            self.unsafe += unsafe
        reason = f"{wanted.name.lower()} refused: {why}"
        return Step(path, reason, wanted, unsafe, target if forced else None)

    def _begin(
        self,
        ego: EgoState,
        path: LanePath,
        target: LanePath,
        wanted: Decision,
        top: float,
        margin: RollMargin,
        forced: bool,
    ) -> str:
        """Plans the quintic and takes it up; else says why there is none."""
        planned, slope, bend = self._state(ego)
        start = float(path.driven_at(ego.station))
        size = start + planned - float(target.driven_at(ego.station))
        change, reach = self.config.change, self.config.change.duration_min * top
        quintic = None
        for _ in range(4):
            limit = lateral_limit(margin, top, self._felt(ego.station, reach, top), change)
            quintic = quintic_change(ego.station, size, slope, bend, top, limit, change)
            if quintic is None or quintic.length <= reach + 1e-6:
                break
            # A longer change may run into the next bend.
            reach = quintic.length
        if quintic is None:
            return "curve and cross-slope leave no lateral acceleration for a change"
        self.residual = quintic
        origin = float(path.offset_at(ego.station))
        self._middle = float(target.offset_at(ego.station))
        self.change = Change(wanted, origin, abs(size), mandatory=forced)
        return ""

    def _pull_out(
        self,
        surroundings: Surroundings,
        path: LanePath,
        target: LanePath,
        wanted: Decision,
        who: str,
    ) -> str:
        """Takes up the way past somebody who stands; else says why there is none."""
        ego = surroundings.scene.ego
        planned, slope, bend = self._state(ego)
        size = planned + float(path.driven_at(ego.station)) - float(target.driven_at(ego.station))
        state = size, slope, bend
        config = self.config.pull_out
        found = way_past(surroundings, self.preview, self._parameters, target, state, config)
        if found is None:
            return "tractor and trailer do not get past who stands ahead"
        self.residual = found
        origin = float(path.offset_at(ego.station))
        self._middle = float(target.offset_at(ego.station))
        self.change = Change(wanted, origin, abs(size), passes=who)
        return ""

    def _must_abort(self, ego: EgoState, surroundings: Surroundings, path: LanePath) -> bool:
        change, residual = self.change, self.residual
        if change is None or residual is None or change.aborted:
            return False
        if change.pull_out:
            return self._drives_on(surroundings, change)
        left = abs(self._state(ego)[0])
        if left < (1.0 - self.config.change.abort_share) * change.size:
            return False
        safety = self.config.safety
        if conflict(surroundings, path, safety, safety.abort_factor) is None:
            return False
        origin = self._origin(ego)
        braking = ego.speed**2 / (2.0 * self.config.merge.stop_deceleration)
        if origin.end - ego.station < braking + self.config.merge.room:
            return False
        return self._way_back(surroundings, origin)

    def _drives_on(self, surroundings: Surroundings, change: Change) -> bool:
        """Whether who stood drives on while the truck is still in its lane, with a way back."""
        scene, config = surroundings.scene, self.config
        who = next((v for v in scene.vehicles if v.id == change.passes), None)
        if who is None or who.speed <= config.pull_out.moves:
            return False
        origin = self._origin(scene.ego)
        aside = abs(scene.ego.offset - float(origin.offset_at(scene.ego.station)))
        if aside + 0.5 * scene.footprint.width > origin.half_width:
            return False
        return self._way_back(surroundings, origin)

    def _way_back(self, surroundings: Surroundings, origin: LanePath) -> bool:
        """Whether the lane that is being left has room for the truck: nobody beside or near."""
        ahead = surroundings.leader(origin)
        return surroundings.beside(origin) is None and (
            ahead is None or ahead.gap > self.config.safety.margin
        )

    def _origin(self, ego: EgoState) -> LanePath:
        assert self.change is not None
        return self._lanes.follow(
            self.preview.nearest_lane(ego.station, self.change.origin_offset), ego
        )

    def _abort(self, ego: EgoState, target: LanePath, margin: RollMargin) -> LanePath:
        assert self.change is not None
        value, slope, bend = self._state(ego)
        origin = self._origin(ego)
        value += float(target.driven_at(ego.station)) - float(origin.driven_at(ego.station))
        self.residual = self._back(ego, value, slope, bend, margin)
        self._middle = float(origin.offset_at(ego.station))
        self.change.aborted = True
        self.aborted += 1
        return origin

    def _felt(self, station: float, reach: float, speed: float) -> float:
        """Greatest lateral acceleration that the road gives on a stretch [m/s2], a magnitude."""
        count = 2 + math.ceil(max(reach, 1.0) / _SAMPLE)
        ahead = np.linspace(station, station + max(reach, 1.0), count)
        return float(np.abs(self.preview.felt(ahead, speed)).max())
