"""The trajectory planner: the paper's Algorithm 1, with real car following and safe lane changes.

Keep: the lane's middle with the speed profile, following whoever is ahead. Change: the target lane
missing or unsafe -> keep, with the reason; else a quintic in road coordinates. `Maneuver` has the
half across the road, this module the half along it: limits, leaders, lights, emergencies.
"""

from __future__ import annotations

import math
from dataclasses import replace
from numbers import Integral
from typing import TYPE_CHECKING

import numpy as np

from controllers.planning.config import PlannerConfig
from controllers.planning.crossing import crossing_leads
from controllers.planning.following import Lead
from controllers.planning.lane_change import Step
from controllers.planning.maneuver import Maneuver
from controllers.planning.merging import GapChoice, choose_gap
from controllers.planning.placement import lane_shift
from controllers.planning.road_preview import LanePath, RoadPreview
from controllers.planning.rollover_limits import RollMargins
from controllers.planning.speed_caps import SpeedCaps, with_zones
from controllers.planning.speed_plan import SpeedConfig, SpeedState, most_urgent, powers, roll_out
from controllers.planning.stops import Stops
from controllers.planning.surroundings import Neighbor, Surroundings
from controllers.planning.trajectory import lead_of, lead_while_passing, on_road
from iits_mj.core.arrays import FloatArray
from iits_mj.core.errors import InputError
from iits_mj.core.messages import (
    Decision,
    PlanMode,
    Scene,
    SpeedProfile,
    Trajectory,
)
from iits_mj.parameters import TruckParameters

if TYPE_CHECKING:
    from iits_mj.road import Route


# The last metres before a stop [m], driven slower than this [m/s]; how far the plan may there be
# below the truck's speed [m/s].
_LAST_WAY, _LAST_SPEED, _LAST_REACH = 30.0, 8.0, 0.1

__all__ = ["Planner", "PlannerConfig"]


class Planner:
    """Plans a trajectory from a scene and a decision, ten times a second.

    Args:
      route: the truck's road.
      config: settings.
      parameters: of the truck, with its payload's height; default: the shipped one.

    Attributes:
      maneuver: the state across the road, with its counters.
      emergencies: number of times the last layer acted.
    """

    def __init__(
        self,
        route: Route,
        config: PlannerConfig | None = None,
        parameters: TruckParameters | None = None,
    ) -> None:
        self.route = route
        parameters = parameters or TruckParameters.load()
        self.config = _of_truck(config or PlannerConfig(), parameters)
        self.preview = RoadPreview(route)
        self._parameters = parameters
        self._state = StateCheck(parameters, route.length)
        self._margins = RollMargins(parameters, 1.0 / self.config.change.duration_min)
        laden = parameters.gross_mass(parameters.payload.mass_max)
        self.preview.shift = lane_shift(
            self.preview, parameters, laden, self.config.speed.curve_acceleration
        )
        self._stops = Stops(self.preview, self.config, parameters)
        self.maneuver = Maneuver(self.preview, self.config, parameters)
        self._caps = SpeedCaps(self.preview, self.config)
        self.reset()

    def reset(self) -> None:
        """Forgets plan, manoeuvre and counters."""
        self.maneuver.reset()
        self._stops.reset()
        self.emergencies = 0
        self._emergency = False
        self._crossing: list[str] = []
        self._gap: GapChoice | None = None
        self._last: Trajectory | None = None

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
        """Decisions refused, for a vehicle or because there is no lane or room."""
        return self.maneuver.refused

    @property
    def unsafe(self) -> int:
        """Decisions refused because of a vehicle."""
        return self.maneuver.unsafe

    @property
    def aborted(self) -> int:
        """Changes given up under way."""
        return self.maneuver.aborted

    def lane(self, scene: Scene) -> int:
        """Index of the lane being kept or changed to."""
        return self.maneuver.lane(scene.ego)

    def bearable_speed(self, station: float, mass: float) -> float:
        """Speed at a station from which every bend ahead is met without tipping over [m/s]."""
        return self._caps.bearable(station, self._margins.at(mass))

    def plan(
        self,
        scene: Scene,
        decision: Decision = Decision.KEEP,
        profile: SpeedProfile | None = None,
        surroundings: Surroundings | None = None,
    ) -> Trajectory:
        """The trajectory of the coming seconds.

        Args:
          scene: the truck, the traffic and the signs.
          decision: of the decision maker; ignored while a change is under way.
          profile: reference speed over station; default: the cruise speed.
          surroundings: the scene's, with this planner's preview; default: made here.

        Raises:
          InputError: a value of the scene that matters cannot be, or the decision is none.
        """
        self._state.check(scene)
        decision = named_decision(decision)
        ego = scene.ego
        surroundings = surroundings or Surroundings(scene, preview=self.preview)
        margin = self._margins.at(ego.mass)
        step = self.maneuver.step(
            scene, surroundings, decision, self._caps.top(ego, profile), margin
        )
        path = with_zones(step.path, scene.signals.zones)
        leads, follows = self._leads(scene, surroundings, path)
        cap = self._caps.cap(path, profile, margin, ego)
        pulls_out_until = self.maneuver.pulls_out_until
        if pulls_out_until > path.station[0]:
            slow = path.station < pulls_out_until
            cap = np.where(slow, np.minimum(cap, self.config.pull_out.speed), cap)
        cap = self._stops.look(surroundings, path, cap, self.maneuver.change)
        self._gap = self._seek(step, surroundings, cap, path)
        if self._gap is not None:
            bound = self._gap.cap(path, ego.station, ego.speed)
            cap = cap if bound is None else np.minimum(cap, bound)
        trajectory = self._assemble(scene, path, leads, cap, waits=step.wanted is not None)
        self._last = replace(
            trajectory,
            mode=PlanMode.EMERGENCY if self._emergency else self.maneuver.mode,
            reason=self._reason(step, follows),
            target_lane=path.lane,
            refused=step.refused,
            extra={**trajectory.extra, "unsafe": float(step.unsafe)},
        )
        return self._last

    def _reason(self, step: Step, follows: Neighbor | None) -> str:
        reason = step.reason or self._stops.light.reason or self._stops.bend_reason
        if step.wanted is not None and self._gap is not None:
            ahead, behind = self._gap.ends
            reason += f"; aiming for the gap ahead of {behind}" if behind else ""
            reason += f"; aiming for the gap behind {ahead}" if ahead and not behind else ""
        if not reason:
            reason = f"{self._crossing[0]} will be in the way" if self._crossing else ""
        if not reason:
            reason = f"following {follows.vehicle.id}" if follows else "free road"
        return f"emergency braking: {reason}" if self._emergency else reason

    def _seek(
        self, step: Step, surroundings: Surroundings, cap: FloatArray, path: LanePath
    ) -> GapChoice | None:
        """The gap of the lane that must be reached, while it is not free."""
        if step.wanted is None or not step.unsafe:
            return None
        ego, merge = surroundings.scene.ego, self.config.merge
        here = float(np.interp(ego.station, path.station, cap))
        return choose_gap(
            surroundings,
            step.wanted,
            path.end - merge.room,
            self._caps.power_left(ego),
            here,
            self.config.safety,
            merge,
            self._gap,
        )

    # Longitudinal ------------------------------------------------------------------------------

    def _leads(
        self, scene: Scene, surroundings: Surroundings, path: LanePath
    ) -> tuple[list[Lead], Neighbor | None]:
        """Who is to be followed, and the nearest of them."""
        follows = surroundings.leader(path)
        leads = [] if follows is None else [lead_of(follows)]
        origin, residual = self.maneuver.origin(scene.ego), self.maneuver.residual
        pulls_out = self.maneuver.pulls_out_until > scene.ego.station
        if origin is not None and residual is not None and not pulls_out:
            old = surroundings.leader(origin)
            if old is not None and (follows is None or old.vehicle.id != follows.vehicle.id):
                clearance = self.config.change.side_gap, self.config.safety.margin
                lead = lead_while_passing(scene, path, residual, old, *clearance)
                leads += [] if lead is None else [lead]
        crossing = crossing_leads(surroundings, self.preview, self._parameters, path, residual)
        self._crossing = [name for _, name in crossing]
        return leads + [lead for lead, _ in crossing], follows

    def _start(self, scene: Scene, stop: float) -> SpeedState:
        """Begins at the last plan's speed, held near the truck's.

        In the last metres before a stop a truck that is faster than planned has to brake harder,
        not to be told that it should have been slower.
        """
        ego, last, reach = scene.ego, self._last, self.config.resync_speed
        last_metres = ego.speed < _LAST_SPEED and ego.station > stop - _LAST_WAY
        below = _LAST_REACH if last_metres else reach
        if last is None or not last.time[0] <= scene.time <= last.time[-1]:
            return SpeedState(ego.station, ego.speed, 0.0)
        speed = float(np.interp(scene.time, last.time, last.speed))
        acceleration = float(np.interp(scene.time, last.time, last.acceleration))
        speed = min(max(speed, ego.speed - below), ego.speed + reach)
        if not self._emergency:
            # What an emergency left is let go at once.
            acceleration = max(acceleration, -self.config.speed.following.deceleration_max)
        if speed <= 0.0:
            acceleration = max(acceleration, 0.0)
        return SpeedState(ego.station, max(speed, 0.0), acceleration)

    def _demand(self, urgency: float) -> float:
        """Deceleration of the last layer now, positive [m/s2]; 0 while it rests."""
        speed = self.config.speed
        if not self._emergency:
            return 0.0
        graded = max(speed.emergency_share * urgency, speed.emergency_onset)
        return min(graded, speed.emergency_deceleration)

    def _assemble(
        self,
        scene: Scene,
        path: LanePath,
        leads: list[Lead],
        cap: FloatArray,
        *,
        waits: bool,
    ) -> Trajectory:
        config, speed = self.config, self.config.speed
        urgency = most_urgent(leads, scene.ego.speed, speed)
        was = self._emergency
        self._emergency = urgency > (speed.emergency_release if was else speed.emergency_onset)
        self.emergencies += self._emergency and not was
        stop, deceleration, cap = self._stops.nearest(scene, path, cap, waits=waits)
        steps = round(config.horizon / config.step)
        station, v, a = roll_out(
            self._start(scene, stop),
            path,
            cap,
            leads,
            scene.ego.mass,
            self.preview,
            steps,
            config.step,
            _braking_at(speed, deceleration),
            stop,
            self._demand(urgency),
            self._stops.holds(stop, scene.ego),
        )
        return on_road(
            self.preview,
            path,
            self.maneuver.residual,
            scene.time,
            station,
            v,
            a,
            config.step,
            urgency,
        )


def _of_truck(config: PlannerConfig, parameters: TruckParameters) -> PlannerConfig:
    """The settings with the truck's own powers where none were given."""
    if config.speed.powers is not None:
        return config
    return replace(config, speed=replace(config.speed, powers=powers(parameters)))


def _braking_at(speed: SpeedConfig, deceleration: float) -> SpeedConfig:
    """The same limits with another deceleration towards the stop ahead [m/s2]."""
    if deceleration == speed.following.preview_deceleration:
        return speed
    following = replace(speed.following, preview_deceleration=deceleration)
    return replace(speed, following=following)


# --- What nobody can plan from is refused by name: states, places, masses, decisions ---

_USED = ("time", "station", "offset", "speed", "mass")
# An estimate of the mass may be wrong by this factor, no more.
_MASS_FACTOR = 2.0


class StateCheck:
    """Bounds of the truck's state for one truck on one road.

    Args:
      parameters: of the truck.
      length: of the road [m].
    """

    def __init__(self, parameters: TruckParameters, length: float) -> None:
        self.length = length
        self.mass_min = parameters.gross_mass(0.0) / _MASS_FACTOR
        self.mass_max = parameters.gross_mass(parameters.payload.mass_max) * _MASS_FACTOR

    def check(self, scene: Scene) -> None:
        """Refuses a truck whose state cannot be planned from.

        Raises:
          InputError: a value is not finite, the mass is no truck's, the station is off the road.
        """
        ego = scene.ego
        for name in _USED:
            value = getattr(ego, name)
            if not math.isfinite(value):
                raise InputError(f"state of the truck: {name} is {value}: not finite")
        if not self.mass_min <= ego.mass <= self.mass_max:
            raise InputError(
                f"state of the truck: mass is {ego.mass:g} kg: allowed is {self.mass_min:.0f} to "
                f"{self.mass_max:.0f} kg"
            )
        # A truck at an end of its road still has a part of itself on it.
        spare = scene.footprint.length
        if not -spare <= ego.station <= self.length + spare:
            raise InputError(
                f"state of the truck: station is {ego.station:g} m: the road has 0 to "
                f"{self.length:.0f} m"
            )


def named_decision(value: object) -> Decision:
    """The decision that a value stands for: a `Decision` or its number.

    Raises:
      InputError: it is none.
    """
    numbers = [int(decision) for decision in Decision]
    if isinstance(value, Integral) and not isinstance(value, bool) and int(value) in numbers:
        return Decision(int(value))
    allowed = ", ".join(f"Decision.{d.name} ({int(d)})" for d in Decision)
    raise InputError(f"decision is {value!r}: allowed is {allowed}")
