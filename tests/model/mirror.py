"""Reflection of the truck's coordinates in its middle plane: left becomes right."""

from __future__ import annotations

import mujoco
import numpy as np

_OTHER = {"left": "right", "right": "left"}
# About x or z (and along y) a reflection in the plane y = 0 changes the sign.
_TURNED = ("roll", "yaw", "knuckle")


def twin(name: str) -> str:
    """The name of the element on the other side; the same for one in the middle."""
    return "_".join(_OTHER.get(part, part) for part in name.split("_"))


class Mirror:
    """Maps `qpos`, `qvel` and `ctrl` of the truck to those of its mirror image."""

    def __init__(self, model: mujoco.MjModel) -> None:
        self._q_from, self._q_sign = np.arange(model.nq), np.ones(model.nq)
        self._v_from, self._v_sign = np.arange(model.nv), np.ones(model.nv)
        for i in range(model.njnt):
            joint = model.joint(i)
            q, v = joint.qposadr[0], joint.dofadr[0]
            if model.jnt_type[i] == mujoco.mjtJoint.mjJNT_FREE:
                self._q_sign[q : q + 7] = 1, -1, 1, 1, -1, 1, -1
                self._v_sign[v : v + 6] = 1, -1, 1, -1, 1, -1
                continue
            other = model.joint(twin(joint.name))
            self._q_from[q], self._v_from[v] = other.qposadr[0], other.dofadr[0]
            if joint.name.split("_")[-1] in _TURNED:
                self._q_sign[q] = self._v_sign[v] = -1
        self._steering = model.actuator("steering_wheel_angle").id

    def position(self, qpos: np.ndarray) -> np.ndarray:
        return self._q_sign * qpos[self._q_from]

    def velocity(self, qvel: np.ndarray) -> np.ndarray:
        return self._v_sign * qvel[self._v_from]

    def control(self, ctrl: np.ndarray) -> np.ndarray:
        mirrored = ctrl.copy()
        mirrored[self._steering] *= -1
        return mirrored
