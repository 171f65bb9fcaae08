"""Drive in recorded traffic, which follows its recording whatever the truck does.

With --verify nothing is driven: SUMO re-runs the recorded traffic from its configuration, seed and
the truck's log, and every pose must come out bit for bit (exit code 1 otherwise).
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from iits_mj.commands import drive
from iits_mj.errors import TrafficError
from iits_mj.options import option
from iits_mj.simulation.parts import load_map
from traffic_bridge import ReSim


@dataclass(frozen=True, kw_only=True)
class Options(drive.Options):
    """Flags of `iits-mj replay`: those of `iits-mj drive`, and the recording."""

    recording: Path | None = option(
        help="recording made by 'iits-mj record'", metavar="FILE.npz", positional=True
    )
    verify: bool = option(False, help="re-run the traffic in SUMO and compare, without driving")


def run(options: Options) -> int:
    """Drives as `iits-mj drive` does, or verifies the recording."""
    if not options.verify:
        return drive.run(options)
    assert options.recording is not None
    with ReSim(load_map(options.map).route(), options.recording) as traffic:
        traffic.reset()
        try:
            digest = traffic.verify()
        except TrafficError as error:
            print(f"{options.recording}: {error}")
            return 1
    print(f"{options.recording}: re-run bit for bit, {len(traffic)} frames, hash {digest[:12]}")
    return 0
