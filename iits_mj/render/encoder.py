"""H.264 in an MP4 file, through the ffmpeg that comes inside the imageio-ffmpeg wheel."""

from __future__ import annotations

import os
from collections.abc import Generator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from iits_mj.closing import Finishing
from iits_mj.errors import InputError, RenderError


class Mp4Encoder(Finishing):
    """Takes pictures one by one; the file appears whole when it is closed without an error.

    Args:
      path: of the film, ending in .mp4; its folder must exist.
      size: width and height, both even; fps: pictures per second.
      quality: x264's constant rate factor, smaller is better and larger.

    Raises:
      InputError: the path is not usable. RenderError: ffmpeg does not start.
    """

    def __init__(
        self, path: str | Path, size: tuple[int, int], fps: float, quality: int = 25
    ) -> None:
        self.path = Path(path)
        if self.path.suffix.lower() != ".mp4":
            raise InputError(f"film {str(path)!r} is not allowed: its name must end in .mp4")
        folder = self.path.parent
        if not folder.is_dir() or not os.access(folder, os.W_OK):
            raise InputError(
                f"film {str(path)!r} cannot be written: no writable folder {str(folder)!r}"
            )
        if not 1.0 <= fps <= 120.0:
            raise InputError(f"fps {fps!r} is not allowed: use 1 to 120")
        self.size = size
        self.frames = 0
        self._partial = self.path.with_name(f".{self.path.stem}.partial.mp4")
        self._pipe: Generator[None, Any, None] | None = _pipe(self._partial, size, fps, quality)

    def add(self, picture: NDArray[np.uint8]) -> None:
        """Appends a picture (height, width, 3).

        Raises:
          InputError: the picture's shape does not fit. RenderError: ffmpeg failed.
        """
        if self._pipe is None:
            raise RenderError(f"film {str(self.path)!r} is already closed")
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
        """Ends the film and puts it in its place; without a picture nothing is left."""
        if self._pipe is None:
            return
        self._pipe.close()
        self._pipe = None
        if self.frames and self._partial.is_file() and self._partial.stat().st_size:
            self._partial.replace(self.path)
            return
        self._partial.unlink(missing_ok=True)
        if self.frames:
            raise RenderError(f"ffmpeg wrote nothing to {str(self.path)!r}")

    def abandon(self) -> None:
        """Ends without a film; an older one stays as it was."""
        if self._pipe is not None:
            self._pipe.close()
            self._pipe = None
        self._partial.unlink(missing_ok=True)


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
