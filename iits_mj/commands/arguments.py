"""Command-line flags from a frozen dataclass of options, and the dataclass from a command line.

A field made by `iits_mj.core.options.option` becomes `--name-with-dashes`; a bool becomes
`--name/--no-name`; a size is `WIDTHxHEIGHT`;
a positional `tuple[str, ...]` takes any number of words, another one may be given several times.
Every error is an InputError of one line.
"""

from __future__ import annotations

import argparse
import dataclasses
import os
import sys
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn, TypeVar

from iits_mj.commands.config_file import read_config, rules_of, with_paths, words_of
from iits_mj.commands.terminal import is_colored
from iits_mj.core import options
from iits_mj.core.checks import did_you_mean
from iits_mj.core.errors import InputError
from iits_mj.core.options import option

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


@dataclass(frozen=True, kw_only=True)
class General:
    """Options of every command."""

    config: Path | None = option(
        None,
        help="file with options, named as the flags; those on the command line take precedence",
        metavar="FILE.toml",
        group="general",
    )
    save_config: Path | None = option(
        None,
        help="write all options in force to a file for --config",
        metavar="FILE.toml",
        group="general",
    )
    quiet: bool = option(False, help="show no progress and no remarks", group="general")


def build_parser(
    kind: type[Any], prog: str, description: str, known: Collection[str] = ()
) -> Parser:
    """Returns a parser with one flag for each option of the dataclass `kind` and of `General`.

    Options in `known` need not be on the command line.
    """
    parser = Parser(
        prog=prog,
        description=description,
        formatter_class=_formatter,
        allow_abbrev=False,
        add_help=False,
    )
    add_options(parser, kind, known)
    return parser


def add_options(parser: Parser, kind: type[Any], known: Collection[str] = ()) -> None:
    """Adds the flags of the dataclass `kind` and of `General` to a parser, by subject."""
    rules = rules_of(kind) | rules_of(General)
    fields = {field.name: field for part in (kind, General) for field in dataclasses.fields(part)}
    words = [name for name, (rule, _) in rules.items() if rule.positional]
    if words:
        section = parser.add_argument_group("arguments")
    for name in words:
        _add(section, fields[name], *rules[name], given=name in known)
    parser.usage = " ".join(["%(prog)s [options]", *map(_placeholder, parser._actions)])
    for group, title in options.GROUPS.items():
        section = parser.add_argument_group(title)
        for name, (rule, value_type) in rules.items():
            if rule.group == group and not rule.positional:
                _add(section, fields[name], rule, value_type, given=name in known)
    section.add_argument("-h", "--help", action="help", help="show this help and end")


def _placeholder(word: argparse.Action) -> str:
    """A positional argument in the usage line."""
    return {"?": f"[{word.metavar}]", "*": f"[{word.metavar} ...]"}.get(
        str(word.nargs), str(word.metavar)
    )


def _formatter(prog: str) -> argparse.HelpFormatter:
    """Formatter of help texts, with colors on a terminal."""
    if not is_colored(sys.stdout):
        return argparse.RawDescriptionHelpFormatter(prog)
    from rich_argparse import RawDescriptionRichHelpFormatter

    class Formatter(RawDescriptionRichHelpFormatter):
        text_markup = help_markup = False

    Formatter.group_name_formatter = str
    return Formatter(prog)


def parse(kind: type[T], arguments: Sequence[str], prog: str, description: str) -> T:
    """Returns an instance of the dataclass `kind` made from command-line arguments; see `read`."""
    return read(kind, arguments, prog, description)[0]


def read(
    kind: type[T],
    arguments: Sequence[str],
    prog: str,
    description: str,
    commands: Collection[str] = (),
) -> tuple[T, General]:
    """Returns an instance of the dataclass `kind` made from a command line and its `--config`.

    A field made by `options.given_names` gets the names of the options given in either.

    Args:
      kind: a dataclass.
      arguments: of the command line, after the command.
      prog: program and command.
      description: what the command does.
      commands: all that a configuration file may have a table for.

    Raises:
      InputError: unknown flag or key, missing or unusable value; SystemExit(0) after `--help`.
    """
    first = Parser(prog=prog, add_help=False, allow_abbrev=False)
    first.add_argument("--config")
    file = first.parse_known_args(list(arguments))[0].config
    rules, common = rules_of(kind), rules_of(General)
    stored: dict[str, Any] = {}
    if file is not None:
        stored = _stored(Path(file), prog, commands, rules | {"quiet": common["quiet"]})
    parser = build_parser(kind, prog, description, stored)
    # Otherwise flags would end a list of positional words.
    parsed, left = parser.parse_known_intermixed_args(list(arguments))
    if left:
        flags = [flag for action in parser._actions for flag in action.option_strings]
        asked = [word.split("=")[0] for word in left if word.startswith("-")]
        near = did_you_mean(asked[0], flags) if asked else ""
        parser.error(f"unrecognized arguments: {' '.join(left)}{near}")
    given = stored | {
        name: _convert(_shown_name(name, rule), text, types[0], rule)
        for name, (rule, types) in (rules | common).items()
        if (text := getattr(parsed, name)) not in (None, [])
    }
    general = General(**{name: given.pop(name) for name in common if name in given})
    made = given | dict.fromkeys(options.holders_of_given(kind), frozenset(given))
    try:
        instance = kind(**made)
        options.check(instance)
    except InputError as error:
        raise InputError(f"{error}; options are also in {file}" if stored else str(error)) from None
    return instance, general


def _shown_name(name: str, rule: options.Option) -> str:
    flag = name.replace("_", "-")
    return flag if rule.positional else f"--{flag}"


def _stored(
    path: Path,
    prog: str,
    commands: Collection[str],
    rules: Mapping[str, tuple[options.Option, tuple[Any, ...]]],
) -> dict[str, Any]:
    """Returns the values of a configuration file by the names of their options."""
    command = prog.split()[-1]
    values = {}
    for name, value in read_config(path, command, commands or (command,)).items():
        key = name.replace("_", "-")
        if name not in rules:
            near = did_you_mean(key, [known.replace("_", "-") for known in rules])
            raise InputError(
                f"{path}: {key} is not an option of '{prog}'{near}; '{prog} --help' lists them"
            )
        rule, types = rules[name]
        text = words_of(f"{path}: {key}", value, types[0])
        if isinstance(text, str):
            # As `os.path.relpath`, which made it.
            text = with_paths(
                text,
                rule,
                types,
                lambda file: os.path.normpath(path.parent / Path(file).expanduser()),
            )
        where = f"{path}: {key}"
        try:
            values[name] = _convert(where, text, types[0], rule)
        except InputError as error:
            known = str(error).startswith(where)
            raise InputError(str(error) if known else f"{where}: {error}") from None
    return values


def _convert(shown: str, text: Any, value_type: Any, rule: options.Option) -> Any:
    if isinstance(text, list):
        return tuple(text)
    if not isinstance(text, str):
        return text
    try:
        value = _CONVERTERS[value_type](text)
    except InputError as error:
        raise InputError(f"{shown}: {error}") from None
    except ValueError:
        raise InputError(f"{shown}: {text[:40]!r} is not {_KINDS[value_type]}") from None
    options.check_value(shown, value, rule)
    return value


def _add(
    section: argparse._ArgumentGroup,
    field: dataclasses.Field[Any],
    rule: options.Option,
    types: Sequence[Any],
    given: bool,
) -> None:
    flag, value_type = field.name.replace("_", "-"), types[0]
    text = _help(field, rule)
    if value_type is bool:
        section.add_argument(
            f"--{flag}", action=argparse.BooleanOptionalAction, default=None, help=text
        )
        return
    plain = {int: "N", float: "VALUE", Path: "FILE"}.get(value_type, "NAME")
    metavar = rule.metavar or _METAVARS.get(rule.unit, plain)
    needed = field.default is dataclasses.MISSING and not given
    if rule.positional:
        count = "*" if value_type == tuple[str, ...] else None if needed else "?"
        section.add_argument(field.name, nargs=count, metavar=metavar, help=text)
        return
    action = "append" if value_type == tuple[str, ...] else "store"
    section.add_argument(
        f"--{flag}", action=action, default=None, metavar=metavar, required=needed, help=text
    )


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
