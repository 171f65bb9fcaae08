"""Videos of a drive: truck, traffic and plan from a following camera, with instruments.

with VideoObserver("drive.mp4", truck, size=(960, 540), camera="chase", fps=20) as video:
    simulation.run([video])
"""

from __future__ import annotations

import os
from collections.abc import Generator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from iits_mj.core.context import Closing, Finishing
from iits_mj.core.errors import InputError, RenderError
from iits_mj.core.output_files import OutputFile
from iits_mj.core.timing import TIMESTEP
from iits_mj.render.cameras import FollowCamera, cameras_of, tiles
from iits_mj.render.lane_sketch import trajectory_boxes
from iits_mj.render.offscreen import Offscreen, check_size
from iits_mj.render.overlay import Overlay
from iits_mj.simulation.lock_step import LockStep, Observer

if TYPE_CHECKING:
    from iits_mj.simulation import DriveFrame
    from iits_mj.truck import Truck


# Constant rate factor of x264: a smaller value gives better and larger videos.
_RATE_FACTOR = "26"


class Mp4Encoder(Finishing):
    """Encodes pictures as H.264 in an MP4 file, with the ffmpeg of the imageio-ffmpeg wheel.

    The file appears when the encoder is closed without an error.

    Args:
      path: of the file, ending in .mp4, in an existing folder.
      size: width and height, both even; fps: pictures per second.

    Raises:
      InputError: path or fps is not usable. RenderError: ffmpeg does not start.
    """

    def __init__(self, path: str | Path, size: tuple[int, int], fps: float) -> None:
        self.path = Path(path)
        if self.path.suffix.lower() != ".mp4":
            raise InputError(f"video {str(path)!r} is not allowed: its name must end in .mp4")
        folder = self.path.parent
        if not folder.is_dir() or not os.access(folder, os.W_OK):
            raise InputError(
                f"video {str(path)!r} cannot be written: no writable folder {str(folder)!r}"
            )
        if not 1.0 <= fps <= 120.0:
            raise InputError(f"fps {fps!r} is not allowed: use 1 to 120")
        self.size = size
        self.frames = 0
        self._output = OutputFile(self.path, "video")
        partial = self._output.partial
        self._pipe: Generator[None, Any, None] | None = None
        try:
            self._pipe = _pipe(partial, size, fps)
        except BaseException:
            self._output.abandon()
            raise

    def add(self, picture: NDArray[np.uint8]) -> None:
        """Appends a picture (height, width, 3).

        Raises:
          InputError: the picture has another shape. RenderError: ffmpeg failed.
        """
        if self._pipe is None:
            raise RenderError(f"video {str(self.path)!r} is already closed")
        width, height = self.size
        if picture.shape != (height, width, 3) or picture.dtype != np.uint8:
            raise InputError(
                f"picture of shape {picture.shape}, {picture.dtype}, is not allowed: "
                f"use ({height}, {width}, 3), uint8"
            )
        try:
            self._pipe.send(np.ascontiguousarray(picture))
        except (OSError, StopIteration) as error:
            self.abandon()
            raise RenderError(f"ffmpeg failed on {str(self.path)!r}: {error}") from error
        self.frames += 1

    def close(self) -> None:
        """Completes the file; without pictures there is no file."""
        if self._pipe is None:
            return
        self._pipe.close()
        self._pipe = None
        partial = self._output.partial
        if self.frames and partial.is_file() and partial.stat().st_size:
            self._output.finish()
            return
        self._output.abandon()
        if self.frames:
            raise RenderError(f"ffmpeg wrote nothing to {str(self.path)!r}")

    def abandon(self) -> None:
        """Removes the unfinished file; an older file stays unchanged."""
        if self._pipe is not None:
            self._pipe.close()
            self._pipe = None
        self._output.abandon()


def _pipe(path: Path, size: tuple[int, int], fps: float) -> Generator[None, Any, None]:
    try:
        import imageio_ffmpeg

        pipe: Generator[None, Any, None] = imageio_ffmpeg.write_frames(
            str(path),
            size,
            fps=fps,
            codec="libx264",
            pix_fmt_in="rgb24",
            pix_fmt_out="yuv420p",
            quality=None,
            macro_block_size=2,
            ffmpeg_log_level="error",
            output_params=["-crf", _RATE_FACTOR, "-preset", "superfast", "-movflags", "+faststart"],
        )
        pipe.send(None)
    except (ImportError, OSError, RuntimeError) as error:
        raise RenderError(f"ffmpeg does not start: {error}; reinstall imageio-ffmpeg") from error
    return pipe


def frame_period(fps: float) -> float:
    """Returns the time between pictures [s], rounded to 2 ms.

    Raises:
      InputError: `fps` is not 1 to 50.
    """
    if not 1.0 <= fps <= 50.0:
        raise InputError(f"fps {fps!r} is not allowed: use 1 to 50")
    return round(1.0 / fps / TIMESTEP) * TIMESTEP


class Pictures(Closing):
    """Draws the pictures of a drive.

    Args:
      truck: to follow on its route; its model has the scene.
      size: of the pictures; camera: of `iits_mj.render.cameras.CAMERAS`, several with commas
        between their names share the picture.
      weather: one of `iits_mj.render.weather.WEATHERS`; None: MuJoCo's look.
      overlay: whether to draw the instruments; plan: whether to draw the planned path.

    Raises:
      InputError: camera, size or weather is not allowed. RenderError: OpenGL is missing.
    """

    def __init__(
        self,
        truck: Truck,
        size: tuple[int, int],
        camera: str = "chase",
        weather: str | None = "day",
        *,
        overlay: bool = True,
        plan: bool = True,
    ) -> None:
        names, self.size = cameras_of(camera), check_size(size)
        self._plan = plan
        self._tiles = tiles(self.size, len(names))
        self._cameras = [
            FollowCamera(name, truck.route.tunnels, truck.parameters) for name in names
        ]
        self._overlay = Overlay(self.size, truck.route, len(names)) if overlay else None
        self.offscreen = Offscreen(truck.model, self._tiles[0][2:], weather)

    def draw(self, data: mujoco.MjData, frame: DriveFrame) -> NDArray[np.uint8]:
        """Returns a picture (height, width, 3) of the state of `data`."""
        lamps = self.offscreen.lamps
        if lamps is not None:
            self.offscreen.signal(lamps.signals(data, frame))
        shown = []
        for camera in self._cameras:
            self.offscreen.update(data, camera.follow(data, frame.ego.station))
            if self._plan:
                self.offscreen.add_boxes(trajectory_boxes(frame.trajectory, float(data.time)))
            shown.append(self.offscreen.draw())
        picture = shown[0]
        if len(shown) > 1:
            picture = np.zeros((self.size[1], self.size[0], 3), np.uint8)
            for part, (left, top, width, height) in zip(shown, self._tiles, strict=True):
                # A dark line between the parts.
                inner = part[: height - 1, : width - 1]
                picture[top : top + height - 1, left : left + width - 1] = inner
        return picture if self._overlay is None else self._overlay.draw(picture, frame)

    def close(self) -> None:
        """Frees OpenGL."""
        self.offscreen.close()


class Film(Finishing):
    """Draws a drive's pictures and encodes them.

    Args:
      pictures, encoder: for pictures of the same size; closed with the film.
    """

    def __init__(self, pictures: Pictures, encoder: Mp4Encoder) -> None:
        self.pictures, self.encoder = pictures, encoder

    def add(self, data: mujoco.MjData, frame: DriveFrame) -> None:
        """Adds a picture of the state of `data`.

        Raises:
          RenderError: ffmpeg failed.
        """
        self.encoder.add(self.pictures.draw(data, frame))

    def close(self) -> None:
        """Completes the video and frees OpenGL."""
        self.pictures.close()
        self.encoder.close()

    def abandon(self) -> None:
        """Frees OpenGL and leaves no video."""
        self.pictures.close()
        self.encoder.abandon()


class VideoObserver(Finishing, Observer):
    """Observer that writes a video of a drive, with the instrument panel.

    Args:
      path: of the MP4 file; it appears when the observer is closed without an error.
      truck: to draw.
      size: width and height in pixels, rounded down to even numbers.
      camera, weather: as of `Pictures`.
      fps: pictures per second; the time between pictures is rounded to 2 ms.
      overlay: whether to draw the instruments.

    Attributes:
      path: of the video; period: time between pictures [s].

    Raises:
      InputError: unknown camera, size or path not allowed.
      RenderError: OpenGL or ffmpeg is missing.
    """

    def __init__(
        self,
        path: str | Path,
        truck: Truck,
        size: tuple[int, int] = (960, 540),
        camera: str = "chase",
        fps: float = 20.0,
        *,
        weather: str | None = "day",
        overlay: bool = True,
    ) -> None:
        self.period = frame_period(fps)
        self._truck = truck
        # OpenGL fails most often; an unused encoder would write to stderr when it is abandoned.
        pictures = Pictures(truck, size, camera, weather, overlay=overlay)
        try:
            encoder = Mp4Encoder(path, pictures.size, 1.0 / self.period)
        except BaseException:
            pictures.close()
            raise
        self.path = encoder.path
        self._film = Film(pictures, encoder)

    @property
    def frames(self) -> int:
        """Number of pictures so far."""
        return self._film.encoder.frames

    def observe(self, simulation: LockStep | None, frame: DriveFrame) -> None:
        """Adds a picture of this instant; `simulation` is not used."""
        del simulation
        self._film.add(self._truck.data, frame)

    def close(self) -> None:
        """Completes the video and frees OpenGL."""
        self._film.close()

    def abandon(self) -> None:
        """Frees OpenGL and leaves no video."""
        self._film.abandon()
