"""The truck's tasks as a dm_control domain: `suite.load("truck", "cruise")`.

The module mirrors `dm_control.suite`: `ALL_TASKS`, `BENCHMARKING`, `EASY`, `HARD`,
`TASKS_BY_DOMAIN`, `load` and `build_environment`.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from typing import Any

try:
    with warnings.catch_warnings():
        # dm_control.mujoco looks for a display through GLFW, which warns where there is none.
        warnings.filterwarnings("ignore", message=".*DISPLAY environment variable is missing")
        import dm_control.mujoco  # noqa: F401 (imported later anyway, with the warning)
        from dm_control.rl import control
except ImportError as error:
    raise ImportError(
        "the tasks need dm_control: pip install --no-deps dm-control==1.0.50"
    ) from error

from iits_mj.core.errors import InputError
from iits_mj.suite import truck
from iits_mj.suite.drivers import DRIVERS
from iits_mj.suite.physics import Physics

DOMAINS = {"truck": truck}


def _tagged(tag: str) -> tuple[tuple[str, str], ...]:
    return tuple(
        (name, task) for name, domain in DOMAINS.items() for task in domain.SUITE.tagged(tag)
    )


ALL_TASKS = tuple((name, task) for name, domain in DOMAINS.items() for task in domain.SUITE)
BENCHMARKING = _tagged("benchmarking")
EASY = _tagged("easy")
HARD = _tagged("hard")
EXTRA = tuple(sorted(set(ALL_TASKS) - set(BENCHMARKING)))
NO_REWARD_VIZ = _tagged("no_reward_visualization")
REWARD_VIZ = tuple(sorted(set(ALL_TASKS) - set(NO_REWARD_VIZ)))
TASKS_BY_DOMAIN = {name: tuple(domain.SUITE) for name, domain in DOMAINS.items()}


def build_environment(
    domain_name: str,
    task_name: str,
    task_kwargs: Mapping[str, Any] | None = None,
    environment_kwargs: Mapping[str, Any] | None = None,
    visualize_reward: bool = False,
) -> control.Environment:
    """Returns the environment of a task.

    Args:
      domain_name: "truck".
      task_name: see `TASKS_BY_DOMAIN`.
      task_kwargs: `random` (seed), `time_limit` [s], `truck`, `payload` [kg], `payload_height` [m],
        `plant` and `visuals`.
      environment_kwargs: of `dm_control.rl.control.Environment`.
      visualize_reward: colors cab and trailers according to the reward.

    Raises:
      InputError: unknown domain or task.
    """
    if domain_name not in DOMAINS:
        raise InputError(f"domain {domain_name!r} is unknown; use: {', '.join(DOMAINS)}")
    tasks = DOMAINS[domain_name].SUITE
    if task_name not in tasks:
        raise InputError(f"task {task_name!r} is unknown; use one of: {', '.join(tasks)}")
    settings = dict(task_kwargs or {})
    if environment_kwargs is not None:
        settings["environment_kwargs"] = dict(environment_kwargs)
    environment = tasks[task_name](**settings)
    environment.task.visualize_reward = visualize_reward
    return environment


load = build_environment


def twin(environment: control.Environment) -> control.Environment:
    """Returns a second environment of a task with the same compiled model and its own data.

    Raises:
      Error: the task's physics cannot be copied (SUMO's traffic).
    """
    physics = environment.physics.copy(share_model=True)
    limit = environment._step_limit * environment.control_timestep()
    return control.Environment(
        physics,
        type(environment.task)(random=0),
        time_limit=limit,
        control_timestep=environment.control_timestep(),
        legacy_step=False,
    )


__all__ = [
    "ALL_TASKS",
    "BENCHMARKING",
    "DRIVERS",
    "EASY",
    "EXTRA",
    "HARD",
    "NO_REWARD_VIZ",
    "REWARD_VIZ",
    "TASKS_BY_DOMAIN",
    "Physics",
    "build_environment",
    "load",
    "twin",
]
