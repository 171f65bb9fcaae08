"""Drive in SUMO traffic and store the traffic and the truck's way through it.

The file serves 'iits-mj replay FILE' and, from Python, traffic_bridge's ReSim and RepSim.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from iits_mj.commands.output import prepare_folder, progress_bar
from iits_mj.options import option
from iits_mj.simulation import DriveConfig, Simulation


@dataclass(frozen=True, kw_only=True)
class Options(DriveConfig):
    """Flags of `iits-mj record`."""

    file: Path = option(help="recording to write", metavar="FILE.npz", positional=True)


def run(options: Options) -> int:
    """Drives without pictures and writes the recording, also of an interrupted drive."""
    prepare_folder(options.file.parent, "FILE")
    with Simulation(options, record=True) as simulation:
        try:
            with progress_bar(options.duration) as progress:
                summary = simulation.run(progress=progress)
        except KeyboardInterrupt:
            simulation.save_recording(options.file)
            raise
        path = simulation.save_recording(options.file)
    print(summary.to_text())
    print(f"recording: {path}")
    return 0
