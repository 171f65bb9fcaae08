"""The trajectory planner: the paper's Algorithm 1, with real car following and safe lane changes.

Keep: the lane's middle with the speed profile, following whoever is ahead. Change: the target lane
missing or unsafe -> keep, with the reason; else a quintic in road coordinates. While a change is
young it is given up when its gap closes; a lane that ends is left in time; the last layer brakes.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from controllers.following import Lead
from controllers.lane_change import LaneChangeConfig, quintic_back, quintic_change
from controllers.quintic import Quintic
from controllers.road_preview import LanePath, RoadPreview
from controllers.safety import SafetyConfig, conflict
from controllers.speed_plan import (
    SpeedConfig,
    SpeedState,
    most_urgent,
    power_acceleration,
    roll_out,
    speed_cap,
)
from controllers.surroundings import Neighbor, Surroundings
from controllers.trajectory import lead_of, lead_while_passing, on_road
from iits_mj.messages import Decision, EgoState, PlanMode, Scene, SpeedProfile, Trajectory

if TYPE_CHECKING:
    from iits_mj.road import Route


@dataclass(frozen=True)
class PlannerConfig:
    """All settings of the planner.

    Attributes:
      lanes: indices of the lanes that decisions may lead to; the paper uses two.
      horizon: of the trajectory [s]; step: [s].
      resync_speed: the plan's speed stays within this of the truck's [m/s].
      recover_offset: distance from the plan that makes a new one from where the truck is [m].
      settled_offset: distance from the lane's middle at which a change is complete [m].
      speed: see `SpeedConfig`; change: see `LaneChangeConfig`; safety: see `SafetyConfig`.
    """

    lanes: tuple[int, ...] = (0, 1)
    horizon: float = 6.0
    step: float = 0.1
    resync_speed: float = 0.5
    recover_offset: float = 0.8
    settled_offset: float = 0.4
    speed: SpeedConfig = field(default_factory=SpeedConfig)
    change: LaneChangeConfig = field(default_factory=LaneChangeConfig)
    safety: SafetyConfig = field(default_factory=SafetyConfig)


@dataclass(slots=True)
class _Change:
    """A lane change under way: direction, the lane it left, its size [m], given up or not."""

    direction: Decision
    origin_offset: float
    size: float
    aborted: bool = False
    mandatory: bool = False


class Planner:
    """Plans a trajectory from a scene and a decision, ten times a second.

    Attributes:
      lane_changes: completed; refused: missing lane or no room in time; unsafe: refused for a
        vehicle; aborted: given up under way; emergencies: number of times the last layer acted.
    """

    def __init__(self, route: Route, config: PlannerConfig | None = None) -> None:
        self.route = route
        self.config = config or PlannerConfig()
        self.preview = RoadPreview(route)
        self.reset()

    def reset(self) -> None:
        """Forgets plan, manoeuvre and counters."""
        self.lane_changes = self.refused = self.unsafe = self.aborted = self.emergencies = 0
        self._middle: float | None = None
        self._residual: Quintic | None = None
        self._change: _Change | None = None
        self._changed_at = -np.inf
        self._emergency = False
        self._wanted_speed = self.config.speed.cruise_speed
        self._last: Trajectory | None = None

    @property
    def changing(self) -> bool:
        """True while a lane change, or its abort, is under way."""
        return self._change is not None

    def lane(self, scene: Scene) -> int:
        """Index of the lane being kept or changed to."""
        ego = scene.ego
        middle = ego.offset if self._middle is None else self._middle
        return self.preview.nearest_lane(ego.station, middle)

    def plan(
        self,
        scene: Scene,
        decision: Decision = Decision.KEEP,
        profile: SpeedProfile | None = None,
    ) -> Trajectory:
        """The trajectory of the coming seconds.

        Args:
          scene: the truck and the traffic.
          decision: of the decision maker; ignored while a change is under way.
          profile: reference speed over station; default: the cruise speed.

        Raises:
          InputError: a value of the scene that matters is not finite.
        """
        surroundings = Surroundings(scene)
        near = scene.ego.station + np.array([0.0, 50.0, 100.0, 150.0])
        self._wanted_speed = (
            self.config.speed.cruise_speed
            if profile is None
            else float(np.interp(near, profile.station, profile.speed).max())
        )
        path = self._path(scene, self.lane(scene))
        self._recover(scene, path)
        self._progress(scene, path)
        reason, refused, unsafe = "", Decision.KEEP, False
        if self._change is None:
            path, reason, refused, unsafe = self._decide(scene, surroundings, path, decision)
        elif self._must_abort(scene, surroundings, path):
            path = self._abort(scene)
        leads, follows = self._leads(scene, surroundings, path)
        trajectory = self._assemble(scene, path, leads, profile)
        if not reason:
            reason = f"following {follows.vehicle.id}" if follows else "free road"
        self._last = replace(
            trajectory,
            mode=self._mode(),
            reason=f"emergency braking: {reason}" if self._emergency else reason,
            target_lane=path.lane,
            refused=refused,
            extra={**trajectory.extra, "unsafe": float(unsafe)},
        )
        return self._last

    def _mode(self) -> PlanMode:
        if self._emergency:
            return PlanMode.EMERGENCY
        if self._change is None:
            return PlanMode.LANE_KEEPING
        return PlanMode.ABORT if self._change.aborted else PlanMode.LANE_CHANGE

    # Lateral -----------------------------------------------------------------------------------

    def _path(self, scene: Scene, lane: int) -> LanePath:
        path = self.preview.follow(lane, scene.ego.station, self.config.speed.preview, 150.0)
        self._middle = float(path.offset_at(scene.ego.station))
        return path

    def _state(self, scene: Scene) -> tuple[float, float, float]:
        """Planned offset from the path [m], slope and bend, where the truck is."""
        if self._residual is None:
            return 0.0, 0.0, 0.0
        value, slope, bend, _ = self._residual.evaluate(scene.ego.station)
        return float(value), float(slope), float(bend)

    def _recover(self, scene: Scene, path: LanePath) -> None:
        """Begins anew from where the truck is when it is far from what was planned."""
        ego = scene.ego
        error = ego.offset - float(path.offset_at(ego.station))
        planned, slope, _ = self._state(scene)
        if abs(error - planned) > self.config.recover_offset:
            self._residual = quintic_back(
                ego.station, error, slope, 0.0, ego.speed, self.config.change
            )

    def _progress(self, scene: Scene, path: LanePath) -> None:
        """Ends what is finished."""
        ego = scene.ego
        if self._residual is None or ego.station < self._residual.end:
            return
        error = abs(ego.offset - float(path.offset_at(ego.station)))
        if self._change is None:
            self._residual = None
        elif error < self.config.settled_offset:
            if not self._change.aborted:
                self.lane_changes += 1
            self._changed_at = scene.time
            self._residual = self._change = None

    def _decide(
        self, scene: Scene, surroundings: Surroundings, path: LanePath, decision: Decision
    ) -> tuple[LanePath, str, Decision, bool]:
        """Begins a change where one is wanted and possible; else says why not."""
        must = self._mandatory(scene, path)
        wanted = decision if must is Decision.KEEP else must
        if wanted is Decision.KEEP:
            return path, "", Decision.KEEP, False
        target, why, unsafe = self._target(scene, surroundings, path, wanted, must is wanted)
        if target is None:
            if decision is not Decision.KEEP and must is Decision.KEEP:
                self.refused += 1
                self.unsafe += unsafe
            return path, f"{wanted.name.lower()} refused: {why}", wanted, unsafe
        ego = scene.ego
        planned, slope, bend = self._state(scene)
        start = float(path.offset_at(ego.station))
        size = start + planned - float(target.offset_at(ego.station))
        curvature = self._curvature_ahead(ego.station, ego.speed)
        residual = quintic_change(
            ego.station, size, slope, bend, self._top(ego), ego.mass, curvature, self.config.change
        )
        if residual is None:
            if must is Decision.KEEP:
                self.refused += 1
            why = "the curve leaves no lateral acceleration for a change"
            return path, f"{wanted.name.lower()} refused: {why}", wanted, False
        self._residual = residual
        self._middle = float(target.offset_at(ego.station))
        self._change = _Change(wanted, start, abs(size), mandatory=must is wanted)
        return target, f"changing to the {wanted.name.lower()}", Decision.KEEP, False

    def _target(
        self,
        scene: Scene,
        surroundings: Surroundings,
        path: LanePath,
        wanted: Decision,
        mandatory: bool,
    ) -> tuple[LanePath | None, str, bool]:
        """Path of the wanted lane, or why there is none, and whether a vehicle is the reason."""
        ego, change = scene.ego, self.config.change
        lane = path.lane - int(wanted)
        if not self.preview.lane_exists(lane, ego.station):
            return None, f"there is no lane to the {wanted.name.lower()}", False
        if not mandatory and lane not in self.config.lanes:
            return None, f"lane {lane} is not one the truck may use", False
        if ego.speed < change.speed_min and not mandatory:
            return None, f"speed {ego.speed:.1f} m/s is below {change.speed_min:g} m/s", False
        if self._residual is not None:
            return None, "the truck is still finding its lane", False
        since = scene.time - self._changed_at
        if since < change.pause and not mandatory:
            return (
                None,
                f"the last change was {since:.1f} s ago, {change.pause:g} s must pass",
                False,
            )
        target = self.preview.follow(lane, ego.station, self.config.speed.preview, 150.0)
        needed = max(ego.speed, 10.0) * change.duration_max + change.lane_left
        if target.end - ego.station < needed and not mandatory:
            left = target.end - ego.station
            return None, f"the lane ends in {left:.0f} m, {needed:.0f} m are needed", False
        why = conflict(surroundings, target, self.config.safety)
        return (None, why, True) if why else (target, "", False)

    def _mandatory(self, scene: Scene, path: LanePath) -> Decision:
        """The way out of a lane that ends, when it is near."""
        ego = scene.ego
        reach = max(ego.speed * self.config.change.merge_time, self.config.change.merge_distance)
        if path.end - ego.station > reach or path.end >= self.preview.station[-1]:
            return Decision.KEEP
        best, choice = path.end, Decision.KEEP
        for side in (Decision.LEFT, Decision.RIGHT):
            lane = path.lane - int(side)
            if self.preview.lane_exists(lane, ego.station):
                end = self.preview.follow(lane, ego.station, self.config.speed.preview).end
                if end > best:
                    best, choice = end, side
        return choice

    def _must_abort(self, scene: Scene, surroundings: Surroundings, path: LanePath) -> bool:
        change, residual = self._change, self._residual
        if change is None or residual is None or change.aborted or change.mandatory:
            return False
        left = abs(self._state(scene)[0])
        if left < (1.0 - self.config.change.abort_share) * change.size:
            return False
        safety = self.config.safety
        if conflict(surroundings, path, safety, safety.abort_factor) is None:
            return False
        origin = self._origin(scene)
        back = surroundings.leader(origin)
        return surroundings.beside(origin) is None and (back is None or back.gap > safety.margin)

    def _origin(self, scene: Scene) -> LanePath:
        assert self._change is not None
        station = scene.ego.station
        lane = self.preview.nearest_lane(station, self._change.origin_offset)
        return self.preview.follow(lane, station, self.config.speed.preview, 150.0)

    def _abort(self, scene: Scene) -> LanePath:
        assert self._change is not None
        ego = scene.ego
        target = self._path(scene, self.lane(scene))
        value, slope, bend = self._state(scene)
        origin = self._origin(scene)
        value += float(target.offset_at(ego.station)) - float(origin.offset_at(ego.station))
        self._residual = quintic_back(
            ego.station, value, slope, bend, ego.speed, self.config.change
        )
        self._middle = float(origin.offset_at(ego.station))
        self._change.aborted = True
        self.aborted += 1
        return origin

    def _top(self, ego: EgoState) -> float:
        """Greatest speed that may be reached during a change [m/s]."""
        grade = float(np.interp(ego.station, self.preview.station, self.preview.grade))
        speed = self.config.speed
        gain = min(
            power_acceleration(ego.speed, ego.mass, grade, speed), speed.following.acceleration_max
        )
        reached = ego.speed + gain * self.config.change.duration_max
        return max(ego.speed, min(reached, self._wanted_speed))

    def _curvature_ahead(self, station: float, speed: float) -> float:
        ahead = station + np.linspace(0.0, max(speed * self.config.change.duration_max, 50.0), 12)
        return float(np.abs(np.interp(ahead, self.preview.station, self.preview.curvature)).max())

    # Longitudinal ------------------------------------------------------------------------------

    def _leads(
        self, scene: Scene, surroundings: Surroundings, path: LanePath
    ) -> tuple[list[Lead], Neighbor | None]:
        """Who is to be followed, and the nearest of them."""
        follows = surroundings.leader(path)
        leads = [] if follows is None else [lead_of(follows)]
        if self._change is not None and not self._change.aborted and self._residual is not None:
            old = surroundings.leader(self._origin(scene))
            if old is not None and (follows is None or old.vehicle.id != follows.vehicle.id):
                clearance = self.config.change.side_gap, self.config.safety.margin
                lead = lead_while_passing(scene, path, self._residual, old, *clearance)
                leads += [] if lead is None else [lead]
        return leads, follows

    def _start(self, scene: Scene) -> SpeedState:
        """Begins at the last plan's speed, held near the truck's."""
        ego, last, reach = scene.ego, self._last, self.config.resync_speed
        if last is None or not last.time[0] <= scene.time <= last.time[-1]:
            return SpeedState(ego.station, ego.speed, 0.0)
        speed = float(np.interp(scene.time, last.time, last.speed))
        acceleration = float(np.interp(scene.time, last.time, last.acceleration))
        speed = min(max(speed, ego.speed - reach), ego.speed + reach)
        return SpeedState(ego.station, max(speed, 0.0), acceleration)

    def _assemble(
        self, scene: Scene, path: LanePath, leads: list[Lead], profile: SpeedProfile | None
    ) -> Trajectory:
        config, speed = self.config, self.config.speed
        urgency = most_urgent(leads, scene.ego.speed, speed)
        was = self._emergency
        self._emergency = urgency > (speed.emergency_release if was else speed.emergency_onset)
        self.emergencies += self._emergency and not was
        steps = round(config.horizon / config.step)
        station, v, a = roll_out(
            self._start(scene),
            path,
            speed_cap(path, self.preview, speed, profile),
            leads,
            scene.ego.mass,
            self.preview,
            steps,
            config.step,
            speed,
            path.end - speed.stop_gap - scene.footprint.front_overhang,
            self._emergency,
        )
        return on_road(
            self.preview, path, self._residual, scene.time, station, v, a, config.step, urgency
        )
