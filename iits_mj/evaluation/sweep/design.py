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
from iits_mj.core.options import jobs_option, option
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
# Names and texts of the values at one point, and of sets of values, one of which is chosen.
Point = tuple[tuple[str, str], ...]
Choices = tuple[tuple[dict[str, str], ...], ...]
_FIELDS = {f.name: f for f in dataclasses.fields(DriveConfig)}
_SWEPT = [name for name in _FIELDS if name not in ("param", "scenario", "events")]


@dataclass(frozen=True)
class Axis:
    """Values of a parameter or an option in a sweep.

    Attributes:
      name: of it; values: texts, empty for a range without a number of values.
      ends: of a range, () for a list.
    """

    name: str
    values: tuple[str, ...]
    ends: tuple[float, ...] = ()

    def at(self, share: float) -> str:
        """The value at a share of the range, or of the list."""
        if self.ends:
            return number_text(self.ends[0] + (self.ends[1] - self.ends[0]) * share)
        return self.values[int(share * len(self.values))]


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
    parts, what = text.split(":"), f"param {name} = {shown(text)}"
    # Other values with colons are texts, such as the class of a file.
    if not any(_is_number(part) for part in parts[:2]) or len(parts) == 1:
        values = [part.strip() for part in text.split(",")]
        if "" in values or len(set(values)) < len(values):
            raise InputError(f"{what}: a value is empty or there twice")
        return Axis(name, tuple(values))
    numbers = all(_is_number(part) for part in parts) and all(
        part.strip("-").isdecimal() for part in parts[2:]
    )
    if not numbers or len(parts) > 3:
        raise InputError(f"{what}: use LOW:HIGH:COUNT, LOW:HIGH or A,B,C")
    low, high = float(parts[0]), float(parts[1])
    if low >= high:
        raise InputError(f"{what}: the lower end must be below the upper one")
    axis = Axis(name, (), (low, high))
    if len(parts) == 2:
        return axis
    if not 2 <= (count := int(parts[2])) <= COUNT_MAX:
        raise InputError(f"{what}: {count} values; use 2 to {COUNT_MAX}")
    return dataclasses.replace(axis, values=tuple(axis.at(k / (count - 1)) for k in range(count)))


def _is_number(text: str) -> bool:
    try:
        return math.isfinite(float(text))
    except ValueError:
        return False


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
        "deterministic or stochastic distribution of parameters",
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
        1.5, "s", "time to collision below this (van der Horst and Hogema, 1993)"
    )
    near_drac: float = _near(
        3.4,
        "m/s2",
        "deceleration rate to avoid a crash above this, which is comfortable for most "
        "drivers (AASHTO, Green Book, 2018)",
    )
    near_deceleration: float = _near(
        3.5,
        "m/s2",
        "deceleration of the truck above this, the limit of adaptive cruise controls "
        "(ISO 15622:2018)",
    )
    near_pet: float | None = _near(
        None,
        "s",
        "post-encroachment time below this, for crossing road users, as 1 s (Peesapati "
        "et al., 2013); without it not used",
    )
    jobs: int = jobs_option()

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
      swept: the swept parameters and options, as parameters; axes: their values.
      choices: of a grid, sets of values of which one is chosen.
    """

    base: Drive
    parameters: Mapping[str, Parameter]
    swept: Mapping[str, Parameter]
    axes: tuple[Axis, ...]
    choices: Choices

    @classmethod
    def of(cls, config: SweepConfig) -> Sweep:
        """Returns the sweep of a configuration.

        Raises:
          InputError: the scenario cannot be read, a name is unknown, or a value is not allowed.
        """
        path, plain = config.scenario, config.samples is None and config.adaptive is None
        choices: Choices = ()
        given = config.given & set(_FIELDS) - {"param", "scenario"}
        values = {name: getattr(config, name) for name in _FIELDS if name != "param"}
        if path.suffix == ".xosc":
            if (found := read_distribution(path)) is not None:
                path, choices = found.scenario, found.choices
                if not plain:
                    raise InputError(f"{config.scenario} names its points: give no other design")
            parameters, values["scenario"] = declared_parameters(path), path
            read_scenario(path, config.ego)
        elif config.events is not None:
            raise InputError(f"{path} is a file of events: leave --events out")
        else:
            parameters = read_parameters(path)
            read_events(path)
            values |= {"scenario": None, "events": path}
            given |= {"events"}
        base, swept, axes = Drive(**values, given=given), {}, []
        for axis in axes_of(config.param):
            name = axis.name if axis.name in parameters else axis.name.replace("-", "_")
            if any(name in each for sets in choices for each in sets):
                raise InputError(f"param {name}: {config.scenario} has its values")
            if name not in parameters and name in given:
                raise InputError(f"param {axis.name}: --{axis.name} is given, too")
            if plain and not axis.values:
                text = f"{name}={':'.join(map(number_text, axis.ends))}"
                raise InputError(f"param {text}: a grid needs a number of values: {text}:12")
            axes.append(dataclasses.replace(axis, name=name))
        ends = (tuple({a.name: text} for text in a.values or (a.at(0.0), a.at(1.0))) for a in axes)
        choices = (*choices, *ends)
        for name, text in (pair for sets in choices for each in sets for pair in each.items()):
            if name not in swept:
                swept[name] = parameters.get(name) or _option(name, parameters)
            _parsed(swept[name], text, name in parameters)
        if not choices:
            has = ", ".join(parameters) or "none"
            raise InputError(f"nothing is swept: give --param NAME=VALUES; {path} has {has}")
        return cls(base, parameters, swept, tuple(axes), choices)

    def label(self, name: str) -> str:
        """A name with its unit, for pictures."""
        return f"{name} [{self.swept[name].unit}]" if self.swept[name].unit else name

    def grid(self) -> list[Point]:
        """The points of the grid, the last parameter changing first; InputError for too many."""
        if (count := math.prod(map(len, self.choices))) > RUNS_MAX:
            raise InputError(f"the grid has {count} points: at most {RUNS_MAX} are allowed")
        return [
            tuple(pair for part in parts for pair in part.items())
            for parts in itertools.product(*self.choices)
        ]

    def sample(self, count: int, seed: int) -> list[Point]:
        """A Latin hypercube: each of `count` equal parts of every range has one point.

        M. D. McKay, R. J. Beckman and W. J. Conover, Technometrics 21(2), 1979.
        """
        rng, columns = np.random.default_rng(seed), []
        for axis in self.axes:
            shares = (rng.permutation(count) + rng.random(count)) / count
            texts = [axis.at(share) for share in shares.tolist()]
            if axis.ends and isinstance(self.swept[axis.name].default, int):
                texts = [number_text(round(float(text))) for text in texts]
            columns.append([(axis.name, text) for text in texts])
        return list(zip(*columns, strict=True))

    def continuous(self) -> tuple[Axis, ...]:
        """The axes of an adaptive design; InputError for a list or for whole numbers."""
        axes = tuple(axis for axis in self.axes if len(axis.values) != 1)
        for axis in axes:
            if not axis.ends or isinstance(self.swept[axis.name].default, int):
                raise InputError(f"param {axis.name}: adaptive needs a range of real numbers")
        if not axes:
            raise InputError("adaptive needs a range: give --param NAME=LOW:HIGH")
        return axes

    def asked(self, point: Point) -> Drive:
        """The options that give the drive of a point; InputError if they are not allowed."""
        own = tuple(f"{name}={text}" for name, text in point if name in self.parameters)
        others = {n: _parsed(self.swept[n], t, False) for n, t in point if n not in self.parameters}
        given = self.base.given | set(others) | ({"param"} if own else set())
        return dataclasses.replace(self.base, param=own, given=given, **others)

    def command(self, point: Point) -> str:
        """The command line that repeats the drive of a point."""
        words = ["iits-mj", "drive", *options.words(self.base)]
        for name, text in point:
            flag = name.replace("_", "-")
            if name in self.parameters:
                words += ["--param", f"{name}={text}"]
            elif isinstance(self.swept[name].default, bool):
                words.append(f"--{flag}" if text == "true" else f"--no-{flag}")
            else:
                words += [f"--{flag}", text]
        return shlex.join(words)

    def identity(self) -> dict[str, str]:
        """What the drives depend on besides their points, as text by name.

        Raises:
          InputError: a file cannot be read.
        """
        left = set(self.swept) - set(self.parameters)
        found = {n: str(v) for n, v in stored_options(self.base).items() if n not in left}
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


def _option(name: str, parameters: Mapping[str, Parameter]) -> Parameter:
    """An option of a drive as a parameter."""
    if name not in _SWEPT:
        has = f"has the parameters {', '.join(parameters)}" if parameters else "has no parameters"
        near = did_you_mean(name, (*parameters, *_SWEPT))
        raise InputError(
            f"param {name}: neither a parameter of the scenario nor an option{near}; it {has}"
        )
    rule, hint = options.of(_FIELDS[name]), get_type_hints(DriveConfig)[name]
    kinds = get_args(hint) or (hint,)
    default = next((kind() for kind in (bool, float, int) if kind in kinds), "")
    return Parameter(name, default, rule.unit if rule is not None else "")


def _parsed(parameter: Parameter, text: str, own: bool) -> Any:
    """A value; one of an option (not `own`) is checked with its rule, and may be a path."""
    name, value = parameter.name, parameter.parse(text)
    if own:
        return value
    if (rule := options.of(_FIELDS[name])) is not None:
        options.check_value(name.replace("_", "-"), value, rule)
    is_path = Path in get_args(get_type_hints(DriveConfig)[name]) and name != "truck"
    return Path(text) if is_path else value
