"""Pictures, windows and scaled observation vectors of the environments."""

from __future__ import annotations

import math
import threading
from collections.abc import Mapping, Sequence
from typing import Any

import gymnasium
import mujoco
import numpy as np
from numpy.typing import NDArray

from iits_mj.core.checks import one_of
from iits_mj.core.context import Closing
from iits_mj.render.cameras import follow
from iits_mj.render.context import check_display
from iits_mj.render.offscreen import Offscreen
from iits_mj.suite.physics import CAMERAS, Observed

Observation = NDArray[np.float32]
Action = NDArray[np.float32]

RENDER_MODES = ["rgb_array", "human"]
RENDER_SIZE = (360, 640)
OBSERVATION_MAX = 5.0
_LEAVE_TIME = 5.0  # [s] for the viewer to end its thread


class Picture(Closing):
    """Draws the model of an environment into pictures or a window, by Gymnasium's render mode.

    Args:
      mode: "rgb_array" for pictures of shape (360, 640, 3), "human" for a window, or None.
      camera: of the pictures: "chase", "side" or "cab".
      prefix: of the truck that carries the camera, in a fleet.

    Raises:
      InputError: unknown mode or camera. RenderError: there is no display for a window.
    """

    def __init__(self, mode: str | None, camera: str, prefix: str = "") -> None:
        if mode is not None:
            one_of("render_mode", mode, RENDER_MODES)
        one_of("camera", camera, CAMERAS)
        if mode == "human":
            check_display()
        self._mode, self._camera, self._prefix = mode, prefix + camera, prefix
        self._renderer: Offscreen | None = None
        self._window: Any = None
        self._threads: set[threading.Thread] = set()
        self._model: mujoco.MjModel | None = None

    def draw(self, model: mujoco.MjModel, data: mujoco.MjData) -> NDArray[np.uint8] | None:
        """Returns a picture of the current state; None in the mode "human" and without a mode.

        Raises:
          RenderError: there is no OpenGL here.
        """
        if self._mode is None:
            return None
        self._change_to(model)
        if self._mode == "human":
            self.show(model, data)
            return None
        if self._renderer is None:
            height, width = RENDER_SIZE
            self._renderer = Offscreen(model, (width, height))
        self._renderer.update(data, level_camera(model, data, self._camera))
        return self._renderer.draw()

    def show(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        """Updates the window in the mode "human"; does nothing in other modes."""
        if self._mode != "human":
            return
        self._change_to(model)
        if self._window is None:
            import mujoco.viewer

            before = set(threading.enumerate())
            self._window = mujoco.viewer.launch_passive(model, data)
            self._threads = set(threading.enumerate()) - before
            follow(self._window, model, self._prefix)
        self._window.sync()

    def close(self) -> None:
        """Closes window and renderer; the next picture reopens them."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None
        if self._window is not None:
            self._window.close()
            self._window = None
            # The viewer draws in a thread that must end before Python does.
            for thread in self._threads:
                thread.join(_LEAVE_TIME)
        self._model = None

    def _change_to(self, model: mujoco.MjModel) -> None:
        """Closes renderer and window of another model."""
        if self._model is not model:
            self.close()
            self._model = model


def top_view(
    boxes: Sequence[tuple[float, float, float]], lanes: int, lane_width: float = 4.0
) -> NDArray[np.uint8]:
    """Returns a picture (360, 640, 3) of a straight road from above, driven to the right.

    Args:
      boxes: a vehicle's front bumper ahead of the truck's, its offset left of the rightmost lane's
        middle, and its length [m]; the truck first.
      lanes: number of lanes.
      lane_width: of each [m].
    """
    height, width = RENDER_SIZE
    along, across = 2.0, 20.0  # pixels per meter
    half = 0.5 * lane_width
    picture = np.full((height, width, 3), (96, 128, 80), np.uint8)

    def fill(left: float, right: float, ahead: tuple[float, float], color: Sequence[int]) -> None:
        """Colors a rectangle: offsets [m], and stations before the truck's front [m]."""
        rows = [round(0.5 * height - across * (y - half * (lanes - 1))) for y in (left, right)]
        columns = [min(max(round(0.25 * width + along * x), 0), width) for x in ahead]
        picture[max(rows[0], 0) : max(rows[1], 0), columns[0] : columns[1]] = color

    fill(lane_width * lanes - half, -half, (-width, width), (80, 80, 84))
    for line in range(lanes + 1):
        middle = lane_width * line - half
        fill(middle + 0.1, middle - 0.1, (-width, width), (230, 230, 230))
    for number, (front, offset, length) in enumerate(boxes):
        color = (40, 90, 180) if number else (190, 30, 30)
        fill(offset + 1.25, offset - 1.25, (front - length, front), color)
    return picture


def level_camera(model: mujoco.MjModel, data: mujoco.MjData, name: str) -> mujoco.MjvCamera:
    """Returns a free camera in the place of a model's camera, level while the truck rolls."""
    place = data.camera(name)
    forward = -place.xmat.reshape(3, 3)[:, 2]
    camera = mujoco.MjvCamera()
    mujoco.mjv_defaultFreeCamera(model, camera)
    camera.distance = 1.0
    camera.lookat[:] = place.xpos + forward
    camera.azimuth = math.degrees(math.atan2(forward[1], forward[0]))
    camera.elevation = math.degrees(math.asin(forward[2]))
    return camera


class ScaledObservations:
    """A task's observations as one vector, each divided by its scale and clipped to [-5, 5].

    Args:
      observed: the task's observations; the vector has their order.

    Attributes:
      names: of the vector's elements; space: of the vector.
    """

    def __init__(self, observed: Mapping[str, Observed]) -> None:
        self._scales = np.concatenate([np.full(e.size, e.scale) for e in observed.values()])
        self.names = tuple(
            name if entry.size == 1 else f"{name}[{i}]"
            for name, entry in observed.items()
            for i in range(entry.size)
        )
        self.space = gymnasium.spaces.Box(
            -OBSERVATION_MAX, OBSERVATION_MAX, (len(self.names),), np.float32
        )

    def __call__(self, values: Sequence[float]) -> NDArray[np.float32]:
        """Returns the vector of these numbers, see `DrivingTask.values`."""
        vector = np.array(values)
        vector /= self._scales
        np.maximum(vector, -OBSERVATION_MAX, out=vector)
        np.minimum(vector, OBSERVATION_MAX, out=vector)
        return vector.astype(np.float32)
