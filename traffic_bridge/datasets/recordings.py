"""Our own recordings as trajectories, and as floating-car data for SUMO's tools."""

from __future__ import annotations

import gzip
from collections.abc import Iterator
from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np

from iits_mj.core.arrays import FloatArray, IntArray
from iits_mj.core.errors import InputError
from iits_mj.road import Route
from traffic_bridge.datasets.assemble import Rows, assemble
from traffic_bridge.datasets.trajectories import Trajectories
from traffic_bridge.recording.provenance import check_map
from traffic_bridge.recording.recording import Recording
from traffic_bridge.recording.rows import COLUMNS

LANE_WIDTH = 3.5  # [m], for a recording of one lane without its road
EDGE = "route"
# Names and decimals of the values of a row; `pos` follows.
ATTRIBUTES = (
    ("x", 4),
    ("y", 4),
    ("z", 4),
    ("angle", 6),
    ("speed", 5),
    ("acceleration", 5),
    ("slope", 4),
)


def of_recording(
    recording: Recording, source: str = "recording", route: Route | None = None
) -> Trajectories:
    """The vehicles of a recording that are in a lane of the route.

    Args:
      recording: as loaded.
      source: its name in messages.
      route: the road of the recording. Without it a lane's center is the median offset of its
        vehicles, which is right if lanes keep their offset.

    Raises:
      InputError: no vehicle is in a lane of the route, or the recording is of another map.
    """
    if route is not None:
        check_map(recording, source, route)
    keep = np.flatnonzero(np.asarray(recording.lane) >= 0)
    if not keep.size:
        raise InputError(f"{source}: no vehicle is in a lane of its route")
    lane = np.asarray(recording.lane)[keep].astype(np.int64)
    vehicle = np.asarray(recording.vehicle)[keep].astype(np.int64)
    values = dict(zip(COLUMNS, np.asarray(recording.columns)[:, keep], strict=True))
    frame = np.repeat(np.arange(len(recording.time)), np.diff(recording.start))[keep]
    center, width = _lanes(lane, values["offset"], values["station"], route)
    left_out = len(recording.lane) - len(keep)
    notes = (f"{left_out} rows of vehicles off the route's lanes are left out",)
    sizes = np.asarray(recording.sizes)[vehicle]
    rows = Rows(
        source=source,
        where=lambda k: f"row {int(keep[k]) + 1}",
        name=np.array(recording.ids)[vehicle],
        kind=np.array(recording.kinds)[vehicle],
        length=sizes[:, 0],
        width=sizes[:, 1],
        time=np.asarray(recording.time)[frame],
        lane=lane,
        station=values["station"] + 0.5 * sizes[:, 0],
        offset=values["offset"] - center,
        speed=np.maximum(values["speed"], 0.0),
        acceleration=values["acceleration"],
    )
    return assemble(rows, int(lane.max()) + 1, width, notes if left_out else ())


def _lanes(
    lane: IntArray, offset: FloatArray, station: FloatArray, route: Route | None
) -> tuple[FloatArray, float]:
    """Offset of the center of each row's lane, and the width of a lane [m]."""
    indices = np.unique(lane).tolist()
    center = np.empty_like(offset)
    widths = []
    for one in indices:
        rows = lane == one
        if route is None:
            center[rows] = np.median(offset[rows])
        else:
            center[rows] = route.lane_offset(one, station[rows])
            widths.append(route.lane_width(one, station[rows]))
    if route is not None:
        return center, float(np.median(np.concatenate(widths)))
    if len(indices) < 2:
        return center, LANE_WIDTH
    middles = [float(np.median(offset[lane == one])) for one in indices]
    return center, float(np.median(np.diff(middles) / np.diff(indices)))


def write_fcd(recording: Recording, path: str | Path) -> Path:
    """Writes `fcd-export` XML, as `sumo --fcd-output` does; compressed if the name ends in .gz.

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
