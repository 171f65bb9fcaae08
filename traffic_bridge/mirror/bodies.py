"""Mocap bodies of the mirrored vehicles: what is seen of them, and the boxes by which they touch.

A body's frame is on the ground under the box's centre, of an articulated truck's two units under
the kingpin: x forward, y left, z up. Everything that is seen is visual only; the hull takes part in
contact detection.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import mujoco

from iits_mj.model.shapes import VISUAL_GROUP, add_mesh
from traffic_bridge.mirror.look_parts import Unit
from traffic_bridge.vehicles.registry import VehicleType

CONTACT_GROUP = 3
# Contact bits: the truck's hull has type 2 and affinity 5. So vehicles meet the truck, not each
# other and not the ground.
CONTACT_TYPE = 4
CONTACT_AFFINITY = 2
# Contacts are listed when the boxes touch (margin + gap = 0), but a margin this far below any
# penetration keeps them out of the solver: detection without force.
DETECTION_GAP = 100.0

PREFIX = "traffic"
# Color, specular, shininess of what all vehicles share.
MATERIALS = {
    "glass": ((0.06, 0.08, 0.10, 1.0), 0.9, 0.9),
    "dark": ((0.05, 0.05, 0.055, 1.0), 0.1, 0.1),
    "rim": ((0.55, 0.56, 0.58, 1.0), 0.6, 0.6),
    "headlamp": ((0.95, 0.95, 0.88, 1.0), 0.9, 0.9),
    "tail_lamp": ((0.70, 0.04, 0.04, 1.0), 0.6, 0.6),
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
      kind: whose unit it is.
      unit: what it looks like and where it touches.
      paint: number of the color in `kind.colors`.
      parking: where the body is while nobody is in the slot [m].
      visuals: adds what is seen; without, only the hull.
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
    return (
        f"{PREFIX}_{kind.name}_{unit.name}_{part}" if unit.name else f"{PREFIX}_{kind.name}_{part}"
    )
