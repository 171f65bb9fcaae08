"""Where logs come from: a telemetry table (CSV) or the frames of the truck's CAN bus."""

from __future__ import annotations

from pathlib import Path

from iits_mj.errors import BusError, InputError
from iits_mj.identification.bus_log import from_frames
from iits_mj.identification.log import Log
from iits_mj.identification.tables import read_table
from iits_mj.j1939 import read_log
from iits_mj.parameters import TruckParameters


def read(path: str | Path, parameters: TruckParameters, names: dict[str, str] | None = None) -> Log:
    """A log by its file's suffix: `.csv` is a table, all else a CAN log (candump .log, .asc, .blf).

    Args:
      path: of the file.
      parameters: give the reference torque of the bus's percent torques.
      names: signal to the title of its column, where a table calls it otherwise.

    Raises:
      InputError: the file cannot be read or has no signal that can be used.
    """
    if Path(path).suffix.lower() == ".csv":
        return read_table(path, names)
    if names:
        raise InputError(f"a CAN log has no columns to rename: {sorted(names)}")
    try:
        frames = list(read_log(path))
    except BusError as error:
        raise InputError(f"log {str(path)!r} cannot be read: {error}") from error
    return from_frames(frames, parameters)
