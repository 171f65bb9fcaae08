"""The process that draws the film of a drive: same film, and nothing left behind in any end."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from iits_mj.core.errors import InputError, RenderError
from iits_mj.render import offscreen
from iits_mj.render.film_process import FilmProcess, FilmSettings
from iits_mj.render.video import VideoObserver
from iits_mj.simulation import DriveConfig, Simulation

CONFIG = DriveConfig(duration=1.0, traffic_mode="none")
SIZE = (160, 120)
LONGEST = 60.0  # [s] for processes to end


@pytest.fixture(scope="module", autouse=True)
def _opengl():
    try:
        offscreen.make_context(16, 16).free()
    except RenderError as error:
        pytest.skip(f"OpenGL is missing: {error}")


def settings(path: Path) -> FilmSettings:
    return FilmSettings(path, CONFIG, SIZE, "chase", 20)


def pictures(path: Path) -> np.ndarray:
    import imageio_ffmpeg

    reader = imageio_ffmpeg.read_frames(str(path))
    next(reader)
    return np.array([np.frombuffer(picture, np.uint8) for picture in reader]).astype(int)


def gone(pid: int) -> bool:
    """Whether a process has ended, or is only remembered until its parent asks."""
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return True
    return state == "Z"


def test_film_shows_the_same_as_in_the_process_of_the_drive(tmp_path: Path) -> None:
    with (
        FilmProcess(settings(tmp_path / "far.mp4")) as film,
        Simulation(CONFIG) as simulation,
        VideoObserver(tmp_path / "near.mp4", simulation.truck, SIZE) as video,
    ):
        simulation.run([film, video])
    far, near = pictures(tmp_path / "far.mp4"), pictures(tmp_path / "near.mp4")
    assert far.shape == near.shape
    assert len(far) == 21
    # Positions of the same instant; those of the near film are one time step old.
    assert np.abs(far - near).mean() < 2.0
    assert sorted(p.name for p in tmp_path.iterdir()) == ["far.mp4", "near.mp4"]


def test_abandoned_film_leaves_no_file_and_no_process(tmp_path: Path) -> None:
    film = FilmProcess(settings(tmp_path / "film.mp4"))
    film.check()
    film.abandon()
    assert gone(film.pid)
    assert list(tmp_path.iterdir()) == []


def test_wrong_path_is_refused(tmp_path: Path) -> None:
    film = FilmProcess(settings(tmp_path / "missing" / "film.mp4"))
    with pytest.raises(InputError, match="no writable folder"):
        film.check()
    film.abandon()


def test_death_of_the_process_is_reported(tmp_path: Path) -> None:
    def drive() -> None:
        with FilmProcess(settings(tmp_path / "film.mp4")) as film, Simulation(CONFIG) as simulation:
            film.check()
            os.kill(film.pid, signal.SIGKILL)
            simulation.run([film])

    with pytest.raises(RenderError, match="ended with exit code -9"):
        drive()
    assert not (tmp_path / "film.mp4").exists()


DRIVER = """
import sys, time
from pathlib import Path
from iits_mj.render.film_process import FilmProcess, FilmSettings
from iits_mj.simulation import DriveConfig
film = FilmProcess(FilmSettings(Path(sys.argv[1]), DriveConfig(), (160, 120), "chase", 20))
film.check()
print(film.pid, flush=True)
time.sleep(60)
"""


def test_killed_drive_leaves_no_process_and_no_file(tmp_path: Path) -> None:
    line = [sys.executable, "-c", DRIVER, str(tmp_path / "film.mp4")]
    with subprocess.Popen(line, stdout=subprocess.PIPE, text=True) as drive:
        assert drive.stdout is not None
        pid = int(drive.stdout.readline())
        drive.kill()
    deadline = time.monotonic() + LONGEST
    while not gone(pid):
        assert time.monotonic() < deadline, "the film's process goes on"
        time.sleep(0.05)
    assert list(tmp_path.iterdir()) == []
