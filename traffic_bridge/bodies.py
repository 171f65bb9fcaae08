"""Mocap bodies of the mirrored vehicles: what is seen of them, and the box by which they touch.

A body's frame is the bounding box's centre on the ground: x forward, y left, z up. Everything that
is seen is visual only; one box per vehicle takes part in contact detection.
"""

from __future__ import annotations

from typing import Any

import mujoco

from iits_mj.model.shapes import VISUAL_GROUP, add_mesh
from traffic_bridge.looks import LOOKS
from traffic_bridge.vehicles import VehicleType

CONTACT_GROUP = 3
# Contact bits: the truck's hull has type 2 and affinity 5. So vehicles meet the truck, not each
# other and not the ground.
CONTACT_TYPE = 4
CONTACT_AFFINITY = 2
# Contacts are listed when the boxes touch (margin + gap = 0), but a margin this far below any
# penetration keeps them out of the solver: detection without force.
DETECTION_GAP = 100.0

PREFIX = "traffic"
# Colour, specular, shininess of what all vehicles share.
MATERIALS = {
    "glass": ((0.06, 0.08, 0.10, 1.0), 0.9, 0.9),
    "dark": ((0.05, 0.05, 0.055, 1.0), 0.1, 0.1),
    "rim": ((0.55, 0.56, 0.58, 1.0), 0.6, 0.6),
    "headlamp": ((0.95, 0.95, 0.88, 1.0), 0.9, 0.9),
    "tail_lamp": ((0.70, 0.04, 0.04, 1.0), 0.6, 0.6),
    "cargo": ((0.86, 0.86, 0.84, 1.0), 0.2, 0.2),
}
# Paint by slot, in turn: common car colours, and what hauliers like.
CAR_PAINTS = (
    (0.62, 0.64, 0.66, 1.0),
    (0.10, 0.11, 0.13, 1.0),
    (0.88, 0.88, 0.88, 1.0),
    (0.08, 0.18, 0.42, 1.0),
    (0.55, 0.06, 0.06, 1.0),
    (0.27, 0.29, 0.32, 1.0),
    (0.05, 0.28, 0.24, 1.0),
    (0.62, 0.46, 0.14, 1.0),
)
HEAVY_PAINTS = (
    (0.06, 0.22, 0.52, 1.0),
    (0.78, 0.78, 0.78, 1.0),
    (0.10, 0.38, 0.20, 1.0),
    (0.80, 0.52, 0.06, 1.0),
    (0.35, 0.36, 0.40, 1.0),
)


def add_assets(spec: mujoco.MjSpec, kinds: list[VehicleType]) -> None:
    """Adds the materials, and each kind's meshes once for all its bodies."""
    for name, (color, specular, shininess) in MATERIALS.items():
        spec.add_material(
            name=f"{PREFIX}_{name}", rgba=list(color), specular=specular, shininess=shininess
        )
    for group, paints in (("car", CAR_PAINTS), ("heavy", HEAVY_PAINTS)):
        for number, color in enumerate(paints):
            spec.add_material(
                name=f"{PREFIX}_{group}_paint_{number}",
                rgba=list(color),
                specular=0.7,
                shininess=0.8,
            )
    for kind in kinds:
        for part, shape in LOOKS[kind.kind](kind).items():
            add_mesh(spec, f"{PREFIX}_{kind.kind}_{part}", shape)


def add_vehicle(body: Any, name: str, kind: VehicleType, slot: int) -> None:
    """Adds looks and contact box of a vehicle to a body.

    Args:
      body: the slot's `MjsBody`.
      name: of the slot; the geoms' names begin with it.
      kind: dimensions and kind, of `add_assets`.
      slot: number of the slot, chooses the paint.
    """
    body.add_geom(
        name=f"{name}_hull",
        type=mujoco.mjtGeom.mjGEOM_BOX,
        pos=[0.0, 0.0, 0.5 * kind.height + 0.1],
        size=[0.5 * kind.length, 0.5 * kind.width, 0.5 * kind.height - 0.1],
        rgba=[0.9, 0.3, 0.1, 0.3],
        contype=CONTACT_TYPE,
        conaffinity=CONTACT_AFFINITY,
        group=CONTACT_GROUP,
        margin=-DETECTION_GAP,
        gap=DETECTION_GAP,
    )
    light = kind.kind in ("car", "van")
    count = len(CAR_PAINTS if light else HEAVY_PAINTS)
    paint = f"{'car' if light else 'heavy'}_paint_{slot % count}"
    for part in LOOKS[kind.kind](kind):
        body.add_geom(
            name=f"{name}_{part}",
            type=mujoco.mjtGeom.mjGEOM_MESH,
            meshname=f"{PREFIX}_{kind.kind}_{part}",
            material=f"{PREFIX}_{paint if part == 'paint' else part}",
            contype=0,
            conaffinity=0,
            group=VISUAL_GROUP,
        )
