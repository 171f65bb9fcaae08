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
from dataclasses import dataclass

from controllers.emergency_braking.threat import (
    Target,
    find_targets,
    moved,
    required_deceleration,
    time_to_collision,
)
from iits_mj.core.errors import InputError
from iits_mj.core.messages import EgoState, Scene, VehicleCommand, XbrMode
from iits_mj.core.timing import CONTROL_PERIOD
from iits_mj.core.units import GRAVITY
from iits_mj.core.vehicles import VehicleFrame
from iits_mj.parameters import TruckParameters
from iits_mj.road.elements import DEFAULT_FRICTION

# Braking of at least this is emergency braking, UN R131, 2.4 [m/s2].
EMERGENCY_DEMAND = 4.0
# Share of the possible deceleration from which a needed one starts emergency braking; share of it
# below which a stage ends, and above which partial braking becomes emergency braking in time.
_SHARE, _RELEASE = 0.8, 0.7
# Times from the warning and from the partial braking to the emergency braking [s]; UN R131 (01
# series) asks for 1.4 s and 0.8 s. Deceleration of the partial braking [m/s2], on a slippery road
# half of what would start emergency braking.
_WARNING_TIME, _PARTIAL_TIME, _PARTIAL_DEMAND = 1.6, 0.9, 2.5
# Demanded over needed deceleration, and greatest demand [m/s2].
_EXCESS, _DEMAND_MAX = 1.25, 9.0
# Distance to leave [m].
_MARGIN = 1.0
# Delay that gives the same distance as the brakes' build-up, 0.2 to 0.35 s on the truck [s]; share
# of the friction that they use, 0.94 measured with ABS.
_LAG, _ADHESION = 0.35, 0.92
# Least speed at which a stage begins [m/s]; UN R131 (02 series) asks for 10 km/h or less.
_SPEED_MIN = 5.0 / 3.6
# Shortest warning; braking without a target; holding after a standstill [s].
_LEAST, _LOST, _HOLD = 0.5, 0.5, 1.5
# A driver's kick-down, 0 to 1, and turn of the steering wheel that override [rad/s].
_KICK_DOWN, _STEERING_RATE = 0.95, 4.0
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
      human: a driver drives, who overrides it by a kick-down or a fast turn of the wheel.

    Attributes:
      report: the last one.
    """

    def __init__(
        self,
        parameters: TruckParameters,
        friction: Callable[[EgoState], float] | None = None,
        *,
        human: bool = False,
    ) -> None:
        if not isinstance(human, bool):
            raise InputError(f"human = {human!r}: allowed is True or False")
        self.human = human
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
        grip = _ADHESION * self._friction(ego) * GRAVITY
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
            0.0 - strength,  # without a negative zero
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
        now, was = EmergencyState, self.report.state
        if self._scene is None:
            return now.OFF, None, 0.0
        lasted = ego.time - self._since
        if was is now.BRAKING and ego.speed < 0.3:
            return now.BRAKING if self._held(ego) else now.OFF, None, 0.0
        age = max(ego.time - self._scene.time, 0.0)
        found = find_targets(ego, self._vehicles, age, self._scene.footprint, self._curvature)
        limit = _SHARE * self.possible(ego)
        needed, target = self._worst(ego, found, 0.0)
        active = was in (now.WARNING, now.PARTIAL, now.BRAKING, now.OVERRIDDEN)
        if ego.speed < _SPEED_MIN and not active:
            return now.OFF, target, needed
        if was is now.BRAKING:
            # To the end: a truck that stopped braking short of its target could still reach it.
            if needed > 0.0:
                self._threat_at = ego.time
            if ego.time - self._threat_at < _LOST:
                return now.BRAKING, target, needed
        partly = was is now.PARTIAL and lasted >= _PARTIAL_TIME - 1e-6
        if needed >= limit * (_RELEASE if partly else 1.0):
            self._threat_at = ego.time
            return now.BRAKING, target, needed
        for state, ahead in ((now.PARTIAL, _PARTIAL_TIME), (now.WARNING, _WARNING_TIME)):
            going = was is state or (was is now.PARTIAL and state is now.WARNING)
            bound = limit * (_RELEASE if going else 1.0)
            soon, at = self._worst(ego, found, ahead)
            if soon >= bound:
                return state, at, needed
        if was in (now.WARNING, now.PARTIAL) and lasted < _LEAST:
            return was, target, needed
        return now.STANDBY, target, needed

    def _worst(
        self, ego: EgoState, found: list[Target], ahead: float
    ) -> tuple[float, Target | None]:
        """Deceleration needed if the brakes are applied `ahead` [s] later, and its target."""
        # Braking of the driver counts, the function's own does not.
        slowing = min(ego.acceleration, 0.0) if self.report.demand == 0.0 or not ahead else 0.0
        wait = ahead + _LAG
        _, speed = moved(ego.speed, slowing, wait)
        needs = [
            required_deceleration(t.after(wait, ego.speed, slowing), speed, _MARGIN) for t in found
        ]
        most = max(needs, default=0.0)
        return most, found[needs.index(most)] if needs else None

    def _held(self, ego: EgoState) -> bool:
        if ego.speed > 0.1:
            self._threat_at = ego.time
        return ego.time - self._threat_at < _HOLD

    def _strength(self, ego: EgoState, state: EmergencyState, needed: float) -> float:
        """Demanded deceleration of a stage [m/s2]."""
        if state is EmergencyState.PARTIAL:
            return min(_PARTIAL_DEMAND, 0.5 * _SHARE * self.possible(ego))
        if state is not EmergencyState.BRAKING:
            return 0.0
        return min(max(_EXCESS * needed, EMERGENCY_DEMAND), _DEMAND_MAX)

    def _overrides(self, wanted: VehicleCommand) -> bool:
        """Whether a human driver acts so as to take over, or has and the threat lasts."""
        if not self.human:
            return False
        turned = 0.0 if self._wheel is None else abs(wanted.steering_wheel_angle - self._wheel)
        kicked = wanted.accelerator_pedal >= _KICK_DOWN > self._pedal
        self._wheel, self._pedal = wanted.steering_wheel_angle, wanted.accelerator_pedal
        still = self.report.state is EmergencyState.OVERRIDDEN
        return still or kicked or turned > _STEERING_RATE * CONTROL_PERIOD
