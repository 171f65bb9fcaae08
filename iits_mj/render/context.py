"""OpenGL contexts without a window (EGL), and the check for the viewer's window."""

from __future__ import annotations

import os
import platform
import sys
from typing import Any

from iits_mj.core.errors import RenderError

VERSION = (4, 3)  # of OpenGL
PACKAGES = "libegl1 libgl1-mesa-dri libopengl0"


def check_display() -> None:
    """Checks that a window can be shown.

    Raises:
      RenderError: there is no display.
    """
    shown = os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    if platform.system() == "Linux" and not shown:
        raise RenderError(
            "there is no display for the viewer (DISPLAY and WAYLAND_DISPLAY are not set); "
            "watch in a browser with 'iits-mj view --web', or make a video with 'iits-mj drive'"
        )


def make_context(width: int, height: int) -> Any:
    """Returns a new OpenGL context, by EGL unless the variable MUJOCO_GL names another backend.

    Raises:
      RenderError: OpenGL is too old, or missing; the message has the Debian packages with it.
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
        # PyOpenGL must not be loaded before the context has chosen its platform.
        from OpenGL import GL

        version = tuple(
            int(GL.glGetIntegerv(n)) for n in (GL.GL_MAJOR_VERSION, GL.GL_MINOR_VERSION)
        )
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
    if version < VERSION:
        context.free()
        raise RenderError(f"OpenGL {version[0]}.{version[1]} is too old: 4.3 is needed")
    return context


def _for_a_display() -> bool:
    """Returns whether PyOpenGL was loaded for another platform than EGL."""
    platform = sys.modules.get("OpenGL.platform")
    chosen = getattr(platform, "PLATFORM", None)
    return chosen is not None and "egl" not in type(chosen).__name__.lower()
