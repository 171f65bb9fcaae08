"""Writes the manual pages of tasks and environments from the code to `docs/environments`.

    python tools/environment_manual.py

A test compares the pages with the code.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import gymnasium

from controllers.decision.observation import FEATURES, FRAME_AGES, FRAME_SHAPE, ROWS
from controllers.decision.observation import __doc__ as observation_text
from iits_mj import suite
from iits_mj.envs import ENVIRONMENTS, LEVELS
from iits_mj.envs.driving import DrivingEnv
from iits_mj.envs.highway import DecisionEnv, HighwayEnv, HighwayFastEnv
from iits_mj.envs.hoel2020 import Hoel2020Env
from iits_mj.envs.platoon import PlatoonEnv
from iits_mj.envs.speed_planning import SpeedPlanningEnv
from iits_mj.suite import tasks
from iits_mj.suite.tasks import DRIVING_TASKS, DrivingTask, Platoon

OTHERS: dict[str, type[gymnasium.Env[Any, Any]]] = {
    "Highway": HighwayEnv,
    "HighwayFast": HighwayFastEnv,
    "SpeedPlanning": SpeedPlanningEnv,
    "Hoel2020": Hoel2020Env,
}
_ACTIONS = {
    "HighwayFast": "left, keep, right",
    "SpeedPlanning": "set speed",
    "Hoel2020": "ten pairs of acceleration and lane change",
}
FOLDER = Path(__file__).resolve().parents[1] / "docs" / "environments"
_NOTE = "<!-- made from the code by `python tools/environment_manual.py` -->"


def pages() -> dict[str, str]:
    """File name to Markdown."""
    made = {f"{task}.md": _driving(task, _env(task)) for task in DRIVING_TASKS}
    made["highway.md"] = _highway()
    made |= {f"{_snake(name)}.md": _other(name) for name in OTHERS if name != "Highway"}
    made["platoon.md"] = _platoon()
    made["README.md"] = _index()
    return made


def _driving(task: str, env: str) -> str:
    kind = DRIVING_TASKS[task]
    return _joined(
        f"# {env}",
        _NOTE,
        _picture(task, env),
        _body(kind),
        _table(
            ("", ""),
            [
                ("dm_control", f'`suite.load("truck", "{task}")`, {kind.time_limit:g} s'),
                ("Gymnasium", f'`gymnasium.make("iits_mj:iits_mj/{env}-v0")`'),
                (
                    "many at once",
                    f'`gymnasium.make_vec("iits_mj:iits_mj/{env}-v0", num_envs=64, threads=8)`',
                ),
                ("scripted driver", f'`suite.DRIVERS["{task}"]`'),
                *_registered(env),
            ],
        ),
        _actions(kind),
        _observations(kind),
        _rewards(
            kind,
            "The reward is the product of these factors, each in [0, 1]; Gymnasium's `info` has "
            "them as `reward_<factor>`.",
        ),
        "## Start\n\n" + _first(kind.initialize_episode),
        "## End\n\n" + _end(kind),
        "## Arguments\n\n" + _arguments(DrivingEnv, skip=("task", "like")),
        "## Versions\n\n- v0: first.",
    )


def _highway() -> str:
    kind = tasks.Highway
    return _joined(
        "# Highway",
        _NOTE,
        _picture("highway", "Highway"),
        '`gymnasium.make("iits_mj:iits_mj/Highway-v0")`',
        _body(HighwayEnv),
        _table(("", ""), _registered("Highway")),
        _decision_observation(),
        "## Arguments\n\n" + _arguments(HighwayEnv),
        "## In dm_control",
        f'`suite.load("truck", "highway")`: {_headline(suite.truck.SUITE["highway"])}',
        _body(kind),
        _observations(kind, heading="###"),
        _rewards(
            kind, "The reward is the product of these factors, each in [0, 1].", heading="###"
        ),
        "### Start\n\n" + _first(kind.initialize_episode),
    )


def _other(name: str) -> str:
    kind = OTHERS[name]
    shown = _picture(_snake(name), name) if "rgb_array" in kind.metadata["render_modes"] else ""
    return _joined(
        f"# {name}",
        _NOTE,
        shown,
        f'`gymnasium.make("iits_mj:iits_mj/{name}-v0")`',
        _body(kind),
        _table(("", ""), _registered(name)),
        _decision_observation() if issubclass(kind, DecisionEnv) else "",
        "## Arguments\n\n" + _arguments(kind),
    )


def _platoon() -> str:
    return _joined(
        "# Platoon",
        _NOTE,
        _picture("platoon", "Platoon"),
        "`iits_mj.envs.platoon.PlatoonEnv()`, after PettingZoo's parallel interface.",
        _body(PlatoonEnv),
        _actions(Platoon),
        _observations(Platoon),
        _rewards(Platoon, "An agent's reward is the product of these factors, each in [0, 1]."),
        "## Arguments\n\n" + _arguments(PlatoonEnv),
    )


def _index() -> str:
    rows = [
        (
            f"[{_env(task)}]({task}.md)",
            f"`truck`, `{task}`",
            f"`iits_mj/{_env(task)}-v0`",
            ", ".join(f"`{name}`" for name in kind.actions),
            _headline(kind),
        )
        for task, kind in DRIVING_TASKS.items()
    ]
    rows.append(
        (
            "[Highway](highway.md)",
            "`truck`, `highway`",
            "`iits_mj/Highway-v0`",
            "left, keep, right",
            _headline(HighwayEnv),
        )
    )
    rows += [
        (
            f"[{name}]({_snake(name)}.md)",
            "",
            f"`iits_mj/{name}-v0`",
            _ACTIONS[name],
            _headline(kind),
        )
        for name, kind in OTHERS.items()
        if name != "Highway"
    ]
    rows.append(
        (
            "[Platoon](platoon.md)",
            "",
            "`iits_mj.envs.platoon.PlatoonEnv`",
            ", ".join(f"`{name}`" for name in Platoon.actions),
            "Two to eight trucks, an agent each.",
        )
    )
    return _joined(
        "# Tasks and environments",
        _NOTE,
        "The same truck, tasks and rewards for dm_control and Gymnasium. "
        '`gymnasium.make("iits_mj:iits_mj/LaneKeep-v0")` imports the package and makes the '
        "environment; after `import iits_mj` the id alone is enough. In Gymnasium, an observation "
        "of a driving task (actions `drive`, `steer`) is one vector, each number divided by its "
        "scale and clipped to [-5, 5]; the pages of the other environments describe theirs.",
        _table(("", "dm_control", "Gymnasium", "actions", ""), rows),
        "Every id but `Hoel2020` has an easier and a harder level, as `iits_mj/CruiseEasy-v0` and "
        "`iits_mj/CruiseHard-v0`; each page says how they differ. `max_episode_steps` ends an "
        "episode also where `time_limit`, `duration` or `length` allow a longer one: give both to "
        "`gymnasium.make`. Scores of random, scripted and trained drivers: "
        "[benchmark](../benchmark.md).",
        "How to train on them, roll out thousands at once and put several trucks into one scene: "
        "[reinforcement learning and rollouts](../learning.md).",
    )


def _actions(kind: type[DrivingTask]) -> str:
    rows = [
        (
            "0",
            "`drive`",
            "-1",
            "1",
            "above 0 the accelerator pedal; below 0 a deceleration of up to "
            f"{kind.brake_max:g} m/s2",
            "`accelerator_pedal`; `xbr_demand`, `xbr_mode`",
        )
    ]
    if "steer" in kind.actions:
        rows.append(
            (
                "1",
                "`steer`",
                "-1",
                "1",
                f"angle of the steering wheel, left positive; 1 is {kind.steer_max:.4g} rad",
                "`steering_wheel_angle`",
            )
        )
    head = ("num", "action", "min", "max", "meaning", "control in the XML")
    return f"## Actions\n\nHeld for {kind.period:g} s each.\n\n" + _table(head, rows)


def _observations(kind: type[DrivingTask | tasks.Highway], heading: str = "##") -> str:
    rows, place = [], 0
    for name, entry in kind.observed.items():
        places = str(place) if entry.size == 1 else f"{place} to {place + entry.size - 1}"
        rows.append(
            (places, f"`{name}`", entry.meaning, entry.unit, f"{entry.scale:g}", entry.source)
        )
        place += entry.size
    head = ("num", "observation", "meaning", "unit", "scale", "from")
    return f"{heading} Observations\n\n" + _table(head, rows)


def _decision_observation() -> str:
    """Places of the 216 numbers, and the features as their module lists them."""
    rows, features = FRAME_SHAPE
    lines = [
        [cell.strip() for cell in line.strip("|").split("|")]
        for line in (observation_text or "").splitlines()
        if line.startswith("|")
    ]
    # Below the heading and its rule, in the order of the numbers.
    table = [
        (str(place), f"`{FEATURES[place]}`", *line[1:]) for place, line in enumerate(lines[2:])
    ]
    ages = ", ".join(f"{age:g}" for age in FRAME_AGES)
    names = ", ".join(f"{place} `{name}`" for place, name in enumerate(ROWS))
    return (
        "## Observations\n\n"
        f"Number {rows * features} x frame + {features} x row + feature. Frames: those of {ages} s "
        f"ago. Rows: {names}; a row is zero where there is no vehicle. Features, each divided by "
        "its scale and clipped to [-1, 1]:\n\n"
        + _table(("feature", "name", "the truck's row", "other rows", "scale"), table)
    )


def _rewards(kind: type[DrivingTask | tasks.Highway], text: str, heading: str = "##") -> str:
    rows = [(f"`{name}`", meaning) for name, meaning in kind.terms.items()]
    return f"{heading} Rewards\n\n{text}\n\n" + _table(("factor", "1 where"), rows)


def _end(kind: type[DrivingTask]) -> str:
    own = inspect.getdoc(kind.get_termination) if "get_termination" in _own_names(kind) else None
    if own is None:
        return "Truncated at the time limit; there is no other end."
    return f"Truncated at the time limit. Terminated: {own[0].lower()}{own[1:]}"


def _own_names(kind: type[DrivingTask]) -> set[str]:
    """Names that this package's classes define, not dm_control's."""
    return {
        name
        for base in kind.__mro__
        if base.__module__.startswith("iits_mj")
        for name in vars(base)
    }


def _registered(name: str) -> list[tuple[str, str]]:
    """Rows about the registration of an environment and of its levels."""
    settings = ENVIRONMENTS[f"iits_mj/{name}-v0"]
    levels = []
    for level, arguments in LEVELS[f"iits_mj/{name}-v0"].items():
        words = (f"{key} {_value(value)}" for key, value in arguments.items())
        levels.append(f"`iits_mj/{name}{level}-v0`: {', '.join(words)}")
    return [
        ("`max_episode_steps`", f"{settings['max_episode_steps']}"),
        ("`reward_threshold`", f"{settings['reward_threshold']:g}"),
        ("other levels", "; ".join(levels) or "none"),
    ]


def _value(value: object) -> str:
    return " or ".join(value) if isinstance(value, tuple) else f"{value}"


def _picture(stem: str, title: str) -> str:
    return f"![{title}](images/{stem}.png)"


def _headline(thing: object) -> str:
    return (inspect.getdoc(thing) or "").splitlines()[0]


def _first(thing: object) -> str:
    return (inspect.getdoc(thing) or "").split("\n\n")[0].replace("\n", " ")


def _body(kind: type) -> str:
    return _unwrapped(_parts(kind)[0])


def _parts(kind: type) -> tuple[str, str]:
    """A docstring before and after its first section."""
    text = inspect.getdoc(kind) or ""
    match = re.search(r"^(Args|Attributes|Raises):$", text, re.MULTILINE)
    return (text, "") if match is None else (text[: match.start()].strip(), text[match.start() :])


def _unwrapped(text: str) -> str:
    """Paragraphs on one line each; tables and code unchanged."""
    blocks = []
    for block in text.split("\n\n"):
        kept = block.lstrip().startswith("|") or block.startswith("    ")
        blocks.append(block if kept else " ".join(line.strip() for line in block.splitlines()))
    return "\n\n".join(blocks)


def _arguments(kind: type, skip: Iterable[str] = ()) -> str:
    section = re.search(r"Args:\n(.*?)(\n\n|\Z)", _parts(kind)[1], re.DOTALL)
    if section is None:
        return "None."
    entries = re.findall(r"^  (\w+): (.*(?:\n    .*)*)", section[1], re.MULTILINE)
    defaults = inspect.signature(kind).parameters
    rows = [
        (f"`{name}`", f"`{_shown(defaults[name].default)}`", " ".join(text.split()))
        for name, text in entries
        if name not in set(skip)
    ]
    return _table(("name", "default", "meaning"), rows)


def _shown(default: object) -> str:
    return f"{default:.6g}" if isinstance(default, float) else repr(default)


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = [f"| {' | '.join(head)} |", "|" + "---|" * len(head)]
    return "\n".join([*lines, *(f"| {' | '.join(row)} |" for row in rows)])


def _env(task: str) -> str:
    """Name of a task's environment in Gymnasium."""
    return task.title().replace("_", "")


def _snake(name: str) -> str:
    return re.sub(r"(?<!^)(?=[A-Z])", "_", name).lower()


def _joined(*parts: str) -> str:
    return "\n\n".join(part for part in parts if part) + "\n"


def main() -> None:
    """Writes the pages."""
    FOLDER.mkdir(parents=True, exist_ok=True)
    for name, page in pages().items():
        (FOLDER / name).write_text(page, encoding="utf-8")


if __name__ == "__main__":
    main()
