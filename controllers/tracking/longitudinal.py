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
from dataclasses import dataclass

from controllers.tracking.driveline_inverse import (
    DrivelineInverse,
    Retardation,
    interpolate,
    share_out,
    xbr_deceleration,
)
from iits_mj.core.messages import EgoState, Trajectory, VehicleCommand, XbrEbiMode, XbrMode
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


class SpeedView:
    """A trajectory prepared for lookups of speed and acceleration by time.

    Attributes:
      trajectory: planned.
      greatest: greatest speed in it [m/s].
    """

    def __init__(self, trajectory: Trajectory) -> None:
        self.trajectory = trajectory
        self.greatest = float(trajectory.speed.max())
        self._time = trajectory.time.tolist()
        self._speed = trajectory.speed.tolist()
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
        self.phase = Phase.DRIVE
        self._since = self.config.dwell
        self._integral = 0.0
        self._pedal = 0.0
        self._kick_down.reset()
        self._engine_brake = 0.0
        self._retarder = 0.0
        self._demand = 0.0
        self._gear = 1
        self._view: SpeedView | None = None

    def command(self, ego: EgoState, trajectory: Trajectory, grade: float) -> VehicleCommand:
        """The command of pedal and brakes, without steering.

        Args:
          ego: the truck.
          trajectory: planned motion, looked up by time.
          grade: under the combination, rise over run.
        """
        config = self.config
        self._since += CONTROL_PERIOD
        if ego.gear >= 1:
            self._gear = ego.gear
        view = self._view
        if view is None or view.trajectory is not trajectory:
            view = self._view = SpeedView(trajectory)
        planned, soon = view.speed(ego.time), view.speed(ego.time + 0.5)
        ahead = view.acceleration(ego.time + config.lead_time)
        if self._stand(ego, planned, soon):
            return self._hold(ego, grade, soon)
        error = planned - ego.speed
        if self.phase is Phase.COAST:
            error = config.coasting_error(error, ego.speed)
        wanted = ahead + config.speed_gain * error + self._integral
        inverse, gear = self.inverse, self._gear
        force = inverse.effective_mass(ego.mass, gear) * wanted
        force += inverse.resistance(ego.mass, ego.speed, grade)
        torque = inverse.engine_torque(force, gear)
        drag = inverse.drag_torque(ego.engine_speed)
        engaged = not ego.shift_in_process and ego.gear >= 1
        endurance = inverse.endurance(ego.speed, ego.engine_speed, gear, engaged)
        shared = share_out(-force, endurance)
        deficit = max(shared.short, self._short_soon(ego, force, wanted, engaged)) / ego.mass
        beyond = max(-force - endurance.drag, 0.0) / ego.mass
        self._choose(torque + drag, beyond, deficit, wanted, engaged)
        self._pull(ego, torque, view.greatest - ego.speed)
        self._retard(shared, wanted, engaged)
        self._brake(ego, force, wanted)
        self._learn(ego, error)
        return self._output()

    def _short_soon(self, ego: EgoState, force: float, wanted: float, engaged: bool) -> float:
        """Force [N] that engine brake and retarder will lack once friction has built up.

        Both fade as the truck slows down, so friction must build up before.
        """
        speed = max(ego.speed + min(wanted, 0.0) * self.config.build_up, 0.0)
        engine_speed = ego.engine_speed * speed / max(ego.speed, 0.1)
        then = self.inverse.endurance(speed, engine_speed, self._gear, engaged)
        return share_out(-force, then).short

    def _stand(self, ego: EgoState, planned: float, soon: float) -> bool:
        """Whether the truck is at standstill and stays there or starts."""
        config = self.config
        if self.phase in (Phase.HOLD, Phase.LAUNCH):
            return ego.speed < config.stop_speed or soon <= config.go_speed
        return ego.speed < config.stop_speed and (
            max(planned, soon) <= config.go_speed or abs(ego.speed) < 0.05
        )

    def _hold(self, ego: EgoState, grade: float, soon: float) -> VehicleCommand:
        """Commands at standstill, and of a start without rolling back."""
        config, inverse = self.config, self.inverse
        self._integral = 0.0
        start = soon > config.go_speed and self._may_start(ego, grade)
        self._enter(Phase.LAUNCH if start else Phase.HOLD)
        self._engine_brake = self._retarder = 0.0
        if self.phase is Phase.HOLD:
            self._pedal, self._demand = 0.0, config.hold_demand
            return self._output()
        # Brake control's hill hold keeps the truck until the driveline does; an XBR demand would
        # cut the engine's torque.
        self._demand = 0.0
        resistance = inverse.resistance(ego.mass, 0.1, grade)
        torque = inverse.engine_torque(0.35 * ego.mass + resistance, self._gear)
        target = max(inverse.pedal(torque, max(ego.engine_speed, 70.0)), 0.12)
        self._pedal = min(target, self._pedal + config.pedal_rise * CONTROL_PERIOD)
        return self._output()

    def _may_start(self, ego: EgoState, grade: float) -> bool:
        """Whether a start is possible: uphill only from a hold with hill hold, not rolling back."""
        if self.phase is Phase.LAUNCH:
            return ego.speed > -self.config.roll_back
        held = self.phase is Phase.HOLD and self._since >= self.config.dwell
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
        if self.phase in (Phase.HOLD, Phase.LAUNCH):
            self._enter(Phase.DRIVE)
        urgent = wanted < -config.urgent
        if (self._since < config.dwell or not engaged) and not urgent:
            return
        if self.phase is Phase.BRAKE:
            if deficit < config.brake_leave and wanted > -config.calm:
                self._enter(Phase.DRIVE if above > config.overrun_leave else Phase.OVERRUN)
        elif urgent or deficit > config.brake_enter:
            self._enter(Phase.BRAKE)
        elif self.phase is Phase.OVERRUN:
            if above > config.overrun_leave:
                self._enter(Phase.DRIVE)
            elif above > 0.0:
                self._enter(Phase.COAST)
        elif beyond > config.retard_enter:
            self._enter(Phase.OVERRUN)
        elif self.phase is Phase.DRIVE and above < -config.overrun_enter:
            self._enter(Phase.COAST)
        elif self.phase is Phase.COAST and above > config.overrun_leave:
            self._enter(Phase.DRIVE)

    def _pull(self, ego: EgoState, torque: float, gain: float) -> None:
        """Sets the accelerator within its rates; released in every phase but DRIVE.

        Args:
          ego: the truck.
          torque: wanted at the crankshaft [N m].
          gain: speed still to be gained by the plan [m/s].
        """
        config = self.config
        if self.phase is not Phase.DRIVE:
            self._pedal = 0.0
            return
        pedal = self._pedal
        if not ego.shift_in_process:
            pedal = self.inverse.pedal(torque, ego.engine_speed)
        if gain < config.kick_down_gain:
            pedal = min(pedal, self._kick_down.greatest_pedal)
        lowest = self._pedal - config.pedal_fall * CONTROL_PERIOD
        self._pedal = min(max(pedal, lowest), self._pedal + config.pedal_rise * CONTROL_PERIOD)

    def _retard(self, shared: Retardation, wanted: float, engaged: bool) -> None:
        """Sets engine brake and retarder; a gear change keeps the engine brake's request."""
        engine_brake, retarder = shared.engine_brake, shared.retarder
        if not engaged:
            engine_brake = self._engine_brake
        resting = self.phase in (Phase.DRIVE, Phase.COAST)
        if resting or wanted < -self.config.urgent:
            engine_brake = retarder = 0.0
        reach = self.config.endurance_rate * CONTROL_PERIOD
        self._engine_brake += min(max(engine_brake - self._engine_brake, -reach), reach)
        self._retarder += min(max(retarder - self._retarder, -reach), reach)

    def _brake(self, ego: EgoState, force: float, wanted: float) -> None:
        """Sets the XBR demand for a force at the wheels [N], negative when it brakes."""
        config, brake = self.config, self.parameters.air_brake
        demand = 0.0
        if self.phase is Phase.BRAKE:
            # Brake control includes rolling resistance and slows the wheels as well.
            weight = ego.mass * GRAVITY
            level = self.inverse.rolling * weight - force
            level /= ego.mass + self.inverse.wheel_mass
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
        coasting = self.phase is Phase.COAST or (
            self.phase is Phase.OVERRUN and idle and error < 0.0
        )
        if stuck or coasting or ego.shift_in_process or ego.speed < 1.0:
            return
        grown = self._integral + config.integral_gain * error * CONTROL_PERIOD
        self._integral = min(max(grown, -config.integral_max), config.integral_max)

    def _enter(self, phase: Phase) -> None:
        if phase is not self.phase:
            self.phase, self._since = phase, 0.0

    def _output(self) -> VehicleCommand:
        active = self._demand > 0.0
        pedal = min(max(self._pedal, 0.0), 1.0)
        self._kick_down.follow(pedal)
        return VehicleCommand(
            accelerator_pedal=pedal,
            xbr_demand=-self._demand if active else 0.0,
            xbr_mode=XbrMode.MAXIMUM if active else XbrMode.OFF,
            xbr_ebi_mode=(
                XbrEbiMode.INTEGRATION
                if active and self.phase is Phase.BRAKE
                else XbrEbiMode.FRICTION_ONLY
            ),
            engine_brake=min(max(self._engine_brake, 0.0), 1.0),
            retarder=min(max(self._retarder, 0.0), 1.0),
        )
