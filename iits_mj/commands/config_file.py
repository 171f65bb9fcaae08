"""Options of commands in a TOML file: `--config` reads it, `--save-config` writes it.

Keys have the names of the flags, with dashes or underscores. Keys above all tables hold for every
command that reads the file; keys in a table named after a command, as `[drive]`, hold for it alone.
Paths are relative to the folder of the file.
"""

from __future__ import annotations

import dataclasses
import json
import os
import types
import typing
from collections.abc import Callable, Collection, Mapping
from pathlib import Path
from typing import Any

import iits_mj
from iits_mj.core import options
from iits_mj.core.checks import did_you_mean, shown
from iits_mj.core.errors import InputError
from iits_mj.core.input_files import read_toml
from iits_mj.core.output_files import write_whole

_WHAT = "configuration file"
# The first words of a written file, which may be overwritten.
_WRITTEN = b"# Settings of 'iits-mj "


def read_config(path: Path, command: str, commands: Collection[str]) -> dict[str, Any]:
    """Returns the values of a file for a command, by the names of the dataclass fields.

    Args:
      path: of the file.
      command: that reads it.
      commands: all that have a table.

    Raises:
      InputError: the file cannot be read, has a table of no command, or a key twice.
    """
    content = read_toml(path, _WHAT)
    tables = {key for key, value in content.items() if isinstance(value, dict)}
    for key in tables:
        if (name := key.replace("_", "-")) not in commands:
            raise InputError(
                f"{path}: [{key}] is not a command{did_you_mean(name, commands)}; use one of: "
                f"{', '.join(commands)}"
            )
    values = _fields(path, {key: content[key] for key in content if key not in tables})
    for key in sorted(tables):
        if key.replace("_", "-") == command:
            values |= _fields(path, content[key])
    return values


def _fields(path: Path, table: Mapping[str, Any]) -> dict[str, Any]:
    values = {key.replace("-", "_"): value for key, value in table.items()}
    if len(values) < len(table):
        twice = next(key for key in table if "-" in key and key.replace("-", "_") in table)
        raise InputError(f"{path}: {twice} is there twice, with dashes and with underscores")
    return values


def rules_of(kind: type[Any]) -> dict[str, tuple[options.Option, tuple[Any, ...]]]:
    """Returns the options of a dataclass by name, each with the types that it may have."""
    hints = typing.get_type_hints(kind)
    return {
        field.name: (rule, _types(hints[field.name]))
        for field in dataclasses.fields(kind)
        if (rule := options.of(field)) is not None
    }


def _types(hint: Any) -> tuple[Any, ...]:
    """Returns the types of a hint such as `X | None`, without None."""
    if not isinstance(hint, types.UnionType):
        return (hint,)
    return tuple(part for part in typing.get_args(hint) if part is not types.NoneType)


def words_of(where: str, value: Any, kind: Any) -> Any:
    """Returns a value of the file as the command line has it: text, a list of texts, or a bool.

    Args:
      where: file and key, for messages.
      value: in the file.
      kind: type of the option.

    Raises:
      InputError: the value has another type.
    """
    if isinstance(value, list) and kind == tuple[str, ...]:
        return [str(part) for part in value]
    if isinstance(value, list) and kind == tuple[int, int]:
        return "x".join(map(str, value))
    if kind is bool:
        good, wanted = isinstance(value, bool), "true or false"
    elif kind in (int, float):
        good, wanted = type(value) in (int, float), "a number, without quotes"
    else:
        good, wanted = isinstance(value, str), "text in quotes"
    if not good:
        raise InputError(f"{where} = {shown(value)} is not allowed; use {wanted}")
    return value if kind is bool else str(value)


def save_config(path: Path, command: str, config: Any) -> None:
    """Writes the options of a command, also those that have their default.

    Options that were not given stand as comments if the command distinguishes them from options
    given with their default.

    Args:
      path: of the file; only a file that this function has written is overwritten.
      command: that the options belong to.
      config: the options.

    Raises:
      InputError: the file cannot be written, or has other content.
    """
    if path.is_file() and not path.read_bytes().startswith(_WRITTEN):
        raise InputError(f"--save-config {str(path)!r}: exists and was not written by iits-mj")
    tells_given = bool(options.holders_of_given(type(config)))
    given = options.given_in(config)
    rules = rules_of(type(config))
    lines = []
    for group, title in options.GROUPS.items():
        rows = []
        for name, (rule, kinds) in rules.items():
            value = getattr(config, name)
            if rule.group != group:
                continue
            if value is None:
                rows.append(f"# {name}: not set")
                continue
            row = f"{name} = {_text(value, rule, kinds, path.parent)}"
            rows.append(row if not tells_given or name in given else f"# {row}")
        if rows:
            lines += ["", f"# {title}", *rows]
    head = f"{_WRITTEN.decode()}{command}', version {iits_mj.__version__}."
    text = "\n".join([head, f"[{command}]", *lines])
    write_whole(path, f"{text}\n".encode(), _WHAT)


def _text(value: Any, rule: options.Option, kinds: Collection[Any], folder: Path) -> str:
    """A value as TOML."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, (int, float)):
        return repr(value)
    if isinstance(value, tuple):
        return f"[{', '.join(_quoted(part) for part in value)}]"

    def relative(file: str) -> str:
        return file if os.path.isabs(file) else os.path.relpath(file, folder)

    return _quoted(with_paths(str(value), rule, kinds, relative))


def _quoted(value: str | int) -> str:
    """Text or a whole number as TOML, which agrees with JSON except for one character."""
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")


def with_paths(
    text: str, rule: options.Option, kinds: Collection[Any], move: Callable[[str], str]
) -> str:
    """Returns the value of an option with the paths in it replaced by what `move` returns.

    Paths are a value as a whole, unless it is one of the option's known names, and the files of own
    parts.
    """
    if Path in kinds and (rule.names is None or text not in rule.names()):
        return move(text)
    return text if rule.files is None else rule.files.sub(lambda file: move(file[0]), text)
