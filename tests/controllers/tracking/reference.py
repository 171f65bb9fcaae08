"""The compiled laws of tracking in Python: steering and the inverse powertrain, part by part.

`tests/controllers/tracking/test_compiled_laws.py` shows that the compiled laws give the same bits.
"""

import math
from bisect import bisect, bisect_left, bisect_right
from fractions import Fraction
from typing import NamedTuple

import numpy as np

from controllers.tracking.lateral import LateralController
from controllers.tracking.lateral_gains import Gains
from iits_mj.core.timing import CONTROL_PERIOD
from iits_mj.core.units import GRAVITY
from iits_mj.parameters.mass_state import rolling_resistance

# --- sums -----------------------------------------------------------------------------------


def fma(a, b, c):
    """a b + c, rounded once."""
    return float(Fraction(a) * Fraction(b) + Fraction(c))


def dot(a, b):
    """Scalar product in the order of OpenBLAS's `ddot` for AVX2."""
    a, b = np.asarray(a, dtype=float).tolist(), np.asarray(b, dtype=float).tolist()
    whole = len(a) // 16 * 16
    part = [0.0] * 16
    for i in range(whole):
        part[i % 16] = fma(a[i], b[i], part[i % 16])
    while len(part) > 2:
        part = [
            part[4 * (k // 2) + k % 2] + part[4 * (k // 2) + k % 2 + 2]
            for k in range(len(part) // 2)
        ]
    total = part[0] + part[1]
    for x, y in zip(a[whole:], b[whole:], strict=True):
        total += x * y
    return total


def product(matrix, vector):
    """Product of a matrix with a vector, rows of 3 or 5 in the order of OpenBLAS's `dgemv`."""
    x = vector.tolist()
    if len(x) == 3:
        rows = [fma(a[2], x[2], fma(a[0], x[0], a[1] * x[1])) for a in matrix.tolist()]
    elif len(x) == 5:
        rows = [
            fma(a[4], x[4], (a[0] * x[0] + a[2] * x[2]) + (a[1] * x[1] + a[3] * x[3]))
            for a in matrix.tolist()
        ]
    else:
        rows = [dot(a, x) for a in matrix.tolist()]
    return np.array(rows)


# --- steering -------------------------------------------------------------------------------


def gains_at(gains, speed):
    """The gains interpolated at a speed [m/s], clamped to the grid."""
    grid = [row.speed for row in gains.gains]
    row = min(max(bisect(grid, speed) - 1, 0), len(grid) - 2)
    share = min(max((speed - grid[row]) / (grid[row + 1] - grid[row]), 0.0), 1.0)
    pairs = zip(gains.gains[row], gains.gains[row + 1], strict=True)
    return Gains(*((1.0 - share) * low + share * high for low, high in pairs))


class PathView:
    """Offset, heading error and curvature of a trajectory by station."""

    def __init__(self, trajectory):
        self.trajectory, self.station = trajectory, trajectory.station
        yaw = trajectory.yaw
        self.yaw = yaw if (np.abs(np.diff(yaw)) < np.pi).all() else np.unwrap(yaw)

    def error(self, ego):
        """Offset to the left of the path [m] and heading error [rad]."""
        columns = (self.station, self.yaw, self.trajectory.x, self.trajectory.y)
        row = int(np.searchsorted(self.station, ego.station, side="right")) - 1
        row = min(max(row, 0), len(self.station) - 2)
        (start, end), yaws, xs, ys = (column[row : row + 2].tolist() for column in columns)
        share = (ego.station - start) / (end - start) if end > start else 0.0
        held = min(max(share, 0.0), 1.0)
        turn = yaws[1] - yaws[0]
        yaw = yaws[0] + held * turn
        x, y = xs[0] + share * (xs[1] - xs[0]), ys[0] + share * (ys[1] - ys[0])
        bulge = 0.5 * turn * (end - start) * held * (1.0 - held)
        error = -math.sin(yaw) * (ego.x - x) + math.cos(yaw) * (ego.y - y) + bulge
        turned = ego.yaw - yaw
        return error, math.atan2(math.sin(turned), math.cos(turned))

    def curvature(self, stations):
        """Mean curvature [1/m] between rising stations of shape (n + 1,); shape (n,)."""
        yaw = np.interp(stations, self.station, self.yaw)
        if stations[-1] > self.station[-1]:
            yaw += self.trajectory.curvature[-1] * np.maximum(stations - self.station[-1], 0.0)
        return np.diff(yaw) / np.diff(stations)


class DisturbanceObserver:
    """Estimate `value` of the disturbing accelerations of (w, r of each unit), (units + 1,)."""

    def __init__(self, time, units=2):
        self._share = 1.0 - float(np.exp(-CONTROL_PERIOD / time))
        self._speeds = units + 1
        self.reset()

    def reset(self):
        self.value, self._expected = np.zeros(self._speeds), None

    def update(self, state, gains):
        """The estimate after a step; the state is (w, r, articulations, road wheel angle)."""
        if self._expected is not None:
            seen = product(gains.blame, state[: self._speeds] - self._expected)
            self.value = self.value + self._share * (seen - self.value)
        self._expected = product(gains.motion, state)
        return self.value

    def rest(self):
        """A step without steering."""
        self._expected = None
        self.value = (1.0 - self._share) * self.value


class SteeringPlay:
    """Inverse of the steering gear's play."""

    def __init__(self, steering, config):
        self.steering, self.config = steering, config
        self.reset()

    def reset(self):
        self._output, self._flank, self._wheel = None, 1.0, 0.0

    def follow(self, wheel, road_wheel):
        """Output of the gear, as angle of the steering wheel [rad], from the measured angles."""
        half = 0.5 * self.steering.dead_band
        if self._output is None:
            self._output = road_wheel * self.steering.ratio
            self._flank = math.copysign(1.0, wheel - self._output)
            self._wheel = wheel
        self._output = min(max(self._output, wheel - half), wheel + half)
        return self._output

    def turn(self, demand, gain, share=1.0):
        """Steering wheel angle [rad] for a road wheel angle; `gain` is the steady response.

        `share` is of the angle that may be missing before the wheel crosses the play.
        """
        config, ratio, half = self.config, self.steering.ratio, 0.5 * self.steering.dead_band
        output = demand * ratio if self._output is None else self._output
        missing = demand * ratio - output
        bearable = min(config.missing_angle, config.missing_acceleration / max(gain, 1e-6))
        if missing * self._flank < -share * bearable * ratio:
            self._flank = -self._flank
        target = output + self._flank * (max(missing * self._flank, 0.0) + half)
        contact = output + self._flank * half
        reach = config.crossing_rate * CONTROL_PERIOD
        crossing = (contact - self._wheel) * self._flank > reach
        wheel = self._wheel + self._flank * reach if crossing else target
        self._wheel = min(max(wheel, -self.steering.angle_max), self.steering.angle_max)
        return self._wheel


class Rest:
    """How the wheel rests in calm; see the kernel's `Calm`."""

    def __init__(self, config, ratio):
        self.config, self.calm, self.ratio = config, config.calm, ratio
        self.strength, self.drift, self.resting = 0.0, 0.0, False
        self.gentle, self.idle_share = 0.0, 1.0

    def update(self, steady, response, across, jerk, trusted, law):
        calm = self.calm
        strength = abs(law.demand - steady) / law.idle(response)
        kept = math.exp(-CONTROL_PERIOD / calm.strength_time)
        self.strength = max(strength, self.strength * kept)
        self.still = trusted and self.strength < calm.strength
        self.offset, self.flank, self.jerk = law.offset, law.play._flank, jerk
        self.beyond = response * (math.sin(law.play._output / self.ratio) - steady)
        share = 1.0 - math.exp(-CONTROL_PERIOD / calm.drift_time)
        self.drift += self.beyond * CONTROL_PERIOD + share * (across - self.drift)
        self.slide = self.drift + self.beyond * calm.delay + self.offset / calm.return_time
        self.quiet = 1.0 - min(abs(jerk) / calm.path_jerk, 1.0) if self.still else 1.0
        wanted = -self.slide / calm.settle_time
        along = self.quiet >= 0.5 or wanted * jerk >= 0.0
        self.gentle = wanted / response if self.still and along else 0.0
        free = (law.demand - steady) * jerk > 0.0 or self.flank * jerk > 0.0
        self.idle_share = self.quiet if free else 1.0

    def farthest(self):
        """Greatest distance from the path over the horizon."""
        offset, drift, a, time = self.offset, self.drift, self.beyond, self.calm.horizon
        places = [offset, offset + drift * time + 0.5 * a * time * time]
        turn = -drift / a if a else 0.0
        if 0.0 < turn < time:
            places.append(offset + 0.5 * drift * turn)
        return max(abs(place) for place in places)

    def crossing(self, correction):
        """Share of the missing angle at which the wheel crosses the play."""
        calm, play = self.calm, self.config.play
        moved = abs(self.slide) * calm.horizon
        turned = 0.5 * abs(self.beyond) * calm.horizon * calm.horizon
        if self.resting:
            bearable = max(self.farthest(), moved) < calm.rest_error
        else:
            bearable = max(moved, turned) < calm.settled
        self.resting = self.still and self.quiet > 0.5 and bearable
        share = 1.0
        if self.still and self.quiet > 0.5 and not self.resting:
            pushing = moved >= calm.settled and correction * self.flank > 0.0
            share = 1.0 if pushing else calm.missing_share
        if self.flank * self.jerk > 0.0:
            ratio = self.config.idle_acceleration / play.missing_acceleration
            share += ratio * (1.0 - self.quiet)
        return share


class Steering(LateralController):
    """The law of `LateralController.steer` from the parts above."""

    def reset(self):
        super().reset()
        config, steering = self.config, self.parameters.steering
        self.most = math.sin(steering.angle_max / steering.ratio)
        self.near = max(1, round(2.0 * config.lag / CONTROL_PERIOD))
        units = len(self.parameters.units)
        self.demand, self.integral, self.wheel = None, 0.0, 0.0
        self.lasting = np.zeros(units + 1)
        self.play = SteeringPlay(steering, config.play)
        self.observer = DisturbanceObserver(config.disturbance_time, units)
        self.rest = Rest(config, steering.ratio)

    def steer(self, ego, trajectory):
        config, view = self.config, PathView(trajectory)
        offset, heading = view.error(ego)
        self.offset = offset
        if self.demand is None:
            self.demand, self.wheel = math.sin(ego.road_wheel_angle), ego.steering_wheel_angle
        self.play.follow(ego.steering_wheel_angle, ego.road_wheel_angle)
        if ego.speed < config.speed_min:
            self.observer.rest()
            return self.wheel
        speed = math.hypot(ego.speed, ego.lateral_speed)
        gains = gains_at(self.gains(ego.mass), speed)
        angle, units = math.sin(ego.road_wheel_angle), len(self.parameters.units)
        turning = [ego.articulation_rate, *ego.rear_articulation_rates]
        rates = [ego.lateral_speed, ego.yaw_rate]
        for k in range(units - 2):
            rates.append(rates[-1] - turning[k])
        rates += [ego.trailer_yaw_rate] * (units > 1)
        folds = [ego.articulation, *ego.rear_articulations][: units - 1]
        swings = [math.sin(fold) for fold in folds]
        drift = ego.lateral_speed / speed
        heading += math.asin(drift) - drift
        error = min(max(offset, -config.error_max), config.error_max)
        state = [*rates, *swings, error, heading, angle, self.demand, self.integral]
        count = round(config.preview_time / CONTROL_PERIOD)
        ages = np.linspace(0.0, config.preview_time, count + 1)
        ahead = view.curvature(ego.station + speed * ages)
        rate = -dot(gains.feedback, state) - dot(gains.preview, ahead)
        push = self.trust(speed) * self.observer.update(np.array([*rates, *swings, angle]), gains)
        rate -= dot(gains.disturbance, push)
        self.move(rate, offset, speed)
        near = float(np.add.reduce(ahead[: self.near])) / self.near
        later = float(np.add.reduce(ahead[self.near : 2 * self.near])) / self.near
        share = 1.0 - math.exp(-CONTROL_PERIOD / config.steady_time)
        self.lasting += share * (push - self.lasting)
        steady = speed**2 * near / gains.response + dot(gains.balance, self.lasting)
        step = config.preview_time / count
        jerk = speed**2 * (later - near) / (self.near * step)
        across = ego.lateral_speed + speed * heading
        trusted = self.trust(speed) == 1.0
        self.rest.update(steady, gains.response, across, jerk, trusted, self)
        wanted = self.quieted(steady, gains.response)
        share = self.rest.crossing(wanted - steady)
        self.wheel = self.play.turn(math.asin(wanted), gains.response, share)
        return self.wheel

    def idle(self, response):
        """Angle below which a correction is not worth a crossing [rad]."""
        return min(self.config.idle_angle, self.config.idle_acceleration / response)

    def quieted(self, steady, response):
        """Sine of the demand without corrections that are too small for a crossing."""
        beyond = self.demand - steady
        idle = self.rest.idle_share * self.idle(response)
        gentle = min(max(self.rest.gentle, -idle), idle)
        wanted = steady + gentle + math.copysign(max(abs(beyond) - idle, 0.0), beyond)
        return min(max(wanted, -self.most), self.most)

    def move(self, rate, offset, speed):
        """Advances the demanded angle and the integral."""
        config, steering = self.config, self.parameters.steering
        limit = steering.rate_max / steering.ratio
        demand = self.demand + min(max(rate, -limit), limit) * CONTROL_PERIOD
        self.demand = min(max(demand, -self.most), self.most)
        if abs(offset) < config.integral_error_max and speed > 2.0:
            error = min(max(offset, -config.error_max), config.error_max)
            grown = self.integral + error * CONTROL_PERIOD
            self.integral = min(max(grown, -config.integral_max), config.integral_max)

    def trust(self, speed):
        """Share of the disturbance that counts."""
        low, high = self.config.disturbance_speed
        return min(max((speed - low) / (high - low), 0.0), 1.0)


# --- powertrain -----------------------------------------------------------------------------


def interpolate(x, places, values):
    """Linear interpolation of one value; the same bits as `np.interp`, faster on lists."""
    row = bisect_right(places, x) - 1
    if row < 0:
        return values[0]
    low, value = places[row], values[row]
    if row == len(places) - 1 or low == x:
        return value
    return (values[row + 1] - value) / (places[row + 1] - low) * (x - low) + value


class EnduranceForces(NamedTuple):
    """Greatest braking forces at the wheels without friction [N]."""

    drag: float
    engine_brake: float
    retarder: float


class Retardation(NamedTuple):
    """Shares of the brakes, 0 to 1, and the remainder for friction [N]."""

    engine_brake: float
    retarder: float
    short: float


def share_out(force, endurance):
    """Divides a braking force: engine drag, engine brake, retarder, friction in this order."""
    rest, shares = max(force - endurance.drag, 0.0), []
    for available in endurance[1:]:
        shares.append(min(rest / available, 1.0) if available > 0.0 else 0.0)
        rest = max(rest - available, 0.0) if available > 0.0 else rest
    return Retardation(*shares, rest)


class Actuation(NamedTuple):
    """What each actuator does for a force at the wheels; see the kernel's `Actuation`."""

    torque: float = 0.0
    drag: float = 0.0
    pedal: float = 0.0
    beyond: float = 0.0
    engine_brake: float = 0.0
    retarder: float = 0.0
    lacking: float = 0.0


class Powertrain:
    """Static inverse of engine and driveline, and the truck's resistances."""

    def __init__(self, parameters):
        self.parameters = parameters
        tires, air, gearbox = parameters.tires, parameters.aerodynamics, parameters.gearbox
        self.radius = tires[parameters.lead.axles[-1].tire].rolling_radius
        self.rolling = rolling_resistance(parameters, parameters.payload_max)
        self.drag = 0.5 * air.density * air.drag_area
        self.wheel_mass = sum(
            2.0 * axle.wheel_inertia_spin / tires[axle.tire].rolling_radius ** 2
            for axle in parameters.axles
        )
        self.efficiency = gearbox.efficiency * gearbox.driveline_efficiency

    def _row(self, gear):
        return min(max(gear, 1), len(self.parameters.gearbox.ratios)) - 1

    def ratio(self, gear):
        """Overall ratio engine to wheel in a forward gear."""
        gearbox = self.parameters.gearbox
        return float(gearbox.ratios[self._row(gear)]) * gearbox.final_drive

    def resistance(self, mass, speed, grade):
        """Rolling, air and grade resistance [N] at a grade (rise over run)."""
        slope = math.atan(grade)
        rolling = self.rolling * math.cos(slope) if speed > 0.05 else 0.0
        return mass * GRAVITY * (math.sin(slope) + rolling) + self.drag * speed * abs(speed)

    def effective_mass(self, mass, gear):
        """Mass with the rotating parts of wheels, engine and gearbox [kg]."""
        engine, gearbox = self.parameters.engine, self.parameters.gearbox
        inertia = engine.inertia + float(gearbox.inertias[self._row(gear)])
        spin = inertia * self.ratio(gear) ** 2 / self.radius**2
        return mass + self.wheel_mass + spin

    def engine_torque(self, force, gear):
        """Torque at the crankshaft [N m] for a force at the wheels [N]."""
        bare = force * self.radius / self.ratio(gear)
        return bare / self.efficiency if bare > 0.0 else bare * self.efficiency

    def drag_torque(self, engine_speed):
        """Drag of the engine on overrun [N m], positive."""
        engine = self.parameters.engine
        return float(np.interp(engine_speed, engine.drag_speed, engine.drag_torque))

    def engine_brake_torque(self, engine_speed):
        """Greatest torque of the engine brake beyond the drag [N m]."""
        engine = self.parameters.engine
        above = engine_speed - engine.engine_brake_speed_min
        if above <= 0.0:
            return 0.0
        rated = engine.engine_brake_power / engine.engine_brake_speed
        relative = engine_speed / engine.engine_brake_speed
        torque = rated * relative ** (engine.engine_brake_exponent - 1.0)
        return min(above / engine.engine_brake_fade, 1.0) * torque

    def retarder_torque(self, shaft_speed):
        """Greatest torque of the cold retarder at the propeller shaft [N m]."""
        retarder = self.parameters.retarder
        if shaft_speed <= 0.0:
            return 0.0
        rise = min(shaft_speed / retarder.full_torque_speed, 1.0)
        return min(retarder.torque_max * rise**2, retarder.power_max / shaft_speed)

    def endurance(self, speed, engine_speed, gear, engaged):
        """Forces of drag, engine brake and retarder at the wheels, increased by losses."""
        gearbox = self.parameters.gearbox
        shaft = gearbox.final_drive / self.radius
        retarder = self.retarder_torque(speed * shaft) * shaft / gearbox.driveline_efficiency
        if not engaged:
            return EnduranceForces(0.0, 0.0, retarder)
        factor = self.ratio(gear) / self.radius / self.efficiency
        brake = factor * self.engine_brake_torque(engine_speed)
        return EnduranceForces(factor * self.drag_torque(engine_speed), brake, retarder)

    def pedal(self, torque, engine_speed):
        """Accelerator pedal, 0 to 1, that gives a torque at the crankshaft [N m]."""
        table = self.parameters.engine.pedal_map
        row = min(max(bisect_left(table.rows, engine_speed) - 1, 0), len(table.rows) - 2)
        low, high = table.rows[row : row + 2].tolist()
        share = min(max((engine_speed - low) / (high - low), 0.0), 1.0)
        drag = self.drag_torque(engine_speed)
        fade = np.minimum(1.0, table.columns / self.parameters.engine.pedal_fade)
        torques = (1.0 - share) * table.values[row] + share * table.values[row + 1]
        torques = np.maximum.accumulate(fade * (torques + drag) - drag)
        torques = torques + 1e-6 * np.arange(len(torques))
        return interpolate(torque, torques.tolist(), table.columns.tolist())

    def actuation(self, force, speed, engine_speed, gear, engaged, speed_soon):
        """What each actuator does for a force at the wheels [N]."""
        torque, drag = self.engine_torque(force, gear), self.drag_torque(engine_speed)
        now = self.endurance(speed, engine_speed, gear, engaged)
        shared = share_out(-force, now)
        soon = engine_speed * speed_soon / max(speed, 0.1)
        later = share_out(-force, self.endurance(speed_soon, soon, gear, engaged))
        beyond = max(-force - now.drag, 0.0)
        pedal = self.pedal(torque, engine_speed)
        lacking = max(shared.short, later.short)
        return Actuation(torque, drag, pedal, beyond, *shared[:2], lacking)
