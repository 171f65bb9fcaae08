"""Recorded drives as ASAM OpenSCENARIO XML 1.3, with their map as OpenDRIVE.

Every road user follows its recorded path at the recorded times; one that comes later is added then,
and one that leaves is deleted. Positions are those of the reference point of OpenSCENARIO: the
middle of the rear axle on the ground, for what does not roll the center of its box.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple
from xml.etree.ElementTree import Element

import numpy as np

from iits_mj.core.arrays import FloatArray, IntArray
from iits_mj.core.context import Finishing
from iits_mj.core.errors import InputError
from iits_mj.core.messages import EgoState, Scene, Trajectory
from iits_mj.core.output_files import OutputFile, write_whole
from iits_mj.core.vehicles import VehicleFrame
from iits_mj.export.osi import unit_motions
from iits_mj.parameters import TruckParameters
from iits_mj.parameters.units import Unit
from iits_mj.road import Route
from iits_mj.simulation.gaps import truck_units
from iits_mj.simulation.lock_step import Observer
from iits_mj.simulation.loop import Simulation
from traffic_bridge import Recording
from traffic_bridge.recording.rows import COLUMNS, ego_row

EGO = "Ego"
MINOR_VERSION = 3
# Recordings have no axles: shares of the length from a vehicle's rear to its axles, of a passenger
# car with a wheelbase of 0.6 of its length.
REAR_AXLE, FRONT_AXLE = 0.2, 0.8
WHEEL_DIAMETER = 0.65  # [m], likewise
# Beyond what any trajectory needs, since trajectories give the motion: speed [m/s], acceleration
# and deceleration [m/s2].
PERFORMANCE = 70.0, 15.0, 15.0
_VEHICLES = {
    "car": "car",
    "van": "van",
    "truck": "truck",
    "articulated": "truck",
    "bicycle": "bicycle",
}
_X, _Y, _Z, _YAW, _PITCH, _ROLL, _SPEED = (
    COLUMNS.index(name) for name in ("x", "y", "z", "yaw", "pitch", "roll", "speed")
)


class Track(NamedTuple):
    """A road user from its appearance to its end.

    Attributes:
      name: of the entity; body: what it is, of scenariogeneration, None for the truck.
      frames: of the recording, without gaps, shape (n,).
      poses: of the reference point: x, y, z [m], yaw, pitch, roll [rad], shape (n, 6).
      speed: at the beginning [m/s].
    """

    name: str
    body: Any
    frames: IntArray
    poses: FloatArray
    speed: float


@functools.cache
def xosc_package() -> ModuleType:
    """Returns scenariogeneration's module; InputError if it is not installed."""
    try:
        from scenariogeneration import xosc
    except ImportError as error:
        raise InputError(
            "OpenSCENARIO needs scenariogeneration: pip install 'iits-mj[export]'"
        ) from error
    return xosc


def write_recording(
    path: Path, recording: Recording, parameters: TruckParameters | None, route: Route
) -> tuple[Path, Path]:
    """Writes a recorded drive as FILE.xosc, and its map as FILE.xodr beside it.

    The truck is the entity Ego, with its trailers. Lights, weather and friction are not written.

    Args:
      path: of the file, ending with .xosc.
      recording: with at least two frames.
      parameters: of the truck; None: there is none.
      route: of the truck, on the recording's map.

    Returns:
      The two paths.

    Raises:
      InputError: scenariogeneration is missing, the path has another ending, the recording is
        empty, or a file cannot be written.
    """
    check_target(path, route)
    if len(recording) < 2:
        raise InputError(f"the recording has {len(recording)} frames: a drive has at least 2")
    xosc = xosc_package()
    entities, init, story = xosc.Entities(), xosc.Init(), xosc.Story("traffic")
    act = xosc.Act("traffic", at_time(0.0), xosc.Trigger("stop"))
    tracks: list[Track] = []
    if parameters is not None and recording.ego_at(0) is not None:
        tracks.append(_truck(recording, parameters, route))
        add_truck(entities, parameters)
    tracks += _others(recording, {EGO, *(_trailer_name(k) for k in range(1, 10))})
    time, last = recording.time - recording.time[0], len(recording) - 1
    for track in tracks:
        if len(track.frames) < 2:
            continue  # seen for one instant: without a path
        if track.name != EGO:
            entities.add_scenario_object(track.name, track.body)
        begin, end = int(track.frames[0]), int(track.frames[-1])
        group = xosc.ManeuverGroup(track.name)
        group.add_actor(track.name)
        maneuver = xosc.Maneuver(track.name)
        if begin == 0:
            init.add_init_action(track.name, xosc.TeleportAction(_position(track.poses[0])))
            init.add_init_action(track.name, speed_action(track.speed))
            init.add_init_action(track.name, _trajectory(track, time[track.frames]))
        else:
            appears = xosc.Event(f"{track.name} appears", xosc.Priority.parallel)
            position = _position(track.poses[0])
            appears.add_action(f"add {track.name}", xosc.AddEntityAction(track.name, position))
            appears.add_action(f"start {track.name}", speed_action(track.speed))
            appears.add_action(
                f"drive {track.name}", _trajectory(track, time[track.frames] - time[begin])
            )
            appears.add_trigger(at_time(float(time[begin])))
            maneuver.add_event(appears)
        if end < last:
            leaves = xosc.Event(f"{track.name} leaves", xosc.Priority.parallel)
            leaves.add_action(f"delete {track.name}", xosc.DeleteEntityAction(track.name))
            leaves.add_trigger(at_time(float(time[end + 1])))
            maneuver.add_event(leaves)
        if begin or end < last:
            group.add_maneuver(maneuver)
            act.add_maneuver_group(group)
    board = xosc.StoryBoard(init, at_time(float(time[-1]), "stop"))
    if act.maneuvergroup:
        story.add_act(act)
        board.add_story(story)
    return write_scenario(path, route, scenario_element(path, entities, board))


def scenario_element(path: Path, entities: Any, board: Any, variables: Any = None) -> Element:
    """Returns the root of a file, of scenariogeneration's parts."""
    xosc = xosc_package()
    made: Element = xosc.Scenario(
        *("a drive of iits_mj", "iits_mj", xosc.ParameterDeclarations(), entities, board),
        *(xosc.RoadNetwork(path.with_suffix(".xodr").name), xosc.Catalog()),
        osc_minor_version=MINOR_VERSION,
        variable_declaration=variables,
    ).get_element()
    return made


def write_scenario(path: Path, route: Route, root: Element) -> tuple[Path, Path]:
    """Writes a scenario and its map; returns the two paths."""
    from scenariogeneration.helpers import printToFile

    source, road = route.road_map.path, path.with_suffix(".xodr")
    if not (road.is_file() and road.samefile(source)):
        write_whole(road, source.read_bytes(), "map")
    with OutputFile(path, "OpenSCENARIO file") as partial:
        printToFile(root, str(partial))
    return path, road


def add_truck(entities: Any, parameters: TruckParameters) -> None:
    """Adds the truck, the entity Ego, and its trailers."""
    for k in (*range(1, len(parameters.units)), 0):
        name = _trailer_name(k) if k else EGO
        entities.add_scenario_object(name, _unit(parameters.units[k], k, parameters))


class XoscLog(Finishing, Observer):
    """Observer that writes a drive as an OpenSCENARIO file when it ends; a context manager.

    Args:
      path: of the file.
      simulation: at its start.

    Raises:
      InputError: as of `write_recording`.
    """

    def __init__(self, path: Path, simulation: Simulation) -> None:
        check_target(path, simulation.route)
        self._path, self._route = path, simulation.route
        self._parameters = simulation.truck.parameters
        self._times: list[float] = []
        self._states: list[tuple[float, ...]] = []
        self._frames: list[VehicleFrame] = []

    def planned(self, scene: Scene, trajectory: Trajectory) -> None:
        """Keeps the road users of a scene."""
        del trajectory
        self._times.append(scene.time)
        self._states.append(ego_row(scene.ego))
        self._frames.append(VehicleFrame.of(scene.vehicles))

    def close(self) -> None:
        """Writes the file; the drive must have at least two scenes."""
        recording = Recording.of_frames({}, np.array(self._times), self._frames)
        recording = replace(recording, ego=np.array(self._states))
        write_recording(self._path, recording, self._parameters, self._route)

    def abandon(self) -> None:
        """Writes nothing."""


def check_target(path: Path, route: Route) -> None:
    """Checks what a file needs before a drive begins."""
    xosc_package()
    if path.suffix != ".xosc":
        raise InputError(f"OpenSCENARIO file {str(path)!r}: its name must end with .xosc")
    if not route.road_map.path.is_file():
        raise InputError(
            f"the map {route.road_map.path} is no OpenDRIVE file, which a scenario needs"
        )


def _truck(recording: Recording, parameters: TruckParameters, route: Route) -> Track:
    """The truck's track."""
    poses, frames = [], []
    first = recording.ego_at(0)
    assert first is not None
    rear, box = reference_of(parameters.units[0]), truck_units(first, parameters)[0]
    # The center of the box is on the surface; the reference point lies in its plane.
    back = rear + 0.5 * (box.ahead - box.behind)
    for k in range(len(recording)):
        ego = recording.ego_at(k)
        if ego is None:
            break
        motion = unit_motions(ego, parameters, route)[0]
        x, y = ego.x - rear * math.cos(ego.yaw), ego.y - rear * math.sin(ego.yaw)
        z = motion.z + back * math.sin(ego.pitch)
        frames.append(k)
        poses.append((x, y, z, ego.yaw, ego.pitch, ego.roll))
    return Track(EGO, None, np.array(frames), np.array(poses), first.speed)


def _others(recording: Recording, taken: set[str]) -> list[Track]:
    """The tracks of the other road users, in the order of their appearance."""
    frame = np.repeat(np.arange(len(recording)), np.diff(recording.start))
    tracks = []
    for number, (kind, size) in enumerate(
        zip(recording.kinds, recording.sizes.tolist(), strict=True)
    ):
        rows = np.flatnonzero(recording.vehicle == number)
        if not len(rows):
            continue
        for part in np.split(rows, np.flatnonzero(np.diff(frame[rows]) > 1) + 1):
            columns = np.asarray(recording.columns[:, part])
            name = _name(recording.ids[number], taken)
            body, back = body_of(name, kind, size)
            yaw = columns[_YAW]
            poses = np.stack(
                [
                    columns[_X] - back * np.cos(yaw),
                    columns[_Y] - back * np.sin(yaw),
                    columns[_Z] + back * np.sin(columns[_PITCH]),
                    *(yaw, columns[_PITCH], columns[_ROLL]),
                ],
                axis=1,
            )
            speed = max(float(columns[_SPEED, 0]), 0.0)
            tracks.append(Track(name, body, frame[part], poses, speed))
    return sorted(tracks, key=lambda track: int(track.frames[0]))


def _name(wanted: str, taken: set[str]) -> str:
    """A name of an entity that no other one has, and that is no parameter."""
    wanted = wanted.lstrip("$") or "vehicle"
    name, number = wanted, 2
    while name in taken:
        name, number = f"{wanted} {number}", number + 1
    taken.add(name)
    return name


def body_of(name: str, kind: str, size: Sequence[float]) -> tuple[Any, float]:
    """A road user, and the distance from its box's center back to its reference point [m]."""
    xosc = xosc_package()
    length, width, height = size
    if kind not in _VEHICLES:
        box = xosc.BoundingBox(width, length, height, 0.0, 0.0, 0.5 * height)
        if kind == "pedestrian":
            return xosc.Pedestrian(name, 75.0, xosc.PedestrianCategory.pedestrian, box), 0.0
        return xosc.MiscObject(name, 100.0, xosc.MiscObjectCategory.obstacle, box), 0.0
    back = round((0.5 - REAR_AXLE) * length, 6)
    box = xosc.BoundingBox(width, length, height, back, 0.0, 0.5 * height)
    base, track = round((FRONT_AXLE - REAR_AXLE) * length, 6), round(0.85 * width, 6)
    front = xosc.Axle(0.6, WHEEL_DIAMETER, track, base, 0.5 * WHEEL_DIAMETER)
    rear = xosc.Axle(0.0, WHEEL_DIAMETER, track, 0.0, 0.5 * WHEEL_DIAMETER)
    category = getattr(xosc.VehicleCategory, _VEHICLES[kind])
    fastest, quickest, hardest = PERFORMANCE
    return xosc.Vehicle(name, category, box, front, rear, fastest, quickest, hardest), back


def reference_of(unit: Unit) -> float:
    """Distance from a unit's origin back to the middle of its axles that do not steer [m]."""
    fixed = [axle.position for axle in unit.axles if not axle.steered]
    return round(sum(fixed) / len(fixed), 6)


def _unit(unit: Unit, number: int, parameters: TruckParameters) -> Any:
    """A unit of the truck with its axles and couplings."""
    xosc = xosc_package()
    reference = reference_of(unit)
    # The units of a truck that stands straight.
    straight = EgoState(rear_articulations=(0.0,) * len(parameters.units))
    shape = truck_units(straight, parameters)[number]
    center = reference + 0.5 * (shape.ahead - shape.behind)
    outline = xosc.BoundingBox(
        *(unit.width, round(shape.ahead + shape.behind, 6), unit.height),
        *(round(center, 6), 0.0, 0.5 * unit.height),
    )
    axles = []
    for axle in unit.axles:
        radius = parameters.tires[axle.tire].rolling_radius
        most = parameters.steering.angle_max / parameters.steering.ratio
        axles.append(
            xosc.Axle(
                *(most if axle.steered else 0.0, 2.0 * radius, axle.track),
                *(round(reference - axle.position, 6), radius),
            )
        )
    fixed = [k for k, axle in enumerate(unit.axles) if not axle.steered]
    rear = min(fixed, key=lambda k: abs(unit.axles[k].position - reference))
    front = 0 if number == 0 else None
    towed = parameters.units[number + 1] if number + 1 < len(parameters.units) else None
    hitch = coupler = None
    if towed is not None and towed.coupling is not None:
        hitch = xosc.HitchCoupler(
            round(reference - towed.coupling.position, 6), towed.coupling.height
        )
    if unit.coupling is not None:
        coupler = xosc.HitchCoupler(reference, unit.coupling.height)
    categories = {"semitrailer": "semitrailer", "tractor": "truck", "rigid_truck": "truck"}
    category = getattr(xosc.VehicleCategory, categories.get(unit.kind, "trailer"))
    made = xosc.Vehicle(
        *(f"{parameters.name} {unit.name}", category, outline),
        *(None if front is None else axles[front], axles[rear], *PERFORMANCE),
        trailer_hitch=hitch,
        trailer_coupler=coupler,
        trailer=None if towed is None else _trailer_name(number + 1),
    )
    for k, axle in enumerate(axles):
        if k not in (front, rear):
            made.add_axle(axle)
    return made


def _trailer_name(number: int) -> str:
    return f"{EGO} trailer {number}"


def _position(pose: FloatArray) -> Any:
    x, y, z, yaw, pitch, roll = (round(float(value), 6) for value in pose)
    return xosc_package().WorldPosition(x, y, z, yaw, pitch, roll)


def speed_action(speed: float) -> Any:
    """An action that gives a speed at once [m/s]."""
    xosc = xosc_package()
    step = xosc.TransitionDynamics(xosc.DynamicsShapes.step, xosc.DynamicsDimension.time, 0.0)
    return xosc.AbsoluteSpeedAction(round(speed, 6), step)


def _trajectory(track: Track, times: FloatArray) -> Any:
    """The recorded path at times since its beginning [s]."""
    xosc = xosc_package()
    path = xosc.Trajectory(f"path of {track.name}", closed=False)
    at = [round(time, 6) for time in times.tolist()]
    path.add_shape(xosc.Polyline(at, [_position(pose) for pose in track.poses]))
    return xosc.FollowTrajectoryAction(
        path, xosc.FollowingMode.position, xosc.ReferenceContext.relative, 1.0, 0.0
    )


def at_time(time: float, point: str = "start") -> Any:
    """A trigger at a simulation time [s]."""
    xosc = xosc_package()
    condition = xosc.SimulationTimeCondition(round(time, 6), xosc.Rule.greaterOrEqual)
    return xosc.ValueTrigger("time", 0.0, xosc.ConditionEdge.none, condition, point)
