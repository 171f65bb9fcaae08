"""What the mirrored vehicles look like, and the box by which they are touched.

A body's frame is the bounding box's centre on the ground: x forward, y left, z up. Everything that
is seen is visual only; one box per vehicle takes part in contact detection.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco

from traffic_bridge.vehicles import VehicleType

VISUAL_GROUP = 1
CONTACT_GROUP = 3
# Contact bits: the truck's hull has type 2 and affinity 5. So vehicles meet the truck, not each
# other and not the ground.
CONTACT_TYPE = 4
CONTACT_AFFINITY = 2
# Contacts are listed when the boxes touch (margin + gap = 0), but a margin this far below any
# penetration keeps them out of the solver: detection without force.
DETECTION_GAP = 100.0

GLASS = (0.10, 0.13, 0.16, 1.0)
TIRE = (0.06, 0.06, 0.07, 1.0)
CHASSIS = (0.16, 0.16, 0.18, 1.0)
HEADLAMP = (0.95, 0.95, 0.85, 1.0)
TAIL_LAMP = (0.75, 0.05, 0.05, 1.0)
BOX_WHITE = (0.88, 0.88, 0.86, 1.0)

# Paint by slot, in turn: common car colours, and what hauliers like.
CAR_COLORS = (
    (0.75, 0.76, 0.78, 1.0),
    (0.20, 0.22, 0.25, 1.0),
    (0.90, 0.90, 0.90, 1.0),
    (0.15, 0.25, 0.50, 1.0),
    (0.60, 0.10, 0.10, 1.0),
    (0.35, 0.37, 0.40, 1.0),
    (0.10, 0.35, 0.30, 1.0),
    (0.70, 0.55, 0.20, 1.0),
)
HEAVY_COLORS = (
    (0.10, 0.30, 0.60, 1.0),
    (0.80, 0.80, 0.80, 1.0),
    (0.65, 0.15, 0.12, 1.0),
    (0.15, 0.45, 0.25, 1.0),
    (0.85, 0.60, 0.10, 1.0),
)


@dataclass(frozen=True)
class _Painter:
    """Adds visual geoms to one body."""

    body: mujoco.MjsBody
    name: str

    def box(
        self,
        part: str,
        center: Sequence[float],
        size: Sequence[float],
        color: Sequence[float],
        quat: Sequence[float] = (1.0, 0.0, 0.0, 0.0),
    ) -> None:
        """A box of full side lengths."""
        half = [0.5 * value for value in size]
        self._add(part, mujoco.mjtGeom.mjGEOM_BOX, center, half, color, quat)

    def blob(
        self, part: str, center: Sequence[float], size: Sequence[float], color: Sequence[float]
    ) -> None:
        """An ellipsoid of full axes: rounds a roof or a bonnet."""
        half = [0.5 * value for value in size]
        self._add(part, mujoco.mjtGeom.mjGEOM_ELLIPSOID, center, half, color)

    def wheels(self, part: str, x: float, track: float, radius: float, width: float) -> None:
        """A pair of wheels; `track` is between the outer faces."""
        lying = (0.70710678, 0.70710678, 0.0, 0.0)  # cylinder axis along y
        for side, sign in (("left", 1.0), ("right", -1.0)):
            center = (x, sign * 0.5 * (track - width), radius)
            self._add(
                f"{part}_{side}",
                mujoco.mjtGeom.mjGEOM_CYLINDER,
                center,
                (radius, 0.5 * width, 0.0),
                TIRE,
                lying,
            )
            rim = (x, sign * (0.5 * track - 0.01), radius)
            self._add(
                f"{part}_{side}_rim",
                mujoco.mjtGeom.mjGEOM_CYLINDER,
                rim,
                (0.58 * radius, 0.02, 0.0),
                (0.55, 0.56, 0.58, 1.0),
                lying,
            )

    def lamps(self, length: float, width: float, front: float, rear: float) -> None:
        """Head and tail lamps at heights `front` and `rear`."""
        for side, sign in (("left", 1.0), ("right", -1.0)):
            y = sign * (0.5 * width - 0.22)
            size = (0.06, 0.30, 0.13)
            self.box(f"headlamp_{side}", (0.5 * length - 0.04, y, front), size, HEADLAMP)
            self.box(f"tail_lamp_{side}", (-0.5 * length + 0.04, y, rear), size, TAIL_LAMP)

    def _add(
        self,
        part: str,
        kind: mujoco.mjtGeom,
        center: Sequence[float],
        size: Sequence[float],
        color: Sequence[float],
        quat: Sequence[float] = (1.0, 0.0, 0.0, 0.0),
    ) -> None:
        self.body.add_geom(
            name=f"{self.name}_{part}",
            type=kind,
            pos=list(center),
            size=list(size),
            quat=list(quat),
            rgba=list(color),
            contype=0,
            conaffinity=0,
            group=VISUAL_GROUP,
        )


def add_vehicle(body: mujoco.MjsBody, name: str, kind: VehicleType, slot: int) -> None:
    """Adds looks and contact box of a vehicle to a body.

    Args:
      body: of the slot.
      name: of the slot; the geoms' names begin with it.
      kind: dimensions and kind.
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
    painter = _Painter(body, name)
    looks = {"car": _car, "van": _van, "truck": _truck, "articulated": _articulated}
    colors = CAR_COLORS if kind.kind in ("car", "van") else HEAVY_COLORS
    looks[kind.kind](painter, kind, colors[slot % len(colors)])


def _car(p: _Painter, kind: VehicleType, paint: Sequence[float]) -> None:
    length, width, height = kind.length, kind.width, kind.height
    p.box("body", (0.0, 0.0, 0.54), (length - 0.30, width, 0.46), paint)
    p.blob("nose", (0.5 * length - 0.62, 0.0, 0.56), (1.24, width, 0.52), paint)
    p.blob("tail", (-0.5 * length + 0.55, 0.0, 0.60), (1.10, width, 0.58), paint)
    p.box("sill", (0.0, 0.0, 0.28), (length - 1.0, width - 0.08, 0.14), CHASSIS)
    # Greenhouse: a glass band with sloped screens under a painted roof.
    glass = height - 0.80
    p.box("cabin", (-0.30, 0.0, 0.76 + 0.5 * glass), (1.75, width - 0.24, glass), GLASS)
    lean = 0.5 * glass
    for part, x, tilt in (("windscreen", 0.62, 0.30), ("rear_window", -1.22, -0.26)):
        quat = (0.9553 if tilt > 0 else 0.9664, 0.0, tilt, 0.0)
        p.box(part, (x, 0.0, 0.70 + lean), (0.12, width - 0.26, 1.25 * glass), GLASS, quat)
    p.box("roof", (-0.30, 0.0, height - 0.04), (1.70, width - 0.26, 0.08), paint)
    p.lamps(length, width, 0.62, 0.72)
    p.wheels("front", 0.29 * length, width - 0.02, 0.32, 0.22)
    p.wheels("rear", -0.29 * length, width - 0.02, 0.32, 0.22)


def _van(p: _Painter, kind: VehicleType, paint: Sequence[float]) -> None:
    length, width, height = kind.length, kind.width, kind.height
    cargo = length - 1.55
    p.box(
        "cargo",
        (-0.5 * (length - cargo), 0.0, 0.5 * (height + 0.35)),
        (cargo, width, height - 0.35),
        paint,
    )
    p.box("bonnet", (0.5 * length - 0.60, 0.0, 0.78), (1.20, width - 0.06, 0.80), paint)
    # The windscreen leans from the bonnet to the roof.
    p.box(
        "windscreen",
        (0.5 * length - 1.28, 0.0, 1.62),
        (0.10, width - 0.16, 1.30),
        GLASS,
        (0.9320, 0.0, -0.3624, 0.0),
    )
    p.box("cab", (0.5 * length - 1.62, 0.0, 1.50), (0.55, width - 0.08, 1.50), GLASS)
    p.box("bumper", (0.0, 0.0, 0.42), (length, width - 0.10, 0.22), CHASSIS)
    p.lamps(length, width, 0.90, 1.05)
    p.wheels("front", 0.31 * length, width - 0.02, 0.35, 0.24)
    p.wheels("rear", -0.29 * length, width - 0.02, 0.35, 0.24)


def _cab(p: _Painter, front: float, width: float, height: float, paint: Sequence[float]) -> None:
    """A cab over the engine whose bumper is at x = front."""
    p.box(
        "cab",
        (front - 1.05, 0.0, 0.5 * (height + 0.55)),
        (2.10, width - 0.06, height - 0.55),
        paint,
    )
    p.box(
        "windscreen", (front - 0.02, 0.0, 0.68 * height), (0.08, width - 0.28, 0.27 * height), GLASS
    )
    p.box(
        "side_windows",
        (front - 0.62, 0.0, 0.68 * height),
        (0.90, width - 0.04, 0.22 * height),
        GLASS,
    )
    p.box(
        "grille", (front - 0.02, 0.0, 0.36 * height), (0.08, width - 0.90, 0.20 * height), CHASSIS
    )
    p.box("bumper", (front - 0.25, 0.0, 0.48), (0.50, width, 0.36), CHASSIS)


def _truck(p: _Painter, kind: VehicleType, paint: Sequence[float]) -> None:
    length, width, height = kind.length, kind.width, kind.height
    front, box = 0.5 * length, length - 2.35
    _cab(p, front, width, min(3.0, height), paint)
    p.box(
        "cargo",
        (-0.5 * (length - box), 0.0, 0.5 * (height + 1.05)),
        (box, width, height - 1.05),
        BOX_WHITE,
    )
    p.box("stripe", (-0.5 * (length - box), 0.0, 1.35), (box - 0.2, width + 0.02, 0.22), paint)
    p.box("frame", (0.0, 0.0, 0.85), (length - 0.6, 0.90, 0.30), CHASSIS)
    p.lamps(length, width, 0.75, 0.95)
    p.wheels("front", front - 1.40, width - 0.06, 0.50, 0.30)
    p.wheels("rear", front - 1.40 - 0.56 * length, width - 0.06, 0.50, 0.55)


def _articulated(p: _Painter, kind: VehicleType, paint: Sequence[float]) -> None:
    length, width, height = kind.length, kind.width, kind.height
    front = 0.5 * length
    trailer = length - 3.05
    middle = -front + 0.5 * trailer
    _cab(p, front, width, height - 0.25, paint)
    p.box(
        "trailer", (middle, 0.0, 0.5 * (height + 1.10)), (trailer, width, height - 1.10), BOX_WHITE
    )
    p.box("stripe", (middle, 0.0, 1.45), (trailer - 0.3, width + 0.02, 0.30), paint)
    p.box("frame", (-0.3, 0.0, 0.90), (length - 1.2, 0.90, 0.30), CHASSIS)
    p.lamps(length, width, 0.75, 0.95)
    p.wheels("steer", front - 1.40, width - 0.04, 0.50, 0.32)
    p.wheels("drive", front - 5.10, width - 0.04, 0.50, 0.58)
    for axle, x in enumerate((-front + 5.1, -front + 3.8, -front + 2.5), start=1):
        p.wheels(f"trailer{axle}", x, width - 0.04, 0.50, 0.38)
