"""Path tracking: steering wheel angle from the planned path.

Linear-quadratic preview control (Tomizuka 1976; Sharp and Valtetsidou 2001) of the
tractor-semitrailer: full state feedback, with articulation in it, plus the path's curvature over
the coming seconds. Gains are made once per mass on a grid of speeds and interpolated. A slow
integral takes out cross-slope and wind; an inverse of the steering's play follows at the end.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_discrete_are

from controllers.lateral_model import STATES, LateralModel
from iits_mj.errors import InputError
from iits_mj.messages import EgoState, Trajectory
from iits_mj.parameters import TruckParameters

FloatArray = NDArray[np.float64]
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


@dataclass(frozen=True)
class LateralConfig:
    """Weights and limits of the steering controller.

    Attributes:
      offset_weight: on the steer axle's offset [1/m2].
      course_weight: on the speed across the path [s2/m2].
      articulation_weight: on the articulation rate [s2/rad2].
      integral_weight: on the integral of the offset [1/(m2 s2)].
      rate_weight: on the rate of the road wheel angle [s2/rad2].
      preview_time: of curvature [s]; step: of the controller [s].
      lag: steering and tire relaxation [s].
      speed_grid: [m/s], rising.
      error_max: offset that the feedback sees at most [m].
      integral_error_max: beyond this offset the integral rests [m].
      integral_max: [m s].
      speed_min: below it the wheel is held [m/s].
      play_hysteresis: road wheel angle below which a reversal does not cross the play [rad].
    """

    offset_weight: float = 1.0
    course_weight: float = 0.2
    articulation_weight: float = 5.0
    integral_weight: float = 0.02
    rate_weight: float = 100.0
    preview_time: float = 2.0
    step: float = 0.02
    lag: float = 0.12
    speed_grid: tuple[float, ...] = (1.0, 2.0, 4.0, 7.0, 10.0, 13.0, 16.0, 19.0, 22.0, 25.0, 28.0)
    error_max: float = 1.0
    integral_error_max: float = 0.6
    integral_max: float = 3.0
    speed_min: float = 0.3
    play_hysteresis: float = 1e-4


@dataclass(frozen=True)
class LateralGains:
    """Feedback (k, 9) and preview (k, n) over the speed grid (k,)."""

    speed: FloatArray
    feedback: FloatArray
    preview: FloatArray

    @classmethod
    def design(cls, model: LateralModel, config: LateralConfig) -> LateralGains:
        """Solves the Riccati equation at every speed of the grid."""
        feedback, preview = [], []
        count = round(config.preview_time / config.step)
        for speed in config.speed_grid:
            a, b, e = model.discrete(speed, config.step)
            weight = _state_weight(speed, config)
            rate = np.array([[config.rate_weight]])
            riccati = solve_discrete_are(a, b, weight, rate)
            inverse = np.linalg.inv(rate + b.T @ riccati @ b)
            gain = inverse @ b.T @ riccati @ a
            closed = (a - b @ gain).T
            # Disturbance known ahead: u = -K x - sum_k inv B' (Acl')^k P E kappa_k.
            row, term = [], riccati @ e
            for _ in range(count):
                row.append((inverse @ b.T @ term).item())
                term = closed @ term
            # Beyond the preview the last curvature is taken to last.
            rest = np.linalg.solve(np.eye(len(STATES)) - closed, term)
            row[-1] += (inverse @ b.T @ rest).item()
            feedback.append(gain[0])
            preview.append(row)
        return cls(np.array(config.speed_grid), np.array(feedback), np.array(preview))

    def at(self, speed: float) -> tuple[FloatArray, FloatArray]:
        """Feedback (9,) and preview (n,) gains at a speed [m/s]."""
        grid = self.speed
        row = int(np.clip(np.searchsorted(grid, speed) - 1, 0, len(grid) - 2))
        share = float(np.clip((speed - grid[row]) / (grid[row + 1] - grid[row]), 0.0, 1.0))
        blend = [(1.0 - share) * g[row] + share * g[row + 1] for g in (self.feedback, self.preview)]
        return blend[0], blend[1]


def _state_weight(speed: float, config: LateralConfig) -> FloatArray:
    """Quadratic weight of the state, shape (9, 9)."""
    n = len(STATES)
    weight = np.zeros((n, n))
    weight[4, 4] = config.offset_weight
    course = np.zeros(n)
    course[0], course[5] = 1.0, speed
    swing = np.zeros(n)
    swing[1], swing[2] = 1.0, -1.0
    weight += config.course_weight * np.outer(course, course)
    weight += config.articulation_weight * np.outer(swing, swing)
    weight[8, 8] = config.integral_weight
    return weight


class LateralController:
    """Steers along a trajectory; one call every 20 ms."""

    def __init__(self, parameters: TruckParameters, config: LateralConfig | None = None) -> None:
        self.parameters = parameters
        self.config = config or LateralConfig()
        self._mass = math.nan
        self._gains: LateralGains | None = None
        self._ages = self.config.step * np.arange(
            round(self.config.preview_time / self.config.step)
        )
        self.reset()

    def reset(self) -> None:
        """Wheel straight, no memory; gains are kept."""
        self.error = 0.0
        self._demand: float | None = None
        self._lagged = 0.0
        self._integral = 0.0
        self._wheel = 0.0

    def steer(self, ego: EgoState, trajectory: Trajectory) -> float:
        """Steering wheel angle [rad], positive to the left."""
        config, steering = self.config, self.parameters.steering
        gains = self._gains_for(ego.mass)
        if self._demand is None:
            self._demand = self._lagged = ego.road_wheel_angle
            self._wheel = ego.steering_wheel_angle
        station = trajectory.station
        self.error, heading = path_error(ego, trajectory)
        if ego.speed < config.speed_min:
            return self._wheel
        error = float(np.clip(self.error, -config.error_max, config.error_max))
        state = np.array(
            [
                ego.lateral_speed,
                ego.yaw_rate,
                ego.trailer_yaw_rate,
                ego.articulation,
                error,
                heading,
                ego.road_wheel_angle,
                self._demand,
                self._integral,
            ]
        )
        feedback, preview = gains.at(ego.speed)
        ahead = np.interp(ego.station + ego.speed * self._ages, station, trajectory.curvature)
        rate = -float(feedback @ state) - float(preview @ ahead)
        limit = steering.rate_max / steering.ratio
        rate = min(max(rate, -limit), limit)
        self._demand += rate * config.step
        angle_max = steering.angle_max / steering.ratio
        self._demand = min(max(self._demand, -angle_max), angle_max)
        if abs(self.error) < config.integral_error_max and ego.speed > 2.0:
            grown = self._integral + error * config.step
            self._integral = min(max(grown, -config.integral_max), config.integral_max)
        self._wheel = self._across_play(self._demand, ego)
        return self._wheel

    def _across_play(self, demand: float, ego: EgoState) -> float:
        """Wheel angle that brings the road wheels to `demand` through the steering's play."""
        steering = self.parameters.steering
        half = 0.5 * steering.dead_band
        wanted = demand * steering.ratio
        # Where the gear's output stands: dragged along by the wheel within the play.
        low, high = ego.steering_wheel_angle - half, ego.steering_wheel_angle + half
        output = min(max(ego.road_wheel_angle * steering.ratio, low), high)
        slack = self.config.play_hysteresis * steering.ratio
        if wanted > output + slack:
            return wanted + half
        if wanted < output - slack:
            return wanted - half
        return self._wheel

    def _gains_for(self, mass: float) -> LateralGains:
        if self._gains is None or not abs(mass - self._mass) < 200.0:
            model = LateralModel.of(self.parameters, mass, self.config.lag)
            self._gains = LateralGains.design(model, self.config)
            self._mass = mass
        return self._gains


def path_error(ego: EgoState, trajectory: Trajectory) -> tuple[float, float]:
    """Offset to the left of the path [m] and heading error [rad] at the truck's station."""
    station = trajectory.station
    x = float(np.interp(ego.station, station, trajectory.x))
    y = float(np.interp(ego.station, station, trajectory.y))
    yaw = float(np.interp(ego.station, station, np.unwrap(trajectory.yaw)))
    error = -math.sin(yaw) * (ego.x - x) + math.cos(yaw) * (ego.y - y)
    turned = ego.yaw - yaw
    return error, math.atan2(math.sin(turned), math.cos(turned))


def check_finite(ego: EgoState, names: tuple[str, ...] = USED) -> None:
    """Holds the numbers that are used of a state to be finite.

    Raises:
      InputError: one of them is not.
    """
    for name in names:
        value = getattr(ego, name)
        if not math.isfinite(value):
            raise InputError(f"ego state: {name} is {value}: must be finite")
