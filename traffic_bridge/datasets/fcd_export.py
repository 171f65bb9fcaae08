"""Writes a recording as SUMO's floating-car data, for SUMO's own tools."""

from __future__ import annotations

import gzip
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING
from xml.sax.saxutils import quoteattr

import numpy as np

from iits_mj.errors import InputError

if TYPE_CHECKING:
    from traffic_bridge.recording.recording import Recording

EDGE = "route"
# Names and decimals of the figures of a row, after which comes `pos`.
ATTRIBUTES = (
    ("x", 4),
    ("y", 4),
    ("z", 4),
    ("angle", 6),
    ("speed", 5),
    ("acceleration", 5),
    ("slope", 4),
)


def write_fcd(recording: Recording, path: str | Path) -> Path:
    """Writes `fcd-export` XML, as `sumo --fcd-output` does; compressed when the name ends in .gz.

    Position and angle are SUMO's: of the front bumper's middle, clockwise from north. The route is
    one edge, named "route": `lane` is "route_0" for the right one, `pos` the station of the front
    bumper. Vehicles off the route's lanes have neither. `slope` is in degrees.

    Args:
      recording: with at least one frame.
      path: of the file.

    Raises:
      InputError: the file cannot be written.
    """
    path = Path(path)
    try:
        with gzip.open(path, "wt") if path.suffix == ".gz" else path.open("w") as file:
            file.writelines(_lines(recording))
    except OSError as error:
        raise InputError(f"floating-car data {path}: cannot be written: {error}") from error
    return path


def _lines(recording: Recording) -> Iterator[str]:
    yield '<?xml version="1.0" encoding="UTF-8"?>\n<fcd-export>\n'
    start = float(recording.time[0]) if len(recording.time) else 0.0
    for time, frame in zip(recording.time.tolist(), recording.frames, strict=True):
        yield f'    <timestep time="{time - start:.4f}">\n'
        x, y, z, yaw, pitch, speed, acceleration, station, length = frame.columns(
            "x", "y", "z", "yaw", "pitch", "speed", "acceleration", "station", "length"
        )
        half = 0.5 * length
        flat = np.cos(pitch)
        figures = np.column_stack(
            (
                x + half * flat * np.cos(yaw),
                y + half * flat * np.sin(yaw),
                z - half * np.sin(pitch),
                np.mod(90.0 - np.degrees(yaw), 360.0),
                np.maximum(speed, 0.0),
                acceleration,
                -np.degrees(pitch),
                station + half,
            )
        ).tolist()
        for name, kind, lane, row in zip(
            frame.ids, frame.kinds, frame.lanes.tolist(), figures, strict=True
        ):
            shown = " ".join(
                f'{key}="{value:.{digits}f}"'
                for (key, digits), value in zip(ATTRIBUTES, row, strict=False)
            )
            place = f' lane="{EDGE}_{lane}" pos="{row[-1]:.4f}"'
            yield (
                f"        <vehicle id={quoteattr(name)} type={quoteattr(kind)} {shown}"
                f"{place if lane >= 0 and row[-1] >= 0.0 else ''}/>\n"
            )
        yield "    </timestep>\n"
    yield "</fcd-export>\n"
