"""Draws the pictures on the environments' manual pages; needs OpenGL.

    python tools/environment_pictures.py
    python tools/environment_pictures.py stop dock

Each picture shows a task some seconds into an episode of its scripted driver.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from PIL import Image

from iits_mj import suite
from iits_mj.envs.picture import level_camera
from iits_mj.envs.platoon import PlatoonEnv
from iits_mj.render.offscreen import Offscreen
from iits_mj.suite.drivers import platoon

# Seconds into the episode, and the camera.
SHOTS = {
    "cruise": (6.0, "side"),
    "stop": (14.0, "chase"),
    "hill_start": (6.0, "side"),
    "lane_keep": (8.0, "chase"),
    "lane_change": (8.0, "chase"),
    "tight_turn": (11.0, "chase"),
    "dock": (25.0, "side"),
    "cut_in": (6.5, "chase"),
    "emergency_stop": (9.0, "side"),
}
SIZE = (640, 360)
FOLDER = Path(__file__).resolve().parents[1] / "docs" / "environments" / "images"


def draw(folder: Path, names: Sequence[str] = ()) -> None:
    """Writes a PNG file for each page, or for the named ones.

    Raises:
        ValueError: A name has no picture.
    """
    pictures: dict[str, Callable[[], Any]] = {
        task: partial(_driven, task, time, camera) for task, (time, camera) in SHOTS.items()
    }
    pictures["highway"] = partial(_stepped, "Highway", 40, 3, density="dense", traffic_speed=12.5)
    pictures["highway_fast"] = partial(_stepped, "HighwayFast", 20, 1, density="dense")
    pictures["speed_planning"] = partial(_stepped, "SpeedPlanning", 6, 1)
    pictures["hoel2020"] = partial(_stepped, "Hoel2020", 5, 3)
    pictures["platoon"] = _platoon
    if unknown := set(names) - set(pictures):
        raise ValueError(f"no picture {sorted(unknown)}; pictures: {', '.join(pictures)}")
    folder.mkdir(parents=True, exist_ok=True)
    for name in names or pictures:
        _save(folder / f"{name}.png", pictures[name]())


def _driven(task: str, time: float, camera: str) -> Any:
    environment = suite.load("truck", task, task_kwargs={"random": 1})
    driver = suite.DRIVERS[task]
    step = environment.reset()
    while environment.physics.data.time < time and not step.last():
        step = environment.step(driver(step.observation))
    physics = environment.physics
    with Offscreen(physics.model.ptr, SIZE) as renderer:
        model, data = physics.model.ptr, physics.data.ptr
        renderer.update(data, level_camera(model, data, camera))
        return renderer.draw()


def _stepped(name: str, steps: int, seed: int, **settings: Any) -> Any:
    environment = gymnasium.make(f"iits_mj:iits_mj/{name}-v0", render_mode="rgb_array", **settings)
    environment.reset(seed=seed)
    discrete = isinstance(environment.action_space, gymnasium.spaces.Discrete)
    for _ in range(steps):
        environment.step(np.int64(1) if discrete else np.array([0.3], np.float32))
    picture = environment.render()
    environment.close()
    return picture


def _platoon() -> Any:
    with PlatoonEnv(render_mode="rgb_array") as environment:
        environment.reset(seed=0)
        for _ in range(40):
            actions = {a: platoon(environment.seen(a)) for a in environment.agents}
            environment.step({a: v.astype(np.float32) for a, v in actions.items()})
        return environment.render()


def _save(path: Path, picture: Any) -> None:
    Image.fromarray(picture).quantize(128).save(path, optimize=True)


if __name__ == "__main__":
    try:
        draw(FOLDER, sys.argv[1:])
    except ValueError as error:
        sys.exit(f"error: {error}")
