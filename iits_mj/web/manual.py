"""Driving by hand: a driver that a person relieves, and that takes over again when released."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from controllers.stack import Stack
from iits_mj.core.messages import (
    Decision,
    EgoState,
    Scene,
    Trajectory,
    TransmissionMode,
    VehicleCommand,
    XbrMode,
)
from iits_mj.core.timing import CONTROL_PERIOD
from iits_mj.parameters import TruckParameters
from iits_mj.road import Route
from iits_mj.simulation.driver import nothing_planned

# Lateral acceleration that full steering asks for [m/s2], well below roll-over of a laden truck.
_TURN = 1.8
# Deceleration of a full brake [m/s2].
_BRAKE = 6.0
_PEDAL_RATE, _BRAKE_RATE = 1.2, 3.0  # [1/s]
_WHEEL_RATE = 5.0  # of the steering wheel [rad/s]
_STANDING = 0.3  # [m/s]: slower than this, the direction of travel may change


@dataclass(frozen=True, slots=True)
class Hands:
    """What a person asks for, from keys or a gamepad.

    Attributes:
      pedal, brake, retarder: 0 to 1; steer: -1 (right) to 1 (left); reverse: direction of travel.
    """

    pedal: float = 0.0
    brake: float = 0.0
    steer: float = 0.0
    retarder: float = 0.0
    reverse: bool = False

    @classmethod
    def of(cls, content: Mapping[str, Any]) -> Hands:
        """Returns the inputs of a page's message; a value that is none counts as 0."""
        return cls(
            _share(content.get("pedal"), 0.0),
            _share(content.get("brake"), 0.0),
            _share(content.get("steer"), -1.0),
            _share(content.get("retarder"), 0.0),
            content.get("reverse") is True,
        )


class Wheel:
    """Turns inputs into commands: ramps, and a steering wheel that turns less at speed.

    Args:
      parameters: of the truck.
    """

    def __init__(self, parameters: TruckParameters) -> None:
        steering = parameters.steering
        self._ratio, self._angle_max = steering.ratio, steering.angle_max
        self._rate = min(_WHEEL_RATE, steering.rate_max)
        unsteered = [axle.position for axle in parameters.lead.axles if not axle.steered]
        self._wheelbase = sum(unsteered) / len(unsteered)
        self.reset()

    def reset(self, angle: float = 0.0) -> None:
        """Releases the pedals and holds the steering wheel at an angle [rad]."""
        self._angle, self._pedal, self._brake = angle, 0.0, 0.0

    def command(self, hands: Hands, ego: EgoState) -> VehicleCommand:
        """Returns the command for the next 20 ms."""
        limit = self.angle_limit(ego.speed)
        self._angle = _toward(self._angle, hands.steer * limit, self._rate)
        self._pedal = _toward(self._pedal, hands.pedal, _PEDAL_RATE)
        self._brake = _toward(self._brake, hands.brake, _BRAKE_RATE)
        pedal = 0.0 if self._brake > 0.0 else self._pedal
        mode = TransmissionMode.REVERSE if hands.reverse else TransmissionMode.DRIVE
        return VehicleCommand(
            accelerator_pedal=pedal,
            xbr_demand=-_BRAKE * self._brake,
            xbr_mode=XbrMode.MAXIMUM if self._brake > 0.0 else XbrMode.OFF,
            steering_wheel_angle=self._angle,
            retarder=hands.retarder,
            transmission_mode=mode,
        )

    def angle_limit(self, speed: float) -> float:
        """Returns the largest angle of the steering wheel at a speed [m/s], in radians."""
        bend = _TURN / max(speed * speed, 1.0)
        # Neutral steering plus what understeer adds at speed.
        wheels = math.atan(bend * self._wheelbase) + 0.01 * _TURN
        return min(self._ratio * wheels, self._angle_max)


class ManualDriver:
    """A `Driver`: the automatic one, or a person while one has the wheel.

    A change happens with the next plan, so at a multiple of 100 ms. The automatic driver begins
    again from the truck's state when it is released.

    Args:
      automatic: the driving stack.
      route: the truck's road; parameters: of the truck.
      hands: returns a person's inputs at a time [s].

    Attributes:
      automatic: that drives now; driving: whether a person has the wheel.
      last_decision: of the automatic driver; to keep the lane while a person drives.
    """

    def __init__(
        self,
        automatic: Stack,
        route: Route,
        parameters: TruckParameters,
        hands: Callable[[float], Hands],
    ) -> None:
        self.automatic = automatic
        self._next: Stack | None = None
        self._route = route
        self._wheel = Wheel(parameters)
        self._hands = hands
        self._changes = self._refused = 0
        self._lane: int | None = None
        self.last_decision = Decision.KEEP
        self._wanted = self.driving = False

    def reset(self) -> None:
        """Prepares for a new drive by the automatic driver."""
        self.automatic.reset()
        self._next = None
        self._wheel.reset()
        self._changes = self._refused = 0
        self._lane = None
        self.last_decision = Decision.KEEP
        self._wanted = self.driving = False

    def take(self) -> None:
        """Gives a person the wheel, from the next plan on."""
        self._wanted = True

    def release(self) -> None:
        """Gives the wheel back to the automatic driver, from the next plan on."""
        self._wanted = False

    def replace(self, automatic: Stack) -> None:
        """Lets another automatic driver drive from the next plan on, keeping the counts."""
        self._next = automatic

    @property
    def lane_changes(self) -> int:
        """Lane changes since `reset`, by person and automatic driver."""
        return self._changes + self.automatic.lane_changes

    @property
    def refused(self) -> int:
        """Decisions to change lanes that the planner refused since `reset`."""
        return self._refused + self.automatic.refused

    def plan(self, scene: Scene) -> Trajectory:
        """Returns the automatic driver's plan; an unknown one while a person drives."""
        if self._next is not None:
            self._changes, self._refused = self.lane_changes, self.refused
            self.automatic, self._next = self._next, None
        if self._wanted != self.driving:
            self.driving = self._wanted
            self._lane = None
            if self.driving:
                self._wheel.reset(scene.ego.steering_wheel_angle)
            else:
                self._changes, self._refused = self.lane_changes, self.refused
                self.automatic.reset()
        if not self.driving:
            trajectory = self.automatic.plan(scene)
            self.last_decision = self.automatic.last_decision
            return trajectory
        self.last_decision = Decision.KEEP
        lane = int(self._route.lane_at(scene.ego.station, scene.ego.offset))
        if lane >= 0:
            self._changes += self._lane not in (None, lane)
            self._lane = lane
        return dataclasses.replace(nothing_planned(scene.time), reason="driven by hand")

    def control(self, ego: EgoState) -> VehicleCommand:
        """Returns the command for the next 20 ms."""
        if not self.driving:
            return self.automatic.control(ego)
        return self._wheel.command(self._hands(round(ego.time, 6)), ego)

    def reference_speed(self, station: float) -> float:
        """Returns the automatic driver's desired speed; not a number while a person drives."""
        return math.nan if self.driving else self.automatic.reference_speed(station)


def may_reverse(ego: EgoState) -> bool:
    """Returns whether the truck stands, so that its direction of travel may change."""
    return abs(ego.speed) < _STANDING


def _toward(value: float, target: float, rate: float) -> float:
    step = rate * CONTROL_PERIOD
    return value + max(-step, min(step, target - value))


def _share(value: Any, low: float) -> float:
    number = isinstance(value, (int, float)) and not isinstance(value, bool)
    return max(low, min(1.0, float(value))) if number and math.isfinite(value) else 0.0
