"""All settings of the trajectory planner. `PlannerConfig` holds the others."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

from iits_mj.core.checks import require_positive
from iits_mj.core.errors import InputError
from iits_mj.parameters import TruckParameters


class Powers(NamedTuple):
    """Of a truck: power at the wheels [W], rolling resistance [1], 0.5 rho CdA [kg/m]."""

    power: float
    rolling_resistance: float
    drag: float

    @classmethod
    def of(cls, parameters: TruckParameters) -> Powers:
        """Greatest power at the wheels in the best gear, and the resistances."""
        engine, gearbox, air = parameters.engine, parameters.gearbox, parameters.aerodynamics
        greatest = float((engine.full_load_torque * engine.full_load_speed).max())
        return cls(
            greatest * gearbox.efficiency * gearbox.driveline_efficiency,
            parameters.tire_common.rolling_resistance,
            0.5 * air.density * air.drag_area,
        )


@dataclass(frozen=True)
class FollowingConfig:
    """How the truck follows a leader and keeps its speed.

    Attributes:
      time_gap: to the leader, bumper to bumper [s].
      standstill_gap: to a leader at rest [m].
      acceleration_max: [m/s2], also limited by engine power.
      deceleration: comfortable, positive [m/s2]; of the IDM.
      deceleration_max: of the plan outside emergencies, positive [m/s2].
      preview_deceleration: towards lower limits ahead, positive [m/s2].
      jerk_max: [m/s3], when braking; drive builds up at half of it.
      regain_deceleration: spent on restoring a time gap that is too short, positive [m/s2].
      coolness: weight of the constant-acceleration heuristic, 0 to 1.
      exponent: of the free-road term.
    """

    time_gap: float = 1.5
    standstill_gap: float = 4.0
    acceleration_max: float = 1.0
    deceleration: float = 1.3
    deceleration_max: float = 3.5
    preview_deceleration: float = 0.5
    jerk_max: float = 2.0
    regain_deceleration: float = 0.8
    coolness: float = 0.95
    exponent: float = 4.0


@dataclass(frozen=True)
class SpeedConfig:
    """Longitudinal limits of the plan.

    Attributes:
      cruise_speed: wanted where no profile is given [m/s]; the paper's 60 km/h.
      curve_acceleration: lateral acceleration that bounds the speed in curves [m/s2].
      preview: how far ahead limits are looked up [m].
      stop_gap: from the front bumper to the end of the lane or of the road [m].
      powers: of the truck, for the acceleration that can be planned: with less power than it has
        the plan would hold it back after a climb. None: of the planner's truck, or the shipped one.
      emergency_onset: required deceleration that starts emergency braking, and the least that is
        demanded then [m/s2].
      emergency_release: required deceleration at which emergency braking ends [m/s2].
      emergency_share: of the required deceleration that is demanded, above 1.
      emergency_deceleration: demanded at most [m/s2].
      emergency_margin: gap wanted after an emergency stop [m].
      reaction_time: of the brakes, for the required deceleration [s].
      following: see `FollowingConfig`.

    Raises:
      InputError: a setting is out of its range; the message names it.
    """

    cruise_speed: float = 16.67
    curve_acceleration: float = 1.3
    preview: float = 400.0
    stop_gap: float = 3.0
    powers: Powers | None = None
    emergency_onset: float = 2.8
    emergency_release: float = 2.0
    emergency_share: float = 1.3
    emergency_deceleration: float = 6.5
    emergency_margin: float = 2.0
    reaction_time: float = 0.5
    following: FollowingConfig = field(default_factory=FollowingConfig)

    def __post_init__(self) -> None:
        names = "cruise_speed", "curve_acceleration", "preview", "emergency_onset"
        require_positive(self, *names, "emergency_release", "emergency_deceleration")
        require_positive(self, "emergency_share")
        if self.powers is not None:
            require_positive(self.powers, *Powers._fields)
        require_positive(self, "stop_gap", "emergency_margin", "reaction_time", zero=True)


@dataclass(frozen=True)
class LaneChangeConfig:
    """Limits of lane changes.

    Attributes:
      comfort_acceleration: lateral, of the change alone, whatever the truck can bear [m/s2].
      change_share: of the rollover threshold, for the trailer's acceleration by the change alone;
        0.18 of 0.39 g gives a 55 t truck at 60 km/h 0.68 m/s2, which takes 6 s.
      total_share: the same for change and road together; a third of the threshold lifts no wheel of
        a laden truck, at 0.42 all wheels keep some load.
      jerk: lateral [m/s3].
      duration_min, duration_max: [s].
      length_min: for slow driving: the trailer needs room to follow [m].
      abort_acceleration: lateral, when a change is given up or the lane is found again [m/s2].
      abort_jerk: lateral [m/s3].
      abort_share: share of the way after which a change is always finished.
      pause: between two changes [s].
      speed_min: below it the truck changes only where its lane ends [m/s].
      side_gap: beside the vehicle being overtaken [m].
      lane_left: of the target lane beyond the change [m].
      merge_time: before its lane's end the truck looks for a gap [s].
      merge_distance: the same as distance [m].
    """

    comfort_acceleration: float = 0.85
    change_share: float = 0.18
    total_share: float = 0.42
    jerk: float = 1.3
    duration_min: float = 4.5
    duration_max: float = 9.0
    length_min: float = 45.0
    abort_acceleration: float = 1.1
    abort_jerk: float = 3.0
    abort_share: float = 0.4
    pause: float = 3.0
    speed_min: float = 4.0
    side_gap: float = 0.4
    lane_left: float = 100.0
    merge_time: float = 24.0
    merge_distance: float = 300.0


@dataclass(frozen=True)
class SafetyConfig:
    """Gaps that a lane change must leave.

    Attributes:
      margin: at least, at both ends [m].
      front_time_gap: to the new leader [s].
      front_deceleration: of the truck behind a slower leader, comfortable, positive [m/s2].
      rear_time_gap: of the new follower [s].
      rear_reaction_time: of the new follower before it brakes comfortably [s].
      rear_deceleration: of the new follower, comfortable, positive [m/s2].
      reaction_time: of the truck with its brakes, when the new leader brakes hard [s].
      driver_reaction_time: of the new follower, when the truck brakes hard [s]; it has seen the
        truck's indicator before the truck is in its lane.
      truck_braking: hardest of the truck, positive [m/s2].
      car_braking: hardest of other vehicles as leaders, positive [m/s2].
      driver_braking: expected of a follower, positive [m/s2].
      entering: a vehicle that will be in the target lane within this time, from either side, counts
        as in it [s].
      sight_behind: range of the sensors to the rear [m].
      unlimited_speed: of a vehicle beyond that range on a road without a limit [m/s].
      speeding: share by which such a vehicle may exceed a limit.
      abort_factor: share of these gaps below which a change is given up.
    """

    margin: float = 3.0
    front_time_gap: float = 0.9
    front_deceleration: float = 0.8
    rear_time_gap: float = 0.7
    rear_reaction_time: float = 1.0
    rear_deceleration: float = 1.5
    reaction_time: float = 0.5
    driver_reaction_time: float = 0.75
    truck_braking: float = 6.5
    car_braking: float = 8.0
    driver_braking: float = 6.5
    entering: float = 3.0
    sight_behind: float = 150.0
    unlimited_speed: float = 36.1
    speeding: float = 0.1
    abort_factor: float = 0.5


@dataclass(frozen=True)
class MergeConfig:
    """How the truck looks for a gap when its lane ends.

    Attributes:
      deceleration: at most, to let a gap come, positive [m/s2].
      speed_min: the truck does not go slower for a gap [m/s].
      crossing_time: from the start of the change until the truck has left its lane [s].
      room: kept before the end of the lane, enough for a change from standstill [m].
      stop_deceleration: towards that place when no gap opens, positive [m/s2].
      keep: bonus of the gap aimed for before, in squares of acceleration.
      patience: cost of a second, in squares of acceleration.
    """

    deceleration: float = 1.5
    speed_min: float = 2.0
    crossing_time: float = 3.5
    room: float = 30.0
    stop_deceleration: float = 1.2
    keep: float = 0.2
    patience: float = 0.04


@dataclass(frozen=True)
class LightConfig:
    """How the truck obeys traffic lights.

    Attributes:
      sight: distance from which a light is looked at [m].
      stop_before: from the front bumper to the line [m].
      deceleration: towards a line that is seen in time, positive [m/s2].
      yellow_deceleration: most for a yellow light, positive [m/s2].
      red_deceleration: most for a red light; one that came too late is passed, positive [m/s2].
      reaction_time: until the brakes act [s].
      arrival_reserve: time after a known change to green at which the truck arrives [s].
      arrival_deceleration: at most, to arrive later, positive [m/s2].
      slow_speed: below it, stopping is better than arriving slowly [m/s].
      creep_speed: below it the truck always stops before a red line [m/s].
      overshoot: a truck that stops up to this far beyond the line stays there [m].
      stand_time: at a line with a stop sign before going on [s].
    """

    sight: float = 300.0
    stop_before: float = 0.8
    deceleration: float = 0.8
    yellow_deceleration: float = 2.0
    red_deceleration: float = 3.5
    reaction_time: float = 0.5
    arrival_reserve: float = 3.0
    arrival_deceleration: float = 0.8
    slow_speed: float = 3.0
    creep_speed: float = 2.0
    overshoot: float = 2.0
    stand_time: float = 1.0


@dataclass(frozen=True)
class PassingConfig:
    """How the truck passes a stopped vehicle.

    Attributes:
      lead_speed: a slower vehicle is stopped [m/s].
      speed: while passing [m/s].
      lengths: of the change, tried from the gentle one to the tight one [m]; 19 m for a lane of
        4 m has a radius of 16 m, more than the truck's least.
      room: beside and behind the stopped vehicle [m].
      gap: kept to the stopped vehicle, from the front bumper, to be able to pass [m].
      patience: after waiting this long behind a vehicle that is stopped alone the truck passes it
        without a decision: a decision maker that compares accelerations sees no gain while there
        is room ahead [s].
      free: road ahead of the stopped vehicle, and beside it, that a jam would fill [m].
      creep_speed: a slower vehicle there is in a queue [m/s].
      sight: how far lanes beside are looked along [m].
      moves: a faster vehicle drives on, which ends the reason to pass [m/s].
      deceleration: to the place at which to wait, positive [m/s2]; a truck that is nearer already
        stops nearer.
      light_near: a vehicle within this distance before a traffic light's line waits there [m].
      reach: from a vehicle this far on the trailer is past it [m].
    """

    lead_speed: float = 0.5
    speed: float = 3.0
    lengths: tuple[float, ...] = (30.0, 25.0, 22.0, 19.0)
    room: float = 0.35
    gap: float = 16.0
    patience: float = 5.0
    free: float = 40.0
    creep_speed: float = 2.0
    sight: float = 150.0
    moves: float = 1.0
    deceleration: float = 1.0
    light_near: float = 150.0
    reach: float = 35.0


@dataclass(frozen=True)
class PlannerConfig:
    """All settings of the planner.

    Attributes:
      lanes: indices of the lanes that decisions may lead to; the paper uses two.
      horizon: of the trajectory [s]; step: [s].
      resync_speed: the plan's speed stays within this of the truck's [m/s].
      recover_offset: at this distance from the plan the planner starts from the truck's place [m].
      settled_offset: distance from the lane's middle at which a change is complete [m].
      curve_share: of the rollover threshold, bounds the speed in bends with their cross-slope.
      speed: see `SpeedConfig`; change: see `LaneChangeConfig`; safety: see `SafetyConfig`;
      merge: see `MergeConfig`; light: see `LightConfig`; passing: see `PassingConfig`.

    Raises:
      InputError: a setting is out of its range; the message names it.
    """

    lanes: tuple[int, ...] = (0, 1)
    horizon: float = 6.0
    step: float = 0.1
    resync_speed: float = 0.5
    recover_offset: float = 0.8
    settled_offset: float = 0.4
    curve_share: float = 0.38
    speed: SpeedConfig = field(default_factory=SpeedConfig)
    change: LaneChangeConfig = field(default_factory=LaneChangeConfig)
    safety: SafetyConfig = field(default_factory=SafetyConfig)
    merge: MergeConfig = field(default_factory=MergeConfig)
    light: LightConfig = field(default_factory=LightConfig)
    passing: PassingConfig = field(default_factory=PassingConfig)

    def __post_init__(self) -> None:
        bounds = "horizon", "step", "resync_speed", "recover_offset", "settled_offset"
        require_positive(self, *bounds, "curve_share")
        if self.horizon < self.step:
            raise InputError(
                f"PlannerConfig: horizon is {self.horizon:g} s: at least one step of "
                f"{self.step:g} s is needed"
            )
