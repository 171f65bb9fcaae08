"""Parameters that OpenSCENARIO files declare, and files with their distributions."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from iits_mj.core.errors import InputError
from traffic_bridge.scenario.openscenario_file import Node, number_or_text, read_root
from traffic_bridge.scenario.parameters import RULES, Parameter, Value

WHOLE_TYPES = ("int", "integer", "unsignedInt", "unsignedShort")
REDRAWN = 1000  # times that a distribution is drawn for values within its range
VALUES_MAX = 10_000  # of one distribution
# A range reaches its upper limit in spite of rounding.
_ROUNDING = 1e-9


class Distribution(NamedTuple):
    """Values of the parameters of a scenario, as text by name.

    Attributes:
      scenario: its file.
      choices: for each distribution the sets of values, one of which is chosen.
    """

    scenario: Path
    choices: tuple[tuple[dict[str, str], ...], ...]


def parameters_of(root: Node) -> dict[str, Parameter]:
    """Returns the parameters that a scenario declares, by name.

    Raises:
      InputError: a declaration is not complete, or its value is not of its type or limits.
    """
    found: dict[str, Parameter] = {}
    scope = root.scoped().scope
    for node in root.find("ParameterDeclarations") or ():
        name, kind = node.declared, node.get("parameterType", node.get("type", "string"))
        limits = tuple(
            tuple(_limit(each) for each in group.only("ValueConstraint"))
            for group in node.only("ConstraintGroup")
        )
        default: Value = scope[name]
        if kind in ("double", *WHOLE_TYPES):
            default = number_or_text(scope[name])
            if isinstance(default, str) or (kind in WHOLE_TYPES and not default.is_integer()):
                node.fail(f"value = {default!r} is not of type {kind}")
            default = int(default) if kind in WHOLE_TYPES else default
        elif kind == "boolean":
            default = default in ("true", "1")
        try:
            found[name] = Parameter(name, default, "", limits).checked()
        except InputError as error:
            node.fail(str(error))
    return found


def _limit(node: Node) -> tuple[str, Value]:
    rule = node.get("rule")
    if rule not in RULES:
        node.fail(f"rule {rule!r} is not read: {', '.join(RULES)}")
    return rule, node.value("value")


def declared_parameters(path: str | Path) -> dict[str, Parameter]:
    """Returns the parameters of a .xosc file by name; errors as of `parameters_of`."""
    return parameters_of(read_root(Path(path)))


def read_distribution(path: str | Path) -> Distribution | None:
    """Returns the distribution of the parameters of a scenario; None if the file has none.

    Deterministic distributions are sets, ranges, and sets of values of several parameters. Those of
    a stochastic one are drawn with its seed.

    Raises:
      InputError: the file cannot be read, or an element is not supported; the message has its line.
    """
    node = read_root(Path(path)).find("ParameterValueDistribution")
    if node is None:
        return None
    file = Path(path).parent / node.child("ScenarioFile").get("filepath")
    node.only("ScenarioFile", "Deterministic", "Stochastic")
    if (stochastic := node.find("Stochastic")) is not None:
        return Distribution(file, (tuple(_drawn(stochastic)),))
    choices = []
    for each in node.child("Deterministic"):
        if each.tag == "DeterministicMultiParameterDistribution":
            sets = each.child("ValueSetDistribution").only("ParameterValueSet")
            chosen = [
                {
                    a.element.get("parameterRef", "").lstrip("$"): a.get("value")
                    for a in one.only("ParameterAssignment")
                }
                for one in sets
            ]
        elif each.tag == "DeterministicSingleParameterDistribution":
            name, kind = each.get("parameterName"), next(iter(each), each)
            chosen = [{name: value} for value in _values(kind)]
        else:
            each.refuse()
        if not 0 < len(chosen) <= VALUES_MAX:
            each.fail(f"has {len(chosen)} values: allowed are 1 to {VALUES_MAX}")
        choices.append(tuple(chosen))
    if not choices:
        node.fail("has no distribution of a parameter")
    return Distribution(file, tuple(choices))


def _drawn(node: Node) -> Iterator[dict[str, str]]:
    """The sets of values of the test runs of a stochastic distribution."""
    count = round(node.number("numberOfTestRuns", low=1.0, high=VALUES_MAX))
    random = np.random.default_rng(round(node.number("randomSeed", 0.0, low=0.0, high=2.0**53)))
    columns: dict[str, list[str]] = {}
    for each in node.only("StochasticDistribution"):
        kind = each.first(*DRAWS)
        columns[each.get("parameterName")] = DRAWS[kind.tag](kind, random, count)
    if not columns:
        node.fail("has no distribution of a parameter")
    for row in zip(*columns.values(), strict=True):
        yield dict(zip(columns, row, strict=True))


def _weighted(node: Node, random: np.random.Generator, count: int) -> list[Node]:
    """Elements of a node, drawn by their weights."""
    found = list(node)
    weights = np.array([each.number("weight", low=0.0) for each in found])
    if weights.sum() <= 0.0:
        node.fail("needs an element with a positive weight")
    numbers = random.choice(len(found), count, p=weights / weights.sum())
    return [found[number] for number in numbers.tolist()]


def _limits(node: Node) -> tuple[float, float]:
    """Lower and upper limit of a range, or of that in a node; infinite without one."""
    limits = node if node.tag == "Range" else node.find("Range")
    if limits is None:
        return -math.inf, math.inf
    low, high = limits.number("lowerLimit"), limits.number("upperLimit")
    if high < low:
        node.fail(f"needs lowerLimit {low:g} <= upperLimit {high:g}")
    return low, high


def _within(
    draw: Callable[[Node, np.random.Generator, int], Any],
) -> Callable[[Node, np.random.Generator, int], list[str]]:
    """Draws from a distribution until there are enough values within its range."""

    def drawn(node: Node, random: np.random.Generator, count: int) -> list[str]:
        (low, high), kept = _limits(node), np.zeros(0)
        for _ in range(REDRAWN):
            values = draw(node, random, count)
            kept = np.concatenate((kept, values[(low <= values) & (values <= high)]))
            if len(kept) >= count:
                return [f"{value:.10g}" for value in kept[:count].tolist()]
        return node.fail(f"has hardly any values from {low:g} to {high:g}")

    return drawn


def _moments(node: Node) -> tuple[float, float]:
    """Expected value and standard deviation."""
    return node.number("expectedValue"), math.sqrt(node.number("variance", low=0.0))


def _in_bins(node: Node, random: np.random.Generator, count: int) -> list[str]:
    bins = [_limits(each.only("Range")) for each in _weighted(node, random, count)]
    return [f"{random.uniform(*ends):.10g}" for ends in bins]


DRAWS: dict[str, Callable[[Node, np.random.Generator, int], list[str]]] = {
    "ProbabilityDistributionSet": lambda node, random, count: [
        each.get("value") for each in _weighted(node.only("Element"), random, count)
    ],
    "NormalDistribution": _within(lambda node, random, n: random.normal(*_moments(node), n)),
    "LogNormalDistribution": _within(lambda node, random, n: random.lognormal(*_moments(node), n)),
    "PoissonDistribution": _within(
        lambda node, random, n: 1.0 * random.poisson(node.number("expectedValue", 0.0, 0.0, 1e6), n)
    ),
    "UniformDistribution": _within(
        lambda node, random, n: random.uniform(*_limits(node.only("Range")), n)
    ),
    "Histogram": lambda node, random, count: _in_bins(node.only("Bin"), random, count),
}


def _values(node: Node) -> Iterator[str]:
    """The values of a set or of a range."""
    if node.tag == "DistributionSet":
        yield from (each.get("value") for each in node.only("Element"))
    elif node.tag == "DistributionRange":
        step, (low, high) = node.number("stepWidth", low=0.0), _limits(node.first("Range"))
        if step == 0.0:
            node.fail("needs a positive stepWidth")
        count = math.floor((high - low) / step + _ROUNDING) + 1
        if count > VALUES_MAX:
            node.fail(f"has {count} values: allowed are 1 to {VALUES_MAX}")
        yield from (f"{low + k * step:.10g}" for k in range(count))
    else:
        node.refuse()
