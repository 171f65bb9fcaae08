"""Settings of the trajectory planner; `PlannerConfig` holds the others."""

from __future__ import annotations

import functools
from dataclasses import dataclass, field, fields
from typing import NamedTuple

from iits_mj.core.checks import require_positive
from iits_mj.core.errors import InputError
from iits_mj.kernels import Table
from iits_mj.parameters import TruckParameters
from iits_mj.parameters.mass_state import rolling_resistance

# Delay of the truck's brakes [s], and its hardest braking, positive [m/s2].
_BRAKE_DELAY, _FULL_BRAKING = 0.5, 6.5


class Powers(NamedTuple):
    """Power at the wheels [W], rolling resistance [1] and 0.5 rho CdA [kg/m] of a truck."""

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
            rolling_resistance(parameters, parameters.payload_max),
            0.5 * air.density * air.mean_drag_area(),
        )


@dataclass(frozen=True)
class FollowingConfig:
    """Settings of car following and of the speed's changes.

    Attributes:
      time_gap: to the leader, bumper to bumper [s].
      standstill_gap: to a leader at rest [m].
      acceleration_max: [m/s2]; the engine's power limits it further.
      deceleration: comfortable one of the IDM, positive [m/s2].
      deceleration_max: of the plan outside emergencies, positive [m/s2].
      preview_deceleration: towards lower limits ahead, positive [m/s2].
      jerk_max: when braking [m/s3]; half of it when accelerating.
      regain_deceleration: to restore a time gap that is too short, positive [m/s2].
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

    @functools.cached_property
    def table(self) -> Table:
        """The settings in this order, for the compiled functions."""
        return Table([getattr(self, field.name) for field in fields(self)])


@dataclass(frozen=True)
class SpeedConfig:
    """Longitudinal limits of the plan.

    Attributes:
      cruise_speed: without a reference profile [m/s]; the paper's 60 km/h.
      curve_acceleration: lateral acceleration that bounds the speed in curves [m/s2].
      preview: distance ahead within which limits count [m].
      stop_gap: from the front bumper to the end of the lane or of the road [m].
      powers: of the truck, which limit the planned acceleration; too low a power would hold the
        truck back after a climb. None: of the planner's truck, or of the shipped one.
      emergency_onset: required deceleration that starts emergency braking; least demand [m/s2].
      emergency_release: required deceleration at which emergency braking ends [m/s2].
      emergency_share: ratio of the demanded to the required deceleration, above 1.
      emergency_deceleration: greatest demand [m/s2].
      emergency_margin: gap left after an emergency stop [m].
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
    emergency_deceleration: float = _FULL_BRAKING
    emergency_margin: float = 2.0
    reaction_time: float = _BRAKE_DELAY
    following: FollowingConfig = field(default_factory=FollowingConfig)

    def __post_init__(self) -> None:
        names = "onset", "release", "deceleration", "share"
        require_positive(self, *(f"emergency_{name}" for name in names))
        require_positive(self, "cruise_speed", "curve_acceleration", "preview")
        if self.powers is not None:
            require_positive(self.powers, *Powers._fields)
        require_positive(self, "stop_gap", "emergency_margin", "reaction_time", zero=True)


@dataclass(frozen=True)
class LaneChangeConfig:
    """Limits of lane changes.

    Attributes:
      comfort_acceleration: greatest lateral acceleration by the change alone [m/s2].
      change_share: of the rollover threshold, for the trailer's acceleration by the change alone;
        0.18 of 0.39 g gives a 55 t truck at 60 km/h 0.68 m/s2, which takes 6 s.
      total_share: the same for change and road together; a third of the threshold lifts no wheel of
        a laden truck, at 0.42 all wheels keep some load.
      jerk: lateral [m/s3].
      duration_min, duration_max: [s].
      length_min: at low speed, so that the trailer has room to follow [m].
      abort_acceleration: lateral, of aborts and returns to the lane's middle [m/s2].
      abort_jerk: lateral [m/s3].
      abort_share: share of the lateral distance after which the truck always finishes a change.
      pause: between two changes [s].
      speed_min: below it the truck changes only where its lane ends [m/s].
      side_gap: to the side of an overtaken vehicle [m].
      lane_left: length of the target lane beyond the change [m].
      merge_time: travel time to its lane's end at which the truck starts to look for a gap [s].
      merge_distance: the same as distance [m].
      keep_right_time: for which a lane must stay free for a truck that keeps right [s].
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
    keep_right_time: float = 20.0


@dataclass(frozen=True)
class SafetyConfig:
    """Gaps that a lane change must leave.

    Attributes:
      margin: least gap at both ends [m].
      front_time_gap: to the new leader [s].
      front_deceleration: comfortable one of the truck behind a slower leader, positive [m/s2].
      rear_time_gap: of the new follower [s].
      rear_reaction_time: of the new follower before it brakes comfortably [s].
      rear_deceleration: comfortable one of the new follower, positive [m/s2].
      reaction_time: of the truck with its brakes when the new leader brakes hard [s].
      driver_reaction_time: of the new follower when the truck brakes hard [s]; it has seen the
        truck's indicator before the truck is in its lane.
      truck_braking: hardest braking of the truck, positive [m/s2].
      car_braking: hardest braking of other vehicles as leaders, positive [m/s2].
      driver_braking: expected of a follower, positive [m/s2].
      entering: a vehicle that enters the target lane within this time, from either side, counts
        as in it [s].
      sight_behind: range of the sensors to the rear [m].
      unlimited_speed: of a vehicle beyond that range on a road without a limit [m/s].
      speeding: share by which such a vehicle may exceed a limit.
      abort_factor: share of these gaps below which the truck aborts a change.
    """

    margin: float = 3.0
    front_time_gap: float = 0.9
    front_deceleration: float = 0.8
    rear_time_gap: float = 0.7
    rear_reaction_time: float = 1.0
    rear_deceleration: float = 1.5
    reaction_time: float = _BRAKE_DELAY
    driver_reaction_time: float = 0.75
    truck_braking: float = _FULL_BRAKING
    car_braking: float = 8.0
    driver_braking: float = 6.5
    entering: float = 3.0
    sight_behind: float = 150.0
    unlimited_speed: float = 36.1
    speeding: float = 0.1
    abort_factor: float = 0.5


@dataclass(frozen=True)
class MergeConfig:
    """Settings of the search for a gap when the truck's lane ends.

    Attributes:
      deceleration: greatest one to reach a gap behind, positive [m/s2].
      speed_min: least speed to which the truck slows down for a gap [m/s].
      crossing_time: from the start of the change until the truck has left its lane [s].
      room: left before the end of the lane, enough for a change from standstill [m].
      stop_deceleration: towards that place while no gap opens, positive [m/s2].
      keep: bonus of the gap of the last cycle [m2/s4].
      patience: cost of each second until the gap is reached [m2/s5].
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
    """Settings of the response to traffic lights.

    Attributes:
      sight: distance at which the truck responds to a light [m].
      stop_before: gap from the front bumper to the line [m].
      deceleration: towards a line that is seen in time, positive [m/s2].
      yellow_deceleration: greatest for a yellow light, positive [m/s2].
      red_deceleration: greatest for a red light, positive [m/s2]; the truck passes a light that
        needs more.
      reaction_time: until the brakes act [s].
      arrival_reserve: time from a known change to green until the truck arrives [s].
      arrival_deceleration: greatest one to arrive later, positive [m/s2].
      slow_speed: the truck stops rather than arrive more slowly [m/s].
      creep_speed: below it the truck always stops before a red line [m/s].
      overshoot: a truck that stops up to this far beyond the line stays there [m].
      stand_time: at a green arrow's line before the truck continues [s].
    """

    sight: float = 300.0
    stop_before: float = 0.8
    deceleration: float = 0.8
    yellow_deceleration: float = 2.0
    red_deceleration: float = 3.5
    reaction_time: float = _BRAKE_DELAY
    arrival_reserve: float = 3.0
    arrival_deceleration: float = 0.8
    slow_speed: float = 3.0
    creep_speed: float = 2.0
    overshoot: float = 2.0
    stand_time: float = 1.0


@dataclass(frozen=True)
class PassingConfig:
    """Settings of passing a stopped vehicle.

    Attributes:
      lead_speed: a slower vehicle counts as stopped [m/s].
      speed: while passing [m/s].
      lengths: of the change, tried from the gentle one to the tight one [m]; 19 m for a lane of
        4 m has a radius of 16 m, more than the truck's least.
      room: beside and behind the stopped vehicle [m].
      gap: from the front bumper to the stopped vehicle, enough to pass it [m].
      patience: time behind a vehicle that has stopped alone after which the truck passes it without
        a decision [s]: a decision maker that compares accelerations sees no gain while there is
        room ahead.
      free: road ahead of the stopped vehicle, and beside it, that a jam would fill [m].
      creep_speed: a slower vehicle there is in a queue [m/s].
      sight: checked length of the lanes beside [m].
      moves: a vehicle faster than this has moved off, and the truck does not pass it [m/s].
      deceleration: to the waiting place, positive [m/s2]; a truck that is nearer stops nearer.
      light_near: a vehicle within this distance before a traffic light's line waits there [m].
      reach: distance beyond a vehicle at which the trailer has passed it [m].
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
      resync_speed: greatest difference of the plan's speed from the truck's [m/s].
      recover_offset: beyond this distance from the plan, planning starts at the truck [m].
      settled_offset: distance from the lane's middle at which a change is complete [m].
      curve_share: of the rollover threshold, bounds the speed in bends with their cross-slope.
      keep_right: whether the truck keeps right, see `controllers.planning.keep_right`.
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
    keep_right: bool = False
    speed: SpeedConfig = field(default_factory=SpeedConfig)
    change: LaneChangeConfig = field(default_factory=LaneChangeConfig)
    safety: SafetyConfig = field(default_factory=SafetyConfig)
    merge: MergeConfig = field(default_factory=MergeConfig)
    light: LightConfig = field(default_factory=LightConfig)
    passing: PassingConfig = field(default_factory=PassingConfig)

    def __post_init__(self) -> None:
        names = "horizon", "step", "resync_speed", "recover_offset", "settled_offset"
        require_positive(self, *names, "curve_share")
        if self.horizon < self.step:
            raise InputError(
                f"PlannerConfig: horizon is {self.horizon:g} s: at least one step of "
                f"{self.step:g} s is needed"
            )
