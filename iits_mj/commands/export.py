"""Write a recorded drive as OpenSCENARIO XML with its map, or as OSI ground truth.

'iits-mj record' makes the recording of a drive, with or without scripted events; 'iits-mj
import-trajectories' that of measured traffic. The road users of the scenario repeat what they did.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from iits_mj.commands.output import prepare_file
from iits_mj.core.errors import InputError
from iits_mj.core.options import option
from iits_mj.core.progress import task
from iits_mj.parameters import AnyTruck, TruckParameters, truck_option
from iits_mj.simulation.drive_log import options_of, truck_of
from iits_mj.simulation.parts import load_map
from traffic_bridge.recording.provenance import check_map, load


@dataclass(frozen=True, kw_only=True)
class Options:
    """Flags of `iits-mj export`."""

    file: Path = option(help="recording", metavar="FILE.npz", positional=True)
    xosc: Path | None = option(
        None,
        help="write OpenSCENARIO XML 1.3, and the map as .xodr beside it",
        metavar="FILE.xosc",
        group="output",
    )
    osi: Path | None = option(
        None, help="write OSI ground truth", metavar="FILE.mcap", group="output"
    )
    map: Path | None = option(
        None,
        help="map of the recording; without it the built-in 15 km highway",
        metavar="FILE.xodr",
        group="road",
    )
    truck: AnyTruck | None = truck_option("truck of the recording, if it is not a shipped one")


def run(options: Options) -> int:
    """Writes the files.

    Raises:
      InputError: no file is asked for, the recording was made on another map or with another truck,
        or a file cannot be written.
    """
    if options.xosc is None and options.osi is None:
        raise InputError("nothing to write: give --xosc FILE.xosc, --osi FILE.mcap, or both")
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
