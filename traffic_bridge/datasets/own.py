"""Our own recordings as trajectories."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from traffic_bridge.datasets.assemble import Rows, assemble
from traffic_bridge.datasets.trajectories import Trajectories
from traffic_bridge.recording import COLUMNS, Recording

FloatArray = NDArray[np.float64]

LANE_WIDTH = 3.5  # [m]


def of_recording(
    recording: Recording, source: str = "recording", lane_offsets: FloatArray | None = None
) -> Trajectories:
    """The vehicles of a recording that are in a lane of the route.

    Args:
      recording: as loaded.
      source: how messages call it.
      lane_offsets: of the lanes' centres from the route's reference line at each of the recording's
        rows, shape (k,) [m]; None takes the lanes' centres from the vehicles, as the median offset
        in every lane, which is right where lanes keep their offset.

    Raises:
      InputError: no vehicle is in a lane of the route.
    """
    keep = np.flatnonzero(np.asarray(recording.lane) >= 0)
    lane = np.asarray(recording.lane)[keep].astype(np.int64)
    vehicle = np.asarray(recording.vehicle)[keep].astype(np.int64)
    values = dict(zip(COLUMNS, np.asarray(recording.columns)[:, keep], strict=True))
    frame = np.repeat(np.arange(len(recording.time)), np.diff(recording.start))[keep]
    if lane_offsets is None:
        offset = values["offset"] - _medians(values["offset"], lane)
    else:
        offset = values["offset"] - np.asarray(lane_offsets)[keep]
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
        offset=offset,
        speed=np.maximum(values["speed"], 0.0),
        acceleration=values["acceleration"],
    )
    lanes = int(lane.max()) + 1 if len(lane) else 1
    return assemble(rows, lanes, LANE_WIDTH, notes if left_out else ())


def _medians(offset: FloatArray, lane: NDArray[np.int64]) -> FloatArray:
    """Median offset of each row's lane."""
    middle = {int(one): float(np.median(offset[lane == one])) for one in np.unique(lane)}
    return np.array([middle[one] for one in lane.tolist()])
