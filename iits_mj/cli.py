"""The command line `iits-mj`: runs a command and reports every error as one line.

Exit codes: 0 done and every check holds; 1 failure, or a check falls short; 2 wrong use or unusable
input; 70 fault of the program; 130 interrupted (Ctrl-C); 141 the reader of a pipe has closed it;
143 terminated (SIGTERM), which ends a command as Ctrl-C does, with its outputs complete up to that
moment.
"""

from __future__ import annotations

import contextlib
import importlib
import os
import signal
import sys
import threading
import traceback
from collections.abc import Iterator, Sequence
from types import FrameType, ModuleType
from typing import TYPE_CHECKING, Any

import iits_mj
from iits_mj.commands import COMMANDS, SECTIONS, terminal
from iits_mj.core.checks import one_of
from iits_mj.core.errors import Error

if TYPE_CHECKING:
    from iits_mj.commands.arguments import General

_AGAIN = 0.05  # [s] until a dropped interrupt is raised again: outside of the finalizer
EXIT_SHORT, EXIT_USE, EXIT_FAULT, EXIT_INTERRUPTED, EXIT_TERMINATED = 1, 2, 70, 130, 143
# As of tools that the signal SIGPIPE ends: 128 and its number. 0 would claim that checks hold.
EXIT_PIPE = 141
_HELP, _VERSION = ("help", "-h", "--help"), ("-V", "--version")
_NAME_MAX = 60  # shown characters of an unknown command
_LOADING = 1.0  # usual time to load the modules of a command [s]
TRACEBACK_VARIABLE = "IITS_MJ_TRACEBACK"


# Headings, commands and flags in the text of `iits-mj --help` on a terminal.
_STYLES = {
    r"(?m)^[a-zA-Z ]+:": "dark_orange",
    r"(?m)^  [a-z-]+(?=  )|(?<=')iits-mj [^']+|--[a-z-]+": "cyan",
}


def usage() -> str:
    """Returns the text of `iits-mj --help`."""
    width = max(map(len, COMMANDS))
    lines = ["usage: iits-mj COMMAND [options]", "", "A self-driving articulated truck in MuJoCo."]
    for title, commands in SECTIONS.items():
        lines += ["", f"{title}:"]
        lines += [f"  {name.ljust(width)}  {text}" for name, text in commands.items()]
    lines += [
        "",
        "'iits-mj drive' without options is a demo of a minute. 'iits-mj help COMMAND' explains",
        "the options of a command. Every command takes --config, --save-config and --quiet.",
        "'iits-mj --version' shows the version.",
        "",
        "exit codes: 0 done, 1 failure or a check falls short, 2 wrong use or unusable input,",
        "  70 fault of the program, 130 interrupted, 141 pipe closed, 143 terminated",
    ]
    return "\n".join(lines)


def dispatch(argv: Sequence[str]) -> int:
    """Runs one command line and returns the exit code; raises `Error` on wrong use."""
    if not argv:
        terminal.show(usage(), _STYLES, sys.stderr)
        return EXIT_USE
    name, rest = argv[0], argv[1:]
    if name == "help" and rest:
        name, rest = rest[0], ["--help"]
    if name in _HELP:
        terminal.show(usage(), _STYLES)
        return 0
    if name in _VERSION:
        print(f"iits-mj {iits_mj.__version__}")
        return 0
    one_of("command", name[:_NAME_MAX], COMMANDS)
    return _run(name, rest)


def _run(name: str, words: Sequence[str]) -> int:
    # The help needs none of these.
    from iits_mj.commands import progress
    from iits_mj.core.progress import task

    silent = not {"--quiet", "-h", "--help"}.isdisjoint(words)
    with progress.shown(quiet=silent), task("loading", usual=_LOADING):
        module = _module(name)
    options, general = _options(module, name, words)
    if general.save_config is not None:
        from iits_mj.commands.config_file import save_config
        from iits_mj.commands.output import prepare_file

        prepare_file(general.save_config, "--save-config")
        final = module.effective(options) if hasattr(module, "effective") else options
        save_config(general.save_config, name, final)
    with progress.shown(quiet=general.quiet):
        return int(module.run(options))


def understood(argv: Sequence[str]) -> bool:
    """Returns whether a command line is valid, without running it."""
    if not argv:
        return False
    if argv[0] in (*_HELP, *_VERSION):
        return set(argv[1:]) <= set(COMMANDS)
    if argv[0] not in COMMANDS:
        return False
    try:
        _options(_module(argv[0]), argv[0], argv[1:])
    except (Error, ImportError):
        return False
    return True


def _module(name: str) -> ModuleType:
    return importlib.import_module(f"iits_mj.commands.{name.replace('-', '_')}")


def _options(module: ModuleType, name: str, words: Sequence[str]) -> tuple[Any, General]:
    from iits_mj.commands import arguments

    text = module.__doc__ or ""
    return arguments.read(module.Options, words, f"iits-mj {name}", text, COMMANDS)


def main(argv: Sequence[str] | None = None) -> int:
    """Runs the command line; prints every error as one line and returns the exit code."""
    with _termination_as_interrupt() as received:
        code = _report(argv)
    return EXIT_TERMINATED if received and code == EXIT_INTERRUPTED else code


@contextlib.contextmanager
def _termination_as_interrupt() -> Iterator[list[int]]:
    """Handles SIGTERM as the current handler of Ctrl-C does; yields the signals received.

    Python drops an interrupt that arrives in a finalizer; then it is raised again.
    """
    received: list[int] = []
    report = sys.unraisablehook

    def again(dropped: sys.UnraisableHookArgs) -> None:
        if issubclass(dropped.exc_type, KeyboardInterrupt):
            number = signal.SIGTERM if received else signal.SIGINT
            threading.Timer(_AGAIN, os.kill, (os.getpid(), number)).start()
        else:
            report(dropped)

    def end(number: int, frame: FrameType | None) -> None:
        received.append(number)
        interrupt = signal.getsignal(signal.SIGINT)
        # A shell starts background jobs with Ctrl-C ignored.
        if not callable(interrupt):
            raise KeyboardInterrupt
        interrupt(number, frame)

    if threading.current_thread() is not threading.main_thread():
        yield received
        return
    before = signal.signal(signal.SIGTERM, end)
    sys.unraisablehook = again
    try:
        yield received
    finally:
        sys.unraisablehook = report
        signal.signal(signal.SIGTERM, before)


def _report(argv: Sequence[str] | None) -> int:
    # Otherwise libsumo prints a warning about pyarrow on stdout, into JSON output.
    os.environ.setdefault("LIBSUMO_AS_TRACI", "quiet")
    try:
        code = dispatch(sys.argv[1:] if argv is None else argv)
        sys.stdout.flush()
    except Error as error:
        if os.environ.get(TRACEBACK_VARIABLE):
            traceback.print_exc()
        return _fail(str(error), EXIT_USE)
    except BrokenPipeError:
        # The reader has closed the pipe (`iits-mj bench | head`). What is left goes nowhere.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return EXIT_PIPE
    except OSError as error:
        return _fail(_os_error(error), EXIT_USE)
    except KeyboardInterrupt:
        return _fail("interrupted", EXIT_INTERRUPTED)
    except SystemExit as stop:
        return stop.code if isinstance(stop.code, int) else 0
    except Exception as error:
        if os.environ.get(TRACEBACK_VARIABLE):
            traceback.print_exc()
        return _fail(
            f"fault in the program ({type(error).__name__}: {error}); "
            f"{TRACEBACK_VARIABLE}=1 shows where",
            EXIT_FAULT,
        )
    return code


def _os_error(error: OSError) -> str:
    reason = error.strerror or type(error).__name__
    return f"{str(error.filename)!r}: {reason}" if error.filename is not None else reason


def _fail(message: str, code: int) -> int:
    text = f"iits-mj: {' '.join(message.split())}"
    terminal.show(text, {"^iits-mj:": "bold red"}, sys.stderr)
    return code


if __name__ == "__main__":
    sys.exit(main())
