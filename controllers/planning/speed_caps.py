"""Bounds on the speed along a path, and the greatest speed by the end of a lane change."""

from __future__ import annotations

import math
import operator
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from controllers.planning.config import PlannerConfig
from controllers.planning.following import braking_profile
from controllers.planning.road_preview import LanePath, RoadPreview, strongest
from controllers.planning.rollover_limits import RollMargin, curve_speed_by_roll
from controllers.planning.speed_plan import power_acceleration, speed_cap
from iits_mj import kernels
from iits_mj.core.arrays import FloatArray
from iits_mj.core.errors import InputError
from iits_mj.core.messages import EgoState, SpeedProfile, SpeedZone
from iits_mj.kernels import Address, Integer, Real

# Below this speed the reference does not limit a launch below its own speed ahead [m/s]. The rise
# exceeds any truck's, so that power and comfort limit it, as without a reference [m/s2].
LAUNCH_SPEED, LAUNCH_ACCELERATION = 8.0, 1.5
_LAUNCH_AHEAD = 200.0
# Excess over the reference at which a truck begins to ease off, and at which it ends [m/s].
_EASING_BEGINS, _EASING_ENDS = 1.0, 0.1

_reference_speed = kernels.function(
    "iits_reference",
    None,
    *(Integer, Address, Integer, Address, Address),  # stations and nodes
    *(*4 * [Real], Address),  # launch and result
)


def with_zones(path: LanePath, zones: Sequence[SpeedZone]) -> LanePath:
    """The path with the limits of speed zones; where two overlap, the later one holds.

    Limits are interpolated between the path's stations. A lower limit therefore extends to the next
    station on both sides, so that the truck keeps it from the sign to the end.

    Raises:
      InputError: a zone's limit is not a positive number, or an end is not a number.
    """
    if not zones:
        return path
    limit = path.speed_limit.copy()
    lanes = np.full(len(limit), path.lane) if path.rows is None else path.rows
    step = float(path.station[1] - path.station[0])
    for zone in zones:
        if not zone.limit > 0.0 or np.isnan([zone.start, zone.end]).any():
            raise InputError(
                f"speed zone of {zone.limit} m/s from {zone.start} to {zone.end} m: "
                "the limit must be positive and the ends numbers"
            )
        here = np.full(len(lanes), True) if zone.lane is None else lanes == zone.lane
        inside = here & (path.station >= zone.start) & (path.station < zone.end)
        near = here & (path.station > zone.start - step) & (path.station < zone.end + step)
        limit[inside] = zone.limit
        limit[near] = np.minimum(limit[near], zone.limit)
    return replace(path, speed_limit=limit)


def _reference(station: FloatArray, profile: SpeedProfile, ego: EgoState) -> SpeedProfile:
    """The reference at evenly spaced stations, with constant acceleration between its nodes.

    A profile over station cannot describe a start from rest: at low speed the planner's launch
    raises it.

    Raises:
      InputError: the reference is empty, or has not one speed for each station.
    """
    nodes = np.ascontiguousarray(profile.station, dtype=float)
    square, speed = np.ascontiguousarray(profile.speed, dtype=float) ** 2, np.empty(len(station))
    if not len(nodes) == len(square) > 0:
        raise InputError(
            f"reference speed of {len(nodes)} stations has {len(square)} speeds: must be as many, "
            "and not none"
        )
    launch = ego.speed**2 if ego.speed < LAUNCH_SPEED else -1.0
    address = kernels.address
    _reference_speed(
        *(len(station), address(station), len(nodes), address(nodes), address(square)),
        *(ego.station, launch, 2.0 * LAUNCH_ACCELERATION, _LAUNCH_AHEAD, address(speed)),
    )
    return SpeedProfile(station, speed)


class SpeedCaps:
    """Limits, reference, comfort and rollover margin as one bound on the speed over station.

    A reference that falls at once, as where the set speed changes, is approached at the preview
    deceleration. Limits and bends are not.
    """

    def __init__(self, preview: RoadPreview, config: PlannerConfig) -> None:
        self.preview = preview
        self.config = config
        self._acceleration = math.nan
        self._bearable: FloatArray = np.empty(0)
        self._known: tuple[tuple[LanePath, SpeedProfile | None, RollMargin], FloatArray] | None = (
            None
        )
        self.reset()

    def reset(self) -> None:
        """Prepares for a new drive."""
        self._eases = False

    def cap(
        self, path: LanePath, profile: SpeedProfile | None, margin: RollMargin, ego: EgoState
    ) -> FloatArray:
        """Greatest speed along a path, shape of path.station [m/s].

        Args:
          path: of the lane, with the limits in force.
          profile: reference speed over station; None: the cruise speed.
          margin: of the truck with its load.
          ego: the truck.

        Raises:
          InputError: the reference speed is not a number.
        """
        # At speed the bound does not depend on the truck: it is the last one until the truck has
        # another path or another reference.
        inputs = path, profile, margin
        least = _EASING_ENDS if self._eases else _EASING_BEGINS
        self._eases = self._excess(profile, ego) > least
        varies = self._eases or (profile is not None and ego.speed < LAUNCH_SPEED)
        known = None if varies else self._known
        if known is not None and all(map(operator.is_, inputs, known[0])):
            return known[1]
        if profile is not None:
            profile = _reference(path.station, profile, ego)
        if self._eases:
            profile = self._eased(path.station, profile, ego)
        cap = speed_cap(path, self.preview, self.config.speed, profile)
        first = self.preview.index(float(path.station[0]))
        cap = np.minimum(cap, self._by_roll(margin)[first : first + len(cap)])
        self._known = None if varies else (inputs, cap)
        return cap

    def _excess(self, profile: SpeedProfile | None, ego: EgoState) -> float:
        """Speed of the truck less that of the reference [m/s]."""
        wanted = self.config.speed.cruise_speed if profile is None else profile.at(ego.station)
        return ego.speed - wanted

    def _eased(
        self, station: FloatArray, profile: SpeedProfile | None, ego: EgoState
    ) -> SpeedProfile:
        """The reference at stations, raised to where the truck is as it eases off."""
        config = self.config.speed
        wanted = config.cruise_speed if profile is None else profile.speed
        fall = 2.0 * config.following.preview_deceleration
        square = ego.speed**2 - fall * np.maximum(station - ego.station, 0.0)
        return SpeedProfile(station, np.sqrt(np.maximum(square, np.square(wanted))))

    def top(self, ego: EgoState, profile: SpeedProfile | None) -> float:
        """Greatest speed that the truck may reach during a lane change [m/s].

        A faster truck drives farther during a change, to where reference and grade may allow an
        even greater speed: the result is the least consistent speed, found from below.

        Args:
          ego: the truck.
          profile: reference speed over station; None: the cruise speed.
        """
        preview, config = self.preview, self.config
        longest, most = config.change.duration_max, config.speed.following.acceleration_max
        here = preview.index(ego.station)
        reach = max((ego.speed + most * longest) * longest, config.change.length_min)
        ahead = slice(here, preview.index(ego.station + reach) + 2)
        station = preview.station[ahead]
        wanted = np.full(len(station), config.speed.cruise_speed)
        if profile is not None and len(station) > 1:
            wanted = _reference(station, profile, ego).speed
        wanted = np.maximum.accumulate(wanted)
        easiest = np.minimum.accumulate(preview.grade[ahead])
        top = ego.speed
        while True:
            way = max(top * longest, config.change.length_min)
            last = min(int(np.searchsorted(station, ego.station + way)), len(station) - 1)
            power = power_acceleration(ego.speed, ego.mass, float(easiest[last]), config.speed)
            gained = ego.speed + min(power, most) * longest
            found = max(ego.speed, min(gained, float(wanted[last])))
            if found <= top + 1e-3:
                return found
            top = found

    def power_left(self, ego: EgoState) -> float:
        """Acceleration that the engine's power allows now [m/s2]."""
        grade = float(np.interp(ego.station, self.preview.station, self.preview.grade))
        return power_acceleration(ego.speed, ego.mass, grade, self.config.speed)

    def bearable(self, station: float, margin: RollMargin) -> float:
        """Greatest speed with which the truck rolls over in no bend ahead [m/s]."""
        return float(np.interp(station, self.preview.station, self._by_roll(margin)))

    def _by_roll(self, margin: RollMargin) -> FloatArray:
        """Speed that the bends and their cross-slope allow, over the whole road [m/s]."""
        acceleration = self.config.curve_share * margin.threshold
        if self._acceleration != acceleration:
            preview, braking = self.preview, self.config.speed.following.preview_deceleration
            tight = strongest(preview.curvature)  # the speed must fit before the bend begins
            bends = curve_speed_by_roll(tight, preview.superelevation, acceleration)
            self._bearable = braking_profile(preview.station, bends, braking)
            self._acceleration = acceleration
        return self._bearable
