"""Road and traffic of the fast world: lanes, kinds of vehicles, density, the IDM."""

from __future__ import annotations

import math
import tomllib
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from iits_mj.core.arrays import FloatArray, IntArray
from iits_mj.core.assets import VEHICLE_TYPES
from iits_mj.core.checks import in_range, require_positive
from iits_mj.road import RoadPoint

LANES = 2
LANE_WIDTH = 4.0
LENGTH = 15_000.0


class HighwayRoad:
    """Two lanes of 4 m, 15 km, straight in plan, hilly in profile.

    The reference line is the center of lane 0, so that a lane's offset is its index times 4 m.
    Grades are two sine waves with random phases, at most `grade_max`, like those of the paper's
    road, whose grades are within 5 %. It has those functions of `iits_mj.road.Route` that decision
    makers call.
    """

    def __init__(
        self, generator: np.random.Generator, length: float = LENGTH, grade_max: float = 0.045
    ) -> None:
        self.length = length
        self._amplitude = (0.65 * grade_max, 0.35 * grade_max)
        self._period = (1900.0, 730.0)
        self._phase = tuple(generator.uniform(0.0, 2.0 * math.pi, 2).tolist())

    def smoothed_grade(self, station: float) -> float:
        """Grade dz/ds."""
        waves = zip(self._amplitude, self._period, self._phase, strict=True)
        return sum(a * math.sin(2.0 * math.pi * station / p + phase) for a, p, phase in waves)

    def evaluate(self, station: float, offset: float = 0.0) -> RoadPoint:
        """Pose at a station and offset; height is not modeled."""
        grade = self.smoothed_grade(station)
        # Floats, as those of `Route.evaluate` at one station.
        values: Any = station, offset, 0.0, 0.0, 0.0, grade, 0.0
        return RoadPoint(*values)

    def lane_count(self, station: float) -> int:
        """Always two."""
        del station
        return LANES

    def lane_exists(self, lane: int, station: float) -> bool:
        """True for lanes 0 and 1 on the road."""
        return 0 <= lane < LANES and station <= self.length + 1000.0

    def lane_offset(self, lane: int, station: float) -> float:
        """Offset of the lane's center [m]."""
        del station
        return lane * LANE_WIDTH

    def lane_width(self, lane: int, station: float) -> float:
        """Width [m]."""
        del lane, station
        return LANE_WIDTH

    def lane_at(self, station: float, offset: float) -> int:
        """Lane under an offset, -1 beside the road."""
        del station
        lane = math.floor(offset / LANE_WIDTH + 0.5)
        return lane if 0 <= lane < LANES else -1

    def speed_limit(self, station: float, lane: int = 0) -> float:
        """The truck's limit, 60 km/h [m/s]."""
        del station, lane
        return 60.0 / 3.6


@dataclass(frozen=True, kw_only=True)
class Kind:
    """A kind of vehicle and its driver, as in the SUMO traffic. SI units.

    Attributes:
      kind: its name; share: of the traffic; length, width, height: of its box.
      minimum_gap, time_headway, acceleration, deceleration: IDM's s0, T, a, b.
      desired_speed_mean, desired_speed_deviation, desired_speed_low: share of the traffic's limit,
        normally distributed and cut to [low, 1].
      politeness, change_threshold, keep_right_bias, safe_braking: MOBIL's p, a_th, a_bias, b_safe.
    """

    kind: str
    share: float
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


# Shares of the traffic, those of the SUMO traffic; a test holds them equal.
_SHARES = {"car": 0.70, "van": 0.12, "truck": 0.08, "articulated": 0.10}
_NUMBERS = tuple(field.name for field in fields(Kind) if field.name not in ("kind", "share"))
_TYPES = tomllib.loads(VEHICLE_TYPES.read_text(encoding="utf-8"))
KINDS = tuple(
    Kind(kind=kind, share=share, **{name: _TYPES[kind][name] for name in _NUMBERS})
    for kind, share in _SHARES.items()
)
SHARES = tuple(kind.share for kind in KINDS)
# The traffic treats the truck as a vehicle of this kind, as in SUMO.
TRUCK_KIND = len(KINDS) - 1
# Share of the traffic's limit with which the road is filled, as in SUMO.
MEAN_DESIRED_SPEED = 0.92


class Drivers:
    """Parameters of many drivers: an array of shape (n,) for each number of `Kind`.

    Args:
      kinds: index into `KINDS` of each of the n drivers.
    """

    def __init__(self, kinds: IntArray) -> None:
        self._kinds = kinds

    def __getattr__(self, name: str) -> FloatArray:
        values: FloatArray = _TABLE[name][self._kinds]
        setattr(self, name, values)
        return values

    def of(self, index: IntArray) -> Drivers:
        """Some of them, in the order of an index."""
        return Drivers(self._kinds[index])


_TABLE = {name: np.array([getattr(kind, name) for kind in KINDS]) for name in _NUMBERS}


@dataclass(frozen=True)
class HighwayConfig:
    """The traffic of the fast world. SI units.

    Attributes:
      spawn_probability: of a vehicle appearing, per second and lane.
      traffic_speed: speed limit of the traffic [m/s].
      keeps_right: whether it keeps right; else vehicles use both lanes.
      window_behind, window_ahead: the simulated stretch about the truck [m]. Slow vehicles side by
        side gather the others behind them; the road ahead is long enough for that to have happened
        before the truck arrives.
      sight_behind, sight_ahead: the stretch whose vehicles are visible [m].
      timestep: of the traffic and the truck [s].
    """

    spawn_probability: float = 0.05
    traffic_speed: float = 12.5
    keeps_right: bool = False
    window_behind: float = 250.0
    window_ahead: float = 2_000.0
    sight_behind: float = 250.0
    sight_ahead: float = 450.0
    timestep: float = 0.2

    def __post_init__(self) -> None:
        require_positive(self, "traffic_speed", "window_behind", "window_ahead", "timestep")
        in_range("spawn_probability", self.spawn_probability, 0.0, 1.0)

    @property
    def mean_headway(self) -> float:
        """Mean distance between the fronts of vehicles of a lane [m]; inf without traffic."""
        rate = self.spawn_probability
        return MEAN_DESIRED_SPEED * self.traffic_speed / rate if rate > 0.0 else math.inf


@dataclass(frozen=True)
class Obstacle:
    """The truck as the traffic sees it, in one lane: front bumper, length, speed, lane."""

    front: float
    length: float
    speed: float
    lane: int


def idm_acceleration(
    speed: FloatArray,
    desired: FloatArray,
    gap: FloatArray,
    leader_speed: FloatArray,
    drivers: Drivers,
) -> FloatArray:
    """IDM acceleration [m/s2], Treiber et al. (2000) eq. 3; arrays of one shape, gap inf if free.

    The free term is bounded at -b above the desired speed; the original leaves it unbounded.
    """
    a, b = drivers.acceleration, drivers.deceleration
    free = a * np.maximum(1.0 - (speed / desired) ** 4, -b / a)
    dynamic = speed * (speed - leader_speed) / (2.0 * np.sqrt(a * b))
    wanted = drivers.minimum_gap + np.maximum(0.0, speed * drivers.time_headway + dynamic)
    return free - a * (wanted / np.maximum(gap, 0.1)) ** 2
