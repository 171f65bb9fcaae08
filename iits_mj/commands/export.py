"""Write a scenario or a recorded drive as OpenSCENARIO XML with its map, or as OSI ground truth.

A file of events (.toml) becomes stories with triggers and actions. 'iits-mj record' makes the
recording (.npz) of a drive, 'iits-mj import-trajectories' that of measured traffic: the road users
of its scenario repeat what they did.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from iits_mj.commands.output import prepare_file
from iits_mj.core.errors import InputError
from iits_mj.core.options import given_in, given_names, option
from iits_mj.core.progress import remark, task
from iits_mj.parameters import AnyTruck, TruckParameters
from iits_mj.simulation.config import DriveConfig
from iits_mj.simulation.drive_log import options_of, truck_of
from iits_mj.simulation.parts import load_map, load_route
from traffic_bridge.recording.provenance import check_map, load

# The options of a scenario are those of a drive.
_DRIVE: dict[str, Any] = {
    each.name: dataclasses.field(default=each.default, metadata=each.metadata)
    for each in dataclasses.fields(DriveConfig)
}


@dataclass(frozen=True, kw_only=True)
class Options:
    """Flags of `iits-mj export`."""

    file: Path = option(help="scenario or recording", metavar="FILE.toml|FILE.npz", positional=True)
    xosc: Path | None = option(
        None,
        help="write OpenSCENARIO XML 1.3, and the map as .xodr beside it",
        metavar="FILE.xosc",
        group="output",
    )
    osi: Path | None = option(
        None, help="write OSI ground truth of a recording", metavar="FILE.mcap", group="output"
    )
    map: Path | None = _DRIVE["map"]
    truck: AnyTruck | None = _DRIVE["truck"]
    route: str | None = _DRIVE["route"]
    start_station: float = _DRIVE["start_station"]
    start_lane: int = _DRIVE["start_lane"]
    start_speed: float = _DRIVE["start_speed"]
    param: tuple[str, ...] = _DRIVE["param"]
    speed: float = _DRIVE["speed"]
    duration: float = _DRIVE["duration"]
    given: frozenset[str] = given_names()


def run(options: Options) -> int:
    """Writes the files.

    Raises:
      InputError: no file is asked for, the recording was made on another map or with another truck,
        or a file cannot be written.
    """
    events = options.file.suffix == ".toml"
    if not events and options.xosc is None and options.osi is None:
        raise InputError("nothing to write: give --xosc FILE.xosc, --osi FILE.mcap, or both")
    if events:
        return _export_events(options)
    unused = [n for n in given_in(options) if n not in ("file", "xosc", "osi", "map", "truck")]
    if unused:
        raise InputError(f"{unused[0]} is of a scenario, and {options.file} is a recording")
    recording, name = load(options.file)
    along, parameters = None, None
    if "drive" in recording.meta:
        stored = options_of(recording, name)
        along = stored.get("route")
        parameters = TruckParameters.load(truck_of(stored, name, options.truck))
    elif options.truck is not None:
        raise InputError(f"{name}: traffic without a drive has no truck; leave --truck out")
    route = load_map(options.map).route(along=along)
    check_map(recording, name, route)
    if options.xosc is not None:
        from iits_mj.export import openscenario

        prepare_file(options.xosc, "--xosc")
        with task("writing OpenSCENARIO"):
            scenario, road = openscenario.write_recording(
                options.xosc, recording, parameters, route
            )
        print(f"scenario: {scenario}")
        print(f"map: {road}")
    if options.osi is not None:
        from iits_mj.export import osi

        prepare_file(options.osi, "--osi")
        with task("writing OSI ground truth"):
            count = osi.write_recording(options.osi, recording, parameters, route)
        print(f"OSI ground truth, {count} messages: {options.osi}")
    return 0


def _export_events(options: Options) -> int:
    """Writes a file of events."""
    from iits_mj.export import storyboard

    if options.xosc is None:
        raise InputError(f"{options.file} is a scenario: give --xosc FILE.xosc")
    if options.osi is not None:
        raise InputError("osi is of a recorded drive: make one with iits-mj record --events")
    values = {name: getattr(options, name) for name in _DRIVE if hasattr(options, name)}
    config = DriveConfig(**values, events=options.file, traffic_mode="none")
    prepare_file(options.xosc, "--xosc")
    parameters = TruckParameters.load(config.truck)
    with task("writing OpenSCENARIO"):
        scenario, road, remarks = storyboard.write_events(
            options.xosc, config, load_route(config), parameters
        )
    for each in remarks:
        remark(each)
    print(f"scenario: {scenario}")
    print(f"map: {road}")
    print(f"to drive it: iits-mj drive --scenario {scenario} --speed {config.speed:g}")
    return 0
