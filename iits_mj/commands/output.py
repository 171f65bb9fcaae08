"""Files, progress bars and results of commands, and options that several commands share."""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable, Iterator
from concurrent.futures import Executor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import iits_mj
from iits_mj.commands.terminal import show
from iits_mj.core.errors import InputError
from iits_mj.core.options import option
from iits_mj.core.own_parts import FILES, FORMS, part_name
from iits_mj.core.progress import task
from iits_mj.core.results import Results
from iits_mj.render.cameras import CAMERAS, cameras_of
from iits_mj.render.weather import WEATHERS
from iits_mj.scale.ray_executor import RayExecutor

if TYPE_CHECKING:
    from iits_mj.simulation import DriveFrame


def prepare_folder(folder: Path, name: str = "out") -> None:
    """Makes a folder, or keeps an existing one, and checks that it is writable.

    Raises:
      InputError: it cannot be made, is not a folder, or is not writable.
    """
    _check_writable(folder, f"--{name} {str(folder)!r}")


def prepare_file(path: Path, name: str) -> None:
    """Makes the folder of a file and checks that it is writable.

    Raises:
      InputError: the path is a folder, or its folder is not writable.
    """
    shown = f"{name} {str(path)!r}"
    if path.is_dir():
        raise InputError(f"{shown} is a folder; name a file")
    _check_writable(path.parent, shown)


def _check_writable(folder: Path, shown: str) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise InputError(f"{shown} cannot be written: {error.strerror or error}") from None


@contextmanager
def drive_progress(duration: float | None) -> Iterator[Callable[[DriveFrame], None]]:
    """Shows progress over the simulated time [s]; without a duration only the time."""
    total = None if duration is None else round(duration, 1)
    with task("driving", total, "s") as report:

        def progress(frame: DriveFrame) -> None:
            time = frame.time if total is None else min(frame.time, total)
            report(time, f"{frame.ego.speed * 3.6:.0f} km/h")

        yield progress


def camera_option() -> Any:
    """Returns a dataclass field for the cameras of pictures."""
    return option(
        "chase",
        help=f"camera of the pictures, or your own as {FORMS}; several with commas between them "
        "share the picture, as chase,top",
        names=lambda: tuple(CAMERAS),
        test=cameras_of,
        label=part_name,
        metavar="NAME",
        files=FILES,
        group="output",
    )


def weather_option() -> Any:
    """Returns a dataclass field for the weather of pictures."""
    return option(
        "day",
        help="weather and time of day of the pictures, which do not change the drive",
        choices=tuple(WEATHERS),
        group="output",
    )


@dataclass(frozen=True, kw_only=True)
class ResultOptions:
    """Options of every command that returns results."""

    json: bool = option(False, help="print one JSON object instead of the table", group="output")
    report: Path | None = option(
        None,
        help="folder for a report with table and plots, as HTML and Markdown",
        metavar="DIR",
        group="output",
    )


def finish(options: ResultOptions, measure: Callable[[], Results]) -> int:
    """Measures, prints the table or the JSON object, writes the report; returns the exit code.

    The exit code is 0 when every check holds, else 1. The report's folder is checked first.

    Raises:
      InputError: the report cannot be written.
    """
    if options.report is not None:
        prepare_folder(options.report, "report")
    results = measure()
    show(results.to_json(iits_mj.__version__) if options.json else results.to_table())
    if options.report is not None:
        # Load matplotlib only for reports.
        from iits_mj.render.pages import write_results_page

        with task("writing the report"):
            page, text = write_results_page(results, iits_mj.__version__, options.report)
        stream = sys.stderr if options.json else sys.stdout
        print(f"report: {page} (the same as Markdown: {text})", file=stream)
    return 0 if results.ok else 1


@dataclass(frozen=True, kw_only=True)
class ClusterOptions:
    """Options of commands that can work on a cluster."""

    ray: str | None = option(
        None,
        help="run on a Ray cluster instead of this machine: HOST:PORT of its head, auto, or local",
        metavar="ADDRESS",
        group="run",
    )
    shard: int = option(
        5, help="results that a worker returns at a time", low=1, high=10_000, group="run"
    )


def pool_of(options: ClusterOptions, digest: Callable[[], str]) -> Callable[[int], Executor] | None:
    """Returns a maker of cluster workers for `run_sharded`; None for processes of this machine.

    `digest` is of the code that does the work; the workers compare it with theirs.
    """
    address = options.ray
    return None if address is None else lambda _: RayExecutor(address, digest)
