"""Parameters of scenarios: their values, limits, expressions, and assignments from outside."""

from __future__ import annotations

import ast
import math
import operator
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from iits_mj.core.checks import check_fields, did_you_mean, is_number, is_whole, shown
from iits_mj.core.errors import InputError

LONGEST_EXPRESSION = 400
PARAMETERS_MAX = 100  # of a file
Value = float | int | bool | str
NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
_USE = re.compile(rf"\$({NAME.pattern})")
_SIGNED = re.compile(rf"([+-]?)\$({NAME.pattern})")
_OPERATORS: dict[type, Callable[..., float]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Mod: math.fmod,
    ast.USub: operator.neg,
    ast.UAdd: operator.pos,
}
_FUNCTIONS: dict[str, Callable[..., float]] = {
    "round": round,
    "floor": math.floor,
    "ceil": math.ceil,
    "sqrt": math.sqrt,
    "pow": math.pow,
}
# Comparisons of OpenSCENARIO's rules.
RULES: dict[str, tuple[str, Callable[[Any, Any], bool]]] = {
    "greaterThan": (">", operator.gt),
    "greaterOrEqual": (">=", operator.ge),
    "lessThan": ("<", operator.lt),
    "lessOrEqual": ("<=", operator.le),
    "equalTo": ("=", operator.eq),
    "notEqualTo": ("!=", operator.ne),
}
Limits = Sequence[Sequence[tuple[str, Value]]]


def evaluate(text: str, scope: Mapping[str, Any]) -> float:
    """Returns the value of an expression of numbers and parameters, such as `-$gap + 2.0`.

    Args:
      text: with `+ - * / %`, `round`, `floor`, `ceil`, `sqrt` and `pow`, as in OpenSCENARIO.
      scope: values of the parameters.

    Raises:
      InputError: it is no such expression, a parameter is not declared, or the value is not finite.
    """

    def value(node: ast.AST) -> float:
        match node:
            case ast.Expression(body=body):
                return value(body)
            case ast.Constant(value=int() | float() as number):
                return float(number)
            case ast.BinOp(left=left, op=op, right=right) if type(op) in _OPERATORS:
                return _OPERATORS[type(op)](value(left), value(right))
            case ast.UnaryOp(op=op, operand=operand) if type(op) in _OPERATORS:
                return _OPERATORS[type(op)](value(operand))
            case ast.Call(func=ast.Name(id=name), args=args) if name in _FUNCTIONS:
                return float(_FUNCTIONS[name](*map(value, args)))
        raise ValueError

    filled = _USE.sub(lambda found: str(declared(found[1], scope)), text)
    try:
        if len(filled) > LONGEST_EXPRESSION:
            raise ValueError
        found = value(ast.parse(filled.strip(), mode="eval"))
    except (SyntaxError, ValueError, TypeError, ArithmeticError, RecursionError, MemoryError):
        raise InputError(f"{text[:60]!r} is no expression of numbers") from None
    if not math.isfinite(found):
        raise InputError(f"{text[:60]!r} is not finite")
    return found


def declared(name: str, scope: Mapping[str, Any]) -> Any:
    """Returns the value of a parameter; InputError if it is not declared."""
    if name not in scope:
        raise InputError(f"parameter ${name} is not declared{did_you_mean(name, scope)}")
    return scope[name]


def resolved(value: Any, scope: Mapping[str, Value], used: set[str]) -> Any:
    """Returns a value of a TOML file with its parameters replaced, also inside lists and tables.

    A text is replaced if it is a parameter, `$NAME`, with a sign, `-$NAME`, or an expression,
    `${...}`. An expression of whole parameters with a whole value is a whole number.

    Args:
      value: as read from the file.
      scope: values of the parameters.
      used: gets the names of the parameters that the value uses.

    Raises:
      InputError: a parameter is not declared, or an expression has no value.
    """
    if isinstance(value, dict):
        return {name: resolved(each, scope, used) for name, each in value.items()}
    if isinstance(value, list):
        return [resolved(each, scope, used) for each in value]
    if not isinstance(value, str) or not value.startswith(("$", "-$", "+$")):
        return value
    names = _USE.findall(value)
    used.update(names)
    if (found := _SIGNED.fullmatch(value)) and not found[1]:
        return declared(found[2], scope)
    if found is None and not (value.startswith("${") and value.endswith("}")):
        raise InputError(f"{shown(value)}: write an expression of parameters as ${{...}}")
    number = evaluate(value if found else value[2:-1], scope)
    whole = all(is_whole(scope[name]) for name in names) and number.is_integer()
    return int(number) if whole else number


@dataclass(frozen=True)
class Parameter:
    """A value of a scenario that can be set from outside.

    Attributes:
      name: of it.
      default: a number, a whole number, a flag or a text; other values are of the same kind.
      unit: of a number.
      limits: groups of rules of `RULES` and values, one group of which must hold; empty: none.
    """

    name: str
    default: Value
    unit: str = ""
    limits: Limits = ()

    def checked(self) -> Parameter:
        """Returns itself; InputError if the default is outside the limits."""
        self.parse(
            str(self.default).lower() if isinstance(self.default, bool) else str(self.default)
        )
        return self

    def parse(self, text: str) -> Value:
        """Returns the value that a text gives.

        Raises:
          InputError: it is of another kind, not finite, or outside the limits.
        """
        value = self._converted(text.strip())
        holds = any(all(RULES[r][1](value, v) for r, v in group) for group in self.limits)
        if self.limits and not holds:
            raise InputError(f"{self.name} = {text} {self.unit}".rstrip() + f": {self._allowed()}")
        return value

    def _converted(self, text: str) -> Value:
        kind = "true or false"
        if isinstance(self.default, bool):
            if text in ("true", "false"):
                return text == "true"
        elif isinstance(self.default, str):
            return text
        else:
            kind = "a whole number" if isinstance(self.default, int) else "a finite number"
            try:
                number = float(text)
            except ValueError:
                number = math.nan
            if math.isfinite(number) and (isinstance(self.default, float) or number.is_integer()):
                return type(self.default)(number)
        hint = f": its default {self.default} is one; write {self.default}.0 to allow any number"
        whole = hint if kind == "a whole number" else ""
        raise InputError(f"{self.name} = {shown(text)} is not {kind}{whole}")

    def _allowed(self) -> str:
        groups = (" and ".join(f"{RULES[r][0]} {v}" for r, v in group) for group in self.limits)
        return f"allowed is {', or '.join(groups)} {self.unit}".rstrip()


def parameter_of(name: str, entry: Any) -> Parameter:
    """Returns a parameter of the table `[parameters]` of a TOML file.

    Args:
      name: of it.
      entry: its default, or a table with `default`, and maybe `unit`, `low` and `high`.

    Raises:
      InputError: the name, the default or a limit is not usable.
    """
    if not NAME.fullmatch(name):
        raise InputError(f"parameter {shown(name)}: a name has letters, digits and underscores")
    values = entry if isinstance(entry, dict) else {"default": entry}
    check_fields(f"parameter {name}", values, ("default", "unit", "low", "high"))
    if "default" not in values:
        raise InputError(f"parameter {name}: default is missing")
    default, unit = values["default"], values.get("unit", "")
    if not isinstance(default, (str, bool)) and not is_number(default):
        raise InputError(f"parameter {name}: default = {shown(default)}: a number, text or flag")
    if not isinstance(unit, str):
        raise InputError(f"parameter {name}: unit = {shown(unit)} is not a text")
    group = []
    for key, rule in (("low", "greaterOrEqual"), ("high", "lessOrEqual")):
        if key in values:
            if not is_number(values[key]) or isinstance(default, (str, bool)):
                raise InputError(f"parameter {name}: {key} = {shown(values[key])}: only numbers")
            group.append((rule, values[key]))
    return Parameter(name, default, unit, (group,) if group else ()).checked()


def assignments(texts: Sequence[str]) -> dict[str, str]:
    """Returns the values of `NAME=VALUE`, as text by name.

    Raises:
      InputError: a text is of another form, or names a parameter again.
    """
    found: dict[str, str] = {}
    if isinstance(texts, str) or not all(isinstance(text, str) for text in texts):
        raise InputError(f"param {shown(texts)}: a sequence of texts NAME=VALUE is needed")
    for text in texts:
        name, equals, value = (part.strip() for part in text.partition("="))
        if not equals or not NAME.fullmatch(name.replace("-", "_")) or not value:
            raise InputError(f"param {shown(text)}: use NAME=VALUE")
        if name in found:
            raise InputError(f"param {name} is given twice: {found[name]} and {value}")
        found[name] = value
    return found


def scope_of(
    parameters: Mapping[str, Parameter], given: Mapping[str, str], where: str
) -> dict[str, Value]:
    """Returns the value of each parameter: the given one, else its default.

    Args:
      parameters: of a scenario, by name.
      given: texts by name, see `assignments`.
      where: file of the scenario, for messages.

    Raises:
      InputError: a name is unknown, or a value is not allowed.
    """
    scope = {name: parameter.default for name, parameter in parameters.items()}
    for name, text in given.items():
        if name not in parameters:
            has = f"it has {', '.join(parameters)}" if parameters else "it has none"
            raise InputError(
                f"{where}: there is no parameter {name!r}{did_you_mean(name, parameters)}; {has}"
            )
        try:
            scope[name] = parameters[name].parse(text)
        except InputError as error:
            raise InputError(f"{where}: parameter {error}") from None
    return scope
