"""The command `iits-mj`: one line for every error, and an exit code that means something.

Exit codes: 0 done and every check holds, 1 a check falls short, 2 wrong use or unusable input,
70 a fault of the program itself, 130 interrupted.
"""

from __future__ import annotations

import importlib
import os
import sys
import traceback
from collections.abc import Sequence
from types import ModuleType
from typing import Any

import iits_mj
from iits_mj.commands import arguments
from iits_mj.core.errors import Error, InputError

COMMANDS = {
    "drive": "drive the truck with its stack over a road in traffic; video, telemetry, report",
    "view": "the same drive in MuJoCo's interactive viewer",
    "validate": "hold the truck against closed-form solutions, standards and the paper",
    "identify": "fit the truck's parameters to a recorded log",
    "pcc": "plan a fuel-optimal speed profile and compare it with the constant-speed baseline",
    "train": "train the decision maker",
    "evaluate": "compare decision makers over the paper's traffic cells",
    "montecarlo": "measure trucks drawn from what is not known of the figures",
    "record": "run traffic and store what it did",
    "replay": "drive in stored traffic",
    "replay-stage": "run one module of a recorded drive again and compare what it says",
    "import-trajectories": "place a data set of recorded trajectories on a map, for replay",
    "serve": "the truck on a CAN bus in real time, for somebody's own controller",
    "replay-can": "drive the truck with the commands of a CAN log, or decode it",
    "bench": "measure what a step costs",
    "doctor": "show versions, plugin, OpenGL and SUMO, each with a remedy",
}
EXIT_SHORT, EXIT_USE, EXIT_FAULT, EXIT_INTERRUPTED = 1, 2, 70, 130
TRACEBACK_VARIABLE = "IITS_MJ_TRACEBACK"


def usage() -> str:
    """The help page."""
    width = max(map(len, COMMANDS))
    lines = [f"  {name.ljust(width)}  {text}" for name, text in COMMANDS.items()]
    return "\n".join(
        [
            "usage: iits-mj COMMAND [flags]",
            "",
            "A self-driving articulated truck in MuJoCo.",
            "",
            *lines,
            "",
            "'iits-mj COMMAND --help' explains the flags of a command; 'iits-mj --version'.",
            "Exit codes: 0 done, 1 a check falls short, 2 wrong use or unusable input.",
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
    """True when a command line would be accepted; nothing is run."""
    try:
        name, rest = argv[0], argv[1:]
        _options(_module(name), name, rest)
    except (Error, IndexError, ImportError):
        return False
    return True


def _module(name: str) -> ModuleType:
    return importlib.import_module(f"iits_mj.commands.{name.replace('-', '_')}")


def _options(module: ModuleType, name: str, words: Sequence[str]) -> Any:
    return arguments.parse(module.Options, words, f"iits-mj {name}", module.__doc__ or "")


def main(argv: Sequence[str] | None = None) -> int:
    """Entry point: `dispatch` with every error turned into one line on stderr."""
    # libsumo would print a warning about an installed pyarrow on stdout, into our JSON.
    os.environ.setdefault("LIBSUMO_AS_TRACI", "quiet")
    try:
        code = dispatch(sys.argv[1:] if argv is None else argv)
        sys.stdout.flush()
    except Error as error:
        return _fail(str(error), EXIT_USE)
    except BrokenPipeError:
        # The reader has gone (`iits-mj bench | head`): nothing is left to say.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return EXIT_USE
    except OSError as error:
        return _fail(_os_error(error), EXIT_USE)
    except KeyboardInterrupt:
        return _fail("interrupted", EXIT_INTERRUPTED)
    except SystemExit as stop:
        return stop.code if isinstance(stop.code, int) else 0
    except Exception as error:  # a fault of ours must not show a traceback either
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
