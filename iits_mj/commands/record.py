"""Drive in SUMO traffic and record the drive: traffic, states and commands of the truck.

'iits-mj replay FILE' drives in the recorded traffic; with --verify it repeats the traffic and
compares every bit. In Python, traffic_bridge.ReSim and traffic_bridge.RepSim read the file.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from iits_mj.commands.output import drive_progress, prepare_file
from iits_mj.core.options import option
from iits_mj.simulation import DriveConfig, Simulation
from iits_mj.simulation.frame import DivergedError
from traffic_bridge.recording.file import target


@dataclass(frozen=True, kw_only=True)
class Options(DriveConfig):
    """Flags of `iits-mj record`."""

    file: Path = option(help="recording to write", metavar="FILE.npz", positional=True)


def run(options: Options) -> int:
    """Drives without a video and writes the recording, also after an interruption."""
    prepare_file(target(options.file), "FILE")
    with Simulation(options, record=True, visuals=False) as simulation:
        try:
            with drive_progress(options.duration) as progress:
                summary = simulation.run(progress=progress)
        except (KeyboardInterrupt, DivergedError):
            simulation.save_recording(options.file)
            raise
        path = simulation.save_recording(options.file)
    print(summary.to_text())
    print(f"recording: {path}")
    return 0
