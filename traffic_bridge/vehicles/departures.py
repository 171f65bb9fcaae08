"""Vehicles that depart by a list instead of by chance."""

from __future__ import annotations

from dataclasses import dataclass

from iits_mj.core.checks import in_range, is_whole, make_plain
from iits_mj.core.errors import InputError


@dataclass(frozen=True)
class Departure:
    """One vehicle and when it comes.

    It appears as soon after `time` as its place is free.

    Attributes:
      time: traffic time [s].
      type: name of its type.
      lane: of the route, from the right.
      station: of its front bumper [m]; None is the beginning of the route.
      speed: desired speed [m/s]; None is the mean of its type.

    Raises:
      InputError: a value is not allowed.
    """

    time: float
    type: str = "car"
    lane: int = 0
    station: float | None = None
    speed: float | None = None

    def __post_init__(self) -> None:
        """Checks every value."""
        in_range("departure: time", self.time, 0.0, 1e6)
        if not isinstance(self.type, str) or not self.type:
            raise InputError(f"departure: type = {self.type!r}: must be the name of a vehicle type")
        if not is_whole(self.lane) or self.lane < 0:
            raise InputError(f"departure: lane = {self.lane!r}: must be a whole number from 0 on")
        if self.station is not None:
            in_range("departure: station", self.station, 0.0, 1e6)
        if self.speed is not None:
            in_range("departure: speed", self.speed, 0.5, 70.0)
        make_plain(self)
