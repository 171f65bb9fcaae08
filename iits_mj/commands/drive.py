"""Drive the truck with its stack over a road in SUMO traffic.

Leaves in --out: drive.mp4, telemetry.csv, plots, summary.json and report.html, which shows them
all. Exit code 0 when the drive ended well, 1 after a collision, 2 on wrong use.
"""

from __future__ import annotations

import dataclasses
import json
import sys
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import iits_mj
from iits_mj import options as option_fields
from iits_mj.commands.output import prepare_folder, progress_bar, write_json
from iits_mj.errors import RenderError
from iits_mj.options import option
from iits_mj.render import plots
from iits_mj.render.cameras import CAMERAS
from iits_mj.render.report import Report
from iits_mj.render.video import VideoObserver
from iits_mj.simulation import DriveConfig, DriveSummary, Observer, Simulation, Telemetry
from iits_mj.simulation.figures import drive_figures

CAPTIONS = {
    "longitudinal": "Speed, gear, brake pressure and grade",
    "lateral": "Lateral motion and articulation",
    "traffic": "Lanes and gaps",
}
INTERRUPTED = 130


@dataclass(frozen=True, kw_only=True)
class Options(DriveConfig):
    """Flags of `iits-mj drive`: the drive itself and what is kept of it."""

    out: Path = option(Path("out"), help="folder for everything that is made", metavar="DIR")
    video: bool = option(True, help="make drive.mp4")
    size: tuple[int, int] = option((960, 540), help="picture size", metavar="WxH")
    camera: str = option("chase", help="view of the video", choices=CAMERAS)
    fps: int = option(20, help="pictures per second of the video", low=5, high=50)
    json: bool = option(False, help="print the summary as one JSON object")


@dataclass(frozen=True, slots=True)
class Outcome:
    """What there is to show of a drive, finished or interrupted."""

    summary: DriveSummary
    telemetry: Telemetry
    video: Path | None
    notes: tuple[str, ...]


def run(options: Options) -> int:
    """Drives, writes everything and prints the summary."""
    prepare_folder(options.out)
    outcome, interrupted = _drive(options)
    pages = _write(options, outcome)
    summary = outcome.summary
    if options.json:
        print(json.dumps(_summary_object(options, outcome), allow_nan=False))
    else:
        print(summary.to_text())
        for name, path in pages:
            print(f"{name}: {path}")
    if interrupted:
        return INTERRUPTED
    return 1 if summary.collision else 0


def _drive(options: Options) -> tuple[Outcome, bool]:
    """Runs the simulation; True when it was interrupted."""
    interrupted = False
    with ExitStack() as stack:
        simulation = stack.enter_context(Simulation(options, visuals=options.video))
        telemetry = stack.enter_context(Telemetry(options.out / "telemetry.csv"))
        film, notes = _open_film(options, simulation)
        observers: list[Observer] = [telemetry]
        if film is not None:
            observers.append(stack.enter_context(film))
        try:
            with progress_bar(options.duration) as progress:
                summary = simulation.run(observers, progress)
        except KeyboardInterrupt:
            interrupted = True
            summary = simulation.summary("interrupted")
    return Outcome(summary, telemetry, film.path if film else None, notes), interrupted


def _open_film(
    options: Options, simulation: Simulation
) -> tuple[VideoObserver | None, tuple[str, ...]]:
    """The video's writer; None, with a note that says why, where pictures cannot be made."""
    if not options.video:
        return None, ()
    try:
        film = VideoObserver(
            options.out / "drive.mp4", simulation.truck, options.size, options.camera, options.fps
        )
    except RenderError as error:
        print(f"iits-mj: driving without a video: {error}", file=sys.stderr)
        return None, (f"There is no video: {error}",)
    return film, ()


def _write(options: Options, outcome: Outcome) -> list[tuple[str, Path]]:
    """Writes plots, report and summary; the list of what lies where."""
    out = options.out
    images = []
    for name, panels in drive_figures(outcome.telemetry).items():
        images.append((CAPTIONS[name], plots.save(panels, out / f"{name}.png")))
    write_json(out / "summary.json", _summary_object(options, outcome))
    summary = outcome.summary
    where = options.map.name if options.map is not None else "the built-in highway"
    Report(
        title="iits-mj drive",
        lead=f"{summary.distance / 1e3:.2f} km in {summary.duration:.0f} s on {where}; "
        f"{summary.ended}",
        rows=summary.rows(),
        video=outcome.video,
        images=images,
        settings=[*_settings(options), ("version", iits_mj.__version__)],
        notes=outcome.notes,
    ).write(out / "report.html")
    pages = [
        ("report", out / "report.html"),
        ("telemetry", out / "telemetry.csv"),
    ]
    return [*pages, ("video", outcome.video)] if outcome.video is not None else pages


def _settings(options: Options) -> list[tuple[str, str]]:
    rows = []
    for field in dataclasses.fields(options):
        rule = option_fields.of(field)
        if rule is not None:
            value = getattr(options, field.name)
            if isinstance(value, tuple):
                value = "x".join(str(part) for part in value)
            shown = f"{value:.6g}" if isinstance(value, float) else str(value)
            rows.append((field.name.replace("_", " "), f"{shown} {rule.unit}".strip()))
    return rows


def _summary_object(options: Options, outcome: Outcome) -> dict[str, object]:
    return {
        "command": "drive",
        "version": iits_mj.__version__,
        "seed": options.seed,
        "summary": outcome.summary.as_dict(),
        "settings": dict(_settings(options)),
        "notes": list(outcome.notes),
    }
