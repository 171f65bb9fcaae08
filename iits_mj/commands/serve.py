"""Serve the truck on a CAN bus in real time: it obeys an external controller and reports.

Ends after --duration, at the end of the road, or with Ctrl-C or SIGTERM (exit code 0), or when the
truck rolls over or leaves the road or the simulation diverges (1). Then prints a summary of the
frames. Exit code 2 after wrong use.
"""

from __future__ import annotations

import contextlib
import json
import signal
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from types import FrameType

import iits_mj
from iits_mj.core.options import option
from iits_mj.core.progress import remark
from iits_mj.simulation import ServeConfig, Server


@dataclass(frozen=True, kw_only=True)
class Options(ServeConfig):
    """Flags of `iits-mj serve`."""

    json: bool = option(False, help="print the summary as one JSON object", group="output")


def run(options: Options) -> int:
    """Serves and prints the summary; returns the exit code."""
    with Server(options, tell=remark) as server, _signals(server.stop):
        remark(f"serving on CAN bus {server.bus.link.name}; Ctrl-C ends it")
        remark(_access(options))
        summary = server.run()
    if options.json:
        content = {"command": "serve", "version": iits_mj.__version__}
        print(json.dumps(content | {"summary": summary.as_dict()}, allow_nan=False))
    else:
        print(summary.to_text())
    return 1 if summary.failed else 0


@contextlib.contextmanager
def _signals(stop: Callable[[str], None]) -> Iterator[None]:
    """Makes Ctrl-C and SIGTERM stop the server instead of the program."""

    def end(number: int, _frame: FrameType | None) -> None:
        stop(f"ended by {signal.Signals(number).name}")

    kinds = (signal.SIGINT, signal.SIGTERM)
    before = [signal.signal(kind, end) for kind in kinds]
    try:
        yield
    finally:
        for kind, handler in zip(kinds, before, strict=True):
            signal.signal(kind, handler)


def _access(options: Options) -> str:
    sender = "every address" if options.any_source else f"address 0x{options.source:02X}"
    if options.bus != "udp_multicast":
        return f"the truck obeys {sender} of the bus"
    if options.reach == "host":
        return f"the truck obeys {sender} on this machine; --reach network opens it to others"
    return f"any machine of the local network can drive the truck as {sender}"
