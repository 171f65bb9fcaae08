"""Advanced emergency braking (AEBS): collision warning, partial braking, emergency braking.

Apart from the planner: it sees the tracks of the sensors and the truck's state, and adds a brake
demand (XBR) of its own. Each stage begins when the deceleration that avoids a collision reaches a
share of what the brakes can do: the emergency braking when this is so now, the warning and the
partial braking when it will be so in a time that lets a driver act, at the truck's present
acceleration. The stages, a warning 1.4 s before the braking and a demand of at least 4 m/s2 are
those of UN Regulation No. 131; the shares and times here are our choices.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Callable
from dataclasses import dataclass, field, fields

from controllers.emergency_braking.threat import (
    Target,
    WayConfig,
    find_targets,
    moved,
    required_deceleration,
    time_to_collision,
)
from iits_mj.core.checks import in_range, require_positive
from iits_mj.core.errors import InputError
from iits_mj.core.messages import EgoState, Scene, VehicleCommand, XbrMode
from iits_mj.core.units import GRAVITY
from iits_mj.core.vehicles import VehicleFrame
from iits_mj.parameters import TruckParameters
from iits_mj.road.elements import DEFAULT_FRICTION

# Braking of at least this is emergency braking, UN R131, 2.4 [m/s2].
EMERGENCY_DEMAND = 4.0
# Below this speed a yaw rate has no meaning as a curvature [m/s].
_TURNING = 2.0


class EmergencyState(enum.Enum):
    """Stage of the emergency braking; OFF below the least speed."""

    OFF = "off"
    STANDBY = "standby"
    WARNING = "warning"
    PARTIAL = "partial braking"
    BRAKING = "emergency braking"
    OVERRIDDEN = "overridden"


@dataclass(frozen=True, slots=True)
class EmergencyBrakingConfig:
    """Settings of the emergency braking.

    Attributes:
      share: of the possible deceleration, from which a needed one starts emergency braking.
      warning_time: from warning to emergency braking at least [s]; UN R131 (01): 1.4 s.
      partial_time: from partial to emergency braking [s].
      partial_demand: deceleration of the partial braking [m/s2], less than emergency braking; on a
        slippery road half of what would start emergency braking.
      release: share of `share` below which a stage ends, and above which a partial braking is
        followed by an emergency braking after `partial_time`.
      excess: demanded over needed deceleration; the demand is at least 4 m/s2.
      demand_max: greatest demand [m/s2].
      margin: distance to leave [m].
      lag: of the brakes: the delay that gives the same distance as their build-up [s]; 0.2 to
        0.35 s on the truck here.
      adhesion: share of the friction that the brakes use; 0.94 measured with ABS.
      speed_min: least speed at which a stage begins [m/s]; UN R131 (02) asks for 10 km/h or less.
      least: shortest duration of a warning [s].
      lost: time for which braking goes on without a target [s].
      hold: time for which the brakes hold after a standstill [s].
      human: a driver drives: a kick-down, or a fast turn of the steering wheel, overrides.
      kick_down: accelerator of a kick-down, 0 to 1; steering_rate: of the override [rad/s].
      way: which objects count.
    """

    share: float = 0.8
    warning_time: float = 1.6
    partial_time: float = 0.9
    partial_demand: float = 2.5
    release: float = 0.7
    excess: float = 1.25
    demand_max: float = 9.0
    margin: float = 1.0
    lag: float = 0.35
    adhesion: float = 0.92
    speed_min: float = 5.0 / 3.6
    least: float = 0.5
    lost: float = 0.5
    hold: float = 1.5
    human: bool = False
    kick_down: float = 0.95
    steering_rate: float = 4.0
    way: WayConfig = field(default_factory=WayConfig)

    def __post_init__(self) -> None:
        names = [f.name for f in fields(self) if f.name not in ("human", "way", "margin")]
        require_positive(self, *names)
        require_positive(self, "margin", zero=True)
        name = "EmergencyBrakingConfig: "
        for share in ("share", "release", "adhesion", "kick_down"):
            in_range(name + share, getattr(self, share), 0.0, 1.0)
        in_range(name + "demand_max", self.demand_max, EMERGENCY_DEMAND, 10.0, "m/s2")
        in_range(name + "partial_demand", self.partial_demand, 0.0, EMERGENCY_DEMAND, "m/s2")
        in_range(name + "warning_time", self.warning_time, self.partial_time, 5.0, "s")
        if not isinstance(self.human, bool):
            raise InputError(f"{name}human = {self.human!r}: allowed is True or False")


@dataclass(frozen=True, slots=True)
class EmergencyReport:
    """What the emergency braking reports at an instant.

    Attributes:
      state: the stage; target: name of the object it is for, "" without one.
      time_to_collision: with it [s], inf without one.
      required: deceleration that avoids it [m/s2]; demand: of the function, zero or negative.
    """

    state: EmergencyState = EmergencyState.OFF
    target: str = ""
    time_to_collision: float = math.inf
    required: float = 0.0
    demand: float = 0.0


class EmergencyBraking:
    """Watches the way ahead; call `observe` with every scene and `demand` every 20 ms.

    Args:
      parameters: of the truck.
      friction: returns the coefficient of friction as far as it is known, by the truck's state;
        default: a dry road.
      config: settings.

    Attributes:
      report: the last one.
    """

    def __init__(
        self,
        parameters: TruckParameters,
        friction: Callable[[EgoState], float] | None = None,
        config: EmergencyBrakingConfig | None = None,
    ) -> None:
        self.config = config or EmergencyBrakingConfig()
        self._friction = friction or (lambda _: DEFAULT_FRICTION)
        pressure = parameters.air_brake.pressure_max
        # Force of all wheel brakes at full pressure [N].
        self._force = sum(
            2.0
            * axle.brake.torque_per_pressure
            * pressure
            / parameters.tires[axle.tire].rolling_radius
            for axle in parameters.axles
        )
        self.reset()

    def reset(self) -> None:
        """Forgets everything."""
        self._scene: Scene | None = None
        self._vehicles = VehicleFrame.empty()
        self.report = EmergencyReport()
        self._since = -math.inf
        self._threat_at = -math.inf
        self._slope = self._curvature = 0.0
        self._wheel: float | None = None
        self._pedal = 0.0

    def observe(self, scene: Scene) -> None:
        """Takes over a scene, every 100 ms."""
        self._scene, self._vehicles = scene, VehicleFrame.of(scene.vehicles)

    def possible(self, ego: EgoState) -> float:
        """Returns the deceleration that the brakes can give now [m/s2], at least 0.5."""
        grip = self.config.adhesion * self._friction(ego) * GRAVITY
        force = min(grip, self._force / max(ego.mass, 1.0))
        return max(force + GRAVITY * self._slope, 0.5)

    def demand(self, ego: EgoState, wanted: VehicleCommand) -> float:
        """Returns the demanded acceleration [m/s2], zero or negative; never weaker than XBR's.

        Args:
          ego: the truck now.
          wanted: the driver's or the planner's command.
        """
        overridden = self._overrides(wanted)
        self._follow(ego)
        state, target, needed = self._stage(ego)
        if overridden and state not in (EmergencyState.OFF, EmergencyState.STANDBY):
            state = EmergencyState.OVERRIDDEN
        if state is not self.report.state:
            self._since = ego.time
        strength = self._strength(ego, state, needed)
        other = wanted.xbr_demand if wanted.xbr_mode is not XbrMode.OFF else 0.0
        self.report = EmergencyReport(
            state,
            "" if target is None else target.id,
            math.inf if target is None else time_to_collision(target, ego.speed),
            needed,
            -strength,
        )
        return min(-strength, other) if strength > 0.0 else 0.0

    def _follow(self, ego: EgoState) -> None:
        """Filters slope of the road and curvature of the way."""
        if self.report.demand == 0.0 and abs(ego.acceleration) < 1.0:
            # Braking pitches the cab: the slope is the one from before.
            self._slope += 0.02 * (-math.sin(ego.pitch) - self._slope)
        turning = ego.yaw_rate / ego.speed if ego.speed > _TURNING else 0.0
        self._curvature += 0.1 * (turning - self._curvature)

    def _stage(self, ego: EgoState) -> tuple[EmergencyState, Target | None, float]:
        """The stage, its target and the deceleration that avoids it [m/s2]."""
        now, config, was = EmergencyState, self.config, self.report.state
        if self._scene is None:
            return now.OFF, None, 0.0
        lasted = ego.time - self._since
        if was is now.BRAKING and ego.speed < 0.3:
            return now.BRAKING if self._held(ego) else now.OFF, None, 0.0
        age = max(ego.time - self._scene.time, 0.0)
        found = find_targets(
            ego, self._vehicles, age, self._scene.footprint, self._curvature, config.way
        )
        limit = config.share * self.possible(ego)
        rows = [(self._needed(ego, t, 0.0), t) for t in found]
        needed, target = max(rows, key=lambda row: row[0], default=(0.0, None))
        active = was in (now.WARNING, now.PARTIAL, now.BRAKING, now.OVERRIDDEN)
        if ego.speed < config.speed_min and not active:
            return now.OFF, target, needed
        if was is now.BRAKING:
            # To the end: a truck that stopped braking short of its target could still reach it.
            if needed > 0.0:
                self._threat_at = ego.time
            if ego.time - self._threat_at < config.lost:
                return now.BRAKING, target, needed
        partly = was is now.PARTIAL and lasted >= config.partial_time - 1e-6
        if needed >= limit * (config.release if partly else 1.0):
            self._threat_at = ego.time
            return now.BRAKING, target, needed
        for state, ahead in (
            (now.PARTIAL, config.partial_time),
            (now.WARNING, config.warning_time),
        ):
            going = was is state or (was is now.PARTIAL and state is now.WARNING)
            bound = limit * (config.release if going else 1.0)
            soon, at = max(
                ((self._needed(ego, t, ahead), t) for t in found),
                key=lambda row: row[0],
                default=(0.0, None),
            )
            if soon >= bound:
                return state, at, needed
        if was in (now.WARNING, now.PARTIAL) and lasted < config.least:
            return was, target, needed
        return now.STANDBY, target, needed

    def _needed(self, ego: EgoState, target: Target, ahead: float) -> float:
        """Deceleration that avoids a target if the brakes are applied `ahead` [s] later [m/s2]."""
        # Braking of the driver counts, the function's own does not.
        slowing = min(ego.acceleration, 0.0) if self.report.demand == 0.0 or not ahead else 0.0
        wait = ahead + self.config.lag
        _, speed = moved(ego.speed, slowing, wait)
        return required_deceleration(
            target.after(wait, ego.speed, slowing), speed, self.config.margin
        )

    def _held(self, ego: EgoState) -> bool:
        if ego.speed > 0.1:
            self._threat_at = ego.time
        return ego.time - self._threat_at < self.config.hold

    def _strength(self, ego: EgoState, state: EmergencyState, needed: float) -> float:
        """Demanded deceleration of a stage [m/s2]."""
        if state is EmergencyState.PARTIAL:
            return min(self.config.partial_demand, 0.5 * self.config.share * self.possible(ego))
        if state is not EmergencyState.BRAKING:
            return 0.0
        wanted = self.config.excess * needed
        return min(max(wanted, EMERGENCY_DEMAND), self.config.demand_max)

    def _overrides(self, wanted: VehicleCommand) -> bool:
        """Whether a human driver acts so as to take over, or has and the threat lasts."""
        if not self.config.human:
            return False
        turned = 0.0 if self._wheel is None else abs(wanted.steering_wheel_angle - self._wheel)
        kicked = wanted.accelerator_pedal >= self.config.kick_down > self._pedal
        self._wheel, self._pedal = wanted.steering_wheel_angle, wanted.accelerator_pedal
        still = self.report.state is EmergencyState.OVERRIDDEN
        return still or kicked or turned / 0.02 > self.config.steering_rate
