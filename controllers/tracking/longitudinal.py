"""Speed tracking: accelerator pedal, engine brake, retarder and XBR from the planned speed.

Feed-forward of acceleration, grade, rolling and air through the inverse powertrain, plus a slow
integral. Accelerator, coasting, endurance brakes and friction alternate with hysteresis and dwell
times, so that they do not chatter. Where the plan needs about the engine's drag, the truck coasts
in gear and ignores small errors of speed: correcting them by accelerator and engine brake in turn
costs fuel and gear changes. For the same reason the pedal moves too slowly for a kick-down, unless
the truck has to gain much speed. Engine brake, then retarder, hold the speed on a descent, each by
its own TSC1; an XBR demand that may use both adds the missing force. At standstill the brakes hold.
The law itself is compiled, in `iits_mj/kernels/longitudinal.cc`.

The XBR demand is the deceleration of the truck, as SPN 2920 defines it. Brake control applies it as
on a level road and corrects it by the measured deceleration, by at most
`trim_max + trim_share * demand` and at most by the demand itself. On a descent, where braking only
holds the speed, this is not enough for a demand near zero: the demand is then the least one whose
correction reaches the level.
"""

from __future__ import annotations

import ctypes
import dataclasses
import enum
import struct
from dataclasses import dataclass

import numpy as np

from controllers.tracking.driveline_inverse import pack_powertrain
from iits_mj import kernels
from iits_mj.core.errors import InputError
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
from iits_mj.parameters import TruckParameters

_SURELY = 0.99  # share of the gearbox's thresholds that does not reach them


class Phase(enum.Enum):
    """Actuator of the speed: engine, its drag, endurance brakes, friction too, or standstill.

    The kernel counts them in this order.
    """

    DRIVE = "drive"
    COAST = "coast"
    OVERRUN = "overrun"
    BRAKE = "brake"
    HOLD = "hold"
    LAUNCH = "launch"


_PHASES = tuple(Phase)
_BRAKE = _PHASES.index(Phase.BRAKE)
# Names of their own: looking up a member in its class takes time.
_XBR_OFF, _XBR_MAXIMUM = XbrMode.OFF, XbrMode.MAXIMUM
_FRICTION_ONLY, _INTEGRATION = XbrEbiMode.FRICTION_ONLY, XbrEbiMode.INTEGRATION
_FORWARD = TransmissionMode.DRIVE
_vehicle_command = positional(VehicleCommand)


@dataclass(frozen=True)
class LongitudinalConfig:
    """Gains and thresholds of the speed controller, in the order of the kernel.

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


class Memory(ctypes.Structure):
    """What the law remembers between its steps.

    Attributes:
      phase: index in `Phase`; since: time in it [s].
      gear: last one engaged; integral: of the error of speed [m/s2].
      pedal, engine_brake, retarder, demand: before they are bounded for the command.
      slow_pedal: low-pass of the pedal, as the gearbox forms it for its kick-down.
      command: pedal, XBR demand (positive), engine brake, retarder.
    """

    _fields_ = [
        *((name, kernels.Real) for name in ("phase", "since", "gear", "integral")),
        *((name, kernels.Real) for name in ("pedal", "slow_pedal", "engine_brake", "retarder")),
        ("demand", kernels.Real),
        ("command", 4 * kernels.Real),
    ]


def pack_plan(trajectory: Trajectory) -> bytes:
    """Columns of a plan for the kernel: time, speed and acceleration.

    Raises:
      InputError: the trajectory has no point.
    """
    t = trajectory
    if not len(t.time):
        raise InputError("a trajectory without points cannot be tracked: at least one is needed")
    return np.concatenate((t.time, t.speed, t.acceleration), dtype=float).tobytes()


def pack_settings(config: LongitudinalConfig, parameters: TruckParameters) -> bytes:
    """The settings of the law, of the gearbox's kick-down and of brake control, for the kernel."""
    shifting, brake = parameters.gearbox.shifting, parameters.air_brake
    numbers = (
        CONTROL_PERIOD,
        *dataclasses.astuple(config),
        _SURELY * shifting.kick_down_pedal,
        _SURELY * shifting.kick_down_rise,
        min(CONTROL_PERIOD / shifting.pedal_lag, 1.0),
        brake.trim_max,
        brake.trim_share,
    )
    return struct.pack(f"{len(numbers)}d", *numbers)


class LongitudinalController:
    """Tracks the planned speed; one call every 20 ms.

    Attributes:
      memory: see `Memory`.
    """

    def __init__(
        self, parameters: TruckParameters, config: LongitudinalConfig | None = None
    ) -> None:
        self.parameters = parameters
        self.config = config or LongitudinalConfig()
        self._settings = pack_settings(self.config, parameters)
        self._powertrain = pack_powertrain(parameters)
        self.reset()

    def reset(self) -> None:
        """Clears phase and integral."""
        self.memory = Memory(since=self.config.dwell, gear=1)
        self._trajectory: Trajectory | None = None
        self._plan = b""

    @property
    def phase(self) -> Phase:
        """Actuator of the speed at the last call."""
        return _PHASES[round(self.memory.phase)]

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
        if trajectory is not self._trajectory:
            self._plan, self._trajectory = pack_plan(trajectory), trajectory
        memory = self.memory
        phase = _track_speed(
            self._settings,
            self._powertrain,
            memory,
            self._plan,
            len(trajectory.time),
            ego.time,
            ego.speed,
            ego.mass,
            ego.engine_speed,
            ego.gear,
            ego.shift_in_process,
            grade,
        )
        pedal, demand, engine_brake, retarder = memory.command
        active = demand > 0.0
        return _vehicle_command(
            pedal,
            -demand if active else 0.0,
            _XBR_MAXIMUM if active else _XBR_OFF,
            steering_wheel_angle,
            0.0,  # parking brake
            engine_brake,
            _FORWARD,
            retarder,
            0.0,  # brake pedal
            _INTEGRATION if active and phase == _BRAKE else _FRICTION_ONLY,
        )


_track_speed = kernels.function(
    "iits_track_speed",
    kernels.Integer,
    kernels.Address,
    kernels.Address,
    ctypes.POINTER(Memory),
    kernels.Address,
    kernels.Integer,
    *7 * [kernels.Real],
)
