"""Parameters that OpenSCENARIO files declare, and files with their distributions."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from traffic_bridge.scenario.openscenario_file import Node, number_or_text, read_root
from traffic_bridge.scenario.parameters import RULES, Parameter, Value

WHOLE_TYPES = ("int", "integer", "unsignedInt", "unsignedShort")
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
        found[name] = Parameter(name, default, "", limits)
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

    Deterministic distributions are read: sets, ranges, and sets of values of several parameters.

    Raises:
      InputError: the file cannot be read, or an element is not supported; the message has its line.
    """
    node = read_root(Path(path)).find("ParameterValueDistribution")
    if node is None:
        return None
    for stochastic in node.only("ScenarioFile", "Deterministic", "Stochastic"):
        if stochastic.tag == "Stochastic":
            stochastic.fail("only deterministic distributions are read")
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
    file = node.child("ScenarioFile").get("filepath")
    return Distribution(Path(path).parent / file, tuple(choices))


def _values(node: Node) -> Iterator[str]:
    """The values of a set or of a range."""
    if node.tag == "DistributionSet":
        yield from (each.get("value") for each in node.only("Element"))
    elif node.tag == "DistributionRange":
        step, limits = node.number("stepWidth", low=0.0), node.only("Range").child("Range")
        low, high = limits.number("lowerLimit"), limits.number("upperLimit")
        if step == 0.0 or high < low:
            node.fail(f"needs a positive stepWidth and lowerLimit {low:g} <= upperLimit {high:g}")
        count = math.floor((high - low) / step + _ROUNDING) + 1
        if count > VALUES_MAX:
            node.fail(f"has {count} values: allowed are 1 to {VALUES_MAX}")
        yield from (f"{low + k * step:.10g}" for k in range(count))
    else:
        node.refuse()
