"""Vehicle types: dimensions, behavior and colors from TOML, and their changeable parameters."""

from __future__ import annotations

import copy
import dataclasses
import math
import re
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np

from iits_mj.core.assets import VEHICLE_TYPES
from iits_mj.core.checks import in_range, is_number, make_plain, shown
from iits_mj.core.errors import InputError
from iits_mj.core.input_files import read_toml

KINDS = ("car", "van", "truck", "articulated")
# Further kinds of road users, which scenarios place; SUMO's traffic has none of them.
ROAD_USERS = ("pedestrian", "bicycle", "obstacle")
ALL_KINDS = (*KINDS, *ROAD_USERS)
HEAVY = ("truck", "articulated")
Color = tuple[float, float, float]

_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_-]{0,31}")
# Names with another meaning in the simulation.
_TAKEN = ("ego", "shadow", "blocker", "stopped", "convoy")
# Fields of `VehicleType` that are SUMO's attributes of its lane-change model LC2013.
LC2013_ATTRIBUTES = {
    "lc_strategic": "lcStrategic",
    "lc_cooperative": "lcCooperative",
    "lc_speed_gain": "lcSpeedGain",
    "lc_keep_right": "lcKeepRight",
    "lc_assertive": "lcAssertive",
}
POSITIVE = (
    *("length", "width", "height", "acceleration", "deceleration", "time_headway"),
    *("desired_speed_mean", "lc_assertive"),
)
# The highest allowed value of each number, and why.
HIGHEST = {
    "length": 100.0,  # [m] road trains have 53.5 m
    "width": 5.0,  # [m] an escorted load; a lane has 3 to 4 m, and SUMO keeps each in its lane
    "height": 10.0,  # [m] an escorted load; bridges leave 4 to 5 m
    "minimum_gap": 50.0,  # [m] drivers stop 1 to 8 m behind their leader
    "time_headway": 20.0,  # [s] drivers keep 0.5 to 4 s; at 20 s a lane carries 3 vehicles a minute
    "acceleration": 15.0,  # [m/s2] as the next two: tires on a dry road reach 10 to 13 m/s2
    "deceleration": 15.0,
    "emergency_deceleration": 15.0,
    "desired_speed_mean": 2.0,  # of a fraction that is cut at 1: with 2 every vehicle has 1
    "desired_speed_deviation": 1.0,
    "desired_speed_low": 1.0,  # the fraction is cut to [low, 1]
    "turning_radius": 30.0,  # [m] of the lane's center: a B-double needs 13 m
    "time_headway_spread": 1.0,  # of ln T: at 1 one driver in six keeps 2.7 times the median
    "politeness": 10.0,  # at 1 the gain of others counts as much as one's own
    "change_threshold": 15.0,  # [m/s2] as accelerations: higher ones have no further effect
    "keep_right_bias": 15.0,
    "safe_braking": 15.0,
    "lc_strategic": 100.0,  # factors in SUMO, 1 by default; higher ones have no visible effect
    "lc_cooperative": 100.0,
    "lc_speed_gain": 100.0,
    "lc_keep_right": 100.0,
    "lc_assertive": 100.0,
}

# SUMO's names of its parameters of vehicles and vehicle types.
SUMO_NAMES = {
    "time_headway": "Tau",
    "minimum_gap": "MinGap",
    "acceleration": "Accel",
    "deceleration": "Decel",
    "emergency_deceleration": "EmergencyDecel",
    "desired_speed": "MaxSpeed",
}
# Parameters that only `mobil` uses.
MOBIL_FIELDS = ("politeness", "change_threshold", "keep_right_bias", "safe_braking")
CHANGEABLE = (*SUMO_NAMES, *MOBIL_FIELDS, *LC2013_ATTRIBUTES, "color")
FASTEST = 70.0  # [m/s] as for `TrafficConfig.speed_limit`


@dataclass(frozen=True)
class VehicleType:
    """One type of vehicle; `iits_mj/parameters/vehicle_types.toml` holds those of the package.

    Numbers are zero or positive and at most `HIGHEST`, so that the vehicle is physically possible.
    Length, width, height, `acceleration`, `deceleration`, `time_headway`, `desired_speed_mean` and
    `lc_assertive` are positive. All become Python's own numbers.

    Attributes:
      name: of the type; letters, digits, "_" and "-".
      length, width, height: [m].
      minimum_gap: IDM standstill gap s0 [m]; time_headway: IDM T [s].
      acceleration, deceleration: IDM a and b, both positive [m/s2].
      emergency_deceleration: the hardest braking possible [m/s2].
      desired_speed_mean, desired_speed_deviation, desired_speed_low: of the normal distribution of
        the desired speed as a fraction of the traffic's maximum speed, cut to [low, 1].
      politeness: MOBIL p; change_threshold: MOBIL a_th [m/s2]; keep_right_bias: MOBIL a_bias
        [m/s2]; safe_braking: MOBIL b_safe [m/s2].
      look: appearance: "car", "van", "truck" (rigid) or "articulated"; "" stands for the name,
        which then must be one of them.
      colors: each red, green, blue from 0 to 1; a vehicle's name selects one of them.
      lc_strategic, lc_cooperative, lc_speed_gain, lc_keep_right: weights of LC2013's four motives;
        lc_assertive: divisor of the accepted gaps. 1 is SUMO's default.
      time_headway_spread: standard deviation of the logarithm of the drivers' time headways; their
        mean is `time_headway`. 0: all drivers are equal.
      turning_radius: of the tightest bend of a lane's center that it takes at a junction where it
        can choose its turn [m].
      governed_speed: of a speed limiter [m/s]; no desired speed is above it.

    Raises:
      InputError: a value is not allowed; the message states the allowed values.
    """

    name: str
    length: float
    width: float
    height: float
    minimum_gap: float
    time_headway: float
    acceleration: float
    deceleration: float
    emergency_deceleration: float
    desired_speed_mean: float
    desired_speed_deviation: float
    desired_speed_low: float
    politeness: float
    change_threshold: float
    keep_right_bias: float
    safe_braking: float
    look: str = ""
    colors: tuple[Color, ...] = ((0.7, 0.7, 0.7),)
    lc_strategic: float = 1.0
    lc_cooperative: float = 1.0
    lc_speed_gain: float = 1.0
    lc_keep_right: float = 1.0
    lc_assertive: float = 1.0
    time_headway_spread: float = 0.0
    governed_speed: float = FASTEST
    turning_radius: float = 0.0

    def __post_init__(self) -> None:
        """Checks every value; lists given as colors become tuples."""
        if not isinstance(self.name, str) or not _NAME.fullmatch(self.name) or self.name in _TAKEN:
            raise InputError(
                f"vehicle type {shown(self.name)}: a name has 1 to 32 letters, digits, '_' or '-', "
                f"begins with a letter and is none of {', '.join(_TAKEN)}"
            )
        object.__setattr__(self, "look", self.look or self.name)
        if self.look not in ALL_KINDS:
            raise InputError(
                f"vehicle type {self.name!r}: look {shown(self.look)}: "
                f"allowed are {', '.join(ALL_KINDS)}"
            )
        object.__setattr__(self, "colors", _colors(self.name, self.colors))
        for name in HIGHEST:
            check_parameter(f"{self.name}.{name}", name, getattr(self, name))
        in_range(f"{self.name}.governed_speed", self.governed_speed, 1.0, FASTEST)
        make_plain(self)

    @property
    def kind(self) -> str:
        """The kind in `TrackedVehicle.kind`: its look."""
        return self.look

    @property
    def heavy(self) -> bool:
        """Whether its look is a truck's; heavy vehicles avoid the left lane of three."""
        return self.look in HEAVY

    def color_of(self, vehicle: str) -> Color:
        """The color of a vehicle of this type; one name always has one color."""
        return self.colors[zlib.crc32(vehicle.encode()) % len(self.colors)]

    def sample_desired_speed(self, maximum: float, rng: np.random.Generator) -> float:
        """Desired speed of one vehicle [m/s], for a traffic maximum speed [m/s]."""
        factor = rng.normal(self.desired_speed_mean, self.desired_speed_deviation)
        desired = float(maximum * min(max(factor, self.desired_speed_low), 1.0))
        return min(desired, self.governed_speed)

    def mean_desired_speed(self, maximum: float) -> float:
        """Mean of `sample_desired_speed` [m/s]."""
        highest = min(1.0, self.governed_speed / maximum)
        mean, deviation = self.desired_speed_mean, self.desired_speed_deviation
        factor = np.linspace(mean - 5.0 * deviation, mean + 5.0 * deviation, 201)
        weight = np.exp(-0.5 * ((factor - mean) / max(deviation, 1e-9)) ** 2)
        factor = np.minimum(np.clip(factor, self.desired_speed_low, 1.0), highest)
        return maximum * float(np.average(factor, weights=weight))

    def sample_driver(self, rng: np.random.Generator) -> VehicleType:
        """The type with the time headway of one driver, log-normal with the type's mean."""
        spread = self.time_headway_spread
        if spread == 0.0:
            return self
        factor = math.exp(spread * min(max(rng.normal(), -2.0), 2.0) - 0.5 * spread**2)
        # A copy without the checks of `__init__`, which take longer than everything else here.
        driver = copy.copy(self)
        object.__setattr__(driver, "time_headway", self.time_headway * factor)
        return driver

    def to_sumo_xml(self, maximum_speed: float) -> str:
        """The `vType` element: IDM, LC2013, no random term, every vehicle at its own speed.

        Args:
          maximum_speed: of the type, until a vehicle gets its own [m/s].
        """
        attributes: dict[str, object] = {
            "id": self.name,
            "length": self.length,
            "width": self.width,
            "height": self.height,
            "minGap": self.minimum_gap,
            "maxSpeed": maximum_speed,
            "carFollowModel": "IDM",
            "tau": self.time_headway,
            "accel": self.acceleration,
            "decel": self.deceleration,
            "emergencyDecel": max(self.emergency_deceleration, self.deceleration),
            "speedFactor": 1,
            "speedDev": 0,
            "laneChangeModel": "LC2013",
        }
        for name, attribute in LC2013_ATTRIBUTES.items():
            if getattr(self, name) != 1.0:
                attributes[attribute] = getattr(self, name)
        text = " ".join(f"{key}={quoteattr(str(value))}" for key, value in attributes.items())
        return f"<vType {text}/>"


@cache
def default_types() -> tuple[VehicleType, ...]:
    """The four types of the package."""
    table = read_toml(VEHICLE_TYPES, "file of vehicle types")
    return tuple(VehicleType(name=kind, **table[kind]) for kind in KINDS)


@cache
def road_user_types() -> tuple[VehicleType, ...]:
    """The types of `ROAD_USERS`, from `road_user_types.toml`."""
    path = Path(__file__).with_name("road_user_types.toml")
    table = read_toml(path, "file of vehicle types")
    return tuple(
        dataclasses.replace(default_types()[0], name=n, look=n, **table[n]) for n in ROAD_USERS
    )


@cache
def motorway_types() -> tuple[VehicleType, ...]:
    """The default types with the drivers of `motorway_types.toml`, for a level of service."""
    return read_types(Path(__file__).with_name("motorway_types.toml"))


def read_types(
    path: str | Path, base: Sequence[VehicleType] | None = None
) -> tuple[VehicleType, ...]:
    """Vehicle types with the changes and additions of a TOML file.

    Each table has the name of a type. An existing name changes that type; a new name adds a type,
    with all other values from the type named by `like`, or else by `look`.

    Args:
      path: of the file.
      base: the types to start from; None: the package's four.

    Raises:
      InputError: the file cannot be read, or has an unknown field or an unusable value.
    """
    types = {t.name: t for t in (default_types() if base is None else base)}
    for name, values in read_toml(path, "file of vehicle types").items():
        try:
            if not isinstance(values, dict):
                raise InputError(f"{name} = {values!r}: expected a table [{name}]")
            values = dict(values)
            like = values.pop("like", name if name in types else values.get("look", name))
            if not isinstance(like, str) or like not in types:
                raise InputError(
                    f"vehicle type {name!r}: there is no type {like!r} to start from; "
                    f"set `like` or `look` to one of {', '.join(types)}"
                )
            known = {f.name for f in dataclasses.fields(VehicleType)} - {"name"}
            for field in values:
                if field not in known:
                    raise InputError(
                        f"{name}.{field} is unknown; the fields are {', '.join(sorted(known))}"
                    )
            types[name] = dataclasses.replace(types[like], name=name, **values)
        except InputError as error:
            raise InputError(f"{path}: {error}") from error
    return tuple(types.values())


def type_from_dict(values: Mapping[str, Any]) -> VehicleType:
    """The type that `dataclasses.asdict` wrote; the first recordings have `kind` for `name`.

    Raises:
      InputError: a field is missing, unknown or unusable.
    """
    given = dict(values)
    if "kind" in given and "name" not in given:
        given["name"] = given.pop("kind")
    try:
        return VehicleType(**given)
    except TypeError as error:
        raise InputError(f"vehicle type {given.get('name')!r}: {error}") from error


def check_parameter(label: str, name: str, value: object) -> None:
    """Checks a parameter of a vehicle type, one of `HIGHEST`; InputError if it is not allowed."""
    if not is_number(value):
        raise InputError(f"{label} = {shown(value)}: must be finite and not negative")
    if value < 0.0:  # type: ignore[operator]
        raise InputError(f"{label} = {value!r}: must be zero or positive")
    if name in POSITIVE and value == 0.0:
        raise InputError(f"{label} = {value!r}: must be positive")
    in_range(label, value, 0.0, HIGHEST[name])


def check_changes(target: str, values: dict[str, Any]) -> None:
    """Checks the arguments of `Vehicles.change`.

    Raises:
      InputError: the target is not a name, no or an unknown parameter is given, or a value is not
        allowed.
    """
    if not isinstance(target, str):
        raise InputError(f"{shown(target)} to change: must be the name of a vehicle or of a type")
    if not values:
        raise InputError(f"no parameter of {target} to change: there are {', '.join(CHANGEABLE)}")
    for name, value in values.items():
        if name not in CHANGEABLE:
            raise InputError(f"parameter {shown(name)}: allowed are {', '.join(CHANGEABLE)}")
        if name == "color":
            check_color(target, value)
            continue
        label = f"{target}.{name}"
        if name != "desired_speed":
            check_parameter(label, name, value)
            continue
        in_range(label, value, 0.0, FASTEST)
        if value == 0.0:
            raise InputError(f"{label} = {value!r}: must be positive")


def changed(kind: VehicleType, values: dict[str, Any]) -> VehicleType:
    """A type with changed fields, except desired speed and color, which belong to the vehicle."""
    fields = {n: v for n, v in values.items() if n not in ("desired_speed", "color")}
    return dataclasses.replace(kind, **fields)


def check_color(name: str, color: object) -> Color:
    """A color as a tuple; InputError unless it is three numbers from 0 to 1."""
    if (
        not isinstance(color, (tuple, list))
        or len(color) != 3
        or any(not is_number(value) or not 0.0 <= value <= 1.0 for value in color)
    ):
        raise InputError(
            f"{name}: color {shown(color)}: must be red, green, blue, each from 0 to 1"
        )
    return float(color[0]), float(color[1]), float(color[2])


def _colors(name: str, colors: object) -> tuple[Color, ...]:
    if not isinstance(colors, (tuple, list)) or not colors:
        raise InputError(f"{name}.colors = {shown(colors)}: must be a list of at least one color")
    return tuple(check_color(name, color) for color in colors)
