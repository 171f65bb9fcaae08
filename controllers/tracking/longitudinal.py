"""Speed tracking: accelerator pedal, engine brake, retarder and XBR from the planned speed.

Feed-forward of acceleration, grade, rolling and air through the inverse powertrain, plus a slow
integral. Accelerator, coasting, endurance brakes and friction alternate with hysteresis and dwell
times, so that they do not chatter. Where the plan needs about the engine's drag, the truck coasts
in gear and ignores small errors of speed: correcting them by accelerator and engine brake in turn
costs fuel and gear changes. For the same reason the pedal moves too slowly for a kick-down, unless
the truck has to gain much speed. Engine brake, then retarder, hold the speed on a descent, each by
its own TSC1; an XBR demand that may use both adds the missing force. At standstill the brakes hold.
"""

from __future__ import annotations

import enum
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass

from controllers.tracking.driveline_inverse import Actuation, DrivelineInverse, xbr_deceleration
from iits_mj.core.messages import (
    EgoState,
    Trajectory,
    TransmissionMode,
    VehicleCommand,
    XbrEbiMode,
    XbrMode,
    positional,
)
from iits_mj.core.timing import CONTROL_PERIOD
from iits_mj.core.units import GRAVITY
from iits_mj.parameters import TruckParameters

_SURELY = 0.99  # share of the gearbox's thresholds that does not reach them


class Phase(enum.Enum):
    """Actuator of the speed: engine, its drag, endurance brakes, friction too, or standstill."""

    DRIVE = "drive"
    COAST = "coast"
    OVERRUN = "overrun"
    BRAKE = "brake"
    HOLD = "hold"
    LAUNCH = "launch"


# Names of their own: looking up a member in its class takes as long as a law of this module.
_DRIVE, _COAST, _OVERRUN, _BRAKE, _HOLD, _LAUNCH = Phase
_XBR_OFF, _XBR_MAXIMUM = XbrMode.OFF, XbrMode.MAXIMUM
_FRICTION_ONLY, _INTEGRATION = XbrEbiMode.FRICTION_ONLY, XbrEbiMode.INTEGRATION
_FORWARD = TransmissionMode.DRIVE
_vehicle_command = positional(VehicleCommand)


@dataclass(frozen=True)
class LongitudinalConfig:
    """Gains and thresholds of the speed controller.

    Attributes:
      speed_gain: [1/s]; integral_gain: [1/s2]; integral_max: [m/s2].
      lead_time: by which the planned acceleration is applied earlier, for lags [s].
      overrun_enter: torque below the engine's drag that ends driving [N m].
      overrun_leave: torque above the engine's drag that begins driving again [N m].
      retard_enter: deceleration beyond the engine's drag that ends coasting [m/s2]. A request to
        the engine brake, however small, makes the gearbox shift down.
      coast_error: error of speed that coasting ignores [m/s]; less below `coast_speed`.
      coast_speed: [m/s].
      brake_enter: deceleration beyond engine brake and retarder that applies friction [m/s2].
      brake_leave: the same, below which friction is released [m/s2].
      build_up: time from the demand for friction to its force [s].
      dwell: least time in a phase [s].
      urgent: demanded deceleration that ends the dwell time and brakes at once; brake control alone
        then commands engine brake and retarder, and releases them while ABS works [m/s2].
      calm: the same, below which the brakes may release again [m/s2].
      pedal_rise, pedal_fall: rates of the pedal [1/s].
      kick_down_gain: gain of speed in the plan that justifies a kick-down [m/s].
      endurance_rate: of the requests to engine brake and retarder [1/s].
      demand_rate: of a rising XBR demand outside emergencies [m/s3].
      demand_max: of XBR [m/s2].
      stop_speed: speed below which a plan to stop applies the hold [m/s].
      go_speed: planned speed that ends the hold [m/s].
      level: grade below which a start needs no hold.
      roll_back: backward speed that ends a start and holds the truck again [m/s].
      hold_demand: XBR demand at standstill [m/s2].
    """

    speed_gain: float = 0.5
    integral_gain: float = 0.06
    integral_max: float = 0.35
    lead_time: float = 0.3
    overrun_enter: float = 150.0
    overrun_leave: float = 120.0
    retard_enter: float = 0.06
    coast_error: float = 0.2
    coast_speed: float = 10.0
    brake_enter: float = 0.15
    brake_leave: float = 0.02
    build_up: float = 0.6
    dwell: float = 0.6
    urgent: float = 1.0
    calm: float = 0.8
    pedal_rise: float = 1.0
    pedal_fall: float = 2.0
    kick_down_gain: float = 2.0
    endurance_rate: float = 2.0
    demand_rate: float = 3.0
    demand_max: float = 8.0
    stop_speed: float = 0.25
    go_speed: float = 0.15
    level: float = 0.01
    roll_back: float = 0.1
    hold_demand: float = 1.0

    def coasting_error(self, error: float, speed: float) -> float:
        """The part of a speed error that is corrected while coasting at a speed [m/s]."""
        band = self.coast_error * min(max(speed, 0.0) / self.coast_speed, 1.0)
        return error - min(max(error, -band), band)


def interpolate(x: float, places: Sequence[float], values: Sequence[float]) -> float:
    """Linear interpolation of one value; the same bits as `np.interp`, faster on lists.

    Args:
      x: a number.
      places: rising, at least one.
      values: finite, one for each place; the first and last hold beyond the ends.
    """
    row = bisect_right(places, x) - 1
    if row < 0:
        return values[0]
    low, value = places[row], values[row]
    if row == len(places) - 1 or low == x:
        return value
    return (values[row + 1] - value) / (places[row + 1] - low) * (x - low) + value


class SpeedView:
    """A trajectory prepared for lookups of speed and acceleration by time.

    Attributes:
      trajectory: planned.
      greatest: greatest speed in it [m/s].
    """

    def __init__(self, trajectory: Trajectory) -> None:
        self.trajectory = trajectory
        self._time = trajectory.time.tolist()
        self._speed = trajectory.speed.tolist()
        self.greatest: float = max(self._speed)
        self._acceleration = trajectory.acceleration.tolist()

    def speed(self, time: float) -> float:
        """Planned speed at a time [m/s]."""
        return interpolate(time, self._time, self._speed)

    def acceleration(self, time: float) -> float:
        """Planned acceleration at a time [m/s2]."""
        return interpolate(time, self._time, self._acceleration)


class KickDown:
    """The gearbox's condition for a kick-down: pedal near the floor, far above its recent level."""

    def __init__(self, parameters: TruckParameters) -> None:
        shifting = parameters.gearbox.shifting
        self._near_floor = _SURELY * shifting.kick_down_pedal
        self._rise = _SURELY * shifting.kick_down_rise
        self._share = min(CONTROL_PERIOD / shifting.pedal_lag, 1.0)
        self.reset()

    def reset(self) -> None:
        """Assumes that the pedal has been released for long."""
        self._slow_pedal = 0.0

    def follow(self, pedal: float) -> None:
        """Takes the pedal of this step, 0 to 1."""
        self._slow_pedal += self._share * (pedal - self._slow_pedal)

    @property
    def greatest_pedal(self) -> float:
        """Greatest pedal position without a kick-down now, 0 to 1."""
        return min(max(self._near_floor, self._slow_pedal + self._rise), 1.0)


class LongitudinalController:
    """Tracks the planned speed; one call every 20 ms."""

    def __init__(
        self, parameters: TruckParameters, config: LongitudinalConfig | None = None
    ) -> None:
        self.parameters = parameters
        self.config = config or LongitudinalConfig()
        self.inverse = DrivelineInverse(parameters)
        self._kick_down = KickDown(parameters)
        self.reset()

    def reset(self) -> None:
        """Clears phase and integral."""
        self.phase = _DRIVE
        self._since = self.config.dwell
        self._integral = 0.0
        self._pedal = 0.0
        self._kick_down.reset()
        self._engine_brake = 0.0
        self._retarder = 0.0
        self._demand = 0.0
        self._gear = 1
        self._view: SpeedView | None = None

    def command(
        self,
        ego: EgoState,
        trajectory: Trajectory,
        grade: float,
        steering_wheel_angle: float = 0.0,
    ) -> VehicleCommand:
        """The command of pedal and brakes.

        Args:
          ego: the truck.
          trajectory: planned motion, looked up by time.
          grade: under the combination, rise over run.
          steering_wheel_angle: of the command [rad]; another controller's.
        """
        config = self.config
        self._since += CONTROL_PERIOD
        if ego.gear >= 1:
            self._gear = ego.gear
        view = self._view
        if view is None or view.trajectory is not trajectory:
            view = self._view = SpeedView(trajectory)
        time, speed = ego.time, ego.speed
        planned, soon = view.speed(time), view.speed(time + 0.5)
        if self._stand(ego, planned, soon):
            self._hold(ego, grade, soon)
            return self._output(steering_wheel_angle)
        error = planned - speed
        if self.phase is _COAST:
            error = config.coasting_error(error, speed)
        ahead = view.acceleration(time + config.lead_time)
        wanted = ahead + config.speed_gain * error + self._integral
        inverse, gear, mass = self.inverse, self._gear, ego.mass
        force = inverse.effective_mass(mass, gear) * wanted
        force += inverse.resistance(mass, speed, grade)
        engaged = not ego.shift_in_process and ego.gear >= 1
        # Engine brake and retarder fade as the truck slows down, so friction must build up before.
        later = max(speed + min(wanted, 0.0) * config.build_up, 0.0)
        split = inverse.actuation(force, speed, ego.engine_speed, gear, engaged, later)
        above = split.torque + split.drag
        self._choose(above, split.beyond / mass, split.lacking / mass, wanted, engaged)
        self._pull(ego, split.pedal, view.greatest - speed)
        self._retard(split, wanted, engaged)
        self._brake(mass, force, wanted)
        self._learn(ego, error)
        return self._output(steering_wheel_angle)

    def _stand(self, ego: EgoState, planned: float, soon: float) -> bool:
        """Whether the truck is at standstill and stays there or starts."""
        config = self.config
        if self.phase in (_HOLD, _LAUNCH):
            return ego.speed < config.stop_speed or soon <= config.go_speed
        return ego.speed < config.stop_speed and (
            max(planned, soon) <= config.go_speed or abs(ego.speed) < 0.05
        )

    def _hold(self, ego: EgoState, grade: float, soon: float) -> None:
        """Sets the actuators at standstill, and for a start without rolling back."""
        config, inverse = self.config, self.inverse
        self._integral = 0.0
        start = soon > config.go_speed and self._may_start(ego, grade)
        self._enter(_LAUNCH if start else _HOLD)
        self._engine_brake = self._retarder = 0.0
        if self.phase is _HOLD:
            self._pedal, self._demand = 0.0, config.hold_demand
            return
        # Brake control's hill hold keeps the truck until the driveline does; an XBR demand would
        # cut the engine's torque.
        self._demand = 0.0
        force = 0.35 * ego.mass + inverse.resistance(ego.mass, 0.1, grade)
        engine_speed = max(ego.engine_speed, 70.0)
        split = inverse.actuation(force, 0.1, engine_speed, self._gear, True, 0.1)
        target = max(split.pedal, 0.12)
        self._pedal = min(target, self._pedal + config.pedal_rise * CONTROL_PERIOD)

    def _may_start(self, ego: EgoState, grade: float) -> bool:
        """Whether a start is possible: uphill only from a hold with hill hold, not rolling back."""
        if self.phase is _LAUNCH:
            return ego.speed > -self.config.roll_back
        held = self.phase is _HOLD and self._since >= self.config.dwell
        return held or grade < self.config.level

    def _choose(
        self, above: float, beyond: float, deficit: float, wanted: float, engaged: bool
    ) -> None:
        """Chooses the next phase, with hysteresis and dwell time; waits for gear changes.

        Args:
          above: torque wanted above the engine's drag [N m].
          beyond: deceleration wanted beyond the engine's drag, positive [m/s2].
          deficit: the same beyond engine brake and retarder, positive [m/s2].
          wanted: acceleration [m/s2].
          engaged: False in a gear change.
        """
        config = self.config
        if self.phase in (_HOLD, _LAUNCH):
            self._enter(_DRIVE)
        urgent = wanted < -config.urgent
        if (self._since < config.dwell or not engaged) and not urgent:
            return
        if self.phase is _BRAKE:
            if deficit < config.brake_leave and wanted > -config.calm:
                self._enter(_DRIVE if above > config.overrun_leave else _OVERRUN)
        elif urgent or deficit > config.brake_enter:
            self._enter(_BRAKE)
        elif self.phase is _OVERRUN:
            if above > config.overrun_leave:
                self._enter(_DRIVE)
            elif above > 0.0:
                self._enter(_COAST)
        elif beyond > config.retard_enter:
            self._enter(_OVERRUN)
        elif self.phase is _DRIVE and above < -config.overrun_enter:
            self._enter(_COAST)
        elif self.phase is _COAST and above > config.overrun_leave:
            self._enter(_DRIVE)

    def _pull(self, ego: EgoState, pedal: float, gain: float) -> None:
        """Sets the accelerator within its rates; released in every phase but DRIVE.

        Args:
          ego: the truck; in a gear change the pedal rests.
          pedal: that gives the wanted torque, 0 to 1.
          gain: speed still to be gained by the plan [m/s].
        """
        config = self.config
        if self.phase is not _DRIVE:
            self._pedal = 0.0
            return
        if ego.shift_in_process:
            pedal = self._pedal
        if gain < config.kick_down_gain:
            pedal = min(pedal, self._kick_down.greatest_pedal)
        lowest = self._pedal - config.pedal_fall * CONTROL_PERIOD
        self._pedal = min(max(pedal, lowest), self._pedal + config.pedal_rise * CONTROL_PERIOD)

    def _retard(self, split: Actuation, wanted: float, engaged: bool) -> None:
        """Sets engine brake and retarder; a gear change keeps the engine brake's request."""
        engine_brake, retarder = split.engine_brake, split.retarder
        if not engaged:
            engine_brake = self._engine_brake
        resting = self.phase in (_DRIVE, _COAST)
        if resting or wanted < -self.config.urgent:
            engine_brake = retarder = 0.0
        reach = self.config.endurance_rate * CONTROL_PERIOD
        self._engine_brake += min(max(engine_brake - self._engine_brake, -reach), reach)
        self._retarder += min(max(retarder - self._retarder, -reach), reach)

    def _brake(self, mass: float, force: float, wanted: float) -> None:
        """Sets the XBR demand for a force at the wheels [N], negative when it brakes."""
        config, brake = self.config, self.parameters.air_brake
        demand = 0.0
        if self.phase is _BRAKE:
            # Brake control includes rolling resistance and slows the wheels as well.
            level = self.inverse.rolling * (mass * GRAVITY) - force
            level /= mass + self.inverse.wheel_mass
            demand = xbr_deceleration(-wanted, level, brake.trim_max, brake.trim_share)
            demand = min(max(demand, 1e-3), config.demand_max)
        rise = (10.0 if wanted < -2.5 else config.demand_rate) * CONTROL_PERIOD
        self._demand = min(demand, self._demand + rise)

    def _learn(self, ego: EgoState, error: float) -> None:
        """Updates the integral, except at the actuators' limits, coasting and in gear changes."""
        config = self.config
        stuck = (self._pedal >= 1.0 and error > 0.0) or (
            self._demand >= config.demand_max and error < 0.0
        )
        idle = self._engine_brake <= 0.0 and self._retarder <= 0.0
        coasting = self.phase is _COAST or (self.phase is _OVERRUN and idle and error < 0.0)
        if stuck or coasting or ego.shift_in_process or ego.speed < 1.0:
            return
        grown = self._integral + config.integral_gain * error * CONTROL_PERIOD
        self._integral = min(max(grown, -config.integral_max), config.integral_max)

    def _enter(self, phase: Phase) -> None:
        if phase is not self.phase:
            self.phase, self._since = phase, 0.0

    def _output(self, steering_wheel_angle: float) -> VehicleCommand:
        active = self._demand > 0.0
        pedal = _share(self._pedal)
        self._kick_down.follow(pedal)
        return _vehicle_command(
            pedal,
            -self._demand if active else 0.0,
            _XBR_MAXIMUM if active else _XBR_OFF,
            steering_wheel_angle,
            0.0,  # parking brake
            _share(self._engine_brake),
            _FORWARD,
            _share(self._retarder),
            0.0,  # brake pedal
            _INTEGRATION if active and self.phase is _BRAKE else _FRICTION_ONLY,
        )


def _share(value: float) -> float:
    """The value within 0 to 1."""
    return 0.0 if value <= 0.0 else min(value, 1.0)
