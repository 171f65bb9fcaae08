"""Reader of highD-like recordings: `NN_tracks.csv`, `NN_tracksMeta.csv`, `NN_recordingMeta.csv`.

The schema is that of Krajewski, Bock, Kloeker and Eckstein, "The highD dataset", ITSC 2018: boxes
by their upper left corner in an image whose y points down, in meters; `width` is along x. Vehicles
of `drivingDirection` 1 drive to the left in the upper lanes, those of 2 to the right in the lower.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from iits_mj.core.arrays import FloatArray, IntArray
from iits_mj.core.errors import InputError
from traffic_bridge.datasets.assemble import Rows, assemble
from traffic_bridge.datasets.ngsim import ARTICULATED_LENGTH
from traffic_bridge.datasets.table import Table, read_csv
from traffic_bridge.datasets.trajectories import Trajectories, find

MARKS = ("frame", "id", "x", "y", "xVelocity", "laneId")
MARKINGS = {1: "upperLaneMarkings", 2: "lowerLaneMarkings"}
STANDSTILL_NOISE = 0.5  # [m/s]: noise of the speed of a standing vehicle, at most


def read_highd(table: Table, path: Path, *, direction: int | None = None) -> Trajectories:
    """Trajectories of one driving direction; the other two files are beside the tracks file.

    Lanes are the bands between the lane markings; a vehicle off them belongs to the nearest one.
    Station zero is the upstream end of the recorded stretch.

    Args:
      table: columns of the tracks file.
      path: of the tracks file.
      direction: 1 (upper lanes) or 2 (lower lanes); None: the one with more vehicles.

    Raises:
      InputError: a file or column is missing, or a value is impossible.
    """
    tracks = read_csv(_beside(path, "tracksMeta"), ",")
    recording = read_csv(_beside(path, "recordingMeta"), ",")
    rate = float(recording.numbers("frameRate")[0])
    recording.must(np.array([1.0 <= rate <= 1000.0]), "frameRate", [rate], "must be 1 to 1000")
    ids = tracks.integers("id")
    heading = tracks.integers("drivingDirection")
    tracks.must(np.isin(heading, (1, 2)), "drivingDirection", heading, "must be 1 or 2")
    direction, notes = _direction(heading, direction)
    markings = _markings(recording, MARKINGS[direction])

    vehicle = table.integers("id")
    order = np.argsort(ids)
    found = find(ids[order], vehicle)
    table.must(found >= 0, "id", vehicle, f"is not in {tracks.path}")
    place = order[found]
    classes = np.char.lower(tracks.texts("class"))
    tracks.must(np.isin(classes, ("car", "truck")), "class", classes, "must be Car or Truck")

    keep = heading[place] == direction
    x, y = table.numbers("x")[keep], table.numbers("y")[keep]
    length, width = table.numbers("width")[keep], table.numbers("height")[keep]
    ahead = 1.0 if direction == 2 else -1.0
    front = x + length if direction == 2 else -x
    origin = float(np.min(x)) if direction == 2 else -float(np.max(x + length))
    middle = y + 0.5 * width
    band = np.clip(np.searchsorted(markings, middle, side="right") - 1, 0, len(markings) - 2)
    center = 0.5 * (markings[band] + markings[band + 1])
    lanes = len(markings) - 1
    speed = ahead * table.numbers("xVelocity")[keep]
    where = np.flatnonzero(keep)
    trucks = np.where(length >= ARTICULATED_LENGTH, "articulated", "truck")
    rows = Rows(
        source=f"data set {path}",
        where=lambda k: table.where(int(where[k])),
        name=vehicle[keep],
        kind=np.where(classes[place][keep] == "truck", trucks, "car"),
        length=length,
        width=width,
        time=table.integers("frame")[keep] / rate,
        lane=(lanes - 1 - band) if direction == 2 else band,
        station=front - origin,
        offset=ahead * (center - middle),
        speed=np.where(speed > -STANDSTILL_NOISE, np.maximum(speed, 0.0), speed),
        acceleration=ahead * table.numbers("xAcceleration")[keep],
        leader=table.integers("precedingId")[keep],
        speed_column="xVelocity",
    )
    return assemble(rows, lanes, float(np.mean(np.diff(markings))), notes)


def _beside(path: Path, what: str) -> Path:
    if "tracks" not in path.name:
        raise InputError(
            f"data set {path}: the name must contain 'tracks', as in '01_tracks.csv', so that the "
            f"{what} file beside it is found"
        )
    other = path.with_name(what.join(path.name.rsplit("tracks", 1)))
    if not other.is_file():
        raise InputError(f"data set {path}: needs {other.name} beside it")
    return other


def _direction(heading: IntArray, given: int | None) -> tuple[int, tuple[str, ...]]:
    """The driving direction to read, and a note on the vehicles of the other."""
    there = sorted(set(heading.tolist()))
    if given is not None:
        if given not in there:
            raise InputError(f"direction {given!r}: the recording has {there}")
        return given, ()
    chosen = max(there, key=lambda d: int((heading == d).sum()))
    other = int((heading != chosen).sum())
    if not other:
        return chosen, ()
    return chosen, (f"driving direction {chosen}; {other} vehicles of the other are left out",)


def _markings(recording: Table, name: str) -> FloatArray:
    text = str(recording.texts(name)[0])
    try:
        markings = np.array([float(value) for value in text.split(";")])
    except ValueError:
        markings = np.zeros(0)
    increasing = len(markings) >= 2 and bool(np.all(np.diff(markings) > 1.0))
    recording.must(
        np.array([increasing]), name, [text], "must be two or more increasing numbers of meters"
    )
    return markings
