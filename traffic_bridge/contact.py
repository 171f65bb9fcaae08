"""Contact between the truck and mirrored vehicles: which pairs touch, and whether any soon may."""

from __future__ import annotations

from collections.abc import Mapping

import mujoco
import numpy as np
from numpy.typing import NDArray

from traffic_bridge.bodies import CONTACT_AFFINITY, CONTACT_TYPE

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.intp]

# Greatest relative acceleration of two vehicles, both braking or steering as hard as tires allow.
ACCELERATION = 20.0  # [m/s2]
SLACK = 0.1  # [m]: what heights, tilt and the newest frame's correction may make


class ContactFinder:
    """Reads contacts between the truck's and the vehicles' hulls out of MuJoCo's list.

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
        self.hull = np.flatnonzero(self._truck)

    def pairs(self, data: mujoco.MjData) -> list[tuple[int, str]]:
        """(number of the vehicle's body, name of the truck's body) of every pair in contact."""
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

    def truck_boxes(self, data: mujoco.MjData) -> tuple[FloatArray, FloatArray]:
        """The truck's hull from above, and its motion, at the state last computed.

        Returns:
          Boxes as of `separation`, shape (m, 3, 2) [m]; velocities of their bodies in the plane and
          greatest speed by rotation, shape (m, 3) [m/s].
        """
        model, hull = self._model, self.hull
        axes = data.geom_xmat[hull].reshape(-1, 3, 3)[:, :2, :2].transpose(0, 2, 1)
        half = axes * model.geom_size[hull, :2, None]
        boxes = np.concatenate((data.geom_xpos[hull, None, :2], half), axis=1)
        motion = np.empty((hull.size, 3))
        velocity = np.empty(6)
        for row, geom in enumerate(hull):
            mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_GEOM, int(geom), velocity, 0)
            spin = abs(float(velocity[2])) * float(model.geom_rbound[geom])
            motion[row] = velocity[3], velocity[4], spin
        return boxes, motion


def separation(a: FloatArray, b: FloatArray) -> FloatArray:
    """Least distances of rectangles, by separating axes; at most the true ones, <= 0 on overlap.

    Args:
      a: center and the two half-extent vectors (forward, left), shape (m, 3, 2) [m].
      b: as a, shape (n, 3, 2) [m].

    Returns:
      Shape (m, n) [m].
    """
    apart = b[None, :, 0] - a[:, None, 0]
    gaps = []
    for box, other in ((a[:, None], b[None, :]), (b[None, :], a[:, None])):
        half = box[..., 1:, :]
        size = np.linalg.norm(half, axis=-1)
        axis = half / size[..., None]
        distance = np.abs((axis * apart[..., None, :]).sum(-1))
        reach = np.abs((axis[..., None, :] * other[..., None, 1:, :]).sum(-1)).sum(-1)
        gaps.append((distance - size - reach).max(-1))
    return np.maximum(gaps[0], gaps[1])


def may_touch(
    a: FloatArray, motion_a: FloatArray, b: FloatArray, motion_b: FloatArray, within: float
) -> bool:
    """Whether two rectangles may meet within a time, whichever way they turn meanwhile.

    Args:
      a: see `separation`.
      motion_a: velocity and greatest speed by rotation, shape (m, 3) [m/s].
      b: as a.
      motion_b: as motion_a, shape (n, 3) [m/s].
      within: [s].
    """
    closing = np.linalg.norm(motion_a[:, None, :2] - motion_b[None, :, :2], axis=-1)
    closing += motion_a[:, None, 2] + motion_b[None, :, 2]
    reach = closing * within + 0.5 * ACCELERATION * within**2 + SLACK
    return bool((separation(a, b) <= reach).any())
