"""OSI ground truth of drives: where every road user is, how large it is, and how it moves.

ASAM OSI (Open Simulation Interface) 3.8.0, `osi3.GroundTruth`. Lanes and signs are in the map that
`map_reference` names; the messages hold moving objects only.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from pathlib import Path
from typing import Any, NamedTuple

from iits_mj.core.boxes import UnitBox
from iits_mj.core.context import Finishing
from iits_mj.core.errors import InputError
from iits_mj.core.messages import EgoState, Scene, TrackedVehicle, Trajectory
from iits_mj.core.output_files import OutputFile, unwritable
from iits_mj.parameters import TruckParameters
from iits_mj.road import Route
from iits_mj.simulation.gaps import truck_units
from iits_mj.simulation.lock_step import Observer
from iits_mj.simulation.loop import Simulation
from traffic_bridge import Recording

VERSION = (3, 8, 0)
TOPIC = "ground_truth"
# Names of `MovingObject.VehicleClassification.Type` by kind of road user and of unit.
_TYPES = {
    "car": "TYPE_CAR",
    "van": "TYPE_VAN",
    "truck": "TYPE_HEAVY_TRUCK",
    "articulated": "TYPE_HEAVY_TRUCK",
    "bicycle": "TYPE_BICYCLE",
    "tractor": "TYPE_SEMITRACTOR",
    "rigid_truck": "TYPE_HEAVY_TRUCK",
    "semitrailer": "TYPE_SEMITRAILER",
    "center_axle_trailer": "TYPE_TRAILER",
    "dolly": "TYPE_TRAILER",
}
_FIRST_OTHER = 1001  # identifier of the first other road user; the truck's units begin at 1


class UnitMotion(NamedTuple):
    """A unit of the truck: center of its box on the ground and how it moves, in the map frame.

    Attributes:
      x, y, z: [m]; yaw, pitch, roll: [rad], ISO 8855.
      speed_x, speed_y: of the center [m/s]; yaw_rate: [rad/s].
      length, width, height: [m].
    """

    x: float
    y: float
    z: float
    yaw: float
    pitch: float
    roll: float
    speed_x: float
    speed_y: float
    yaw_rate: float
    length: float
    width: float
    height: float


def unit_motions(ego: EgoState, parameters: TruckParameters, route: Route) -> list[UnitMotion]:
    """Returns place and motion of every unit, front to rear.

    A towed unit stands on the road as its box's center does; its motion follows from that of the
    coupling and from the articulation's rate.
    """
    found: list[UnitMotion] = []
    rates = iter((ego.articulation_rate, *ego.rear_articulation_rates))
    along, across, rate = ego.speed, ego.lateral_speed, ego.yaw_rate  # of the unit's origin
    yaw, station = ego.yaw, ego.station
    for unit, box in zip(parameters.units, truck_units(ego, parameters), strict=True):
        if unit.coupling is not None:
            across -= rate * unit.coupling.position
            turn, station = box.yaw - yaw, station - unit.coupling.position
            cosine, sine = math.cos(turn), math.sin(turn)
            along, across = along * cosine + across * sine, across * cosine - along * sine
            yaw, rate = box.yaw, rate - next(rates)
        found.append(_motion(ego, box, unit.height, (along, across, rate), station, route))
    return found


def _motion(
    ego: EgoState,
    box: UnitBox,
    height: float,
    motion: tuple[float, float, float],
    station: float,
    route: Route,
) -> UnitMotion:
    along, across, rate = motion
    ahead = 0.5 * (box.ahead - box.behind)
    cosine, sine = math.cos(box.yaw), math.sin(box.yaw)
    x, y = box.x + ahead * cosine, box.y + ahead * sine
    point = route.evaluate(*route.locate(x, y, station + ahead))
    pitch, roll = ego.pitch, ego.roll
    if box.yaw != ego.yaw or (box.x, box.y) != (ego.x, ego.y):
        forward = math.cos(box.yaw - float(point.heading))
        pitch = -math.atan(float(point.grade)) * forward
        roll = float(point.superelevation) * forward
    across += rate * ahead
    return UnitMotion(
        *(x, y, float(point.z), box.yaw, pitch, roll),
        *(along * cosine - across * sine, along * sine + across * cosine, rate),
        *(box.ahead + box.behind, box.width, height),
    )


class GroundTruthWriter:
    """Writes `osi3.GroundTruth` messages into an MCAP file, one for each instant.

    The truck's units are objects of their own: the motor vehicle, which is the host, has the
    identifier 1, and names the unit it tows; the others follow. Every other road user is one object
    from 1001 on, in the order of appearance; its `source_reference` has its name.

    Args:
      path: of the file, which appears when it is complete.
      parameters: of the truck; None: there is none.
      route: the truck's road, which gives the height of its units.

    Raises:
      InputError: the packages for OSI are missing, or the file cannot be written.
    """

    def __init__(self, path: Path, parameters: TruckParameters | None, route: Route) -> None:
        if path.suffix != ".mcap":
            raise InputError(f"OSI file {str(path)!r}: its name must end with .mcap")
        try:
            from osi3 import osi_groundtruth_pb2, osi_object_pb2
            from osi_utilities import MultiTraceWriter
            from osi_utilities.tracefile.writers.multi import prepare_required_file_metadata
        except ImportError as error:
            raise InputError(
                "OSI ground truth needs osi-python: pip install 'iits-mj[export]'"
            ) from error
        self.path, self.count = path, 0
        self._message, self._object = osi_groundtruth_pb2.GroundTruth, osi_object_pb2.MovingObject
        self._parameters, self._route = parameters, route
        self._ids: dict[str, int] = {}
        self._file = OutputFile(path, "OSI file")
        self._trace = MultiTraceWriter()
        version = ".".join(map(str, VERSION))
        about = prepare_required_file_metadata()
        about |= {"min_osi_version": version, "max_osi_version": version}
        if not self._trace.open(self._file.partial, about):
            self._file.abandon()
            raise InputError(f"OSI file {str(path)!r} cannot be written")
        channel = {
            "net.asam.osi.trace.channel.osi_version": version,
            "net.asam.osi.trace.channel.protobuf_version": about["min_protobuf_version"],
        }
        self._trace.add_channel(TOPIC, self._message, channel)

    def write(self, time: float, ego: EgoState | None, vehicles: Iterable[TrackedVehicle]) -> None:
        """Writes the road users at a time [s]."""
        truth = self._message()
        truth.version.version_major, truth.version.version_minor = VERSION[:2]
        truth.version.version_patch = VERSION[2]
        _set_time(truth.timestamp, time)
        truth.map_reference = self._route.road_map.path.name
        if ego is not None and self._parameters is not None:
            truth.host_vehicle_id.value = 1
            self._add_truck(truth, ego, self._parameters)
        for vehicle in vehicles:
            self._add(truth, vehicle)
        if not self._trace.write_message(truth, TOPIC):
            raise unwritable("OSI file", self.path, OSError("the disk may be full"))
        self.count += 1

    def _add_truck(self, truth: Any, ego: EgoState, parameters: TruckParameters) -> None:
        motions = unit_motions(ego, parameters, self._route)
        for k, (unit, motion) in enumerate(zip(parameters.units, motions, strict=True)):
            made = truth.moving_object.add()
            made.id.value = k + 1
            made.type = self._object.TYPE_VEHICLE
            kind = made.vehicle_classification
            kind.type = self._object.VehicleClassification.Type.Value(_TYPES[unit.kind])
            kind.has_trailer = k + 1 < len(motions)
            if kind.has_trailer:
                kind.trailer_id.value = k + 2
            _place(made.base, motion)
            _vector(made.base.velocity, motion.speed_x, motion.speed_y, 0.0)
            made.base.orientation_rate.yaw = motion.yaw_rate
            # From the box's center to the middle of the first and of the last axle.
            center = 0.5 * motion.length - unit.front_overhang
            attributes = made.vehicle_attributes
            attributes.number_wheels = 2 * len(unit.axles)
            for axle, vector in (
                (unit.axles[0], attributes.bbcenter_to_front),
                (unit.axles[-1], attributes.bbcenter_to_rear),
            ):
                radius = parameters.tires[axle.tire].rolling_radius
                _vector(vector, center - axle.position, 0.0, radius - 0.5 * motion.height)
            if k == 0:
                cosine, sine = math.cos(ego.yaw), math.sin(ego.yaw)
                a, b = ego.acceleration, ego.lateral_acceleration
                _vector(made.base.acceleration, a * cosine - b * sine, a * sine + b * cosine, 0.0)
                attributes.steering_wheel_angle = ego.steering_wheel_angle
            reference = made.source_reference.add()
            reference.type, reference.identifier[:] = "unit of the truck", [unit.name]

    def _add(self, truth: Any, vehicle: TrackedVehicle) -> None:
        made = truth.moving_object.add()
        made.id.value = self._ids.setdefault(vehicle.id, _FIRST_OTHER + len(self._ids))
        if vehicle.kind in _TYPES:
            made.type = self._object.TYPE_VEHICLE
            types = self._object.VehicleClassification.Type
            made.vehicle_classification.type = types.Value(_TYPES[vehicle.kind])
        else:
            walks = vehicle.kind == "pedestrian"
            made.type = self._object.TYPE_PEDESTRIAN if walks else self._object.TYPE_OTHER
        _place(made.base, vehicle)
        cosine, sine = math.cos(vehicle.yaw), math.sin(vehicle.yaw)
        _vector(made.base.velocity, vehicle.speed * cosine, vehicle.speed * sine, 0.0)
        a = vehicle.acceleration
        _vector(made.base.acceleration, a * cosine, a * sine, 0.0)
        made.base.orientation_rate.yaw = vehicle.yaw_rate
        reference = made.source_reference.add()
        reference.type, reference.identifier[:] = vehicle.kind, [vehicle.id]

    def close(self) -> None:
        """Completes the file."""
        self._trace.close()
        self._file.finish()

    def abandon(self) -> None:
        """Removes the unfinished file."""
        self._trace.close()
        self._file.abandon()


class OsiLog(Finishing, Observer):
    """Observer that writes the ground truth of a drive every 100 ms; a context manager.

    Args:
      path: of the MCAP file.
      simulation: at its start.

    Raises:
      InputError: as of `GroundTruthWriter`.
    """

    def __init__(self, path: Path, simulation: Simulation) -> None:
        self.writer = GroundTruthWriter(path, simulation.truck.parameters, simulation.route)

    def planned(self, scene: Scene, trajectory: Trajectory) -> None:
        """Writes the road users of a scene."""
        del trajectory
        self.writer.write(scene.time, scene.ego, scene.vehicles)

    def close(self) -> None:
        """Completes the file."""
        self.writer.close()

    def abandon(self) -> None:
        """Removes the unfinished file."""
        self.writer.abandon()


def write_recording(
    path: Path, recording: Recording, parameters: TruckParameters | None, route: Route
) -> int:
    """Writes the ground truth of a recorded drive; returns the number of messages."""
    writer = GroundTruthWriter(path, parameters, route)
    try:
        for k, time in enumerate(recording.time.tolist()):
            writer.write(time, recording.ego_at(k), recording.frames[k])
    except BaseException:
        writer.abandon()
        raise
    writer.close()
    return writer.count


def _set_time(stamp: Any, time: float) -> None:
    stamp.seconds, stamp.nanos = divmod(round(time * 1e9), 1_000_000_000)


def _place(base: Any, body: UnitMotion | TrackedVehicle) -> None:
    """Sets size, center and orientation of a box that stands on (x, y, z)."""
    base.dimension.length, base.dimension.width = body.length, body.width
    base.dimension.height = body.height
    _vector(base.position, body.x, body.y, body.z + 0.5 * body.height)
    base.orientation.yaw, base.orientation.pitch = body.yaw, body.pitch
    base.orientation.roll = body.roll


def _vector(vector: Any, x: float, y: float, z: float) -> None:
    vector.x, vector.y, vector.z = x, y, z
