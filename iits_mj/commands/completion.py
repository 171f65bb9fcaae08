"""Print the script that completes commands, flags, names and files in a shell.

  bash  iits-mj completion bash > ~/.local/share/bash-completion/completions/iits-mj
  zsh   iits-mj completion zsh > DIR/_iits-mj, with DIR in fpath before compinit
  fish  iits-mj completion fish > ~/.config/fish/completions/iits-mj.fish

The script is complete in itself, so that pressing Tab starts no Python. Print it again after an
update.
"""

from __future__ import annotations

import importlib
from dataclasses import dataclass
from pathlib import Path

import shtab

from iits_mj.commands import COMMANDS, arguments
from iits_mj.commands.config_file import rules_of
from iits_mj.core.options import option
from iits_mj.core.progress import each

SHELLS = ("bash", "zsh", "fish")


@dataclass(frozen=True, kw_only=True)
class Options:
    """Flags of `iits-mj completion`."""

    shell: str = option(
        help="shell that reads it", choices=SHELLS, metavar="SHELL", positional=True
    )


def run(options: Options) -> int:
    """Prints the script."""
    print(script(options.shell))
    return 0


def script(shell: str) -> str:
    """Returns the script for a shell, one of `SHELLS`."""
    root = arguments.Parser(prog="iits-mj", add_help=False)
    root.add_argument("-h", "--help", action="store_true", help="show the help and end")
    root.add_argument("-V", "--version", action="store_true", help="show the version and end")
    commands = root.add_subparsers(parser_class=arguments.Parser)
    for name in each(COMMANDS, "reading the commands", str):
        module = importlib.import_module(f"iits_mj.commands.{name.replace('-', '_')}")
        _add(commands.add_parser(name, help=COMMANDS[name], add_help=False), module.Options)
    words = commands.add_parser("help", help="explain a command", add_help=False)
    words.add_argument("command", choices=tuple(COMMANDS), help="command to explain")
    return shtab.complete(root, shell)


def _add(parser: arguments.Parser, kind: type) -> None:
    """Adds the flags of a command, with what may follow them."""
    arguments.add_options(parser, kind)
    rules = rules_of(kind) | rules_of(arguments.General)
    for action in parser._actions:
        if action.dest not in rules:
            continue
        rule, types = rules[action.dest]
        names = rule.allowed() or (rule.names() if rule.names is not None else None)
        if names:
            action.choices = tuple(names)
        elif Path in types:
            folder = (rule.metavar or "").startswith("DIR")
            action.complete = shtab.DIRECTORY if folder else shtab.FILE  # type: ignore[attr-defined]
