"""Messages between the modules: frozen dataclasses in SI units and ISO 8855 axes.

Positions are in the map frame (x east, y north, z up). `station` and `offset` are route
coordinates: meters along the `iits_mj.road.Route` and meters to the left of its reference line.
Lanes are counted from the outside: 0 is the driving lane of the route's direction that is nearest
to the edge of the road, the rightmost one in right-hand traffic.
"""

from __future__ import annotations

import enum
import functools
import math
import operator
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields, make_dataclass
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from iits_mj.core.arrays import FloatArray
from iits_mj.core.checks import in_range
from iits_mj.core.neighbors import Neighbors
from iits_mj.core.vehicles import TrackedVehicle as TrackedVehicle

M = TypeVar("M")


def positional(message: type[M]) -> Callable[..., M]:
    """Returns a constructor of a frozen message that takes all fields in their order.

    It takes a quarter of the time: the constructor of a frozen dataclass sets each field through
    `object.__setattr__`, this one fills an open class of the same slots and then freezes it.
    """
    slots = [(each.name, each.type) for each in fields(message)]  # type: ignore[arg-type]
    open_class = make_dataclass(message.__name__, slots, slots=True)

    def make(*values: Any) -> M:
        made: Any = open_class(*values)
        made.__class__ = message
        return made

    return make


class Decision(enum.IntEnum):
    """High-level decision, with the paper's numbers.

    LEFT is the next inner lane, RIGHT the next outer one; left-hand traffic swaps the sides.
    """

    LEFT = -1
    KEEP = 0
    RIGHT = 1


class XbrMode(enum.IntEnum):
    """XBR control mode of SAE J1939-71 (SPN 2916): how XBR and driver demands combine."""

    OFF = 0
    ADDITION = 1
    MAXIMUM = 2


class XbrEbiMode(enum.IntEnum):
    """XBR endurance brake integration of SAE J1939-71 (SPN 2914): which brakes may answer."""

    FRICTION_ONLY = 0
    ENDURANCE_ONLY = 1
    INTEGRATION = 2


class TransmissionMode(enum.IntEnum):
    """Gear selector; drive is zero, so that an all-zero control vector is ready to drive.

    In drive the gearbox chooses the gear. A forward gear is requested as by TC1's SPN 525; the
    gearbox engages it while the engine can run in it, and chooses itself otherwise.
    """

    DRIVE = 0
    NEUTRAL = 1
    REVERSE = 2
    GEAR_1 = 3
    GEAR_2 = 4
    GEAR_3 = 5
    GEAR_4 = 6
    GEAR_5 = 7
    GEAR_6 = 8
    GEAR_7 = 9
    GEAR_8 = 10
    GEAR_9 = 11
    GEAR_10 = 12
    GEAR_11 = 13
    GEAR_12 = 14
    GEAR_13 = 15
    GEAR_14 = 16
    GEAR_15 = 17
    GEAR_16 = 18
    GEAR_17 = 19
    GEAR_18 = 20

    @classmethod
    def forward(cls, gear: int) -> TransmissionMode:
        """Returns the request for a forward gear.

        Raises:
          InputError: no such gear can be requested.
        """
        in_range("requested gear", gear, 1, cls.GEAR_18.gear)
        return cls(cls.REVERSE + gear)

    @property
    def gear(self) -> int:
        """The requested forward gear, 0 for none."""
        return max(self - TransmissionMode.REVERSE, 0)


def requests_of(gear: NDArray[np.int64]) -> NDArray[np.int64]:
    """Returns the requests for planned gears, 0 in neutral, of any shape: see `TransmissionMode`.

    In a gear that cannot be requested the gearbox chooses.
    """
    known = (gear >= 0) & (gear <= TransmissionMode.GEAR_18.gear)
    requests = np.where(known, gear + TransmissionMode.REVERSE, TransmissionMode.DRIVE)
    return np.where(gear == 0, TransmissionMode.NEUTRAL, requests)


class PlanMode(enum.Enum):
    """Mode of the trajectory planner."""

    LANE_KEEPING = "lane_keeping"
    LANE_CHANGE = "lane_change"
    ABORT = "abort"
    EMERGENCY = "emergency"


@dataclass(frozen=True, slots=True)
class VehicleCommand:
    """Command to the truck; the fields have the order of the model's `ctrl`.

    Attributes:
      accelerator_pedal: EEC2 accelerator pedal position, 0 to 1.
      xbr_demand: XBR external acceleration demand [m/s2], zero or negative.
      xbr_mode: XBR control mode, see `XbrMode`.
      steering_wheel_angle: at the steering wheel [rad], positive to the left.
      parking_brake: 1 applies the spring brakes, 0 releases them.
      engine_brake: requested fraction of the available engine-brake torque, 0 to 1.
      transmission_mode: see `TransmissionMode`.
      retarder: requested fraction of the available retarder torque, 0 to 1.
      brake_pedal: position of the driver's service-brake pedal, 0 to 1.
      xbr_ebi_mode: whether engine brake and retarder answer the XBR demand, see `XbrEbiMode`.
    """

    accelerator_pedal: float = 0.0
    xbr_demand: float = 0.0
    xbr_mode: XbrMode = XbrMode.OFF
    steering_wheel_angle: float = 0.0
    parking_brake: float = 0.0
    engine_brake: float = 0.0
    transmission_mode: TransmissionMode = TransmissionMode.DRIVE
    retarder: float = 0.0
    brake_pedal: float = 0.0
    xbr_ebi_mode: XbrEbiMode = XbrEbiMode.FRICTION_ONLY


@dataclass(frozen=True, slots=True)
class EgoState:
    """State that the truck reports; the pose is that of the steer axle's center on the ground.

    Attributes:
      time: [s].
      x, y, z: steer axle center, projected to the road [m].
      yaw, pitch, roll: of the tractor [rad], ISO 8855 (pitch positive nose down).
      speed, lateral_speed: of the steer axle center in the tractor's frame [m/s].
      acceleration, lateral_acceleration: in the tractor's frame, gravity removed [m/s2].
      yaw_rate, trailer_yaw_rate: of the motor vehicle and of the last unit [rad/s].
      articulation, articulation_rate: yaw of the tractor minus that of the first towed unit [rad],
        [rad/s]; 0 for a truck without trailer.
      steering_wheel_angle: actual [rad].
      road_wheel_angle: mean of left and right [rad].
      mass: gross combination mass [kg].
      station, offset: of the steer axle center on the route [m].
      trailer_offset: of the last unit's rear axle group center on the route [m].
      gear: 1 to the highest forward, 0 neutral, -1 reverse.
      shift_in_process: True while the driveline is open for a gear change.
      engine_speed: [rad/s]; engine_torque: at the crankshaft [N m].
      fuel_rate: [kg/s]; fuel_used: since reset [kg].
      brake_pressures: front left, front right, rear left, rear right, trailer [Pa].
      rear_articulations, rear_articulation_rates: of the couplings behind the first, yaw of the
        unit ahead minus that of the unit behind [rad], [rad/s].
    """

    time: float = 0.0
    x: float = 0.0
    y: float = 0.0
    z: float = 0.0
    yaw: float = 0.0
    pitch: float = 0.0
    roll: float = 0.0
    speed: float = 0.0
    lateral_speed: float = 0.0
    acceleration: float = 0.0
    lateral_acceleration: float = 0.0
    yaw_rate: float = 0.0
    trailer_yaw_rate: float = 0.0
    articulation: float = 0.0
    articulation_rate: float = 0.0
    steering_wheel_angle: float = 0.0
    road_wheel_angle: float = 0.0
    mass: float = 55_000.0
    station: float = 0.0
    offset: float = 0.0
    trailer_offset: float = 0.0
    gear: int = 0
    shift_in_process: bool = False
    engine_speed: float = 0.0
    engine_torque: float = 0.0
    fuel_rate: float = 0.0
    fuel_used: float = 0.0
    brake_pressures: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)
    rear_articulations: tuple[float, ...] = ()
    rear_articulation_rates: tuple[float, ...] = ()


@dataclass(frozen=True, slots=True)
class TruckReport:
    """Further reports of the truck's control units; None means "not available".

    Attributes:
      accelerator_pedal, brake_pedal: positions in force, 0 to 1; parking_brake: 1 when applied.
      engine_brake, retarder: the driver's levers, 0 to 1.
      transmission_mode: the gear selector's, see `TransmissionMode`.
      xbr_mode: XBR control mode in force, see `XbrMode`.
      xbr_acceleration_limit: the lowest acceleration that XBR may demand [m/s2].
      engine_torque_percent: indicated, of the reference torque (SPN 513).
      torque_loss_percent: friction, of the reference torque (SPN 514).
      engine_torque_percent_driver: demand of the pedal, as indicated torque (SPN 512).
      engine_load_percent: indicated torque, of the greatest at this speed (SPN 92).
      engine_torque_mode: source of the torque demand, as numbered in SPN 899.
      clutch_engagement: 0 open to 1 closed.
      input_shaft_speed, propeller_shaft_speed: of the gearbox's two ends [rad/s].
      gear_engaged: the engaged gear; during a change the previous one, see `EgoState.gear`.
      gear_ratio: of that gear, a magnitude; None in neutral.
      engine_brake_torque: braking, at the crankshaft, zero or positive [N m].
      retarder_torque: braking, at the propeller shaft, zero or positive [N m].
      engine_brake_torque_percent_intended, engine_brake_torque_percent_available: of the greatest
        torque, negative when braking (SPN 1085, 1717); likewise for the retarder.
      reservoir_pressure_front, reservoir_pressure_rear, reservoir_pressure_trailer: [Pa].
      compressor_active: 1 while the compressor fills the reservoirs.
      abs_active, xbr_active: 1 while ABS modulates, while an XBR demand is being answered.
      asr_engine_active, asr_brake_active: 1 while traction control reduces the engine's torque,
        while it brakes spinning wheels.
      steering_wheel_torque: of the driver, left positive [N m].
      abs_operational: 0 while ABS does not use a wheel's sensor.
      brake_pressure_rear2_left, brake_pressure_rear2_right: of the second drive axle [Pa].
      wheel_based_speed: of the drive axles' tires, a magnitude, as their sensor has no sign [m/s].
      wheel_speeds: the same of the tractor's wheel ends, front to rear, left before right [m/s].
      tractor_mass, trailer_mass, cargo_mass: [kg]; the trailer's includes the cargo.
      axle_loads: vertical tire forces of the axles, front to rear [N].
    """

    accelerator_pedal: float | None = None
    brake_pedal: float | None = None
    parking_brake: float | None = None
    engine_brake: float | None = None
    retarder: float | None = None
    transmission_mode: float | None = None
    xbr_mode: float | None = None
    xbr_acceleration_limit: float | None = None
    engine_torque_percent: float | None = None
    torque_loss_percent: float | None = None
    engine_torque_percent_driver: float | None = None
    engine_load_percent: float | None = None
    engine_torque_mode: float | None = None
    clutch_engagement: float | None = None
    input_shaft_speed: float | None = None
    propeller_shaft_speed: float | None = None
    gear_engaged: float | None = None
    gear_ratio: float | None = None
    engine_brake_torque: float | None = None
    engine_brake_torque_percent_intended: float | None = None
    engine_brake_torque_percent_available: float | None = None
    retarder_torque: float | None = None
    retarder_torque_percent_intended: float | None = None
    retarder_torque_percent_available: float | None = None
    reservoir_pressure_front: float | None = None
    reservoir_pressure_rear: float | None = None
    reservoir_pressure_trailer: float | None = None
    compressor_active: float | None = None
    abs_active: float | None = None
    steering_wheel_torque: float | None = None
    abs_operational: float | None = None
    xbr_active: float | None = None
    asr_engine_active: float | None = None
    asr_brake_active: float | None = None
    brake_pressure_rear2_left: float | None = None
    brake_pressure_rear2_right: float | None = None
    wheel_based_speed: float | None = None
    wheel_speeds: tuple[float, ...] = ()
    tractor_mass: float | None = None
    trailer_mass: float | None = None
    cargo_mass: float | None = None
    axle_loads: tuple[float, ...] = ()


def _getters(kind: type[Any]) -> tuple[Callable[[Any], Any], Callable[[Any], Any]]:
    """Returns getters of a message's numbers and of its tuples, two or more of each."""
    lists = [each.name for each in fields(kind) if isinstance(each.default, tuple)]
    numbers = [each.name for each in fields(kind) if each.name not in lists]
    return operator.attrgetter(*numbers), operator.attrgetter(*lists)


_GETTERS = {kind: _getters(kind) for kind in (EgoState, TruckReport)}


def not_finite(message: EgoState | TruckReport) -> str:
    """Returns name and value of a message's first number that is not finite; "" without one."""
    numbers, lists = _GETTERS[type(message)]
    # A sum is finite only if all its terms are; None and 0 need no term.
    total = sum(filter(None, numbers(message))) + sum(map(sum, lists(message)))
    if math.isfinite(total):
        return ""
    for each in fields(message):
        value = getattr(message, each.name)
        values = value if isinstance(value, tuple) else (value,)
        if not all(number is None or math.isfinite(number) for number in values):
            return f"{each.name} = {value!r}"
    return ""


@dataclass(frozen=True, slots=True)
class EgoFootprint:
    """Size of the combination about its pose point (the steer axle center) [m].

    Attributes:
      front_overhang: from the pose point to the front bumper, 0 to the length.
      length: 1 to 100 m, road trains have 53.5 m; width, height: 0.5 to 10 m.

    Raises:
      InputError: a size is not a number or is out of its range.
    """

    front_overhang: float = 1.40
    length: float = 16.5
    width: float = 2.55
    height: float = 4.0

    def __post_init__(self) -> None:
        """Checks every size and keeps it as Python's own number."""
        bounds = {"length": (1.0, 100.0), "width": (0.5, 10.0), "height": (0.5, 10.0)}
        for name, (low, high) in (bounds | {"front_overhang": (0.0, self.length)}).items():
            size = in_range(f"footprint: {name}", getattr(self, name), low, high, "m")
            object.__setattr__(self, name, size)


class LightState(enum.Enum):
    """State of a traffic light; red with yellow counts as red.

    STOP is red with a green arrow: stop, then go if the way is free.
    """

    GREEN = "green"
    YELLOW = "yellow"
    RED = "red"
    STOP = "stop"


@dataclass(frozen=True, slots=True)
class TrafficLight:
    """The next traffic light on the route.

    Attributes:
      station: of its stop line [m].
      state: at present.
      next_switch: time until the state changes [s], None if unknown.
      next_state: after the change, None if unknown.
    """

    station: float
    state: LightState
    next_switch: float | None = None
    next_state: LightState | None = None


@dataclass(frozen=True, slots=True)
class SignalLamp:
    """State that a traffic light of the map shows; `signal` is its id in OpenDRIVE."""

    signal: str
    state: LightState


@dataclass(frozen=True, slots=True)
class SpeedZone:
    """A speed limit on a stretch of the route that replaces the map's.

    Attributes:
      start, end: stations [m]; limit: [m/s]; lane: from the outside, None for all lanes.
    """

    start: float
    end: float
    limit: float
    lane: int | None = None


@dataclass(frozen=True, slots=True)
class RoadSignals:
    """States of traffic lights and variable signs; where zones overlap the later one applies.

    `lines` are stations of stop lines before junctions without a light, where vehicles cross [m].
    `lamps` are the map's lights that are lit, also those off the route: for pictures.
    """

    light: TrafficLight | None = None
    zones: tuple[SpeedZone, ...] = ()
    lines: tuple[float, ...] = ()
    lamps: tuple[SignalLamp, ...] = ()


@dataclass(frozen=True)
class Scene:
    """Input of the stack at one instant: ego truck, traffic and signals."""

    time: float
    ego: EgoState
    vehicles: Sequence[TrackedVehicle] = ()
    footprint: EgoFootprint = EgoFootprint()
    signals: RoadSignals = RoadSignals()

    @functools.cached_property
    def neighbors(self) -> Neighbors:
        """The traffic around the truck as columns; made on first use.

        Raises:
          InputError: a number of a vehicle is not finite.
        """
        return Neighbors(self.ego, self.vehicles, self.footprint)


# Least speed of a profile [m/s]: at 0 the truck would never move again.
PROFILE_SPEED_MIN = 0.5


@dataclass(frozen=True, slots=True)
class SpeedProfile:
    """Reference speed over station, both of shape (n,); [m] and [m/s].

    `transmission_mode`, (n,), has the `TransmissionMode` from a station to the next one: a forward
    gear to keep, neutral to roll in, or drive; None: drive everywhere. Above `coast_above` [m/s]
    the truck coasts in gear and burns no fuel.
    """

    station: FloatArray
    speed: FloatArray
    transmission_mode: NDArray[np.int64] | None = None
    coast_above: float = math.inf

    def at(self, station: float) -> float:
        """Returns the reference speed at a station [m/s], constant beyond both ends."""
        return float(np.interp(station, self.station, self.speed))

    def capped(self, speed_max: float) -> SpeedProfile:
        """Returns the profile limited to `speed_max` [m/s], with the gearbox's own gears.

        An infinite `speed_max` changes nothing.
        """
        if speed_max == math.inf:
            return self
        speed = np.minimum(self.speed, speed_max)
        return SpeedProfile(self.station, speed, coast_above=self.coast_above)

    def mode_at(self, station: float) -> TransmissionMode:
        """Returns the planned mode at a station [m], drive beyond both ends."""
        modes = self.transmission_mode
        if modes is None or not self.station[0] <= station < self.station[-1]:
            return TransmissionMode.DRIVE
        return TransmissionMode(modes[int(self.station.searchsorted(station, "right")) - 1])


@dataclass(frozen=True, slots=True)
class Trajectory:
    """Planned motion of the steer axle center; arrays of shape (n,), strictly increasing time.

    Attributes:
      time: absolute simulation time [s].
      station, offset: route coordinates [m].
      x, y, z, yaw: map frame [m], [rad].
      curvature: of the path [1/m]; speed [m/s]; acceleration [m/s2].
      mode: of the planner; reason: of the mode in words, for logs and pictures.
      target_lane: index of the lane that is kept or entered.
    """

    time: FloatArray
    station: FloatArray
    offset: FloatArray
    x: FloatArray
    y: FloatArray
    z: FloatArray
    yaw: FloatArray
    curvature: FloatArray
    speed: FloatArray
    acceleration: FloatArray
    mode: PlanMode = PlanMode.LANE_KEEPING
    reason: str = ""
    target_lane: int = 0
    refused: Decision = Decision.KEEP
    extra: dict[str, float] = field(default_factory=dict)
