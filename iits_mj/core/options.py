"""Options as fields of a frozen dataclass, with the same checks in Python and on the command line.

A field made by `option` carries its help, unit, bounds and choices. `check` compares an instance
with them, and `iits_mj.commands.arguments` turns the same fields into flags.
"""

from __future__ import annotations

import dataclasses
import math
import os
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from numbers import Integral, Real
from pathlib import Path
from typing import Any

from iits_mj.core.checks import one_of
from iits_mj.core.errors import InputError
from iits_mj.core.own_parts import FILES, FORMS, Kind, part_name
from iits_mj.core.timing import PLANTS, TIMESTEP

_KEY = "iits_mj.option"
_GIVEN = "iits_mj.given"
# Subjects of options and their titles, in the order of the help.
GROUPS = {
    "truck": "truck",
    "road": "road and start",
    "traffic": "traffic",
    "decision": "decisions and speed",
    "bus": "CAN bus",
    "data": "data",
    "view": "what is shown, and where",
    "learning": "learning",
    "run": "run",
    "output": "output",
    "": "other options",
    "general": "configuration and messages",
}
# Types of fields that hold a file or a folder, as they are written.
_FILES = ("Path", "Path | None")
# Type of the default, type that a value must have, and its name; in Python a bool is an int.
_KINDS = (
    (bool, bool, "on or off, True or False"),
    (int, Integral, "a whole number"),
    (float, Real, "a number"),
    (str, str, "text"),
)


@dataclass(frozen=True, slots=True)
class Option:
    """Help and allowed values of a field.

    Attributes:
      help: one sentence; unit: "" for a number without one.
      low, high: inclusive bounds, or None; choices: allowed values, or a function that lists them.
      names: lists the values that are shipped, for the help; others may be allowed.
      test: raises InputError for a value that is not allowed; it also checks the type.
      label: a value as a word of the command line.
      metavar: placeholder of the value in the help text.
      files: what matches the relative paths in a text that is not a path as a whole.
      positional: True for an argument without a flag.
      group: subject under which the help shows the flag, one of `GROUPS`; "" for none.
    """

    help: str
    unit: str = ""
    low: float | None = None
    high: float | None = None
    choices: Sequence[str] | Callable[[], Sequence[str]] | None = None
    names: Callable[[], Sequence[str]] | None = None
    test: Callable[[Any], object] | None = None
    label: Callable[[Any], str] = str
    metavar: str | None = None
    files: re.Pattern[str] | None = None
    positional: bool = False
    group: str = ""

    def allowed(self) -> Sequence[str] | None:
        """The choices; None when every value of the type is allowed."""
        return self.choices() if callable(self.choices) else self.choices

    def text(self, value: Any) -> str:
        """A value in words, with its unit."""
        if isinstance(value, bool):
            return "yes" if value else "no"
        if isinstance(value, tuple):
            texts = value and isinstance(value[0], str)
            return (", " if texts else "x").join(str(part) for part in value)
        shown = f"{value:.6g}" if isinstance(value, float) else self.label(value)
        return f"{shown} {self.unit}".strip()

    def bounds(self) -> str:
        """The allowed range in words, "" when there is none."""
        unit = f" {self.unit}" if self.unit else ""
        low, high = (None if v is None else _plain(v) for v in (self.low, self.high))
        if low is not None and high is not None:
            return f"{low} to {high}{unit}"
        if low is not None:
            return f"{low}{unit} or more"
        return f"{high}{unit} or less" if high is not None else ""


def _plain(value: float) -> str:
    """A number without an exponent where it is whole."""
    return str(int(value)) if float(value).is_integer() else f"{value:g}"


def option(default: Any = dataclasses.MISSING, **settings: Any) -> Any:
    """Returns a dataclass field with an `Option`, whose attributes are the settings."""
    metadata = {_KEY: Option(**settings)}
    if default is dataclasses.MISSING:
        return dataclasses.field(metadata=metadata)
    return dataclasses.field(default=default, metadata=metadata)


def plant_option() -> Any:
    """Returns a dataclass field for the model of the truck's motion."""
    return option(
        "full",
        help="model of the truck's motion; full: MuJoCo's bodies; yaw-roll: planar motion and the "
        "roll of each unit; yaw-sideslip: planar motion; kinematic: planar motion, without slip; "
        "the planar ones take less time",
        choices=PLANTS,
        group="truck",
    )


def timestep_option(default: float | None = TIMESTEP, more: str = "") -> Any:
    """Returns a dataclass field for the time step of the physics; `more` ends its help."""
    text = f"time step of the physics{more}"
    return option(default, help=text, unit="s", low=0.0005, high=0.005, group="run")


def jobs_option(default: int = 1, help: str = "number of processes on this machine") -> Any:
    """Returns a dataclass field for the number of processes."""
    return option(default, help=help, low=1, high=256, group="run")


def part_option(default: str | None, kind: Kind, help: str, group: str = "decision") -> Any:
    """Returns a dataclass field for a part that a user may replace by an own one."""
    return option(
        default,
        help=f"{help}; or your own as {FORMS}",
        names=lambda: kind.shipped,
        test=kind.check,
        label=part_name,
        metavar="NAME",
        files=FILES,
        group=group,
    )


def given_names() -> Any:
    """A dataclass field of type `frozenset[str]`: names of the options that the user gave.

    It distinguishes an option that was given with its default value from one that was not given. It
    is empty when the dataclass is made in Python.
    """
    return dataclasses.field(
        default=frozenset(), compare=False, repr=False, metadata={_GIVEN: True}
    )


def holders_of_given(kind: type[Any]) -> list[str]:
    """Names of the fields of a dataclass that were made by `given_names`."""
    return [field.name for field in dataclasses.fields(kind) if _GIVEN in field.metadata]


def given_in(config: Any) -> frozenset[str]:
    """Names of the options that the user gave; none if the dataclass does not know."""
    holders = holders_of_given(type(config))
    return frozenset(name for holder in holders for name in getattr(config, holder))


def of(field: dataclasses.Field[Any]) -> Option | None:
    """The `Option` of a dataclass field; None when it has none."""
    return field.metadata.get(_KEY)


def words(config: Any) -> list[str]:
    """The words of a command line that gives these options.

    Options that were not given and have their default are left out. A truck that is not named, but
    given as parameters, appears by its name.
    """
    given = given_in(config)
    flags: list[str] = []
    positional: list[str] = []
    for field in dataclasses.fields(config):
        rule, value = of(field), getattr(config, field.name)
        if rule is None or value is None or (value == field.default and field.name not in given):
            continue
        flag = f"--{field.name.replace('_', '-')}"
        if rule.positional:
            positional += map(str, value if isinstance(value, tuple) else (value,))
        elif isinstance(value, bool):
            flags.append(flag if value else f"--no-{flag[2:]}")
        elif isinstance(value, tuple) and value and isinstance(value[0], str):
            flags += [word for part in value for word in (flag, part)]
        elif isinstance(value, tuple):
            flags += [flag, "x".join(map(str, value))]
        elif isinstance(value, float):
            flags += [flag, repr(value).removesuffix(".0")]
        else:
            flags += [flag, rule.label(value)]
    return positional + flags


def check(config: Any) -> None:
    """Checks every option of a dataclass instance for its type, bounds and choices.

    A file may be given as text; it becomes a `Path`.

    Raises:
      InputError: names the first value that is not allowed, and the allowed values.
    """
    for field in dataclasses.fields(config):
        rule = of(field)
        if rule is not None:
            name, value = field.name.replace("_", "-"), getattr(config, field.name)
            if field.type in _FILES and value is not None:
                value = _path(name, value)
                object.__setattr__(config, field.name, value)
            if rule.test is None:
                _check_kind(name, value, field.default)
            check_value(name, value, rule)


def _path(name: str, value: Any) -> Path:
    if not isinstance(value, (str, os.PathLike)) or not os.fspath(value):
        raise InputError(f"{name} {value!r} is not a file or folder; use a path or its text")
    return Path(value)


def _check_kind(name: str, value: Any, default: Any) -> None:
    for kind, wanted, what in _KINDS:
        if isinstance(default, kind):
            if not isinstance(value, wanted) or isinstance(value, bool) is not (kind is bool):
                raise InputError(f"{name} {value!r} is not {what}")
            return


def check_value(name: str, value: Any, rule: Option) -> None:
    """Checks one value; raises InputError outside the rule's bounds or choices."""
    if value is None or isinstance(value, bool):
        return
    if rule.test is not None:
        rule.test(value)
    allowed = rule.allowed()
    if allowed is not None:
        one_of(name, value, allowed)
    if not isinstance(value, Real):
        if rule.low is not None or rule.high is not None:
            raise InputError(f"{name} {value!r} is not a number")
        return
    try:
        number = float(value)
    except OverflowError:
        number = math.inf
    if not math.isfinite(number):
        raise InputError(f"{name} {value!r} is not a finite number")
    below = rule.low is not None and number < rule.low
    above = rule.high is not None and number > rule.high
    if below or above:
        raise InputError(f"{name} {value:g} is not allowed; use {rule.bounds()}")
