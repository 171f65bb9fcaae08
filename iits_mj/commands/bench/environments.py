"""Measures the Gymnasium environments against the bare physics, and the time of `import iits_mj`.

Things that are compared run in turns, so that other work on the machine affects all of them, and
the best round counts. Times are processor times, except for threads and processes.
"""

from __future__ import annotations

import functools
import math
import subprocess
import sys
import time
from collections.abc import Callable

import gymnasium
import mujoco
import numpy as np

import iits_mj  # noqa: F401 (registers the environments)
from iits_mj.commands.bench.clocks import children_time, in_turns
from iits_mj.core.results import Findings
from iits_mj.envs.driving import DrivingEnv

ENVIRONMENT = "iits_mj/LaneKeep-v0"
TOGETHER = 8  # environments of one process
_STEPS = 10  # of the environments in a round
_WARM_UP = 2


def environments(rounds: int = 20) -> Findings:
    """Returns the share of the physics in steps of one environment, and of eight in one process.

    The physics is `mujoco.mj_step`, which computes the sensors in every time step.
    """
    alone = gymnasium.make(ENVIRONMENT)
    together = gymnasium.make_vec(ENVIRONMENT, num_envs=TOGETHER)
    driving = alone.unwrapped
    assert isinstance(driving, DrivingEnv)
    model = driving.physics.model.ptr
    data = mujoco.MjData(model)
    action = np.zeros(len(driving.task.actions), np.float32)
    actions = np.tile(action, (TOGETHER, 1))
    least = [math.inf] * 3
    for seed in range(rounds):
        alone.reset(seed=seed)
        together.reset(seed=seed)
        for _ in range(_WARM_UP):
            alone.step(action)
            together.step(actions)
        mujoco.mj_copyData(data, model, driving.physics.data.ptr)
        calls: tuple[Callable[[], object], ...] = (
            lambda: mujoco.mj_step(model, data, driving.steps_per_action),
            lambda: alone.step(action),
            lambda: together.step(actions),
        )
        for place, call in enumerate(calls):
            start = time.thread_time()
            for _ in range(_STEPS):
                call()
            least[place] = min(least[place], (time.thread_time() - start) / _STEPS)
    alone.close()
    together.close()
    bare, one, each = least[0], least[1], least[2] / TOGETHER
    found = Findings()
    found.check("step of LaneKeep, 0.1 s", one * 1e6, "us")
    found.check("bare physics over a step of LaneKeep", bare / one, "1", 0.9, ">= 0.80")
    name = f"bare physics over each step of {TOGETHER} LaneKeep on one thread"
    found.check(name, bare / each, "1", 0.9, ">= 0.80")
    found.check(f"{TOGETHER} LaneKeep on one thread, each over one alone", one / each, "1")
    return found


def import_time(rounds: int = 10) -> Findings:
    """Returns the processor time of `import iits_mj` over that of `import mujoco`."""
    codes = ("pass", "import mujoco", "import iits_mj")
    command = [sys.executable, "-W", "ignore", "-c"]
    runs = {code: functools.partial(subprocess.run, [*command, code], check=True) for code in codes}
    start, bare, ours = in_turns(runs, rounds, children_time).values()
    found = Findings()
    name = "import iits_mj over import mujoco, without Python's start"
    found.check(name, (ours - start) / (bare - start), "1", 1.2, "<= 1.5")
    return found
