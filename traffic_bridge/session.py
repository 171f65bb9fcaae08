"""Starts, guards and ends one libsumo simulation; the only module that imports libsumo."""

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
    """Whether this process holds a SUMO simulation; a second one needs its own process.

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
      TrafficError: the file is missing or not well-formed XML; it has no version, location or
        lanes, a lane without length, speed or shape, or an internal lane without a connection.
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
    """Description of a net's fault, or ""; cached while the file does not change."""
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
            if re.search(r"nan|inf", element.get("shape", ""), re.IGNORECASE):
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


class Session:
    """A loaded SUMO simulation; libsumo's global state allows one in a process.

    A session without references is closed. A simulation that other code of the process started
    through libsumo is neither used nor closed.

    Args:
      net: the SUMO network file.
      additional: content of an additional file (vehicle types), XML text.
      step_length: [s].
      seed: of SUMO's generator.
      options: further SUMO options.
      depart_delay: longest time that a vehicle waits for room to depart [s].

    Attributes:
      api: the libsumo module.
      guards: number of the guards entered and not yet left.

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
        depart_delay: float = 5.0,
    ) -> None:
        self.api = load_libsumo()
        self.guards = 0
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
            *("--max-depart-delay", f"{depart_delay:g}", "--error-log", self._error_log),
            # SUMO tries to insert each vehicle separately, which fills the road in one step.
            *("--eager-insert", "true"),
            *("--no-step-log", "true", "--no-warnings", "true", "--xml-validation", "never"),
            *options,
        ]
        self._finalizer = weakref.finalize(self, _unload, self.api, folder)
        with self.guard(f"loading {net}", loading=True), _captured_stderr(self._stderr):
            self.api.start(command)

    def __reduce__(self) -> NoReturn:
        raise TrafficError(
            "a running SUMO simulation cannot be copied or pickled: copy the environment or the "
            "settings before reset(), and reset the copy with the same seed"
        )

    def guard(self, action: str, loading: bool = False) -> Guard:
        """A `with` block for every use of `api`; see `Guard`.

        Args:
          action: for the messages of errors.
          loading: libsumo does not hold this simulation yet.
        """
        return Guard(self, action, loading)

    def function(self, domain: str, name: str) -> Callable[..., Any]:
        """A fast function of libsumo, for calls in every step.

        `function("vehicle", "getSpeed")` returns a function of a vehicle's name. The call from
        libsumo's public function to the native one takes as long as the native function itself. So
        the native function is returned if this version of libsumo has it. It takes all its
        arguments, by position.
        """
        native = getattr(self.api.libsumo, "_libsumo", None)
        found = getattr(native, f"{domain}_{name}", None)
        return found if callable(found) else getattr(getattr(self.api, domain), name)

    def step(self) -> None:
        """Advances the simulation by one step.

        Raises:
          TrafficError: it is closed, SUMO fails, or libsumo holds another simulation.
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
    """A `with` block in which every error ends a simulation.

    SUMO's errors become a `TrafficError` that names the action. The outermost block checks that
    libsumo still holds this simulation, except while loading it.

    Raises:
      TrafficError: on entering, if the simulation has ended or libsumo holds another one, which
        stays open.
    """

    __slots__ = ("_action", "_loading", "_session")

    def __init__(self, session: Session, action: str, loading: bool) -> None:
        self._session = session
        self._action = action
        self._loading = loading

    def __enter__(self) -> None:
        session = self._session
        if not session.is_open:
            raise TrafficError(
                f"{self._action}: this belongs to a simulation that has ended; take "
                "traffic.vehicles / traffic.signals of the running one, or call reset()"
            )
        if session.guards == 0 and not self._loading:
            session.check_held()
        session.guards += 1

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        session = self._session
        session.guards -= 1
        if error is None:
            return
        api = session.api
        native = api.TraCIException, api.libsumo.FatalTraCIError, OSError, RuntimeError
        text = session.explain(error) if isinstance(error, native) else None
        session.close()
        if text is not None:
            raise TrafficError(f"SUMO failed while {self._action}: {text}") from error


def _holds(api: Any, error_log: str) -> bool:
    """Whether libsumo holds the simulation with this error log, unique to each session."""
    try:
        return bool(api.simulation.getOption("error-log") == error_log)
    except (api.TraCIException, api.libsumo.FatalTraCIError, RuntimeError):
        # Without the options there is no simulation, or start() has failed half-way.
        return bool(api.isLoaded())


def _unload(api: Any, folder: TemporaryFolder) -> None:
    # After a failed start, close() fails too, but ends the simulation.
    with contextlib.suppress(api.TraCIException, api.libsumo.FatalTraCIError, RuntimeError):
        if _holds(api, str(folder.path / ERROR_LOG)):
            api.close()
    folder.cleanup()
