"""Safe stop: the truck's smooth stop in its lane without commands.

It uses the truck's state and the road alone: it keeps the lane with the tracking controller's
steering, brakes all axles by XBR at a moderate, jerk-limited deceleration, reduces it before
standstill and then sets the parking brake. It does not know the traffic. It brakes harder only
where the lane or the road ends sooner.
"""

from __future__ import annotations

import dataclasses
import enum
import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from controllers.planning.config import LaneChangeConfig, PlannerConfig, SpeedConfig
from controllers.planning.lane_change import BEHIND, quintic_back
from controllers.planning.road_preview import LanePath, RoadPreview
from controllers.planning.speed_plan import SpeedState
from controllers.planning.trajectory import Quintic, on_road
from controllers.tracking.lateral import USED, LateralConfig, LateralController, check_finite
from iits_mj.core.angles import wrap_angle
from iits_mj.core.arrays import FloatArray
from iits_mj.core.checks import require_positive
from iits_mj.core.errors import InputError
from iits_mj.core.messages import (
    EgoState,
    PlanMode,
    Trajectory,
    TransmissionMode,
    VehicleCommand,
    XbrEbiMode,
    XbrMode,
)
from iits_mj.core.timing import CONTROL_PERIOD, CYCLE_PERIOD
from iits_mj.parameters import TruckParameters

if TYPE_CHECKING:
    from iits_mj.road import Route

SLACK = 1e-6  # [s] in comparisons of times
_USED = (*USED, "acceleration", "offset")


@dataclass(frozen=True, slots=True)
class StopLimits:
    """Deceleration and jerk of a stop; all positive.

    Attributes:
      deceleration: in the middle of the stop [m/s2].
      jerk: greatest rate at which the deceleration builds up [m/s3].
      jerk_end: the same before standstill, at most `jerk` [m/s3].
      deceleration_end: when the truck comes to rest [m/s2].
    """

    deceleration: float = 1.5
    jerk: float = 1.0
    jerk_end: float = 0.8
    deceleration_end: float = 0.25

    def __post_init__(self) -> None:
        for name in ("deceleration", "jerk", "deceleration_end", "jerk_end"):
            value, whole = getattr(self, name), name.removesuffix("_end")
            most = 10.0 if name == whole else getattr(self, whole)
            if not 0.0 < value <= most:
                bound = f"{most:g}" if name == whole else f"{whole} = {most:g}"
                raise InputError(f"stop limit {name} = {value!r}: allowed is above 0 to {bound}")

    def wanted(self, speed: float) -> float:
        """Wanted acceleration at a speed [m/s2], zero or negative.

        The end is at constant jerk: `a^2 = a_end^2 + 2 jerk_end v`.
        """
        eased = math.sqrt(self.deceleration_end**2 + 2.0 * self.jerk_end * max(speed, 0.0))
        return -min(self.deceleration, eased)


class StopPhase(enum.Enum):
    """Phase of a stop."""

    BRAKING = "braking"
    STANDING = "standing"
    PARKED = "parked"


@dataclass(frozen=True)
class SafeStopConfig:
    """Settings of the stop.

    Attributes:
      limits: deceleration and jerk, see `StopLimits`.
      deceleration_max: greatest, where lane or road end too soon for the limits [m/s2].
      look_ahead: time of the lateral extrapolation that chooses the lane [s].
      off_center: distance from the lane's middle beyond which a transition curve leads back [m].
      stop_gap: from the front bumper to the end of lane or road [m].
      resync_speed: greatest difference of the plan's speed from the truck's [m/s].
      speed_gain: added deceleration by a speed above the plan's [1/s].
      lead_time: lead of the demand over the planned deceleration, for the brakes' lag [s].
      hold_demand: XBR demand at standstill [m/s2].
      neutral_speed: speed below which the driveline is open, so that no gear change disturbs the
        stop [m/s].
      standing_speed: speed below which the truck counts as stopped [m/s].
      standing_time: at standstill until the parking brake is set [s].
      parking_time: during which the service brakes hold until the parking brake acts [s].
      horizon: of the plan [s]; step: of its points [s].
      preview: range ahead of lane and road [m].
      change: lateral limits of the way back to the lane's middle.
      lateral: settings of the steering.
    """

    limits: StopLimits = field(default_factory=StopLimits)
    deceleration_max: float = 4.0
    look_ahead: float = 1.0
    off_center: float = 0.2
    stop_gap: float = SpeedConfig.stop_gap
    resync_speed: float = PlannerConfig.resync_speed
    speed_gain: float = 0.5
    lead_time: float = 0.3
    hold_demand: float = 1.5
    neutral_speed: float = 6.0
    standing_speed: float = 0.05
    standing_time: float = 1.0
    parking_time: float = 2.0
    horizon: float = 4.0
    step: float = 0.1
    preview: float = 500.0
    change: LaneChangeConfig = field(default_factory=LaneChangeConfig)
    lateral: LateralConfig = field(default_factory=LateralConfig)

    def __post_init__(self) -> None:
        if not self.limits.deceleration <= self.deceleration_max <= 10.0:
            raise InputError(
                f"deceleration_max = {self.deceleration_max!r} m/s2: allowed is the deceleration "
                f"{self.limits.deceleration:g} to 10"
            )
        require_positive(self, "standing_time", "parking_time", "stop_gap", zero=True)
        require_positive(self, "off_center", "look_ahead", zero=True)


class SafeStop:
    """Stops the truck in its lane and parks it; the first `command` begins the stop.

    Attributes:
      phase: of the stop; lane: index of the kept lane, -1 before the stop begins.
      trajectory: the tracked one, None before the stop begins.
    """

    def __init__(
        self,
        route: Route,
        parameters: TruckParameters | None = None,
        config: SafeStopConfig | None = None,
    ) -> None:
        """Makes the stop for a route; the default parameters are those of the shipped truck."""
        self.config = config or SafeStopConfig()
        self.preview = RoadPreview(route)
        parameters = parameters or TruckParameters.load()
        self.lateral = LateralController(parameters, self.config.lateral)
        self._overhang = parameters.lead.front_overhang
        self.reset()

    def reset(self) -> None:
        """Prepares for the next stop."""
        self.lateral.reset()
        self.phase = StopPhase.BRAKING
        self.lane = -1
        self.trajectory: Trajectory | None = None
        self._last = VehicleCommand()
        self._residual: Quintic | None = None
        self._middle = self._kept = 0.0
        self._limits = self.config.limits
        self._command = VehicleCommand()
        self._demand = 0.0
        self._planned_at = self._commanded_at = -math.inf
        self._still_since = math.inf

    def prepare(self, ego: EgoState) -> None:
        """Computes the controller's gains for the truck's mass, so that a stop begins at once.

        Raises:
          InputError: the state is not finite.
        """
        self.reset()
        self.command(ego)
        self.reset()

    def command(self, ego: EgoState, last: VehicleCommand | None = None) -> VehicleCommand:
        """The command now; call it at least every 20 ms.

        Args:
          ego: the truck.
          last: command before the stop. Its selector, driver's brake pedal and parking brake stay,
            and the stop is at least as strong as its XBR demand, up to `deceleration_max`.

        Raises:
          InputError: a value of the state that the stop uses is not finite.
        """
        check_finite(ego, _USED)
        if self.trajectory is None:
            self._begin(ego, last)
        elif ego.time - self._commanded_at < CONTROL_PERIOD - SLACK:
            return self._command
        if ego.time - self._planned_at >= CYCLE_PERIOD - SLACK:
            self._plan(ego)
        assert self.trajectory is not None
        self._stand(ego)
        self._brake(ego, self.trajectory)
        self._commanded_at = ego.time
        self._command = self._assemble(ego, self.lateral.steer(ego, self.trajectory))
        return self._command

    def _begin(self, ego: EgoState, last: VehicleCommand | None) -> None:
        """Chooses the lane and the deceleration."""
        self._last = last or VehicleCommand()
        if self._last.xbr_mode is not XbrMode.OFF:
            self._limits = self._at_least(-self._last.xbr_demand)
        self._kept = ego.offset
        sideways = self._slope(ego) * max(ego.speed, 0.0)
        aimed_at = ego.offset + self.config.look_ahead * sideways
        self.lane = self.preview.nearest_lane(ego.station, aimed_at)
        path = self._follow(ego, self.lane)
        error = ego.offset - float(path.offset_at(ego.station))
        if abs(error) > self.config.off_center:
            self._residual = quintic_back(
                ego.station,
                error,
                self._slope(ego),
                self._bend(ego),
                max(ego.speed, 1.0),
                self.config.change,
            )

    def _slope(self, ego: EgoState) -> float:
        """Direction of motion of the steer axle against the road, as a slope of its offset."""
        if ego.speed < 1.0:
            return 0.0
        heading = float(self.preview.route.evaluate(ego.station, ego.offset).heading)
        course = ego.yaw + math.atan2(ego.lateral_speed, ego.speed) - heading
        return math.tan(min(max(wrap_angle(course), -0.3), 0.3))

    def _bend(self, ego: EgoState) -> float:
        """Curvature of the motion against the road's [1/m]."""
        if ego.speed < 5.0:
            return 0.0
        road = float(np.interp(ego.station, self.preview.station, self.preview.curvature))
        return min(max(ego.yaw_rate / ego.speed - road, -0.003), 0.003)

    def _follow(self, ego: EgoState, lane: int) -> LanePath:
        """The path of a lane around the truck."""
        path = self.preview.follow(max(lane, 0), ego.station, self.config.preview, BEHIND)
        if not np.isfinite(path.offset).all():
            # On a road without lanes the truck stops parallel to the reference line.
            path = dataclasses.replace(path, offset=np.full_like(path.offset, self._kept))
        self._middle = float(path.offset_at(ego.station))
        return path

    def _plan(self, ego: EgoState) -> None:
        """A trajectory along the lane, from the last plan's speed or the truck's."""
        config = self.config
        # The middle identifies the lane: lanes that begin or end on the right shift the indices.
        self.lane = self.preview.nearest_lane(ego.station, self._middle)
        path = self._follow(ego, self.lane)
        start = self._start(ego)
        room = path.end - config.stop_gap - self._overhang - ego.station
        limits = self._sooner(start, room)
        steps = round(config.horizon / config.step)
        rolled = roll_to_stop(start, limits, steps, config.step)
        self.trajectory = on_road(
            *(self.preview, path, self._residual, ego.time, *rolled, config.step),
            *(PlanMode.EMERGENCY, "stop in lane", self.lane),
        )
        self._planned_at = ego.time

    def _start(self, ego: EgoState) -> SpeedState:
        """State of the last plan now, held near the truck's."""
        last, reach = self.trajectory, self.config.resync_speed
        if last is None or not last.time[0] <= ego.time <= last.time[-1]:
            begin = min(max(ego.acceleration, -self._limits.deceleration), 0.5)
            return SpeedState(ego.station, ego.speed, begin)
        speed = float(np.interp(ego.time, last.time, last.speed))
        acceleration = float(np.interp(ego.time, last.time, last.acceleration))
        speed = min(max(speed, ego.speed - reach), ego.speed + reach)
        return SpeedState(ego.station, max(speed, 0.0), acceleration)

    def _sooner(self, start: SpeedState, room: float) -> StopLimits:
        """Limits that stop the truck within a distance [m], as far as allowed."""
        if stop_distance(start.speed, start.acceleration, self._limits) <= room:
            return self._limits
        # The brakes need time to build up, hence more than v^2 / 2 s.
        return self._at_least(1.15 * start.speed**2 / (2.0 * max(room, 0.1)))

    def _at_least(self, deceleration: float) -> StopLimits:
        """The limits with a greater deceleration, as far as allowed."""
        most = self.config.deceleration_max
        wanted = min(max(deceleration, self._limits.deceleration), most)
        jerk = self._limits.jerk * wanted / self._limits.deceleration
        return dataclasses.replace(self._limits, deceleration=wanted, jerk=min(jerk, 10.0))

    def _stand(self, ego: EgoState) -> None:
        """Advances the phase from braking to standing to parked; a sliding truck brakes again."""
        config = self.config
        if abs(ego.speed) >= config.standing_speed:
            self._still_since = math.inf
            if self.phase is StopPhase.STANDING:
                self.phase = StopPhase.BRAKING
            return
        self._still_since = min(self._still_since, ego.time)
        if self.phase is StopPhase.BRAKING:
            self.phase = StopPhase.STANDING
        still = ego.time - self._still_since
        if self.phase is StopPhase.STANDING and still >= config.standing_time - SLACK:
            self.phase = StopPhase.PARKED

    def _brake(self, ego: EgoState, trajectory: Trajectory) -> None:
        """Sets the demanded deceleration: the plan's, earlier, plus the correction of speed."""
        config = self.config
        if self.phase is StopPhase.BRAKING:
            soon = ego.time + config.lead_time
            planned = float(np.interp(soon, trajectory.time, trajectory.acceleration))
            speed = float(np.interp(ego.time, trajectory.time, trajectory.speed))
            wanted = -planned + config.speed_gain * (abs(ego.speed) - speed)
            # Near standstill brake control needs a demand to hold.
            if ego.speed < 1.0:
                wanted = max(wanted, self._limits.deceleration_end)
        else:
            wanted = config.hold_demand
        reach = 2.0 * self._limits.jerk * CONTROL_PERIOD
        wanted = min(max(wanted, self._demand - reach), self._demand + reach)
        self._demand = min(max(wanted, 0.0), config.deceleration_max)

    def _assemble(self, ego: EgoState, wheel: float) -> VehicleCommand:
        """The whole command, with selector, driver's pedal and parking brake."""
        config, last = self.config, self._last
        slow = abs(ego.speed) < config.neutral_speed
        braking = VehicleCommand(
            xbr_demand=-self._demand,
            xbr_mode=XbrMode.MAXIMUM,
            steering_wheel_angle=wheel,
            parking_brake=last.parking_brake,
            transmission_mode=TransmissionMode.NEUTRAL if slow else last.transmission_mode,
            brake_pedal=last.brake_pedal,
            # All axles brake: endurance brakes would use up the drive axles' grip in a bend.
            xbr_ebi_mode=XbrEbiMode.FRICTION_ONLY,
        )
        if self.phase is not StopPhase.PARKED:
            return braking
        parked = dataclasses.replace(braking, parking_brake=1.0, brake_pedal=0.0)
        if ego.time - self._still_since < config.standing_time + config.parking_time:
            return parked
        return dataclasses.replace(parked, xbr_demand=0.0, xbr_mode=XbrMode.OFF)


def roll_to_stop(
    start: SpeedState, limits: StopLimits, steps: int, step: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Station, speed and acceleration of a stop at steps + 1 times from now on.

    Args:
      start: initial state; a speed below zero counts as standstill.
      limits: of the stop.
      steps: number of steps.
      step: [s].
    """
    station, speed, acceleration = (np.zeros(steps + 1) for _ in range(3))
    s, v, a = start.station, max(start.speed, 0.0), start.acceleration
    reach = limits.jerk * step
    for k in range(steps + 1):
        if k:
            # If the truck stops within the step, it moves only until then.
            stays = v + a * step > 0.0
            s += v * step + 0.5 * a * step**2 if stays else 0.5 * v * step
            v = max(v + a * step, 0.0)
            a = min(max(limits.wanted(v), a - reach), a + reach)
        if v <= 0.0:
            a = 0.0
        station[k], speed[k], acceleration[k] = s, v, a
    return station, speed, acceleration


def stop_distance(speed: float, acceleration: float, limits: StopLimits) -> float:
    """Distance to standstill [m] from a speed [m/s] and acceleration [m/s2]."""
    step = 0.05
    way, v, a = 0.0, max(speed, 0.0), acceleration
    reach = limits.jerk * step
    while v > 0.0:
        v_next = max(v + a * step, 0.0)
        way += 0.5 * (v + v_next) * step
        v = v_next
        a = min(max(limits.wanted(v), a - reach), a + reach)
    return way
