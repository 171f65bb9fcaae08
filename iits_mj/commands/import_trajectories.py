"""Place recorded trajectories on a map and write them as a recording for 'iits-mj replay'.

The content of the file determines its format: NGSIM table, reconstructed NGSIM pairs, highD-like
tracks, SUMO's floating-car data, or a recording of 'iits-mj record'.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

from iits_mj.commands.output import prepare_file
from iits_mj.core.errors import InputError
from iits_mj.core.options import option
from iits_mj.core.progress import task
from iits_mj.road.route_choice import route_option
from iits_mj.simulation.parts import load_map
from traffic_bridge.datasets import (
    ImportConfig,
    import_trajectories,
    read_trajectories,
    without_noise,
    write_fcd,
)
from traffic_bridge.recording.file import target


@dataclass(frozen=True, kw_only=True)
class Options:
    """Flags of `iits-mj import-trajectories`."""

    data: Path = option(help="data set to place on the map", metavar="FILE", positional=True)
    file: Path = option(help="recording to write", metavar="OUT.npz", group="output")
    map: Path | None = option(
        None,
        help="map (.xodr, .osm, .net.xml); without it the built-in 15 km highway",
        metavar="FILE.xodr",
        group="road",
    )
    route: str | None = route_option()
    start_station: float = option(
        0.0,
        help="station of the map's route at which the data set begins",
        unit="m",
        low=-1e6,
        high=1e6,
        group="road",
    )
    lanes: str | None = option(
        None,
        help="lane of the map for each lane of the data set, as in 0:1,1:2; lane 0 is nearest to "
        "the edge of the road; other lanes are left out; without it every lane keeps its number",
        metavar="MAP",
        group="road",
    )
    begin: float | None = option(
        None, help="leave out data before this time of the data set", unit="s", group="data"
    )
    end: float | None = option(
        None, help="leave out data from this time of the data set on", unit="s", group="data"
    )
    filter_noise: bool = option(
        False, help="smooth raw positions, for NGSIM tables as published", group="data"
    )
    units: str | None = option(
        None,
        help="unit of lengths in an NGSIM table; without it ft, as published",
        choices=("ft", "m"),
        group="data",
    )
    main_lanes: int | None = option(
        None,
        help="number of lanes of an NGSIM site without its ramps, which are left out",
        low=1,
        high=30,
        group="data",
    )
    location: str | None = option(
        None,
        help="site in an NGSIM table of several sites, such as us-101",
        metavar="NAME",
        group="data",
    )
    direction: int | None = option(
        None,
        help="driving direction of highD-like tracks; without it the one with more vehicles",
        low=1,
        high=2,
        group="data",
    )
    fcd: Path | None = option(
        None, help="also write SUMO's floating-car data", metavar="FILE.xml[.gz]", group="output"
    )


def run(options: Options) -> int:
    """Reads the trajectories, places them on the map and writes the recording."""
    prepare_file(target(options.file), "--file")
    if options.fcd is not None:
        prepare_file(options.fcd, "--fcd")
    with task("reading the data"):
        trajectories = read_trajectories(
            options.data,
            units=options.units,
            main_lanes=options.main_lanes,
            location=options.location,
            direction=options.direction,
        )
    if options.begin is not None or options.end is not None:
        begin = -math.inf if options.begin is None else options.begin
        end = math.inf if options.end is None else options.end
        whole = (float(trajectories.time.min()), float(trajectories.time.max()))
        trajectories = trajectories.between(begin, end)
        if not len(trajectories):
            raise InputError(
                f"--begin {begin:g}, --end {end:g}: no data between them; use times from "
                f"{whole[0]:g} to {whole[1]:g} s"
            )
    if options.filter_noise:
        trajectories = without_noise(trajectories)
    config = ImportConfig(start_station=options.start_station, lane_map=lane_map(options.lanes))
    route = load_map(options.map).route(along=options.route)
    with task("placing the trajectories"):
        recording = import_trajectories(trajectories, route, config)
        path = recording.save(options.file)
    for note in recording.meta["notes"]:
        print(f"note: {note}")
    print(
        f"{path}: {len(recording.ids)} vehicles in {recording.time[-1]:.1f} s, "
        f"{len(recording.vehicle)} positions"
    )
    if options.fcd is not None:
        print(f"floating-car data: {write_fcd(recording, options.fcd)}")
    return 0


def lane_map(text: str | None) -> dict[int, int] | None:
    """Returns the lanes of a text such as `0:1,1:2`.

    Raises:
      InputError: the text has another form.
    """
    if text is None:
        return None
    pairs = [part.strip().split(":") for part in text.split(",")]
    good = all(len(pair) == 2 and all(word.strip().isdecimal() for word in pair) for pair in pairs)
    if not good or len({pair[0].strip() for pair in pairs}) != len(pairs):
        raise InputError(f"--lanes {text!r}: use the form 0:1,1:2 with each lane of the set once")
    return {int(lane): int(target) for lane, target in pairs}
