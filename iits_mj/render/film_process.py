"""Draws and encodes the video of a drive in another process while the drive goes on."""

from __future__ import annotations

import contextlib
import dataclasses
import os
import pickle
import queue
import signal
import subprocess
import sys
import threading
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

import mujoco
import numpy as np

from iits_mj.core.context import Finishing
from iits_mj.core.errors import Error, InputError, RenderError
from iits_mj.core.process_pool import single_threaded_workers
from iits_mj.render.cameras import Camera, cameras_of
from iits_mj.render.context import make_context
from iits_mj.render.offscreen import check_size
from iits_mj.render.video import Film, Mp4Encoder, Pictures, frame_period
from iits_mj.simulation.config import TruckStart
from iits_mj.simulation.lock_step import LockStep, Observer
from iits_mj.simulation.parts import load_route, load_truck
from iits_mj.truck import Truck
from traffic_bridge import Mirror

if TYPE_CHECKING:
    from iits_mj.simulation import DriveFrame

# The drive waits when the film is more than this number of pictures behind. What the pipe between
# the processes holds, about seven pictures, comes on top.
BEHIND = 8
_STATE = (
    mujoco.mjtState.mjSTATE_TIME
    | mujoco.mjtState.mjSTATE_QPOS
    | mujoco.mjtState.mjSTATE_MOCAP_POS
    | mujoco.mjtState.mjSTATE_MOCAP_QUAT
)
_LEAVE_TIME = 10.0  # [s] for the process to end on request


@dataclasses.dataclass(frozen=True)
class FilmSettings:
    """What the other process needs to begin.

    Attributes:
      path: of the MP4 file; config: truck and road of the drive.
      size, camera, fps, weather: as of `VideoObserver`.
      road_users: as of the `Mirror` of the drive.
    """

    path: Path
    config: TruckStart
    size: tuple[int, int]
    camera: str | type[Camera] | Camera
    fps: float
    weather: str = "day"
    road_users: bool | Mapping[str, int] = False


class FilmProcess(Finishing, Observer):
    """Observer that writes a video as `VideoObserver` does, in another process.

    That process makes its own model with road and landscape, so the drive can do without them. It
    starts at once; `check` waits until it can draw.

    Args:
      settings: of the film.

    Attributes:
      path: of the video, which appears when the observer is closed without an error.
      period: time between pictures [s].

    Raises:
      InputError: fps, size or camera is not allowed.
    """

    def __init__(self, settings: FilmSettings) -> None:
        self.path, self.period = settings.path, frame_period(settings.fps)
        # The other process needs no traffic and no driving stack.
        names = [field.name for field in dataclasses.fields(TruckStart)]
        config = TruckStart(**{name: getattr(settings.config, name) for name in names})
        settings = dataclasses.replace(settings, size=check_size(settings.size), config=config)
        cameras_of(settings.camera)
        self._messages: queue.Queue[bytes] = queue.Queue(BEHIND)
        self._ready, self._loaded = threading.Event(), threading.Event()
        self._failure: Error | None = None
        self._ended = False
        with single_threaded_workers():
            # In its own session, which Ctrl-C does not reach.
            self._process = subprocess.Popen(
                [sys.executable, "-P", "-m", __name__],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                start_new_session=True,
            )
        # Threads, so that an interrupt of the drive cannot cut a message.
        self._threads = [
            threading.Thread(target=task, daemon=True) for task in (self._send, self._receive)
        ]
        for thread in self._threads:
            thread.start()
        self._messages.put(pickle.dumps(settings))

    @property
    def pid(self) -> int:
        """Number of the other process."""
        return self._process.pid

    def check(self) -> None:
        """Waits until the process is ready to draw.

        Raises:
          InputError: the path is not allowed. RenderError: OpenGL or ffmpeg is missing.
        """
        self._ready.wait()
        self._raise_failure()

    def wait_until_loaded(self) -> None:
        """Waits until the process has made its model; errors as of `check`."""
        self._loaded.wait()
        self._raise_failure()

    def observe(self, simulation: LockStep | None, frame: DriveFrame) -> None:
        """Sends this instant to the process, and waits if it is behind.

        Raises:
          RenderError: the film failed.
        """
        self._raise_failure()
        truck = None if simulation is None else simulation.truck
        if not isinstance(truck, Truck):
            raise InputError(f"a film needs the Truck of a simulation, not {truck!r}")
        state = np.empty(mujoco.mj_stateSize(truck.model, _STATE))
        mujoco.mj_getState(truck.model, truck.data, state, _STATE)
        # A new scene is without its columns of neighbors, which hold the whole route.
        plain = dataclasses.replace(frame, scene=dataclasses.replace(frame.scene))
        self._messages.put(pickle.dumps((state, plain)))

    def close(self) -> None:
        """Waits for the last pictures and completes the video.

        Raises:
          RenderError: the film failed.
        """
        if self._ended:
            return
        try:
            self._messages.put(pickle.dumps(None))
            self._wait()
        except BaseException:
            self.abandon()
            raise
        self._raise_failure()

    def abandon(self) -> None:
        """Ends the process; it leaves no video."""
        if self._ended:
            return
        if self._process.poll() is None:
            self._process.terminate()
            try:
                self._process.wait(_LEAVE_TIME)
            except subprocess.TimeoutExpired:
                self._process.kill()
        self._wait()

    def _wait(self) -> None:
        self._process.wait()
        self._messages.put(b"")
        for thread in self._threads:
            thread.join()
        self._ended = True

    def _raise_failure(self) -> None:
        if self._failure is not None:
            raise self._failure

    def _send(self) -> None:
        """Writes messages to the process; after its end, removes them."""
        pipe = self._process.stdin
        assert pipe is not None
        while message := self._messages.get():
            with contextlib.suppress(OSError):
                pipe.write(message)
                pipe.flush()
        with contextlib.suppress(OSError):
            pipe.close()

    def _receive(self) -> None:
        """Reads the process's answers until it ends."""
        pipe = self._process.stdout
        assert pipe is not None
        answer: Any = None
        with contextlib.suppress(EOFError, pickle.UnpicklingError), pipe:
            while True:
                answer = pickle.load(pipe)
                if isinstance(answer, Error):
                    self._failure = answer
                self._ready.set()
                if answer == "loaded":
                    self._loaded.set()
        if answer != "done" and self._failure is None:
            code = self._process.wait()
            self._failure = RenderError(
                f"the process that draws {str(self.path)!r} ended with exit code {code}"
            )
        self._ready.set()
        self._loaded.set()


def main() -> None:
    """Draws the film whose settings and instants arrive on stdin; answers on stdout."""
    # Ends with the `with` blocks below, which remove the unfinished file.
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)

    def answer(content: object) -> None:
        pickle.dump(content, answers)
        answers.flush()

    try:
        _draw(sys.stdin.buffer, answer)
    except Error as error:
        answer(error)
    except (EOFError, pickle.UnpicklingError, BrokenPipeError):
        # The drive was killed.
        sys.exit(1)


def _draw(messages: BinaryIO, answer: Any) -> None:
    settings: FilmSettings = pickle.load(messages)
    make_context(16, 16).free()
    encoder = Mp4Encoder(settings.path, settings.size, 1.0 / frame_period(settings.fps))
    with encoder:
        answer("ready")
        route = load_route(settings.config)
        truck = load_truck(settings.config, route, Mirror(road_users=settings.road_users))
        model, data = truck.model, mujoco.MjData(truck.model)
        pictures = Pictures(truck, settings.size, settings.camera, settings.weather)
        with Film(pictures, encoder) as film:
            answer("loaded")
            while (message := pickle.load(messages)) is not None:
                state, frame = message
                mujoco.mj_setState(model, data, state, _STATE)
                mujoco.mj_kinematics(model, data)
                mujoco.mj_camlight(model, data)
                film.add(data, frame)
    answer("done")


if __name__ == "__main__":
    main()
