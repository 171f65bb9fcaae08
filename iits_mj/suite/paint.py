"""What of the tasks is only seen: marks on the road, and colors that show the reward."""

from __future__ import annotations

import mujoco

from iits_mj.suite.physics import Physics

# dm_control colors the materials self, effector and target between default and highlight.
_COLORS = {
    "self": ((0.70, 0.06, 0.05, 1.0), (0.05, 0.55, 0.15, 1.0)),
    "effector": ((0.88, 0.89, 0.91, 1.0), (0.55, 0.90, 0.60, 1.0)),
    "target": ((0.95, 0.45, 0.05, 1.0), (0.10, 0.80, 0.25, 1.0)),
}
# Which of the truck's materials become those of the actor and of its working end.
_REPLACED = {"truck_paint": "self", "trailer_curtain": "effector"}


def add_reward_colors(spec: mujoco.MjSpec) -> None:
    """Gives cab, trailer and target the materials by which dm_control shows the reward."""
    for name, (default, highlight) in _COLORS.items():
        spec.add_material(name=name, rgba=default)
        spec.add_material(name=f"{name}_default", rgba=default)
        spec.add_material(name=f"{name}_highlight", rgba=highlight)
    for geom in spec.geoms:
        if geom.material in _REPLACED:
            geom.material = _REPLACED[geom.material]


def movable(spec: mujoco.MjSpec, name: str, size: tuple[float, float, float]) -> None:
    """A flat box in the target's color on a mocap body, which `move` puts on the road."""
    body = spec.worldbody.add_body(name=name, mocap=True)
    _box(body, f"{name}_box", size)


def move(physics: Physics, name: str, station: float, offset: float) -> None:
    """Puts a movable mark on the road [m]."""
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
    """A box in the target's color that stays where it is; half sizes [m]."""
    _box(spec.worldbody, name, size, position)


def cone(spec: mujoco.MjSpec, name: str, x: float, y: float) -> None:
    """A traffic cone, as a slim post."""
    spec.worldbody.add_geom(
        name=name,
        type=mujoco.mjtGeom.mjGEOM_CYLINDER,
        size=(0.12, 0.35, 0.0),
        pos=(x, y, 0.35),
        material="target",
        contype=0,
        conaffinity=0,
    )


def _box(
    body: mujoco.MjsBody,
    name: str,
    size: tuple[float, float, float],
    position: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> None:
    body.add_geom(
        name=name,
        type=mujoco.mjtGeom.mjGEOM_BOX,
        size=size,
        pos=position,
        material="target",
        contype=0,
        conaffinity=0,
    )
