"""The hash of a traffic's course: two runs with one hash had every vehicle at the same places."""

from __future__ import annotations

import hashlib
import struct
from collections.abc import Iterable

import numpy as np

from iits_mj.messages import TrackedVehicle
from traffic_bridge.frame import VehicleFrame


class PoseDigest:
    """SHA-256 over every vehicle's name, kind, lane and figures, frame after frame.

    Bits count, not values: a difference in the last place of one number gives another hash.

    Attributes:
      count: frames added.
    """

    def __init__(self) -> None:
        self.count = 0
        self._hash = hashlib.sha256()

    def add(self, vehicles: Iterable[TrackedVehicle]) -> None:
        """Adds a frame."""
        frame = VehicleFrame.of(vehicles)
        self._hash.update(struct.pack("<I", len(frame)))
        self._hash.update("\0".join((*frame.ids, *frame.kinds)).encode())
        self._hash.update(np.ascontiguousarray(frame.lanes, dtype="<i4").tobytes())
        self._hash.update(np.ascontiguousarray(frame.values, dtype="<f8").tobytes())
        self.count += 1

    def hexdigest(self) -> str:
        """The digest so far."""
        return self._hash.hexdigest()
