"""Command-line flags from a frozen dataclass of options, and the dataclass from a command line.

A field made by `iits_mj.core.options.option` becomes `--name-with-dashes`; a bool becomes
`--name/--no-name`; a size is `WIDTHxHEIGHT`;
a positional `tuple[str, ...]` takes any number of words. Every error is an InputError of one line.
"""

from __future__ import annotations

import argparse
import dataclasses
import types
import typing
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NoReturn, TypeVar

from iits_mj.core import options
from iits_mj.core.errors import InputError

T = TypeVar("T")
# Placeholders of values with a unit, in the help.
_METAVARS = {"kg": "KG", "m": "M", "m/s": "MPS", "km/h": "KMH", "s": "S"}


class Parser(argparse.ArgumentParser):
    """ArgumentParser whose errors are an `InputError` instead of a usage page and an exit."""

    def error(self, message: str) -> NoReturn:
        """Raises the message as one line that names the help of the command."""
        raise InputError(f"{' '.join(message.split())}; see '{self.prog} --help'")


def parse_size(text: str) -> tuple[int, int]:
    """Returns width and height in pixels of `WIDTHxHEIGHT`, both even for the video codec.

    Raises:
      InputError: any other text.
    """
    # Load MuJoCo only for commands that draw.
    from iits_mj.render.offscreen import SIZE_MAX, SIZE_MIN

    parts = text.lower().split("x")
    if len(parts) == 2 and all(part.isascii() and part.isdigit() for part in parts):
        width, height = (int(part[:6]) for part in parts)
        even = width % 2 == 0 and height % 2 == 0
        if even and min(width, height) >= SIZE_MIN and max(width, height) <= SIZE_MAX:
            return width, height
    raise InputError(
        f"size {text!r} is not allowed; use WIDTHxHEIGHT with even numbers from "
        f"{SIZE_MIN} to {SIZE_MAX}, for instance 960x540"
    )


_CONVERTERS: dict[Any, Callable[[str], Any]] = {
    int: int,
    float: float,
    str: str,
    Path: Path,
    tuple[int, int]: parse_size,
}
_KINDS = {int: "a whole number", float: "a number"}


def build_parser(kind: type[Any], prog: str, description: str) -> Parser:
    """Returns a parser with one flag for each option of the dataclass `kind`."""
    parser = Parser(
        prog=prog,
        description=description,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    hints = typing.get_type_hints(kind)
    rules = [(field, rule) for field in dataclasses.fields(kind) if (rule := options.of(field))]
    for field, rule in rules:
        if rule.positional:
            _add(parser, field, rule, _plain_type(hints[field.name]))
    for group, title in options.GROUPS.items():
        section = parser.add_argument_group(title)
        for field, rule in rules:
            if rule.group == group and not rule.positional:
                _add(section, field, rule, _plain_type(hints[field.name]))
    return parser


def parse(kind: type[T], arguments: Sequence[str], prog: str, description: str) -> T:
    """Returns an instance of the dataclass `kind` made from command-line arguments.

    A field made by `options.given_names` gets the names of the options on the command line.

    Raises:
      InputError: unknown flag, missing or unusable value; SystemExit(0) after `--help`.
    """
    parser = build_parser(kind, prog, description)
    # Otherwise flags would end a list of positional words.
    parsed = vars(parser.parse_intermixed_args(list(arguments)))
    rules = {field.name: options.of(field) for field in dataclasses.fields(kind)}  # type: ignore[arg-type]
    given = {
        name: _convert(kind, name, text, rule)
        for name, text in parsed.items()
        if text is not None and (rule := rules[name]) is not None
    }
    names = frozenset(given)
    given |= dict.fromkeys(options.holders_of_given(kind), names)
    instance = kind(**given)
    options.check(instance)
    return instance


def _convert(kind: type[Any], name: str, text: Any, rule: options.Option) -> Any:
    if isinstance(text, list):
        return tuple(text)
    if not isinstance(text, str):
        return text
    flag = name.replace("_", "-")
    shown = flag if rule.positional else f"--{flag}"
    value_type = _plain_type(typing.get_type_hints(kind)[name])
    try:
        value = _CONVERTERS[value_type](text)
    except InputError as error:
        raise InputError(f"{shown}: {error}") from None
    except ValueError:
        raise InputError(f"{shown}: {text[:40]!r} is not {_KINDS[value_type]}") from None
    options.check_value(shown, value, rule)
    return value


def _plain_type(hint: Any) -> Any:
    """Returns `X` of a type hint `X | None`."""
    if isinstance(hint, types.UnionType):
        return next(part for part in typing.get_args(hint) if part is not types.NoneType)
    return hint


def _add(
    parser: argparse._ActionsContainer,
    field: dataclasses.Field[Any],
    rule: options.Option,
    value_type: Any,
) -> None:
    flag = field.name.replace("_", "-")
    text = _help(field, rule)
    if value_type is bool:
        parser.add_argument(
            f"--{flag}", action=argparse.BooleanOptionalAction, default=None, help=text
        )
        return
    plain = {int: "N", float: "VALUE", Path: "FILE"}.get(value_type, "NAME")
    metavar = rule.metavar or _METAVARS.get(rule.unit, plain)
    if rule.positional:
        optional = field.default is not dataclasses.MISSING
        count = "*" if value_type == tuple[str, ...] else "?" if optional else None
        parser.add_argument(field.name, nargs=count, metavar=metavar, help=text)
        return
    required = field.default is dataclasses.MISSING
    parser.add_argument(f"--{flag}", default=None, metavar=metavar, required=required, help=text)


def _help(field: dataclasses.Field[Any], rule: options.Option) -> str:
    parts = [rule.help]
    allowed = rule.allowed()
    if allowed is not None:
        parts.append(f"one of {', '.join(allowed)}")
    elif rule.bounds():
        parts.append(rule.bounds())
    if rule.names is not None:
        parts.append(f"names are {', '.join(rule.names())}")
    default = field.default
    if default is not dataclasses.MISSING and default not in (None, "", ()):
        parts.append(f"default {_shown(default)}")
    return "; ".join(parts).replace("%", "%%")


def _shown(value: Any) -> str:
    if isinstance(value, bool):
        return "on" if value else "off"
    if isinstance(value, float):
        return f"{value:.5g}"
    if isinstance(value, tuple):
        return "x".join(str(part) for part in value)
    return str(value)
