"""Roads of the tasks, their markers, and the colors that show the reward."""

from __future__ import annotations

import math
from typing import Any

import mujoco

from iits_mj.road import Route
from iits_mj.road.design import Design
from iits_mj.suite.physics import Physics

LANE_WIDTH = 4.0
# The outer tire's arc of 12.5 m (PBS) minus half the steer axle's width over the tires.
TURN_RADIUS = 12.5 - 1.25
TURN_ENTRY = 60.0
_SPEED_LIMIT = 22.22
# dm_control colors the materials self, effector and target between default and highlight.
_COLORS = {
    "self": ((0.70, 0.06, 0.05, 1.0), (0.05, 0.55, 0.15, 1.0)),
    "effector": ((0.88, 0.89, 0.91, 1.0), (0.55, 0.90, 0.60, 1.0)),
    "target": ((0.95, 0.45, 0.05, 1.0), (0.10, 0.80, 0.25, 1.0)),
}
# Materials of the truck that take the colors of cab and trailer.
_REPLACED = {"truck_paint": "self", "trailer_curtain": "effector"}


def flat() -> Route:
    """Returns a straight, level road of 5 km."""
    return Route.straight(length=5_000.0, lanes=2)


def uphill() -> Route:
    """Returns a straight uphill road of 2 km with grades of 4 to 9 % in steps of 300 m."""
    grades = [(300.0 * (k + 1), 0.01 * (5 + k), 60.0) for k in range(5)]
    return _route(
        "suite_uphill", ((2_000.0, 0.0, 0.0, 0.0, 0.0),), tuple(grades), initial_grade=0.04
    )


def turn() -> Route:
    """Returns a 90 degree turn to the left between straights, the steer axle's path."""
    bend = 1.0 / TURN_RADIUS
    alignment = (
        (TURN_ENTRY, 0.0, 0.0, 0.0, 0.0),
        (0.5 * math.pi * TURN_RADIUS, bend, bend, 0.0, 0.0),
        (300.0, 0.0, 0.0, 0.0, 0.0),
    )
    return _route("suite_turn", alignment, lanes=1, left_shoulder=3.45, right_shoulder=0.3)


def yard() -> Route:
    """Returns 200 m of level ground along x, wide enough for a turn."""
    return Route.straight(length=200.0, lanes=3)


def hills() -> Route:
    """Returns a straight road of 8 km over hills of 400 m, with grades within +/-4 %."""
    size = (0.02, -0.03, 0.04, -0.02, 0.03, -0.04, 0.01, -0.01)
    grades = [(400.0 * (k + 1), size[k % len(size)], 250.0) for k in range(19)]
    return _route("suite_hills", ((8_000.0, 0.0, 0.0, 0.0, 0.0),), tuple(grades))


def winding() -> Route:
    """Returns 5 km of alternating left and right bends with clothoids, radii 500 to 900 m."""
    alignment = [(200.0, 0.0, 0.0, 0.0, 0.0)]
    radii = (900.0, -700.0, 600.0, -500.0, 800.0, -600.0, 500.0, -900.0)
    for radius in radii:
        curvature = 1.0 / radius
        alignment += [
            (120.0, 0.0, curvature, 0.0, 0.0),
            (300.0, curvature, curvature, 0.0, 0.0),
            (120.0, curvature, 0.0, 0.0, 0.0),
        ]
    alignment.append((480.0, 0.0, 0.0, 0.0, 0.0))
    return _route("suite_winding", tuple(alignment))


def _route(
    name: str,
    alignment: tuple[tuple[float, float, float, float, float], ...],
    grades: tuple[tuple[float, float, float], ...] = (),
    lanes: int = 2,
    **settings: Any,
) -> Route:
    """Returns a route with shoulders; `settings` are other fields of `Design`."""
    length = sum(element[0] for element in alignment)
    return Design(
        name=name,
        lane_width=LANE_WIDTH,
        speed_limit=_SPEED_LIMIT,
        alignment=alignment,
        grades=grades,
        limits=((0.0, length, _SPEED_LIMIT),),
        lanes=lanes,
        **settings,
    ).route()


def add_reward_colors(spec: mujoco.MjSpec) -> None:
    """Gives cab, trailer and target the materials that dm_control colors by the reward."""
    for name, (default, highlight) in _COLORS.items():
        spec.add_material(name=name, rgba=default)
        spec.add_material(name=f"{name}_default", rgba=default)
        spec.add_material(name=f"{name}_highlight", rgba=highlight)
    for geom in spec.geoms:
        if geom.material in _REPLACED:
            geom.material = _REPLACED[geom.material]


def movable(spec: mujoco.MjSpec, name: str, size: tuple[float, float, float]) -> None:
    """Adds a flat box in the target's color on a mocap body that `move` places."""
    body = spec.worldbody.add_body(name=name, mocap=True)
    _add(body, f"{name}_box", size)


def move(physics: Physics, name: str, station: float, offset: float) -> None:
    """Places a movable box on the road [m]."""
    point = physics.route.evaluate(station, offset)
    model = physics.model.ptr
    physics.data.mocap_pos[model.body(name).mocapid[0]] = (
        float(point.x),
        float(point.y),
        float(point.z) + 0.01,
    )


def mark(
    spec: mujoco.MjSpec,
    name: str,
    position: tuple[float, float, float],
    size: tuple[float, float, float],
) -> None:
    """Adds a fixed box in the target's color; half sizes [m]."""
    _add(spec.worldbody, name, size, position)


def cone(spec: mujoco.MjSpec, name: str, x: float, y: float) -> None:
    """Adds a traffic cone as a slim post."""
    _add(spec.worldbody, name, (0.12, 0.35, 0.0), (x, y, 0.35), mujoco.mjtGeom.mjGEOM_CYLINDER)


def _add(
    body: mujoco.MjsBody,
    name: str,
    size: tuple[float, float, float],
    position: tuple[float, float, float] = (0.0, 0.0, 0.0),
    kind: mujoco.mjtGeom = mujoco.mjtGeom.mjGEOM_BOX,
) -> None:
    body.add_geom(
        name=name,
        type=kind,
        size=size,
        pos=position,
        material="target",
        contype=0,
        conaffinity=0,
    )
