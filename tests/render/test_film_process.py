"""The process that draws the film of a drive: same film, and nothing left behind in any end."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path

import numpy as np
import pytest

from iits_mj import cli
from iits_mj.core.errors import InputError, RenderError
from iits_mj.render.film_process import FilmProcess, FilmSettings
from iits_mj.render.video import VideoObserver
from iits_mj.simulation import DriveConfig, Simulation

pytestmark = pytest.mark.usefixtures("opengl")

CONFIG = DriveConfig(duration=1.0, traffic_mode="none")
SIZE = (160, 120)
LONGEST = 60.0  # [s] for processes to end


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


@pytest.mark.parametrize(
    ("number", "code"),
    [
        (signal.SIGINT, 130),
        pytest.param(signal.SIGTERM, 143, marks=pytest.mark.slow),
        (signal.SIGKILL, -9),
    ],
)
def test_ended_drive_leaves_a_whole_film_or_none(
    tmp_path: Path, number: signal.Signals, code: int
) -> None:
    words = "drive --traffic-mode none --duration 4000 --size 160x120 --out ."
    line = [sys.executable, "-m", "iits_mj.cli", *words.split()]
    drive = subprocess.Popen(line, cwd=tmp_path, stderr=subprocess.PIPE)
    deadline = time.monotonic() + LONGEST
    # The telemetry begins when the drive does.
    while not list(tmp_path.glob(".telemetry*")) or not list(tmp_path.glob(".drive*")):
        assert time.monotonic() < deadline, "the drive did not begin"
        time.sleep(0.1)
    time.sleep(5.0)
    film = children(drive.pid)
    drive.send_signal(number)
    _, error = drive.communicate(timeout=LONGEST)
    assert drive.returncode == code
    assert b"Traceback" not in error
    assert film
    while not all(gone(pid) for pid in film):
        assert time.monotonic() < deadline + LONGEST, "the film's process goes on"
        time.sleep(0.05)
    assert not list(tmp_path.glob(".drive*"))
    if number == signal.SIGKILL:
        assert not (tmp_path / "drive.mp4").exists()
    else:
        assert len(pictures(tmp_path / "drive.mp4")) > 5


def children(pid: int) -> list[int]:
    """Numbers of a process's children and of theirs."""
    found = []
    for tasks in Path(f"/proc/{pid}/task").glob("*/children"):
        for child in map(int, tasks.read_text().split()):
            found += [child, *children(child)]
    return found


def test_full_disk_ends_the_drive_and_keeps_the_old_film(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    full_disk: Callable[[int], AbstractContextManager[None]],
) -> None:
    (tmp_path / "drive.mp4").write_bytes(b"old")
    words = ["drive", "--traffic-mode", "none", "--duration", "60", "--out", str(tmp_path)]
    with full_disk(50_000):
        assert cli.main(words) == 2
    error = capsys.readouterr().err
    assert "drive.mp4" in error
    assert (tmp_path / "drive.mp4").read_bytes() == b"old"
    assert not list(tmp_path.glob(".drive*"))
