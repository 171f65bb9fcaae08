"""Path tracking: steering wheel angle from the planned path.

State feedback with preview of curvature and with the observed disturbance, see `lateral_gains`; the
gains are computed once per mass. A slow integral removes the remaining error. The law itself is
compiled, in `iits_mj/kernels/lateral.cc`.

The model is one of small angles. In tight turns the controller uses the relations that are exact in
a steady turn without tire slip: `sin(delta) = L r / V`, course `psi + asin(w / V)`, with V the
speed of the steer axle.

The observer estimates the lateral disturbance by wind, cross slope and model error. It compares the
truck's lateral motion with the prediction of the linear model one step ago. The difference, as
accelerations of (lateral speed, yaw rate of each unit), passes a first-order filter (disturbance
observer, Ohnishi 1987). A gust appears in the yaw rates long before the truck leaves
its path.

The output of the steering gear follows the steering wheel only while one of the two flanks of its
play is in contact; on a reversal the wheel must first cross the play while the road wheels rest.
Crossing at every small reversal would make the wheel jump to and fro in a long bend. The wheel
therefore stays on its flank until the missing angle on the other side is large enough, and then
crosses at a steady rate. The inverse of play is that of Tao and Kokotovic (1996), with hysteresis
and a bounded rate.

In calm, a dead zone on the angle alone has a limit cycle: it leaves the truck without feedback, the
truck drifts from one side of its path to the other, and the loop of double integrator and
hysteresis crosses the play at both ends. In calm, the wheel therefore rests at the steady angle
itself. A gentle correction of the drift comes before, and ends early enough for the way back
through the play. The rest lasts until the predicted error is no longer bearable. Where the path's
curvature changes, the wheel moves anyway, and corrections along its way need no crossing. A greater
correction ends the calm for some seconds, see `CalmConfig`.
"""

from __future__ import annotations

import ctypes
import functools
import math
import operator
import struct
from collections.abc import Callable

import numpy as np

from controllers.tracking.lateral_gains import LateralConfig, LateralGains
from controllers.tracking.lateral_model import LateralModel
from iits_mj import kernels
from iits_mj.core.errors import InputError
from iits_mj.core.messages import EgoState, Trajectory
from iits_mj.core.timing import CONTROL_PERIOD
from iits_mj.parameters import Steering, TruckParameters

# Change of mass at which the gains are computed again [kg].
_MASS_STEP = 200.0
# Values of the truck's state that the kernel reads, in its order; those of the units follow.
_TRUCK = (
    "x",
    "y",
    "yaw",
    "speed",
    "steering_wheel_angle",
    "road_wheel_angle",
    "station",
    "lateral_speed",
)
_read = operator.attrgetter(*_TRUCK)
# Values of the truck's state that steering uses.
USED = ("time", "mass", *_TRUCK, "yaw_rate", "trailer_yaw_rate", "articulation")


class Memory(ctypes.Structure):
    """What the steering law remembers between its steps.

    Attributes:
      started: 0 before the first step.
      error: offset to the left of the path [m].
      demand: sine of the demanded road wheel angle.
      integral: of the offset [m s].
      wheel: steering wheel angle of the last command [rad].
      output: of the steering gear, as angle of the steering wheel [rad].
      flank: of the play that is in contact, 1 (left) or -1.
      asked: steering wheel angle that the inverse of the play asks for [rad].
      predicted: 0 while the observer has no prediction.
      strength: greatest correction of the last seconds over the idle angle, decaying.
      drift: speed across the path, filtered with the model [m/s].
      resting: 1 while the wheel rests in calm.
    """

    _fields_ = [
        *((name, kernels.Real) for name in ("started", "error", "demand", "integral", "wheel")),
        *((name, kernels.Real) for name in ("output", "flank", "asked", "predicted")),
        *((name, kernels.Real) for name in ("strength", "drift", "resting")),
    ]


def pack_path(trajectory: Trajectory) -> bytes:
    """Columns of a path for the kernel: station, yaw, x, y and curvature.

    Raises:
      InputError: the trajectory has a single point.
    """
    t = trajectory
    if len(t.station) < 2:
        raise InputError("a trajectory of 1 point cannot be tracked: at least two are needed")
    return np.concatenate((t.station, t.yaw, t.x, t.y, t.curvature), dtype=float).tobytes()


def pack_settings(config: LateralConfig, steering: Steering) -> bytes:
    """The settings of the law and of the steering gear, for the kernel."""
    numbers = (
        CONTROL_PERIOD,
        config.preview_time / round(config.preview_time / CONTROL_PERIOD),
        max(1, round(2.0 * config.lag / CONTROL_PERIOD)),
        config.speed_min,
        config.error_max,
        config.integral_error_max,
        config.integral_max,
        1.0 - float(np.exp(-CONTROL_PERIOD / config.disturbance_time)),
        1.0 - math.exp(-CONTROL_PERIOD / config.steady_time),
        *config.disturbance_speed,
        config.idle_angle,
        config.idle_acceleration,
        steering.ratio,
        0.5 * steering.dead_band,
        steering.angle_max,
        steering.rate_max / steering.ratio,
        math.sin(steering.angle_max / steering.ratio),
        config.play.missing_angle,
        config.play.missing_acceleration,
        config.play.crossing_rate * CONTROL_PERIOD,
        config.calm.strength,
        math.exp(-CONTROL_PERIOD / config.calm.strength_time),
        config.calm.horizon,
        config.calm.settled,
        config.calm.rest_error,
        config.calm.return_time,
        config.calm.settle_time,
        config.calm.delay,
        1.0 - math.exp(-CONTROL_PERIOD / config.calm.drift_time),
        config.calm.path_jerk,
        config.calm.missing_share,
    )
    return struct.pack(f"{len(numbers)}d", *numbers)


class LateralController:
    """Steers along a trajectory; one call every 20 ms.

    Attributes:
      memory: see `Memory`.
      observed: rows of the predicted (w, r of each unit), the estimate of their disturbing
        accelerations [m/s2, rad/s2], and its slow part, after trust and a low-pass filter; shape
        (3, units + 1).
    """

    def __init__(self, parameters: TruckParameters, config: LateralConfig | None = None) -> None:
        self.parameters = parameters
        self.config = config = config or LateralConfig()
        self._settings = pack_settings(config, parameters.steering)
        self._mass = math.nan
        self._gains: LateralGains | None = None
        self.reset()

    def reset(self) -> None:
        """Clears everything but the gains."""
        self.memory = Memory()
        self.observed = np.zeros((3, 1 + len(self.parameters.units)))
        self._trajectory: Trajectory | None = None
        self._path = b""

    @property
    def error(self) -> float:
        """Offset to the left of the path at the last call [m]."""
        return float(self.memory.error)

    def steer(self, ego: EgoState, trajectory: Trajectory) -> float:
        """Steering wheel angle [rad], positive to the left.

        Args:
          ego: the truck.
          trajectory: planned path of at least two points; its stations never fall.
        """
        if trajectory is not self._trajectory:
            self._path, self._trajectory = pack_path(trajectory), trajectory
        gains = self.gains(ego.mass)
        units = len(self.parameters.units)
        return _steer(
            self._settings,
            self.memory,
            kernels.address(self.observed),
            gains.table,
            len(gains.gains),
            gains.previews,
            self._path,
            len(trajectory.station),
            _packer(units)(*_read(ego), *unit_motions(ego, units)),
            units,
            math.hypot(ego.speed, ego.lateral_speed),
        )

    def gains(self, mass: float) -> LateralGains:
        """The gains for a truck's gross mass [kg]."""
        if self._gains is None or not abs(mass - self._mass) < _MASS_STEP:
            model = LateralModel.of(self.parameters, mass, self.config.lag)
            self._gains = LateralGains.design(model, self.config)
            self._mass = mass
        return self._gains


def unit_motions(ego: EgoState, units: int) -> list[float]:
    """Yaw rates of the units [rad/s], then the articulations between them [rad].

    Raises:
      InputError: the state has not this number of units.
    """
    if units == 1:
        return [ego.yaw_rate]
    if units == 2 and not ego.rear_articulations:
        return [ego.yaw_rate, ego.trailer_yaw_rate, ego.articulation]
    if len(ego.rear_articulations) != units - 2 or len(ego.rear_articulation_rates) != units - 2:
        raise InputError(
            f"state of the truck: rear_articulations are {ego.rear_articulations}, their rates "
            f"{ego.rear_articulation_rates}: {units - 2} are needed for {units} units"
        )
    rates = [ego.yaw_rate]
    for turning in (ego.articulation_rate, *ego.rear_articulation_rates[:-1]):
        rates.append(rates[-1] - turning)
    return [*rates, ego.trailer_yaw_rate, ego.articulation, *ego.rear_articulations]


def check_finite(ego: EgoState, names: tuple[str, ...]) -> None:
    """Raises InputError unless the named values of a state, and those behind, are finite."""
    rear = ego.rear_articulations + ego.rear_articulation_rates
    # A sum is finite only if all its terms are.
    if math.isfinite(sum(_reader(names)(ego)) + sum(rear)):
        return
    if rear and not math.isfinite(sum(rear)):
        raise InputError(
            f"state of the truck: articulations behind the first are {rear}: must be finite"
        )
    for name in names:
        value = getattr(ego, name)
        if not math.isfinite(value):
            raise InputError(f"state of the truck: {name} is {value}: must be finite")


@functools.cache
def _packer(units: int) -> Callable[..., bytes]:
    return struct.Struct(f"{len(_TRUCK) + 2 * units - 1}d").pack


@functools.cache
def _reader(names: tuple[str, ...]) -> Callable[[EgoState], tuple[float, ...]]:
    return operator.attrgetter(*names)


_steer = kernels.function(
    "iits_steer",
    kernels.Real,
    kernels.Address,
    ctypes.POINTER(Memory),
    *(kernels.Address, kernels.Address),  # observed values, gains
    *(kernels.Integer, kernels.Integer),
    *(kernels.Address, kernels.Integer),  # the path
    *(kernels.Address, kernels.Integer),  # the truck
    kernels.Real,
)
