"""Drive in recorded traffic, which does not react to the truck, or verify a recording.

--reactive adds SUMO traffic, which reacts to the recorded vehicles and the truck. --verify repeats
the recorded traffic from its configuration, its seed and the truck's states; name your own traffic
again by --traffic-mode. --verify --drive also repeats the truck's drive from its recorded commands.
Exit code 1 unless every pose and state is equal bit for bit. Another map, truck, version or option
than the recorded one is an error.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from pathlib import Path

from iits_mj.commands import drive
from iits_mj.commands.output import drive_progress
from iits_mj.core.errors import InputError, TrafficError
from iits_mj.core.options import option
from iits_mj.core.progress import task
from iits_mj.simulation.drive_log import check_options
from iits_mj.simulation.parts import load_map
from iits_mj.simulation.redrive import RedriveError, own_traffic_of, redrive
from traffic_bridge import Recording, ReSim


@dataclass(frozen=True, kw_only=True)
class Options(drive.Options):
    """Flags of `iits-mj replay`: those of `iits-mj drive`, and the recording."""

    recording: Path | None = option(
        help="recording of 'iits-mj record' or 'iits-mj import-trajectories'",
        metavar="FILE.npz",
        positional=True,
    )
    verify: bool = option(
        False, help="repeat the traffic in SUMO and compare, without a drive", group="run"
    )
    drive: bool = option(
        False,
        help="with --verify: repeat the truck's drive from its recorded commands, too",
        group="run",
    )


def run(options: Options) -> int:
    """Drives like `iits-mj drive`, or verifies the recording.

    Raises:
      InputError: an option has no effect here, or differs from the recording.
    """
    if options.verify:
        return _verify(options)
    if options.drive:
        raise InputError("--drive needs --verify: use --verify --drive")
    return drive.run(options, "replay")


def _verify(options: Options) -> int:
    assert options.recording is not None
    path = options.recording
    for field in dataclasses.fields(drive.Kept):
        if field.name in options.given:
            flag = field.name.replace("_", "-")
            raise InputError(f"--{flag} has no effect with --verify, which writes no files")
    try:
        lines = _drive_again(path, options) if options.drive else _traffic_again(path, options)
    except (TrafficError, RedriveError) as error:
        print(f"{path}: {error}")
        return 1
    for line in lines:
        print(f"{path}: {line}")
    return 0


def _traffic_again(path: Path, options: Options) -> list[str]:
    recording, name, route = (
        Recording.load(path),
        f"recording {path}",
        load_map(options.map).route(),
    )
    own = None
    if "drive" in recording.meta:
        own = own_traffic_of(recording, name, route, options.traffic_mode, options)
    with ReSim(route, path, own=own) as traffic:
        check_options(recording, name, options, options.given)
        with task("repeating the traffic"):
            digest = traffic.verify()
        return [f"re-run bit for bit, {len(traffic)} frames, hash of poses {digest[:12]}"]


def _drive_again(path: Path, options: Options) -> list[str]:
    recording, name = Recording.load(path), f"recording {path}"
    check_options(recording, name, options, options.given)
    with drive_progress(float(recording.time[-1])) as progress:
        traffic = options.traffic_mode
        same = redrive(recording, name, options.map, options.truck, progress, traffic)
    return [
        f"re-run bit for bit, {same.frames} frames, hash of poses {same.pose_hash[:12]}",
        f"truck driven again bit for bit, {same.commands} commands, "
        f"hash of states {same.truck_hash[:12]}",
    ]
