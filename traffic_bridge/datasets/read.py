"""Reads a data set; the format is found by the content, not by the name."""

from __future__ import annotations

from pathlib import Path

from iits_mj.errors import InputError
from traffic_bridge.datasets import ngsim_pairs
from traffic_bridge.datasets.table import read_parquet
from traffic_bridge.datasets.trajectories import Trajectories


def read_trajectories(path: str | Path) -> Trajectories:
    """Trajectories of a file.

    Raises:
      InputError: it cannot be read, is of no known format, or holds a value that cannot be.
    """
    path = Path(path)
    try:
        with path.open("rb") as file:
            head = file.read(4)
    except OSError as error:
        raise InputError(f"data set {path}: {error.strerror or error}") from error
    if head == b"PAR1":
        return ngsim_pairs.read_ngsim_pairs(read_parquet(path), path)
    raise InputError(f"data set {path}: of no known format")
