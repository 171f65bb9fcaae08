"""Mocap bodies of the mirrored vehicles, and contact between them and the truck.

A body's frame is on the ground under the vehicle's center, for the two units of an articulated
truck under the kingpin: x forward, y left, z up. Meshes are visual only; the boxes of the hull take
part in contact detection.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from iits_mj import kernels
from iits_mj.core.boxes import axis_gaps
from iits_mj.model.visuals.shapes import VISUAL_GROUP, add_mesh
from traffic_bridge.mirror.looks import Unit
from traffic_bridge.vehicles.types import VehicleType

CONTACT_GROUP = 3
# Contact bits: the truck's hull has type 2 and affinity 5, so vehicles collide with the truck but
# not with each other or the ground.
CONTACT_TYPE = 4
CONTACT_AFFINITY = 2
# MuJoCo lists contacts when the boxes touch (margin + gap = 0); the low margin keeps them out of
# the solver: detection without force.
DETECTION_GAP = 100.0
# Greatest relative acceleration of two vehicles, both braking or steering as hard as tires allow.
ACCELERATION = 20.0  # [m/s2]
SLACK = 0.1  # [m] for heights, tilt and the correction of the newest frame

PREFIX = "traffic"
# Color, specular and shininess of the materials that all vehicles share.
MATERIALS = {
    "glass": ((0.06, 0.08, 0.10, 1.0), 0.9, 0.9),
    "dark": ((0.05, 0.05, 0.055, 1.0), 0.1, 0.1),
    "rim": ((0.55, 0.56, 0.58, 1.0), 0.6, 0.6),
    "headlamp": ((0.95, 0.95, 0.88, 1.0), 0.9, 0.9),
    "tail_lamp": ((0.70, 0.04, 0.04, 1.0), 0.6, 0.6),
    "indicator_left": ((0.85, 0.42, 0.05, 1.0), 0.6, 0.6),
    "indicator_right": ((0.85, 0.42, 0.05, 1.0), 0.6, 0.6),
    "cargo": ((0.86, 0.86, 0.84, 1.0), 0.2, 0.2),
}


def add_assets(spec: mujoco.MjSpec, looks: Mapping[VehicleType, tuple[Unit, ...]]) -> None:
    """Adds the materials, and each type's meshes once for all its bodies."""
    for name, (color, specular, shininess) in MATERIALS.items():
        spec.add_material(
            name=f"{PREFIX}_{name}", rgba=list(color), specular=specular, shininess=shininess
        )
    for kind, units in looks.items():
        for number, paint in enumerate(kind.colors):
            spec.add_material(
                name=f"{PREFIX}_{kind.name}_paint_{number}",
                rgba=[*paint, 1.0],
                specular=0.7,
                shininess=0.8,
            )
        for unit in units:
            for part, shape in unit.meshes.items():
                add_mesh(spec, _mesh_name(kind, unit, part), shape)


def unit_name(slot: str, unit: Unit) -> str:
    """Name of the body of one unit of the vehicle in a slot."""
    return f"{slot}_{unit.name}" if unit.name else slot


def add_unit(
    spec: mujoco.MjSpec,
    name: str,
    kind: VehicleType,
    unit: Unit,
    paint: int,
    parking: Sequence[float],
    visuals: bool,
) -> None:
    """Adds the body of one unit.

    Args:
      spec: that has the meshes and materials of `add_assets`.
      name: of the body, see `unit_name`; its geoms' names begin with it.
      kind: type of the vehicle.
      unit: with meshes and hull.
      paint: number of the color in `kind.colors`.
      parking: position of the body while its slot is free [m].
      visuals: adds the meshes; without them, only the hull.
    """
    body = spec.worldbody.add_body(name=name, mocap=True, pos=list(parking))
    for number, (center, size) in enumerate(unit.hull):
        body.add_geom(
            name=f"{name}_hull_{number}",
            type=mujoco.mjtGeom.mjGEOM_BOX,
            pos=list(center),
            size=[0.5 * extent for extent in size],
            rgba=[0.9, 0.3, 0.1, 0.3],
            contype=CONTACT_TYPE,
            conaffinity=CONTACT_AFFINITY,
            group=CONTACT_GROUP,
            margin=-DETECTION_GAP,
            gap=DETECTION_GAP,
        )
    for part in unit.meshes if visuals else ():
        material = f"{kind.name}_paint_{paint}" if part == "paint" else part
        body.add_geom(
            name=f"{name}_{part}",
            type=mujoco.mjtGeom.mjGEOM_MESH,
            meshname=_mesh_name(kind, unit, part),
            material=f"{PREFIX}_{material}",
            contype=0,
            conaffinity=0,
            group=VISUAL_GROUP,
        )


def _mesh_name(kind: VehicleType, unit: Unit, part: str) -> str:
    return f"{unit_name(f'{PREFIX}_{kind.name}', unit)}_{part}"


class ContactFinder:
    """Reads contacts between the truck's and the vehicles' hulls from MuJoCo's list.

    Attributes:
      hull: geoms of the truck's hull, shape (n,).
      radius: of a circle about each geom's center that holds it at any tilt, as in
        `truck_outlines` [m].
      complete: no other geoms of the model can collide.

    Args:
      model: compiled with the bodies of the pool.
      vehicle_bodies: number by body name, for all bodies of the pool.
    """

    def __init__(self, model: mujoco.MjModel, vehicle_bodies: Mapping[str, int]) -> None:
        self._model = model
        self._body_name = [model.body(body).name for body in model.geom_bodyid]
        self._number = np.array(
            [vehicle_bodies.get(name, -1) for name in self._body_name], dtype=np.intp
        )
        moving = model.body_weldid[model.geom_bodyid] != 0
        meets = (model.geom_contype & CONTACT_AFFINITY) | (model.geom_conaffinity & CONTACT_TYPE)
        self._truck = (self._number < 0) & moving & (meets != 0)
        self._geoms = np.flatnonzero(self._truck)
        self.hull = kernels.Table(self._geoms)
        self._sizes = model.geom_size[self._truck].tolist()
        length, width, height = model.geom_size[self._truck].T
        self.radius = kernels.Table(np.hypot(length + height, width + height))
        self.complete = self._is_complete(model)

    def _is_complete(self, model: mujoco.MjModel) -> bool:
        """Whether MuJoCo can only find contacts of the truck's hull with a vehicle's."""
        owner = np.where(self._truck, 1, np.where(self._number >= 0, 2, 0))
        bits = np.stack((owner, model.geom_contype, model.geom_conaffinity), axis=1)
        kinds = np.unique(bits, axis=0).tolist()
        return not (model.npair or model.nflex) and all(
            {one[0], other[0]} == {1, 2} or not (one[1] & other[2] or other[1] & one[2])
            for one, other in itertools.combinations_with_replacement(kinds, 2)
        )

    def pairs(self, data: mujoco.MjData) -> list[tuple[int, str]]:
        """(number of the vehicle's body, name of the truck's body) of every contact, sorted."""
        count = data.ncon
        if count == 0:
            return []
        pairs = data.contact.geom[:count]
        first, second = pairs[:, 0], pairs[:, 1]
        hits = (self._number[first] >= 0) & self._truck[second]
        hits |= (self._number[second] >= 0) & self._truck[first]
        found = set()
        for k in np.flatnonzero(hits & (data.contact.dist[:count] <= 0.0)).tolist():
            a, b = int(first[k]), int(second[k])
            vehicle, truck = (a, b) if self._number[a] >= 0 else (b, a)
            found.add((int(self._number[vehicle]), self._body_name[truck]))
        return sorted(found)

    def truck_outlines(self, data: mujoco.MjData) -> list[Outline]:
        """The truck's hull from above and its motion, at the state last computed."""
        model, found = self._model, []
        velocity = np.empty(6)
        axes = data.geom_xmat.take(self._geoms, axis=0).tolist()
        centers = data.geom_xpos.take(self._geoms, axis=0).tolist()
        parts = zip(self._geoms.tolist(), self._sizes, centers, axes, strict=True)
        for geom, (length, width, height), (x, y, _), (xx, _, xz, yx, _, yz, *_) in parts:
            mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_GEOM, geom, velocity, 0)
            _, _, turn, vx, vy, _ = velocity.tolist()
            # A tilted hull covers more ground.
            lean = height * math.hypot(xz, yz)
            spin = abs(turn) * math.hypot(length, width)
            yaw = math.atan2(yx, xx)
            box = x, y, math.cos(yaw), math.sin(yaw), length + lean, width + lean
            found.append(Outline(*box, vx, vy, spin))
        return found


@dataclass(frozen=True, slots=True)
class Outline:
    """A rectangle that moves in the plane.

    Attributes:
      x, y: of its center [m].
      ahead_x, ahead_y: forward direction.
      half_length, half_width: [m].
      velocity_x, velocity_y: of its center [m/s].
      spin: greatest speed of a corner by rotation [m/s].
    """

    x: float
    y: float
    ahead_x: float
    ahead_y: float
    half_length: float
    half_width: float
    velocity_x: float = 0.0
    velocity_y: float = 0.0
    spin: float = 0.0


def separation(a: Outline, b: Outline) -> float:
    """A lower bound of the distance of two rectangles [m]; zero or negative: they overlap."""
    one = a.ahead_x, a.ahead_y, a.half_length, a.half_width
    other = b.ahead_x, b.ahead_y, b.half_length, b.half_width
    return float(max(axis_gaps(b.x - a.x, b.y - a.y, one, other)))


def may_touch(a: Outline, b: Outline, within: float) -> bool:
    """Whether two rectangles may touch within a time [s], however they brake and steer."""
    closing = math.hypot(a.velocity_x - b.velocity_x, a.velocity_y - b.velocity_y)
    closing += a.spin + b.spin
    return separation(a, b) <= closing * within + 0.5 * ACCELERATION * within**2 + SLACK
