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

from iits_mj.core.context import Finishing
from iits_mj.core.errors import InputError, RenderError
from iits_mj.core.messages import Trajectory
from iits_mj.core.output_files import OutputFile
from iits_mj.core.timing import TIMESTEP
from iits_mj.render.cameras import FollowCamera
from iits_mj.render.lane_sketch import add_trajectory
from iits_mj.render.offscreen import Offscreen, check_size
from iits_mj.render.overlay import Overlay
from iits_mj.simulation.lock_step import LockStep, Observer

if TYPE_CHECKING:
    from iits_mj.simulation import Frame
    from iits_mj.truck import Truck


class Mp4Encoder(Finishing):
    """Encodes pictures as H.264 in an MP4 file, with the ffmpeg of the imageio-ffmpeg wheel.

    The file appears when the encoder is closed without an error.

    Args:
      path: of the file, ending in .mp4; its folder must exist.
      size: width and height, both even; fps: pictures per second.
      quality: constant rate factor of x264; a smaller value gives better and larger videos.

    Raises:
      InputError: the path is not usable. RenderError: ffmpeg does not start.
    """

    def __init__(
        self, path: str | Path, size: tuple[int, int], fps: float, quality: int = 25
    ) -> None:
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
        self._pipe: Generator[None, Any, None] | None = _pipe(partial, size, fps, quality)

    def add(self, picture: NDArray[np.uint8]) -> None:
        """Appends a picture (height, width, 3).

        Raises:
          InputError: the picture's shape does not fit. RenderError: ffmpeg failed.
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
        """Completes the file; without a picture there is no file."""
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
        """Ends without a file; an older file stays unchanged."""
        if self._pipe is not None:
            self._pipe.close()
            self._pipe = None
        self._output.abandon()


def _pipe(
    path: Path, size: tuple[int, int], fps: float, quality: int
) -> Generator[None, Any, None]:
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
            output_params=["-crf", str(quality), "-preset", "veryfast", "-movflags", "+faststart"],
        )
        pipe.send(None)
    except (ImportError, OSError, RuntimeError) as error:
        raise RenderError(f"ffmpeg does not start: {error}; reinstall imageio-ffmpeg") from error
    return pipe


class VideoWriter(Finishing):
    """Writes a video of any model that has the bodies `tractor` and `trailer`.

    Args:
      path: of the MP4 file; it appears when the writer is closed without an error.
      model: to draw.
      size: width and height in pixels, made even.
      fps: pictures per second.
      camera: one of `iits_mj.render.cameras.CAMERAS`.
      tunnels: intervals of stations, for the view in tunnels.

    Raises:
      InputError: unknown camera, size or path not allowed. RenderError: no OpenGL, no ffmpeg.
    """

    def __init__(
        self,
        path: str | Path,
        model: mujoco.MjModel,
        size: tuple[int, int] = (960, 540),
        fps: float = 20.0,
        camera: str = "chase",
        tunnels: tuple[tuple[float, float], ...] = (),
    ) -> None:
        self.size = check_size(size)
        self.fps = fps
        self._camera = FollowCamera(camera, tunnels)
        # OpenGL fails most often; an unused encoder would write to stderr when it is abandoned.
        self._offscreen = Offscreen(model, self.size)
        try:
            self._encoder = Mp4Encoder(path, self.size, fps)
        except BaseException:
            self._offscreen.close()
            raise

    @property
    def path(self) -> Path:
        """Path of the video."""
        return self._encoder.path

    @property
    def frames(self) -> int:
        """Number of pictures so far."""
        return self._encoder.frames

    def picture(
        self,
        data: mujoco.MjData,
        trajectory: Trajectory | None = None,
        station: float | None = None,
    ) -> NDArray[np.uint8]:
        """A picture (height, width, 3), which is not added to the video."""
        self._offscreen.update(data, self._camera.follow(data, station))
        if trajectory is not None:
            add_trajectory(self._offscreen.scene, trajectory, float(data.time))
        return self._offscreen.draw()

    def append(self, picture: NDArray[np.uint8]) -> None:
        """Adds a picture to the video."""
        self._encoder.add(picture)

    def add(
        self,
        data: mujoco.MjData,
        trajectory: Trajectory | None = None,
        station: float | None = None,
    ) -> None:
        """Draws a picture of `data` and adds it to the video."""
        self.append(self.picture(data, trajectory, station))

    def close(self) -> None:
        """Completes the video and frees the context."""
        self._offscreen.close()
        self._encoder.close()

    def abandon(self) -> None:
        """Frees everything and leaves no video."""
        self._offscreen.close()
        self._encoder.abandon()


class VideoObserver(Finishing, Observer):
    """Observer that writes a video of a drive, with the instrument panel.

    Args:
      path, size, camera: see `VideoWriter`.
      truck: to draw.
      fps: pictures per second; rounded to a whole number of 2 ms steps between pictures.
      overlay: whether to draw the instruments.

    Attributes:
      period: time between pictures [s].

    Raises:
      InputError, RenderError: see `VideoWriter`.
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
        if not 1.0 <= fps <= 50.0:
            raise InputError(f"fps {fps!r} is not allowed: use 1 to 50")
        self.period = round(1.0 / fps / TIMESTEP) * TIMESTEP
        self._truck = truck
        self._writer = VideoWriter(
            path, truck.model, size, 1.0 / self.period, camera, truck.route.tunnels
        )
        self._overlay = Overlay(self._writer.size, truck.route) if overlay else None
        self.last: NDArray[np.uint8] | None = None

    @property
    def path(self) -> Path:
        """Path of the video."""
        return self._writer.path

    @property
    def frames(self) -> int:
        """Number of pictures so far."""
        return self._writer.frames

    def observe(self, simulation: LockStep | None, frame: Frame) -> None:
        """Adds a picture of this instant; `simulation` is not used."""
        del simulation
        picture = self._writer.picture(self._truck.data, frame.trajectory, frame.ego.station)
        if self._overlay is not None:
            picture = self._overlay.draw(picture, frame)
        self._writer.append(picture)
        self.last = picture

    def __call__(self, frame: Frame) -> None:
        """The same as `observe`."""
        self.observe(None, frame)

    def close(self) -> None:
        """Completes the video."""
        self._writer.close()

    def abandon(self) -> None:
        """Ends without a video."""
        self._writer.abandon()
