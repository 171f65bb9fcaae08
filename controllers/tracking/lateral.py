"""Path tracking: steering wheel angle from the planned path.

State feedback with preview of curvature and with the observed disturbance, see `lateral_gains`; the
gains are computed once per mass. A slow integral removes the remaining error; `SteeringPlay` then
inverts the play of the steering gear.

The model is one of small angles. In tight turns the controller uses the relations that are exact in
a steady turn without tire slip: `sin(delta) = L r / V`, course `psi + asin(w / V)`, with V the
speed of the steer axle.
"""

from __future__ import annotations

import functools
import math
import operator
from bisect import bisect_right
from collections.abc import Callable

import numpy as np

from controllers.tracking.lateral_gains import Gains, LateralConfig, LateralGains, PlayConfig
from controllers.tracking.lateral_model import LateralModel
from iits_mj.core.arrays import FloatArray
from iits_mj.core.errors import InputError
from iits_mj.core.messages import EgoState, Trajectory
from iits_mj.core.timing import CONTROL_PERIOD
from iits_mj.parameters import Steering, TruckParameters

# Change of mass at which the gains are computed again [kg].
_MASS_STEP = 200.0
# Values of the truck's state that steering uses.
USED = (
    "time",
    "x",
    "y",
    "yaw",
    "speed",
    "lateral_speed",
    "yaw_rate",
    "trailer_yaw_rate",
    "articulation",
    "steering_wheel_angle",
    "road_wheel_angle",
    "mass",
    "station",
)


class PathView:
    """A trajectory prepared for lookups of offset, heading error and curvature by station.

    Args:
      trajectory: planned; its stations never fall.
    """

    def __init__(self, trajectory: Trajectory) -> None:
        self.trajectory = trajectory
        self.station = trajectory.station
        yaw = trajectory.yaw
        continuous = bool((np.abs(yaw[1:] - yaw[:-1]) < np.pi).all())
        self.yaw = yaw if continuous else np.unwrap(yaw)
        self._last = self.station.item(-1), trajectory.curvature.item(-1)
        # The same as lists, for lookups of one station.
        self._places, self._yaws = self.station.tolist(), self.yaw.tolist()
        self._x, self._y = trajectory.x.tolist(), trajectory.y.tolist()

    def error(self, ego: EgoState) -> tuple[float, float]:
        """Offset to the left of the path [m] and heading error [rad] at the truck's station."""
        places, yaws, xs, ys = self._places, self._yaws, self._x, self._y
        row = min(max(bisect_right(places, ego.station) - 1, 0), len(places) - 2)
        start, end = places[row], places[row + 1]
        # The path continues straight beyond its ends.
        way = ego.station - start
        share = way / (end - start) if end > start else 0.0
        held = min(max(share, 0.0), 1.0)
        turn = yaws[row + 1] - yaws[row]
        yaw = yaws[row] + held * turn
        x = xs[row] + share * (xs[row + 1] - xs[row])
        y = ys[row] + share * (ys[row + 1] - ys[row])
        # The points are ends of chords: the path deviates from them by the sagitta.
        bulge = 0.5 * turn * (end - start) * held * (1.0 - held)
        error = -math.sin(yaw) * (ego.x - x) + math.cos(yaw) * (ego.y - y) + bulge
        turned = ego.yaw - yaw
        return error, math.atan2(math.sin(turned), math.cos(turned))

    def curvature(self, stations: FloatArray) -> FloatArray:
        """Mean curvature [1/m] between rising stations of shape (n + 1,); shape (n,).

        It is the change of heading over distance; beyond the path's end the last curvature holds.
        """
        yaw = np.interp(stations, self.station, self.yaw)
        end, curvature = self._last
        if stations[-1] > end:
            yaw += curvature * np.maximum(stations - end, 0.0)
        return np.asarray((yaw[1:] - yaw[:-1]) / (stations[1:] - stations[:-1]))


class DisturbanceObserver:
    """Estimates the lateral disturbance by wind, cross slope and model error; one call per step.

    It compares the truck's lateral motion with the prediction of the linear model one step ago. The
    difference, as three accelerations of (lateral speed, yaw rate, trailer yaw rate), passes a
    first-order filter (disturbance observer, Ohnishi 1987). A gust appears in the yaw rates long
    before the truck leaves its path.

    Attributes:
      value: the estimate, (3,) [m/s2, rad/s2, rad/s2].
    """

    def __init__(self, time: float) -> None:
        """Filters with a time constant `time` [s]."""
        self._share = 1.0 - float(np.exp(-CONTROL_PERIOD / time))
        self.reset()

    def reset(self) -> None:
        """Clears the estimate and the prediction."""
        self.value = np.zeros(3)
        self._expected: FloatArray | None = None

    def update(self, state: FloatArray, gains: Gains) -> FloatArray:
        """The estimate after a step.

        Args:
          state: (w, r, r_t, articulation, road wheel angle) now, (5,).
          gains: at the present speed.
        """
        if self._expected is not None:
            seen = gains.blame @ (state[:3] - self._expected)
            self.value = self.value + self._share * (seen - self.value)
        self._expected = gains.motion @ state
        return self.value

    def rest(self) -> None:
        """Clears the prediction and lets the estimate decay, for steps without steering."""
        self._expected = None
        self.value = (1.0 - self._share) * self.value


class SteeringPlay:
    """Inverse of the steering gear's play; one call per control step.

    The gear's output follows the steering wheel only while one of the two flanks of its play is in
    contact; on a reversal the wheel must first cross the play while the road wheels rest. Crossing
    at every small reversal would make the wheel jump to and fro in a long bend. The wheel therefore
    stays on its flank until the missing angle on the other side is large enough, and then crosses
    at a steady rate. The inverse of play is that of Tao and Kokotovic (1996), with hysteresis and a
    bounded rate.

    Args:
      steering: ratio and width of the play.
      config: see `PlayConfig`.
    """

    def __init__(self, steering: Steering, config: PlayConfig) -> None:
        self.steering = steering
        self.config = config
        self.reset()

    def reset(self) -> None:
        """Clears the state of the gear."""
        self._output: float | None = None
        self._flank = 1.0
        self._wheel = 0.0

    def follow(self, wheel: float, road_wheel: float) -> float:
        """Updates and returns the gear's output on the steering wheel's side [rad].

        The measured wheel drags the output along within the play. Only the first call reads it from
        the road wheels, whose compliance would disturb it later.

        Args:
          wheel: angle of the steering wheel as measured [rad].
          road_wheel: mean angle of the road wheels as measured [rad].
        """
        half = 0.5 * self.steering.dead_band
        if self._output is None:
            self._output = road_wheel * self.steering.ratio
            self._flank = math.copysign(1.0, wheel - self._output)
            self._wheel = wheel
        self._output = min(max(self._output, wheel - half), wheel + half)
        return self._output

    def turn(self, demand: float, gain: float) -> float:
        """Steering wheel angle [rad] that brings the gear's output to the demand.

        Args:
          demand: of the road wheels' angle [rad].
          gain: lateral acceleration by road wheel angle, steady [m/s2 per rad].
        """
        config, ratio = self.config, self.steering.ratio
        half = 0.5 * self.steering.dead_band
        output = demand * ratio if self._output is None else self._output
        missing = demand * ratio - output
        bearable = min(config.missing_angle, config.missing_acceleration / max(gain, 1e-6))
        if missing * self._flank < -bearable * ratio:
            self._flank = -self._flank
        # The wheel never moves off its flank toward the play.
        target = output + self._flank * (max(missing * self._flank, 0.0) + half)
        contact = output + self._flank * half
        reach = config.crossing_rate * CONTROL_PERIOD
        crossed = (contact - self._wheel) * self._flank
        if crossed > reach:
            self._wheel += self._flank * reach
        else:
            self._wheel = target
        most = self.steering.angle_max
        self._wheel = min(max(self._wheel, -most), most)
        return self._wheel


class LateralController:
    """Steers along a trajectory; one call every 20 ms.

    Attributes:
      error: offset to the left of the path at the last call [m].
    """

    def __init__(self, parameters: TruckParameters, config: LateralConfig | None = None) -> None:
        self.parameters = parameters
        self.config = config = config or LateralConfig()
        self._mass = math.nan
        self._gains: LateralGains | None = None
        count = round(config.preview_time / CONTROL_PERIOD) + 1
        self._ages: FloatArray = np.linspace(0.0, config.preview_time, count)
        # Sine of the road wheels' greatest angle.
        self._most = math.sin(parameters.steering.angle_max / parameters.steering.ratio)
        self._steady_share = 1.0 - math.exp(-CONTROL_PERIOD / config.steady_time)
        self._near = max(1, round(2.0 * config.lag / CONTROL_PERIOD))
        self._play = SteeringPlay(parameters.steering, config.play)
        self._observer = DisturbanceObserver(config.disturbance_time)
        self.reset()

    def reset(self) -> None:
        """Clears everything but the gains."""
        self.error = 0.0
        self._demand: float | None = None
        self._integral = 0.0
        self._lasting = np.zeros(3)
        self._wheel = 0.0
        self._view: PathView | None = None
        self._play.reset()
        self._observer.reset()

    def steer(self, ego: EgoState, trajectory: Trajectory) -> float:
        """Steering wheel angle [rad], positive to the left."""
        config = self.config
        if self._view is None or self._view.trajectory is not trajectory:
            self._view = PathView(trajectory)
        self.error, heading = self._view.error(ego)
        if self._demand is None:
            self._demand = math.sin(ego.road_wheel_angle)
            self._wheel = ego.steering_wheel_angle
        self._play.follow(ego.steering_wheel_angle, ego.road_wheel_angle)
        if ego.speed < config.speed_min:
            self._observer.rest()
            return self._wheel
        speed = math.hypot(ego.speed, ego.lateral_speed)
        gains = self._gains_for(ego.mass).at(speed)
        angle = math.sin(ego.road_wheel_angle)
        swing = math.sin(ego.articulation)
        rates = ego.lateral_speed, ego.yaw_rate, ego.trailer_yaw_rate
        motion = np.array([*rates, swing, angle])
        drift = ego.lateral_speed / speed
        heading += math.asin(drift) - drift
        error = min(max(self.error, -config.error_max), config.error_max)
        state = np.array([*rates, swing, error, heading, angle, self._demand, self._integral])
        ahead = self._view.curvature(ego.station + speed * self._ages)
        rate = -float(gains.feedback @ state) - float(gains.preview @ ahead)
        push = self._trust(speed) * self._observer.update(motion, gains)
        rate -= float(gains.disturbance @ push)
        self._move(rate, error, speed)
        near = float(np.add.reduce(ahead[: self._near])) / self._near
        self._lasting += self._steady_share * (push - self._lasting)
        steady = speed**2 * near / gains.response + float(gains.balance @ self._lasting)
        self._wheel = self._play.turn(math.asin(self._quieted(steady, gains)), gains.response)
        return self._wheel

    def _quieted(self, steady: float, gains: Gains) -> float:
        """Sine of the demand without corrections that are too small for a crossing of the play.

        `steady` is the sine of the angle for the path and the disturbance alone.
        """
        beyond = (self._demand or 0.0) - steady
        idle = min(self.config.idle_angle, self.config.idle_acceleration / gains.response)
        wanted = steady + math.copysign(max(abs(beyond) - idle, 0.0), beyond)
        return min(max(wanted, -self._most), self._most)

    def _move(self, rate: float, error: float, speed: float) -> None:
        """Advances the demanded angle, within the limits of the gear, and the integral."""
        config, steering = self.config, self.parameters.steering
        limit = steering.rate_max / steering.ratio
        demand = (self._demand or 0.0) + min(max(rate, -limit), limit) * CONTROL_PERIOD
        self._demand = min(max(demand, -self._most), self._most)
        if abs(self.error) < config.integral_error_max and speed > 2.0:
            grown = self._integral + error * CONTROL_PERIOD
            self._integral = min(max(grown, -config.integral_max), config.integral_max)

    def _trust(self, speed: float) -> float:
        """Share of the disturbance that counts: at walking pace it is mostly model error."""
        low, high = self.config.disturbance_speed
        return min(max((speed - low) / (high - low), 0.0), 1.0)

    def _gains_for(self, mass: float) -> LateralGains:
        if self._gains is None or not abs(mass - self._mass) < _MASS_STEP:
            model = LateralModel.of(self.parameters, mass, self.config.lag)
            self._gains = LateralGains.design(model, self.config)
            self._mass = mass
        return self._gains


def check_finite(ego: EgoState, names: tuple[str, ...]) -> None:
    """Raises InputError unless the named values of a state are finite."""
    if all(map(math.isfinite, _reader(names)(ego))):
        return
    for name in names:
        value = getattr(ego, name)
        if not math.isfinite(value):
            raise InputError(f"state of the truck: {name} is {value}: must be finite")


@functools.cache
def _reader(names: tuple[str, ...]) -> Callable[[EgoState], tuple[float, ...]]:
    return operator.attrgetter(*names)
