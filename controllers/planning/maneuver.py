"""The lateral half of the planner, a state machine: keep, change, abort, leave a lane that ends.

The plan across the road is the lane's path plus a quintic residual over station, so that the plans
of successive cycles are one curve.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from controllers.planning.config import PlannerConfig
from controllers.planning.keep_right import stays_free
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
from controllers.planning.stopped_vehicle import StoppedLeader, stopped_leader, way_past
from controllers.planning.trajectory import Quintic
from iits_mj.core.messages import Decision, EgoState, PlanMode, Scene
from iits_mj.parameters import TruckParameters

# Spacing of the road's samples along a change [m].
_SAMPLE = 15.0
# The truck passes a stopped vehicle within this distance at low speed [m].
_PASSING_REACH = 60.0


class Maneuver:
    """Keeps, changes and aborts; one `step` per planning cycle.

    Attributes:
      lane_changes: completed; refused: decisions refused; unsafe: those refused because of a
        vehicle; aborted: changes aborted under way.
      change: under way, or None; residual: offset from the path, or None.
    """

    def __init__(
        self, preview: RoadPreview, config: PlannerConfig, parameters: TruckParameters
    ) -> None:
        self.preview = preview
        self._parameters = parameters
        self.config = config
        self._lanes = LaneChoice(preview, config)
        self._stopped = StoppedLeader(preview, config)
        self.reset()

    def reset(self) -> None:
        """Clears plan, maneuver and counters."""
        self.lane_changes = self.refused = self.unsafe = self.aborted = 0
        self.change: Change | None = None
        self.residual: Quintic | None = None
        self._middle: float | None = None
        self._changed_at = -math.inf
        self._stopped.reset()

    @property
    def mode(self) -> PlanMode:
        """Lane keeping, lane change or abort."""
        if self.change is None:
            return PlanMode.LANE_KEEPING
        return PlanMode.ABORT if self.change.aborted else PlanMode.LANE_CHANGE

    @property
    def passing_until(self) -> float:
        """Station up to which the truck passes a stopped vehicle slowly, or -inf [m]."""
        change, residual = self.change, self.residual
        if change is None or residual is None or not change.passed_id or change.aborted:
            return -math.inf
        return residual.end

    def lane(self, ego: EgoState) -> int:
        """Index of the lane being kept or changed to."""
        middle = ego.offset if self._middle is None else self._middle
        return self.preview.nearest_lane(ego.station, middle)

    def path(self, ego: EgoState) -> LanePath:
        """Path of that lane."""
        return self._lanes.follow(self.lane(ego), ego)

    def origin(self, ego: EgoState) -> LanePath | None:
        """Path of the lane that the truck is leaving, also as it aborts; None outside a change."""
        if self.change is None or self.residual is None:
            return None
        return self._origin(ego, self.change)

    def step(
        self, scene: Scene, decision: Decision, top: Callable[[], float], margin: RollMargin
    ) -> Step:
        """Continues the maneuver under way, or begins the decided one.

        Args:
          scene: the truck and the traffic.
          decision: of the decision maker; ignored while a change is under way.
          top: gives the greatest speed that the truck may reach during a change [m/s].
          margin: of the truck with its load.
        """
        ego = scene.ego
        path = self.path(ego)
        self._middle = float(path.offset_at(ego.station))
        self._recover(ego, path, margin)
        self._progress(scene, path)
        at_rest = ego.speed <= self.config.passing.lead_speed
        if at_rest and self.change is not None and self.change.passed_id and self.change.aborted:
            # Aborted and at rest: the truck drives the rest of the way back as lane keeping.
            self._changed_at, self.change = scene.time, None
        if self.change is None:
            return self._decide(scene, path, decision, top, margin)
        if self.residual is not None and self._must_abort(scene, path, self.change):
            return Step(self._abort(ego, path, self.change, margin))
        return Step(path)

    def _state(self, ego: EgoState) -> tuple[float, float, float]:
        """Planned offset from the path [m], slope [1] and bend [1/m] at the truck."""
        if self.residual is None:
            return 0.0, 0.0, 0.0
        value, slope, bend, _ = self.residual.evaluate(ego.station)
        return float(value), float(slope), float(bend)

    def _recover(self, ego: EgoState, path: LanePath, margin: RollMargin) -> None:
        """Plans from the truck's position when the truck is far from the plan."""
        error = ego.offset - float(path.driven_at(ego.station))
        planned, slope, _ = self._state(ego)
        if abs(error - planned) > self.config.recover_offset:
            self.residual = self._back(ego, error, slope, 0.0, margin)

    def _back(
        self, ego: EgoState, value: float, slope: float, bend: float, margin: RollMargin
    ) -> Quintic:
        """The return to the path from an offset [m] with its derivatives."""
        config = self.config.change
        felt = self._felt(ego.station, config.duration_max * ego.speed, ego.speed)
        limit = config.total_share * margin.threshold - felt
        limit /= margin.amplified(ego.speed)
        return quintic_back(ego.station, value, slope, bend, ego.speed, config, limit)

    def _progress(self, scene: Scene, path: LanePath) -> None:
        """Ends a maneuver that is complete."""
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
        path: LanePath,
        decision: Decision,
        top: Callable[[], float],
        margin: RollMargin,
    ) -> Step:
        """Begins a change if it is wanted and possible; otherwise gives the reason."""
        ego, config = scene.ego, self.config
        must = self._lanes.mandatory(ego, path)
        forced = must is not Decision.KEEP
        wanted = must if forced else decision
        passes, stays = self._stopped.passes(scene, path)
        own = wanted is Decision.KEEP and passes
        wanted = self._lanes.around(ego, path) if own else wanted
        if wanted is Decision.KEEP and not stays and self._returns(scene, path):
            wanted, own = Decision.RIGHT, True
        if wanted is Decision.KEEP:
            return Step(path, stays)
        slow = ego.speed < config.change.speed_min and not forced
        stopped = stopped_leader(scene, path, config.passing, _PASSING_REACH) if slow else None
        target, why = self._lanes.target(
            ego,
            path,
            wanted,
            forced=forced,
            passing=stopped is not None,
            since=scene.time - self._changed_at,
            finding=self.residual is not None,
        )
        unsafe = False
        if wanted is Decision.LEFT and not (why or forced or own or stopped is not None):
            why = self.stays_right(scene, path)
        if target is not None and not why:
            why = self._conflict(scene, target)
            unsafe = bool(why)
        if target is not None and not why:
            done = f"changing to the {wanted.name.lower()}"
            if stopped is not None:
                done = f"passing {stopped.id}"
                why = self._begin_passing(scene, path, target, stopped.id)
            else:
                why = self._begin(ego, path, target, top(), margin)
            if not why:
                return Step(target, done)
        if not forced and not own:
            self.refused += 1
            self.unsafe += unsafe
        reason = f"{wanted.name.lower()} refused: {why}"
        return Step(path, reason, wanted, unsafe, target if forced else None)

    def stays_right(self, scene: Scene, path: LanePath) -> str:
        """The reason for which the truck may not pass on the left now, "" if it may."""
        if self._forbids_overtaking(scene.ego):
            return "a sign forbids trucks to overtake"
        if self.config.keep_right and self._stays_free(scene, path):
            seconds = self.config.change.keep_right_time
            return f"the truck keeps right: its lane is free for {seconds:g} s"
        return ""

    def _forbids_overtaking(self, ego: EgoState) -> bool:
        """Whether a sign forbids trucks to overtake here or before a change would end."""
        end = ego.station + self.config.change.duration_max * ego.speed
        bans = self.preview.route.overtaking_bans
        return any(first <= end and ego.station < last for first, last in bans)

    def _stays_free(self, scene: Scene, path: LanePath) -> bool:
        """Whether the truck would catch up with nobody in the lane of a path."""
        ego, speed = scene.ego, self.config.speed
        limit = float(np.interp(ego.station, path.station, path.speed_limit))
        return stays_free(
            scene.neighbors.leader_along_path(path),
            *(ego.speed, min(speed.cruise_speed, limit)),
            *(speed.following, self.config.change.keep_right_time),
        )

    def _returns(self, scene: Scene, path: LanePath) -> bool:
        """Whether the truck keeps right here, and can return to a right lane that stays free."""
        ego, config = scene.ego, self.config
        if path.lane <= 0 or not (config.keep_right or self._forbids_overtaking(ego)):
            return False
        target, why = self._lanes.target(
            *(ego, path, Decision.RIGHT),
            forced=False,
            passing=False,
            since=scene.time - self._changed_at,
            finding=self.residual is not None,
        )
        if target is None or why or not self._stays_free(scene, target):
            return False
        # The truck does not return to a lane that it would have to leave again.
        speed = max(ego.speed, config.speed.cruise_speed)
        way = speed * (config.change.keep_right_time + config.change.merge_time)
        end = self.preview.follow(target.lane, ego.station, way, 0.0).end
        if end < min(ego.station + way, self.preview.station[-1]):
            return False
        return not self._conflict(scene, target)

    def _conflict(self, scene: Scene, target: LanePath) -> str:
        """The reason in the traffic not to enter a lane now, or ""."""
        here = float(np.interp(scene.ego.station, target.station, target.speed_limit))
        safety = self.config.safety
        limit = safety.unlimited_speed if math.isinf(here) else here
        return conflict(scene, target, safety, limit=limit) or ""

    def _begin(
        self, ego: EgoState, path: LanePath, target: LanePath, top: float, margin: RollMargin
    ) -> str:
        """Plans and begins a change; returns the reason if there is none."""
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
        self._take_up(quintic, ego, path, target, size)
        return ""

    def _begin_passing(self, scene: Scene, path: LanePath, target: LanePath, stopped: str) -> str:
        """Plans and begins a change past a stopped vehicle; returns the reason if there is none."""
        ego = scene.ego
        planned, slope, bend = self._state(ego)
        size = planned + float(path.driven_at(ego.station)) - float(target.driven_at(ego.station))
        state, config = (size, slope, bend), self.config.passing
        found = way_past(scene, self.preview, self._parameters, target, state, config)
        if found is None:
            return "tractor and trailer do not get past the stopped vehicle ahead"
        self._take_up(found, ego, path, target, size, stopped)
        return ""

    def _take_up(
        self,
        residual: Quintic,
        ego: EgoState,
        path: LanePath,
        target: LanePath,
        size: float,
        passed: str = "",
    ) -> None:
        self.residual = residual
        self.change = Change(float(path.offset_at(ego.station)), abs(size), passed)
        self._middle = float(target.offset_at(ego.station))

    def _must_abort(self, scene: Scene, path: LanePath, change: Change) -> bool:
        if change.aborted:
            return False
        ego = scene.ego
        origin = self._origin(ego, change)
        if change.passed_id:
            return self._drives_on(scene, origin, change.passed_id)
        left = abs(self._state(ego)[0])
        if left < (1.0 - self.config.change.abort_share) * change.size:
            return False
        safety = self.config.safety
        if conflict(scene, path, safety, safety.abort_factor) is None:
            return False
        braking = ego.speed**2 / (2.0 * self.config.merge.stop_deceleration)
        if origin.end - ego.station < braking + self.config.merge.room:
            return False
        return self._can_return(scene, origin)

    def _drives_on(self, scene: Scene, origin: LanePath, passed: str) -> bool:
        """Whether the passed vehicle moves off while the truck is in its lane and can return."""
        neighbors, ego = scene.neighbors, scene.ego
        if passed not in neighbors.ids:
            return False
        if neighbors.speed[neighbors.ids.index(passed)] <= self.config.passing.moves:
            return False
        aside = abs(ego.offset - float(origin.offset_at(ego.station)))
        if aside + 0.5 * scene.footprint.width > origin.half_width:
            return False
        return self._can_return(scene, origin)

    def _can_return(self, scene: Scene, origin: LanePath) -> bool:
        """Whether the lane that the truck is leaving has room for it."""
        ahead = scene.neighbors.leader_along_path(origin)
        return not scene.neighbors.is_beside(origin) and (
            ahead is None or ahead.gap > self.config.safety.margin
        )

    def _origin(self, ego: EgoState, change: Change) -> LanePath:
        lane = self.preview.nearest_lane(ego.station, change.origin_offset)
        return self._lanes.follow(lane, ego)

    def _abort(
        self, ego: EgoState, target: LanePath, change: Change, margin: RollMargin
    ) -> LanePath:
        """Begins the return to the lane that the truck has left; returns that lane's path."""
        value, slope, bend = self._state(ego)
        origin = self._origin(ego, change)
        value += float(target.driven_at(ego.station)) - float(origin.driven_at(ego.station))
        self.residual = self._back(ego, value, slope, bend, margin)
        self._middle = float(origin.offset_at(ego.station))
        change.origin_offset = float(target.offset_at(ego.station))
        change.aborted = True
        self.aborted += 1
        return origin

    def _felt(self, station: float, reach: float, speed: float) -> float:
        """Greatest lateral acceleration by the road on a stretch [m/s2], a magnitude."""
        reach = max(reach, 1.0)
        ahead = np.linspace(station, station + reach, 2 + math.ceil(reach / _SAMPLE))
        return float(np.abs(self.preview.felt(ahead, speed)).max())
