"""Tires, rims and axle beams; holes and bolts of the rims make rotation visible."""

from __future__ import annotations

import mujoco
import numpy as np

from iits_mj.core.errors import InputError
from iits_mj.model.visuals.shapes import Painter, Shape, add_mesh, lathe, merge, ring
from iits_mj.parameters import Axle, Tire, TruckParameters

DUAL_SPACING = 0.310  # [m], between the tires of a pair
TIRE_WIDTH = {1: 0.315, 2: 0.280}  # [m], by number of tires at the wheel end
_WIDE_TIRE = 0.385  # [m], a single tire of a towed unit
RIM_RADIUS = 0.295  # of a rim of 22.5 inches
_RADIUS_MIN = 0.445  # [m], of a tire on such a rim; a smaller wheel is a scaled one
BOLTS = 10


def draw_axles(spec: mujoco.MjSpec, parameters: TruckParameters) -> None:
    """Adds tires and rims to every wheel and a beam to every axle.

    Raises:
      InputError: a wheel's body is missing.
    """
    used = {axle.tire for axle in parameters.axles}
    narrow = {axle.tire for axle in parameters.lead.axles}
    for kind, tire in parameters.tires.items():
        if kind in used:
            width = TIRE_WIDTH[tire.count] if tire.count > 1 or kind in narrow else _WIDE_TIRE
            for part, shape in _wheel_parts(tire, width).items():
                add_mesh(spec, f"wheel_{kind}_{part}", shape)
    for axle in parameters.axles:
        for side in ("left", "right"):
            name = f"{axle.name}_{side}_wheel"
            body = spec.body(name)
            if body is None:
                raise InputError(f"the specification has no body {name!r} to decorate")
            # The meshes face left; those of the right side are turned about z.
            quat = (1, 0, 0, 0) if side == "left" else (0, 0, 0, 1)
            painter = Painter(spec, body, name)
            for part, material in _MATERIALS.items():
                painter.reuse(part, f"wheel_{axle.tire}_{part}", material, quat)
        _beam(spec, axle, driven=axle.driven)


_MATERIALS = {
    "tire": "truck_rubber",
    "rim": "truck_aluminum",
    "bolts": "truck_chrome",
    "holes": "truck_black",
}


def _wheel_parts(tire: Tire, width: float) -> dict[str, Shape]:
    centers = [0.0] if tire.count == 1 else [-0.5 * DUAL_SPACING, 0.5 * DUAL_SPACING]
    radius = max(tire.free_radius, _RADIUS_MIN)
    one = _tire(radius, width)
    tires = merge(one.moved((0.0, y, 0.0)) for y in centers)
    face = centers[-1] + 0.5 * width
    inner = centers[0] - 0.5 * width + 0.03
    if tire.count == 1:
        # Steer wheel: the disc bulges outwards.
        disc = [(0.275, face - 0.06), (0.205, face - 0.005), (0.135, face + 0.01)]
        hub = [(0.135, face + 0.01), (0.125, face + 0.055), (0.10, face + 0.07), (0.0, face + 0.07)]
    else:
        # Outer wheel of a pair: the disc is recessed and the hub protrudes.
        disc = [(0.275, face - 0.15), (0.215, face - 0.17), (0.150, face - 0.17)]
        hub = [(0.150, face - 0.17), (0.140, face - 0.03), (0.115, face - 0.01), (0.0, face - 0.01)]
    lip = [(RIM_RADIUS, face - 0.035), (RIM_RADIUS, face - 0.012), (0.285, face - 0.010)]
    # Profiles run from small radius outside inwards; `lathe` wants the order of falling y.
    rim = merge(
        [
            lathe(hub[::-1]),
            lathe(disc[::-1]),
            lathe([(0.275, disc[0][1]), (0.285, face - 0.010)][::-1]),
            lathe([lip[2], lip[1], lip[0]]),
        ]
    )
    slope = disc[1][1] - 0.5 * (disc[1][1] - disc[0][1])
    hole = lathe([(0.0, slope + 0.012), (0.028, slope + 0.010), (0.028, slope - 0.03)], 12)
    nut = lathe([(0.0, 0.035), (0.012, 0.033), (0.016, 0.0)], 6)
    drum = lathe(
        [(0.0, disc[0][1] - 0.06), (0.28, disc[0][1] - 0.06), (0.28, inner), (0.0, inner)], 24
    )
    parts = {
        "tire": tires,
        "rim": rim,
        "bolts": ring(nut.moved((0.0, disc[2][1], 0.0)), BOLTS, 0.168),
        "holes": merge([ring(hole, BOLTS, 0.242), drum]),
    }
    scale = tire.free_radius / radius
    return {
        name: Shape(part.vertices * [scale, 1.0, scale], part.faces) for name, part in parts.items()
    }


def _tire(radius: float, width: float) -> Shape:
    half = 0.5 * width
    outside = [
        (RIM_RADIUS - 0.01, half - 0.035),
        (RIM_RADIUS + 0.02, half - 0.01),
        (0.5 * (RIM_RADIUS + radius), half),
        (radius - 0.06, half - 0.008),
        (radius - 0.018, half - 0.028),
        (radius, half - 0.06),
    ]
    profile = outside + [(r, -y) for r, y in reversed(outside)]
    depth = [0, 0, 0, 0, 0.014, 0.008, 0.008, 0.014, 0, 0, 0, 0]
    return lathe(profile, 80, np.array(depth))


def _beam(spec: mujoco.MjSpec, axle: Axle, *, driven: bool) -> None:
    body = spec.body(axle.name)
    if body is None:
        return
    painter = Painter(spec, body, axle.name)
    half = 0.5 * axle.track - 0.15
    painter.cylinder("beam", (0, -half, 0), (0, half, 0), 0.075, "truck_chassis")
    if driven:
        half_case = [(0.0, 0.19), (0.13, 0.17), (0.22, 0.06)]
        case = half_case + [(r, -y) for r, y in reversed(half_case)]
        painter.mesh("differential", lathe(case, 20), "truck_chassis")
