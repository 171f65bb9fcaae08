"""Measure the film of a drive against MuJoCo's bare renderer, and against the drive alone."""

from __future__ import annotations

import copy
import functools
import math
import tempfile
import time
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

from iits_mj.commands.bench.clocks import MILLISECONDS, children_time
from iits_mj.core.context import Closing
from iits_mj.core.errors import RenderError
from iits_mj.core.results import Findings
from iits_mj.render.cameras import FollowCamera
from iits_mj.render.context import make_context
from iits_mj.render.film_process import FilmProcess, FilmSettings
from iits_mj.render.video import Pictures, VideoObserver
from iits_mj.render.weather import WEATHERS
from iits_mj.simulation import DriveConfig, Simulation

SIZE, DEFAULT_SIZE = (1280, 720), (960, 540)
PICTURES = 6
FPS = 20.0


def film(rounds: int) -> Findings:
    """Returns the speed of films.

    Args:
      rounds: of pictures, and twice the simulated seconds of the drive; three take less than 30 s
        on two free cores without a graphics card.
    """
    found = Findings("film")
    try:
        make_context(16, 16).free()
    except RenderError:
        return found
    with tempfile.TemporaryDirectory() as folder:
        with Simulation(DriveConfig(duration=60.0)) as simulation:
            for _ in range(20):
                simulation.cycle()
            _pictures(found, simulation, rounds, Path(folder))
            _weathers(found, simulation, rounds)
        _whole_drive(found, 2.0 * rounds, Path(folder))
    return found


def _pictures(found: Findings, simulation: Simulation, rounds: int, folder: Path) -> None:
    """Adds the pictures of a film with overlay and encoding over those of MuJoCo's renderer."""
    truck, frame = simulation.truck, simulation.frame
    before, count = children_time(), 0
    with (
        VideoObserver(folder / "film.mp4", truck, SIZE, fps=FPS) as video,
        _BareRenderer(truck.model) as bare,
    ):
        camera = FollowCamera("chase").follow(truck.data)
        walls, processor = _times(
            {
                "film": lambda: video.observe(None, frame),
                "bare": lambda: bare.draw(truck.data, camera),
            },
            rounds,
        )
        count = video.frames
    # The encoder is another process, whose time is known at its end.
    processor["film"] += PICTURES * (children_time() - before) / count
    for kind, times in (("wall time", walls), ("processor time", processor)):
        ratio = times["bare"] / times["film"]
        found.check(f"film over MuJoCo's bare renderer, {kind}", ratio, "1", 0.85, ">= 0.7")
    found.check(
        "a picture of the film, 1280x720", MILLISECONDS * processor["film"] / PICTURES, "ms"
    )


def _weathers(found: Findings, simulation: Simulation, rounds: int) -> None:
    """Adds the processor time of a picture in each weather over that of one by day."""
    truck, frame = simulation.truck, simulation.frame
    with ExitStack() as stack:
        drawn = {
            name: stack.enter_context(Pictures(truck, DEFAULT_SIZE, weather=name))
            for name in WEATHERS
        }
        players = {
            name: functools.partial(pictures.draw, truck.data, frame)
            for name, pictures in drawn.items()
        }
        _, processor = _times(players, rounds)
    for name in WEATHERS:
        if name != "day":
            ratio = processor[name] / processor["day"]
            found.check(f"a picture in {name} over one by day, processor time", ratio, "1")


def _times(
    players: Mapping[str, Callable[[], object]], rounds: int
) -> tuple[dict[str, float], dict[str, float]]:
    """Returns wall and processor times of some pictures by each player [s]."""
    walls, processor = dict.fromkeys(players, math.inf), dict.fromkeys(players, math.inf)
    # In turns, so that other work on the machine affects all; the first pictures compile shaders.
    for turn in range(rounds + 1):
        for name, play in players.items():
            start = time.perf_counter(), time.process_time()
            for _ in range(PICTURES):
                play()
            if turn:
                walls[name] = min(walls[name], time.perf_counter() - start[0])
                processor[name] = min(processor[name], time.process_time() - start[1])
    return walls, processor


def _whole_drive(found: Findings, duration: float, folder: Path) -> None:
    """Adds the wall time of a drive with its film over the drive alone, both without loading."""
    config = DriveConfig(duration=duration)
    with Simulation(config, visuals=False) as simulation:
        start = time.perf_counter()
        simulation.run()
        alone = time.perf_counter() - start
    settings = FilmSettings(folder / "drive.mp4", config, DEFAULT_SIZE, "chase", FPS)
    with Simulation(config, visuals=False) as simulation:
        with FilmProcess(settings) as process:
            process.wait_until_loaded()
            start = time.perf_counter()
            simulation.run([process])
        filmed = time.perf_counter() - start
    found.check(
        "drive with its film, 960x540, over the drive alone", filmed / alone, "1", 4.0, "<= 6"
    )


class _BareRenderer(Closing):
    """Pictures as `mujoco.Renderer` draws them, with a context from EGL.

    Multisampling is off, as in films: it would make these pictures slower.
    """

    def __init__(self, model: mujoco.MjModel) -> None:
        self._context = make_context(*SIZE)
        self._model = copy.copy(model)
        self._model.vis.quality.offsamples = 0
        self._model.vis.global_.offwidth, self._model.vis.global_.offheight = SIZE
        self._target = mujoco.MjrContext(self._model, mujoco.mjtFontScale.mjFONTSCALE_100.value)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN.value, self._target)
        self._scene = mujoco.MjvScene(self._model, maxgeom=5000)
        self._option, self._perturb = mujoco.MjvOption(), mujoco.MjvPerturb()
        self._pixels = np.empty((SIZE[1], SIZE[0], 3), np.uint8)

    def draw(self, data: mujoco.MjData, camera: mujoco.MjvCamera) -> NDArray[np.uint8]:
        """Returns a picture."""
        self._context.make_current()
        everything = mujoco.mjtCatBit.mjCAT_ALL.value
        mujoco.mjv_updateScene(
            self._model, data, self._option, self._perturb, camera, everything, self._scene
        )
        part = mujoco.MjrRect(0, 0, *SIZE)
        mujoco.mjr_render(part, self._scene, self._target)
        mujoco.mjr_readPixels(self._pixels, None, part, self._target)
        return self._pixels[::-1]

    def close(self) -> None:
        """Frees the context."""
        self._context.make_current()
        self._target.free()
        self._context.free()
