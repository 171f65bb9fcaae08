"""Pictures of a model without a window (EGL), and checks for the viewer's window."""

from __future__ import annotations

import copy
import math
import os
import platform
import sys
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from iits_mj.core.context import Closing
from iits_mj.core.errors import InputError, RenderError


def check_display() -> None:
    """Checks that a window can be shown.

    Raises:
      RenderError: there is no display.
    """
    shown = os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    if platform.system() == "Linux" and not shown:
        raise RenderError(
            "there is no display for the viewer (DISPLAY and WAYLAND_DISPLAY are not set); run it "
            "from a desktop session, or make a video with 'iits-mj drive'"
        )


def follow(window: Any, model: mujoco.MjModel, prefix: str = "") -> None:
    """Makes a viewer's camera follow the semitrailer with this prefix."""
    window.cam.type = mujoco.mjtCamera.mjCAMERA_TRACKING
    window.cam.trackbodyid = model.body(f"{prefix}trailer").id
    window.cam.distance, window.cam.elevation = 28.0, -18.0
    window.cam.azimuth = 180.0


PACKAGES = "libegl1 libgl1-mesa-dri libopengl0"
SIZE_MIN, SIZE_MAX = 64, 4096
MAX_GEOMS = 6000
# Static geoms beyond these distances [m] or behind the camera are not drawn.
DRAW_DISTANCE = {"fine": 900.0, "coarse": 4000.0}
_FINE = ("steel", "post", "reflector", "trunk", "conifer", "leaves", "gravel", "marking")
_HIDDEN_GROUP = 5


def check_size(size: tuple[int, int]) -> tuple[int, int]:
    """Returns width and height rounded down to even numbers, as the video format requires.

    Raises:
      InputError: not two whole numbers between 64 and 4096.
    """
    try:
        width, height = (int(value) for value in size)
    except (TypeError, ValueError):
        raise InputError(f"size {size!r} is not allowed: use two numbers, as (960, 540)") from None
    for value in (width, height):
        if not SIZE_MIN <= value <= SIZE_MAX:
            raise InputError(
                f"size {width}x{height} is not allowed: use {SIZE_MIN} to {SIZE_MAX} for each side"
            )
    return width - width % 2, height - height % 2


def make_context(width: int, height: int) -> Any:
    """Returns a new OpenGL context, by EGL unless the variable MUJOCO_GL names another backend.

    Raises:
      RenderError: OpenGL is missing; the message has the Debian packages that contain it.
    """
    wanted = os.environ.get("MUJOCO_GL", "").lower().strip()
    if wanted in ("disable", "disabled", "off", "false", "0"):
        raise RenderError(f"MUJOCO_GL={wanted} switches pictures off; set MUJOCO_GL=egl")
    try:
        if wanted == "osmesa":
            from mujoco.osmesa import GLContext
        else:
            from mujoco.egl import GLContext
        context = GLContext(width, height)
        context.make_current()
    # PyOpenGL raises errors of many types: AttributeError on None, ImportError, GLError.
    except Exception as error:
        remedy = f"on Debian or Ubuntu: apt-get install {PACKAGES}"
        if wanted != "osmesa" and _for_a_display():
            remedy = (
                "another module has loaded OpenGL for a display in this process; set "
                "MUJOCO_GL=egl before Python starts"
            )
        raise RenderError(
            f"no offscreen OpenGL ({type(error).__name__}: {error}); {remedy}"
        ) from error
    return context


def _for_a_display() -> bool:
    """Returns whether PyOpenGL was loaded for another platform than EGL."""
    platform = sys.modules.get("OpenGL.platform")
    chosen = getattr(platform, "PLATFORM", None)
    return chosen is not None and "egl" not in type(chosen).__name__.lower()


class Offscreen(Closing):
    """Draws a model's data into arrays of pixels.

    It hides distant geoms in a copy of the model; the model itself does not change.

    Args:
      model: to draw.
      size: width and height in pixels, rounded down to even numbers.

    Attributes:
      scene: MuJoCo's scene; `update` fills it, then the caller may add geoms.

    Raises:
      InputError: the size is out of range. RenderError: OpenGL is missing.
    """

    def __init__(self, model: mujoco.MjModel, size: tuple[int, int]) -> None:
        self.width, self.height = check_size(size)
        self._gl: Any = None
        self._mjr: Any = None
        self._gl = make_context(self.width, self.height)
        self._model = copy.copy(model)
        visual = self._model.vis.global_
        visual.offwidth, visual.offheight = self.width, self.height
        # Antialiasing takes twice as long without a GPU.
        self._model.vis.quality.offsamples = 0
        try:
            self._mjr = mujoco.MjrContext(self._model, mujoco.mjtFontScale.mjFONTSCALE_100.value)
        except mujoco.FatalError as error:
            self.close()
            raise RenderError(
                f"OpenGL refuses a {self.width}x{self.height} picture: {error}"
            ) from error
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN.value, self._mjr)
        self.scene = mujoco.MjvScene(self._model, maxgeom=MAX_GEOMS)
        flags = self.scene.flags
        flags[mujoco.mjtRndFlag.mjRND_REFLECTION] = 0
        flags[mujoco.mjtRndFlag.mjRND_FOG] = 1
        flags[mujoco.mjtRndFlag.mjRND_HAZE] = 0
        self._option = mujoco.MjvOption()
        self._option.geomgroup[:] = [1, 1, 1, 0, 0, 0]
        self._perturb = mujoco.MjvPerturb()
        self._rect = mujoco.MjrRect(0, 0, self.width, self.height)
        self._pixels = np.empty((self.height, self.width, 3), dtype=np.uint8)
        self._prepare_culling()

    def _prepare_culling(self) -> None:
        model = self._model
        planes = model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE
        self._static = np.flatnonzero((model.geom_bodyid == 0) & ~planes)
        names = [model.geom(int(i)).name for i in self._static]
        fine = [any(word in name for word in _FINE) for name in names]
        reach = np.where(fine, DRAW_DISTANCE["fine"], DRAW_DISTANCE["coarse"])
        self._radius = model.geom_rbound[self._static]
        self._reach = reach + self._radius
        self._group = model.geom_group[self._static].copy()

    def update(self, data: mujoco.MjData, camera: mujoco.MjvCamera) -> None:
        """Fills the scene with the state of `data`, seen by `camera`."""
        self._cull(data, camera)
        mujoco.mjv_updateScene(
            self._model,
            data,
            self._option,
            self._perturb,
            camera,
            mujoco.mjtCatBit.mjCAT_ALL.value,
            self.scene,
        )

    def draw(self) -> NDArray[np.uint8]:
        """Returns the scene as a new array of pixels (height, width, 3), top row first."""
        self._gl.make_current()
        mujoco.mjr_render(self._rect, self.scene, self._mjr)
        mujoco.mjr_readPixels(self._pixels, None, self._rect, self._mjr)
        return np.ascontiguousarray(self._pixels[::-1])

    def close(self) -> None:
        """Frees the context; may be called again."""
        if self._mjr is not None:
            self._gl.make_current()
            self._mjr.free()
            self._mjr = None
        if self._gl is not None:
            self._gl.free()
            self._gl = None

    def _cull(self, data: mujoco.MjData, camera: mujoco.MjvCamera) -> None:
        """Hides static geoms that are far away or outside the view cone."""
        eye, forward = camera_pose(camera)
        relative = data.geom_xpos[self._static] - eye
        along = relative @ forward
        distance = np.sqrt(np.einsum("ij,ij->i", relative, relative))
        beside = np.sqrt(np.maximum(distance**2 - along**2, 0.0))
        half = math.radians(0.5 * self._model.vis.global_.fovy)
        aspect = self.width / self.height
        cone = math.atan(math.tan(half) * math.hypot(1.0, aspect)) + 0.05
        # Hidden if the bounding sphere is outside the cone, with a margin of 40 m for shadows.
        gap = beside * math.cos(cone) - along * math.sin(cone)
        hidden = (distance > self._reach) | (gap > self._radius + 40.0)
        self._model.geom_group[self._static] = np.where(hidden, _HIDDEN_GROUP, self._group)


def camera_pose(camera: mujoco.MjvCamera) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Returns position and viewing direction of a free camera."""
    azimuth, elevation = math.radians(camera.azimuth), math.radians(camera.elevation)
    forward = np.array(
        [
            math.cos(elevation) * math.cos(azimuth),
            math.cos(elevation) * math.sin(azimuth),
            math.sin(elevation),
        ]
    )
    return np.asarray(camera.lookat) - camera.distance * forward, forward
