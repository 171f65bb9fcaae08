"""The user's own parts of the driving stack: their kinds, and the guards that check their results.

A shipped part is used as it is. Any other one is called through its guard, so that no value that is
not finite, and no array of a wrong shape, reaches the rest of the stack.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from controllers import protocols
from controllers.planning.config import PlannerConfig
from controllers.planning.planner import Planner, named_decision
from controllers.planning.speed_reference import SpeedReference, check_profile
from controllers.tracking.lateral import LateralController
from controllers.tracking.longitudinal import LongitudinalController
from iits_mj.core.checks import in_range, is_whole, shown
from iits_mj.core.errors import InputError
from iits_mj.core.messages import (
    Decision,
    EgoState,
    PlanMode,
    Scene,
    SpeedProfile,
    Trajectory,
    TransmissionMode,
    VehicleCommand,
    XbrEbiMode,
    XbrMode,
)
from iits_mj.core.neighbors import Neighbor
from iits_mj.core.own_parts import Guard, Kind, is_own

if TYPE_CHECKING:
    from controllers.decision.base import DecisionContext
    from iits_mj.road import Route


def _rule(name: str) -> type[Any] | None:
    """Returns the class of a decision maker that takes options."""
    # The rules need this module.
    from controllers.decision import rules

    return {"mobil": rules.Mobil, "lookahead": rules.LookAhead}.get(name)


DECISION = Kind(
    "decision maker",
    protocols.DecisionMaker,
    ("keep", "conservative", "neutral", "aggressive", "mobil", "lookahead", "ddqn"),
    _rule,
)
PLANNER = Kind("planner", protocols.TrajectoryPlanner, ("paper",))
LATERAL = Kind("lateral controller", protocols.LateralControl, ("preview",))
LONGITUDINAL = Kind("longitudinal controller", protocols.LongitudinalControl, ("inverse",))
SPEED = Kind("speed planner", protocols.SpeedSource, ("pcc", "cruise"))

_ARRAYS = (
    *("time", "station", "offset", "x", "y", "z", "yaw"),
    *("curvature", "speed", "acceleration"),
)
_COUNTED = ("lane_changes", "refused", "unsafe", "emergencies")
# Least and greatest value of each field of a command; the truck checks the steering angle.
_RANGES = {
    "accelerator_pedal": (0.0, 1.0),
    "xbr_demand": (-20.0, 0.0),
    "parking_brake": (0.0, 1.0),
    "engine_brake": (0.0, 1.0),
    "retarder": (0.0, 1.0),
    "brake_pedal": (0.0, 1.0),
}
_MODES = {
    "xbr_mode": XbrMode,
    "transmission_mode": TransmissionMode,
    "xbr_ebi_mode": XbrEbiMode,
}


class _Resetting(Guard):
    def reset(self) -> None:
        """Prepares the part for a new drive."""
        self.call("reset")


class DecisionGuard(_Resetting):
    """Guard of a decision maker."""

    kind = DECISION

    def decide(self, context: DecisionContext) -> Decision:
        """Returns the decision; raises InputError for anything else."""
        value = self.call("decide", context)
        try:
            return named_decision(value)
        except InputError as error:
            raise InputError(f"{self.title}: {error}") from error


class PlannerGuard(_Resetting):
    """Guard of a trajectory planner; counts what a planner reports, if the part does not count it.

    Args:
      part: of the user.
      route: the truck's road.
      config: with the lanes that the truck may use and its cruise speed.

    Attributes:
      lane_changes: completed; emergencies: begun; refused: decisions to change that were refused;
        unsafe: of those, because of a vehicle.
    """

    kind = PLANNER

    def __init__(self, part: Any, route: Route, config: PlannerConfig) -> None:
        super().__init__(part)
        self.route, self.config = route, config
        self._clear()

    def _clear(self) -> None:
        self._last: Trajectory | None = None
        self._lane = -1
        self._counts = dict.fromkeys(_COUNTED, 0)

    def reset(self) -> None:
        """Prepares the part for a new drive."""
        super().reset()
        self._clear()

    @property
    def changing(self) -> bool:
        """Whether the last plan changes lanes."""
        last = self._last
        return last is not None and last.mode in (PlanMode.LANE_CHANGE, PlanMode.ABORT)

    def __getattr__(self, name: str) -> Any:
        if name in _COUNTED and not hasattr(self.part, name):
            return self._counts[name]
        return super().__getattr__(name)

    def lane(self, scene: Scene) -> int:
        """Returns the index of the lane that is kept or changed to."""
        if self._last is not None:
            return self._last.target_lane
        return max(int(self.route.lane_at(scene.ego.station, scene.ego.offset)), 0)

    def may_pass(self, scene: Scene) -> bool:
        """Returns True: a planner of the user decides itself where the truck keeps right."""
        del scene
        return True

    def leader(self, scene: Scene) -> Neighbor | None:
        """Returns the vehicle ahead in that lane."""
        return scene.neighbors.leader_in_lane(self.route, self.lane(scene))

    def plan(self, scene: Scene, decision: Decision, profile: SpeedProfile) -> Trajectory:
        """Returns the plan.

        Raises:
          InputError: it is not a trajectory, or is not usable.
        """
        plan = self._checked(self.call("plan", scene, decision, profile), scene.time)
        last, emergency = self._last, PlanMode.EMERGENCY
        if plan.mode is PlanMode.LANE_KEEPING and plan.target_lane != self._lane:
            self._counts["lane_changes"] += self._lane >= 0
            self._lane = plan.target_lane
        self._counts["refused"] += plan.refused != Decision.KEEP
        was = last is not None and last.mode is emergency
        self._counts["emergencies"] += plan.mode is emergency and not was
        self._last = plan
        return plan

    def _checked(self, plan: Any, now: float) -> Trajectory:
        if not isinstance(plan, Trajectory):
            raise self.unusable("plan", f"returned {shown(plan)}, must return a Trajectory")
        arrays: dict[str, Any] = {}
        for name in _ARRAYS:
            try:
                values = np.asarray(getattr(plan, name), dtype=float)
            except (TypeError, ValueError):
                raise self.unusable("plan", f"returned no numbers as {name}") from None
            if values.ndim != 1 or values.shape != np.shape(plan.time) or len(values) < 2:
                raise self.unusable(
                    "plan",
                    f"returned {name} of shape {values.shape}, time of {np.shape(plan.time)}: must "
                    "be the same (n,), n of 2 or more",
                )
            if not np.isfinite(values).all():
                row = int(np.argmin(np.isfinite(values)))
                raise self.unusable("plan", f"returned {name}[{row}] = {values[row]}: not finite")
            arrays[name] = values
        time, station, speed = arrays["time"], arrays["station"], arrays["speed"]
        if not (np.diff(time) > 0.0).all() or time[-1] <= now:
            raise self.unusable(
                "plan",
                f"returned times {time[0]:g} to {time[-1]:g} s at {now:g} s: they must rise "
                "and end later",
            )
        if (np.diff(station) < 0.0).any() or (speed < 0.0).any():
            raise self.unusable("plan", "returned stations that fall, or speeds below zero")
        if not isinstance(plan.mode, PlanMode) or not is_whole(plan.target_lane):
            raise self.unusable(
                "plan",
                f"returned mode {shown(plan.mode)}, target_lane {shown(plan.target_lane)}: must be "
                "a PlanMode and a whole number",
            )
        return dataclasses.replace(plan, **arrays)


class LateralGuard(_Resetting):
    """Guard of a lateral controller."""

    kind = LATERAL

    def steer(self, ego: EgoState, trajectory: Trajectory) -> float:
        """Returns the angle of the steering wheel [rad]; raises InputError if not finite."""
        return self.number("steer", ego, trajectory)


class LongitudinalGuard(_Resetting):
    """Guard of a longitudinal controller."""

    kind = LONGITUDINAL

    def command(
        self, ego: EgoState, trajectory: Trajectory, grade: float, steering_wheel_angle: float
    ) -> VehicleCommand:
        """Returns the command with the steering angle [rad] of the lateral controller.

        Raises:
          InputError: it is not a command, or a value is out of its range.
        """
        found = self.call("command", ego, trajectory, grade)
        if not isinstance(found, VehicleCommand):
            raise self.unusable("command", f"returned {shown(found)}, must be a VehicleCommand")
        values: dict[str, Any] = {"steering_wheel_angle": steering_wheel_angle}
        for name, (low, high) in _RANGES.items():
            what = f"{self.title}: command returned {name}"
            values[name] = in_range(what, getattr(found, name), low, high)
        for name, modes in _MODES.items():
            mode = getattr(found, name)
            if not is_whole(mode) or mode not in list(modes):
                raise self.unusable("command", f"returned {name} {shown(mode)}: not a mode")
            values[name] = modes(mode)
        return VehicleCommand(**values)


class SpeedGuard(_Resetting):
    """Guard of a source of the reference speed."""

    kind = SPEED
    _profile: SpeedProfile | None = None

    def reset(self) -> None:
        """Prepares the part for a new drive."""
        super().reset()
        self._profile = None

    def update(self, scene: Scene, find_leader: Callable[[], Neighbor | None]) -> SpeedProfile:
        """Returns the profile; raises InputError if it is not usable."""
        found = self.call("update", scene, find_leader)
        if not isinstance(found, SpeedProfile):
            raise self.unusable("update", f"returned {shown(found)}, must be a SpeedProfile")
        try:
            modes = found.transmission_mode
            profile = SpeedProfile(
                np.asarray(found.station, dtype=float),
                np.asarray(found.speed, dtype=float),
                None if modes is None else np.asarray(modes, dtype=np.int64),
                float(found.coast_above),
            )
        except (TypeError, ValueError):
            raise self.unusable("update", "returned a profile without numbers") from None
        check_profile(profile, f"{self.title}: the profile of update")
        self._profile = profile
        return profile

    def at(self, station: float) -> float:
        """Returns the profile's speed at a station [m/s]."""
        if self._profile is None:
            raise self.unusable("update", "was not called yet")
        return self._profile.at(station)

    def free(self, station: float) -> float:
        """Returns the speed without traffic [m/s]; the profile's where the part has no `free`."""
        has_free = hasattr(self.part, "free")
        return self.number("free", station) if has_free else self.at(station)


# What the stack uses.
AnyPlanner = Planner | PlannerGuard
AnyLateral = LateralController | LateralGuard
AnyLongitudinal = LongitudinalController | LongitudinalGuard


def guarded_decision(part: protocols.DecisionMaker) -> protocols.DecisionMaker:
    """Returns a decision maker behind its guard; a shipped one as it is."""
    return DecisionGuard(part) if is_own(part) else part


def guarded_planner(
    part: protocols.TrajectoryPlanner, route: Route, config: PlannerConfig
) -> AnyPlanner:
    """Returns a planner behind its guard; a shipped one as it is."""
    if isinstance(part, (Planner, PlannerGuard)) and not is_own(part):
        return part
    return PlannerGuard(part, route, config)


def guarded_lateral(part: protocols.LateralControl) -> AnyLateral:
    """Returns a lateral controller behind its guard; a shipped one as it is."""
    if isinstance(part, (LateralController, LateralGuard)) and not is_own(part):
        return part
    return LateralGuard(part)


def guarded_longitudinal(part: protocols.LongitudinalControl) -> AnyLongitudinal:
    """Returns a longitudinal controller behind its guard; a shipped one as it is."""
    if isinstance(part, (LongitudinalController, LongitudinalGuard)) and not is_own(part):
        return part
    return LongitudinalGuard(part)


def guarded_speed(part: Any) -> SpeedReference:
    """Returns a source of the reference speed behind its guard; a shipped one as it is."""
    return SpeedGuard(part) if is_own(part) else part
