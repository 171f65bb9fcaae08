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

from iits_mj.core.checks import one_of
from iits_mj.core.context import Finishing
from iits_mj.core.errors import InputError, RenderError
from iits_mj.core.output_files import OutputFile
from iits_mj.core.timing import TIMESTEP
from iits_mj.render.cameras import CAMERAS, FollowCamera
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


class Film(Finishing):
    """Draws a drive's pictures and encodes them.

    Args:
      offscreen, encoder: for pictures of the same size; closed with the film.
      truck: to follow on its route; camera: one of `iits_mj.render.cameras.CAMERAS`.
      overlay: whether to draw the instruments.

    Raises:
      InputError: unknown camera.
    """

    def __init__(
        self,
        offscreen: Offscreen,
        encoder: Mp4Encoder,
        truck: Truck,
        camera: str,
        *,
        overlay: bool = True,
    ) -> None:
        self.offscreen, self.encoder = offscreen, encoder
        self._camera = FollowCamera(camera, truck.route.tunnels, truck.parameters)
        self._overlay = Overlay(encoder.size, truck.route) if overlay else None

    def add(self, data: mujoco.MjData, frame: DriveFrame) -> None:
        """Adds a picture of the state of `data`.

        Raises:
          RenderError: ffmpeg failed.
        """
        self.offscreen.update(data, self._camera.follow(data, frame.ego.station))
        lamps = self.offscreen.lamps
        if lamps is not None:
            self.offscreen.signal(lamps.signals(data, frame))
        self.offscreen.add_boxes(trajectory_boxes(frame.trajectory, float(data.time)))
        picture = self.offscreen.draw()
        if self._overlay is not None:
            picture = self._overlay.draw(picture, frame)
        self.encoder.add(picture)

    def close(self) -> None:
        """Completes the video and frees OpenGL."""
        self.offscreen.close()
        self.encoder.close()

    def abandon(self) -> None:
        """Frees OpenGL and leaves no video."""
        self.offscreen.close()
        self.encoder.abandon()


class VideoObserver(Finishing, Observer):
    """Observer that writes a video of a drive, with the instrument panel.

    Args:
      path: of the MP4 file; it appears when the observer is closed without an error.
      truck: to draw.
      size: width and height in pixels, rounded down to even numbers.
      camera: one of `iits_mj.render.cameras.CAMERAS`.
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
        overlay: bool = True,
    ) -> None:
        self.period = frame_period(fps)
        self._truck = truck
        size = check_size(size)
        one_of("camera", camera, CAMERAS)
        # OpenGL fails most often; an unused encoder would write to stderr when it is abandoned.
        offscreen = Offscreen(truck.model, size)
        try:
            encoder = Mp4Encoder(path, size, 1.0 / self.period)
        except BaseException:
            offscreen.close()
            raise
        self.path = encoder.path
        self._film = Film(offscreen, encoder, truck, camera, overlay=overlay)

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
