"""Writes the map of the built-in highway and its SUMO net from `tools/highway.toml`.

    python tools/highway_map.py

A test compares the map and the net with the design table.
"""

from __future__ import annotations

import argparse
import re
import sys
import tempfile
from pathlib import Path

from iits_mj.core.errors import Error
from iits_mj.road.design import Design, build
from iits_mj.road.elements import OpenDriveMap
from iits_mj.road.writer import write
from traffic_bridge.network.nets import run_netconvert

TABLE = Path(__file__).resolve().with_name("highway.toml")
MAPS = Path(__file__).resolve().parents[1] / "iits_mj" / "road" / "maps"
# Distance between shape points of the net [m].
CURVE_RESOLUTION = 1.0


def highway() -> OpenDriveMap:
    """The built-in highway's records, from its design table."""
    return build(Design.load(TABLE))


def convert(xodr: Path, net: Path) -> Path:
    """Runs SUMO's netconvert on a map and returns the net's path.

    Raises:
      Error: netconvert is missing, or refuses the map.
    """
    run_netconvert(
        [
            "--opendrive", str(xodr), "--output-file", str(net), "--no-turnarounds",
            "--opendrive.curve-resolution", str(CURVE_RESOLUTION), "--geometry.max-grade", "30",
            "--junctions.limit-turn-speed", "-1", "--precision", "3", "--output.original-names",
        ],
        name=xodr.name,
    )  # fmt: skip
    # The leading comment holds date and paths: the net must not change with them.
    text = net.read_text(encoding="utf-8")
    net.write_text(re.sub(r"<!--.*?-->\s*", "", text, count=1, flags=re.DOTALL), encoding="utf-8")
    return net


def main(arguments: list[str] | None = None) -> int:
    """Writes highway.xodr and highway.net.xml; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=MAPS, help="folder to write to")
    folder = parser.parse_args(arguments).out
    try:
        xodr = write(highway(), folder / "highway.xodr")
        with tempfile.TemporaryDirectory() as scratch:
            plain = build(Design.load(TABLE), tapered=False)
            net = convert(write(plain, Path(scratch) / "x.xodr"), folder / "highway.net.xml")
    except Error as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    print(f"{xodr} ({xodr.stat().st_size} bytes), {net} ({net.stat().st_size} bytes)")
    return 0


if __name__ == "__main__":
    sys.exit(main())
