"""Road and traffic of the fast world: lanes, kinds of vehicles, density."""

from __future__ import annotations

import math
import tomllib
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from controllers.decision.trip import TrafficDemand
from iits_mj.core.assets import DEFAULT_MIX, VEHICLE_TYPES
from iits_mj.core.checks import require_positive
from iits_mj.road import RoadPoint

LANE_WIDTH = 4.0
# Shares of the greatest grade, and periods [m], of the hills' two waves.
WAVES = np.array([0.65, 0.35])
PERIODS = (1900.0, 730.0)
Pair = tuple[float, float]


class HighwayRoad:
    """Lanes of 4 m, straight in plan, hilly in profile.

    The reference line is the center of lane 0, so that a lane's offset is its index times 4 m.
    Grades are two sine waves with random phases, at most `grade_max`, like those of the paper's
    road, whose grades are within 5 %. It has those functions of `iits_mj.road.Route` that decision
    makers call.

    Args:
      length: [m]; lanes: their number.
      amplitude, phase: of the waves' grades, [-] and [rad].
    """

    def __init__(self, length: float, lanes: int, amplitude: Pair, phase: Pair) -> None:
        self.length, self.lanes = length, lanes
        self._waves = tuple(zip(amplitude, PERIODS, phase, strict=True))

    def smoothed_grade(self, station: float) -> float:
        """Returns the grade dz/ds."""
        return sum(a * math.sin(2.0 * math.pi * station / p + phase) for a, p, phase in self._waves)

    def evaluate(self, station: float, offset: float = 0.0) -> RoadPoint:
        """Returns the pose at a station and offset; height is not modeled."""
        grade = self.smoothed_grade(station)
        # Floats, as those of `Route.evaluate` at one station.
        values: Any = station, offset, 0.0, 0.0, 0.0, grade, 0.0
        return RoadPoint(*values)

    def lane_exists(self, lane: int, station: float) -> bool:
        """Returns whether the highway has a lane and the station is on the road."""
        return 0 <= lane < self.lanes and station <= self.length + 1000.0

    def lane_offset(self, lane: int, station: float) -> float:
        """Returns the offset of a lane's center [m]."""
        del station
        return lane * LANE_WIDTH

    def lane_width(self, lane: int, station: float) -> float:
        """Returns the width of a lane [m]."""
        del lane, station
        return LANE_WIDTH

    def lane_at(self, station: float, offset: float) -> int:
        """Returns the lane at an offset, -1 beside the road."""
        del station
        lane = math.floor(offset / LANE_WIDTH + 0.5)
        return lane if 0 <= lane < self.lanes else -1


@dataclass(frozen=True, kw_only=True)
class Kind:
    """A kind of vehicle and its driver, as in the SUMO traffic. SI units.

    Attributes:
      kind: its name; length, width, height: of its box.
      minimum_gap, time_headway, acceleration, deceleration: IDM's s0, T, a, b.
      desired_speed_mean, desired_speed_deviation, desired_speed_low: share of the traffic's limit,
        normally distributed and cut to [low, 1].
      politeness, change_threshold, keep_right_bias, safe_braking: MOBIL's p, a_th, a_bias, b_safe.
    """

    kind: str
    length: float
    width: float
    height: float
    minimum_gap: float
    time_headway: float
    acceleration: float
    deceleration: float
    desired_speed_mean: float
    desired_speed_deviation: float
    desired_speed_low: float
    politeness: float
    change_threshold: float
    keep_right_bias: float
    safe_braking: float


NUMBERS = tuple(field.name for field in fields(Kind) if field.name != "kind")
_TYPES = tomllib.loads(VEHICLE_TYPES.read_text(encoding="utf-8"))
KINDS = tuple(
    Kind(kind=kind, **{name: _TYPES[kind][name] for name in NUMBERS}) for kind, _ in DEFAULT_MIX
)
# Share of the traffic's limit with which the road is filled, as in SUMO.
MEAN_DESIRED_SPEED = 0.92
SHARES = tuple(share for _, share in DEFAULT_MIX)


@dataclass(frozen=True)
class HighwayConfig(TrafficDemand):
    """The traffic of the fast world. SI units.

    Attributes:
      window_behind, window_ahead: the simulated road around the truck [m]. It is long enough ahead
        for platoons to form behind slow vehicles side by side before the truck arrives.
      sight_behind, sight_ahead: the road whose vehicles are visible [m].
      timestep: of the traffic and the truck [s].
    """

    window_behind: float = 250.0
    window_ahead: float = 2_000.0
    sight_behind: float = 250.0
    sight_ahead: float = 450.0
    timestep: float = 0.2

    def __post_init__(self) -> None:
        super().__post_init__()
        require_positive(self, "window_behind", "window_ahead", "timestep")


@dataclass(frozen=True)
class Obstacle:
    """The truck as the traffic sees it, in one lane: front bumper, length, speed, lane."""

    front: float
    length: float
    speed: float
    lane: int
