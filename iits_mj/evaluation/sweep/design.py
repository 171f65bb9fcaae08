"""Settings of a sweep: the scenario, the values of its parameters, and the points to drive."""

from __future__ import annotations

import dataclasses
import hashlib
import itertools
import math
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_args, get_type_hints

import numpy as np

from iits_mj.core import options
from iits_mj.core.checks import did_you_mean, shown
from iits_mj.core.errors import InputError
from iits_mj.core.options import option
from iits_mj.core.own_parts import source_digest
from iits_mj.parameters import check_truck
from iits_mj.simulation import DriveConfig
from iits_mj.simulation.config import PARTS
from iits_mj.simulation.drive_log import stored_options
from traffic_bridge.scenario.openscenario import read_scenario
from traffic_bridge.scenario.openscenario_parameters import declared_parameters, read_distribution
from traffic_bridge.scenario.parameters import Parameter, assignments
from traffic_bridge.scenario.reading import read_events, read_parameters

COUNT_MAX, RUNS_MAX = 10_000, 100_000
# Names and texts of the values at one point.
Point = tuple[tuple[str, str], ...]
_NOT_SWEPT = ("param", "scenario", "events")
_FIELDS = {field.name: field for field in dataclasses.fields(DriveConfig)}


@dataclass(frozen=True)
class Axis:
    """Values of a parameter or an option in a sweep.

    Attributes:
      name: of it; values: texts, empty for a range without a number of values.
      low, high: ends of a range, nan for a list.
    """

    name: str
    values: tuple[str, ...]
    low: float = math.nan
    high: float = math.nan

    @property
    def is_range(self) -> bool:
        """Whether it is a range of numbers."""
        return math.isfinite(self.low)

    def at(self, share: float) -> str:
        """The value at a share of the range, or of the list."""
        if self.is_range:
            return number_text(self.low + (self.high - self.low) * share)
        return self.values[min(int(share * len(self.values)), len(self.values) - 1)]


def number_text(value: float) -> str:
    """A number with the digits that the files, the commands and the drives of a sweep have."""
    return f"{value:.10g}"


def axes_of(texts: Sequence[str]) -> tuple[Axis, ...]:
    """Returns the axes of `NAME=LOW:HIGH:COUNT`, `NAME=LOW:HIGH` and `NAME=A,B,C`.

    Raises:
      InputError: a text has another form, a name or a value is there twice, or a range is empty.
    """
    return tuple(_axis(name, text) for name, text in assignments(texts).items())


def _axis(name: str, text: str) -> Axis:
    parts = text.split(":")
    try:
        first = float(parts[0])
    except ValueError:
        first = math.nan  # a text, as the file of an own part
    if len(parts) == 1 or (math.isnan(first) and parts[0].lower() != "nan"):
        values = [part.strip() for part in text.split(",")]
        if "" in values:
            raise InputError(f"param {name} = {shown(text)}: a value is empty")
        if twice := [value for value in values if values.count(value) > 1]:
            raise InputError(f"param {name}: the value {twice[0]} is there twice")
        return Axis(name, tuple(values))
    wrong = InputError(f"param {name} = {shown(text)}: use LOW:HIGH:COUNT, LOW:HIGH or A,B,C")
    try:
        low, high = float(parts[0]), float(parts[1])
        count = int(parts[2]) if len(parts) == 3 else 0
    except ValueError:
        raise wrong from None
    if len(parts) > 3 or not math.isfinite(low) or not math.isfinite(high):
        raise wrong
    if low >= high:
        raise InputError(f"param {name} = {shown(text)}: the lower end must be below the upper one")
    if len(parts) == 3 and not 2 <= count <= COUNT_MAX:
        raise InputError(f"param {name} = {shown(text)}: {count} values; use 2 to {COUNT_MAX}")
    axis = Axis(name, (), low, high)
    return dataclasses.replace(axis, values=tuple(axis.at(k / (count - 1)) for k in range(count)))


@dataclass(frozen=True, kw_only=True)
class Drive(DriveConfig):
    """A drive of a sweep."""

    given: frozenset[str] = options.given_names()


def _near(default: float | None, unit: str, help: str) -> Any:
    return option(default, help=help, unit=unit, low=0.0, high=100.0, group="data")


@dataclass(frozen=True, kw_only=True)
class SweepConfig(DriveConfig):
    """A scenario, the values of its parameters, and what counts as a near miss."""

    scenario: Path = option(
        help="file of events (.toml), OpenSCENARIO file (.xosc), or OpenSCENARIO file of a "
        "deterministic distribution of parameters",
        metavar="SCENARIO",
        positional=True,
    )
    param: tuple[str, ...] = option(
        (),
        help="values of a parameter of the scenario or of an option of a drive: LOW:HIGH:COUNT, "
        "LOW:HIGH (of a sample) or A,B,C; may be given for several",
        test=axes_of,
        metavar="NAME=VALUES",
        group="traffic",
    )
    samples: int | None = option(
        None,
        help="drive a Latin hypercube of this many points instead of the grid",
        low=1,
        high=RUNS_MAX,
        group="run",
    )
    adaptive: int | None = option(
        None,
        help="drive at most this many points, which locate the boundaries between the outcomes",
        low=2,
        high=RUNS_MAX,
        group="run",
    )
    near_ttc: float = _near(
        1.5, "s", "near miss: time to collision below this (van der Horst and Hogema, 1993)"
    )
    near_drac: float = _near(
        3.4,
        "m/s2",
        "near miss: deceleration rate to avoid a crash above this, which is comfortable for most "
        "drivers (AASHTO, Green Book, 2018)",
    )
    near_deceleration: float = _near(
        3.5,
        "m/s2",
        "near miss: deceleration of the truck above this, the limit of adaptive cruise controls "
        "(ISO 15622:2018)",
    )
    near_pet: float | None = _near(
        None,
        "s",
        "near miss: post-encroachment time below this, for crossing road users, as 1 s (Peesapati "
        "et al., 2013); without it not used",
    )
    jobs: int = option(1, help="number of processes on this machine", low=1, high=256, group="run")

    given: frozenset[str] = options.given_names()

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.samples is not None and self.adaptive is not None:
            raise InputError("samples and adaptive are two designs: give one of them")


@dataclass(frozen=True)
class Sweep:
    """A checked sweep.

    Attributes:
      base: the drive without the swept values; parameters: of the scenario.
      axes: swept parameters and options; choices: of the grid, sets of values of which one is
        chosen, see `Distribution`.
    """

    base: Drive
    parameters: Mapping[str, Parameter]
    axes: tuple[Axis, ...]
    choices: tuple[tuple[dict[str, str], ...], ...]

    @classmethod
    def of(cls, config: SweepConfig) -> Sweep:
        """Returns the sweep of a configuration.

        Raises:
          InputError: the scenario cannot be read, a name is unknown, or a value is not allowed.
        """
        path = config.scenario
        choices: tuple[tuple[dict[str, str], ...], ...] = ()
        given = config.given & set(_FIELDS) - {"param", "scenario"}
        values = {name: getattr(config, name) for name in _FIELDS if name not in ("param", "given")}
        if path.suffix == ".xosc":
            if (found := read_distribution(path)) is not None:
                path, choices = found.scenario, found.choices
                if config.samples is not None or config.adaptive is not None:
                    raise InputError(f"{config.scenario} names its points: give no other design")
            parameters = declared_parameters(path)
            values["scenario"] = path
            read_scenario(path, config.ego)
        else:
            if config.events is not None:
                raise InputError(f"{path} is a file of events: leave --events out")
            parameters = read_parameters(path)
            read_events(path)
            values |= {"scenario": None, "events": path}
            given |= {"events"}
        base = Drive(**values, given=given)
        axes = tuple(_known(axis, parameters, base) for axis in axes_of(config.param))
        for name, text in (pair for sets in choices for each in sets for pair in each.items()):
            if name in (axis.name for axis in axes):
                raise InputError(f"param {name}: {config.scenario} has its values")
            _check_value(name, text, parameters)
        if not axes and not choices:
            has = ", ".join(parameters) or "none"
            raise InputError(f"nothing is swept: give --param NAME=VALUES; {path} has {has}")
        plain = config.samples is None and config.adaptive is None
        for axis in axes:
            if plain and not axis.values:
                text = f"{axis.name}={axis.low:g}:{axis.high:g}"
                raise InputError(f"param {text}: a grid needs a number of values: {text}:12")
        return cls(base, parameters, axes, (*choices, *(_chosen(axis) for axis in axes)))

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the swept values, in the order of points."""
        return tuple(dict.fromkeys(name for sets in self.choices for each in sets for name in each))

    def label(self, name: str) -> str:
        """A name with its unit, for pictures."""
        if name in self.parameters:
            unit = self.parameters[name].unit
        else:
            rule = options.of(_FIELDS[name])
            unit = "" if rule is None else rule.unit
        return f"{name} [{unit}]" if unit else name

    def grid(self) -> list[Point]:
        """The points of the grid, the last parameter changing first.

        Raises:
          InputError: there are too many.
        """
        count = math.prod(map(len, self.choices))
        if count > RUNS_MAX:
            raise InputError(f"the grid has {count} points: at most {RUNS_MAX} are allowed")
        return [
            tuple(pair for part in parts for pair in part.items())
            for parts in itertools.product(*self.choices)
        ]

    def sample(self, count: int, seed: int) -> list[Point]:
        """A Latin hypercube: each of `count` equal parts of every range has one point.

        M. D. McKay, R. J. Beckman and W. J. Conover, Technometrics 21(2), 1979.
        """
        rng = np.random.default_rng(seed)
        columns = []
        for axis in self.axes:
            shares = (rng.permutation(count) + rng.random(count)) / count
            texts = [axis.at(share) for share in shares.tolist()]
            if axis.is_range and isinstance(self._default(axis.name), int):
                texts = [number_text(round(float(text))) for text in texts]
            columns.append([(axis.name, text) for text in texts])
        return list(zip(*columns, strict=True))

    def _default(self, name: str) -> Any:
        parameter = self.parameters.get(name)
        return parameter.default if parameter is not None else _FIELDS[name].default

    def continuous(self) -> tuple[Axis, ...]:
        """The axes of an adaptive design.

        Raises:
          InputError: an axis is a list, or has only whole values.
        """
        axes = tuple(axis for axis in self.axes if len(axis.values) != 1)
        for axis in axes:
            if not axis.is_range or isinstance(self._default(axis.name), int):
                raise InputError(f"param {axis.name}: adaptive needs a range of real numbers")
        if not axes:
            raise InputError("adaptive needs a range: give --param NAME=LOW:HIGH")
        return axes

    def asked(self, point: Point) -> Drive:
        """The options that give the drive of a point.

        Raises:
          InputError: an option does not have such a value.
        """
        own = tuple(f"{name}={text}" for name, text in point if name in self.parameters)
        others = {n: option_value(n, text) for n, text in point if n not in self.parameters}
        given = self.base.given | set(others) | ({"param"} if own else set())
        return dataclasses.replace(self.base, param=own, given=given, **others)

    def command(self, point: Point) -> str:
        """The command line that repeats the drive of a point."""
        words = ["iits-mj", "drive", *options.words(self.base)]
        for name, text in point:
            flag = name.replace("_", "-")
            if name in self.parameters:
                words += ["--param", f"{name}={text}"]
            elif text in ("true", "false"):
                words.append(f"--{flag}" if text == "true" else f"--no-{flag}")
            else:
                words += [f"--{flag}", text]
        return shlex.join(words)

    def identity(self) -> dict[str, str]:
        """What the drives depend on besides their points, as text by name.

        Raises:
          InputError: a file cannot be read.
        """
        swept = {axis.name for axis in self.axes} - set(self.parameters)
        found = {n: str(v) for n, v in stored_options(self.base).items() if n not in swept}
        files = {n: v for n in _FIELDS if isinstance(v := getattr(self.base, n), Path)}
        if self.base.scenario is not None:
            used = read_scenario(self.base.scenario, self.base.ego).files
            files |= {f"{path.name} of the scenario": path for path in used}
        for name, path in files.items():
            try:
                digest = hashlib.sha256(path.read_bytes()).hexdigest()
            except OSError as error:
                raise InputError(f"{str(path)!r} cannot be read: {error.strerror}") from error
            found[name] = f"{path.name}, SHA-256 {digest[:12]}"
        for name in found.keys() & PARTS.keys():
            if digest := source_digest(getattr(self.base, name)):
                found[name] += f", SHA-256 {digest}"
        if "truck" in found:
            found["truck"] += f", {check_truck(self.base).digest()[:12]}"
        return found


def _chosen(axis: Axis) -> tuple[dict[str, str], ...]:
    return tuple({axis.name: value} for value in axis.values or (axis.at(0.0), axis.at(1.0)))


def _known(axis: Axis, parameters: Mapping[str, Parameter], base: Drive) -> Axis:
    """The axis with the name of a parameter or of an option, whose values are checked."""
    name = axis.name if axis.name in parameters else axis.name.replace("-", "_")
    allowed = [*parameters, *(n for n in _FIELDS if n not in _NOT_SWEPT)]
    if name not in allowed:
        has = f"has the parameters {', '.join(parameters)}" if parameters else "has no parameters"
        near = did_you_mean(name, allowed)
        raise InputError(
            f"param {axis.name}: neither a parameter of the scenario nor an option{near}; it {has}"
        )
    if name not in parameters and name in base.given:
        raise InputError(f"param {axis.name}: --{axis.name.replace('_', '-')} is given, too")
    for value in axis.values or (axis.at(0.0), axis.at(1.0)):
        _check_value(name, value, parameters)
    return dataclasses.replace(axis, name=name)


def _check_value(name: str, text: str, parameters: Mapping[str, Parameter]) -> None:
    if name in parameters:
        parameters[name].parse(text)
    elif name in _FIELDS and name not in _NOT_SWEPT:
        option_value(name, text)
    else:
        raise InputError(f"parameter {name!r} is not declared{did_you_mean(name, parameters)}")


def option_value(name: str, text: str) -> Any:
    """Returns the value of an option of a drive.

    Raises:
      InputError: it is of another kind, or not allowed.
    """
    rule, hint = options.of(_FIELDS[name]), get_type_hints(DriveConfig)[name]
    kinds = get_args(hint) or (hint,)
    value: Any = text
    if bool in kinds:
        value = {"true": True, "false": False}.get(text)
        if value is None:
            raise InputError(f"param {name} = {shown(text)}: use true or false")
    elif int in kinds or float in kinds:
        value = Parameter(f"param {name}", 0.0 if float in kinds else 0).parse(text)
    elif Path in kinds and name != "truck":
        value = Path(text)
    if rule is not None:
        options.check_value(name.replace("_", "-"), value, rule)
    return value
