"""The trajectory planner: the paper's Algorithm 1, with car following and safe lane changes.

Keep: the lane's middle with the speed profile, behind the vehicle ahead. Change: keep, with the
reason, if the target lane is missing or unsafe; else a quintic in road coordinates. `Maneuver` is
the lateral half, this module the longitudinal one: limits, leaders, lights, emergencies.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from controllers.planning.config import PlannerConfig, Powers
from controllers.planning.crossing import crossing_leads
from controllers.planning.following import Lead
from controllers.planning.lane_change import Step
from controllers.planning.maneuver import Maneuver
from controllers.planning.merging import GapChoice, choose_gap
from controllers.planning.road_preview import LanePath, RoadPreview, lane_shift
from controllers.planning.rollover_limits import RollMargins
from controllers.planning.speed_caps import SpeedCaps, with_zones
from controllers.planning.speed_plan import SpeedState, most_urgent, roll_out
from controllers.planning.stops import Stops
from controllers.planning.trajectory import Quintic, on_road
from controllers.tracking.lateral import check_finite
from iits_mj.core.arrays import FloatArray
from iits_mj.core.checks import is_whole
from iits_mj.core.errors import InputError
from iits_mj.core.messages import (
    Decision,
    PlanMode,
    Scene,
    SpeedProfile,
    SpeedZone,
    Trajectory,
)
from iits_mj.core.neighbors import Neighbor
from iits_mj.parameters import TruckParameters

if TYPE_CHECKING:
    from iits_mj.road import Route

# In the last meters before a stop [m], below this speed [m/s], the plan's speed may be below the
# truck's by no more than this [m/s].
_LAST_WAY, _LAST_SPEED, _LAST_REACH = 30.0, 8.0, 0.1
# Values of the truck's state that planning and decisions use.
_STATE = ("time", "station", "offset", "speed", "mass", "yaw", "lateral_speed")
# An estimate of the mass may be wrong by this factor.
_MASS_FACTOR = 2.0

__all__ = ["Planner", "PlannerConfig"]


class Planner:
    """Plans a trajectory from a scene and a decision every 100 ms.

    Args:
      route: the truck's road.
      config: settings.
      parameters: of the truck, with its payload's height; default: the shipped one.

    Attributes:
      maneuver: the lateral state, with its counters.
      emergencies: number of emergency brakings.
    """

    def __init__(
        self,
        route: Route,
        config: PlannerConfig | None = None,
        parameters: TruckParameters | None = None,
    ) -> None:
        self.route = route
        parameters = parameters or TruckParameters.load()
        self.config = config = config or PlannerConfig()
        if config.speed.powers is None:
            speed = replace(config.speed, powers=Powers.of(parameters))
            self.config = replace(config, speed=speed)
        self.preview = RoadPreview(route)
        self._parameters = parameters
        self._margins = RollMargins(parameters, 1.0 / self.config.change.duration_min)
        laden = parameters.gross_mass(parameters.payload_max)
        self._masses = parameters.gross_mass(0.0) / _MASS_FACTOR, laden * _MASS_FACTOR
        self.preview.shift = lane_shift(
            self.preview, parameters, laden, self.config.speed.curve_acceleration
        )
        self._stops = Stops(self.preview, self.config, parameters)
        self.maneuver = Maneuver(self.preview, self.config, parameters)
        self._caps = SpeedCaps(self.preview, self.config)
        self.reset()

    def reset(self) -> None:
        """Clears plan, maneuver and counters."""
        self.maneuver.reset()
        self._stops.reset()
        self._caps.reset()
        self.emergencies = 0
        self._emergency = False
        self._crossing: list[str] = []
        self._gap: GapChoice | None = None
        self._last: Trajectory | None = None
        self._zoned: tuple[LanePath, tuple[SpeedZone, ...], LanePath] | None = None

    @property
    def changing(self) -> bool:
        """True while a lane change, or its abort, is under way."""
        return self.maneuver.change is not None

    @property
    def lane_changes(self) -> int:
        """Lane changes completed."""
        return self.maneuver.lane_changes

    @property
    def refused(self) -> int:
        """Decisions refused because of a vehicle, a missing lane or too little room."""
        return self.maneuver.refused

    @property
    def unsafe(self) -> int:
        """Decisions refused because of a vehicle."""
        return self.maneuver.unsafe

    @property
    def aborted(self) -> int:
        """Changes aborted under way."""
        return self.maneuver.aborted

    def lane(self, scene: Scene) -> int:
        """Index of the lane being kept or changed to."""
        return self.maneuver.lane(scene.ego)

    def path(self, scene: Scene) -> LanePath:
        """Path of that lane, without the limits of speed zones."""
        return self.maneuver.path(scene.ego)

    def leader(self, scene: Scene) -> Neighbor | None:
        """The vehicle ahead in the lane being kept or changed to."""
        return scene.neighbors.leader_along_path(self.path(scene))

    def may_pass(self, scene: Scene) -> bool:
        """Whether neither signs nor the rule to keep right forbid a change to the left."""
        return not self.maneuver.stays_right(scene, self.path(scene))

    def bearable_speed(self, station: float, mass: float) -> float:
        """Greatest speed at a station with which the truck rolls over in no bend ahead [m/s]."""
        return self._caps.bearable(station, self._margins.at(mass))

    def plan(
        self,
        scene: Scene,
        decision: Decision = Decision.KEEP,
        profile: SpeedProfile | None = None,
    ) -> Trajectory:
        """The trajectory of the coming seconds.

        Args:
          scene: the truck, the traffic and the signs.
          decision: of the decision maker; ignored while a change is under way.
          profile: reference speed over station; default: the cruise speed.

        Raises:
          InputError: a number of the scene is not finite or out of its range, or the decision is
            neither a `Decision` nor the number of one.
        """
        self._check(scene)
        decision = named_decision(decision)
        ego = scene.ego
        margin = self._margins.at(ego.mass)
        step = self.maneuver.step(scene, decision, lambda: self._caps.top(ego, profile), margin)
        path = self._with_zones(step.path, scene.signals.zones)
        leads, follows = self._leads(scene, path)
        cap = self._caps.cap(path, profile, margin, ego)
        passing_until = self.maneuver.passing_until
        if passing_until > path.station[0]:
            slow = path.station < passing_until
            cap = np.where(slow, np.minimum(cap, self.config.passing.speed), cap)
        cap = self._stops.look(scene, path, cap, self.maneuver.change)
        self._gap = self._choose_gap(step, scene, cap, path)
        if self._gap is not None:
            bound = self._gap.cap(path, ego.station, ego.speed)
            cap = cap if bound is None else np.minimum(cap, bound)
        rolled, urgency = self._roll_out(scene, path, leads, cap, step.wanted is not None)
        self._last = on_road(
            *(self.preview, path, self.maneuver.residual, scene.time),
            *rolled,
            self.config.step,
            PlanMode.EMERGENCY if self._emergency else self.maneuver.mode,
            self._reason(step, follows),
            path.lane,
            step.refused,
            {"urgency": urgency, "unsafe": float(step.unsafe)},
        )
        return self._last

    def _with_zones(self, path: LanePath, zones: tuple[SpeedZone, ...]) -> LanePath:
        """The path with the limits of the zones; the same object while neither changes."""
        if self._zoned is None or self._zoned[0] is not path or self._zoned[1] != zones:
            self._zoned = path, zones, with_zones(path, zones)
        return self._zoned[2]

    def _check(self, scene: Scene) -> None:
        """Raises InputError for a state of the truck from which no plan is possible."""
        ego, (least, most) = scene.ego, self._masses
        check_finite(ego, _STATE)
        if not least <= ego.mass <= most:
            raise InputError(
                f"state of the truck: mass is {ego.mass:g} kg: allowed is {least:.0f} to "
                f"{most:.0f} kg"
            )
        # At an end of the road, part of the truck is still on it.
        spare, length = scene.footprint.length, self.route.length
        if not -spare <= ego.station <= length + spare:
            raise InputError(
                f"state of the truck: station is {ego.station:g} m: the road has 0 to "
                f"{length:.0f} m"
            )

    def _reason(self, step: Step, follows: Neighbor | None) -> str:
        reason = step.reason or self._stops.light.reason or self._stops.bend_reason
        if step.wanted is not None and self._gap is not None:
            ahead, behind = self._gap.ends
            reason += f"; aiming for the gap ahead of {behind}" if behind else ""
            reason += f"; aiming for the gap behind {ahead}" if ahead and not behind else ""
        if not reason:
            reason = f"{self._crossing[0]} will be in the way" if self._crossing else ""
        if not reason:
            reason = f"following {follows.id}" if follows else "free road"
        return f"emergency braking: {reason}" if self._emergency else reason

    def _choose_gap(
        self, step: Step, scene: Scene, cap: FloatArray, path: LanePath
    ) -> GapChoice | None:
        """The gap to aim for in the lane that the truck must reach, while that lane is not free."""
        if step.wanted is None or not step.unsafe:
            return None
        ego, merge = scene.ego, self.config.merge
        here = float(np.interp(ego.station, path.station, cap))
        return choose_gap(
            scene,
            step.wanted,
            path.end - merge.room,
            self._caps.power_left(ego),
            here,
            self.config.safety,
            merge,
            self._gap,
        )

    def _leads(self, scene: Scene, path: LanePath) -> tuple[list[Lead], Neighbor | None]:
        """The leads to brake for, and the leader in the lane."""
        follows = scene.neighbors.leader_along_path(path)
        leads = [] if follows is None else [Lead.of(follows)]
        origin, residual = self.maneuver.origin(scene.ego), self.maneuver.residual
        passing = self.maneuver.passing_until > scene.ego.station
        if origin is not None and residual is not None and not passing:
            old = scene.neighbors.leader_along_path(origin)
            if old is not None and (follows is None or old.id != follows.id):
                leads += self._old_leader(scene, path, residual, old)
        crossing = crossing_leads(scene, self.preview, self._parameters, path, residual)
        self._crossing = [name for _, name in crossing]
        return leads + [lead for lead, _ in crossing], follows

    def _old_leader(
        self, scene: Scene, path: LanePath, residual: Quintic, old: Neighbor
    ) -> list[Lead]:
        """The leader of the lane being left as a lead, while the truck may still touch it.

        It counts if the truck, at its present speed, comes within the margin of it before it is
        beside it, also as the leader brakes on as it does now.
        """
        ego, config = scene.ego, self.config
        last = max(residual.end, ego.station + 1.0)
        braking = replace(Lead.of(old), acceleration=min(old.acceleration, 0.0))

        def spare(until: float) -> float:
            # The gap is least at one of both ends, as the leader does not speed up.
            closed = ego.speed * until - braking.at(until)[0]
            return old.gap - max(closed, 0.0) - config.safety.margin

        longest = (last - ego.station) / max(ego.speed, 1.0)
        if spare(longest) > 0.0:
            return []
        clear = 0.5 * (old.width + scene.footprint.width) + config.change.side_gap
        stations = np.linspace(ego.station, last, 40)
        offsets = path.driven_at(stations) + residual.evaluate(stations)[0]
        aside = np.abs(offsets - old.offset) > clear
        free_at = float(stations[int(np.argmax(aside))]) if aside.any() else float(stations[-1])
        until = (free_at - ego.station) / max(ego.speed, 1.0)
        return [] if until <= 0.0 or spare(until) > 0.0 else [Lead.of(old, until)]

    def _start(self, scene: Scene, stop: float) -> SpeedState:
        """Start of the speed plan: the last plan's speed, held near the truck's.

        In the last meters before a stop the plan does not follow a truck that is too fast: the
        truck has to brake harder.
        """
        ego, last, reach = scene.ego, self._last, self.config.resync_speed
        near_stop = ego.speed < _LAST_SPEED and ego.station > stop - _LAST_WAY
        below = _LAST_REACH if near_stop else reach
        if last is None or not last.time[0] <= scene.time <= last.time[-1]:
            return SpeedState(ego.station, ego.speed, 0.0)
        speed = float(np.interp(scene.time, last.time, last.speed))
        acceleration = float(np.interp(scene.time, last.time, last.acceleration))
        speed = min(max(speed, ego.speed - below), ego.speed + reach)
        if not self._emergency:
            # The hard braking of an emergency ends at once.
            acceleration = max(acceleration, -self.config.speed.following.deceleration_max)
        if speed <= 0.0:
            acceleration = max(acceleration, 0.0)
        return SpeedState(ego.station, max(speed, 0.0), acceleration)

    def _roll_out(
        self, scene: Scene, path: LanePath, leads: list[Lead], cap: FloatArray, waits: bool
    ) -> tuple[tuple[FloatArray, FloatArray, FloatArray], float]:
        """The speed plan within a bound on the speed, see `roll_out`, and the leaders' urgency.

        It may begin or end an emergency.
        """
        config, speed = self.config, self.config.speed
        urgency = most_urgent(leads, scene.ego.speed, speed)
        was = self._emergency
        self._emergency = urgency > (speed.emergency_release if was else speed.emergency_onset)
        self.emergencies += self._emergency and not was
        demand = 0.0
        if self._emergency:
            graded = max(speed.emergency_share * urgency, speed.emergency_onset)
            demand = min(graded, speed.emergency_deceleration)
        stop, deceleration, cap = self._stops.nearest(scene, path, cap, waits)
        rolled = roll_out(
            self._start(scene, stop),
            path,
            cap,
            leads,
            scene.ego.mass,
            self.preview,
            round(config.horizon / config.step),
            config.step,
            speed,
            stop,
            demand,
            self._stops.holds(stop, scene.ego) or self._is_close(leads),
            deceleration,
        )
        return rolled, urgency

    def _is_close(self, leads: list[Lead]) -> bool:
        """Whether a leader stands nearer than the standstill gap: the truck stops at once.

        The plan's speed is zero there. Held, the plan still brakes a truck that rolls on, as on a
        descent.
        """
        nearest, stopped = (
            self.config.speed.following.standstill_gap,
            self.config.passing.lead_speed,
        )
        return any(lead.gap < nearest and lead.speed <= stopped for lead in leads)


def named_decision(value: object) -> Decision:
    """The decision that a value names: a `Decision` or its number.

    Raises:
      InputError: it is neither.
    """
    if isinstance(value, Decision):
        return value
    for decision in Decision:
        if is_whole(value) and value == decision:
            return decision
    allowed = ", ".join(f"Decision.{d.name} ({int(d)})" for d in Decision)
    raise InputError(f"decision is {value!r}: allowed is {allowed}")
