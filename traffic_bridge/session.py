"""One libsumo simulation: start, error handling and end. The only module that imports libsumo."""

from __future__ import annotations

import contextlib
import math
import os
import re
import weakref
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable, Iterator, Sequence
from functools import lru_cache
from pathlib import Path
from types import TracebackType
from typing import Any, NoReturn

from iits_mj.core.errors import TrafficError
from iits_mj.core.output_files import TemporaryFolder

ERROR_LOG = "errors.txt"


def load_libsumo() -> Any:
    """Imports libsumo without its messages on the terminal.

    Raises:
      TrafficError: the package is missing.
    """
    before = os.environ.get("LIBSUMO_AS_TRACI")
    # libsumo prints a warning about pyarrow's version unless this is "quiet" at import.
    os.environ["LIBSUMO_AS_TRACI"] = "quiet"
    try:
        import libsumo
    except ImportError as error:
        raise TrafficError(
            f"SUMO's Python library is missing ({error}); install it with: pip install libsumo"
        ) from error
    finally:
        if before is None:
            del os.environ["LIBSUMO_AS_TRACI"]
        else:
            os.environ["LIBSUMO_AS_TRACI"] = before
    return libsumo


def sumo_runs_here() -> bool:
    """Whether this process holds a SUMO simulation, so that another one needs its own process.

    Raises:
      TrafficError: SUMO's library is missing.
    """
    return bool(load_libsumo().isLoaded())


@contextlib.contextmanager
def _captured_stderr(path: Path) -> Iterator[None]:
    """Redirects stderr of native code to a file, because SUMO writes its errors only there."""
    saved = os.dup(2)
    target = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    try:
        os.dup2(target, 2)
        yield
    finally:
        os.dup2(saved, 2)
        os.close(saved)
        os.close(target)


def check_net(net: Path) -> None:
    """Checks a net for faults on which SUMO crashes instead of reporting an error.

    Raises:
      TrafficError: the file is missing, not well-formed XML, has no version, place or lanes, a lane
        without length, speed or shape, or a lane inside a junction to which no connection leads.
    """
    try:
        status = net.stat()
        fault = _fault(net, status.st_mtime_ns, status.st_size)
    except (OSError, ElementTree.ParseError, UnicodeError) as error:
        fault = str(error)
    if fault:
        raise TrafficError(f"loading {net}: not a SUMO network: {fault}")


@lru_cache(maxsize=16)
def _fault(net: Path, _changed: int, _size: int) -> str:
    """The fault of a net in words, or ""; cached while the file does not change."""
    versioned, placed, internal = False, False, False
    lanes, inside, reached = 0, set(), set()
    for event, element in ElementTree.iterparse(net, events=("start", "end")):
        if event == "end":
            element.clear()
        elif element.tag == "edge":
            internal = element.get("function") == "internal"
        elif element.tag == "lane":
            lanes += 1
            name = element.get("id", "")
            if not all(_positive(element.get(key)) for key in ("length", "speed")):
                return f"lane {name!r} has no positive length and speed"
            if not _finite(element.get("shape", "")):
                return f"lane {name!r} has a shape that is not finite"
            if internal:
                inside.add(name)
        elif element.tag == "connection":
            reached.add(element.get("via"))
        elif element.tag == "net":
            versioned = element.get("version") is not None
        elif element.tag == "location":
            placed = {"netOffset", "convBoundary", "origBoundary"} <= set(element.keys())
    if not (versioned and placed):
        return "it has no version or no complete <location>"
    if lanes == 0:
        return "it has no lanes"
    if lost := inside - reached:
        return f"no connection leads to lane {min(lost)!r} inside a junction"
    return ""


def _positive(text: str | None) -> bool:
    try:
        return 0.0 < float(text or "") < math.inf
    except ValueError:
        return True  # SUMO has a better message for a malformed number


def _finite(shape: str) -> bool:
    return not re.search(r"nan|inf", shape, re.IGNORECASE)


class Session:
    """A loaded SUMO simulation. A process can have one, because libsumo has one global state.

    A session without references is closed. A simulation that other code of the process has started
    through libsumo is neither used nor closed.

    Args:
      net: the SUMO network file.
      additional: content of an additional file (vehicle types), XML text.
      step_length: [s].
      seed: of SUMO's generator.
      options: further SUMO options.

    Attributes:
      api: the libsumo module.

    Raises:
      TrafficError: another simulation is loaded in this process, or SUMO refuses the input.
    """

    def __init__(
        self,
        net: Path,
        additional: str = "",
        step_length: float = 0.1,
        seed: int = 0,
        options: Sequence[str] = (),
    ) -> None:
        self.api = load_libsumo()
        self._guards = 0
        self._finalizer: weakref.finalize[[Any, TemporaryFolder], Session] | None
        self._finalizer = None
        if self.api.isLoaded():
            raise TrafficError(
                "a SUMO simulation is already running in this process and libsumo can hold only "
                "one; close() it first, or run several as processes with TrafficWorlds"
            )
        check_net(net)
        try:
            folder = TemporaryFolder("sumo")
            self._folder = folder.path
            types = self._folder / "types.add.xml"
            types.write_text(f"<additional>{additional}</additional>", encoding="utf-8")
        except OSError as error:
            raise TrafficError(f"SUMO's temporary files cannot be written: {error}") from error
        self._error_log = str(self._folder / ERROR_LOG)
        self._stderr = self._folder / "stderr.txt"
        command = [
            "sumo",
            *("--net-file", str(net), "--additional-files", str(types)),
            *("--step-length", str(step_length), "--seed", str(seed % 2**31)),
            *("--time-to-teleport", "-1", "--collision.action", "warn"),
            *("--max-depart-delay", "5", "--error-log", self._error_log),
            # SUMO tries to insert each vehicle separately: the road is filled in one step.
            *("--eager-insert", "true"),
            *("--no-step-log", "true", "--no-warnings", "true", "--xml-validation", "never"),
            *options,
        ]
        self._finalizer = weakref.finalize(self, _unload, self.api, folder)
        with Guard(self, f"loading {net}", loading=True), _captured_stderr(self._stderr):
            self.api.start(command)

    def __reduce__(self) -> NoReturn:
        raise TrafficError(
            "a running SUMO simulation cannot be copied or pickled: copy the environment or the "
            "settings before reset(), and reset the copy with the same seed"
        )

    def guard(self, action: str) -> Guard:
        """A `with` block for every use of `api`.

        SUMO's errors become a `TrafficError` that names the action, and close the simulation.

        Raises:
          TrafficError: on entering, if this simulation has ended or libsumo holds another one,
            which stays open.
        """
        return Guard(self, action)

    def getter(self, domain: str, name: str) -> Callable[[str], Any]:
        """A fast function of libsumo that reads a value by id, for reading many values.

        libsumo's public functions call native ones, which takes as long as the native ones
        themselves. The native function is returned if this version of libsumo has it.

        Args:
          domain: "vehicle", "lane" ...
          name: "getSpeed" ...
        """
        native = getattr(self.api.libsumo, "_libsumo", None)
        found = getattr(native, f"{domain}_{name}", None)
        return found if callable(found) else getattr(getattr(self.api, domain), name)

    def step(self) -> None:
        """Advances the simulation by one step.

        Raises:
          TrafficError: it is closed, SUMO fails, or another simulation has taken its place.
        """
        if not self.is_open:
            raise TrafficError("the SUMO simulation is closed; call reset() to start it again")
        with self.guard("stepping"):
            self.api.simulationStep()

    def close(self) -> None:
        """Unloads the simulation; may be called again."""
        if self._finalizer is not None:
            self._finalizer()

    @property
    def is_open(self) -> bool:
        """True while SUMO runs."""
        return self._finalizer is not None and self._finalizer.alive

    def check_held(self) -> None:
        """Closes the simulation and raises TrafficError if libsumo holds another one."""
        if not _holds(self.api, self._error_log):
            self.close()
            raise TrafficError(
                "the SUMO simulation was ended or replaced by other code of this process "
                "that uses libsumo; call reset() when that is done"
            )

    def explain(self, error: BaseException) -> str:
        """SUMO's explanation of an error: its message and its output while loading."""
        parts = [str(error).strip()]
        for path in (self._stderr, Path(self._error_log)):
            if path.is_file():
                parts += path.read_text(encoding="utf-8", errors="replace").splitlines()
        lines: list[str] = []
        for part in parts:
            line = part.replace("Error:", "").strip()
            if line and line not in lines and not line.startswith("Quitting"):
                lines.append(line)
        return "; ".join(lines)[:600] or "no explanation given"


class Guard:
    """A `with` block in which every error ends the simulation; see `Session.guard`."""

    __slots__ = ("_action", "_loading", "_session")

    def __init__(self, session: Session, action: str, loading: bool = False) -> None:
        self._session = session
        self._action = action
        self._loading = loading

    def __enter__(self) -> None:
        """Checks that the simulation is open and, in the outermost block, that libsumo holds it."""
        session = self._session
        if not session.is_open:
            raise TrafficError(
                f"{self._action}: this belongs to a simulation that has ended; take "
                "traffic.vehicles / traffic.signals of the running one, or call reset()"
            )
        if session._guards == 0 and not self._loading:
            session.check_held()
        session._guards += 1

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._session._guards -= 1
        if error is None:
            return
        session = self._session
        api = session.api
        foreign = (api.TraCIException, api.libsumo.FatalTraCIError, OSError, RuntimeError)
        text = session.explain(error) if isinstance(error, foreign) else None
        session.close()
        if text is not None:
            raise TrafficError(f"SUMO failed while {self._action}: {text}") from error


def _holds(api: Any, error_log: str) -> bool:
    """Whether libsumo holds the simulation with this error log; each has its own."""
    if not api.isLoaded():
        return False
    try:
        return bool(api.simulation.getOption("error-log") == error_log)
    except (api.TraCIException, api.libsumo.FatalTraCIError, RuntimeError):
        return True  # no options to read: start() has failed half-way


def _unload(api: Any, folder: TemporaryFolder) -> None:
    # A simulation that failed while loading also fails to close, but is gone then.
    with contextlib.suppress(api.TraCIException, api.libsumo.FatalTraCIError, RuntimeError):
        if _holds(api, str(folder.path / ERROR_LOG)):
            api.close()
    folder.cleanup()
