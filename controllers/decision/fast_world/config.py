"""What the fast world's traffic is: kinds of vehicles, density, the IDM they follow by."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from iits_mj.core.arrays import FloatArray
from iits_mj.core.errors import InputError

# --- The straight two-lane road of the fast world: answers what decision makers ask of a `Route`

LANES = 2
LANE_WIDTH = 4.0
LENGTH = 15_000.0


@dataclass(frozen=True)
class StraightPoint:
    """Pose on the straight road; the fields are those of `iits_mj.road.RoadPoint`."""

    x: float
    y: float
    z: float
    heading: float
    curvature: float
    grade: float
    superelevation: float


class HighwayRoad:
    """Two lanes of 4 m, 15 km, straight in plan, hilly in profile.

    The reference line is the centre of lane 0, so that a lane's offset is its index times 4 m.
    Grades are two sine waves with random phases, at most `grade_max`: shaped like the paper's
    road, whose grades lie within 5 %. Plays the part of `iits_mj.road.Route` for the functions
    below only.
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

    def evaluate(self, station: float, offset: float = 0.0) -> StraightPoint:
        """Pose at a station and offset; height is not modeled."""
        grade = self.smoothed_grade(station)
        return StraightPoint(station, offset, 0.0, 0.0, 0.0, grade, 0.0)

    def lane_count(self, station: float) -> int:
        """Always two."""
        del station
        return LANES

    def lane_exists(self, lane: int, station: float) -> bool:
        """True for lanes 0 and 1 on the road."""
        return 0 <= lane < LANES and station <= self.length + 1000.0

    def lane_offset(self, lane: int, station: float) -> float:
        """Offset of the lane's centre [m]."""
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


# --- What the fast world's traffic is: kinds of vehicles, density, the IDM they follow by ---


@dataclass(frozen=True, kw_only=True)
class Kind:
    """A kind of vehicle and its driver: those of the SUMO traffic, by the same names. SI units.

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
    deceleration: float = 2.0
    desired_speed_mean: float
    desired_speed_deviation: float
    desired_speed_low: float
    politeness: float = 0.25
    change_threshold: float
    keep_right_bias: float
    safe_braking: float = 4.0


# The SUMO traffic's figures, traffic_bridge/vehicles/types.toml; a test holds them to be the same.
KINDS = (
    Kind(
        kind="car",
        share=0.70,
        length=4.7,
        width=1.85,
        height=1.5,
        minimum_gap=2.5,
        time_headway=1.5,
        acceleration=1.4,
        desired_speed_mean=0.95,
        desired_speed_deviation=0.07,
        desired_speed_low=0.75,
        change_threshold=0.1,
        keep_right_bias=0.2,
    ),
    Kind(
        kind="van",
        share=0.12,
        length=6.0,
        width=2.05,
        height=2.6,
        minimum_gap=2.5,
        time_headway=1.5,
        acceleration=1.1,
        desired_speed_mean=0.92,
        desired_speed_deviation=0.06,
        desired_speed_low=0.75,
        change_threshold=0.1,
        keep_right_bias=0.2,
    ),
    Kind(
        kind="truck",
        share=0.08,
        length=9.5,
        width=2.50,
        height=3.6,
        minimum_gap=4.0,
        time_headway=2.0,
        acceleration=0.7,
        desired_speed_mean=0.85,
        desired_speed_deviation=0.05,
        desired_speed_low=0.70,
        change_threshold=0.2,
        keep_right_bias=0.4,
    ),
    Kind(
        kind="articulated",
        share=0.10,
        length=16.5,
        width=2.55,
        height=4.0,
        minimum_gap=4.0,
        time_headway=2.0,
        acceleration=0.7,
        desired_speed_mean=0.82,
        desired_speed_deviation=0.05,
        desired_speed_low=0.68,
        change_threshold=0.2,
        keep_right_bias=0.4,
    ),
)
SHARES = tuple(kind.share for kind in KINDS)
# The truck is minded as a vehicle of this kind, as in the SUMO traffic.
TRUCK_KIND = len(KINDS) - 1
# Of the traffic's limit; the SUMO traffic fills the road by the same figure.
MEAN_DESIRED_SPEED = 0.92


class Drivers:
    """Parameters of many drivers: an array of shape (n,) for each number of `Kind`.

    Args:
      kinds: index into `KINDS` of each of the n drivers.
    """

    def __init__(self, kinds: NDArray[np.int64]) -> None:
        self._kinds = kinds

    def __getattr__(self, name: str) -> FloatArray:
        values: FloatArray = _TABLE[name][self._kinds]
        setattr(self, name, values)
        return values

    def of(self, index: NDArray[np.int64]) -> Drivers:
        """Some of them, in the order of an index."""
        return Drivers(self._kinds[index])


_TABLE = {
    field.name: np.array([getattr(kind, field.name) for kind in KINDS])
    for field in fields(Kind)
    if field.name != "kind"
}


@dataclass(frozen=True)
class HighwayConfig:
    """The traffic of the fast world. SI units.

    Attributes:
      spawn_probability: of a vehicle appearing, per second and lane.
      traffic_speed: speed limit of the traffic [m/s].
      keeps_right: whether it keeps right; else each drives for itself, on either lane.
      window_behind, window_ahead: the simulated stretch about the truck [m]. Slow vehicles side by
        side gather the others behind them; ahead there must be road enough for that to have
        happened by the time that the truck arrives.
      sight_behind, sight_ahead: the stretch whose vehicles are told of [m].
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
        """Refuses values that are not finite or make no traffic."""
        for name in ("traffic_speed", "window_behind", "window_ahead", "timestep"):
            value = getattr(self, name)
            if not math.isfinite(value) or value <= 0.0:
                raise InputError(f"{name} = {value!r} is not allowed: use a number above 0")
        if not 0.0 <= self.spawn_probability <= 1.0:
            raise InputError(f"spawn_probability = {self.spawn_probability!r}: use 0 to 1")

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

    Above the desired speed the free term is bounded at -b, which the original leaves unbounded.
    """
    a, b = drivers.acceleration, drivers.deceleration
    free = a * np.maximum(1.0 - (speed / desired) ** 4, -b / a)
    dynamic = speed * (speed - leader_speed) / (2.0 * np.sqrt(a * b))
    wanted = drivers.minimum_gap + np.maximum(0.0, speed * drivers.time_headway + dynamic)
    return free - a * (wanted / np.maximum(gap, 0.1)) ** 2
