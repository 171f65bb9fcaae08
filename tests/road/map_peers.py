"""Reads SUMO nets and runs netconvert, for comparison with our roads."""

from __future__ import annotations

import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from tests.paths import DATA, needs

NAMES = ("crest-curve", "curves_elevation", "e6mini", "fabriksgatan_traffic_lights", "velodrome")
OUTSIDE_MAPS = [
    pytest.param(DATA / file, marks=needs(file), id=Path(file).stem)
    for file in (f"xodr/esmini_{name}.xodr" for name in NAMES)
]
"""Real maps from outside the repository, as parameters of a test."""


def netconvert() -> str | None:
    beside = Path(sys.executable).with_name("netconvert")
    return str(beside) if beside.is_file() else shutil.which("netconvert")


def convert(xodr: Path, net: Path, resolution: float = 1.0) -> subprocess.CompletedProcess[str]:
    program = netconvert()
    assert program is not None
    return subprocess.run(
        [
            program,
            "--opendrive",
            str(xodr),
            "-o",
            str(net),
            "--no-turnarounds",
            "--opendrive.curve-resolution",
            str(resolution),
            "--geometry.max-grade",
            "30",
        ],
        capture_output=True,
        text=True,
        check=False,
    )


@dataclass(frozen=True)
class NetLane:
    """A lane of a net: id of its OpenDRIVE road, direction of travel, index from the right."""

    road_id: str
    direction: int
    index: int
    speed: float
    shape: np.ndarray


def read_net(path: Path) -> list[NetLane]:
    root = ElementTree.parse(path).getroot()
    shift = np.array([*map(float, root.find("location").get("netOffset").split(",")), 0.0])
    lanes = []
    for edge in root.findall("edge"):
        identity = edge.get("id")
        if identity.startswith(":"):
            continue
        road_id = identity.lstrip("-").split("#")[0].split(".")[0]
        for lane in edge.findall("lane"):
            points = [[*map(float, point.split(","))] for point in lane.get("shape").split()]
            shape = np.array([point if len(point) == 3 else [*point, 0.0] for point in points])
            lanes.append(
                NetLane(
                    road_id,
                    1 if identity.startswith("-") else -1,
                    int(lane.get("index")),
                    float(lane.get("speed")),
                    shape - shift,
                )
            )
    return lanes
