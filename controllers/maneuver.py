"""Which lane, and how to get there: keep, change, give up, leave a lane that ends.

The lateral half of the planner as a state machine. The plan across the road is the lane's path plus
a quintic residual over station, so that the plans of successive cycles are one curve.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from controllers.lane_change import lateral_limit, quintic_back, quintic_change
from controllers.lateral_limits import RollMargin
from controllers.pull_out import blocker, way_past
from controllers.quintic import Quintic
from controllers.road_preview import LanePath, RoadPreview
from controllers.safety import conflict
from controllers.surroundings import Surroundings
from iits_mj.messages import Decision, EgoState, PlanMode, Scene
from iits_mj.parameters import TruckParameters

if TYPE_CHECKING:
    from controllers.planner_config import PlannerConfig

BEHIND = 150.0
# Places at which the road is looked at along a change [m].
_SAMPLE = 15.0


@dataclass(slots=True)
class Change:
    """A lane change under way: direction, the lane it left, its size [m], given up or not.

    `pull_out`: from low speed, past somebody who stands.
    """

    direction: Decision
    origin_offset: float
    size: float
    aborted: bool = False
    mandatory: bool = False
    pull_out: bool = False


@dataclass(frozen=True, slots=True)
class Step:
    """What the state machine says in one cycle.

    Attributes:
      path: of the lane kept or changed to; reason: why not as decided, "" for nothing to say.
      refused: the decision refused; unsafe: because of a vehicle.
      wanted: path of the lane that must be reached but is not free, None for none.
    """

    path: LanePath
    reason: str = ""
    refused: Decision = Decision.KEEP
    unsafe: bool = False
    wanted: LanePath | None = None


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
        self.reset()

    def reset(self) -> None:
        """Forgets plan, manoeuvre and counters."""
        self.lane_changes = self.refused = self.unsafe = self.aborted = 0
        self.change: Change | None = None
        self.residual: Quintic | None = None
        self._middle: float | None = None
        self._changed_at = -math.inf
        self._stands_since: float | None = None

    @property
    def mode(self) -> PlanMode:
        """What is being done across the road."""
        if self.change is None:
            return PlanMode.LANE_KEEPING
        return PlanMode.ABORT if self.change.aborted else PlanMode.LANE_CHANGE

    @property
    def pulls_out_until(self) -> float:
        """Station up to which the truck pulls out slowly [m]; minus infinity when it does not."""
        pulls_out = self.change is not None and self.change.pull_out and self.residual is not None
        return self.residual.end if pulls_out and self.residual is not None else -math.inf

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
        path = self._follow(self.lane(ego), ego)
        self._middle = float(path.offset_at(ego.station))
        self._recover(ego, path, margin)
        self._progress(scene, path)
        if self.change is None:
            return self._decide(scene, surroundings, path, decision, top, margin)
        if self._must_abort(ego, surroundings, path):
            return Step(self._abort(ego, path, margin))
        return Step(path)

    def _follow(self, lane: int, ego: EgoState) -> LanePath:
        return self.preview.follow(lane, ego.station, self.config.speed.preview, BEHIND)

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
        must = self._mandatory(scene.ego, path)
        wanted = decision if must is Decision.KEEP else must
        own = wanted is Decision.KEEP and self._stands_behind(scene, surroundings, path)
        wanted = self._way_around(scene.ego, path) if own else wanted
        if wanted is Decision.KEEP:
            return Step(path)
        forced = must is not Decision.KEEP
        slow = scene.ego.speed < self.config.change.speed_min and not forced
        pull_out = slow and blocker(surroundings, path, self.config.pull_out, 60.0) is not None
        target, why = self._target(scene, path, wanted, forced, pull_out)
        unsafe = False
        if target is not None and not why:
            here = float(np.interp(scene.ego.station, target.station, target.speed_limit))
            limit = self.config.safety.unlimited_speed if math.isinf(here) else here
            why = conflict(surroundings, target, self.config.safety, limit=limit) or ""
            unsafe = bool(why)
        if target is not None and not why and pull_out:
            why = self._pull_out(surroundings, path, target, wanted)
            if not why:
                who = blocker(surroundings, path, self.config.pull_out, 60.0)
                name = who.vehicle.id if who is not None else "who stands there"
                return Step(target, f"pulling out past {name}")
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

    def _stands_behind(self, scene: Scene, surroundings: Surroundings, path: LanePath) -> bool:
        """Whether the truck has long been standing behind somebody who stands, too."""
        config = self.config.pull_out
        reach = config.gap + 10.0
        if scene.ego.speed > config.lead_speed or not blocker(surroundings, path, config, reach):
            self._stands_since = None
            return False
        if self._stands_since is None:
            self._stands_since = scene.time
        return scene.time - self._stands_since >= config.patience

    def _way_around(self, ego: EgoState, path: LanePath) -> Decision:
        """The side with a lane that the truck may use, the left one first."""
        for side in (Decision.LEFT, Decision.RIGHT):
            lane = path.lane - int(side)
            if lane in self.config.lanes and self.preview.lane_exists(lane, ego.station):
                return side
        return Decision.KEEP

    def _pull_out(
        self, surroundings: Surroundings, path: LanePath, target: LanePath, wanted: Decision
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
        self.change = Change(wanted, origin, abs(size), pull_out=True)
        return ""

    def _target(
        self, scene: Scene, path: LanePath, wanted: Decision, forced: bool, pull_out: bool
    ) -> tuple[LanePath | None, str]:
        """Path of the wanted lane and why it may not be taken, apart from traffic."""
        ego, change = scene.ego, self.config.change
        lane = path.lane - int(wanted)
        if not self.preview.lane_exists(lane, ego.station):
            return None, f"there is no lane to the {wanted.name.lower()}"
        if not forced and lane not in self.config.lanes:
            return None, f"lane {lane} is not one the truck may use"
        if ego.speed < change.speed_min and not forced and not pull_out:
            return None, f"speed {ego.speed:.1f} m/s is below {change.speed_min:g} m/s"
        target = self._follow(lane, ego)
        if self.residual is not None:
            return target, "the truck is still finding its lane"
        since = scene.time - self._changed_at
        if since < change.pause and not forced:
            return target, f"the last change was {since:.1f} s ago, {change.pause:g} s must pass"
        needed = max(ego.speed, 10.0) * change.duration_max + change.lane_left
        if target.end - ego.station < needed and not forced:
            left = target.end - ego.station
            return target, f"the lane ends in {left:.0f} m, {needed:.0f} m are needed"
        return target, ""

    def _mandatory(self, ego: EgoState, path: LanePath) -> Decision:
        """The way out of a lane that ends, when it is near."""
        change = self.config.change
        # Not of the speed alone: who slows down for a gap is still about to leave the lane.
        speed = max(ego.speed, self.config.speed.cruise_speed)
        reach = max(speed * change.merge_time, change.merge_distance)
        if path.end - ego.station > reach or path.end >= self.preview.station[-1]:
            return Decision.KEEP
        best, choice = path.end, Decision.KEEP
        for side in (Decision.LEFT, Decision.RIGHT):
            lane = path.lane - int(side)
            if self.preview.lane_exists(lane, ego.station):
                end = self._follow(lane, ego).end
                if end > best:
                    best, choice = end, side
        return choice

    def _must_abort(self, ego: EgoState, surroundings: Surroundings, path: LanePath) -> bool:
        change, residual = self.change, self.residual
        if change is None or residual is None or change.aborted or change.pull_out:
            return False
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
        back = surroundings.leader(origin)
        return surroundings.beside(origin) is None and (back is None or back.gap > safety.margin)

    def _origin(self, ego: EgoState) -> LanePath:
        assert self.change is not None
        return self._follow(self.preview.nearest_lane(ego.station, self.change.origin_offset), ego)

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
