"""Standard ROS 2 messages of what a drive holds: frames, odometry, twist, markers, path, CAN.

REP 103 and 105: metres and radians, x forward, y left, z up; frames `map`, `tractor` (steer axle's
centre on the ground) and `trailer` (kingpin, at the tractor's height). Our roll is positive to the
right and our pitch nose down, as theirs.
"""

from __future__ import annotations

import dataclasses
import enum
import functools
import math
import types
import typing
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from iits_mj.core.messages import (
    Decision,
    EgoFootprint,
    EgoState,
    RoadSignals,
    Scene,
    SpeedZone,
    TrackedVehicle,
    TrafficLight,
    Trajectory,
    VehicleCommand,
)
from iits_mj.j1939 import Frame as BusFrame
from iits_mj.parameters import TruckParameters

# --- Our messages as ROS 2 types: definitions and conversion are made from the dataclasses ---
# | Python                         | ROS 2                                                  |
# |--------------------------------|--------------------------------------------------------|
# | float, int, bool, str          | float64, int64, bool, string                           |
# | IntEnum                        | int64; other enumerations: string, their value         |
# | arrays and tuples of floats    | float64[]                                              |
# | float or None                  | float64, nan for None                                  |
# | enumeration or None            | string, empty for None                                 |
# | int or None                    | int64[], empty for None                                |
# | dataclass; dataclass or None   | message; message[], empty for None                     |
# | sequence of dataclasses        | message[]                                              |
# | dictionary of floats           | string[] `<field>_names` and float64[] `<field>`       |

PACKAGE = "iits_msgs/msg"


@dataclass(frozen=True, slots=True)
class Decided:
    """An answer of the decision maker: when it was asked [s], and what it said."""

    time: float
    decision: Decision


# In the order in which they build on each other.
MESSAGES = (
    *(EgoState, EgoFootprint, TrackedVehicle, TrafficLight, SpeedZone, RoadSignals),
    *(Scene, Trajectory, VehicleCommand, Decided),
)


def type_name(kind: type) -> str:
    """Name of a dataclass's ROS 2 type."""
    return f"{PACKAGE}/{kind.__name__}"


def definition(kind: type) -> str:
    """Text of the `.msg` file of a dataclass."""
    lines = []
    for field in _fields(kind):
        if field.form == "dictionary":
            lines.append(f"string[] {field.name}_names")
        lines.append(f"{field.ros} {field.name}")
    return "\n".join(lines) + "\n"


def encode(message: Any, make: Callable[[str], type]) -> Any:
    """A dataclass as an instance of its ROS 2 type.

    Args:
      message: one of `MESSAGES`.
      make: class of a ROS 2 type by its name.
    """
    kind = typing.cast(Any, type(message))
    values: dict[str, Any] = {}
    for field in _fields(kind):
        value = getattr(message, field.name)
        if field.form == "dictionary":
            values[f"{field.name}_names"] = list(value)
            values[field.name] = np.array(list(value.values()), dtype=np.float64)
        else:
            values[field.name] = _encoded(value, field, make)
    return make(type_name(kind))(**values)


def decode(message: Any, kind: type) -> Any:
    """An instance of a ROS 2 type as the dataclass."""
    values: dict[str, Any] = {}
    for field in _fields(kind):
        value = getattr(message, field.name)
        if field.form == "dictionary":
            names = getattr(message, f"{field.name}_names")
            values[field.name] = dict(zip(names, np.asarray(value).tolist(), strict=True))
        else:
            values[field.name] = _decoded(value, field)
    return kind(**values)


@dataclass(frozen=True)
class _Field:
    name: str
    ros: str
    form: str
    kind: Any = None


@functools.cache
def _fields(kind: type) -> tuple[_Field, ...]:
    hints = typing.get_type_hints(kind)
    return tuple(_field(field.name, hints[field.name]) for field in dataclasses.fields(kind))


_PLAIN = {float: "float64", int: "int64", bool: "bool", str: "string"}


def _field(name: str, hint: Any) -> _Field:
    origin, inside = typing.get_origin(hint), typing.get_args(hint)
    if origin in (typing.Union, types.UnionType):
        (wanted,) = (part for part in inside if part is not type(None))
        if wanted is float:
            return _Field(name, "float64", "float or none")
        if wanted is int:
            return _Field(name, "int64[]", "int or none")
        if dataclasses.is_dataclass(wanted):
            return _Field(
                name, f"{type_name(typing.cast(type, wanted))}[]", "message or none", wanted
            )
        return _Field(name, "string", "enum or none", wanted)
    if hint in _PLAIN:
        return _Field(name, _PLAIN[hint], "plain", hint)
    if origin is dict:
        return _Field(name, "float64[]", "dictionary")
    if dataclasses.is_dataclass(hint):
        return _Field(name, type_name(typing.cast(type, hint)), "message", hint)
    if isinstance(hint, type) and issubclass(hint, enum.IntEnum):
        return _Field(name, "int64", "number enum", hint)
    if isinstance(hint, type) and issubclass(hint, enum.Enum):
        return _Field(name, "string", "enum", hint)
    if inside and dataclasses.is_dataclass(inside[0]):
        return _Field(name, f"{type_name(typing.cast(type, inside[0]))}[]", "messages", inside[0])
    if origin is tuple:
        return _Field(name, "float64[]", "tuple")
    return _Field(name, "float64[]", "array")


def _encoded(value: Any, field: _Field, make: Callable[[str], type]) -> Any:
    form = field.form
    if form == "float or none":
        return math.nan if value is None else float(value)
    if form == "int or none":
        return np.array([] if value is None else [value], dtype=np.int64)
    if form == "message or none":
        return [] if value is None else [encode(value, make)]
    if form == "messages":
        return [encode(part, make) for part in value]
    if form == "message":
        return encode(value, make)
    if form in ("enum", "enum or none"):
        return "" if value is None else str(value.value)
    if form in ("tuple", "array"):
        return np.ascontiguousarray(value, dtype=np.float64)
    return int(value) if form == "number enum" else field.kind(value)


def _decoded(value: Any, field: _Field) -> Any:
    form, kind = field.form, field.kind
    if form == "float or none":
        return None if math.isnan(value) else float(value)
    if form == "int or none":
        return int(value[0]) if len(value) else None
    if form == "message or none":
        return decode(value[0], kind) if len(value) else None
    if form == "messages":
        return tuple(decode(part, kind) for part in typing.cast(Sequence[Any], value))
    if form == "message":
        return decode(value, kind)
    if form == "enum or none" and value == "":
        return None
    if form == "tuple":
        return tuple(np.asarray(value).tolist())
    if form == "array":
        return np.array(value, dtype=np.float64)
    return kind(value)


# --- Standard ROS 2 messages of what a drive holds: frames, odometry, twist, markers, path, CAN ---

Make = Callable[[str], type]

# The ROS package can_msgs is not among those that all distributions have.
CAN_FRAME = (
    "std_msgs/Header header\nuint32 id\nbool is_rtr\nbool is_extended\nbool is_error\n"
    "uint8 dlc\nuint8[8] data\n"
)
CAN_TYPE = "can_msgs/msg/Frame"
_COLORS = {
    "car": (0.25, 0.5, 0.9),
    "van": (0.9, 0.7, 0.2),
    "truck": (0.3, 0.7, 0.4),
    "articulated": (0.6, 0.35, 0.8),
}
_CUBE, _DELETE_ALL = 1, 3


class Standard:
    """Makes the messages.

    Args:
      make: class of a ROS 2 type by its name.
      parameters: of the truck.
    """

    def __init__(self, make: Make, parameters: TruckParameters) -> None:
        self._make = make
        self._hitch = parameters.fifth_wheel.position
        self._no_covariance = np.zeros(36)

    def stamp(self, time: float) -> Any:
        """A time of the simulation [s]."""
        nanoseconds = round(time * 1e9)
        return self._make("builtin_interfaces/msg/Time")(
            sec=nanoseconds // 1_000_000_000, nanosec=nanoseconds % 1_000_000_000
        )

    def odometry(self, ego: EgoState) -> Any:
        """`nav_msgs/Odometry` of the tractor in the map; twist in the tractor's frame."""
        pose = self._make("geometry_msgs/msg/PoseWithCovariance")(
            pose=self._pose(ego.x, ego.y, ego.z, ego.yaw, ego.pitch, ego.roll),
            covariance=self._no_covariance,
        )
        twist = self._make("geometry_msgs/msg/TwistWithCovariance")(
            twist=self._twist(ego), covariance=self._no_covariance
        )
        return self._make("nav_msgs/msg/Odometry")(
            header=self._header(ego.time, "map"), child_frame_id="tractor", pose=pose, twist=twist
        )

    def transforms(self, ego: EgoState) -> Any:
        """`tf2_msgs/TFMessage`: map to tractor, tractor to trailer."""
        place = (ego.x, ego.y, ego.z)
        trailer = (-self._hitch, 0.0, 0.0)
        return self._make("tf2_msgs/msg/TFMessage")(
            transforms=[
                self._transform(ego.time, "map", "tractor", place, (ego.yaw, ego.pitch, ego.roll)),
                self._transform(
                    ego.time, "tractor", "trailer", trailer, (-ego.articulation, 0.0, 0.0)
                ),
            ]
        )

    def twist(self, ego: EgoState) -> Any:
        """`geometry_msgs/TwistStamped` of the tractor in its own frame."""
        return self._make("geometry_msgs/msg/TwistStamped")(
            header=self._header(ego.time, "tractor"), twist=self._twist(ego)
        )

    def markers(self, time: float, vehicles: Iterable[TrackedVehicle]) -> Any:
        """`visualization_msgs/MarkerArray`: a box for each vehicle, those before are gone."""
        found = [self._marker(time, 0, "", _DELETE_ALL, (0.0,) * 6, (0.0,) * 3, "car")]
        for number, vehicle in enumerate(vehicles):
            lift = 0.5 * vehicle.height
            pose = (
                vehicle.x,
                vehicle.y,
                vehicle.z + lift,
                vehicle.yaw,
                vehicle.pitch,
                vehicle.roll,
            )
            size = (vehicle.length, vehicle.width, vehicle.height)
            found.append(self._marker(time, number, vehicle.id, 0, pose, size, vehicle.kind))
        return self._make("visualization_msgs/msg/MarkerArray")(markers=found)

    def path(self, time: float, plan: Trajectory) -> Any:
        """`nav_msgs/Path` of a plan, each pose with the time it is planned for."""
        poses = [
            self._make("geometry_msgs/msg/PoseStamped")(
                header=self._header(max(at, 0.0), "map"), pose=self._pose(x, y, z, yaw, 0.0, 0.0)
            )
            for at, x, y, z, yaw in zip(
                *(v.tolist() for v in (plan.time, plan.x, plan.y, plan.z, plan.yaw)), strict=True
            )
        ]
        return self._make("nav_msgs/msg/Path")(header=self._header(time, "map"), poses=poses)

    def can(self, frame: BusFrame) -> Any:
        """`can_msgs/Frame`, extended."""
        data = np.zeros(8, dtype=np.uint8)
        data[: len(frame.data)] = list(frame.data)
        return self._make(CAN_TYPE)(
            header=self._header(frame.time, "can"),
            id=frame.can_id,
            is_rtr=False,
            is_extended=True,
            is_error=False,
            dlc=len(frame.data),
            data=data,
        )

    def text(self, content: str) -> Any:
        """`std_msgs/String`."""
        return self._make("std_msgs/msg/String")(data=content)

    def _header(self, time: float, frame: str) -> Any:
        return self._make("std_msgs/msg/Header")(stamp=self.stamp(time), frame_id=frame)

    def _vector(self, x: float, y: float, z: float) -> Any:
        return self._make("geometry_msgs/msg/Vector3")(x=x, y=y, z=z)

    def _twist(self, ego: EgoState) -> Any:
        return self._make("geometry_msgs/msg/Twist")(
            linear=self._vector(ego.speed, ego.lateral_speed, 0.0),
            angular=self._vector(0.0, 0.0, ego.yaw_rate),
        )

    def _pose(self, x: float, y: float, z: float, yaw: float, pitch: float, roll: float) -> Any:
        return self._make("geometry_msgs/msg/Pose")(
            position=self._make("geometry_msgs/msg/Point")(x=x, y=y, z=z),
            orientation=self._quaternion(yaw, pitch, roll),
        )

    def _quaternion(self, yaw: float, pitch: float, roll: float) -> Any:
        """Of a turn by yaw, then pitch, then roll, each about the axis as it is then."""
        (cy, sy), (cp, sp), (cr, sr) = (
            (math.cos(0.5 * angle), math.sin(0.5 * angle)) for angle in (yaw, pitch, roll)
        )
        return self._make("geometry_msgs/msg/Quaternion")(
            x=sr * cp * cy - cr * sp * sy,
            y=cr * sp * cy + sr * cp * sy,
            z=cr * cp * sy - sr * sp * cy,
            w=cr * cp * cy + sr * sp * sy,
        )

    def _transform(
        self,
        time: float,
        parent: str,
        child: str,
        place: tuple[float, float, float],
        turn: tuple[float, float, float],
    ) -> Any:
        return self._make("geometry_msgs/msg/TransformStamped")(
            header=self._header(time, parent),
            child_frame_id=child,
            transform=self._make("geometry_msgs/msg/Transform")(
                translation=self._vector(*place), rotation=self._quaternion(*turn)
            ),
        )

    def _marker(
        self,
        time: float,
        number: int,
        name: str,
        action: int,
        pose: tuple[float, ...],
        size: tuple[float, ...],
        kind: str,
    ) -> Any:
        red, green, blue = _COLORS.get(kind, (0.6, 0.6, 0.6))
        return self._make("visualization_msgs/msg/Marker")(
            header=self._header(time, "map"),
            ns="traffic",
            id=number,
            type=_CUBE,
            action=action,
            pose=self._pose(*pose),
            scale=self._vector(*size),
            color=self._make("std_msgs/msg/ColorRGBA")(r=red, g=green, b=blue, a=1.0),
            lifetime=self._make("builtin_interfaces/msg/Duration")(sec=0, nanosec=0),
            frame_locked=False,
            points=[],
            colors=[],
            texture_resource="",
            texture=self._make("sensor_msgs/msg/CompressedImage")(
                header=self._header(time, ""), format="", data=np.zeros(0, dtype=np.uint8)
            ),
            uv_coordinates=[],
            text=name,
            mesh_resource="",
            mesh_file=self._make("visualization_msgs/msg/MeshFile")(
                filename="", data=np.zeros(0, dtype=np.uint8)
            ),
            mesh_use_embedded_materials=False,
        )
