"""Speed tracking in Python, part by part.

`tests/controllers/tracking/test_compiled_laws.py` shows that the compiled law gives the same bits.
"""

from controllers.tracking.longitudinal import LongitudinalController, Phase
from iits_mj.core.messages import TransmissionMode, VehicleCommand, XbrEbiMode, XbrMode
from iits_mj.core.timing import CONTROL_PERIOD
from iits_mj.core.units import GRAVITY
from tests.controllers.tracking.reference import Powertrain, interpolate


def coasting_error(config, error, speed):
    """The part of a speed error that is corrected while coasting at a speed [m/s]."""
    band = config.coast_error * min(max(speed, 0.0) / config.coast_speed, 1.0)
    return error - min(max(error, -band), band)


def xbr_deceleration(deceleration, level, correction_max, correction_share):
    """XBR demand with which the brakes reach a braking level [m/s2]."""
    least = max(0.5 * level, (level - correction_max) / (1.0 + correction_share))
    return max(deceleration, least, 0.0)


class SpeedView:
    """A trajectory prepared for lookups of speed and acceleration by time."""

    def __init__(self, trajectory):
        self._time = trajectory.time.tolist()
        self._speed = trajectory.speed.tolist()
        self.greatest = max(self._speed)
        self._acceleration = trajectory.acceleration.tolist()

    def speed(self, time):
        """Planned speed at a time [m/s]."""
        return interpolate(time, self._time, self._speed)

    def acceleration(self, time):
        """Planned acceleration at a time [m/s2]."""
        return interpolate(time, self._time, self._acceleration)


class KickDown:
    """The gearbox's condition for a kick-down: pedal near the floor, far above its recent level."""

    def __init__(self, parameters):
        shifting = parameters.gearbox.shifting
        self._near_floor = 0.99 * shifting.kick_down_pedal
        self._rise = 0.99 * shifting.kick_down_rise
        self._share = min(CONTROL_PERIOD / shifting.pedal_lag, 1.0)
        self.reset()

    def reset(self):
        """Assumes that the pedal has been released for long."""
        self._slow_pedal = 0.0

    def follow(self, pedal):
        """Takes the pedal of this step, 0 to 1."""
        self._slow_pedal += self._share * (pedal - self._slow_pedal)

    @property
    def greatest_pedal(self):
        """Greatest pedal position without a kick-down now, 0 to 1."""
        return min(max(self._near_floor, self._slow_pedal + self._rise), 1.0)


class SpeedLaw(LongitudinalController):
    """The law of `LongitudinalController.command` from the parts above."""

    phase = Phase.DRIVE

    def __init__(self, parameters, config=None):
        self.inverse = Powertrain(parameters)
        self._kick_down = KickDown(parameters)
        super().__init__(parameters, config)

    def reset(self):
        super().reset()
        self.phase = Phase.DRIVE
        self._since = self.config.dwell
        self._integral = self._pedal = self._engine_brake = self._retarder = self._demand = 0.0
        self._kick_down.reset()
        self._gear = 1

    def command(
        self,
        ego,
        trajectory,
        grade,
        steering_wheel_angle=0.0,
    ):
        """The command of pedal and brakes."""
        config = self.config
        self._since += CONTROL_PERIOD
        if ego.gear >= 1:
            self._gear = ego.gear
        view = SpeedView(trajectory)
        time, speed = ego.time, ego.speed
        planned, soon = view.speed(time), view.speed(time + 0.5)
        if self._stand(ego, planned, soon):
            self._hold(ego, grade, soon)
            return self._output(steering_wheel_angle)
        error = planned - speed
        if self.phase is Phase.COAST:
            error = coasting_error(config, error, speed)
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

    def _stand(self, ego, planned, soon):
        """Whether the truck is at standstill and stays there or starts."""
        config = self.config
        if self.phase in (Phase.HOLD, Phase.LAUNCH):
            return ego.speed < config.stop_speed or soon <= config.go_speed
        return ego.speed < config.stop_speed and (
            max(planned, soon) <= config.go_speed or abs(ego.speed) < 0.05
        )

    def _hold(self, ego, grade, soon):
        """Sets the actuators at standstill, and for a start without rolling back."""
        config, inverse = self.config, self.inverse
        self._integral = 0.0
        start = soon > config.go_speed and self._may_start(ego, grade)
        self._enter(Phase.LAUNCH if start else Phase.HOLD)
        self._engine_brake = self._retarder = 0.0
        if self.phase is Phase.HOLD:
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

    def _may_start(self, ego, grade):
        """Whether a start is possible: uphill only from a hold with hill hold, not rolling back."""
        if self.phase is Phase.LAUNCH:
            return ego.speed > -self.config.roll_back
        held = self.phase is Phase.HOLD and self._since >= self.config.dwell
        return held or grade < self.config.level

    def _choose(self, above, beyond, deficit, wanted, engaged):
        """Chooses the next phase, with hysteresis and dwell time; waits for gear changes."""
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

    def _pull(self, ego, pedal, gain):
        """Sets the accelerator within its rates; released in every phase but DRIVE."""
        config = self.config
        if self.phase is not Phase.DRIVE:
            self._pedal = 0.0
            return
        if ego.shift_in_process:
            pedal = self._pedal
        if gain < config.kick_down_gain:
            pedal = min(pedal, self._kick_down.greatest_pedal)
        lowest = self._pedal - config.pedal_fall * CONTROL_PERIOD
        self._pedal = min(max(pedal, lowest), self._pedal + config.pedal_rise * CONTROL_PERIOD)

    def _retard(self, split, wanted, engaged):
        """Sets engine brake and retarder; a gear change keeps the engine brake's request."""
        engine_brake, retarder = split.engine_brake, split.retarder
        if not engaged:
            engine_brake = self._engine_brake
        resting = self.phase in (Phase.DRIVE, Phase.COAST)
        if resting or wanted < -self.config.urgent:
            engine_brake = retarder = 0.0
        reach = self.config.endurance_rate * CONTROL_PERIOD
        self._engine_brake += min(max(engine_brake - self._engine_brake, -reach), reach)
        self._retarder += min(max(retarder - self._retarder, -reach), reach)

    def _brake(self, mass, force, wanted):
        """Sets the XBR demand for a force at the wheels [N], negative when it brakes."""
        config, brake = self.config, self.parameters.air_brake
        demand = 0.0
        if self.phase is Phase.BRAKE:
            # Brake control includes rolling resistance and slows the wheels as well.
            level = self.inverse.rolling * (mass * GRAVITY) - force
            level /= mass + self.inverse.wheel_mass
            demand = xbr_deceleration(-wanted, level, brake.trim_max, brake.trim_share)
            demand = min(max(demand, 1e-3), config.demand_max)
        rise = (10.0 if wanted < -2.5 else config.demand_rate) * CONTROL_PERIOD
        self._demand = min(demand, self._demand + rise)

    def _learn(self, ego, error):
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

    def _enter(self, phase):
        if phase is not self.phase:
            self.phase, self._since = phase, 0.0

    def _output(self, steering_wheel_angle):
        active = self._demand > 0.0
        pedal = share(self._pedal)
        self._kick_down.follow(pedal)
        both = active and self.phase is Phase.BRAKE
        return VehicleCommand(
            accelerator_pedal=pedal,
            xbr_demand=-self._demand if active else 0.0,
            xbr_mode=XbrMode.MAXIMUM if active else XbrMode.OFF,
            steering_wheel_angle=steering_wheel_angle,
            engine_brake=share(self._engine_brake),
            transmission_mode=TransmissionMode.DRIVE,
            retarder=share(self._retarder),
            xbr_ebi_mode=XbrEbiMode.INTEGRATION if both else XbrEbiMode.FRICTION_ONLY,
        )


def share(value):
    """The value within 0 to 1."""
    return 0.0 if value <= 0.0 else min(value, 1.0)
