"""Drive the truck along a road in SUMO traffic, controlled by its driving stack.

Without options of the drive itself it is a demo of a minute: leaving a tunnel the truck overtakes
two slow trucks, returns to the right lane, and brakes with its retarder behind slower traffic on a
descent. With any such option, for instance --duration, it is a drive in ordinary traffic from
--start-station on.

Writes drive.mp4, telemetry.csv, summary.json, and report.html, a page with plots that answers to
the reader, into --out. Exit code: 0 after a drive without failure; 1 after a collision, a roll-over
or a divergence of the simulation; 2 after wrong use.
"""

from __future__ import annotations

import dataclasses
import hashlib
import importlib.metadata
import json
import platform
import shlex
import sys
from collections.abc import Callable, Mapping
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

import iits_mj
from iits_mj.commands.config_file import rules_of
from iits_mj.commands.output import camera_option, drive_progress, prepare_folder, weather_option
from iits_mj.core import options as option_fields
from iits_mj.core.errors import Error, RenderError
from iits_mj.core.options import option
from iits_mj.core.output_files import write_whole
from iits_mj.core.own_parts import part_name, source_digest
from iits_mj.core.progress import remark, task
from iits_mj.j1939 import CommandReceiver
from iits_mj.j1939.log_files import WRITTEN
from iits_mj.parameters import check_truck
from iits_mj.render.cameras import Camera
from iits_mj.render.drive_page import DriveReport
from iits_mj.render.film_process import FilmProcess, FilmSettings
from iits_mj.render.pages import Film
from iits_mj.road import Route
from iits_mj.simulation import DriveConfig, DriveSummary, Observer, Simulation, Telemetry
from iits_mj.simulation.config import PARTS, with_level_start
from iits_mj.simulation.conflicts import ConflictLog
from iits_mj.simulation.drive_log import BusLog, check_given
from iits_mj.simulation.drive_table import DriveTable
from iits_mj.simulation.driver import LogDriver
from iits_mj.simulation.frame import SAME_LINE, DivergedError
from iits_mj.simulation.lock_step import Driver
from iits_mj.simulation.parts import road_user_slots, with_scenario
from iits_mj.simulation.summary import counts_text, to_text
from iits_mj.simulation.telemetry import speed_object, speed_rows
from iits_mj.truck import Truck

INTERRUPTED = 130
# The drive without options; found by trying seeds and stations.
DEMO: Mapping[str, Any] = {
    "start_station": 1420.0,
    "seed": 4,
    "duration": 60.0,
    "density": "medium",
    "traffic_speed": 14.0,
    "speed": 20.0,
    "speed_planner": "cruise",
    "decision": "lookahead",
    "events": Path(__file__).with_name("demo.toml"),
}
LONGEST_REPLAY = 300.0  # [s]; a minute takes 1 to 2 MB of the replay's page
UNSTEERED = (
    "No steering command (IITS_COMMAND) was accepted, and the truck does not obey the accelerator "
    "without steering: use replay-can --keep-lane, which steers instead of the log."
)


@dataclass(frozen=True, kw_only=True)
class Kept:
    """Options of the files that a drive writes."""

    out: Path = option(Path("out"), help="folder for all output", metavar="DIR", group="output")
    video: bool = option(True, help="write drive.mp4", group="output")
    size: tuple[int, int] = option(
        (960, 540), help="size of the video in pixels", metavar="WxH", group="output"
    )
    camera: str | type[Camera] | Camera = camera_option()
    weather: str = weather_option()
    fps: int = option(20, help="pictures per second of the video", low=5, high=50, group="output")
    can_log: Path | None = option(
        None,
        help="write commands and reports of the truck's CAN bus; the suffix selects the format: "
        f"{', '.join(WRITTEN)}",
        metavar="FILE",
        group="output",
    )
    bag: Path | None = option(
        None,
        help="write the messages between the modules as a ROS 2 bag (MCAP), for Foxglove, "
        "'ros2 bag' and 'iits-mj replay-stage'",
        metavar="DIR",
        group="output",
    )
    xosc: Path | None = option(
        None,
        help="write what all road users did as OpenSCENARIO XML, with the map as .xodr beside it",
        metavar="FILE.xosc",
        group="output",
    )
    osi: Path | None = option(
        None,
        help="write OSI ground truth of all road users (MCAP)",
        metavar="FILE.mcap",
        group="output",
    )
    replay: bool = option(
        False,
        help="write replay.html, the drive in 3-D for a browser; the report opens it",
        group="output",
    )
    json: bool = option(False, help="print the summary as one JSON object", group="output")


@dataclass(frozen=True, kw_only=True)
class Options(Kept, DriveConfig):
    """Flags of `iits-mj drive`: the drive itself and its files."""

    given: frozenset[str] = option_fields.given_names()


@dataclass(frozen=True, slots=True)
class Job:
    """A drive to perform.

    Attributes:
      command: name; options: all flags; config: of the drive; kept: options of its files.
      driver: makes the driver; None for the driving stack.
      duration: expected [s], None when it is unknown.
    """

    command: str
    options: Any
    config: DriveConfig
    kept: Kept
    driver: Callable[[Route, Truck], Driver] | None = None
    duration: float | None = None


@dataclass(frozen=True, slots=True)
class Outcome:
    """The result of a drive, finished or interrupted.

    Attributes:
      summary, telemetry: of the drive; video: path, or None; notes: for the report.
      receiver: of command frames, None for direct commands; logged: number of logged frames.
      driver: of the truck; route: the road; lights: stations of the stop lines of lights [m].
      replay: page with the drive in 3-D, or None.
      conflicts: with the vehicles of scripted events, None without events.
    """

    summary: DriveSummary
    telemetry: Telemetry
    video: Path | None
    notes: tuple[str, ...]
    receiver: CommandReceiver | None
    logged: int
    driver: Driver
    route: Route
    lights: tuple[float, ...]
    replay: Path | None = None
    conflicts: ConflictLog | None = None

    def frames(self) -> dict[str, Mapping[str, int]]:
        """Returns the counts of command frames by outcome; empty for direct commands."""
        heard = self.receiver
        if heard is None:
            return {}
        return {
            "accepted": heard.accepted,
            "rejected": heard.rejected,
            "ignored": heard.ignored,
            "lost": heard.lost,
        }

    def rows(self) -> list[tuple[str, str]]:
        """Returns name and value of every figure."""
        rows = self.summary.rows() + speed_rows(self.driver)
        if self.conflicts is not None:
            rows += self.conflicts.rows()
        rows += [(f"frames {what}", counts_text(n)) for what, n in self.frames().items()]
        return rows


def run(options: Options, command: str = "drive") -> int:
    """Drives, writes all files and prints the summary; returns the exit code."""
    check_given(options, options.given)
    prepare_folder(options.out)
    if _is_default(options):
        flags = " ".join(
            f"--{name.replace('_', '-')} {value}"
            for name, value in DEMO.items()
            if not isinstance(value, Path)
        )
        remark(f"demo drive with its own traffic events ({flags})")
        options = dataclasses.replace(options, **DEMO)
    options = with_scenario(with_level_start(options, options.given))
    return perform(Job(command, options, options, options, duration=options.duration))


def effective(options: Options) -> Options:
    """Returns the options in force: those of the demo for the demo, and all of them as given.

    In recorded traffic some options have no effect and must not be given.
    """
    if _is_default(options):
        options = dataclasses.replace(options, **DEMO)
    options = with_level_start(options, options.given)
    if options.recording is not None:
        return options
    return dataclasses.replace(options, given=frozenset(rules_of(type(options))))


def _is_default(options: Options) -> bool:
    """Returns whether no option of the drive itself was given."""
    names = [field.name for field in dataclasses.fields(DriveConfig)]
    plain = DriveConfig()
    return options.given.isdisjoint(names) and all(
        getattr(options, name) == getattr(plain, name) for name in names
    )


def perform(job: Job) -> int:
    """Drives, writes all files and prints the summary; returns the exit code."""
    prepare_folder(job.kept.out)
    outcome, interrupted = _drive(job)
    with task("writing the report"):
        pages = _write(job, outcome)
    if job.kept.json:
        print(json.dumps(_summary_object(job, outcome), allow_nan=False))
    else:
        print(to_text(outcome.rows()))
        for name, path in pages:
            print(f"{name}: {path}")
    if interrupted:
        return INTERRUPTED
    return 1 if outcome.summary.failed else 0


def _drive(job: Job) -> tuple[Outcome, bool]:
    """Runs the simulation; returns its outcome and whether it was interrupted."""
    interrupted, kept = False, job.kept
    # A bag is complete after the film, whose pictures it has.
    with ExitStack() as bags, ExitStack() as stack:
        # The process of the film loads while the simulation does. The film has the model with road
        # and landscape; the drive is the same without.
        film = stack.enter_context(_film(kept, job.config)) if kept.video else None
        simulation = stack.enter_context(Simulation(job.config, driver=job.driver, visuals=False))
        telemetry = stack.enter_context(Telemetry(kept.out / "telemetry.csv"))
        observers: list[Observer] = [telemetry]
        conflicts = ConflictLog() if job.config.has_events else None
        if conflicts is not None:
            observers.append(conflicts)
        log = None
        if kept.can_log is not None:
            log = stack.enter_context(BusLog(kept.can_log, simulation.truck))
            observers.append(log)
        if kept.bag is not None:
            # Load rosbags only for bags.
            from iits_mj.bag.mcap_file import BagWriter

            video = film.path if film else None
            observers.append(bags.enter_context(BagWriter(kept.bag, simulation, video)))
        if kept.xosc is not None:
            # Load scenariogeneration only for OpenSCENARIO.
            from iits_mj.export.openscenario import XoscLog

            observers.append(stack.enter_context(XoscLog(kept.xosc, simulation)))
        if kept.osi is not None:
            # Load protobuf only for OSI.
            from iits_mj.export.osi import OsiLog

            observers.append(stack.enter_context(OsiLog(kept.osi, simulation)))
        track = None
        if kept.replay:
            # Load viser only for replays.
            from iits_mj.web.track import TrackObserver

            track = TrackObserver(simulation)
            observers.append(track)
        notes: tuple[str, ...] = ()
        if film is not None:
            film, notes = _checked(film)
        if film is not None:
            observers.append(film)
        if isinstance(simulation.driver, LogDriver):
            observers.append(simulation.driver)
        try:
            with drive_progress(job.duration) as progress:
                summary = simulation.run(observers, progress)
        except KeyboardInterrupt:
            interrupted = True
            summary = simulation.summary("interrupted")
        except DivergedError:
            summary = simulation.summary()
        lights = _stop_lines(simulation)
    replay = None
    if track is not None and len(track.track.states) > 1:
        from iits_mj.web.playback import replay_page

        replay = replay_page(track.track, kept.out / "replay.html", duration=LONGEST_REPLAY)
    receiver = _receiver(simulation)
    if receiver is not None and not receiver.accepted["IITS_COMMAND"]:
        print(f"iits-mj: {UNSTEERED}", file=sys.stderr)
        notes += (UNSTEERED,)
    # In a drive of the stack the second sender of XBR is the emergency braking.
    heard = receiver if isinstance(simulation.driver, LogDriver) else None
    for unit, senders in heard.senders.items() if heard is not None else ():
        if len(senders) > 1:
            named = ", ".join(f"0x{address:02X}" for address in senders)
            text = f"{unit} was obeyed from several senders ({named}): --source selects one."
            print(f"iits-mj: {text}", file=sys.stderr)
            notes += (text,)
    for limit in simulation.truck.left_range:
        text = f"The plant {job.config.plant} was not valid all the time: {limit}."
        print(f"iits-mj: {text}", file=sys.stderr)
        notes += (text,)
    video = film.path if film else None
    logged = log.count if log else 0
    driver = simulation.driver
    parts = (summary, telemetry, video, notes, receiver, logged, driver, simulation.route, lights)
    return Outcome(*parts, replay, conflicts), interrupted


def _stop_lines(simulation: Simulation) -> tuple[float, ...]:
    """Stations of the stop lines of lights on the route [m]."""
    traffic = simulation.traffic
    signals = None if traffic is None else traffic.signal_controller()
    found: list[float] = []
    # A drive that ended inside a step of SUMO has a map without lights.
    with suppress(Error):
        while signals and (light := signals.light_ahead(found[-1] + SAME_LINE if found else 0.0)):
            found.append(light.station)
    return tuple(found)


def _receiver(simulation: Simulation) -> CommandReceiver | None:
    """Returns the receiver of command frames, None for direct commands."""
    if isinstance(simulation.driver, LogDriver):
        return simulation.driver.receiver
    return simulation.path.receiver if simulation.path.over_bytes else None


def _film(kept: Kept, config: DriveConfig) -> FilmProcess:
    video = kept.out / "drive.mp4"
    shown = kept.size, kept.camera, kept.fps, kept.weather
    return FilmProcess(FilmSettings(video, config, *shown, road_user_slots(config)))


def _checked(film: FilmProcess) -> tuple[FilmProcess | None, tuple[str, ...]]:
    """Returns the writer of the video; None with a note for the report without OpenGL."""
    try:
        film.check()
    except RenderError as error:
        film.abandon()
        print(f"iits-mj: driving without a video: {error}", file=sys.stderr)
        return None, (f"There is no video: {error}",)
    return film, ()


def _write(job: Job, outcome: Outcome) -> list[tuple[str, Path]]:
    """Writes summary and report; returns names and paths of the main files."""
    out = job.kept.out
    origin = _provenance(job)
    found = _summary_object(job, outcome) | {"provenance": origin}
    content = json.dumps(found, indent=2, allow_nan=False)
    write_whole(out / "summary.json", f"{content}\n".encode(), "summary")
    summary, road = outcome.summary, job.config.map
    where = road.name if road is not None else "the built-in highway"
    versions = ", ".join(f"{name} {version}" for name, version in origin["versions"].items())
    rows = [
        ("command line", f"`{origin['command_line']}`"),
        ("date", origin["date"]),
        ("truck", f"{origin['truck']}, digest of its parameters `{origin['truck_parameters']}`"),
        ("seed", str(job.config.seed)),
        ("versions", versions),
    ]
    for name, own in origin["own_parts"].items():
        text = f"`{own['part']}`, digest of its file `{own['file_sha256']}`"
        rows.insert(3, (f"your own {name.replace('_', ' ')}", text))
    if origin["telemetry_sha256"]:
        text = f"`{origin['telemetry_sha256'][:16]}`, the first digits of `sha256sum telemetry.csv`"
        rows.append(("digest of the drive", text))
    video = outcome.video
    film = None if video is None else Film(f"Film, camera {part_name(job.kept.camera)}", video)
    DriveReport(
        f"iits-mj {job.command}",
        f"{summary.distance / 1e3:.2f} km in {summary.duration:.0f} s on {where}; {summary.ended}",
        outcome.notes,
        DriveTable.of(outcome.telemetry),
        outcome.route,
        outcome.lights,
        outcome.rows(),
        rows,
        _settings(job),
        film,
        outcome.replay,
        outcome.conflicts,
    ).page().write(out / "report.html")
    pages = [
        ("report", out / "report.html"),
        ("telemetry", out / "telemetry.csv"),
    ]
    if outcome.replay is not None:
        pages.append(("replay in 3-D", outcome.replay))
    if job.kept.can_log is not None:
        pages.append((f"CAN log, {outcome.logged} frames", job.kept.can_log))
    if job.kept.xosc is not None:
        pages.append(("OpenSCENARIO", job.kept.xosc))
    if job.kept.osi is not None:
        pages.append(("OSI ground truth", job.kept.osi))
    return [*pages, ("video", outcome.video)] if outcome.video is not None else pages


def _provenance(job: Job) -> dict[str, Any]:
    """Returns what is needed to make the drive again, and the digest that tells whether it is."""
    parameters, telemetry = check_truck(job.config), job.kept.out / "telemetry.csv"
    digest = hashlib.sha256(telemetry.read_bytes()).hexdigest() if telemetry.is_file() else ""
    own_parts = {
        name: {"part": part_name(value), "file_sha256": source_digest(value)}
        for name, kind in PARTS.items()
        if kind.is_own(value := getattr(job.config, name))
    }
    return {
        "command_line": shlex.join(["iits-mj", job.command, *option_fields.words(job.options)]),
        "date": datetime.now().astimezone().isoformat(" ", "seconds"),
        "truck": parameters.name,
        "truck_parameters": parameters.digest()[:12],
        "versions": {
            "iits-mj": iits_mj.__version__,
            "MuJoCo": mujoco.__version__,
            "SUMO": importlib.metadata.version("libsumo"),
            "NumPy": np.__version__,
            "Python": platform.python_version(),
        },
        "telemetry_sha256": digest,
        "own_parts": own_parts,
    }


def _settings(job: Job) -> list[tuple[str, str]]:
    """Returns name and value of every option that is set, with truck and load of the drive."""
    parameters = check_truck(job.config)
    used = {"truck": parameters.name, "payload": parameters.check_payload(job.config.payload)}
    rows = []
    for field in dataclasses.fields(job.options):
        rule = option_fields.of(field)
        if rule is not None:
            value = used.get(field.name, getattr(job.options, field.name))
            if value not in (None, ()):
                rows.append((field.name.replace("_", " "), rule.text(value)))
    return rows


def _summary_object(job: Job, outcome: Outcome) -> dict[str, object]:
    found: dict[str, object] = {
        "command": job.command,
        "version": iits_mj.__version__,
        "seed": job.config.seed,
        "summary": outcome.summary.as_dict(),
        "settings": dict(_settings(job)),
        "notes": list(outcome.notes),
    }
    found |= speed_object(outcome.driver)
    if outcome.conflicts is not None:
        found |= outcome.conflicts.as_dict()
    return found | {what: dict(counts) for what, counts in outcome.frames().items()}
