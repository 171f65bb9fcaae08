"""Show a drive live, in a browser (--web) or in MuJoCo's interactive viewer.

--web prints an address to open; it also works on a machine without a display, over SSH. In the
browser viewers pause, change cameras and settings, trigger events, and drive by keyboard or
gamepad. FILE shows a recording or a bag, --env a task of the suite or a Gymnasium environment.
Without --web, keys and mouse work as in MuJoCo's own viewer, and closing the window ends the drive.
"""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from iits_mj.core.errors import InputError
from iits_mj.core.options import given_names, option, part_option
from iits_mj.core.timing import CONTROL_PERIOD
from iits_mj.envs import ENVIRONMENTS
from iits_mj.render.cameras import CAMERA, Camera
from iits_mj.simulation import DriveConfig, DriveFrame, Observer, Simulation
from iits_mj.simulation.config import with_level_start
from iits_mj.simulation.drive_log import check_given
from iits_mj.simulation.lock_step import LockStep
from iits_mj.web import PORT, WebServer

INTERRUPTED = 130
POLICIES = ("scripted", "random", "manual")
# A drive in the browser lasts this long unless --duration is given [s].
_LONG = 86_400.0
_OF_WEB = ("host", "port", "env", "policy", "camera")
# Options of a drive that an environment has, too.
_OF_ENV = ("web", "env", "policy", "host", "port", "pace", "seed", "truck", "payload", "plant")
_OF_FILE = ("web", "host", "port", "pace", "file", "map", "truck")


@dataclass(frozen=True, kw_only=True)
class Options(DriveConfig):
    """Flags of `iits-mj view`."""

    file: Path | None = option(
        None,
        help="show this recording of 'iits-mj record' or this bag of 'iits-mj drive --bag'",
        metavar="FILE",
        positional=True,
    )
    web: bool = option(False, help="show it in a browser", group="view")
    host: str = option(
        "127.0.0.1",
        help="address to listen on; 0.0.0.0 lets other machines in that know the secret address",
        metavar="ADDRESS",
        group="view",
    )
    port: int = option(
        PORT, help="port of the page; the next free one is used", low=0, high=65_535, group="view"
    )
    env: str | None = option(
        None,
        help="show this task of the suite or Gymnasium environment instead of a drive",
        names=lambda: tuple(ENVIRONMENTS),
        group="view",
    )
    policy: str = option(
        "scripted", help="driver of the environment", choices=POLICIES, group="view"
    )
    camera: str | type[Camera] | Camera = part_option(
        "chase", CAMERA, "camera with which the pages of a drive begin", group="view"
    )
    pace: float = option(
        1.0,
        help="simulated time over wall time",
        low=0.1,
        high=20.0,
        metavar="FACTOR",
        group="view",
    )
    given: frozenset[str] = given_names()


class _Window(Observer):
    """Observer that shows the drive at the pace of the wall clock."""

    period = CONTROL_PERIOD

    def __init__(self, window: Any, pace: float) -> None:
        self._window = window
        self._pace = pace
        self._start = time.perf_counter()

    def observe(self, simulation: LockStep, frame: DriveFrame) -> None:
        """Draws the frame and waits until the wall clock reaches its time."""
        if not self._window.is_running():
            simulation.stop("the window was closed")
            return
        self._window.sync()
        ahead = frame.time / self._pace - (time.perf_counter() - self._start)
        if ahead > 0.0:
            time.sleep(ahead)


def run(options: Options) -> int:
    """Shows the drive; returns the exit code.

    Raises:
      RenderError: there is no display. InputError: an option has no effect.
    """
    if options.web:
        return _in_browser(options)
    for name in (*_OF_WEB, "file"):
        if name in options.given:
            raise InputError(f"{_flag(name)} needs --web")
    check_given(options, options.given)
    return _in_window(with_level_start(options, options.given))


def _in_window(options: Options) -> int:
    # Load OpenGL for a window only here.
    import mujoco.viewer

    from iits_mj.render.cameras import follow
    from iits_mj.render.context import check_display

    check_display()
    with Simulation(options) as simulation:
        truck = simulation.truck
        with mujoco.viewer.launch_passive(truck.model, truck.data) as window:
            follow(window, truck.model)
            summary = simulation.run([_Window(window, options.pace)])
    print(summary.to_text())
    sys.stdout.flush()
    return 0


def _in_browser(options: Options) -> int:
    if options.file is not None and options.env is not None:
        raise InputError("FILE and --env cannot both be shown: name one")
    if options.env is not None:
        _refuse(options, _OF_ENV, "--env")
        return _environment(options, options.env)
    if "policy" in options.given:
        raise InputError("--policy needs --env")
    if options.file is not None:
        _refuse(options, _OF_FILE, "a recording")
        return _file(options, options.file)
    return _drive(options)


def _refuse(options: Options, used: tuple[str, ...], by: str) -> None:
    for name in sorted(options.given - {*used, "file"}):
        raise InputError(f"{_flag(name)} has no effect on {by}: leave it out")


def _flag(name: str) -> str:
    return "FILE" if name == "file" else f"--{name.replace('_', '-')}"


def announced(options: Options, title: str, what: str) -> WebServer:
    """Returns the server after it has printed where to look; building a drive takes seconds."""
    server = WebServer(options.host, options.port, title=title)
    server.tell("state", {"message": f"Preparing {what} …"})
    print(f"{what} is shown in the browser.\n{server.instructions()}\nCtrl-C ends it.")
    sys.stdout.flush()
    return server


def _drive(options: Options) -> int:
    from iits_mj.web.live import LiveDrive

    check_given(options, options.given)
    config = with_level_start(options, options.given)
    if "duration" not in options.given:
        config = replace(config, duration=_LONG)
    with (
        announced(options, "iits-mj drive", "The drive") as server,
        LiveDrive(server, config, options.pace, options.camera) as drive,
    ):
        drive.run()
        summary = drive.summary()
    print(summary.to_text())
    sys.stdout.flush()
    return INTERRUPTED


def _environment(options: Options, name: str) -> int:
    from iits_mj.web.environments import EnvironmentShow, check_name

    check_name(name)
    with (
        announced(options, f"iits-mj {name}", name) as server,
        EnvironmentShow(
            server,
            name,
            policy=options.policy,
            pace=options.pace,
            seed=options.seed,
            truck=options.truck,
            payload=options.payload,
            plant=options.plant,
        ) as show,
    ):
        show.run()
        print(show.summary())
    sys.stdout.flush()
    return INTERRUPTED


def _file(options: Options, path: Path) -> int:
    from iits_mj.web.playback import Playback
    from iits_mj.web.track import read_track

    track = read_track(path, options.map, options.truck)
    with announced(options, f"iits-mj {path.name}", str(path)) as server:
        Playback(server, track, options.pace).run()
    return INTERRUPTED
