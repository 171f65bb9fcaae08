"""Path tracking: steering wheel angle from the planned path.

State feedback with preview of curvature and with the disturbance that was seen, see
`lateral_gains`; the gains are made once per mass. A slow integral takes out what is left; the
gear's play is crossed last, see `steering_play`.

The model is that of small angles. Tight turns are put into its terms by what is exact in a steady
turn without tire slip: `sin(delta) = L r / V`, course `psi + asin(w / V)`, with V the speed of the
steer axle.
"""

from __future__ import annotations

import functools
import math
import operator
from bisect import bisect_right
from collections.abc import Callable

import numpy as np

from controllers.tracking.lateral_gains import Gains, LateralConfig, LateralGains, SteeringPlay
from controllers.tracking.lateral_model import LateralModel
from iits_mj.core.arrays import FloatArray
from iits_mj.core.errors import InputError
from iits_mj.core.messages import EgoState, Trajectory
from iits_mj.parameters import TruckParameters

# --- What steering sees of a trajectory: offset, heading error and the path's curvature ahead ---


class PathView:
    """A trajectory made ready for many looks at it.

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
        # The same as numbers, for one place.
        self._places, self._yaws = self.station.tolist(), self.yaw.tolist()
        self._x, self._y = trajectory.x.tolist(), trajectory.y.tolist()

    def error(self, ego: EgoState) -> tuple[float, float]:
        """Offset to the left of the path [m] and heading error [rad] at the truck's station."""
        places, yaws, xs, ys = self._places, self._yaws, self._x, self._y
        row = min(max(bisect_right(places, ego.station) - 1, 0), len(places) - 2)
        start, end = places[row], places[row + 1]
        # Off its ends the path goes on straight.
        way = ego.station - start
        share = way / (end - start) if end > start else 0.0
        held = min(max(share, 0.0), 1.0)
        turn = yaws[row + 1] - yaws[row]
        yaw = yaws[row] + held * turn
        x = xs[row] + share * (xs[row + 1] - xs[row])
        y = ys[row] + share * (ys[row + 1] - ys[row])
        # The points are ends of chords: the path bulges out between them by the sagitta.
        bulge = 0.5 * turn * (end - start) * held * (1.0 - held)
        error = -math.sin(yaw) * (ego.x - x) + math.cos(yaw) * (ego.y - y) + bulge
        turned = ego.yaw - yaw
        return error, math.atan2(math.sin(turned), math.cos(turned))

    def curvature(self, stations: FloatArray) -> FloatArray:
        """Mean curvature [1/m] between stations of shape (n + 1,), rising; shape (n,).

        It is the turn of the heading by the way; beyond the path's end the last curvature lasts.
        """
        yaw = np.interp(stations, self.station, self.yaw)
        end, curvature = self._last
        if stations[-1] > end:
            yaw += curvature * np.maximum(stations - end, 0.0)
        return np.asarray((yaw[1:] - yaw[:-1]) / (stations[1:] - stations[:-1]))


def path_error(ego: EgoState, trajectory: Trajectory) -> tuple[float, float]:
    """Offset to the left of the path [m] and heading error [rad] at the truck's station."""
    return PathView(trajectory).error(ego)


# --- Estimates what pushes the truck sideways besides its tires: wind, cross-slope, model error ---
# The truck's lateral motion is compared with what the linear model said a step ago; what is left,
# as three accelerations of (lateral speed, yaw rate, trailer yaw rate), is believed over a short
# time (disturbance observer with first-order filter, Ohnishi 1987). It sees a gust in the yaw rates
# long before the truck is off its path.


class DisturbanceObserver:
    """One call every control step.

    Attributes:
      value: the estimate, (3,) [m/s2, rad/s2, rad/s2].
    """

    def __init__(self, time: float, step: float) -> None:
        """Believes a disturbance over `time` [s], called every `step` [s]."""
        self._share = 1.0 - float(np.exp(-step / time))
        self.reset()

    def reset(self) -> None:
        """No disturbance, nothing remembered."""
        self.value = np.zeros(3)
        self._expected: FloatArray | None = None

    def update(self, state: FloatArray, gains: Gains) -> FloatArray:
        """The estimate after a step.

        Args:
          state: (w, r, r_t, articulation, road wheel angle) now, (5,).
          gains: of the present speed.
        """
        if self._expected is not None:
            seen = gains.blame @ (state[:3] - self._expected)
            self.value = self.value + self._share * (seen - self.value)
        self._expected = gains.motion @ state
        return self.value

    def rest(self) -> None:
        """Forgets the expectation: the next step is judged from anew; the estimate fades."""
        self._expected = None
        self.value = (1.0 - self._share) * self.value


# --- Path tracking: steering wheel angle from the planned path ---

# The mass may be off by this before gains are made anew [kg].
_MASS_STEP = 200.0
# What steering uses of the truck's state.
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
        count = round(config.preview_time / config.step) + 1
        self._ages: FloatArray = np.linspace(0.0, config.preview_time, count)
        # Sine of the road wheels' greatest angle.
        self._most = math.sin(parameters.steering.angle_max / parameters.steering.ratio)
        self._steady_share = 1.0 - math.exp(-config.step / config.steady_time)
        self._near = max(1, round(2.0 * config.lag / config.step))
        self._play = SteeringPlay(parameters.steering, config.play)
        self._observer = DisturbanceObserver(config.disturbance_time, config.step)
        self.reset()

    def reset(self) -> None:
        """Wheel straight, no memory; gains are kept."""
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
        self._wheel = self._play.turn(
            math.asin(self._quieted(steady, gains)), gains.response, config.step
        )
        return self._wheel

    def _quieted(self, steady: float, gains: Gains) -> float:
        """The demand less what of it is too little to be worth crossing the play.

        Args:
          steady: angle that the path and the disturbance need in themselves [rad].
          gains: of the present speed.
        """
        beyond = (self._demand or 0.0) - steady
        idle = min(self.config.idle_angle, self.config.idle_acceleration / gains.response)
        wanted = steady + math.copysign(max(abs(beyond) - idle, 0.0), beyond)
        return min(max(wanted, -self._most), self._most)

    def _move(self, rate: float, error: float, speed: float) -> None:
        """Moves the demanded angle, within what the gear can, and the integral."""
        config, steering = self.config, self.parameters.steering
        limit = steering.rate_max / steering.ratio
        demand = (self._demand or 0.0) + min(max(rate, -limit), limit) * config.step
        self._demand = min(max(demand, -self._most), self._most)
        if abs(self.error) < config.integral_error_max and speed > 2.0:
            grown = self._integral + error * config.step
            self._integral = min(max(grown, -config.integral_max), config.integral_max)

    def _trust(self, speed: float) -> float:
        """How much of the disturbance counts: at walking pace it is mostly model error."""
        low, high = self.config.disturbance_speed
        return min(max((speed - low) / (high - low), 0.0), 1.0)

    def _gains_for(self, mass: float) -> LateralGains:
        if self._gains is None or not abs(mass - self._mass) < _MASS_STEP:
            model = LateralModel.of(self.parameters, mass, self.config.lag)
            self._gains = LateralGains.design(model, self.config)
            self._mass = mass
        return self._gains


def check_finite(ego: EgoState, names: tuple[str, ...] = USED) -> None:
    """Holds the numbers that are used of a state to be finite.

    Raises:
      InputError: one of them is not.
    """
    if all(map(math.isfinite, _reader(names)(ego))):
        return
    for name in names:
        value = getattr(ego, name)
        if not math.isfinite(value):
            raise InputError(f"ego state: {name} is {value}: must be finite")


@functools.cache
def _reader(names: tuple[str, ...]) -> Callable[[EgoState], tuple[float, ...]]:
    return operator.attrgetter(*names)
