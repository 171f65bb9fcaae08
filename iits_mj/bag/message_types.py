"""Messages of a bag as ROS 2 types: our own dataclasses, and the standard messages of a drive.

Definitions and conversions of our own types are derived from the dataclasses:

| Python                         | ROS 2                                                  |
|--------------------------------|--------------------------------------------------------|
| float, int, bool, str          | float64, int64, bool, string                           |
| IntEnum                        | int64; other enumerations: string, their value         |
| arrays and tuples of floats    | float64[]                                              |
| float or None                  | float64, nan for None                                  |
| enumeration or None            | string, empty for None                                 |
| int or None                    | int64[], empty for None                                |
| dataclass; dataclass or None   | message; message[], empty for None                     |
| sequence of dataclasses        | message[]                                              |
| dictionary of floats           | string[] `<field>_names` and float64[] `<field>`       |

Standard messages follow REP 103 and 105: meters and radians, x forward, y left, z up; frames `map`,
`tractor` (center of the steer axle, on the ground) and one for each towed unit, with its name
(`trailer`: kingpin, at the height of `tractor`). Roll is positive to the right and pitch nose down,
both here and there.
"""

from __future__ import annotations

import dataclasses
import enum
import functools
import itertools
import math
import types
import typing
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from iits_mj.bag.foxglove import GLTF
from iits_mj.core.messages import (
    Decision,
    EgoFootprint,
    EgoState,
    RoadSignals,
    Scene,
    SignalLamp,
    SpeedZone,
    TrackedVehicle,
    TrafficLight,
    Trajectory,
    VehicleCommand,
)
from iits_mj.j1939 import Frame as BusFrame
from iits_mj.parameters import TruckParameters

PACKAGE = "iits_msgs/msg"
# The ROS package can_msgs is not part of every distribution.
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
# `dataclasses.is_dataclass` narrows types to instances, which these are not.
_is_message: Callable[[Any], bool] = dataclasses.is_dataclass
_PLAIN = {float: "float64", int: "int64", bool: "bool", str: "string"}

# Returns the class of a ROS 2 type by its name.
Make = Callable[[str], type]


@dataclass(frozen=True, slots=True)
class Decided:
    """A decision with its time [s], and the highest speed that it allows [m/s]."""

    time: float
    decision: Decision
    speed_max: float = math.inf


# A type follows the types that it contains.
MESSAGES = (
    *(EgoState, EgoFootprint, TrackedVehicle, TrafficLight, SpeedZone, SignalLamp),
    RoadSignals,
    *(Scene, Trajectory, VehicleCommand, Decided),
)


def type_name(kind: type) -> str:
    """Name of the ROS 2 type of a dataclass."""
    return f"{PACKAGE}/{kind.__name__}"


def definition(kind: type) -> str:
    """Text of the `.msg` file of a dataclass."""
    parts = [part for field in _fields(kind) for part in field.types.items()]
    return "".join(f"{ros} {name}\n" for name, ros in parts)


def encode(message: Any, make: Make) -> Any:
    """Converts a dataclass, one of `MESSAGES`, to an instance of its ROS 2 type."""
    values: dict[str, Any] = {}
    kind: Any = type(message)
    for field in _fields(kind):
        parts = field.write(getattr(message, field.name), make)
        values.update(zip(field.types, parts, strict=True))
    return make(type_name(kind))(**values)


def decode(message: Any, kind: type) -> Any:
    """Converts an instance of a ROS 2 type to its dataclass."""
    return kind(
        **{
            field.name: field.read(*(getattr(message, part) for part in field.types))
            for field in _fields(kind)
        }
    )


@dataclass(frozen=True)
class _Field:
    """A field of a dataclass in its ROS 2 message.

    Attributes:
      name: of the field; types: ROS 2 types by name in the message, several for a dictionary.
      write: converts the value to the values of `types`, with `Make`; read: converts them back.
    """

    name: str
    types: dict[str, str]
    write: Callable[[Any, Make], tuple[Any, ...]]
    read: Callable[..., Any]


@functools.cache
def _fields(kind: Any) -> tuple[_Field, ...]:
    hints = typing.get_type_hints(kind)
    return tuple(_field(field.name, hints[field.name]) for field in dataclasses.fields(kind))


def _field(name: str, hint: Any) -> _Field:
    """The field of a dataclass by its type hint; see the module's table."""

    def field(ros: str, write: Callable[[Any, Make], Any], read: Callable[[Any], Any]) -> _Field:
        return _Field(name, {name: ros}, lambda value, make: (write(value, make),), read)

    origin, inside = typing.get_origin(hint), typing.get_args(hint)
    kind: Any = hint
    if origin in (typing.Union, types.UnionType):
        (kind,) = (part for part in inside if part is not type(None))
        if kind is float:
            return field(
                "float64",
                lambda v, _: math.nan if v is None else float(v),
                lambda v: None if math.isnan(v) else float(v),
            )
        if kind is int:
            return field(
                "int64[]",
                lambda v, _: np.array([] if v is None else [v], dtype=np.int64),
                lambda v: int(v[0]) if len(v) else None,
            )
        if _is_message(kind):
            return field(
                f"{type_name(kind)}[]",
                lambda v, make: [] if v is None else [encode(v, make)],
                lambda v: decode(v[0], kind) if len(v) else None,
            )
        return field(
            "string",
            lambda v, _: "" if v is None else str(v.value),
            lambda v: None if v == "" else kind(v),
        )
    if kind in _PLAIN:
        return field(_PLAIN[kind], lambda v, _: kind(v), kind)
    if origin is dict:
        return _Field(
            name,
            {f"{name}_names": "string[]", name: "float64[]"},
            lambda v, _: (list(v), np.array(list(v.values()), dtype=np.float64)),
            lambda names, v: dict(zip(names, np.asarray(v).tolist(), strict=True)),
        )
    if _is_message(kind):
        return field(type_name(kind), encode, lambda v: decode(v, kind))
    if isinstance(kind, type) and issubclass(kind, enum.IntEnum):
        return field("int64", lambda v, _: int(v), kind)
    if isinstance(kind, type) and issubclass(kind, enum.Enum):
        return field("string", lambda v, _: str(v.value), kind)
    if inside and _is_message(inside[0]):
        (part, *_) = inside
        return field(
            f"{type_name(part)}[]",
            lambda v, make: [encode(item, make) for item in v],
            lambda v: tuple(decode(item, part) for item in v),
        )
    is_tuple = origin is tuple
    return field(
        "float64[]",
        lambda v, _: np.ascontiguousarray(v, dtype=np.float64),
        lambda v: tuple(np.asarray(v).tolist()) if is_tuple else np.array(v, dtype=np.float64),
    )


class StandardMessages:
    """Makes the standard ROS 2 messages: odometry, twist, frames, markers, path, CAN.

    Args:
      make: class of a ROS 2 type by its name.
      parameters: of the truck.
    """

    def __init__(self, make: Make, parameters: TruckParameters) -> None:
        self._make = make
        self._units = [unit.name for unit in parameters.units]
        self._hitches = [coupling.position for coupling in parameters.couplings]
        self._no_covariance = np.zeros(36)

    def odometry(self, ego: EgoState) -> Any:
        """`nav_msgs/Odometry` of the tractor in the map; twist in the tractor's frame."""
        pose = self._new(
            "geometry_msgs/PoseWithCovariance",
            pose=self._pose(ego.x, ego.y, ego.z, ego.yaw, ego.pitch, ego.roll),
            covariance=self._no_covariance,
        )
        twist = self._new(
            "geometry_msgs/TwistWithCovariance",
            twist=self._twist(ego),
            covariance=self._no_covariance,
        )
        header = self._header(ego.time, "map")
        return self._new(
            "nav_msgs/Odometry", header=header, child_frame_id="tractor", pose=pose, twist=twist
        )

    def transforms(self, ego: EgoState) -> Any:
        """`tf2_msgs/TFMessage`: map to tractor, and each unit to the one that it tows."""
        place, turn = (ego.x, ego.y, ego.z), (ego.yaw, ego.pitch, ego.roll)
        found = [self._transform(ego.time, "map", "tractor", place, turn)]
        # A truck without trailer reports an articulation, too.
        angles = (ego.articulation, *ego.rear_articulations)
        for (ahead, unit), hitch, angle in zip(
            itertools.pairwise(self._units), self._hitches, angles, strict=False
        ):
            fold = (-angle, 0.0, 0.0)
            found.append(self._transform(ego.time, ahead, unit, (-hitch, 0.0, 0.0), fold))
        return self._new("tf2_msgs/TFMessage", transforms=found)

    def twist(self, ego: EgoState) -> Any:
        """`geometry_msgs/TwistStamped` of the tractor in its own frame."""
        header = self._header(ego.time, "tractor")
        return self._new("geometry_msgs/TwistStamped", header=header, twist=self._twist(ego))

    def markers(self, time: float, vehicles: Iterable[TrackedVehicle]) -> Any:
        """`visualization_msgs/MarkerArray`: removes all boxes, then one for each vehicle."""
        found = [self._marker(time, 0, "", _DELETE_ALL, (0.0,) * 6, (0.0,) * 3, "car")]
        for number, v in enumerate(vehicles):
            pose = (v.x, v.y, v.z + 0.5 * v.height, v.yaw, v.pitch, v.roll)
            size = (v.length, v.width, v.height)
            found.append(self._marker(time, number, v.id, 0, pose, size, v.kind))
        return self._new("visualization_msgs/MarkerArray", markers=found)

    def path(self, time: float, plan: Trajectory) -> Any:
        """`nav_msgs/Path` of a plan, each pose with its planned time."""
        columns = (v.tolist() for v in (plan.time, plan.x, plan.y, plan.z, plan.yaw))
        poses = [
            self._new(
                "geometry_msgs/PoseStamped",
                header=self._header(max(at, 0.0), "map"),
                pose=self._pose(x, y, z, yaw, 0.0, 0.0),
            )
            for at, x, y, z, yaw in zip(*columns, strict=True)
        ]
        return self._new("nav_msgs/Path", header=self._header(time, "map"), poses=poses)

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

    def models(self, found: Mapping[str, bytes]) -> Any:
        """`foxglove_msgs/SceneUpdate` with the binary glTF of each unit, fixed to its frame."""
        entities = [
            self._new(
                "foxglove_msgs/SceneEntity",
                timestamp=self._time(0.0),
                frame_id=unit,
                id=unit,
                lifetime=self._new("builtin_interfaces/Duration", sec=0, nanosec=0),
                frame_locked=True,
                metadata=[],
                **{
                    f"{kind}s": []
                    for kind in ("arrow", "cube", "sphere", "cylinder", "line", "triangle", "text")
                },
                models=[
                    self._new(
                        "foxglove_msgs/ModelPrimitive",
                        pose=self._pose(*[0.0] * 6),
                        scale=self._vector(1.0, 1.0, 1.0),
                        color=self._new("foxglove_msgs/Color", r=1.0, g=1.0, b=1.0, a=1.0),
                        override_color=False,
                        url="",
                        media_type=GLTF,
                        data=np.frombuffer(content, dtype=np.uint8),
                    )
                ],
            )
            for unit, content in found.items()
        ]
        return self._new("foxglove_msgs/SceneUpdate", deletions=[], entities=entities)

    def picture(self, time: float, jpeg: bytes) -> Any:
        """`sensor_msgs/CompressedImage` of a JPEG picture."""
        return self._new(
            "sensor_msgs/CompressedImage",
            header=self._header(time, "camera"),
            format="jpeg",
            data=np.frombuffer(jpeg, dtype=np.uint8),
        )

    def text(self, content: str) -> Any:
        """`std_msgs/String`."""
        return self._new("std_msgs/String", data=content)

    def quaternion(self, yaw: float, pitch: float, roll: float) -> Any:
        """Rotation by yaw, then pitch, then roll, each about the rotated axis."""
        (cy, sy), (cp, sp), (cr, sr) = (
            (math.cos(0.5 * angle), math.sin(0.5 * angle)) for angle in (yaw, pitch, roll)
        )
        return self._new(
            "geometry_msgs/Quaternion",
            x=sr * cp * cy - cr * sp * sy,
            y=cr * sp * cy + sr * cp * sy,
            z=cr * cp * sy - sr * sp * cy,
            w=cr * cp * cy + sr * sp * sy,
        )

    def _new(self, kind: str, **fields: Any) -> Any:
        """A message of the type "package/Name"."""
        package, name = kind.split("/")
        return self._make(f"{package}/msg/{name}")(**fields)

    def _time(self, time: float) -> Any:
        second, nanosecond = divmod(round(time * 1e9), 1_000_000_000)
        return self._new("builtin_interfaces/Time", sec=second, nanosec=nanosecond)

    def _header(self, time: float, frame: str) -> Any:
        return self._new("std_msgs/Header", stamp=self._time(time), frame_id=frame)

    def _vector(self, x: float, y: float, z: float) -> Any:
        return self._new("geometry_msgs/Vector3", x=x, y=y, z=z)

    def _twist(self, ego: EgoState) -> Any:
        return self._new(
            "geometry_msgs/Twist",
            linear=self._vector(ego.speed, ego.lateral_speed, 0.0),
            angular=self._vector(0.0, 0.0, ego.yaw_rate),
        )

    def _pose(self, x: float, y: float, z: float, *angles: float) -> Any:
        point = self._new("geometry_msgs/Point", x=x, y=y, z=z)
        orientation = self.quaternion(*angles)
        return self._new("geometry_msgs/Pose", position=point, orientation=orientation)

    def _transform(
        self, time: float, parent: str, child: str, place: tuple[float, ...], turn: Sequence[float]
    ) -> Any:
        return self._new(
            "geometry_msgs/TransformStamped",
            header=self._header(time, parent),
            child_frame_id=child,
            transform=self._new(
                "geometry_msgs/Transform",
                translation=self._vector(*place),
                rotation=self.quaternion(*turn),
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
        nothing = np.zeros(0, dtype=np.uint8)
        return self._new(
            "visualization_msgs/Marker",
            header=self._header(time, "map"),
            ns="traffic",
            id=number,
            type=_CUBE,
            action=action,
            pose=self._pose(*pose),
            scale=self._vector(*size),
            color=self._new("std_msgs/ColorRGBA", r=red, g=green, b=blue, a=1.0),
            lifetime=self._new("builtin_interfaces/Duration", sec=0, nanosec=0),
            frame_locked=False,
            points=[],
            colors=[],
            texture_resource="",
            texture=self._new(
                "sensor_msgs/CompressedImage",
                header=self._header(time, ""),
                format="",
                data=nothing,
            ),
            uv_coordinates=[],
            text=name,
            mesh_resource="",
            mesh_file=self._new("visualization_msgs/MeshFile", filename="", data=nothing),
            mesh_use_embedded_materials=False,
        )
