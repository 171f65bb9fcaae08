"""Draw a film, or one picture, of a recorded drive.

The recording is of 'iits-mj record' or a bag of 'iits-mj drive --bag'. Nothing is simulated, so any
camera, weather and size can be chosen afterwards. A recording (.npz) holds no plans: the path that
the truck drove stands for them.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from pathlib import Path

from PIL import Image

from iits_mj.commands.output import camera_option, prepare_file, weather_option
from iits_mj.core.errors import InputError
from iits_mj.core.options import option
from iits_mj.core.progress import each
from iits_mj.parameters import AnyTruck, truck_option
from iits_mj.render.cameras import Camera
from iits_mj.render.recorded import Record, RecordedDrive, times_of
from iits_mj.render.video import Film, Mp4Encoder, Pictures, frame_period
from iits_mj.simulation.drive_log import FILES
from iits_mj.simulation.redrive import recorded_config
from traffic_bridge import Recording

PICTURES = (".png", ".jpg", ".jpeg")
_QUALITY = 88


@dataclass(frozen=True, kw_only=True)
class Options:
    """Flags of `iits-mj render`."""

    recording: Path = option(
        help="recording of 'iits-mj record' (.npz), or bag of 'iits-mj drive --bag'",
        metavar="RECORDING",
        positional=True,
    )
    out: Path = option(
        Path("drive.mp4"),
        help="film to write (.mp4), or picture of the first instant (.png, .jpg)",
        metavar="FILE",
        group="output",
    )
    camera: str | type[Camera] | Camera = camera_option()
    weather: str = weather_option()
    size: tuple[int, int] = option(
        (960, 540), help="size of the pictures", metavar="WxH", group="output"
    )
    fps: int = option(20, help="pictures per second", low=1, high=50, group="output")
    start: float | None = option(
        None,
        help="time of the first picture; without it the recording's begin",
        unit="s",
        low=0.0,
        group="output",
    )
    end: float | None = option(
        None,
        help="time of the last picture; without it the recording's end",
        unit="s",
        low=0.0,
        group="output",
    )
    instruments: bool = option(
        True, help="draw instruments and the map of the lanes", group="output"
    )
    plan: bool = option(True, help="draw the planned path on the road", group="output")
    map: Path | None = option(
        None,
        help="OpenDRIVE map of the drive; without it the built-in highway",
        metavar="FILE",
        group="road",
    )
    truck: AnyTruck | None = truck_option("truck of the drive", "the recorded one")


def run(options: Options) -> int:
    """Draws and writes the file.

    Raises:
      InputError: the recording, a time or the file's name cannot be used.
      RenderError: OpenGL or ffmpeg is missing.
    """
    suffix = options.out.suffix.lower()
    if suffix not in (".mp4", *PICTURES):
        raise InputError(
            f"--out {str(options.out)!r} is not allowed: its name must end in .mp4, "
            f"{', '.join(PICTURES[:-1])} or {PICTURES[-1]}"
        )
    prepare_file(options.out, "--out")
    drive = RecordedDrive(read_record(options.recording, options.map, options.truck))
    start = drive.start if options.start is None else options.start
    end = drive.end if options.end is None else options.end
    if not drive.start <= start <= end <= drive.end:
        raise InputError(
            f"--start {start:g} to --end {end:g} s is not in the recording: "
            f"use {drive.start:g} to {drive.end:g} s"
        )
    pictures = Pictures(
        drive.truck,
        options.size,
        options.camera,
        options.weather,
        overlay=options.instruments,
        plan=options.plan,
    )
    if suffix != ".mp4":
        with pictures:
            shown = pictures.draw(drive.data, drive.at(start))
        Image.fromarray(shown).save(options.out, quality=_QUALITY)
    else:
        period = frame_period(options.fps)
        with Film(pictures, Mp4Encoder(options.out, pictures.size, 1.0 / period)) as film:
            for time in each(times_of(start, end, period).tolist(), "drawing", "{:.1f} s".format):
                frame = drive.at(min(time, drive.end))
                film.add(drive.data, frame)
    print(f"{'film' if suffix == '.mp4' else 'picture'}: {options.out}")
    return 0


def read_record(path: Path, map_path: Path | None, truck: AnyTruck | None) -> Record:
    """Reads a recording or a bag.

    Raises:
      InputError: it cannot be used, or its drive had another map or truck.
    """
    if path.suffix.lower() == ".npz":
        recording = Recording.load(path)
        config = recorded_config(recording, f"recording {path}", map_path, truck)
        return Record.of_recording(recording, config)
    # Load rosbags only for bags.
    from iits_mj.bag.mcap_file import read_bag

    bag = read_bag(path)
    # Pictures need no file of the drive but its map, and no part of its stack.
    files = dict.fromkeys(name for name in FILES if name != "map")
    config = bag.config(map_path, (), truck=truck, **files)
    times = [state.time for state in bag.states]
    return Record(
        dataclasses.replace(config, commands="direct"),
        bag.states,
        bag.scenes,
        bag.trajectories,
        list(zip(times, bag.obeyed, strict=False)),
    )
