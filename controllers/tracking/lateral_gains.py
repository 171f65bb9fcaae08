"""Linear-quadratic preview gains of the steering over speed, and the settings of path tracking.

Linear-quadratic preview control (Tomizuka 1976; Sharp and Valtetsidou 2001): feedback of the full
state with the articulations, plus feed-forward of the path's curvature over the coming seconds and
of the observed disturbance, assumed to last. One Riccati equation per speed gives all three.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import NamedTuple

import numpy as np
from scipy.linalg import solve_discrete_are

from controllers.tracking.lateral_model import LateralModel
from iits_mj.core.arrays import FloatArray
from iits_mj.core.checks import require_positive
from iits_mj.core.errors import InputError
from iits_mj.core.timing import CONTROL_PERIOD


@dataclass(frozen=True)
class PlayConfig:
    """Settings of crossing the steering gear's play.

    Attributes:
      missing_acceleration: lateral acceleration that may be missing before a crossing [m/s2].
      missing_angle: the same as road wheel angle, at low speed [rad].
      crossing_rate: of the steering wheel [rad/s].
    """

    missing_acceleration: float = 0.03
    missing_angle: float = 1e-3
    crossing_rate: float = 0.35


@dataclass(frozen=True)
class CalmConfig:
    """Settings of the steering wheel's rest in calm.

    With the wheel's angle held, the truck's offset e, its drift v across the path and the lateral
    acceleration a beyond the steady one give the error `e + v t + a t^2 / 2`.

    Attributes:
      strength: calm are corrections below this multiple of the idle angle.
      strength_time: time constant with which a greater correction is forgotten [s].
      horizon: of the predicted error [s].
      settled: change of the error over the horizon below which the wheel rests [m].
      rest_error: predicted error that ends the rest [m].
      return_time: in which the wanted drift leads back to the path [s].
      settle_time: in which a correction changes the drift to the wanted one [s].
      delay: from the decision to cross the play to the truck's response [s].
      drift_time: time constant of the drift's filter [s].
      path_jerk: change of the path's lateral acceleration that suspends the rest [m/s3].
      missing_share: of `PlayConfig`'s missing angles, for the way to the steady angle.

    Raises:
      InputError: a number is not positive and finite.
    """

    strength: float = 2.0
    strength_time: float = 6.7
    horizon: float = 3.0
    settled: float = 0.01
    rest_error: float = 0.03
    return_time: float = 6.0
    settle_time: float = 1.0
    delay: float = 0.5
    drift_time: float = 0.5
    path_jerk: float = 0.2
    missing_share: float = 0.3

    def __post_init__(self) -> None:
        require_positive(self, *(entry.name for entry in fields(self)))


@dataclass(frozen=True)
class LateralConfig:
    """Weights and limits of the steering controller.

    Attributes:
      offset_weight: on the steer axle's offset [1/m2].
      course_weight: on the speed across the path [s2/m2].
      articulation_weight: on the rate of each articulation [s2/rad2].
      integral_weight: on the integral of the offset [1/(m2 s2)].
      rate_weight: on the rate of the road wheel angle [s2/rad2].
      rate_speed: below it `rate_weight` falls with the fourth power of speed, since the path
        responds with the square [m/s]; rate_weight_min: its least value [s2/rad2].
      preview_time: of curvature [s].
      lag: steering and tire relaxation [s].
      speed_grid: [m/s], rising.
      disturbance_time: time constant of the disturbance's estimate [s].
      steady_time: time constant of the lasting disturbance [s].
      disturbance_speed: above the first of these speeds the disturbance counts, above the second
        fully [m/s].
      idle_acceleration: lateral acceleration of the greatest omitted correction [m/s2].
      idle_angle: the same as road wheel angle, at low speed [rad].
      error_max: greatest offset in the feedback [m].
      integral_error_max: offset above which the integral does not change [m].
      integral_max: [m s].
      speed_min: speed below which the wheel is held [m/s].
      play: see `PlayConfig`; calm: see `CalmConfig`.

    Raises:
      InputError: a number is not positive and finite, or the speeds do not rise.
    """

    offset_weight: float = 1.0
    course_weight: float = 0.2
    articulation_weight: float = 5.0
    integral_weight: float = 0.003
    rate_weight: float = 50.0
    rate_speed: float = 12.0
    rate_weight_min: float = 0.1
    preview_time: float = 2.0
    lag: float = 0.12
    speed_grid: tuple[float, ...] = (1.0, 2.0, 4.0, 7.0, 10.0, 13.0, 16.0, 19.0, 22.0, 25.0, 28.0)
    disturbance_time: float = 0.18
    steady_time: float = 1.0
    disturbance_speed: tuple[float, float] = (3.0, 6.0)
    idle_acceleration: float = 0.06
    idle_angle: float = 2e-3
    error_max: float = 1.0
    integral_error_max: float = 0.6
    integral_max: float = 3.0
    speed_min: float = 0.3
    play: PlayConfig = field(default_factory=PlayConfig)
    calm: CalmConfig = field(default_factory=CalmConfig)

    def __post_init__(self) -> None:
        require_positive(self, *(entry.name for entry in fields(self) if entry.type == "float"))
        grid = np.array(self.speed_grid)
        if not (len(grid) > 1 and grid[0] > 0.0 and np.all(np.diff(grid) > 0.0)):
            raise InputError(
                f"LateralConfig: speed_grid is {self.speed_grid}: at least two positive, rising "
                "speeds are needed"
            )


class Gains(NamedTuple):
    """Gains and model of n units at one speed, in the kernel's order.

    Attributes:
      speed: [m/s].
      response: steady lateral acceleration by road wheel angle [m/s2 per rad].
      feedback: of the state, (2 n + 5,).
      disturbance: of the disturbing accelerations of (w, r of each unit), (n + 1,).
      motion: (w, r) a step later as a product with (w, r, articulations, delta), (n + 1, 2 n + 1).
      blame: disturbing accelerations from the prediction error of (w, r), (n + 1, n + 1).
      balance: road wheel angle that holds a disturbance on a straight path, (n + 1,).
      preview: of the curvatures ahead, (previews,).
    """

    speed: float
    response: float
    feedback: FloatArray
    disturbance: FloatArray
    motion: FloatArray
    blame: FloatArray
    balance: FloatArray
    preview: FloatArray


@dataclass(frozen=True)
class LateralGains:
    """Gains at the speeds of a grid, between which the kernel interpolates.

    Attributes:
      gains: by speed.
      previews: number of curvatures ahead.
      table: all numbers, speed by speed, as the kernel reads them.
    """

    gains: tuple[Gains, ...]
    previews: int
    table: bytes

    @classmethod
    def design(cls, model: LateralModel, config: LateralConfig) -> LateralGains:
        """Solves the Riccati equation at every speed of the grid."""
        gains = tuple(_design(model, speed, config) for speed in config.speed_grid)
        table = np.concatenate([np.ravel(value) for row in gains for value in row])
        return cls(gains, len(gains[0].preview), table.tobytes())


def _design(model: LateralModel, speed: float, config: LateralConfig) -> Gains:
    a, b, e, disturb = model.discrete(speed, CONTROL_PERIOD)
    share = min(1.0, speed / config.rate_speed) ** 4
    rate = np.array([[max(config.rate_weight * share, config.rate_weight_min)]])
    riccati = solve_discrete_are(a, b, state_weight(model, speed, config), rate)
    inverse = np.linalg.inv(rate + b.T @ riccati @ b)
    gain = inverse @ b.T @ riccati @ a
    closed = (a - b @ gain).T
    # Preview: u = -K x - sum_k inv B' (Acl')^k P E kappa_k.
    row, term = [], riccati @ e
    for _ in range(round(config.preview_time / CONTROL_PERIOD)):
        row.append((inverse @ b.T @ term).item())
        term = closed @ term
    # The last curvature is assumed to last beyond the preview, the disturbance from now on.
    forever = np.eye(len(a)) - closed
    row[-1] += (inverse @ b.T @ np.linalg.solve(forever, term)).item()
    lasting = inverse @ b.T @ np.linalg.solve(forever, riccati @ disturb)
    rates, motions = model.rates, model.motions
    delta = motions + 2
    return Gains(
        speed=speed,
        response=model.steady_acceleration(speed),
        feedback=gain[0],
        disturbance=lasting[0],
        # Over a step the road wheel angle stays at its measured value.
        motion=np.column_stack([a[:rates, :motions], a[:rates, delta] + a[:rates, delta + 1]]),
        blame=np.asarray(np.linalg.inv(disturb[:rates]), dtype=float),
        balance=model.balance(speed),
        preview=np.array(row),
    )


def state_weight(model: LateralModel, speed: float, config: LateralConfig) -> FloatArray:
    """Quadratic weight of the state, square; all of it vanishes in a steady curve."""
    offset = model.motions
    n = offset + 5
    weight = np.zeros((n, n))
    weight[offset, offset] = config.offset_weight
    course = np.zeros(n)
    course[0], course[offset + 1] = 1.0, speed
    weight += config.course_weight * np.outer(course, course)
    for unit in range(1, model.rates - 1):
        swing = np.zeros(n)
        swing[unit], swing[unit + 1] = 1.0, -1.0
        weight += config.articulation_weight * np.outer(swing, swing)
    weight[-1, -1] = config.integral_weight
    return weight
