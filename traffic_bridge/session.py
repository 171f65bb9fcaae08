"""One libsumo simulation: started, guarded and closed. The only module that imports libsumo."""

from __future__ import annotations

import contextlib
import os
import tempfile
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

from iits_mj.errors import TrafficError


def load_libsumo() -> Any:
    """Imports libsumo without its chatter on the terminal.

    Raises:
      TrafficError: the package is missing.
    """
    before = os.environ.get("LIBSUMO_AS_TRACI")
    # libsumo prints a warning about pyarrow's version unless this says "quiet" at import.
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


@contextlib.contextmanager
def _captured_stderr(path: Path) -> Iterator[None]:
    """Sends what native code writes to stderr into a file: SUMO explains itself only there."""
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
    """Refuses a file on which SUMO would die instead of complaining (without a version it does).

    Raises:
      TrafficError: the file is missing, not well-formed XML, or has no version, place or lanes.
    """
    try:
        status = net.stat()
        lanes, placed = _survey(net, status.st_mtime_ns, status.st_size)
    except (OSError, ElementTree.ParseError, UnicodeError) as error:
        raise TrafficError(f"loading {net}: not a SUMO network: {error}") from error
    if lanes == 0 or not placed:
        missing = "no lanes" if placed else "no version or no complete <location>"
        raise TrafficError(f"loading {net}: not a SUMO network: it has {missing}")


@lru_cache(maxsize=16)
def _survey(net: Path, _changed: int, _size: int) -> tuple[int, bool]:
    """Number of lanes, and whether version and place are said; kept while the file is the same."""
    count, versioned, placed = 0, False, False
    for event, element in ElementTree.iterparse(net, events=("start", "end")):
        if event == "end":
            element.clear()
        elif element.tag == "lane":
            count += 1
        elif element.tag == "net":
            versioned = element.get("version") is not None
        elif element.tag == "location":
            placed = {"netOffset", "convBoundary", "origBoundary"} <= set(element.keys())
    return count, versioned and placed


class Session:
    """A loaded SUMO simulation. There can be one in a process (libsumo has one global world).

    Args:
      net: the SUMO network file.
      additional: content of an additional file (vehicle types), XML text.
      step_length: [s].
      seed: of SUMO's generator.
      options: further SUMO options.

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
        self._open = False
        if self.api.isLoaded():
            raise TrafficError(
                "a SUMO simulation is already running in this process and libsumo can hold only "
                "one; close() it first, or run the second one in another process"
            )
        self._folder = tempfile.TemporaryDirectory(prefix="iits_mj_sumo_")
        folder = Path(self._folder.name)
        self._error_log = folder / "errors.txt"
        self._stderr = folder / "stderr.txt"
        types = folder / "types.add.xml"
        types.write_text(f"<additional>{additional}</additional>", encoding="utf-8")
        command = [
            "sumo",
            *("--net-file", str(net), "--additional-files", str(types)),
            *("--step-length", str(step_length), "--seed", str(seed % 2**31)),
            *("--time-to-teleport", "-1", "--collision.action", "warn"),
            *("--max-depart-delay", "5", "--error-log", str(self._error_log)),
            # Each vehicle is tried by itself: the road is filled in one step.
            *("--eager-insert", "true"),
            *("--no-step-log", "true", "--no-warnings", "true", "--xml-validation", "never"),
            *options,
        ]
        check_net(net)
        self._open = True
        with self.guard(f"loading {net}"), _captured_stderr(self._stderr):
            self.api.start(command)

    @contextlib.contextmanager
    def guard(self, action: str) -> Iterator[None]:
        """Turns SUMO's errors into a `TrafficError` that says what was being done, and closes."""
        try:
            yield
        except (
            self.api.TraCIException,
            self.api.libsumo.FatalTraCIError,
            OSError,
            RuntimeError,
        ) as error:
            text = self._explanation(str(error))
            self.close()
            raise TrafficError(f"SUMO failed while {action}: {text}") from error
        except BaseException:
            self.close()
            raise

    def step(self) -> None:
        """Advances the simulation by one step."""
        if not self._open:
            raise TrafficError("the SUMO simulation is closed; call reset() to start it again")
        with self.guard("stepping"):
            self.api.simulationStep()

    def close(self) -> None:
        """Unloads the simulation; may be called again."""
        if not self._open:
            return
        self._open = False
        # A start() that failed half-way leaves a simulation loaded, whose close() may fail in turn.
        with contextlib.suppress(self.api.TraCIException, self.api.libsumo.FatalTraCIError):
            self.api.close()
        self._folder.cleanup()

    @property
    def is_open(self) -> bool:
        """True while SUMO runs."""
        return self._open

    def _explanation(self, text: str) -> str:
        parts = [text.strip()]
        for path in (self._stderr, self._error_log):
            if path.is_file():
                parts += path.read_text(encoding="utf-8", errors="replace").splitlines()
        lines: list[str] = []
        for part in parts:
            line = part.replace("Error:", "").strip()
            if line and line not in lines and not line.startswith("Quitting"):
                lines.append(line)
        return "; ".join(lines)[:600] or "no explanation given"
