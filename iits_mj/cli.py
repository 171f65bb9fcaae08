"""The command line `iits-mj`: runs a command and reports every error as one line.

Exit codes: 0 done and every check holds; 1 failure, or a check falls short; 2 wrong use or unusable
input; 70 fault of the program; 130 interrupted (Ctrl-C); 143 terminated (SIGTERM), which ends a
command as Ctrl-C does, with its outputs complete up to that moment.
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
from typing import Any

import iits_mj
from iits_mj.commands import arguments
from iits_mj.core.errors import Error, InputError

COMMANDS = {
    "drive": "drive the truck in traffic; writes video, telemetry and report",
    "view": "show a drive live in MuJoCo's interactive viewer",
    "validate": "compare truck, traffic and planning with theory, standards and the paper",
    "identify": "fit the truck's parameters to a recorded log",
    "pcc": "plan a fuel-optimal speed profile and compare it with constant speed",
    "train": 'train the decision maker "ddqn"',
    "evaluate": "compare decision makers in the paper's traffic cells",
    "montecarlo": "Monte Carlo over the uncertainty of the truck's parameters",
    "record": "drive in traffic and record traffic, states and commands",
    "replay": "drive in recorded traffic, or verify a recording",
    "render": "draw a film or a picture of a recorded drive: other cameras, weather, sizes",
    "compare": "compare two drives: what differs, where they part, over time and station",
    "replay-stage": "run one module of a recorded drive and compare its outputs",
    "import-trajectories": "place recorded trajectories on a map for replay",
    "serve": "serve the truck on a CAN bus in real time, for an external controller",
    "replay-can": "drive the truck with the commands of a CAN log, or decode the log",
    "truck": "check, show, compare and export trucks; JSON Schema of truck files",
    "bench": "measure computing times",
    "doctor": "check the installation and name remedies",
}
EXIT_SHORT, EXIT_USE, EXIT_FAULT, EXIT_INTERRUPTED, EXIT_TERMINATED = 1, 2, 70, 130, 143
TRACEBACK_VARIABLE = "IITS_MJ_TRACEBACK"


def usage() -> str:
    """Returns the text of `iits-mj --help`."""
    width = max(map(len, COMMANDS))
    lines = [f"  {name.ljust(width)}  {text}" for name, text in COMMANDS.items()]
    return "\n".join(
        [
            "usage: iits-mj COMMAND [options]",
            "",
            "A self-driving articulated truck in MuJoCo.",
            "",
            *lines,
            "",
            "'iits-mj COMMAND --help' explains the options of a command; 'iits-mj --version' shows "
            "the version.",
            "Exit codes: 0 done, 1 failure or a check falls short, 2 wrong use or unusable input.",
        ]
    )


def dispatch(argv: Sequence[str]) -> int:
    """Runs one command line and returns the exit code; raises `Error` on wrong use."""
    if not argv:
        raise InputError(f"a command is missing; use one of: {', '.join(COMMANDS)}")
    name, rest = argv[0], argv[1:]
    if name in ("-h", "--help", "help"):
        print(usage())
        return 0
    if name in ("-V", "--version"):
        print(f"iits-mj {iits_mj.__version__}")
        return 0
    if name not in COMMANDS:
        raise InputError(f"command {name[:60]!r} is not known; use one of: {', '.join(COMMANDS)}")
    module = _module(name)
    return int(module.run(_options(module, name, rest)))


def understood(argv: Sequence[str]) -> bool:
    """Returns whether a command line is valid, without running it."""
    if not argv or argv[0] not in COMMANDS:
        return False
    try:
        _options(_module(argv[0]), argv[0], argv[1:])
    except (Error, ImportError):
        return False
    return True


def _module(name: str) -> ModuleType:
    return importlib.import_module(f"iits_mj.commands.{name.replace('-', '_')}")


def _options(module: ModuleType, name: str, words: Sequence[str]) -> Any:
    return arguments.parse(module.Options, words, f"iits-mj {name}", module.__doc__ or "")


def main(argv: Sequence[str] | None = None) -> int:
    """Runs the command line; prints every error as one line and returns the exit code."""
    with _termination_as_interrupt() as received:
        code = _report(argv)
    return EXIT_TERMINATED if received and code == EXIT_INTERRUPTED else code


@contextlib.contextmanager
def _termination_as_interrupt() -> Iterator[list[int]]:
    """Handles SIGTERM as the current handler of Ctrl-C does; yields the signals received."""
    received: list[int] = []

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
    try:
        yield received
    finally:
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
        # The reader has closed the pipe (`iits-mj bench | head`).
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return EXIT_USE
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
    print(f"iits-mj: {' '.join(message.split())}", file=sys.stderr)
    return code


if __name__ == "__main__":
    sys.exit(main())
