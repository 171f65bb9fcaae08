"""Windows on a screen, where there is one."""

from __future__ import annotations

import os
import platform
from typing import Any

import mujoco

from iits_mj.errors import RenderError


def check_display() -> None:
    """Refuses to open a window where none can be shown.

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
    """Lets a viewer's camera follow the semitrailer of that prefix from behind."""
    window.cam.type = mujoco.mjtCamera.mjCAMERA_TRACKING
    window.cam.trackbodyid = model.body(f"{prefix}trailer").id
    window.cam.distance, window.cam.elevation = 28.0, -18.0
    window.cam.azimuth = 180.0
