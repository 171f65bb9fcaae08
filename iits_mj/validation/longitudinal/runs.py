"""Records a straight drive under open-loop pedal and brake commands."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from iits_mj.core.arrays import FloatArray
from iits_mj.core.messages import EgoState, VehicleCommand, XbrMode
from iits_mj.road import RoadMap, Route
from iits_mj.road.design import Design, build
from iits_mj.truck import Truck
from iits_mj.validation.harness.recorder import PERIOD, sampled, wheel_slips

# --- Straight roads whose grade changes in parabolas: ramps for climbing and hills for the audit

_LANE_WIDTH = 4.0
_SPEED_LIMIT = 25.0
# (station of the change [m], grade after it, length of the parabola [m]).
Grade = tuple[float, float, float]
_HILLS: tuple[Grade, ...] = (
    (250.0, 0.03, 200.0),
    (700.0, -0.02, 250.0),
    (1100.0, 0.04, 250.0),
    (1600.0, -0.045, 300.0),
    (2050.0, 0.02, 300.0),
    (2700.0, 0.0, 200.0),
)
HILLS_LENGTH = 3000.0


def sloping(length: float, initial: float, grades: tuple[Grade, ...]) -> Route:
    """A straight road along x that begins with grade `initial` (dz/ds).

    Raises:
      InputError: two changes of grade overlap.
    """
    design = Design(
        name="slopes",
        start=(0.0, 0.0, 0.0, 0.0),
        lane_width=_LANE_WIDTH,
        lanes=1,
        left_shoulder=1.0,
        right_shoulder=2.5,
        speed_limit=_SPEED_LIMIT,
        initial_grade=initial,
        road_ends=(),
        alignment=((length, 0.0, 0.0, 0.0, 0.0),),
        grades=grades,
        extra_lanes=(),
        limits=((0.0, length, _SPEED_LIMIT),),
        structures=(),
    )
    return RoadMap(build(design), design.name).route()


def hills() -> Route:
    """3 km of hills, grades from -4.5 to +4 %, which end 18 m above their start."""
    return sloping(HILLS_LENGTH, 0.0, _HILLS)


# --- A driver who keeps a speed: pedal, then engine brake, then retarder, then the service brake
# One PI controller on the speed asks for a share: positive is accelerator pedal, 0 to -1 engine
# brake, -1 to -2 retarder. The service brake comes in when the truck is 1 m/s too fast all the
# same, and stays until the speed is back.

# Share per speed error [s/m], and its integral [1/m].
_GAIN = 1.0
_INTEGRAL = 0.08
_TOO_FAST, _BACK = 1.0, 0.2
_DECELERATION = 0.8


class SpeedKeeper:
    """Call `command` every 10 ms; remembers its integral and whether it brakes."""

    def __init__(self, share: float = 0.0) -> None:
        """`share`: what the controller begins with, -2 to 1."""
        self._integral = share
        self.braking = False

    def command(self, speed: float, target: float) -> VehicleCommand:
        """What to command at a speed when another is wanted [m/s]."""
        error = target - speed
        share = _GAIN * error + self._integral
        if -2.0 < share < 1.0:  # no wind-up at the ends
            self._integral += _INTEGRAL * error * PERIOD
        self.braking = -error > (_BACK if self.braking else _TOO_FAST)
        return VehicleCommand(
            accelerator_pedal=float(np.clip(share, 0.0, 1.0)),
            engine_brake=float(np.clip(-share, 0.0, 1.0)),
            retarder=float(np.clip(-share - 1.0, 0.0, 1.0)),
            xbr_mode=XbrMode.MAXIMUM if self.braking else XbrMode.OFF,
            xbr_demand=-_DECELERATION if self.braking else 0.0,
        )


# --- Records a straight drive under open-loop pedal and brake commands ---

# What of a run is not one number a sample of the truck's own report.
_NOT_SCALAR = ("grade", "wheel_slips", "wheel_pressures", "extra")


@dataclass(frozen=True)
class Run:
    """Time histories, each of shape (n,) unless said otherwise, every 10 ms; SI.

    Attributes:
      time, speed, acceleration, station; gear; shift: 1 while the driveline is open.
      engine_speed, engine_torque, fuel_rate, fuel_used; grade: of the road.
      wheel_slips, wheel_pressures: of each wheel, axle by axle, left before right, shape (n, 12).
      extra: further sensors by name.
    """

    time: FloatArray
    speed: FloatArray
    acceleration: FloatArray
    station: FloatArray
    gear: FloatArray
    shift: FloatArray
    engine_speed: FloatArray
    engine_torque: FloatArray
    fuel_rate: FloatArray
    fuel_used: FloatArray
    grade: FloatArray
    wheel_slips: FloatArray
    wheel_pressures: FloatArray
    extra: dict[str, FloatArray] = field(default_factory=dict)

    @property
    def slip(self) -> FloatArray:
        """Greatest slip magnitude of all wheels, shape (n,)."""
        return np.asarray(np.max(np.abs(self.wheel_slips), axis=1))


def run(
    truck: Truck,
    command: Callable[[float, EgoState], VehicleCommand],
    duration: float,
    stop: Callable[[EgoState], bool] | None = None,
    sensors: tuple[str, ...] = (),
) -> Run:
    """Drives the truck as it stands (call `truck.reset` before), commands each 10 ms.

    Args:
      truck: on its road.
      command: by time since the start [s] and state.
      duration: at most [s].
      stop: ends the run early.
      sensors: to be recorded besides; one that the model lacks reads nan, so that a check of it
        falls short.
    """
    known = {truck.model.sensor(i).name: truck.model.sensor(i) for i in range(truck.model.nsensor)}
    present = [name for name in sensors if name in known]
    wheels = 2 * len(truck.parameters.axles)
    first = int(known["brake_pressures"].adr[0])
    places = np.array(
        [*range(first, first + wheels), *(int(known[name].adr[0]) for name in present)]
    )

    def read(state: EgoState) -> list[float]:
        return [*_row(state), *wheel_slips(truck), *truck.data.sensordata[places]]

    table = sampled(truck, command, read, duration, stop)
    scalars = [name for name in Run.__dataclass_fields__ if name not in _NOT_SCALAR]
    columns = dict(zip(scalars, table[:, : len(scalars)].T, strict=True))
    bounds = np.cumsum([len(scalars), wheels, wheels])
    slips, wheel_pressures, others = np.split(table, bounds, axis=1)[1:]
    extra = dict.fromkeys(sensors, np.full(len(table), np.nan))
    extra |= dict(zip(present, others.T, strict=True))
    return Run(
        **columns,
        grade=np.asarray(truck.route.evaluate(columns["station"]).grade),
        wheel_slips=slips,
        wheel_pressures=wheel_pressures,
        extra=extra,
    )


def _row(state: EgoState) -> list[float]:
    return [
        state.speed,
        state.acceleration,
        state.station,
        float(state.gear),
        float(state.shift_in_process),
        state.engine_speed,
        state.engine_torque,
        state.fuel_rate,
        state.fuel_used,
    ]
