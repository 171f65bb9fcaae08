"""The truck's tasks as a dm_control domain: `suite.load("truck", "cruise")`.

The module mirrors `dm_control.suite`: `ALL_TASKS`, `BENCHMARKING`, `EASY`, `HARD`,
`TASKS_BY_DOMAIN`, `load` and `build_environment`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from dm_control.rl import control

from iits_mj.errors import InputError
from iits_mj.suite import truck
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
TASKS_BY_DOMAIN = {name: tuple(domain.SUITE) for name, domain in DOMAINS.items()}


def build_environment(
    domain_name: str,
    task_name: str,
    task_kwargs: Mapping[str, Any] | None = None,
    environment_kwargs: Mapping[str, Any] | None = None,
) -> control.Environment:
    """Builds a task's environment.

    Args:
      domain_name: "truck".
      task_name: see `TASKS_BY_DOMAIN`.
      task_kwargs: `random` (seed), `time_limit` [s], `payload` [kg], `payload_height` [m] and
        `visuals`.
      environment_kwargs: of `dm_control.rl.control.Environment`.

    Raises:
      InputError: unknown domain or task.
    """
    if domain_name not in DOMAINS:
        raise InputError(f"domain {domain_name!r} is unknown; there is: {', '.join(DOMAINS)}")
    tasks = DOMAINS[domain_name].SUITE
    if task_name not in tasks:
        raise InputError(f"task {task_name!r} is unknown; there are: {', '.join(tasks)}")
    settings = dict(task_kwargs or {})
    if environment_kwargs is not None:
        settings["environment_kwargs"] = dict(environment_kwargs)
    return tasks[task_name](**settings)


load = build_environment

__all__ = [
    "ALL_TASKS",
    "BENCHMARKING",
    "EASY",
    "HARD",
    "TASKS_BY_DOMAIN",
    "Physics",
    "build_environment",
    "load",
]
