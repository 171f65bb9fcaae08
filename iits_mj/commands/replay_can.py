"""Drive the truck with the commands of a CAN log, or decode the log into a table.

The road is empty. The drive starts with the first frame of the log and ends with the last. A log
of 'iits-mj drive' gives the same drive again if map, payload and start are the same. The output is
that of 'iits-mj drive'. A log without steering commands needs --keep-lane.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import iits_mj
from iits_mj.commands import drive
from iits_mj.core.errors import InputError
from iits_mj.core.options import option
from iits_mj.core.progress import task
from iits_mj.j1939 import Frame, read_log
from iits_mj.j1939.bus_summary import write_table
from iits_mj.j1939.network import LAST_ADDRESS
from iits_mj.road import Route
from iits_mj.simulation import DriveConfig
from iits_mj.simulation.config import TruckStart
from iits_mj.simulation.driver import LogDriver
from iits_mj.simulation.parts import make_stack
from iits_mj.truck import Truck

# Highest values that `DriveConfig` accepts: the log determines duration and speed.
_LONGEST = 86_400.0
_FASTEST = 30.0


@dataclass(frozen=True, kw_only=True)
class Options(drive.Kept, TruckStart):
    """Flags of `iits-mj replay-can`."""

    file: Path = option(
        help="CAN log: .asc, .blf, .log, .csv, .trc or the text of candump",
        metavar="FILE",
        positional=True,
    )
    duration: float | None = option(
        None,
        help="longest simulated time; without it to the end of the log",
        unit="s",
        low=1.0,
        high=_LONGEST,
        group="run",
    )
    source: int | None = option(
        None,
        help="address of the only sender to obey, such as 0, the engine of a recorded truck, whose "
        "EEC2 has the pedal; without it every sender that may command",
        low=0,
        high=LAST_ADDRESS,
        metavar="ADDRESS",
        group="bus",
    )
    keep_lane: bool = option(
        False, help="steer along the lane and ignore steering in the log", group="bus"
    )
    video: bool = option(False, help="write drive.mp4", group="output")
    decode: Path | None = option(
        None,
        help="do not drive: write every signal of the log to this table and summarize the bus",
        metavar="FILE.csv",
        group="bus",
    )
    all_signals: bool = option(
        False, help="with --decode: write signals that are 'not available', too", group="bus"
    )


def run(options: Options) -> int:
    """Decodes, or drives like `iits-mj drive`.

    Raises:
      InputError: an output file is the log itself.
    """
    for flag, path in (("decode", options.decode), ("can-log", options.can_log)):
        if path is not None and _same(path, options.file):
            raise InputError(f"--{flag} {str(path)!r} is the input log itself; name another file")
    if options.decode is not None:
        return _decode(options, options.decode)
    start = {f.name: getattr(options, f.name) for f in dataclasses.fields(TruckStart)}
    config = DriveConfig(
        **start,
        speed=_FASTEST,
        duration=options.duration or _LONGEST,
        traffic_mode="none",
        decision="keep",
        speed_planner="cruise",
    )

    def driver(route: Route, truck: Truck) -> LogDriver:
        keeper = make_stack(config, route, truck.parameters) if options.keep_lane else None
        return LogDriver(
            read,
            route,
            steering_angle_max=truck.parameters.steering.angle_max,
            source=options.source,
            keeper=keeper,
        )

    def read() -> Iterable[Frame]:
        return read_log(options.file)

    return drive.perform(
        drive.Job("replay-can", options, config, options, driver, options.duration)
    )


def _same(path: Path, other: Path) -> bool:
    return path.exists() and other.exists() and path.samefile(other)


def _decode(options: Options, path: Path) -> int:
    """Writes the table and prints a summary of the bus as text or JSON."""
    with task("decoding"):
        summary = write_table(read_log(options.file), path, only_values=not options.all_signals)
    if options.json:
        content = {"command": "replay-can", "version": iits_mj.__version__, "table": str(path)}
        print(json.dumps(content | summary.as_dict(), allow_nan=False))
    else:
        print(summary.text())
        print(f"table: {path}")
    return 0
